//! The bridge to the C++ core: whole problems go over as plain values, results come back as
//! `Result`. No other module knows that there is C++ on the far side, and no other is unsafe.

mod conversions;

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};

use nalgebra::{DMatrix, Isometry3, Vector2};

use super::options::{CostOptions, SolverOptions};
use super::problem::{Problem, Projected};
use super::refinement::{Iteration, Refinement};
use super::uncertainty::Uncertainty;
use crate::error::{Error, Result};
use crate::model::PlenopticCamera;

// cxx asks for the lifetimes to be spelt out.
#[allow(unsafe_code, clippy::elidable_lifetime_names)]
#[cxx::bridge(namespace = "plenocal::bridge")]
mod ffi {
    // The core's own enumerations: the code that cxx makes asserts that the values agree.

    #[namespace = "plenocal"]
    #[repr(i32)]
    enum Packing {
        #[cxx_name = "kOrthogonal"]
        Orthogonal,
        #[cxx_name = "kHexagonalRowsEven"]
        HexagonalRowsEven,
        #[cxx_name = "kHexagonalRowsOdd"]
        HexagonalRowsOdd,
        #[cxx_name = "kHexagonalColumnsEven"]
        HexagonalColumnsEven,
        #[cxx_name = "kHexagonalColumnsOdd"]
        HexagonalColumnsOdd,
    }

    #[namespace = "plenocal"]
    #[repr(i32)]
    enum LossKind {
        #[cxx_name = "kNone"]
        None,
        #[cxx_name = "kHuber"]
        Huber,
        #[cxx_name = "kCauchy"]
        Cauchy,
    }

    #[namespace = "plenocal"]
    #[repr(i32)]
    enum Termination {
        #[cxx_name = "kConverged"]
        Converged,
        #[cxx_name = "kIterationLimit"]
        IterationLimit,
        #[cxx_name = "kStopped"]
        Stopped,
        #[cxx_name = "kFailed"]
        Failed,
    }

    /// A camera: its parameters in the order of both tables, and what is not a parameter.
    struct CameraParts {
        packing: Packing,
        columns: i32,
        rows: i32,
        pixel_size_mm: f64,
        lens_types: i32,
        parameters: Vec<f64>,
    }

    /// An intrinsic parameter as the core names it.
    struct NamedParameter {
        name: String,
        value: f64,
    }

    /// A micro-lens as the core places it: in pitches about the centre of the array.
    struct NodeRow {
        x: f64,
        y: f64,
        lens_type: i32,
    }

    /// Two coordinates of a plane.
    struct PairRow {
        x: f64,
        y: f64,
    }

    /// `camera_from_board` as angle-axis (rad) and translation (mm).
    struct PoseBlock {
        block: [f64; 6],
    }

    struct FeatureRow {
        frame: i32,
        board_point_mm: [f64; 3],
        k: i32,
        l: i32,
        u_px: f64,
        v_px: f64,
        rho_px: f64,
        /// Of u, v and ρ.
        std_dev_px: [f64; 3],
    }

    struct CenterRow {
        k: i32,
        l: i32,
        u_px: f64,
        v_px: f64,
        std_dev_px: f64,
    }

    /// Micro-lens (k, l).
    struct MicroLensIndex {
        k: i32,
        l: i32,
    }

    /// A projected feature; without meaning unless `defined`, ρ not a number where there is none.
    struct ProjectionRow {
        defined: bool,
        u_px: f64,
        v_px: f64,
        rho_px: f64,
    }

    struct CostParts {
        uv_std_dev_px: f64,
        rho_std_dev_px: f64,
        centers_std_dev_px: f64,
        loss_kind: LossKind,
        loss_scale: f64,
        fixed: Vec<String>,
    }

    struct SolverParts {
        max_iterations: i32,
        threads: i32,
        initial_trust_region_radius: f64,
        extrapolate: bool,
    }

