//! Refinement of camera, board and poses.

use nalgebra::Isometry3;

use super::bridge::ffi::{CostOptions, Iteration, SolverOptions, Termination};
use super::problem::Problem;
use super::{bridge, conversions};
use crate::error::Result;
use crate::model::{BoardShape, PlenopticCamera};

/// Result of the refinement.
#[derive(Debug, Clone, PartialEq)]
pub struct Refinement {
    /// Refined camera.
    pub camera: PlenopticCamera,
    /// Refined shape of the board.
    pub shape: BoardShape,
    /// Refined `camera_from_board`, in the given order.
    pub poses: Vec<Isometry3<f64>>,
    /// Initial cost.
    pub initial_cost: f64,
    /// Final cost.
    pub cost: f64,
    /// Contribution of the features of each pose to `cost`, in the order of `poses`.
    pub frame_costs: Vec<f64>,
    /// Reason why the solver stopped.
    pub termination: Termination,
    /// Reason as stated by Ceres.
    pub message: String,
    /// Full report of Ceres.
    pub report: String,
    /// Wall time of the solve, s.
    pub time_s: f64,
    /// All iterations.
    pub iterations: Vec<Iteration>,
}

impl Refinement {
    /// Joins this refinement and `next`, which continued from its end.
    pub(crate) fn followed_by(self, next: Self) -> Self {
        let last = self.iterations.last().map_or(0, |i| i.number);
        let later = next.iterations.iter().skip(1).map(|i| Iteration {
            number: last + i.number,
            time_s: self.time_s + i.time_s,
            ..*i
        });
        Self {
            initial_cost: self.initial_cost,
            report: format!("{}\n{}", self.report, next.report),
            time_s: self.time_s + next.time_s,
            iterations: self.iterations.iter().copied().chain(later).collect(),
            ..next
        }
    }
}

/// Minimises the cost over camera and poses.
pub(crate) fn refine(
    problem: &Problem,
    cost: &CostOptions,
    solver: &SolverOptions,
    progress: &mut dyn FnMut(&Iteration) -> bool,
) -> Result<Refinement> {
    let parts = bridge::refine(&problem.parts(), cost, solver, progress)?;
    Ok(Refinement {
        camera: problem.camera.with_intrinsics(&parts.parameters),
        shape: conversions::shape(&parts.shape),
        poses: conversions::rows(&parts.poses),
        initial_cost: parts.initial_cost,
        cost: parts.cost,
        frame_costs: parts.frame_costs,
        termination: parts.termination,
        message: parts.message,
        report: parts.report,
        time_s: parts.time_s,
        iterations: parts.iterations,
    })
}
