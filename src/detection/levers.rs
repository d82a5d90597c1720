//! How the place of a corner depends on what its fit takes for granted: the slope of its line, from which the
//! blur follows, and the aberrations of the main lens.
//!
//! A fit has ∂cost/∂place = 0. If the light of the model is moved, the place follows as by one more step of
//! Gauss and Newton: all pixels along both edges have their say, each with the rays that it receives.

// Only what is inlined into a dispatched function is compiled for its registers.
#![allow(clippy::inline_always)]

use nalgebra::{Matrix2x3, SMatrix, Vector2, Vector4};
use pulp::{Arch, NullaryFnOnce};

use super::aberration::Bend;
use super::blur::Rays;
use super::corner::{Corner, step};
use super::micro_images::OTHERWISE;
use super::patch::Patch;
use crate::model::TAKEN;
use crate::numerics::NormalEquations;

/// Derivatives of a place by what is taken from white images, px: see [`crate::model::TAKEN_FROM_WHITES`].
pub(super) type ByTaken = SMatrix<f64, 2, TAKEN>;

/// Derivatives of the straightened place of a corner.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Levers {
    /// By the slope, px.
    pub by_slope: Vector2<f64>,
    /// By S, C and T, px³.
    pub by_aberration: Matrix2x3<f64>,
    /// By what is taken from white images; 0 where it was not asked for.
    pub by_taken: ByTaken,
}

/// By how much what is taken from white images is changed, by its index: the part [`OTHERWISE`] of it, and the variance of the
/// point spread, which may be 0, by px².
pub(super) const STEPS: [f64; TAKEN] = [OTHERWISE, OTHERWISE, OTHERWISE, OTHERWISE, 0.02];

/// What is taken for granted: γ, S, C and T, and what is taken from white images.
const GIVEN: usize = 4 + TAKEN;
/// Columns: derivatives of the light by u and v, its shape, and by γ, S, C and T.
const COLUMNS: usize = 7;

impl Corner {
    /// The levers of a corner that was fitted; `None` if the light does not determine its place. `others` are its
    /// rays if what is taken from white images is larger by [`STEPS`], or none.
    #[allow(clippy::cast_possible_truncation)] // single precision, as the light
    pub fn levers(
        &self,
        patch: &Patch,
        rays: &Rays,
        slope: f64,
        bend: &Bend,
        others: &[Rays],
    ) -> Option<Levers> {
        let pixels = patch.x.len();
        let mut columns = [const { Vec::new() }; COLUMNS].map(|_: Vec<f32>| vec![0.0; pixels]);
        let bend = bend.in_single();
        let nearness = (slope - 1.0) as f32;
        Arch::new().dispatch(Sums { columns: &mut columns, corner: self, rays, bend, nearness });
        let share = 1.0 / rays.points().len() as f32;
        let per_point = self.contrast as f32 * share;
        let shapes: Vec<Vec<f32>> = others.iter().map(|rays| self.shape(pixels, rays)).collect();
        let [by_u, by_v, shape, given @ ..] = &columns;
        let mut equations = NormalEquations::<f32, 4, GIVEN>::new();
        for i in 0..pixels {
            let row = Vector4::new(by_u[i] * per_point, by_v[i] * per_point, 1.0, shape[i] * share);
            let moved =
                SMatrix::<f32, 1, GIVEN>::from_fn(|_, k| match k.checked_sub(given.len()) {
                    None => given[k][i] * per_point,
                    Some(k) => shapes
                        .get(k)
                        .map_or(0.0, |other| (shape[i] - other[i]) * per_point / STEPS[k] as f32),
                });
            equations.add(&row, &moved, patch.weight[i]);
        }
        let levers = equations.solve()?.map(f64::from);
        let place = levers.fixed_rows::<2>(0);
        levers.iter().all(|x| x.is_finite()).then(|| Levers {
            by_slope: place.column(0).into_owned(),
            by_aberration: place.fixed_columns::<3>(1).into_owned(),
            by_taken: place.fixed_columns::<TAKEN>(4).into_owned(),
        })
    }

    /// The sum of the shapes of all rays, pixel by pixel.
    pub fn shape(&self, pixels: usize, rays: &Rays) -> Vec<f32> {
        let mut shape = vec![0.0; pixels];
        Arch::new().dispatch(Shape { shape: &mut shape, corner: self, rays });
        shape
    }
}

