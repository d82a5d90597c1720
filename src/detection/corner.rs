//! A checkerboard corner in a micro-image.

// Only what is inlined into a dispatched function is compiled for its registers.
#![allow(clippy::inline_always)]

use nalgebra::{Matrix2, Vector1, Vector2, Vector4};

use super::blur::Rays;
use super::patch::Patch;
use crate::numerics::NormalEquations;

/// Two edges that cross: light m + h at directions between n₁ and n₂, m − h beside.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Corner {
    /// Offset from the centre of the micro-image, px.
    pub place: Vector2<f64>,
    /// Directions of the edges, rad.
    pub angles: [f64; 2],
    /// m.
    pub level: f64,
    /// h.
    pub contrast: f64,
    /// Half the width over which a step rises, over that of the rays.
    pub width: f64,
    /// Covariance of the place, px².
    pub covariance: Matrix2<f64>,
    /// Part of the variance of the light that it explains.
    pub explained: f64,
}

/// A step at a distance from it in its half widths, −1 to 1, and its slope.
#[inline(always)]
pub(super) fn step(distance: f32) -> (f32, f32) {
    let t = distance.clamp(-1.0, 1.0);
    (t * (1.5 - 0.5 * t * t), 1.5 - 1.5 * t * t)
}

impl Corner {
    /// Positive along directions to bright squares, of a size that does not depend on the contrast.
    pub fn squares(&self) -> Matrix2<f64> {
        let [a, b] = self.angles.map(|angle| Vector2::new(-angle.sin(), angle.cos()));
        (a * b.transpose() + b * a.transpose()) * self.contrast.signum()
    }

    /// How far the four quarters are from two bright and two dark ones: the steps across single edges
    /// over that across both. 0 for a corner of a checkerboard, 1 where only one quarter is dark, as at
    /// the outer corners of the board; `None` if the light does not determine it.
    #[allow(clippy::cast_possible_truncation)] // single precision, as the light
    pub fn imbalance(&self, patch: &Patch, rays: &Rays) -> Option<f64> {
        let mut equations = NormalEquations::<f32, 4, 1>::new();
        let narrower = (1.0 / self.width) as f32;
        let place = self.place.map(|x| x as f32);
        let normals = self.angles.map(|angle| [-angle.sin() as f32, angle.cos() as f32]);
        let share = 1.0 / rays.points().len() as f32;
        for i in 0..patch.x.len() {
            let mut row = Vector4::new(1.0, 0.0, 0.0, 0.0);
            for [origin_x, origin_y, _, _, inverse_width] in rays.points() {
                let inverse = inverse_width[i] * narrower;
                let (x, y) = ((origin_x[i] - place.x) * inverse, (origin_y[i] - place.y) * inverse);
                let [s, t] = normals.map(|n| step(n[0] * x + n[1] * y).0);
                row += Vector4::new(0.0, s, t, s * t) * share;
            }
            equations.add(&row, &Vector1::new(patch.light[i]), patch.weight[i]);
        }
        let levels = equations.solve()?;
        Some(f64::from(levels[1].abs().max(levels[2].abs()) / levels[3].abs()))
    }

    /// Standard deviation of the place per axis, px, the mean of both axes.
    pub fn std_dev_px(&self) -> f64 {
        (self.covariance.trace() / 2.0).max(0.0).sqrt()
    }

    /// Sine of the angle between the edges.
    pub fn opening(&self) -> f64 {
        (self.angles[0] - self.angles[1]).sin().abs()
    }
}
