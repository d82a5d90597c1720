//! Corners fitted to the light of a micro-image.

// Only what is inlined into a dispatched function is compiled for its registers.
#![allow(clippy::inline_always)]

use nalgebra::{SMatrix, SVector, Vector2};
use pulp::{Arch, Simd, WithSimd};

use super::corner::{Corner, Edges};
use super::lanes::{Lanes, products, weighted_squares};
use super::patch::Patch;
use super::rays::{OfRays, RayLanes, Rays};
use crate::numerics::{Descent, LeastSquares};

/// What a fit is free to change.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Free {
    /// Place, levels, directions and width.
    All,
    /// Place and levels; the width is that of the blur.
    Place,
}

/// Parameters of the model: place (u, v), level, contrast, both directions and width. Those that are free
/// come first.
const ALL: usize = 7;
const PLACE: usize = 4;

/// How corners are followed down: to a third of a hundredth of a pixel, far below their uncertainty. Starts
/// are so near that few steps are needed; in single precision no finer damping makes a difference.
const DESCENT: Descent =
    Descent { steps: 12, settled: 0.003, unseen: 0.0, factor: 10.0, damping: (1e-6, 1e4) };
/// Where only place and levels are free, a last step of two hundredths of a pixel leaves some ten thousandths. (Directions and
/// width may have far to go where the place has not.)
const UNSEEN_PX: f64 = 0.02;
/// Longest step of the place, px, of a direction, rad, and of the width, px: beyond, the linear model no
/// longer describes the light.
const LONGEST_STEP_PX: f64 = 2.0;
const LONGEST_TURN_RAD: f64 = 0.3;
const LONGEST_WIDENING_PX: f64 = 1.0;
/// Half widths of steps: from that of a sharp step in pixels to that of the widest blur, px.
const WIDTHS_PX: (f64, f64) = (0.6, 8.0);
/// A corner further from the centre, px, is in no micro-image: the fit has led nowhere.
const FURTHEST_PX: f64 = 30.0;

impl Corner {
    /// Fits the corner to the light; `None` if that leads nowhere.
    pub fn fitted(
        &self,
        patch: &Patch,
        rays: &Rays,
        free: Free,
        room: &mut FitRoom,
    ) -> Option<Self> {
        match free {
            Free::All => fit::<ALL>(*self, patch, rays, room),
            Free::Place => fit::<PLACE>(Self { width: 1.0, ..*self }, patch, rays, room),
        }
    }
}

fn fit<const P: usize>(
    start: Corner,
    patch: &Patch,
    rays: &Rays,
    room: &mut FitRoom,
) -> Option<Corner> {
    let pixels = patch.x.len();
    room.trial.resize(pixels);
    room.taken.resize(pixels);
    room.weighted.resize(pixels, 0.0);
    let mut squares = Squares::<P> { patch, rays, room };
    let unseen = if P == PLACE { UNSEEN_PX } else { 0.0 };
    let (mut corner, cost) = Descent { unseen, ..DESCENT }.from(start, &mut squares)?;
    let (normal, _) = squares.normal_equations()?;
    let inverse = normal.cholesky()?.inverse();
    let variance = cost / (pixels as f64 - P as f64).max(1.0);
    corner.covariance = inverse.fixed_view::<2, 2>(0, 0).into_owned() * variance;
    corner.explained = 1.0 - cost / patch.sum_of_squares();
    let finite = corner.place.iter().all(|x| x.is_finite()) && corner.contrast.is_finite();
    finite.then_some(corner)
}

/// The weighted sum of squares of the light less that of a corner, over the first P parameters.
struct Squares<'a, const P: usize> {
    patch: &'a Patch,
    rays: &'a Rays,
    room: &'a mut FitRoom,
}

/// Room for a fit, which others may have used before.
#[derive(Default)]
pub(super) struct FitRoom {
    trial: Model,
    taken: Model,
    weighted: Vec<f32>,
}