/// See [`Corner::shape`].
struct Shape<'a> {
    shape: &'a mut [f32],
    corner: &'a Corner,
    rays: &'a Rays,
}

impl NullaryFnOnce for Shape<'_> {
    type Output = ();

    #[inline(always)]
    #[allow(clippy::cast_possible_truncation)] // single precision, as the light
    fn call(self) {
        let Self { shape, corner, rays } = self;
        let (n, narrower) = (shape.len(), (1.0 / corner.width) as f32);
        let place = corner.place.map(|x| x as f32);
        let [(s1, c1), (s2, c2)] = corner.angles.map(|angle| {
            let (s, c) = angle.sin_cos();
            (s as f32, c as f32)
        });
        for [origin_x, origin_y, _, _, inverse_width] in rays.points() {
            let (origin_x, origin_y) = (&origin_x[..n], &origin_y[..n]);
            let inverse_width = &inverse_width[..n];
            for i in 0..n {
                let inverse = inverse_width[i] * narrower;
                let (x, y) = ((origin_x[i] - place.x) * inverse, (origin_y[i] - place.y) * inverse);
                shape[i] += step(c1 * y - s1 * x).0 * step(c2 * y - s2 * x).0;
            }
        }
    }
}

/// The sums over points of the micro-lens, pixel by pixel.
struct Sums<'a> {
    columns: &'a mut [Vec<f32>; COLUMNS],
    corner: &'a Corner,
    rays: &'a Rays,
    bend: Bend<f32>,
    /// γ − 1.
    nearness: f32,
}

