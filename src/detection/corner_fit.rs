//! Fit of a board corner in a micro-image with known blur, and the sensitivities of its position to all held quantities.
//!
//! The unknowns are the position of the corner and two levels. All else is held: the slope of the corner's line, which gives
//! its blur radius, the aberrations of the main lens, the sharpness of edges, and the measurements from white images. All
//! derivatives follow from the same normal equations. N, m and n are their blocks of the unknowns, of unknowns with held
//! quantities, and of held quantities. The derivatives of the unknowns by the held quantities are −N⁻¹ m, and n − mᵀ N⁻¹ m is
//! the information of the light alone about the held quantities.

// Only functions inlined into a dispatched function are compiled for its registers.
#![allow(clippy::inline_always)]

use nalgebra::{Matrix2, Matrix4, SMatrix, SVector, Vector2, Vector4};
use pulp::{Arch, Simd, WithSimd};

use super::corner::{Corner, imbalance};
use super::edge_width::EdgeWidth;
use super::patch::Patch;
use super::{Aberration, MicroOptics};
use crate::model::TAKEN;
use crate::model::taken::{APERTURE_RATIO, FALL_OFF, INTERCEPT, POINT_SPREAD, PUPIL};
use crate::numerics::simd::{dot, products};
use crate::optics::aberration::smaller_by_growth;
use crate::optics::{Bundle, Column, CornerEdges, CornerLight};

/// Derivatives of a position by the quantities that all corners share, px; those by aberrations are 0 before the fit of lines: see [`crate::model::TAKEN_QUANTITIES`].
pub(super) type ByTaken = SMatrix<f64, 2, TAKEN>;

/// Fitted corner.
#[derive(Debug, Clone, Copy)]
pub(super) struct FittedCorner {
    pub corner: Corner,
    /// Derivatives of its position by held quantities.
    pub sensitivities: Sensitivities,
    /// Information of its light about its blur radius and the variance of its edges.
    pub width: EdgeWidth,
}

/// Derivatives of the position of a corner.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Sensitivities {
    /// Derivative by the slope, px.
    pub by_slope: Vector2<f64>,
    /// Derivatives by S, b and M at its position, in the scale of the middle of the image, see [`Aberration`].
    pub by_aberration: SMatrix<f64, 2, 5>,
    /// Derivatives by the quantities that all corners share.
    pub by_taken: ByTaken,
}

/// Quantities that the fit holds.
#[derive(Debug, Clone, Copy)]
pub(super) struct Held<'a> {
    pub optics: &'a MicroOptics,
    /// Slope of the line of the corner.
    pub slope: f64,
    /// Aberrations of the main lens, and centre of the micro-image, px.
    pub aberration: &'a Aberration,
    pub center: Vector2<f64>,
    /// Variance of the point spread along an axis, and excess edge variance, px².
    pub point_spread_px2: f64,
    pub wider_px2: f64,
}

/// Buffers for a fit, which can be reused.
#[derive(Default)]
pub(super) struct FitRoom {
    light: CornerLight,
    residual: Vec<f32>,
    ones: Vec<f32>,
    weighted: Vec<f32>,
}

/// Number of unknowns: position (u, v), level, contrast.
const UNKNOWNS: usize = 4;
/// Columns of held quantities.
const OF_HELD: [Column; 11] = [
    Column::BlurRadius,
    Column::EdgeVariance,
    Column::PupilBlurRadius,
    Column::Pupil,
    Column::PointSpread,
    Column::FallOff,
    Column::Spherical,
    Column::ComaU,
    Column::ComaV,
    Column::AstigmatismUU,
    Column::AstigmatismUV,
];
const HELD: usize = OF_HELD.len();

