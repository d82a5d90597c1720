//! How the place of a corner depends on what its fit takes for granted: the slope of its line, from which the
//! blur follows, the aberrations of the main lens, and what is taken from white images.
//!
//! A fit has ∂cost/∂place = 0. If the light of the model is moved, the place follows as by one more step of
//! Gauss and Newton: all pixels along both edges have their say, each with the rays that it receives.

// Only what is inlined into a dispatched function is compiled for its registers.
#![allow(clippy::inline_always)]

use nalgebra::{Matrix2, Matrix2x3, Matrix4, SMatrix, Vector2};
use pulp::{Arch, Simd, WithSimd};

use super::aberration::Bend;
use super::corner::{Corner, Edges, Shape, WithPlace};
use super::micro_images::STEPS;
use super::patch::Patch;
use super::rays::{OfRays, RayLanes, Rays};
use super::simd::{Lanes, dot, products};
use crate::model::TAKEN;

/// Derivatives of a place by what is taken from white images, px: see [`crate::model::TAKEN_FROM_WHITES`].
pub(super) type ByTaken = SMatrix<f64, 2, TAKEN>;

/// Derivatives of the straightened place of a corner.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Sensitivities {
    /// By the slope, px.
    pub by_slope: Vector2<f64>,
    /// By S, C and T, px³.
    pub by_aberration: Matrix2x3<f64>,
    /// By what is taken from white images; 0 where it was not asked for.
    pub by_taken: ByTaken,
}

/// What is taken for granted beside that: γ, S, C and T.
const GIVEN: usize = 4;
/// Columns: derivatives of the light by u and v, its shape, and by γ, S, C and T.
const COLUMNS: usize = 3 + GIVEN;

/// The unknowns of a fit: place (u, v), level and contrast.
const UNKNOWNS: usize = 4;

/// The sensitivities of a corner that was fitted, but for those by what is taken from white images, and the inverse of the normal
/// matrix of its fit; `None` if the light does not determine its place.
#[allow(clippy::cast_possible_truncation)] // single precision, as the light
pub(super) fn sensitivities(
    corner: &Corner,
    patch: &Patch,
    rays: &Rays,
    slope: f64,
    bend: &Bend,
) -> Option<(Sensitivities, Matrix4<f64>)> {
    let pixels = patch.x.len();
    let mut room = vec![0.0; (COLUMNS + 2) * pixels];
    let sums = Sums {
        room: &mut room,
        patch,
        corner,
        rays,
        bend: bend.in_single(),
        nearness: (slope - 1.0) as f32,
    };
    let (normal, right) = Arch::new().dispatch(sums);
    let normal = Matrix4::from_fn(|a, b| f64::from(normal[a.max(b)][a.min(b)]));
    let inverse = normal.cholesky()?.inverse();
    let derivatives =
        inverse * SMatrix::<f64, UNKNOWNS, GIVEN>::from_fn(|a, b| f64::from(right[a][b]));
    let place = derivatives.fixed_rows::<2>(0);
    derivatives.iter().all(|x| x.is_finite()).then(|| {
        let sensitivities = Sensitivities {
            by_slope: place.column(0).into_owned(),
            by_aberration: place.fixed_columns::<3>(1).into_owned(),
            by_taken: ByTaken::zeros(),
        };
        (sensitivities, inverse)
    })
}

/// What a place depends on, in the order of [`COLUMNS`], but for what is the same for all pixels.
struct Terms<S: Simd> {
    edges: Edges<S>,
    /// Of the bend.
    field: [Lanes<S>; 2],
    zone2: Lanes<S>,
}

