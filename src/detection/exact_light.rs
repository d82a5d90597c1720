//! Light of corners summed over very many points, for tests.

use nalgebra::{Matrix2, Vector2};

use super::aberration::Bend;
use super::blur::Blur;
use super::corner::Corner;
use super::patch::{Patch, USABLE, weight};
use crate::vignetting::{Obliquity, Pixel, Vignetting};

/// Number of directions from the centre in which corners lie.
pub(super) const DIRECTIONS: usize = 6;
/// How far the places reach over which a point spread is summed, in its standard deviations.
const REACH: f64 = 4.5;

/// The light of a micro-image behind an ideal main lens, with cos⁴.
pub(super) struct ExactLight {
    /// ρ, px.
    pub rho: f64,
    /// qᵢ, px.
    pub q: f64,
    /// a, px.
    pub pupil: f64,
    /// Variance of the point spread along an axis, px².
    pub point_spread_px2: f64,
    /// What pixels add to cos⁴, px⁻².
    pub of_pixels_per_px2: f64,
    /// Number of places in a pixel along an axis.
    pub of_pixel: i32,
    /// Its square times three is the number of points of the micro-lens.
    pub rings: i32,
}

const HALF_PITCH: f64 = 11.65;
const WITHIN: f64 = 4.0 / (59.0 * 59.0);

impl Default for ExactLight {
    /// The lens of an R12 whose micro-images are most vignetted.
    fn default() -> Self {
        Self {
            rho: -3.4,
            q: -4.19,
            pupil: 6.48,
            point_spread_px2: 0.0,
            of_pixels_per_px2: 0.0,
            of_pixel: 3,
            rings: 18,
        }
    }
}

impl ExactLight {
    /// Its vignetting.
    pub fn vignetting(&self) -> Vignetting {
        Vignetting::new(self.pupil, self.q, &Pixel::new(self.point_spread_px2))
    }

    fn obliquity(&self) -> Obliquity {
        Obliquity {
            within_per_px2: WITHIN + self.of_pixels_per_px2,
            of_pixels_per_px2: self.of_pixels_per_px2,
            half_pitch_px: HALF_PITCH,
            ..Obliquity::default()
        }
    }

    /// Its blur.
    pub fn blur<'a>(&self, vignetting: &'a Vignetting) -> Blur<'a> {
        Blur {
            rho: self.rho,
            q: self.q,
            pupil: self.pupil,
            bend: Bend::none(),
            vignetting,
            obliquity: self.obliquity(),
            wider_px2: 0.0,
        }
    }

    /// Places from the middle of a pixel along an axis, px, and their weights.
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

    /// Weight and origin, p − ρ w, of the light of the pixel at (x, y).
    pub fn of_pixel(&self, [x, y]: [f64; 2]) -> Vec<(f64, Vector2<f64>)> {
        let count = 3 * self.rings * self.rings;
        let on_lens = |i: i32| {
            let radius = ((f64::from(i) + 0.5) / f64::from(count)).sqrt();
            // By the golden angle no two points are side by side.
            let (sin, cos) = (f64::from(i) * 2.399_963_229_728_653).sin_cos();
            Vector2::new(cos, sin) * radius
        };
        let lens: Vec<Vector2<f64>> = (0..count).map(on_lens).collect();
        let (along, law) = (self.along(), self.obliquity());
        let places = along.iter().flat_map(|a| along.iter().map(move |b| (a, b)));
        let light = places.flat_map(|((i, of_i), (j, of_j))| {
            let p = Vector2::new(x + i, y + j);
            let seen = lens.iter().filter(move |w| (p - *w * self.q).norm() < self.pupil);
            let law = &law;
            seen.map(move |w| {
                let oblique = (p + w * HALF_PITCH).norm_squared();
                (of_i * of_j * law.light(oblique), p - w * self.rho)
            })
        });
        light.collect()
    }

    /// Corners at a distance from the centre, px, and their patches.
    #[allow(clippy::cast_possible_truncation)] // single precision, as the light
    pub fn corners(&self, distance: f64) -> [(Corner, Patch); DIRECTIONS] {
        let outer = (self.pupil + self.q.abs()).min(HALF_PITCH);
        let sum = |light: &[(f64, Vector2<f64>)]| light.iter().map(|(weight, _)| weight).sum();
        let brightest: f64 = sum(&self.of_pixel([0.0; 2]));
        std::array::from_fn(|direction| {
            let turn = direction as f64 * std::f64::consts::TAU / DIRECTIONS as f64 + 0.1;
            let place = Vector2::new(turn.cos(), turn.sin()) * distance;
            let corner = Corner {
                place,
                angles: [0.3 + 1.7 * turn, 1.8 + 1.7 * turn],
                level: 0.5,
                contrast: 0.4,
                width: 1.0,
                covariance: Matrix2::zeros(),
                explained: 0.0,
            };
            let [a, b] = corner.angles.map(|angle| Vector2::new(-angle.sin(), angle.cos()));
            let mut patch = Patch::default();
            for i in 0..25 * 25 {
                let (x, y) = (f64::from(i % 25) - 11.79, f64::from(i / 25) - 12.37);
                if x.hypot(y) > outer {
                    continue;
                }
                let light = self.of_pixel([x, y]);
                let white: f64 = sum(&light);
                let part = (white / brightest) as f32;
                if part < USABLE {
                    continue;
                }
                let side = |o: &Vector2<f64>| (a.dot(&(o - place)) * b.dot(&(o - place))).signum();
                let board: f64 = light.iter().map(|(weight, o)| weight * side(o)).sum();
                patch.x.push(x as f32);
                patch.y.push(y as f32);
                patch.light.push((0.5 + 0.4 * board / white) as f32);
                patch.weight.push(weight(part));
            }
            (corner, patch)
        })
    }
}
