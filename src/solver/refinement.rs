//! The result of the refinement.

use nalgebra::Isometry3;

use crate::model::{BoardShape, PlenopticCamera};

/// One iteration of the refinement.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Iteration {
    /// Number of the iteration; 0 is the start.
    pub number: i32,
    /// The cost.
    pub cost: f64,
    /// Largest component of the gradient.
    pub gradient_max_norm: f64,
    /// 2-norm of the change of all parameters; 0 for a rejected step.
    pub step_norm: f64,
    /// Radius of the trust region.
    pub trust_region_radius: f64,
    /// Wall time since the start of the solve, s.
    pub time_s: f64,
}

/// Why the solver stopped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Termination {
    /// It reached a minimum, by the solver's tolerances.
    Converged,
    /// It reached the limit of iterations.
    IterationLimit,
    /// The progress function stopped it.
    Stopped,
    /// It failed.
    Failed,
}

/// The result of the refinement.
#[derive(Debug, Clone, PartialEq)]
pub struct Refinement {
    /// The refined camera.
    pub camera: PlenopticCamera,
    /// The refined shape of the board.
    pub shape: BoardShape,
    /// The refined `camera_from_board`, in the order given.
    pub poses: Vec<Isometry3<f64>>,
    /// Initial cost.
    pub initial_cost: f64,
    /// Final cost.
    pub cost: f64,
    /// The contribution of the features of each pose to `cost`, in the order of `poses`.
    pub frame_costs: Vec<f64>,
    /// Why it stopped.
    pub termination: Termination,
    /// The reason as stated by Ceres.
    pub message: String,
    /// Ceres' full report.
    pub report: String,
    /// Wall time of the solve, s.
    pub time_s: f64,
    /// All iterations.
    pub iterations: Vec<Iteration>,
}

impl Refinement {
    /// This refinement and `next`, which continued from its end, as one.
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
