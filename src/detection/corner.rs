//! A checkerboard corner in a micro-image.

// Only what is inlined into a dispatched function is compiled for its registers.
#![allow(clippy::inline_always)]

use nalgebra::{Matrix2, Matrix4, Vector2, Vector4};
use pulp::{Arch, NullaryFnOnce};

use super::blur::Rays;
use super::lanes::products;
use super::patch::Patch;

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
    pub fn imbalance(&self, patch: &Patch, rays: &Rays) -> Option<f64> {
        let mut room = vec![0.0; 5 * patch.x.len()];
        let (normal, right) =
            Arch::new().dispatch(Quarters { corner: self, patch, rays, room: &mut room });
        let normal = Matrix4::from_fn(|a, b| normal[a.max(b)][a.min(b)]);
        let levels = normal.cholesky()?.solve(&Vector4::from(right.map(|[right]| right)));
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

/// Normal equations of the mean light, the steps across either edge, and that across both.
struct Quarters<'a> {
    corner: &'a Corner,
    patch: &'a Patch,
    rays: &'a Rays,
    /// Room for five rows.
    room: &'a mut [f32],
}

impl NullaryFnOnce for Quarters<'_> {
    type Output = ([[f32; 4]; 4], [[f32; 1]; 4]);

    #[inline(always)]
    #[allow(clippy::cast_possible_truncation)] // single precision, as the light
    fn call(self) -> Self::Output {
        let Self { corner, patch, rays, room } = self;
        let n = patch.x.len();
        let mut rows = room.chunks_exact_mut(n.max(1));
        let [ones, first, second, both, weighted] =
            std::array::from_fn(|_| rows.next().map_or(&mut [][..], |row| &mut row[..n]));
        let narrower = (1.0 / corner.width) as f32;
        let place = corner.place.map(|x| x as f32);
        let [(s1, c1), (s2, c2)] = corner.angles.map(|angle| {
            let (s, c) = angle.sin_cos();
            (s as f32, c as f32)
        });
        ones.fill(rays.points().len() as f32);
        for [origin_x, origin_y, _, _, inverse_width] in rays.points() {
            let (origin_x, origin_y) = (&origin_x[..n], &origin_y[..n]);
            let inverse_width = &inverse_width[..n];
            for i in 0..n {
                let inverse = inverse_width[i] * narrower;
                let (x, y) = ((origin_x[i] - place.x) * inverse, (origin_y[i] - place.y) * inverse);
                let (t1, t2) = (step(c1 * y - s1 * x).0, step(c2 * y - s2 * x).0);
                first[i] += t1;
                second[i] += t2;
                both[i] += t1 * t2;
            }
        }
        products([&*ones, first, second, both], [&patch.light[..n]], &patch.weight, weighted)
    }
}