/// Largest number of evaluations of the light. Corners start within a pixel, and one step leaves a few hundredths.
const EVALUATIONS: usize = 5;
/// Length of a step below which it is the last one, px and as a part of the blur radius: it leaves a few thousandths of a pixel
/// at most, and has the size of the noise. (Last steps of 0.2 px move d by half a σ where blur radii are 1 px.)
const LAST_STEP_PX: f64 = 0.1;
const LAST_STEP_OF_BLUR: f64 = 0.05;
/// Longest step, px. Beyond it, the linear model no longer describes the light.
const LONGEST_STEP_PX: f64 = 1.0;
/// Distance beyond all light of a micro-image, px.
const FAR_PX: f64 = 1e3;
/// Distance from the expected position, px, beyond which a corner is another one.
const FURTHEST_PX: f64 = 3.0;

impl Held<'_> {
    fn bundle(&self) -> Bundle {
        let Self { optics, slope, .. } = *self;
        let (rho, q) = (optics.blur_radius_px(slope), optics.q_px());
        Bundle::new(rho, q, optics.pupil_px, self.point_spread_px2)
            .through(optics.opening, optics.normal_rad)
            .oblique(&optics.obliquity)
            .aberrated(&self.aberration.bend(&self.center, optics.growth, slope))
            .wider(self.wider_px2)
    }

    /// Returns the [`imbalance`] of a corner.
    pub fn imbalance(&self, corner: &Corner, patch: &Patch, room: &mut FitRoom) -> Option<f64> {
        let bundle = self.bundle();
        let mut steps = [const { Vec::new() }; 3];
        // A corner moved far along one edge shows the step across this edge alone.
        let moved = [Some(corner.angles[0]), Some(corner.angles[1]), None];
        for (step, along) in steps.iter_mut().zip(moved) {
            let far = along.map_or_else(Vector2::zeros, |angle| {
                Vector2::new(angle.cos(), angle.sin()) * FAR_PX
            });
            let edges = CornerEdges { place: corner.place + far, angles: corner.angles };
            bundle.corner_shape(&edges, &patch.x, &patch.y, &mut room.light);
            step.extend_from_slice(room.light.column(Column::Shape));
        }
        imbalance(steps.each_ref().map(Vec::as_slice), patch)
    }

    /// Fits the position and levels of a corner; `None` if the fit fails. If it is `rough`, the corner may start far away, and
    /// positions to a few hundredths of a pixel suffice.
    pub fn fit(
        &self,
        start: &Corner,
        rough: bool,
        patch: &Patch,
        room: &mut FitRoom,
    ) -> Option<FittedCorner> {
        let bundle = if rough { self.bundle().coarse() } else { self.bundle() };
        let mut corner = *start;
        let blur_px = self.optics.blur_radius_px(self.slope).abs();
        let last_step_px = LAST_STEP_PX.max(LAST_STEP_OF_BLUR * blur_px);
        for evaluation in 1..=EVALUATIONS {
            let edges = CornerEdges { place: corner.place, angles: corner.angles };
            // An intermediate step needs no other derivatives.
            let on_the_way = rough && evaluation == 1;
            if on_the_way {
                bundle.corner_shape(&edges, &patch.x, &patch.y, &mut room.light);
            } else {
                bundle.corner_light(&edges, &patch.x, &patch.y, &mut room.light);
            }
            let step = room.step(&corner, patch)?;
            corner.level += step.levels.x;
            corner.contrast += step.levels.y;
            let length = step.place.norm();
            if !on_the_way && (length < last_step_px || evaluation == EVALUATIONS) {
                corner.place += step.place;
                return self.fitted(corner, &step, patch, room);
            }
            corner.place += step.place * (LONGEST_STEP_PX / length).min(1.0);
            if (corner.place - start.place).norm() > FURTHEST_PX {
                return None;
            }
        }
        None
    }

    /// Completes the corner after its last step.
    fn fitted(
        &self,
        mut corner: Corner,
        step: &Step,
        patch: &Patch,
        room: &mut FitRoom,
    ) -> Option<FittedCorner> {
        let pixels = patch.x.len() as f64;
        let contrast = corner.contrast;
        corner.explained = 1.0 - step.cost / patch.sum_of_squares();
        let variance = step.cost / (pixels - UNKNOWNS as f64).max(1.0);
        let place = step.inverse.fixed_view::<2, 2>(0, 0);
        corner.covariance = place * (variance / contrast.powi(2));
        let (mixed, own, right) = room.held(patch);
        let follow = step.inverse * mixed;
        let by_held = -follow.fixed_rows::<2>(0).into_owned();
        let sensitivities = self.sensitivities(&by_held);
        // Information of the light alone about the blur radius and the edge variance.
        let of_two = mixed.fixed_columns::<2>(0).into_owned();
        let left = own - of_two.transpose() * follow.fixed_columns::<2>(0);
        let change = right - of_two.transpose() * step.unknowns;
        let scale = contrast / (step.cost / (pixels - UNKNOWNS as f64 - 2.0).max(1.0));
        let width = EdgeWidth::new(left * (contrast * scale), change * scale);
        let finite = corner.place.iter().chain(&by_held).all(|x| x.is_finite());
        (finite && width.is_finite()).then_some(FittedCorner { corner, sensitivities, width })
    }

    /// Converts derivatives by the columns to derivatives by the held quantities.
    fn sensitivities(&self, by: &SMatrix<f64, 2, HELD>) -> Sensitivities {
        let of = |column: Column| -> Vector2<f64> {
            let i = OF_HELD.iter().position(|c| *c == column).expect("a column of what is held");
            by.column(i).into_owned()
        };
        let Self { optics, slope, .. } = self;
        let by_radius = of(Column::BlurRadius);
        // The columns are S, b and M over A, and 1/A is γ − 1.
        let by_bend = by.fixed_columns::<5>(HELD - 5);
        let by_slope = by_radius * optics.blur_by_slope_px()
            + by_bend * self.aberration.at(&self.center, optics.growth);
        let mut by_taken = ByTaken::zeros();
        let columns = [
            (PUPIL, of(Column::Pupil) * optics.pupil_px),
            (
                INTERCEPT,
                (by_radius + of(Column::PupilBlurRadius))
                    * (optics.aperture_ratio * optics.q_prime_px),
            ),
            (FALL_OFF, of(Column::FallOff) * optics.obliquity.within_per_px2),
            (APERTURE_RATIO, by_radius * optics.blur_by_ratio_px(*slope, 0.0)),
            (POINT_SPREAD, of(Column::PointSpread)),
        ];
        for (taken, column) in columns {
            by_taken.set_column(taken, &column);
        }
        let by_aberration =
            by_bend * SMatrix::from_diagonal(&smaller_by_growth(optics.growth)) * (slope - 1.0);
        Sensitivities { by_slope, by_aberration, by_taken }
    }
}