impl<const P: usize> LeastSquares<P> for Squares<'_, P> {
    type Point = Corner;

    fn evaluate(&mut self, at: &Corner) -> Option<f64> {
        // The same operations in the widest registers that the processor has.
        let Self { room: FitRoom { trial, .. }, patch, rays } = self;
        trial.place = at.place;
        Some(Arch::new().dispatch(Evaluation::<P> { model: trial, corner: at, patch, rays }))
    }

    fn accept(&mut self) {
        std::mem::swap(&mut self.room.trial, &mut self.room.taken);
    }

    fn normal_equations(&mut self) -> Option<(SMatrix<f64, P, P>, SVector<f64, P>)> {
        let Self { room: FitRoom { taken, weighted, .. }, patch, .. } = self;
        if taken.place.norm() > FURTHEST_PX {
            return None;
        }
        let (products, right) =
            Arch::new().dispatch(Products::<P> { model: taken, weight: &patch.weight, weighted });
        let normal = SMatrix::from_fn(|a, b| f64::from(products[a.max(b)][a.min(b)]));
        Some((normal, SVector::from_fn(|a, _| f64::from(right[a][0]))))
    }

    fn moved(&self, from: &Corner, step: &SVector<f64, P>) -> Corner {
        let mut place = Vector2::new(step[0], step[1]);
        if place.norm() > LONGEST_STEP_PX {
            place *= LONGEST_STEP_PX / place.norm();
        }
        let mut next = *from;
        next.place += place;
        next.level += step[2];
        next.contrast += step[3];
        if P == ALL {
            let turn = |step: f64| step.clamp(-LONGEST_TURN_RAD, LONGEST_TURN_RAD);
            next.angles[0] += turn(step[4]);
            next.angles[1] += turn(step[5]);
            let wider = step[6].clamp(-LONGEST_WIDENING_PX, LONGEST_WIDENING_PX);
            next.width = (next.width + wider).clamp(WIDTHS_PX.0, WIDTHS_PX.1);
        }
        next
    }

    fn distance(&self, from: &Corner, to: &Corner) -> f64 {
        (to.place - from.place).norm()
    }
}

/// The model of the light and its derivatives, pixel by pixel.
#[derive(Default)]
struct Model {
    /// Place of the corner, px.
    place: Vector2<f64>,
    residual: Vec<f32>,
    /// Derivatives by the parameters.
    rows: [Vec<f32>; ALL],
}

impl Model {
    fn resize(&mut self, pixels: usize) {
        self.residual.resize(pixels, 0.0);
        for row in &mut self.rows {
            row.resize(pixels, 0.0);
        }
    }
}

/// Weighted products of the first P rows of a model with each other, in the lower triangle, and with the
/// residuals.
struct Products<'a, const P: usize> {
    model: &'a Model,
    weight: &'a [f32],
    /// Room for a row times the weights.
    weighted: &'a mut [f32],
}

impl<const P: usize> WithSimd for Products<'_, P> {
    type Output = ([[f32; P]; P], [[f32; 1]; P]);

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        let rows = std::array::from_fn(|a| self.model.rows[a].as_slice());
        products(simd, rows, [&self.model.residual], self.weight, self.weighted)
    }
}

/// One evaluation of a model.
struct Evaluation<'a, const P: usize> {
    model: &'a mut Model,
    corner: &'a Corner,
    patch: &'a Patch,
    rays: &'a Rays,
}

impl<const P: usize> WithSimd for Evaluation<'_, P> {
    type Output = f64;

    #[inline(always)]
    #[allow(clippy::cast_possible_truncation)] // single precision, as the light
    fn with_simd<S: Simd>(self, simd: S) -> f64 {
        let Self { model, corner, patch, rays } = self;
        let n = patch.x.len();
        let rows = model.rows.each_mut().map(|row| &mut row[..n]);
        let [by_u, by_v, level, shape, by_1, by_2, by_width] = rows;
        let edges = Edges::of(simd, corner);
        if P == ALL {
            let mut rows = [&mut *shape, by_u, by_v, by_1, by_2, by_width];
            rays.means(simd, &WithForm(edges), &mut rows);
        } else {
            rays.means(simd, &WithPlace(edges), &mut [&mut *shape, by_u, by_v]);
        }
        let (m, h) = (corner.level as f32, corner.contrast as f32);
        let by_width_factor = h / corner.width as f32;
        let (light, weight, residuals) =
            (&patch.light[..n], &patch.weight[..n], &mut model.residual[..n]);
        for i in 0..n {
            residuals[i] = light[i] - m - h * shape[i];
            level[i] = 1.0;
            by_u[i] *= h;
            by_v[i] *= h;
            if P == ALL {
                by_1[i] *= h;
                by_2[i] *= h;
                by_width[i] *= by_width_factor;
            }
        }
        f64::from(weighted_squares(simd, weight, residuals))
    }
}

/// The product of both steps, and how it changes with the place.
pub(super) struct WithPlace<S: Simd>(pub Edges<S>);

impl<S: Simd> OfRays<S, 3> for WithPlace<S> {
    #[inline(always)]
    fn of_rays(&self, rays: &RayLanes<S>) -> [Lanes<S>; 3] {
        let seen = self.0.seen(rays);
        let [u, v] = self.0.by_place(&seen);
        [seen.shape(), u, v]
    }
}

/// The same, and how it changes with both directions and the width.
struct WithForm<S: Simd>(Edges<S>);

impl<S: Simd> OfRays<S, 6> for WithForm<S> {
    #[inline(always)]
    fn of_rays(&self, rays: &RayLanes<S>) -> [Lanes<S>; 6] {
        let seen = self.0.seen(rays);
        let ([u, v], [first, second, width]) = (self.0.by_place(&seen), self.0.by_form(&seen));
        [seen.shape(), u, v, first, second, width]
    }
}
