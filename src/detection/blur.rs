//! How the light of a point is blurred in a micro-image.
//!
//! Light that comes through a point w of the micro-lens (a disc of radius 1) shows the board moved by
//! ρ w, and the pupil of the main lens moved by qᵢ w: pixel p sees the mean of the board at p − ρ w
//! over those w for which p − qᵢ w lies in the pupil, a disc of radius a about the centre of the
//! micro-image. Away from the centre the pupil cuts the disc of blur, and the mean moves: without that
//! a corner near the edge would seem up to ρ away from its place. That place of the pupil also tells how far
//! the aberrations of the main lens bend the ray.

use nalgebra::Vector2;

use super::MicroOptics;
use super::aberration::Bend;
use super::patch::Patch;
use crate::vignetting::{Obliquity, POINTS, PartPoint, Vignetting, mean_square, of_disc};

/// How a micro-image blurs a point.
#[derive(Debug, Clone)]
pub(super) struct Blur<'a> {
    /// ρ, px.
    rho: f64,
    /// qᵢ, px.
    q: f64,
    /// What the aberrations add.
    bend: Bend,
    /// Which part of the micro-lens the pupil leaves visible.
    vignetting: &'a Vignetting,
    /// The angles at which the light arrives.
    obliquity: Obliquity,
    /// Whether it blurs at all.
    blurs: bool,
    /// The disc that the points of visible parts come from.
    disc: [Vector2<f32>; POINTS],
}

/// The rays that arrive at the pixels of a micro-image.
pub(super) struct Rays {
    /// By point of the micro-lens, for every pixel: where in the sharp and straightened image its light comes
    /// from, p − ρ w + E/A, and where in the pupil, p − qᵢ w, both as (x, y) from the centre of the
    /// micro-image, px; and one over half the width over which a step rises by what the point leaves out, which
    /// is the extent of its cell and of the pixel, px⁻¹.
    pub points: Vec<[Vec<f32>; 5]>,
}

impl<'a> Blur<'a> {
    /// For a point with the slope γ, seen through a micro-lens of which `vignetting` tells the visible parts.
    pub fn new(optics: &MicroOptics, slope: f64, bend: Bend, vignetting: &'a Vignetting) -> Self {
        let (rho, q) = (optics.blur_radius_px(slope), optics.q_px());
        let (obliquity, disc) = (optics.obliquity, of_disc_in_single());
        Self { rho, q, bend, vignetting, obliquity, blurs: true, disc }
    }

    /// No blur, for steps of unknown width: they rise over 1 px to either side.
    pub fn unknown(vignetting: &'a Vignetting) -> Self {
        let (bend, obliquity, disc) = (Bend::none(), Obliquity::default(), of_disc_in_single());
        Self { rho: 0.0, q: 0.0, bend, vignetting, obliquity, blurs: false, disc }
    }

    /// The rays that arrive at the pixels of a patch.
    #[allow(clippy::cast_possible_truncation)] // single precision, as the light
    pub fn rays(&self, patch: &Patch) -> Rays {
        let (bend, bends) = (self.bend.in_single(), self.bend.bends());
        let count = if self.blurs { POINTS } else { 1 };
        let pixels = patch.x.len();
        let mut points: Vec<[Vec<f32>; 5]> =
            (0..count).map(|_| [(); 5].map(|()| vec![0.0; pixels])).collect();
        let rho = self.rho as f32;
        let mean_square = mean_square();
        for (i, (&x, &y)) in patch.x.iter().zip(&patch.y).enumerate() {
            let offset = Vector2::new(f64::from(x), f64::from(y));
            let part = self.vignetting.at(&offset);
            // The mean square of a disc along an axis is a quarter; the points have less.
            let cell = self.rho * self.rho * (0.25 - mean_square) * part.spread[0] * part.spread[1];
            // Points of the micro-lens are half a turn away from where they lie.
            let from_lens = offset + part.mean * self.obliquity.half_pitch_px;
            let slant = self.obliquity.over_part(&from_lens, &part.outwards, part.spread);
            let field = slant.field(mean_square);
            let (spread, sign) = (part.spread.map(|x| x as f32), part.sign as f32);
            let place = |point: &PartPoint, of_disc: &Vector2<f32>| {
                let moved = field(&Vector2::new(sign * of_disc.x, of_disc.y));
                point.place + Vector2::new(spread[0] * moved.x, spread[1] * moved.y)
            };
            let scaled = |radius: f64| {
                let middle = (part.seen_at - part.mean * radius).map(|x| x as f32);
                let along = (part.outwards * radius).map(|x| x as f32);
                move |point: &Vector2<f32>| {
                    Vector2::new(
                        middle.x - along.x * point.x + along.y * point.y,
                        middle.y - along.y * point.x - along.x * point.y,
                    )
                }
            };
            let (sharp, pupil) = (scaled(self.rho), scaled(self.q));
            for ((rays, point), of_disc) in points.iter_mut().zip(part.points).zip(&self.disc) {
                let (w, inverse_width) = if self.blurs {
                    let variance = point.pixel(rho) + cell as f32;
                    (place(point, of_disc), inverse_width(variance))
                } else {
                    (Vector2::zeros(), 1.0)
                };
                let pupil = pupil(&w);
                let bent = if bends { bend.at(&pupil) } else { Vector2::zeros() };
                let origin = sharp(&w) + bent;
                let own = [origin.x, origin.y, pupil.x, pupil.y, inverse_width];
                for (all, own) in rays.iter_mut().zip(own) {
                    all[i] = own;
                }
            }
        }
        Rays { points }
    }
}

