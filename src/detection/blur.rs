//! How the light of a point is blurred in a micro-image.
//!
//! Light that comes through a point w of the micro-lens (a disc of radius 1) shows the board moved by
//! ρ w, and the pupil of the main lens moved by qᵢ w: pixel p sees the mean of the board at p − ρ w
//! over those w for which p − qᵢ w lies in the pupil, a disc of radius a about the centre of the
//! micro-image. Away from the centre the pupil cuts the disc of blur, and the mean moves: without that
//! a corner near the edge would seem up to ρ away from its place. That place of the pupil also tells how far
//! the aberrations of the main lens bend the ray.

// Only what is inlined into a dispatched function is compiled for its registers.
#![allow(clippy::inline_always)]

use nalgebra::Vector2;
use pulp::{Arch, NullaryFnOnce};

use super::MicroOptics;
use super::aberration::Bend;
use super::patch::Patch;
use super::rays::{PixelRays, Rays};
use crate::vignetting::{DISC, Field, Obliquity, PartPoints, ROOM, Vignetting, VisiblePart};

/// How a micro-image blurs a point.
#[derive(Debug, Clone)]
pub(super) struct Blur<'a> {
    /// ρ, px.
    pub(super) rho: f64,
    /// qᵢ, px.
    pub(super) q: f64,
    /// a, the radius of the pupil, px.
    pub(super) pupil: f64,
    /// What the aberrations add.
    pub(super) bend: Bend,
    /// Which part of the micro-lens the pupil leaves visible.
    pub(super) vignetting: &'a Vignetting,
    /// The angles at which the light arrives.
    pub(super) obliquity: Obliquity,
    /// Variance along an axis by which edges are wider than blur and pixels make them, px².
    pub(super) wider_px2: f32,
}

impl<'a> Blur<'a> {
    /// For a point with the slope γ, seen through a micro-lens of which `vignetting` tells the visible parts.
    pub fn new(optics: &MicroOptics, slope: f64, bend: Bend, vignetting: &'a Vignetting) -> Self {
        let (rho, q) = (optics.blur_radius_px(slope), optics.q_px());
        Self {
            rho,
            q,
            pupil: optics.pupil_px,
            bend,
            vignetting,
            obliquity: optics.obliquity,
            wider_px2: 0.0,
        }
    }

    /// With edges that are wider by a variance along an axis, px².
    #[allow(clippy::cast_possible_truncation)] // single precision, as the light
    pub fn wider(self, px2: f64) -> Self {
        Self { wider_px2: self.wider_px2 + px2 as f32, ..self }
    }

    /// The rays that arrive at the pixels of a patch.
    #[cfg(test)]
    pub fn rays(&self, patch: &Patch) -> Rays {
        let mut rays = Rays::default();
        self.trace(patch, &mut rays);
        rays
    }

    /// Puts the rays that arrive at the pixels of a patch in the place of others.
    pub fn trace(&self, patch: &Patch, rays: &mut Rays) {
        let mut all = rays.take();
        Arch::new().dispatch(Tracing { blur: self, patch, all: &mut all });
        *rays = Rays::Blurred(all);
    }
}

/// The rays of a patch.
struct Tracing<'a> {
    blur: &'a Blur<'a>,
    patch: &'a Patch,
    all: &'a mut Vec<PixelRays>,
}

impl NullaryFnOnce for Tracing<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { blur, patch, all } = self;
        let (bends, bend) = (blur.bend.bends(), blur.bend.in_single());
        all.resize(patch.x.len(), PixelRays::NONE);
        for (rays, (&x, &y)) in all.iter_mut().zip(patch.x.iter().zip(&patch.y)) {
            let pixel = OfPixel::new(blur, &Vector2::new(f64::from(x), f64::from(y)));
            pixel.trace(rays);
            if bends {
                for j in 0..ROOM {
                    let bent = bend.at(&Vector2::new(rays.pupil_x[j], rays.pupil_y[j]));
                    rays.origin_x[j] += bent.x;
                    rays.origin_y[j] += bent.y;
                }
            }
        }
    }
}

/// What the rays of a pixel have in common.
struct OfPixel<'a> {
    points: &'a PartPoints,
    /// That of qᵢ.
    sign: f32,
    spread: [f32; 2],
    field: Field,
    rho: f32,
    /// Variance of a pixel along an axis, px².
    pixel: f32,
    /// Variance of the cells of the points along an axis, with that of what makes edges wider, px².
    cell: f32,
    /// Place of the mean of the points, px, and how a point along and across moves it: for ρ and for qᵢ.
    sharp: [f32; 4],
    pupil: [f32; 4],
}

impl<'a> OfPixel<'a> {
    #[inline(always)]
    #[allow(clippy::cast_possible_truncation)] // single precision, as the light
    fn new(blur: &Blur<'a>, offset: &Vector2<f64>) -> Self {
        let part = blur.vignetting.at(offset);
        let mean_square = DISC.mean_square;
        // The mean square of a disc along an axis is a quarter; the points have less.
        let cell = blur.rho * blur.rho * (0.25 - mean_square) * part.spread[0] * part.spread[1];
        // Points of the micro-lens are half a turn away from where they lie.
        let from_lens = offset + part.mean * blur.obliquity.half_pitch_px;
        let slant = blur.obliquity.over_part(&from_lens, &part.outwards, part.spread);
        Self {
            points: part.points,
            sign: part.sign as f32,
            spread: [part.spread[0] as f32, part.spread[1] as f32],
            field: slant.field(mean_square),
            rho: blur.rho as f32,
            pixel: part.pixel,
            cell: cell as f32 + blur.wider_px2,
            sharp: placed(&part, blur.rho),
            pupil: placed(&part, blur.q),
        }
    }

