//! Light of a micro-image as a sum over very many rays, in double precision: the reference for tests of [`super::Bundle`].

use nalgebra::Vector2;

use super::{Bundle, CornerEdges, Obliquity};
use crate::model::Opening;

/// Reach of the summation over the point spread, in its standard deviations.
const REACH: f64 = 4.5;

/// Micro-image behind an ideal main lens, with a cos⁴ law.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Oracle {
    /// Blur radius ρ, px.
    pub rho: f64,
    /// Blur radius q of the pupil, px.
    pub q: f64,
    /// Radius a of the pupil, px.
    pub pupil: f64,
    /// Variance of the point spread along an axis, px².
    pub point_spread_px2: f64,
    /// Part of H that the pixels add to cos⁴, px⁻².
    pub of_pixels_per_px2: f64,
    /// Opening of the micro-lens, with the direction of the normal of a side, rad.
    pub opening: Opening,
    pub normal_rad: f64,
    /// Number of sample points in a pixel along an axis.
    pub of_pixel: i32,
    /// Square root of a third of the number of sample points on the micro-lens.
    pub rings: i32,
}

pub(crate) const HALF_PITCH: f64 = 11.65;
const WITHIN: f64 = 4.0 / (59.0 * 59.0);

impl Default for Oracle {
    /// Returns the lens type of an R12 whose micro-images are most vignetted.
    fn default() -> Self {
        Self {
            rho: -3.4,
            q: -4.19,
            pupil: 6.48,
            point_spread_px2: 0.0,
            of_pixels_per_px2: 0.0,
            opening: Opening::Disc,
            normal_rad: 0.0,
            of_pixel: 8,
            rings: 11,
        }
    }
}

impl Oracle {
    /// Returns the angular response.
    pub fn law(&self) -> Obliquity {
        Obliquity {
            within_per_px2: WITHIN + self.of_pixels_per_px2,
            of_pixels_per_px2: self.of_pixels_per_px2,
            half_pitch_px: HALF_PITCH,
            ..Obliquity::default()
        }
    }

    /// Returns the bundle with the same optics.
    pub fn bundle(&self) -> Bundle {
        Bundle::new(self.rho, self.q, self.pupil, self.point_spread_px2)
            .through(self.opening, self.normal_rad)
            .oblique(&self.law())
    }

    /// Returns the white light of a pixel that sees the whole opening at normal incidence.
    pub fn whole_disc(&self) -> f64 {
        let along: f64 = self.along().iter().map(|(_, weight)| weight).sum();
        f64::from(3 * self.rings * self.rings) * along * along
    }

    /// Returns the radius of the micro-image, px.
    pub fn outer_px(&self) -> f64 {
        (self.pupil + self.q.abs()).min(HALF_PITCH)
    }

    /// Returns sample points along an axis from the middle of a pixel, px, and their weights.
    fn along(&self) -> Vec<(f64, f64)> {
        let spread = self.point_spread_px2.sqrt();
        let reach = 0.5 + REACH * spread;
        let below = |x: f64| {
            if spread > 0.0 { libm::erf(x / spread / std::f64::consts::SQRT_2) } else { x.signum() }
        };
        let all = (0..self.of_pixel)
            .map(|i| reach * ((2.0 * f64::from(i) + 1.0) / f64::from(self.of_pixel) - 1.0));
        all.map(|x| (x, below(x + 0.5) - below(x - 0.5))).collect()
    }

    /// Returns the white light of the pixel at (x, y), and for each corner the sum over rays of the product of both steps.
    pub fn of_pixel(&self, [x, y]: [f64; 2], corners: &[CornerEdges]) -> (f64, Vec<f64>) {
        let count = 3 * self.rings * self.rings;
        let on_lens = |i: i32| {
            let radius = ((f64::from(i) + 0.5) / f64::from(count)).sqrt();
            // The golden angle keeps points apart.
            let (sin, cos) = (f64::from(i) * 2.399_963_229_728_653).sin_cos();
            self.opening.of_disc(&(Vector2::new(cos, sin) * radius), self.normal_rad)
        };
        let lens: Vec<Vector2<f64>> = (0..count).map(on_lens).collect();
        let normals: Vec<[Vector2<f64>; 2]> = corners
            .iter()
            .map(|corner| corner.angles.map(|angle| Vector2::new(-angle.sin(), angle.cos())))
            .collect();
        let (along, law) = (self.along(), self.law());
        let (mut white, mut sums) = (0.0, vec![0.0; corners.len()]);
        for ((i, of_i), (j, of_j)) in along.iter().flat_map(|a| along.iter().map(move |b| (a, b))) {
            let p = Vector2::new(x + i, y + j);
            for w in lens.iter().filter(|w| (p - *w * self.q).norm() < self.pupil) {
                let light = of_i * of_j * law.light((p + w * HALF_PITCH).norm_squared());
                white += light;
                let origin = p - w * self.rho;
                for ((sum, corner), [a, b]) in sums.iter_mut().zip(corners).zip(&normals) {
                    let from = origin - corner.place;
                    *sum += light * (a.dot(&from) * b.dot(&from)).signum();
                }
            }
        }
        (white, sums)
    }

    /// Returns the positions of all pixels of the micro-image.
    pub fn pixels(&self) -> Vec<[f64; 2]> {
        let all = (0..25 * 25).map(|i| [f64::from(i % 25) - 11.79, f64::from(i / 25) - 12.37]);
        all.filter(|[x, y]| x.hypot(*y) < self.outer_px()).collect()
    }
}

/// Returns corners at a distance from the centre, px, in several directions.
pub(crate) fn corners_at(distance: f64) -> [CornerEdges; 6] {
    std::array::from_fn(|direction| {
        let turn = direction as f64 * std::f64::consts::TAU / 6.0 + 0.1;
        let place = Vector2::new(turn.cos(), turn.sin()) * distance;
        CornerEdges { place, angles: [0.3 + 1.7 * turn, 1.8 + 1.7 * turn] }
    })
}