/// Half widths of steps are not below this, px.
const LEAST_WIDTH_PX: f32 = 0.3;

/// One over half the width of a step whose derivative has a variance: a fifth of the half width squared.
fn inverse_width(variance: f32) -> f32 {
    (5.0 * variance).max(LEAST_WIDTH_PX * LEAST_WIDTH_PX).sqrt().recip()
}

/// The points of the whole disc.
#[allow(clippy::cast_possible_truncation)] // single precision, as the light
fn of_disc_in_single() -> [Vector2<f32>; POINTS] {
    of_disc().map(|p| p.map(|x| x as f32))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The lens of an R12 whose micro-images are most vignetted, px, with cos⁴.
    const RHO: f64 = -3.4;
    const Q: f64 = -4.19;
    const PUPIL: f64 = 6.48;
    const HALF_PITCH: f64 = 11.65;
    const WITHIN: f64 = 4.0 / (59.0 * 59.0);

    /// Mean and variances of where the light of the pixel at (x, 0) comes from, from sums over the pixel and the
    /// micro-lens.
    fn summed(x: f64) -> [f64; 3] {
        let (mut light, mut mean, mut along, mut across) = (0.0, 0.0, 0.0, 0.0);
        let steps = |count: i32, half: f64| {
            (0..count).map(move |i| half * ((f64::from(i) + 0.5) * 2.0 / f64::from(count) - 1.0))
        };
        for (dx, dy) in steps(8, 0.5).flat_map(|dx| steps(8, 0.5).map(move |dy| (dx, dy))) {
            for (a, b) in steps(80, 1.0).flat_map(|a| steps(80, 1.0).map(move |b| (a, b))) {
                let (w, p) = (Vector2::new(a, b), Vector2::new(x + dx, dy));
                if w.norm() > 1.0 || (p - w * Q).norm() > PUPIL {
                    continue;
                }
                let oblique = (p + w * HALF_PITCH).norm_squared();
                let weight = (1.0 + WITHIN * oblique / 4.0).powi(-2);
                let origin = p - w * RHO;
                light += weight;
                mean += weight * origin.x;
                along += weight * origin.x * origin.x;
                across += weight * origin.y * origin.y;
            }
        }
        mean /= light;
        [mean, along / light - mean * mean, across / light]
    }

    #[test]
    fn rays_come_from_where_the_light_does() {
        let vignetting = Vignetting::new(PUPIL, Q);
        let obliquity =
            Obliquity { within_per_px2: WITHIN, half_pitch_px: HALF_PITCH, ..Obliquity::default() };
        let blur = Blur {
            rho: RHO,
            q: Q,
            bend: Bend::none(),
            vignetting: &vignetting,
            obliquity,
            blurs: true,
            disc: of_disc_in_single(),
        };
        let places = [0.5_f32, 1.5, 3.0, 4.5, 6.0, 7.5, 9.0];
        let patch = Patch { x: places.into(), y: vec![0.0; places.len()], ..Patch::default() };
        let rays = blur.rays(&patch);
        for (i, x) in places.into_iter().enumerate() {
            let mean_of = |of: &dyn Fn(&[Vec<f32>; 5]) -> f64| {
                rays.points.iter().map(of).sum::<f64>() / POINTS as f64
            };
            let mean = mean_of(&|p| f64::from(p[0][i]));
            let left_out = mean_of(&|p| f64::from(p[4][i]).powi(-2) / 5.0);
            let along = mean_of(&|p| (f64::from(p[0][i]) - mean).powi(2)) + left_out;
            let across = mean_of(&|p| f64::from(p[1][i]).powi(2)) + left_out;
            let [expected, expected_along, expected_across] = summed(f64::from(x));
            assert!((mean - expected).abs() < 0.005, "{x}: {mean} for {expected}");
            let spread = |variance: f64| variance.sqrt();
            assert!(
                (spread(along) - spread(expected_along)).abs() < 0.04
                    && (spread(across) - spread(expected_across)).abs() < 0.04,
                "{x}: {along} {across} for {expected_along} {expected_across}"
            );
        }
    }
}
