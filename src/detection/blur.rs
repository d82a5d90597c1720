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
use crate::vignetting::{Obliquity, POINTS, Vignetting, mean_square};

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
    /// See [`Rays::width`].
    width: f64,
}

/// The rays that arrive at the pixels of a micro-image.
pub(super) struct Rays {
    /// By point of the micro-lens, for every pixel: where in the sharp and straightened image its light comes
    /// from, p − ρ w + E/A, and where in the pupil, p − qᵢ w, both as (x, y) from the centre of the
    /// micro-image, px.
    pub points: Vec<[Vec<f32>; 4]>,
    /// Half the width over which a step rises by what the points leave out: the disc between them, and a
    /// pixel, px.
    pub width: f64,
}

impl<'a> Blur<'a> {
    /// For a point with the slope γ, seen through a micro-lens of which `vignetting` tells the visible parts.
    pub fn new(optics: &MicroOptics, slope: f64, bend: Bend, vignetting: &'a Vignetting) -> Self {
        let (rho, q) = (optics.blur_radius_px(slope), optics.q_px());
        // The mean square of a disc along an axis is a quarter; the points have less.
        // The step's derivative has a variance of a fifth of its half width squared.
        let width = (5.0 * (1.0 / 12.0 + rho * rho * (0.25 - mean_square()))).sqrt();
        Self { rho, q, bend, vignetting, obliquity: optics.obliquity, blurs: true, width }
    }

    /// No blur, for steps of unknown width.
    pub fn unknown(vignetting: &'a Vignetting) -> Self {
        let (bend, obliquity) = (Bend::none(), Obliquity::default());
        Self { rho: 0.0, q: 0.0, bend, vignetting, obliquity, blurs: false, width: 3.0 }
    }

    /// The rays that arrive at the pixels of a patch.
    #[allow(clippy::cast_possible_truncation)] // single precision, as the light
    pub fn rays(&self, patch: &Patch) -> Rays {
        let bend = self.bend.in_single();
        let count = if self.blurs { POINTS } else { 1 };
        let pixels = patch.x.len();
        let mut points: Vec<[Vec<f32>; 4]> =
            (0..count).map(|_| [(); 4].map(|()| Vec::with_capacity(pixels))).collect();
        for (&x, &y) in patch.x.iter().zip(&patch.y) {
            let offset = Vector2::new(f64::from(x), f64::from(y));
            let part = self.vignetting.at(&offset);
            // Points of the micro-lens are half a turn away from where they lie.
            let from_lens = offset + part.mean * self.obliquity.half_pitch_px;
            let mean = part.mean - self.obliquity.shift(&from_lens, &part.squeeze);
            let scaled = |radius: f64| {
                let middle = (part.seen_at - mean * radius).map(|x| x as f32);
                let along = (part.outwards * radius).map(|x| x as f32);
                move |point: &Vector2<f32>| {
                    Vector2::new(
                        middle.x - along.x * point.x + along.y * point.y,
                        middle.y - along.y * point.x - along.x * point.y,
                    )
                }
            };
            let (sharp, pupil) = (scaled(self.rho), scaled(self.q));
            for (rays, point) in points.iter_mut().zip(part.points) {
                let point = if self.blurs { *point } else { Vector2::zeros() };
                let pupil = pupil(&point);
                let origin = sharp(&point) + bend.at(&pupil);
                for (all, own) in rays.iter_mut().zip([origin.x, origin.y, pupil.x, pupil.y]) {
                    all.push(own);
                }
            }
        }
        Rays { points, width: self.width }
    }
}