impl NullaryFnOnce for Sums<'_> {
    type Output = ();

    #[inline(always)]
    #[allow(clippy::cast_possible_truncation)] // single precision, as the light
    fn call(self) {
        let Self { columns, corner, rays, bend, nearness } = self;
        let n = columns[0].len();
        let narrower = (1.0 / corner.width) as f32;
        let place = corner.place.map(|x| x as f32);
        let [(s1, c1), (s2, c2)] = corner.angles.map(|angle| {
            let (s, c) = angle.sin_cos();
            (s as f32, c as f32)
        });
        let columns = columns.each_mut().map(|column| &mut column[..n]);
        let [by_u, by_v, shape, by_slope, by_s, by_c, by_t] = columns;
        for [origin_x, origin_y, pupil_x, pupil_y, inverse_width] in rays.points() {
            let (origin_x, origin_y) = (&origin_x[..n], &origin_y[..n]);
            let (pupil_x, pupil_y) = (&pupil_x[..n], &pupil_y[..n]);
            let inverse_width = &inverse_width[..n];
            for i in 0..n {
                let inverse = inverse_width[i] * narrower;
                let (x, y) = ((origin_x[i] - place.x) * inverse, (origin_y[i] - place.y) * inverse);
                let ((t1, e1), (t2, e2)) = (step(c1 * y - s1 * x), step(c2 * y - s2 * x));
                let (g1, g2) = (e1 * t2, t1 * e2);
                let u = (g1 * s1 + g2 * s2) * inverse;
                let v = -(g1 * c1 + g2 * c2) * inverse;
                by_u[i] += u;
                by_v[i] += v;
                shape[i] += t1 * t2;
                let pupil = Vector2::new(pupil_x[i], pupil_y[i]);
                // The origin is w + (γ − 1) (what the point of the micro-lens and E make of it).
                let (along_x, along_y) = (origin_x[i] - pupil.x, origin_y[i] - pupil.y);
                by_slope[i] += (u * along_x + v * along_y) / nearness;
                let terms = bend.terms(&pupil);
                by_s[i] += (u * terms[(0, 0)] + v * terms[(1, 0)]) * nearness;
                by_c[i] += (u * terms[(0, 1)] + v * terms[(1, 1)]) * nearness;
                by_t[i] += (u * terms[(0, 2)] + v * terms[(1, 2)]) * nearness;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix2;

    use super::super::aberration::Aberration;
    use super::super::blur::Blur;
    use super::super::corner_fit::Free;
    use super::super::patch::tests::micro_images;
    use super::*;

    const SLOPE: f64 = 0.75;

    fn corner(place: Vector2<f64>) -> Corner {
        Corner {
            place,
            angles: [0.2, 1.6],
            level: 0.5,
            contrast: 0.4,
            width: 1.0,
            covariance: Matrix2::zeros(),
            explained: 0.0,
        }
    }

    /// The light of a corner in a micro-image with these rays.
    #[allow(clippy::cast_possible_truncation)] // single precision, as the light
    fn light(patch: &mut Patch, corner: &Corner, rays: &Rays) {
        for i in 0..patch.x.len() {
            let of_point = |point: [&[f32]; 5]| {
                let step = |distance: f64| f64::from(step(distance as f32 * point[4][i]).0);
                let from =
                    Vector2::new(f64::from(point[0][i]), f64::from(point[1][i])) - corner.place;
                let [a, b] =
                    corner.angles.map(|angle| step(angle.cos() * from.y - angle.sin() * from.x));
                a * b
            };
            let mean = rays.points().map(of_point).sum::<f64>() / rays.points().len() as f64;
            patch.light[i] = (corner.level + corner.contrast * mean) as f32;
        }
    }

    /// The place follows what is taken for granted, as fits with other values show.
    #[test]
    fn levers_are_the_changes_of_fits() {
        let micro_images = micro_images(23.0);
        let optics = micro_images.optics(1, 1);
        let vignetting = micro_images.vignetting(&optics);
        // Far off the middle of the image, where all three aberrations show.
        let center = Vector2::new(400.0, -300.0);
        let place = Vector2::new(4.0, -2.5);
        let rays = |slope: f64, coefficients: [f64; 3], patch: &Patch| {
            let none = Aberration::none(Vector2::zeros(), optics.pupil_px);
            let bend = none.changed(&coefficients.into()).bend(&center, slope);
            (Blur::new(&optics, slope, bend, vignetting).rays(patch), bend)
        };
        let mut patch = Patch::default();
        for (x, y) in (-10..=10).flat_map(|y| (-10..=10).map(move |x| (x as f32, y as f32))) {
            if x * x + y * y < 100.0 {
                patch.x.push(x + 0.3);
                patch.y.push(y - 0.2);
                patch.light.push(0.0);
                patch.weight.push(1.0);
            }
        }
        let (known, bend) = rays(SLOPE, [0.0; 3], &patch);
        let truth = corner(place);
        light(&mut patch, &truth, &known);
        let levers = truth.levers(&patch, &known, SLOPE, &bend, &[]).unwrap();
        let place_with = |slope: f64, coefficients: [f64; 3]| {
            let (rays, _) = rays(slope, coefficients, &patch);
            truth.fitted(&patch, &rays, Free::Place).unwrap().place
        };
        assert!((place_with(SLOPE, [0.0; 3]) - place).norm() < 2e-3);
        let close = |change: Vector2<f64>, lever: Vector2<f64>, step: f64| {
            let expected = lever * step;
            assert!(
                (change - expected).norm() < 0.15 * expected.norm() + 3e-3,
                "{change} {expected}"
            );
        };
        let by_slope = place_with(SLOPE + 0.01, [0.0; 3]) - place_with(SLOPE - 0.01, [0.0; 3]);
        close(by_slope, levers.by_slope, 0.02);
        for i in 0..3 {
            let lever = levers.by_aberration.column(i).into_owned();
            // That moves the place by a fiftieth of a pixel.
            let step = 0.02 / lever.norm();
            let with = |sign: f64| {
                let mut coefficients = [0.0; 3];
                coefficients[i] = sign * step;
                place_with(SLOPE, coefficients)
            };
            close(with(1.0) - with(-1.0), lever, 2.0 * step);
        }
        let others: [Rays; TAKEN] = std::array::from_fn(|taken| {
            let (optics, vignetting) = micro_images.otherwise(&optics, taken);
            Blur::new(&optics, SLOPE, bend, vignetting).rays(&patch)
        });
        let by_taken = truth.levers(&patch, &known, SLOPE, &bend, &others).unwrap().by_taken;
        for ((other, lever), step) in others.iter().zip(by_taken.column_iter()).zip(STEPS) {
            let moved = truth.fitted(&patch, other, Free::Place).unwrap().place - place;
            close(moved, lever.into_owned(), step);
        }
        assert!(by_taken.column(0).norm() > 0.5, "{by_taken}");
    }
}
