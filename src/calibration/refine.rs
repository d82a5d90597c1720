//! Refinement (paper, section 5.3), repeated for boards that turn out to be mirrored.

use nalgebra::Isometry3;
use tracing::{debug, info};

use crate::calibration::CalibrationOptions;
use crate::calibration::checks::check_refined;
use crate::calibration::frames::{Frames, reconsidered_poses};
use crate::calibration::options::{LENS_TILT, SMALL_TERMS};
use crate::error::Result;
use crate::model::{BentBoard, Parameter};
use crate::solver::{
    self, CostOptions, Iteration, Loss, LossKind, Problem, Refinement, SolverOptions,
    SystematicError, Termination, Uncertainty, names,
};

/// Limit of repetitions: the correction of one mirrored board may reveal others.
const MAX_RECONSIDERATIONS: usize = 4;

/// Iterations of a rough minimum, at which the weight of the priors is measured. The first of these, where the trust
/// region is too large, take little time and lead nowhere. The weight is measured again if it differs by more than the
/// factor `ALIKE` from the weight used there. With few frames it is known to some ten per cent at best.
const ROUGH_ITERATIONS: usize = 12;
const ALIKE: f64 = 2.0;
/// Limit of refinements; the first half of them is rough.
const MAX_ATTEMPTS: usize = 6;
/// The principal point, whose start is good to the tolerance of mounts, 0.5 mm, or better.
const PRINCIPAL_POINT: [Parameter; 2] = [Parameter::PrincipalPointU, Parameter::PrincipalPointV];
/// Initial weight of the priors, typical of real observations.
const FIRST_WEIGHT: f64 = 10.0;
/// Weight of the priors where residuals vanish, as in simulations without noise.
const LEAST_WEIGHT: f64 = 1e-6;

/// Input of a refinement besides the problem.
pub(super) struct Settings<'a> {
    pub frames: &'a Frames,
    /// True if the shape of the board may be tried: all frames show which way round the board is.
    pub tries_shape: bool,
    pub options: &'a CalibrationOptions,
    /// Systematic errors of observations and priors.
    pub systematic: Vec<SystematicError>,
    /// Weight of the priors in a refinement that ended where this one begins; `None` far from a minimum.
    pub known_weight: Option<f64>,
}

/// Refinement, its uncertainty, and its final cost: with the weight of the priors, and without the loss if it was
/// stopped before the loss took part.
pub(super) struct Refined {
    pub refinement: Refinement,
    pub uncertainty: Uncertainty,
    pub cost: CostOptions,
}

impl Settings<'_> {
    /// Refines. If there are priors, first finds their weight.
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
        let stated = self.options.prior_weight;
        let measured = !cost.priors.is_empty() && stated.is_none();
        if !cost.priors.is_empty() {
            cost.prior_weight = stated.or(self.known_weight).unwrap_or(FIRST_WEIGHT);
        }
        // Far from the minimum nearly all residuals are in the flat part of a loss. Without a loss the solver takes a
        // fifth of the steps.
        let plain = |cost: &CostOptions| CostOptions {
            loss: Loss { kind: LossKind::None, ..cost.loss },
            ..cost.clone()
        };
        let is_far = self.known_weight.is_none();
        let mut rough = is_far && (!cost.priors.is_empty() || cost.loss.kind != LossKind::None);
        let mut so_far: Option<Refinement> = None;
        let mut attempt = 0;
        loop {
            attempt += 1;
            let start = at_end(problem, so_far.as_ref());
            let left = self.left(so_far.as_ref());
            let used = if rough { plain(&cost) } else { cost.clone() };
            let limit = if rough { ROUGH_ITERATIONS.min(left) } else { left };
            let minimised = if rough { with_held(&used) } else { used.clone() };
            let next = refine(&start, self, &minimised, limit, rough, progress)?;
            let stopped = next.termination == Termination::Stopped;
            let mut refinement = followed(so_far.take(), next);
            let refined = at_end(problem, Some(&refinement));
            let uncertainty = self.uncertainty(&refined, &used)?;
            let change = uncertainty.dispersion.max(LEAST_WEIGHT) / cost.prior_weight;
            let settled = !measured || (1.0 / ALIKE..ALIKE).contains(&change);
            let done = stopped
                || self.left(Some(&refinement)) == 0
                || (!rough && (settled || attempt >= MAX_ATTEMPTS));
            if done {
                if rough && refinement.termination == Termination::Converged {
                    // The parameters held have not moved.
                    refinement.termination = Termination::IterationLimit;
                }
                return Ok(Refined { refinement, uncertainty, cost: used });
            }
            if measured {
                cost.prior_weight *= change;
                debug!("weight of the priors: {:.3}", cost.prior_weight);
            }
            rough = rough && !settled && attempt < MAX_ATTEMPTS / 2;
            so_far = Some(refinement);
        }
    }

    /// Evaluates the cost at a problem, without a step.
    pub fn evaluate(&self, problem: &Problem, mut cost: CostOptions) -> Result<Refined> {
        let solver =
            SolverOptions { max_iterations: 0, extrapolate: false, ..self.options.solver() };
        cost.prior_weight = self.options.prior_weight.unwrap_or(FIRST_WEIGHT);
        let mut uncertainty = self.uncertainty(problem, &cost)?;
        if self.options.prior_weight.is_none() && !cost.priors.is_empty() {
            for _ in 0..MAX_ATTEMPTS {
                let weight = uncertainty.dispersion.max(LEAST_WEIGHT);
                let settled = (1.0 / ALIKE..ALIKE).contains(&(weight / cost.prior_weight));
                cost.prior_weight = weight;
                uncertainty = self.uncertainty(problem, &cost)?;
                if settled {
                    break;
                }
            }
        }
        let refinement = solver::refine(problem, &cost, &solver, &mut |_| true)?;
        Ok(Refined { refinement, uncertainty, cost })
    }

    fn uncertainty(&self, at: &Problem, cost: &CostOptions) -> Result<Uncertainty> {
        solver::uncertainty(at, cost, &self.systematic, self.options.threads)
    }

    /// Returns the number of iterations that the options still allow.
    fn left(&self, so_far: Option<&Refinement>) -> usize {
        let done = so_far.map_or(0, |refinement| refinement.iterations.len().saturating_sub(1));
        self.options.max_iterations.saturating_sub(done)
    }
}

