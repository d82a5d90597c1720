//! How the light of a point is blurred in a micro-image.
//!
//! Light that comes through a point w of the micro-lens (a disc of radius 1) shows the board moved by
//! ρ w, and the pupil of the main lens moved by qᵢ w: pixel p sees the mean of the board at p − ρ w
//! over those w for which p − qᵢ w lies in the pupil, a disc of radius a about the centre of the
//! micro-image. Away from the centre the pupil cuts the disc of blur, and the mean moves: without that
//! a corner near the edge would seem up to ρ away from its place.

use nalgebra::{Matrix2, Vector2};

use super::patch::Patch;
use crate::vignetting::{Obliquity, Vignetting};

/// How a micro-image blurs a point.
#[derive(Debug, Clone)]
pub(super) struct Blur<'a> {
    /// ρ, px.
    rho: f64,
    /// Which part of the micro-lens the pupil leaves visible.
    vignetting: &'a Vignetting,
    /// The angles at which the light arrives.
    obliquity: Obliquity,
    /// Points of the unit disc that stand for equal shares of it.
    points: Vec<Vector2<f64>>,
    /// Half the width over which a step rises by what the points leave out: the disc between them, and a
    /// pixel, px.
    pub width: f64,
}

/// Numbers of points in rings, from the middle.
const RINGS: [u32; 3] = [1, 6, 12];

impl<'a> Blur<'a> {
    /// For a blur radius ρ, px.
    pub fn new(rho: f64, vignetting: &'a Vignetting, obliquity: Obliquity) -> Self {
        let all = f64::from(RINGS.iter().sum::<u32>());
        let mut points = Vec::new();
        let mut inside = 0;
        for count in RINGS {
            // The root mean square radius of the ring's share of the area.
            let radius = if count == 1 {
                0.0
            } else {
                ((f64::from(inside) + f64::from(count) / 2.0) / all).sqrt()
            };
            points.extend((0..count).map(|i| {
                let angle = std::f64::consts::TAU * (f64::from(i) + 0.25) / f64::from(count);
                Vector2::new(angle.cos(), angle.sin()) * radius
            }));
            inside += count;
        }
        // The mean square of a disc along an axis is a quarter; the points have less.
        let of_points = points.iter().map(|p| p.norm_squared() / 2.0).sum::<f64>() / all;
        // The step's derivative has a variance of a fifth of its half width squared.
        let width = (5.0 * (1.0 / 12.0 + rho * rho * (0.25 - of_points))).sqrt();
        Self { rho, vignetting, obliquity, points, width }
    }

    /// No blur, for steps of unknown width.
    pub fn unknown(vignetting: &'a Vignetting) -> Self {
        let obliquity = Obliquity::default();
        Self { rho: 0.0, vignetting, obliquity, points: vec![Vector2::zeros()], width: 3.0 }
    }

    /// By point of the micro-lens, where in the sharp image the light of every pixel comes from: the
    /// offset of the pixel less what the blur moves it by.
    #[allow(clippy::cast_possible_truncation)] // single precision, as the light
    pub fn origins(&self, patch: &Patch) -> Vec<[Vec<f32>; 2]> {
        let rho = self.rho;
        let (mut middle, mut squeeze) = (Vec::new(), Vec::new());
        for (&x, &y) in patch.x.iter().zip(&patch.y) {
            let offset = Vector2::new(f64::from(x), f64::from(y));
            let part = self.vignetting.at(&offset);
            // Points of the micro-lens are half a turn away from where they lie.
            let from_lens = offset + part.mean * self.obliquity.half_pitch_px;
            let mean = part.mean - self.obliquity.shift(&from_lens, &part.squeeze);
            middle.push((part.seen_at - mean * rho).map(|x| x as f32));
            squeeze.push((part.squeeze * rho).map(|x| x as f32));
        }
        let of_point = |point: &Vector2<f64>| {
            let point = point.map(|x| x as f32);
            let origin = |row: usize| {
                let of_pixel = |(m, s): (&Vector2<f32>, &Matrix2<f32>)| {
                    m[row] - s[(row, 0)] * point.x - s[(row, 1)] * point.y
                };
                middle.iter().zip(&squeeze).map(of_pixel).collect::<Vec<f32>>()
            };
            [origin(0), origin(1)]
        };
        self.points.iter().map(of_point).collect()
    }
}