impl<S: Simd> OfRays<S, COLUMNS> for Terms<S> {
    #[inline(always)]
    fn of_rays(&self, rays: &RayLanes<S>) -> [Lanes<S>; COLUMNS] {
        let seen = self.edges.seen(rays);
        let ([u, v], [x, y]) = (self.edges.by_place(&seen), rays.pupil);
        // The origin is w + (γ − 1) (what the point of the micro-lens and E make of it).
        let by_slope = u.mul_add(rays.origin[0] - x, v * (rays.origin[1] - y));
        // See `Bend::terms`.
        let (square, along) = (x.mul_add(x, y * y), self.field[0].mul_add(x, self.field[1] * y));
        let outwards = u.mul_add(x, v * y);
        let of_field = u.mul_add(self.field[0], v * self.field[1]);
        let by_s = outwards * (square - self.zone2);
        let by_c = outwards.mul_add(along + along, of_field * square);
        [u, v, seen.shape(), by_slope, by_s, by_c, of_field * along]
    }
}

/// Normal equations of the unknowns, with the changes of the light by γ, S, C and T on their right.
struct Sums<'a> {
    /// Room for [`COLUMNS`] and two more rows.
    room: &'a mut [f32],
    patch: &'a Patch,
    corner: &'a Corner,
    rays: &'a Rays,
    bend: Bend<f32>,
    /// γ − 1.
    nearness: f32,
}

impl WithSimd for Sums<'_> {
    type Output = ([[f32; UNKNOWNS]; UNKNOWNS], [[f32; GIVEN]; UNKNOWNS]);

    #[inline(always)]
    #[allow(clippy::cast_possible_truncation)] // single precision, as the light
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        let Self { room, patch, corner, rays, bend, nearness } = self;
        let n = patch.x.len();
        let mut rows = room.chunks_exact_mut(n.max(1));
        let mut row = || rows.next().map_or(&mut [][..], |row| &mut row[..n]);
        let (ones, weighted) = (row(), row());
        let mut columns: [&mut [f32]; COLUMNS] = std::array::from_fn(|_| row());
        let terms = Terms {
            edges: Edges::of(simd, corner),
            field: [Lanes::splat(simd, bend.field.x), Lanes::splat(simd, bend.field.y)],
            zone2: Lanes::splat(simd, bend.zone2),
        };
        rays.means(simd, &terms, &mut columns);
        let h = corner.contrast as f32;
        let mut factors = [h * nearness; COLUMNS];
        factors[..4].copy_from_slice(&[h, h, 1.0, h / nearness]);
        for (column, factor) in columns.iter_mut().zip(factors) {
            for x in column.iter_mut() {
                *x *= factor;
            }
        }
        ones.fill(1.0);
        let [by_u, by_v, shape, given @ ..] = &columns;
        products(
            simd,
            [&**by_u, &**by_v, ones, &**shape],
            given.each_ref().map(|given| &**given),
            &patch.weight,
            weighted,
        )
    }
}

/// How much information of all pixels the few are held by, over their own: see [`place_by_few`].
const HOLD: f64 = 0.3;

/// Those of a few pixels of a corner that see an edge of it: what else is taken from white images makes no difference to the
/// others.
#[derive(Default)]
pub(super) struct OnEdges {
    /// The pixels.
    pub patch: Patch,
    /// Derivatives of their light by the place, 1, and the shape that they see.
    rows: [Vec<f32>; UNKNOWNS],
    /// Normal matrix of all of the few.
    normal: [[f32; UNKNOWNS]; UNKNOWNS],
    room: Vec<f32>,
}

impl OnEdges {
    /// Puts the pixels of a corner in the place of those of another.
    pub fn find(&mut self, corner: &Corner, few: &Patch, rays: &Rays) {
        let n = few.x.len();
        for row in &mut self.rows {
            row.resize(n, 0.0);
        }
        self.room.resize(n, 0.0);
        let Self { rows, room, .. } = self;
        self.normal = Arch::new().dispatch(OfFew { rows, weighted: room, few, corner, rays });
        self.patch.clone_from(few);
        let [by_u, by_v, ..] = &self.rows;
        let sees = |(u, v): (&f32, &f32)| u8::from(*u != 0.0 || *v != 0.0);
        let marks: Vec<u8> = by_u.iter().zip(by_v).map(sees).collect();
        self.patch.keep(&marks);
        for row in &mut self.rows {
            let mut kept = 0;
            for (i, mark) in marks.iter().enumerate() {
                row[kept] = row[i];
                kept += usize::from(*mark);
            }
            row.truncate(kept);
        }
    }

