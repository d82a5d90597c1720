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
        let bend = self.bend.in_single();
        let count = if self.blurs { POINTS } else { 1 };
        let pixels = patch.x.len();
        let mut points: Vec<[Vec<f32>; 5]> =
            (0..count).map(|_| [(); 5].map(|()| Vec::with_capacity(pixels))).collect();
        let rho = self.rho as f32;
        let mean_square = mean_square();
        for (&x, &y) in patch.x.iter().zip(&patch.y) {
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
                let origin = sharp(&w) + bend.at(&pupil);
                let own = [origin.x, origin.y, pupil.x, pupil.y, inverse_width];
                for (all, own) in rays.iter_mut().zip(own) {
                    all.push(own);
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