    struct IterationRow {
        number: i32,
        cost: f64,
        gradient_max_norm: f64,
        step_norm: f64,
        trust_region_radius: f64,
        time_s: f64,
    }

    struct RefinementParts {
        camera: CameraParts,
        poses: Vec<PoseBlock>,
        initial_cost: f64,
        cost: f64,
        frame_costs: Vec<f64>,
        termination: Termination,
        message: String,
        report: String,
        time_s: f64,
        iterations: Vec<IterationRow>,
    }

    struct UncertaintyParts {
        free_intrinsics: Vec<i32>,
        size: i32,
        rank: i32,
        covariance: Vec<f64>,
        information: Vec<f64>,
        weakest: Vec<f64>,
        determined: Vec<bool>,
        residual_std_dev_px: [f64; 3],
        expected_decrease: f64,
    }

    extern "Rust" {
        type ProgressSink<'a>;
        unsafe fn report<'a>(self: &mut ProgressSink<'a>, iteration: &IterationRow) -> bool;
    }

    unsafe extern "C++" {
        include!("bridge.hpp");

        #[namespace = "plenocal"]
        type Packing;
        #[namespace = "plenocal"]
        type LossKind;
        #[namespace = "plenocal"]
        type Termination;

        fn silence_log();
        #[allow(dead_code)] // used by tests
        fn parameters(camera: &CameraParts) -> Vec<NamedParameter>;
        #[allow(dead_code)] // used by tests
        fn lattice(camera: &CameraParts) -> Vec<NodeRow>;
        fn distortion(camera: &CameraParts, points_mm: &[PairRow]) -> Result<Vec<PairRow>>;
        fn project(
            camera: &CameraParts,
            poses: &[PoseBlock],
            features: &[FeatureRow],
        ) -> Result<Vec<ProjectionRow>>;
        fn project_centers(
            camera: &CameraParts,
            micro_lenses: &[MicroLensIndex],
        ) -> Result<Vec<PairRow>>;
        unsafe fn refine<'a>(
            camera: &CameraParts,
            poses: &[PoseBlock],
            features: &[FeatureRow],
            centers: &[CenterRow],
            cost: &CostParts,
            solver: &SolverParts,
            progress: &mut ProgressSink<'a>,
        ) -> Result<RefinementParts>;
        fn uncertainty(
            camera: &CameraParts,
            poses: &[PoseBlock],
            features: &[FeatureRow],
            centers: &[CenterRow],
            cost: &CostParts,
        ) -> Result<UncertaintyParts>;
    }
}

/// Carries the caller's progress function across, and a panic of it back.
struct ProgressSink<'a> {
    callback: &'a mut dyn FnMut(&Iteration) -> bool,
    panic: Option<Box<dyn Any + Send>>,
}

impl ProgressSink<'_> {
    fn report(&mut self, row: &ffi::IterationRow) -> bool {
        let iteration = Iteration::from(row);
        match catch_unwind(AssertUnwindSafe(|| (self.callback)(&iteration))) {
            Ok(go_on) => go_on,
            Err(panic) => {
                self.panic = Some(panic);
                false
            }
        }
    }
}

/// Keeps warnings of Ceres off stderr, for the whole process: those of steps that leave the domain
/// of the model are no news.
///
/// For programs, once, before they start threads. A library leaves the log as it finds it.
pub fn silence_log() {
    ffi::silence_log();
}

/// By how much distortion of the main lens moves ideal image points, all in mm of the camera frame
/// (Brown-Conrady; paper, section 2.1).
///
/// An error if the camera is not valid.
pub fn distortion_mm(
    camera: &PlenopticCamera,
    image_points_mm: &[Vector2<f64>],
) -> Result<Vec<Vector2<f64>>> {
    let points: Vec<_> = image_points_mm.iter().map(|p| ffi::PairRow { x: p.x, y: p.y }).collect();
    let shifts = ffi::distortion(&camera.into(), &points).map_err(solver_error)?;
    Ok(shifts.iter().map(|shift| Vector2::new(shift.x, shift.y)).collect())
}