    /// How the place changes with what is taken from white images, px: `others` are the rays of the pixels on edges if that is
    /// larger by [`STEPS`]. Few pixels may not determine the place, so `inverse` is that of all that were fitted, of which the
    /// few are the part `share`.
    #[allow(clippy::cast_possible_truncation)] // single precision, as the light
    pub fn by_taken(
        &mut self,
        corner: &Corner,
        others: &[Rays; TAKEN],
        inverse: &Matrix4<f64>,
        share: f64,
    ) -> ByTaken {
        let Self { patch, rows, room, normal } = self;
        room.resize(patch.x.len(), 0.0);
        let right = Arch::new().dispatch(Changes { rows, change: room, patch, corner, others });
        let normal = Matrix4::from_fn(|a, b| f64::from(normal[a.max(b)][a.min(b)]));
        let right = SMatrix::from_fn(|a, b| f64::from(right[a][b]) / STEPS[b]);
        place_by_few(&normal, &right, inverse, share)
    }
}

/// Normal equations of the unknowns.
struct OfFew<'a> {
    rows: &'a mut [Vec<f32>; UNKNOWNS],
    weighted: &'a mut [f32],
    few: &'a Patch,
    corner: &'a Corner,
    rays: &'a Rays,
}

impl WithSimd for OfFew<'_> {
    type Output = [[f32; UNKNOWNS]; UNKNOWNS];

    #[inline(always)]
    #[allow(clippy::cast_possible_truncation)] // single precision, as the light
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        let Self { rows, weighted, few, corner, rays } = self;
        let n = few.x.len();
        let [by_u, by_v, ones, shape] = rows.each_mut().map(|row| &mut row[..n]);
        let mut all = [&mut *shape, &mut *by_u, &mut *by_v];
        rays.means(simd, &WithPlace(Edges::of(simd, corner)), &mut all);
        let h = corner.contrast as f32;
        for i in 0..n {
            by_u[i] *= h;
            by_v[i] *= h;
        }
        ones.fill(1.0);
        products(simd, [&*by_u, by_v, ones, shape], [], &few.weight, weighted).0
    }
}

/// The changes of the light by what is taken from white images, times the unknowns.
struct Changes<'a> {
    rows: &'a [Vec<f32>; UNKNOWNS],
    change: &'a mut [f32],
    patch: &'a Patch,
    corner: &'a Corner,
    others: &'a [Rays; TAKEN],
}

impl WithSimd for Changes<'_> {
    type Output = [[f32; TAKEN]; UNKNOWNS];

    #[inline(always)]
    #[allow(clippy::cast_possible_truncation)] // single precision, as the light
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        let Self { rows, change, patch, corner, others } = self;
        let n = patch.x.len();
        let (h, of_shape) = (corner.contrast as f32, Shape(Edges::of(simd, corner)));
        let (shape, weight) = (&rows[3][..n], &patch.weight[..n]);
        let mut right = [[0.0; TAKEN]; UNKNOWNS];
        for (k, other) in others.iter().enumerate() {
            other.means(simd, &of_shape, &mut [&mut *change]);
            // The corner moves to where it makes up for the change.
            for i in 0..n {
                change[i] = (shape[i] - change[i]) * h * weight[i];
            }
            for (right, row) in right.iter_mut().zip(rows) {
                right[k] = dot(simd, row, change);
            }
        }
        right
    }
}