/// Gauss-Newton step.
struct Step {
    place: Vector2<f64>,
    /// Changes of level and contrast.
    levels: Vector2<f64>,
    /// Unknowns: the position times the contrast, and the levels.
    unknowns: Vector4<f64>,
    /// Inverse of their normal matrix, for a contrast of 1.
    inverse: Matrix4<f64>,
    /// Remaining weighted sum of squares.
    cost: f64,
}

impl FitRoom {
    /// Computes the step from a corner whose light was evaluated; `None` if the light does not determine it.
    #[allow(clippy::cast_possible_truncation)] // single precision, as the light
    fn step(&mut self, corner: &Corner, patch: &Patch) -> Option<Step> {
        let n = patch.x.len();
        self.ones.resize(n, 1.0);
        self.weighted.resize(n, 0.0);
        self.residual.resize(n, 0.0);
        let (level, contrast) = (corner.level as f32, corner.contrast as f32);
        let shape = self.light.column(Column::Shape);
        for ((residual, light), shape) in self.residual.iter_mut().zip(&patch.light).zip(shape) {
            *residual = light - level - contrast * shape;
        }
        let Self { light, residual, ones, weighted } = self;
        let rows = [light.column(Column::U), light.column(Column::V), ones, shape_of(light)];
        let sums = OfUnknowns { rows, residual, weight: &patch.weight, weighted };
        let (normal, right, squares) = Arch::new().dispatch(sums);
        let normal = Matrix4::from_fn(|a, b| f64::from(normal[a.max(b)][a.min(b)]));
        let right = Vector4::from_fn(|a, _| f64::from(right[a][0]));
        let inverse = normal.cholesky()?.inverse();
        let unknowns = inverse * right;
        let contrast = corner.contrast + unknowns.w;
        let place = unknowns.xy() / contrast;
        let cost = (f64::from(squares) - unknowns.dot(&right)).max(0.0);
        let finite = unknowns.iter().chain(&place).all(|x| x.is_finite());
        finite.then(|| Step {
            place,
            levels: Vector2::new(unknowns.z, unknowns.w),
            unknowns,
            inverse,
            cost,
        })
    }