    /// Its rays as through an ideal main lens.
    #[inline(always)]
    fn trace(&self, rays: &mut PixelRays) {
        let disc = &*DISC;
        let ([o_x, o_y, o_along, o_across], [p_x, p_y, p_along, p_across]) =
            (self.sharp, self.pupil);
        for j in 0..ROOM {
            let moved = self.field.at(self.sign * disc.x[j], disc.y[j]);
            let along = self.points.along[j] + self.spread[0] * moved[0];
            let across = self.points.across[j] + self.spread[1] * moved[1];
            rays.origin_x[j] = o_x - o_along * along + o_across * across;
            rays.origin_y[j] = o_y - o_across * along - o_along * across;
            rays.pupil_x[j] = p_x - p_along * along + p_across * across;
            rays.pupil_y[j] = p_y - p_across * along - p_along * across;
            let width = inverse_width(self.points.pixel(j, self.rho) * self.pixel + self.cell);
            rays.inverse_width[j] = disc.is_one[j] * width;
        }
    }
}

/// Place of the mean of the points of a part, px, and how a point along and across moves it, for a blur radius.
#[inline(always)]
#[allow(clippy::cast_possible_truncation)] // single precision, as the light
fn placed(part: &VisiblePart, radius: f64) -> [f32; 4] {
    let (middle, along) = (part.seen_at - part.mean * radius, part.outwards * radius);
    [middle.x as f32, middle.y as f32, along.x as f32, along.y as f32]
}

/// Half widths of steps are not below this, px.
const LEAST_WIDTH_PX: f32 = 0.3;

/// One over half the width of a step whose derivative has a variance: a fifth of the half width squared.
#[inline(always)]
fn inverse_width(variance: f32) -> f32 {
    (5.0 * variance).max(LEAST_WIDTH_PX * LEAST_WIDTH_PX).sqrt().recip()
}

#[cfg(test)]
mod tests {
    use super::super::corner::{FitRoom, Free};
    use super::super::exact_light::ExactLight;
    use super::*;
    use crate::vignetting::POINTS;

    /// Mean and variances of where the light of the pixel at (x, 0) comes from.
    fn moments(light: &ExactLight, x: f64) -> [f64; 3] {
        let light = light.of_pixel([x, 0.0]);
        let all: f64 = light.iter().map(|(weight, _)| weight).sum();
        let mean_of = |of: &dyn Fn(&Vector2<f64>) -> f64| {
            light.iter().map(|(weight, origin)| weight * of(origin)).sum::<f64>() / all
        };
        let mean = mean_of(&|o| o.x);
        [mean, mean_of(&|o| (o.x - mean).powi(2)), mean_of(&|o| o.y * o.y)]
    }

    /// By how much corners of summed light at a distance from the centre are found further outwards, px: the mean of
    /// several directions.
    fn misplaced(rho: f64, q: f64, distance: f64) -> f64 {
        let light = ExactLight { rho, q, ..ExactLight::default() };
        let vignetting = light.vignetting();
        let blur = light.blur(&vignetting);
        let all = light.corners(distance).map(|(start, patch)| {
            let found = start
                .fitted(&patch, &blur.rays(&patch), Free::Place, &mut FitRoom::default())
                .unwrap();
            (found.place - start.place).dot(&start.place) / distance
        });
        all.iter().sum::<f64>() / all.len() as f64
    }

    #[test]
    fn corners_of_summed_light_are_where_they_are() {
        for (rho, q) in [(-4.2, -5.1), (-3.3, -4.2), (-2.1, -4.2)] {
            for distance in [2.2, 3.8, 5.2] {
                let error = misplaced(rho, q, distance);
                assert!(error.abs() < 0.005, "{error} at {distance} for {rho}");
            }
        }
    }

    #[test]
    fn rays_come_from_where_the_light_does() {
        let light = ExactLight { of_pixel: 8, rings: 40, ..ExactLight::default() };
        let vignetting = light.vignetting();
        let blur = light.blur(&vignetting);
        let places = [0.5_f32, 1.5, 3.0, 4.5, 6.0, 7.5, 9.0];
        let patch = Patch { x: places.into(), y: vec![0.0; places.len()], ..Patch::default() };
        let rays = blur.rays(&patch);
        for (i, x) in places.into_iter().enumerate() {
            let Rays::Blurred(of_pixels) = &rays else { unreachable!() };
            let rays = &of_pixels[i];
            let mean_of =
                |of: &dyn Fn(usize) -> f64| (0..POINTS).map(of).sum::<f64>() / POINTS as f64;
            let mean = mean_of(&|j| f64::from(rays.origin_x[j]));
            let left_out = mean_of(&|j| f64::from(rays.inverse_width[j]).powi(-2) / 5.0);
            let along = mean_of(&|j| (f64::from(rays.origin_x[j]) - mean).powi(2)) + left_out;
            let across = mean_of(&|j| f64::from(rays.origin_y[j]).powi(2)) + left_out;
            let [expected, expected_along, expected_across] = moments(&light, f64::from(x));
            assert!((mean - expected).abs() < 0.003, "{x}: {mean} for {expected}");
            let spread = |variance: f64| variance.sqrt();
            assert!(
                (spread(along) - spread(expected_along)).abs() < 0.04
                    && (spread(across) - spread(expected_across)).abs() < 0.04,
                "{x}: {along} {across} for {expected_along} {expected_across}"
            );
        }
    }
}
