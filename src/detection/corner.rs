//! Model of the light of a checkerboard corner in a single micro-image, with edges of one unknown width, and its fit. The blur
//! is not known yet.

// Only functions inlined into a dispatched function are compiled for its registers.
#![allow(clippy::inline_always)]

use nalgebra::{Matrix2, Matrix4, SMatrix, SVector, Vector2, Vector4};
use pulp::{Arch, Simd, WithSimd};

use super::patch::Patch;
use crate::numerics::simd::{Lanes, products, weighted_squares};
use crate::numerics::{Descent, LeastSquares};

/// Two crossing edges with the normals n₁ and n₂: light m + h between n₁ and n₂ and opposite, m − h elsewhere.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Corner {
    /// Offset from the centre of the micro-image, px.
    pub place: Vector2<f64>,
    /// Directions of the edges, rad.
    pub angles: [f64; 2],
    /// Mean light m.
    pub level: f64,
    /// Contrast h.
    pub contrast: f64,
    /// Half the width over which a step rises, px.
    pub width: f64,
    /// Covariance of the position, px².
    pub covariance: Matrix2<f64>,
    /// Part of the variance of the light that the corner explains.
    pub explained: f64,
}

/// Number of parameters: position (u, v), level, contrast, both directions and width.
const PARAMETERS: usize = 7;

/// Settings of the fit, which ends at a third of a hundredth of a pixel, far below the uncertainty of corners. Starts are so
/// near that few steps are needed; in single precision no finer damping makes a difference.
const DESCENT: Descent =
    Descent { steps: 12, settled: 0.003, unseen: 0.0, factor: 10.0, damping: (1e-6, 1e4) };
/// Longest steps: of the position, px, of a direction, rad, and of the width, px. Beyond them, the linear model no longer
/// describes the light.
const LONGEST_STEP_PX: f64 = 2.0;
const LONGEST_TURN_RAD: f64 = 0.3;
const LONGEST_WIDENING_PX: f64 = 1.0;
/// Smallest and largest half width of steps, px: of a sharp step in pixels, and of the widest blur.
const WIDTHS_PX: (f64, f64) = (0.6, 8.0);
/// Distance from the centre, px, that no micro-image reaches: a corner beyond it means that the fit has failed.
const FURTHEST_PX: f64 = 30.0;

/// Edges of a corner, in single precision like the light.
struct Edges<S: Simd> {
    place: [Lanes<S>; 2],
    inverse: Lanes<S>,
    /// Sine and cosine of both directions.
    directions: [[Lanes<S>; 2]; 2],
    one: Lanes<S>,
}

/// Values of two edges in some pixels.
struct SeenEdges<S: Simd> {
    /// Position relative to the corner, in half widths of steps.
    from: [Lanes<S>; 2],
    /// Distances from the edges, in half widths.
    distance: [Lanes<S>; 2],
    /// Values of the steps, and their slopes.
    steps: [Lanes<S>; 2],
    slopes: [Lanes<S>; 2],
}

impl<S: Simd> Edges<S> {
    #[inline(always)]
    #[allow(clippy::cast_possible_truncation)] // single precision, as the light
    fn of(simd: S, corner: &Corner) -> Self {
        let all = |x: f64| Lanes::splat(simd, x as f32);
        let [(s1, c1), (s2, c2)] = [corner.angles[0].sin_cos(), corner.angles[1].sin_cos()];
        Self {
            place: [all(corner.place.x), all(corner.place.y)],
            inverse: all(1.0 / corner.width),
            directions: [[all(s1), all(c1)], [all(s2), all(c2)]],
            one: all(1.0),
        }
    }

