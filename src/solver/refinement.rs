//! What the refinement gives back.

use nalgebra::Isometry3;

use crate::model::PlenopticCamera;

/// One iteration of the refinement.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Iteration {
    /// From 0, the start.
    pub number: i32,
    /// The cost.
    pub cost: f64,
    /// Largest component of the gradient.
    pub gradient_max_norm: f64,
    /// Length of the step.
    pub step_norm: f64,
    /// Radius of the trust region.
    pub trust_region_radius: f64,
    /// Wall time since the start of the solve, s.
    pub time_s: f64,
}

/// Why the solver stopped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Termination {
    /// At a minimum, by the solver's tolerances.
    Converged,
    /// At the limit of iterations.
    IterationLimit,
    /// By the progress function.
    Stopped,
    /// By a failure.
    Failed,
}

/// What the solver gives back.
#[derive(Debug, Clone, PartialEq)]
pub struct Refinement {
    /// The refined camera.
    pub camera: PlenopticCamera,
    /// The refined `camera_from_board`, in the order given.
    pub poses: Vec<Isometry3<f64>>,
    /// Cost at the start.
    pub initial_cost: f64,
    /// Cost at the end.
    pub cost: f64,
    /// The part of `cost` that comes from the features of each pose, in the order of `poses`.
    pub frame_costs: Vec<f64>,
    /// Why it stopped.
    pub termination: Termination,
    /// The reason in Ceres' words.
    pub message: String,
    /// Ceres' full report.
    pub report: String,
    /// Wall time of the solve, s.
    pub time_s: f64,
    /// Every iteration.
    pub iterations: Vec<Iteration>,
}

impl Refinement {
    /// This refinement and one that went on from where it ended, as one.
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