/// Projects every feature's board point through its micro-lens; `None` where the model is not
/// defined.
pub(crate) fn project(problem: &Problem) -> Result<Vec<Option<Projected>>> {
    let rows =
        ffi::project(&problem.camera.into(), &problem.pose_blocks(), &problem.feature_rows())
            .map_err(solver_error)?;
    let has_blur = problem.camera.lens_types() > 0;
    let projected = |row: &ffi::ProjectionRow| {
        row.defined.then_some(Projected {
            u_px: row.u_px,
            v_px: row.v_px,
            rho_px: has_blur.then_some(row.rho_px),
        })
    };
    Ok(rows.iter().map(projected).collect())
}

/// Projects micro-lenses (k, l) to their micro-image centres (u, v) in px.
pub(crate) fn project_centers(
    camera: &PlenopticCamera,
    micro_lenses: impl Iterator<Item = (i32, i32)>,
) -> Result<Vec<[f64; 2]>> {
    let micro_lenses: Vec<_> = micro_lenses.map(|(k, l)| ffi::MicroLensIndex { k, l }).collect();
    let rows = ffi::project_centers(&camera.into(), &micro_lenses).map_err(solver_error)?;
    Ok(rows.iter().map(|pixel| [pixel.x, pixel.y]).collect())
}

/// Minimises the cost over camera and poses.
#[allow(unsafe_code)]
pub(crate) fn refine(
    problem: &Problem,
    cost: &CostOptions,
    solver: &SolverOptions,
    progress: &mut dyn FnMut(&Iteration) -> bool,
) -> Result<Refinement> {
    let mut sink = ProgressSink { callback: progress, panic: None };
    // SAFETY: the sink is used by this call only, which ends before it and what it borrows do.
    let result = unsafe {
        ffi::refine(
            &problem.camera.into(),
            &problem.pose_blocks(),
            &problem.feature_rows(),
            &problem.center_rows(),
            &cost.into(),
            &solver.into(),
            &mut sink,
        )
    };
    if let Some(panic) = sink.panic {
        resume_unwind(panic);
    }
    let parts = result.map_err(solver_error)?;
    Ok(Refinement {
        camera: problem.camera.with_intrinsics(&parts.camera.parameters),
        poses: parts.poses.iter().map(Isometry3::from).collect(),
        initial_cost: parts.initial_cost,
        cost: parts.cost,
        frame_costs: parts.frame_costs,
        termination: parts.termination.into(),
        message: parts.message,
        report: parts.report,
        time_s: parts.time_s,
        iterations: parts.iterations.iter().map(Iteration::from).collect(),
    })
}

/// Uncertainty of the parameters at a minimum.
pub(crate) fn uncertainty(problem: &Problem, cost: &CostOptions) -> Result<Uncertainty> {
    let parts = ffi::uncertainty(
        &problem.camera.into(),
        &problem.pose_blocks(),
        &problem.feature_rows(),
        &problem.center_rows(),
        &cost.into(),
    )
    .map_err(solver_error)?;
    let size = usize::try_from(parts.size).unwrap_or(0);
    let index = |i: &i32| usize::try_from(*i).unwrap_or(0);
    Ok(Uncertainty {
        free_intrinsics: parts.free_intrinsics.iter().map(index).collect(),
        rank: usize::try_from(parts.rank).unwrap_or(0),
        covariance: DMatrix::from_row_slice(size, size, &parts.covariance),
        information: parts.information,
        weakest: parts.weakest.chunks_exact(size.max(1)).map(<[f64]>::to_vec).collect(),
        determined: parts.determined,
        residual_std_dev_px: parts.residual_std_dev_px,
        expected_decrease: parts.expected_decrease,
    })
}

// Values map_err hands over.
#[allow(clippy::needless_pass_by_value)]
fn solver_error(error: cxx::Exception) -> Error {
    Error::Invalid(error.what().to_owned())
}

#[cfg(test)]
mod tests;
