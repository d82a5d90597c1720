//! The refinement (paper, section 5.3), repeated for boards that turn out to be mirrored.

use nalgebra::Isometry3;
use tracing::{debug, info};

use crate::calibration::CalibrationOptions;
use crate::calibration::checks::check_refined;
use crate::calibration::frames::{Frames, reconsidered_poses};
use crate::error::Result;
use crate::model::Board;
use crate::solver::{
    self, CostOptions, Iteration, Problem, Refinement, SolverOptions, Termination, Uncertainty,
};

/// Limit of repetitions: correcting one mirrored board may reveal others.
const MAX_RECONSIDERATIONS: usize = 4;

/// The weight of the anchors is settled if a further refinement would change it by less than this
/// factor: it is known to some ten per cent at best, with as few frames as there are.
const SETTLED: f64 = 1.1;
/// Limit of refinements with other weights of the anchors.
const MAX_WEIGHINGS: usize = 5;

/// What a refinement needs besides the problem.
pub(super) struct Settings<'a> {
    pub board: &'a Board,
    pub frames: &'a Frames,
    pub options: &'a CalibrationOptions,
    /// σ of ρ that features of a lens type have in common, px.
    pub type_rho_std_dev_px: Vec<f64>,
}

/// The refinement, its uncertainty, and the cost with the weight that the anchors ended with.
pub(super) struct Refined {
    pub refinement: Refinement,
    pub uncertainty: Uncertainty,
    pub cost: CostOptions,
}

impl Settings<'_> {
    /// Refines; with anchors, again until their weight is what the residuals say.
    pub fn refine(
        &self,
        problem: &Problem,
        mut cost: CostOptions,
        progress: &mut dyn FnMut(&Iteration) -> bool,
    ) -> Result<Refined> {
        let progress = &mut |iteration: &Iteration| {
            let Iteration { number, cost, gradient_max_norm, step_norm, .. } = iteration;
            debug!(
                "iteration {number}: cost {cost:.9}, gradient {gradient_max_norm:.3e}, step \
                 {step_norm:.3e}"
            );
            progress(iteration)
        };
        let mut refinement = refine(problem, self, &cost, progress)?;
        let mut weighings = 1;
        loop {
            let refined =
                Problem { camera: &refinement.camera, poses: &refinement.poses, ..*problem };
            let uncertainty = solver::uncertainty(&refined, &cost, &self.type_rho_std_dev_px)?;
            let change = uncertainty.dispersion / cost.anchor_weight;
            if cost.anchors.is_empty()
                || refinement.termination == Termination::Stopped
                || weighings == MAX_WEIGHINGS
                || (1.0 / SETTLED..SETTLED).contains(&change)
            {
                return Ok(Refined { refinement, uncertainty, cost });
            }
            debug!("the anchors weigh {:.3}", uncertainty.dispersion);
            cost.anchor_weight = uncertainty.dispersion;
            let again = refine(&refined, self, &cost, progress)?;
            refinement = refinement.followed_by(again);
            weighings += 1;
        }
    }
}

/// Refines, and repeats if the tilt of a board turns out to have the other sign.
fn refine(
    problem: &Problem,
    settings: &Settings,
    cost: &CostOptions,
    progress: &mut dyn FnMut(&Iteration) -> bool,
) -> Result<Refinement> {
    let Settings { board, frames, options, .. } = settings;
    info!(
        "{} features of {} frames, {} left out; {} centres",
        problem.features.len(),
        problem.poses.len(),
        frames.left_out.len(),
        problem.centers.len()
    );
    let mut refinement = solver::refine(problem, cost, &options.solver, progress)?;
    check_refined(&refinement)?;
    for _ in 0..MAX_RECONSIDERATIONS {
        if refinement.termination == Termination::Stopped {
            break;
        }
        let (camera, poses) = (&refinement.camera, &refinement.poses);
        // If a repetition fails, the present result stands.
        let Ok(Some(poses)) =
            reconsidered_poses(camera, board, frames, poses, cost, &options.solver)
        else {
            break;
        };
        info!("refining again: the tilt of some boards changes its sign");
        let done = refinement.iterations.len().saturating_sub(1);
        let max_iterations = options.solver.max_iterations.saturating_sub(done);
        if max_iterations == 0 {
            break;
        }
        let poses: Vec<Isometry3<f64>> = poses.iter().map(|p| p.camera_from_board).collect();
        let again = Problem { camera, poses: &poses, ..*problem };
        let solver = SolverOptions { max_iterations, ..options.solver };
        match solver::refine(&again, cost, &solver, progress) {
            Ok(again) if again.cost < refinement.cost && check_refined(&again).is_ok() => {
                refinement = refinement.followed_by(again);
            }
            _ => break,
        }
    }
    info!(
        "cost {:.6} (initially {:.6}) after {} iterations in {:.3} s",
        refinement.cost,
        refinement.initial_cost,
        refinement.iterations.len().saturating_sub(1),
        refinement.time_s
    );
    Ok(refinement)
}
