//! How the light of a point is blurred in a micro-image.
//!
//! Light that comes through a point w of the micro-lens (a disc of radius 1) shows the board moved by
//! ρ w, and the pupil of the main lens moved by qᵢ w: pixel p sees the mean of the board at p − ρ w
//! over those w for which p − qᵢ w lies in the pupil, a disc of radius a about the centre of the
//! micro-image. Away from the centre the pupil cuts the disc of blur, and the mean moves: without that
//! a corner near the edge would seem up to ρ away from its place.

use nalgebra::Vector2;

use super::patch::Patch;
use crate::vignetting::{Obliquity, POINTS, Vignetting, mean_square};

/// How a micro-image blurs a point.
#[derive(Debug, Clone)]
pub(super) struct Blur<'a> {
    /// ρ, px.
    rho: f64,
    /// Which part of the micro-lens the pupil leaves visible.
    vignetting: &'a Vignetting,
    /// The angles at which the light arrives.
    obliquity: Obliquity,
    /// Whether it blurs at all.
    blurs: bool,
    /// Half the width over which a step rises by what the points leave out: the disc between them, and a
    /// pixel, px.
    pub width: f64,
}

impl<'a> Blur<'a> {
    /// For a blur radius ρ, px.
    pub fn new(rho: f64, vignetting: &'a Vignetting, obliquity: Obliquity) -> Self {
        // The mean square of a disc along an axis is a quarter; the points have less.
        // The step's derivative has a variance of a fifth of its half width squared.
        let width = (5.0 * (1.0 / 12.0 + rho * rho * (0.25 - mean_square()))).sqrt();
        Self { rho, vignetting, obliquity, blurs: true, width }
    }

    /// No blur, for steps of unknown width.
    pub fn unknown(vignetting: &'a Vignetting) -> Self {
        let obliquity = Obliquity::default();
        Self { rho: 0.0, vignetting, obliquity, blurs: false, width: 3.0 }
    }

    /// By point of the micro-lens, where in the sharp image the light of every pixel comes from: the
    /// offset of the pixel less what the blur moves it by.
    #[allow(clippy::cast_possible_truncation)] // single precision, as the light
    pub fn origins(&self, patch: &Patch) -> Vec<[Vec<f32>; 2]> {
        let rho = self.rho;
        let count = if self.blurs { POINTS } else { 1 };
        let mut origins = vec![[const { Vec::new() }; 2]; count];
        for (&x, &y) in patch.x.iter().zip(&patch.y) {
            let offset = Vector2::new(f64::from(x), f64::from(y));
            let part = self.vignetting.at(&offset);
            // Points of the micro-lens are half a turn away from where they lie.
            let from_lens = offset + part.mean * self.obliquity.half_pitch_px;
            let mean = part.mean - self.obliquity.shift(&from_lens, &part.squeeze);
            let middle = (part.seen_at - mean * rho).map(|x| x as f32);
            let along = (part.outwards * rho).map(|x| x as f32);
            for (origin, point) in origins.iter_mut().zip(part.points) {
                let point = if self.blurs { *point } else { Vector2::zeros() };
                origin[0].push(middle.x - along.x * point.x + along.y * point.y);
                origin[1].push(middle.y - along.y * point.x - along.x * point.y);
            }
        }
        origins
    }
}