    #[inline(always)]
    fn seen(&self, [x, y]: [Lanes<S>; 2]) -> SeenEdges<S> {
        let x = (x - self.place[0]) * self.inverse;
        let y = (y - self.place[1]) * self.inverse;
        let [[s1, c1], [s2, c2]] = self.directions;
        let distance = [s1.mul_from(x, c1 * y), s2.mul_from(x, c2 * y)];
        let ([t1, e1], [t2, e2]) = (self.step(distance[0]), self.step(distance[1]));
        SeenEdges { from: [x, y], distance, steps: [t1, t2], slopes: [e1, e2] }
    }

    /// Returns a step from −1 to 1 at a distance in its half widths, and its slope: t (3 − t²)/2 and 3 (1 − t²)/2.
    #[inline(always)]
    fn step(&self, distance: Lanes<S>) -> [Lanes<S>; 2] {
        let t = distance.clamp(-self.one, self.one);
        let half_slope = (t * 0.5).mul_from(t, self.one * 0.5);
        [t * (half_slope + self.one), half_slope * 3.0]
    }

    /// Returns the derivatives of the product of both steps by the position of the corner, px⁻¹, by both directions, and by the
    /// width of the steps, times this width.
    #[inline(always)]
    fn derivatives(&self, seen: &SeenEdges<S>) -> [Lanes<S>; 5] {
        let ([x, y], [[s1, c1], [s2, c2]]) = (seen.from, self.directions);
        let along = [c1.mul_add(x, s1 * y), c2.mul_add(x, s2 * y)];
        let [d1, d2] = seen.distance;
        let (g1, g2) = (seen.slopes[0] * seen.steps[1], seen.steps[0] * seen.slopes[1]);
        [
            g1.mul_add(s1, g2 * s2) * self.inverse,
            -g1.mul_add(c1, g2 * c2) * self.inverse,
            -(g1 * along[0]),
            -(g2 * along[1]),
            -g1.mul_add(d1, g2 * d2),
        ]
    }
}

impl Corner {
    /// Fits the corner to the light; `None` if the fit fails.
    pub fn fitted(&self, patch: &Patch, room: &mut FitRoom) -> Option<Self> {
        let pixels = patch.x.len();
        room.trial.resize(pixels);
        room.taken.resize(pixels);
        room.weighted.resize(pixels, 0.0);
        let mut squares = Squares { patch, room };
        let (mut corner, cost) = DESCENT.from(*self, &mut squares)?;
        let (normal, _) = squares.normal_equations()?;
        let inverse = normal.cholesky()?.inverse();
        let variance = cost / (pixels as f64 - PARAMETERS as f64).max(1.0);
        corner.covariance = inverse.fixed_view::<2, 2>(0, 0).into_owned() * variance;
        corner.explained = 1.0 - cost / patch.sum_of_squares();
        let finite = corner.place.iter().all(|x| x.is_finite()) && corner.contrast.is_finite();
        finite.then_some(corner)
    }

    /// Returns a quadratic form that is positive along directions to bright squares and does not depend on the size of the
    /// contrast.
    pub fn squares(&self) -> Matrix2<f64> {
        let [a, b] = self.angles.map(|angle| Vector2::new(-angle.sin(), angle.cos()));
        (a * b.transpose() + b * a.transpose()) * self.contrast.signum()
    }

    /// Returns the [`imbalance`] of the corner.
    pub fn imbalance(&self, patch: &Patch) -> Option<f64> {
        let mut room = [const { Vec::new() }; 3];
        for row in &mut room {
            row.resize(patch.x.len(), 0.0);
        }
        Arch::new().dispatch(Steps { corner: self, patch, rows: &mut room });
        imbalance(room.each_ref().map(Vec::as_slice), patch)
    }

    /// Returns the standard deviation of the position per axis, px, as the mean of both axes.
    pub fn std_dev_px(&self) -> f64 {
        (self.covariance.trace() / 2.0).max(0.0).sqrt()
    }

    /// Returns the sine of the angle between the edges.
    pub fn opening(&self) -> f64 {
        (self.angles[0] - self.angles[1]).sin().abs()
    }
}