    /// Computes the blocks of the normal equations with the held quantities: with the unknowns, and of the blur radius and the
    /// edge variance alone, with their right-hand side.
    fn held(
        &mut self,
        patch: &Patch,
    ) -> (SMatrix<f64, UNKNOWNS, HELD>, Matrix2<f64>, SVector<f64, 2>) {
        let Self { light, residual, ones, weighted } = self;
        let unknowns = [light.column(Column::U), light.column(Column::V), ones, shape_of(light)];
        let held = OF_HELD.map(|column| light.column(column));
        let sums = OfHeld { unknowns, held, residual, weight: &patch.weight, weighted };
        let (mixed, own, right) = Arch::new().dispatch(sums);
        (
            SMatrix::from_fn(|a, b| f64::from(mixed[a][b])),
            Matrix2::from_fn(|a, b| f64::from(own[a.max(b)][a.min(b)])),
            Vector2::from_fn(|a, _| f64::from(right[a])),
        )
    }
}

fn shape_of(light: &CornerLight) -> &[f32] {
    light.column(Column::Shape)
}

/// Normal equations of the unknowns, and the weighted sum of squares.
struct OfUnknowns<'a> {
    rows: [&'a [f32]; UNKNOWNS],
    residual: &'a [f32],
    weight: &'a [f32],
    /// Buffer for a row times the weights.
    weighted: &'a mut [f32],
}

impl WithSimd for OfUnknowns<'_> {
    type Output = ([[f32; UNKNOWNS]; UNKNOWNS], [[f32; 1]; UNKNOWNS], f32);

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        let Self { rows, residual, weight, weighted } = self;
        let (normal, right) = products(simd, rows, [residual], weight, weighted);
        for (weighted, (weight, residual)) in weighted.iter_mut().zip(weight.iter().zip(residual)) {
            *weighted = weight * residual;
        }
        (normal, right, dot(simd, weighted, residual))
    }
}

/// Sums for [`FitRoom::held`].
struct OfHeld<'a> {
    unknowns: [&'a [f32]; UNKNOWNS],
    held: [&'a [f32]; HELD],
    residual: &'a [f32],
    weight: &'a [f32],
    /// Buffer for a row times the weights.
    weighted: &'a mut [f32],
}

impl WithSimd for OfHeld<'_> {
    type Output = ([[f32; HELD]; UNKNOWNS], [[f32; 2]; 2], [f32; 2]);

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        let Self { unknowns, held, residual, weight, weighted } = self;
        let mut mixed = [[0.0; HELD]; UNKNOWNS];
        for (mixed, unknown) in mixed.iter_mut().zip(unknowns) {
            for (weighted, (weight, row)) in weighted.iter_mut().zip(weight.iter().zip(unknown)) {
                *weighted = weight * row;
            }
            for (mixed, held) in mixed.iter_mut().zip(held) {
                *mixed = dot(simd, weighted, held);
            }
        }
        let (own, right) = products(simd, [held[0], held[1]], [residual], weight, weighted);
        (mixed, own, right.map(|[right]| right))
    }
}