/// Returns the cost of a rough refinement. Small terms would take up large residuals of other origin, and the principal point
/// would move far along a flat valley.
fn with_held(cost: &CostOptions) -> CostOptions {
    let held = names(&[&SMALL_TERMS[..], &LENS_TILT, &PRINCIPAL_POINT].concat());
    let mut rough = cost.clone();
    rough.priors.retain(|prior| !held.contains(&prior.quantity));
    rough.fixed.extend(held);
    rough
}

fn followed(so_far: Option<Refinement>, next: Refinement) -> Refinement {
    match so_far {
        Some(so_far) => so_far.followed_by(next),
        None => next,
    }
}

/// Returns the problem at the end of a refinement, if there is one.
pub(super) fn at_end<'a>(problem: &Problem<'a>, refinement: Option<&'a Refinement>) -> Problem<'a> {
    refinement.map_or(*problem, |r| Problem {
        camera: &r.camera,
        board: BentBoard { shape: r.shape, ..problem.board },
        poses: &r.poses,
        ..*problem
    })
}

/// Refines. Unless the refinement is rough, repeats it if the tilt of a board turns out to have the other sign.
fn refine(
    problem: &Problem,
    settings: &Settings,
    cost: &CostOptions,
    max_iterations: usize,
    rough: bool,
    progress: &mut dyn FnMut(&Iteration) -> bool,
) -> Result<Refinement> {
    let Settings { frames, options, .. } = settings;
    info!(
        "{} features of {} frames, {} left out; {} centres",
        problem.features.len(),
        problem.poses.len(),
        frames.left_out.len(),
        problem.centers.len()
    );
    let solver = SolverOptions { max_iterations, ..options.solver() };
    let mut refinement = solver::refine(problem, cost, &solver, progress)?;
    check_refined(&refinement)?;
    for _ in 0..if rough { 0 } else { MAX_RECONSIDERATIONS } {
        if refinement.termination == Termination::Stopped {
            break;
        }
        let refined = at_end(problem, Some(&refinement));
        // If a repetition fails, the present result stands.
        let Ok(Some(poses)) = reconsidered_poses(&refined, frames, cost, &options.solver()) else {
            break;
        };
        info!("refining again with the opposite tilt of some boards");
        let done = refinement.iterations.len().saturating_sub(1);
        let max_iterations = max_iterations.saturating_sub(done);
        if max_iterations == 0 {
            break;
        }
        let poses: Vec<Isometry3<f64>> = poses.iter().map(|p| p.camera_from_board).collect();
        let again = Problem { poses: &poses, ..refined };
        let solver = SolverOptions { max_iterations, ..options.solver() };
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