/// Calls `add` for groups of pixels in turn, with their indices and positions.
#[inline(always)]
fn for_pixels<S: Simd>(
    simd: S,
    patch: &Patch,
    mut add: impl FnMut(std::ops::Range<usize>, [Lanes<S>; 2]),
) {
    for first in (0..patch.x.len()).step_by(S::F32_LANES) {
        let some = first..(first + S::F32_LANES).min(patch.x.len());
        let of = |all: &[f32]| Lanes::of(simd, simd.partial_load_f32s(&all[some.clone()]));
        let place = [of(&patch.x), of(&patch.y)];
        add(some, place);
    }
}

/// Returns the deviation of a corner from two bright and two dark quarters: the contrast across single edges over the contrast
/// across both. It follows from the steps across its edges and their product in each pixel. It is 0 for a corner of a
/// checkerboard, and 1 if only one quarter is dark, as at the outer corners of the board; `None` if the light does not
/// determine it.
pub(super) fn imbalance(steps: [&[f32]; 3], patch: &Patch) -> Option<f64> {
    let (normal, right) = Arch::new().dispatch(Quarters { steps, patch });
    let normal = Matrix4::from_fn(|a, b| normal[a.max(b)][a.min(b)]);
    let levels = normal.cholesky()?.solve(&Vector4::from(right.map(|[right]| right)));
    Some(f64::from(levels[1].abs().max(levels[2].abs()) / levels[3].abs()))
}

/// Normal equations of the mean light, of the steps across either edge, and of the step across both.
struct Quarters<'a> {
    steps: [&'a [f32]; 3],
    patch: &'a Patch,
}

impl WithSimd for Quarters<'_> {
    type Output = ([[f32; 4]; 4], [[f32; 1]; 4]);

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        let Self { steps: [first, second, both], patch } = self;
        let n = patch.x.len();
        let (ones, mut weighted) = (vec![1.0; n], vec![0.0; n]);
        let rows = [ones.as_slice(), first, second, both];
        products(simd, rows, [&patch.light[..n]], &patch.weight, &mut weighted)
    }
}

/// Computation of the steps across both edges and their product, pixel by pixel.
struct Steps<'a> {
    corner: &'a Corner,
    patch: &'a Patch,
    rows: &'a mut [Vec<f32>; 3],
}

impl WithSimd for Steps<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { corner, patch, rows: [first, second, both] } = self;
        let edges = Edges::of(simd, corner);
        for_pixels(simd, patch, |some, place| {
            let [a, b] = edges.seen(place).steps;
            simd.partial_store_f32s(&mut first[some.clone()], a.register());
            simd.partial_store_f32s(&mut second[some.clone()], b.register());
            simd.partial_store_f32s(&mut both[some], (a * b).register());
        });
    }
}

/// Weighted sum of squares of the light minus the model of a corner.
struct Squares<'a> {
    patch: &'a Patch,
    room: &'a mut FitRoom,
}

/// Buffers for a fit, which can be reused.
#[derive(Default)]
pub(super) struct FitRoom {
    trial: Model,
    taken: Model,
    weighted: Vec<f32>,
}