/// The place by the normal equations of a few pixels, whose unknowns are place, level and contrast. They may not determine it:
/// then it is held to 0 by a part of the information of all pixels that were fitted. `inverse` is that of their normal matrix,
/// and `share` the part of them that the few are, by weight.
pub(super) fn place_by_few<const Q: usize>(
    normal: &Matrix4<f64>,
    right: &SMatrix<f64, UNKNOWNS, Q>,
    inverse: &Matrix4<f64>,
    share: f64,
) -> SMatrix<f64, 2, Q> {
    // Level and contrast make up for what they can.
    let levels = normal.fixed_view::<2, 2>(2, 2).into_owned();
    let mixed = normal.fixed_view::<2, 2>(0, 2);
    let made_up = levels.cholesky().map_or_else(Matrix2::zeros, |c| c.inverse());
    let follow = mixed * made_up;
    let information = normal.fixed_view::<2, 2>(0, 0) - follow * mixed.transpose();
    let left = right.fixed_rows::<2>(0) - follow * right.fixed_rows::<2>(2);
    let place = inverse.fixed_view::<2, 2>(0, 0).into_owned();
    let of_all = place.cholesky().map_or_else(Matrix2::zeros, |c| c.inverse()) * share;
    // Where the few are like all, this makes no difference.
    let held = (information + of_all * HOLD) / (1.0 + HOLD);
    held.cholesky().map_or_else(SMatrix::zeros, |c| c.solve(&left))
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::aberration::Aberration;
    use super::super::blur::Blur;
    use super::super::corner::{FitRoom, Free};
    use super::super::micro_images::tests::micro_images;
    use super::*;

    pub const SLOPE: f64 = 0.75;

    pub fn corner(place: Vector2<f64>) -> Corner {
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

    /// The pixels of a micro-image, without light.
    pub fn disc(radius: i16) -> Patch {
        let mut patch = Patch::default();
        let places = (-radius..=radius).flat_map(|y| (-radius..=radius).map(move |x| (x, y)));
        for (x, y) in places.map(|(x, y)| (f32::from(x), f32::from(y))) {
            if x * x + y * y < f32::from(radius).powi(2) {
                patch.x.push(x + 0.3);
                patch.y.push(y - 0.2);
                patch.light.push(0.0);
                patch.weight.push(1.0);
            }
        }
        patch
    }

    /// The light of a corner in a micro-image with these rays.
    #[allow(clippy::cast_possible_truncation)] // single precision, as the light
    fn light(patch: &mut Patch, corner: &Corner, rays: &Rays) {
        for (light, shape) in patch.light.iter_mut().zip(corner.shape(rays)) {
            *light = (corner.level + corner.contrast * f64::from(shape)) as f32;
        }
    }

    /// The place follows what is taken for granted, as fits with other values show.
    #[test]
    fn sensitivities_are_the_changes_of_fits() {
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
        let mut patch = disc(10);
        let (known, bend) = rays(SLOPE, [0.0; 3], &patch);
        let truth = corner(place);
        light(&mut patch, &truth, &known);
        let (sensitivities, inverse) = sensitivities(&truth, &patch, &known, SLOPE, &bend).unwrap();
        let place_with = |slope: f64, coefficients: [f64; 3]| {
            let (rays, _) = rays(slope, coefficients, &patch);
            truth.fitted(&patch, &rays, Free::Place, &mut FitRoom::default()).unwrap().place
        };
        assert!((place_with(SLOPE, [0.0; 3]) - place).norm() < 2e-3);
        let close = |change: Vector2<f64>, sensitivity: Vector2<f64>, step: f64| {
            let expected = sensitivity * step;
            assert!(
                (change - expected).norm() < 0.15 * expected.norm() + 3e-3,
                "{change} {expected}"
            );
        };
        let by_slope = place_with(SLOPE + 0.01, [0.0; 3]) - place_with(SLOPE - 0.01, [0.0; 3]);
        close(by_slope, sensitivities.by_slope, 0.02);
        for i in 0..3 {
            let sensitivity = sensitivities.by_aberration.column(i).into_owned();
            // That moves the place by a fiftieth of a pixel.
            let step = 0.02 / sensitivity.norm();
            let with = |sign: f64| {
                let mut coefficients = [0.0; 3];
                coefficients[i] = sign * step;
                place_with(SLOPE, coefficients)
            };
            close(with(1.0) - with(-1.0), sensitivity, 2.0 * step);
        }
        let others = |patch: &Patch| -> [Rays; TAKEN] {
            std::array::from_fn(|taken| {
                let (optics, vignetting) = micro_images.otherwise(&optics, taken);
                Blur::new(&optics, SLOPE, bend, vignetting).rays(patch)
            })
        };
        let mut on_edges = OnEdges::default();
        on_edges.find(&truth, &patch, &known);
        let by_taken = on_edges.by_taken(&truth, &others(&on_edges.patch), &inverse, 1.0);
        for ((other, sensitivity), step) in
            others(&patch).iter().zip(by_taken.column_iter()).zip(STEPS)
        {
            let moved =
                truth.fitted(&patch, other, Free::Place, &mut FitRoom::default()).unwrap().place
                    - place;
            close(moved, sensitivity.into_owned(), step);
        }
        assert!(by_taken.column(0).norm() > 0.5, "{by_taken}");
    }

    /// Along an edge that the few pixels do not see they say nothing of the place; what level and contrast make up for does not
    /// move it.
    #[test]
    fn few_pixels_make_no_large_sensitivities() {
        let few = Matrix4::from_diagonal(&[1.0, 1e-6, 1.0, 1.0].into());
        let right = SMatrix::<f64, UNKNOWNS, 1>::new(0.1, 0.01, 0.0, 0.0);
        let place = place_by_few(&few, &right, &Matrix4::identity(), 1.0);
        assert!((place[0] - 0.1).abs() < 1e-9 && place[1].abs() < 0.05, "{place}");
        // Pixels on one side of the corner: darker light there is a lower level.
        let mut aside = Matrix4::identity();
        (aside[(0, 2)], aside[(2, 0)]) = (0.5, 0.5);
        let darker = aside.column(2).into_owned();
        assert!(place_by_few(&aside, &darker, &Matrix4::identity(), 1.0).norm() < 1e-12);
    }

    /// All fifths of the pixels together say what all pixels do.
    #[test]
    fn a_fifth_of_the_pixels_shows_the_sensitivities() {
        let micro_images = micro_images(23.0);
        let optics = micro_images.optics(1, 1);
        let rays = |patch: &Patch, taken: Option<usize>| {
            let (optics, vignetting) = taken.map_or_else(
                || (optics, micro_images.vignetting(&optics)),
                |taken| micro_images.otherwise(&optics, taken),
            );
            Blur::new(&optics, SLOPE, Bend::none(), vignetting).rays(patch)
        };
        let patch = disc(10);
        let weights = patch.sum_of_weights();
        for place in [Vector2::new(4.0, -2.5), Vector2::new(-4.5, 3.5), Vector2::new(0.5, 0.2)] {
            let truth = corner(place);
            let (_, inverse) =
                sensitivities(&truth, &patch, &rays(&patch, None), SLOPE, &Bend::none()).unwrap();
            let by = |few: &Patch| {
                let mut on_edges = OnEdges::default();
                on_edges.find(&truth, few, &rays(few, None));
                let others = std::array::from_fn(|taken| rays(&on_edges.patch, Some(taken)));
                let share = few.sum_of_weights() / weights;
                on_edges.by_taken(&truth, &others, &inverse, share)
            };
            let all = by(&patch);
            let mut mean = ByTaken::zeros();
            for first in 0..5 {
                let mut fifth = patch.clone();
                let marks: Vec<u8> = (0..patch.x.len()).map(|i| u8::from(i % 5 == first)).collect();
                fifth.keep(&marks);
                let fifth = by(&fifth);
                assert!((fifth - all).norm() < 0.7 * all.norm(), "{fifth} for {all}");
                mean += fifth / 5.0;
            }
            assert!((mean - all).norm() < 0.15 * all.norm(), "{mean} for {all}");
        }
    }
}
