//! How the place of a corner depends on what is taken from white images, by a few of its pixels: that is summed over all
//! corners.

// Only what is inlined into a dispatched function is compiled for its registers.
#![allow(clippy::inline_always)]

use nalgebra::{Matrix2, Matrix4, SMatrix};
use pulp::{Arch, Simd, WithSimd};

use super::corner::{Corner, Edges};
use super::corner_fit::WithPlace;
use super::lanes::{dot, products};
use super::levers::{ByTaken, STEPS, Shape, UNKNOWNS};
use super::patch::Patch;
use super::rays::Rays;
use crate::model::TAKEN;

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
mod tests {
    use nalgebra::Vector2;

    use super::super::aberration::Bend;
    use super::super::blur::Blur;
    use super::super::levers::tests::{SLOPE, corner, disc};
    use super::super::patch::tests::micro_images;
    use super::*;

    /// Along an edge that the few pixels do not see they say nothing of the place; what level and contrast make up for does not
    /// move it.
    #[test]
    fn few_pixels_make_no_large_levers() {
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
    fn a_fifth_of_the_pixels_shows_the_levers() {
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
                truth.levers(&patch, &rays(&patch, None), SLOPE, &Bend::none()).unwrap();
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