impl LeastSquares<PARAMETERS> for Squares<'_> {
    type Point = Corner;

    fn evaluate(&mut self, at: &Corner) -> Option<f64> {
        // The processor's widest registers carry out the same operations.
        let Self { room: FitRoom { trial, .. }, patch } = self;
        trial.place = at.place;
        Some(Arch::new().dispatch(Evaluation { model: trial, corner: at, patch }))
    }

    fn accept(&mut self) {
        std::mem::swap(&mut self.room.trial, &mut self.room.taken);
    }

    fn normal_equations(
        &mut self,
    ) -> Option<(SMatrix<f64, PARAMETERS, PARAMETERS>, SVector<f64, PARAMETERS>)> {
        let Self { room: FitRoom { taken, weighted, .. }, patch, .. } = self;
        if taken.place.norm() > FURTHEST_PX {
            return None;
        }
        let (products, right) =
            Arch::new().dispatch(Products { model: taken, weight: &patch.weight, weighted });
        let normal = SMatrix::from_fn(|a, b| f64::from(products[a.max(b)][a.min(b)]));
        Some((normal, SVector::from_fn(|a, _| f64::from(right[a][0]))))
    }

    fn moved(&self, from: &Corner, step: &SVector<f64, PARAMETERS>) -> Corner {
        let mut place = Vector2::new(step[0], step[1]);
        if place.norm() > LONGEST_STEP_PX {
            place *= LONGEST_STEP_PX / place.norm();
        }
        let mut next = *from;
        next.place += place;
        next.level += step[2];
        next.contrast += step[3];
        let turn = |step: f64| step.clamp(-LONGEST_TURN_RAD, LONGEST_TURN_RAD);
        next.angles[0] += turn(step[4]);
        next.angles[1] += turn(step[5]);
        let wider = step[6].clamp(-LONGEST_WIDENING_PX, LONGEST_WIDENING_PX);
        next.width = (next.width + wider).clamp(WIDTHS_PX.0, WIDTHS_PX.1);
        next
    }

    fn distance(&self, from: &Corner, to: &Corner) -> f64 {
        (to.place - from.place).norm()
    }
}

/// Model of the light and its derivatives, pixel by pixel.
#[derive(Default)]
struct Model {
    /// Position of the corner, px.
    place: Vector2<f64>,
    residual: Vec<f32>,
    /// Derivatives by the parameters.
    rows: [Vec<f32>; PARAMETERS],
}

impl Model {
    fn resize(&mut self, pixels: usize) {
        self.residual.resize(pixels, 0.0);
        for row in &mut self.rows {
            row.resize(pixels, 0.0);
        }
    }
}

/// Weighted products of the rows of a model with each other, in the lower triangle, and with the residuals.
struct Products<'a> {
    model: &'a Model,
    weight: &'a [f32],
    /// Buffer for a row times the weights.
    weighted: &'a mut [f32],
}

impl WithSimd for Products<'_> {
    type Output = ([[f32; PARAMETERS]; PARAMETERS], [[f32; 1]; PARAMETERS]);

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        let rows = self.model.rows.each_ref().map(Vec::as_slice);
        products(simd, rows, [&self.model.residual], self.weight, self.weighted)
    }
}

/// Evaluation of a model.
struct Evaluation<'a> {
    model: &'a mut Model,
    corner: &'a Corner,
    patch: &'a Patch,
}

impl WithSimd for Evaluation<'_> {
    type Output = f64;

    #[inline(always)]
    #[allow(clippy::cast_possible_truncation)] // single precision, as the light
    fn with_simd<S: Simd>(self, simd: S) -> f64 {
        let Self { model, corner, patch } = self;
        let n = patch.x.len();
        let [by_u, by_v, level, shape, by_1, by_2, by_width] =
            model.rows.each_mut().map(|row| &mut row[..n]);
        level.fill(1.0);
        let (edges, h) = (Edges::of(simd, corner), corner.contrast as f32);
        let by_width_factor = h / corner.width as f32;
        for_pixels(simd, patch, |some, place| {
            let seen = edges.seen(place);
            let [u, v, first, second, width] = edges.derivatives(&seen);
            let store = |row: &mut [f32], values: Lanes<S>| {
                simd.partial_store_f32s(&mut row[some.clone()], values.register());
            };
            store(shape, seen.steps[0] * seen.steps[1]);
            store(by_u, u * h);
            store(by_v, v * h);
            store(by_1, first * h);
            store(by_2, second * h);
            store(by_width, width * by_width_factor);
        });
        let (light, weight) = (&patch.light[..n], &patch.weight[..n]);
        let (m, residuals) = (corner.level as f32, &mut model.residual[..n]);
        for i in 0..n {
            residuals[i] = light[i] - m - h * shape[i];
        }
        f64::from(weighted_squares(simd, weight, residuals))
    }
}
