//! The refinement (paper, section 5.3), repeated for boards that turn out to be mirrored.

use nalgebra::Isometry3;
use tracing::{debug, info};

use crate::calibration::CalibrationOptions;
use crate::calibration::checks::check_refined;
use crate::calibration::frames::{Frames, reconsidered_poses};
use crate::error::Result;
use crate::model::Board;
use crate::solver::{
    self, CostOptions, Iteration, Problem, Refinement, SolverOptions, Termination,
};

/// Limit of repetitions: correcting one mirrored board may reveal others.
const MAX_RECONSIDERATIONS: usize = 4;

/// Refines, and repeats if the tilt of a board turns out to have the other sign.
pub(super) fn refine(
    problem: &Problem,
    board: &Board,
    frames: &Frames,
    cost: &CostOptions,
    options: &CalibrationOptions,
    progress: &mut dyn FnMut(&Iteration) -> bool,
) -> Result<Refinement> {
    info!(
        "{} features of {} frames, {} left out; {} centres",
        problem.features.len(),
        problem.poses.len(),
        frames.left_out.len(),
        problem.centers.len()
    );
    let progress = &mut |iteration: &Iteration| {
        let Iteration { number, cost, gradient_max_norm, step_norm, .. } = iteration;
        debug!(
            "iteration {number}: cost {cost:.9}, gradient {gradient_max_norm:.3e}, step {step_norm:.3e}"
        );
        progress(iteration)
    };
    let mut refinement = solver::refine(problem, cost, &options.solver, progress)?;
    check_refined(&refinement)?;
    for _ in 0..MAX_RECONSIDERATIONS {
        if refinement.termination == Termination::Stopped {
            break;
        }
        let (camera, poses) = (&refinement.camera, &refinement.poses);
        // If a repetition fails, the present result stands.
        let Ok(Some(poses)) =
            reconsidered_poses(camera, board, frames, poses, &options.cost, &options.solver)
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
