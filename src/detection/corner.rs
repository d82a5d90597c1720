//! A checkerboard corner in a micro-image: the model of its light, and its fit.

// Only what is inlined into a dispatched function is compiled for its registers.
#![allow(clippy::inline_always)]

use nalgebra::{Matrix2, Matrix4, SMatrix, SVector, Vector2, Vector4};
use pulp::{Arch, Simd, WithSimd};

use super::patch::Patch;
use super::rays::{OfRays, RayLanes, Rays};
use super::simd::{Lanes, products, weighted_squares};
use crate::numerics::{Descent, LeastSquares};

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

/// The two edges of a corner, in single precision as the light.
pub(super) struct Edges<S: Simd> {
    place: [Lanes<S>; 2],
    narrower: Lanes<S>,
    /// Sine and cosine of both directions.
    directions: [[Lanes<S>; 2]; 2],
    one: Lanes<S>,
    half: Lanes<S>,
}

/// What rays show of two edges.
pub(super) struct SeenEdges<S: Simd> {
    /// The place less that of the corner, in half widths of steps.
    from: [Lanes<S>; 2],
    /// One over that half width, px⁻¹.
    inverse: Lanes<S>,
    /// Distances from the edges, in half widths.
    distance: [Lanes<S>; 2],
    /// The steps there, and their slopes.
    pub steps: [Lanes<S>; 2],
    slopes: [Lanes<S>; 2],
}

impl<S: Simd> Edges<S> {
    #[inline(always)]
    #[allow(clippy::cast_possible_truncation)] // single precision, as the light
    pub fn of(simd: S, corner: &Corner) -> Self {
        let all = |x: f64| Lanes::splat(simd, x as f32);
        let [(s1, c1), (s2, c2)] = [corner.angles[0].sin_cos(), corner.angles[1].sin_cos()];
        Self {
            place: [all(corner.place.x), all(corner.place.y)],
            narrower: all(1.0 / corner.width),
            directions: [[all(s1), all(c1)], [all(s2), all(c2)]],
            one: all(1.0),
            half: all(0.5),
        }
    }

    #[inline(always)]
    pub fn seen(&self, rays: &RayLanes<S>) -> SeenEdges<S> {
        let inverse = rays.inverse_width * self.narrower;
        let x = (rays.origin[0] - self.place[0]) * inverse;
        let y = (rays.origin[1] - self.place[1]) * inverse;
        let [[s1, c1], [s2, c2]] = self.directions;
        let distance = [s1.mul_from(x, c1 * y), s2.mul_from(x, c2 * y)];
        let ([t1, e1], [t2, e2]) = (self.step(distance[0]), self.step(distance[1]));
        SeenEdges { from: [x, y], inverse, distance, steps: [t1, t2], slopes: [e1, e2] }
    }

    /// A step at a distance from it in its half widths, −1 to 1, and its slope: t (3 − t²)/2 and 3 (1 − t²)/2.
    #[inline(always)]
    fn step(&self, distance: Lanes<S>) -> [Lanes<S>; 2] {
        let t = distance.clamp(-self.one, self.one);
        let half_slope = (self.half * t).mul_from(t, self.half);
        [t * (half_slope + self.one), half_slope + half_slope + half_slope]
    }

    /// The distances along the edges, in half widths.
    #[inline(always)]
    fn along(&self, seen: &SeenEdges<S>) -> [Lanes<S>; 2] {
        let ([x, y], [[s1, c1], [s2, c2]]) = (seen.from, self.directions);
        [c1.mul_add(x, s1 * y), c2.mul_add(x, s2 * y)]
    }

    /// How the product of both steps changes with the place of the corner, px⁻¹.
    #[inline(always)]
    pub fn by_place(&self, seen: &SeenEdges<S>) -> [Lanes<S>; 2] {
        let [[s1, c1], [s2, c2]] = self.directions;
        let [g1, g2] = seen.by_distance();
        [g1.mul_add(s1, g2 * s2) * seen.inverse, -g1.mul_add(c1, g2 * c2) * seen.inverse]
    }

    /// How it changes with both directions and with the width of the steps, times that.
    #[inline(always)]
    pub fn by_form(&self, seen: &SeenEdges<S>) -> [Lanes<S>; 3] {
        let ([g1, g2], [along_1, along_2]) = (seen.by_distance(), self.along(seen));
        let [d1, d2] = seen.distance;
        [-(g1 * along_1), -(g2 * along_2), -g1.mul_add(d1, g2 * d2)]
    }
}

impl<S: Simd> SeenEdges<S> {
    /// The product of both steps.
    #[inline(always)]
    pub fn shape(&self) -> Lanes<S> {
        self.steps[0] * self.steps[1]
    }

    /// How it changes with the distances from the edges.
    #[inline(always)]
    fn by_distance(&self) -> [Lanes<S>; 2] {
        [self.slopes[0] * self.steps[1], self.steps[0] * self.slopes[1]]
    }
}

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

    /// The mean of the shapes that all rays show, pixel by pixel.
    pub fn shape(&self, rays: &Rays) -> Vec<f32> {
        let mut shape = vec![0.0; rays.len()];
        Arch::new().dispatch(MeanShape { corner: self, rays, shape: &mut shape });
        shape
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

impl WithSimd for Quarters<'_> {
    type Output = ([[f32; 4]; 4], [[f32; 1]; 4]);

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        let Self { corner, patch, rays, room } = self;
        let n = patch.x.len();
        let mut rows = room.chunks_exact_mut(n.max(1));
        let [ones, first, second, both, weighted] =
            std::array::from_fn(|_| rows.next().map_or(&mut [][..], |row| &mut row[..n]));
        ones.fill(1.0);
        rays.means(simd, &Steps(Edges::of(simd, corner)), &mut [first, second, both]);
        let rows = [&*ones, first, second, both];
        products(simd, rows, [&patch.light[..n]], &patch.weight, weighted)
    }
}

/// Both steps, and their product.
struct Steps<S: Simd>(Edges<S>);

impl<S: Simd> OfRays<S, 3> for Steps<S> {
    #[inline(always)]
    fn of_rays(&self, rays: &RayLanes<S>) -> [Lanes<S>; 3] {
        let seen = self.0.seen(rays);
        [seen.steps[0], seen.steps[1], seen.shape()]
    }
}

/// See [`Corner::shape`].
struct MeanShape<'a> {
    corner: &'a Corner,
    rays: &'a Rays,
    shape: &'a mut [f32],
}

impl WithSimd for MeanShape<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        self.rays.means(simd, &Shape(Edges::of(simd, self.corner)), &mut [self.shape]);
    }
}

/// The product of both steps.
pub(super) struct Shape<S: Simd>(pub Edges<S>);

impl<S: Simd> OfRays<S, 1> for Shape<S> {
    #[inline(always)]
    fn of_rays(&self, rays: &RayLanes<S>) -> [Lanes<S>; 1] {
        [self.0.seen(rays).shape()]
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
