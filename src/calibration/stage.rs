//! The calibration as one stage: from observations to a refined camera.

use nalgebra::Isometry3;
use tracing::debug;

use crate::calibration::board::{Settled, findings_of};
use crate::calibration::frames::{Frames, feature_residuals, solver_centers, solver_features};
use crate::calibration::outlying::{LOSS_SCALE, loss_by_residuals};
use crate::calibration::prepare::{Prepared, Solution, prepared};
use crate::calibration::priors::{contradicted, priors, results, with_far_prior};
use crate::calibration::refine::{Refined, Settings, at_end};
use crate::calibration::systematic_errors::systematic_errors;
use crate::calibration::{
    BlurMeasurement, BoardResult, Calibration, CalibrationOptions, LeftOut, Mode, PriorSource,
    SolvedProblem, Start,
};
use crate::checks::calibration as checks;
use crate::error::Result;
use crate::finding::Finding;
use crate::model::{
    BentBoard, Board, BoardShape, CenterResidual, FramePose, MicroImageCenter, Observations,
    Parameter, PlenopticCamera, Reprojection,
};
use crate::solver::{
    self, CostOptions, Iteration, LossKind, Prior, Problem, Refinement, Termination, Uncertainty,
};

/// Largest relative decrease of the cost by one more Gauss-Newton step at a minimum. A parameter n standard deviations
/// off adds n² s²/2 to the cost, where s² is the variance of the residuals that determine it: with 10⁵ residuals of
/// similar variance n < 10⁻³.
const MAX_EXPECTED_DECREASE: f64 = 1e-11;
/// Cost per (standardised) residual that is zero up to rounding: (10⁻⁶)²/2.
const ZERO_COST_PER_RESIDUAL: f64 = 0.5e-12;

/// Calibrates a camera, or with [`Mode::PosesOnly`] finds the poses of the boards.
///
/// `progress` is called after every iteration and stops the solve by returning false.
///
/// Returns an error if the input is inconsistent or no frame can be used.
pub fn calibrate(
    start: &Start,
    board: &Board,
    observations: &Observations,
    options: &CalibrationOptions,
    progress: &mut dyn FnMut(&Iteration) -> bool,
) -> Result<Calibration> {
    let options = options.of_start(start);
    let prepared = prepared(start, board, observations, &options)?;
    let board = BentBoard { board: *board, shape: options.known_shape() };
    completed(prepared, board, &options, None, progress)
}

/// Evaluates the cost that [`calibrate`] minimises at a solution that may come from elsewhere. Returns the result of a
/// calibration that ended there. Its [`uncertainty`](Calibration::uncertainty) tells the gain of one more step. A free
/// shape of the board keeps the value of the options.
///
/// Returns an error like [`calibrate`], and if camera and observations do not belong together.
pub fn cost_at(
    solution: &Solution,
    start: &Start,
    board: &Board,
    observations: &Observations,
    options: &CalibrationOptions,
) -> Result<Calibration> {
    let options = options.of_start(start);
    let prepared = prepared(start, board, observations, &options)?;
    let board = BentBoard { board: *board, shape: options.known_shape() };
    completed(prepared, board, &options, Some(solution), &mut |_| true)
}

/// Evaluates the cost of a problem at a solution, like [`cost_at`]. The problem gives observations, weights, loss,
/// priors and free parameters. `shape` is the shape of the board at the solution.
///
/// Returns an error if the numbers of the problem are impossible, or if it and the solution do not belong together.
pub fn cost_of_problem_at(
    problem: &SolvedProblem,
    solution: &Solution,
    shape: BoardShape,
    threads: usize,
) -> Result<Calibration> {
    let options = CalibrationOptions { threads, ..problem.options(shape) };
    let prepared = Prepared::of_problem(problem, &options)?;
    let board = BentBoard { shape, ..problem.board };
    completed(prepared, board, &options, Some(solution), &mut |_| true)
}

/// Completes a calibration from its start, or evaluates the cost at a solution.
fn completed(
    prepared: Prepared,
    board: BentBoard,
    options: &CalibrationOptions,
    at: Option<&Solution>,
    progress: &mut dyn FnMut(&Iteration) -> bool,
) -> Result<Calibration> {
    let _span = tracing::info_span!("calibration").entered();
    let (initial, frames) = prepared.placed(&board, options, at)?;
    let Prepared { start, grid, blur, misfocused, observations, cost: known, .. } = prepared;
    let features = solver_features(&frames.features, &frames.poses, &board.board);
    let centers = solver_centers(&observations.centers);
    let poses: Vec<Isometry3<f64>> = frames.poses.iter().map(|p| p.camera_from_board).collect();
    let problem =
        Problem { camera: &initial, board, poses: &poses, features: &features, centers: &centers };
    let of_problem = known.is_some();
    let priors = match &known {
        Some(cost) => cost.priors.iter().map(|p| (p.clone(), PriorSource::Stated)).collect(),
        None => priors(&start, options),
    };
    let mut cost = known.unwrap_or_else(|| cost_for(options, &initial, &observations, &priors));
    let all = (frames.features.as_slice(), observations.centers.as_slice());
    let systematic = systematic_errors(&start, &initial, all, &cost, options)?;
    let tries_shape = observations.shifted_frames.is_empty();
    let settings =
        Settings { frames: &frames, tries_shape, options, systematic, known_weight: None };
    let (settled, outlying) = match at {
        Some(_) => (settings.evaluated(&problem, &cost, &priors, !of_problem)?, None),
        None => withstanding(&settings, &problem, &mut cost, &priors, progress)
            .map_err(|error| with_far_prior(error, &priors, &problem))?,
    };
    let Settled { refined, priors, trial, aside } = settled;
    let Refined { refinement, uncertainty, cost } = refined;

    let refined = at_end(&problem, Some(&refinement));
    let std_devs = uncertainty.shape_std_devs(initial.lens_types());
    let board = BoardResult { bent: refined.board, std_devs, trial, aside };
    let reprojection = Reprojection {
        features: feature_residuals(&refined, &frames.features)?,
        centers: center_residuals(&refinement.camera, &observations.centers)?,
    };
    let poses = refined_poses(&frames, &refinement);
    let converged = (at.is_some() || refinement.termination == Termination::Converged)
        && is_minimum(&refinement, &uncertainty, &reprojection);
    let results = results(priors, &refinement.camera, &refinement.shape);
    let estimates_camera = options.mode != Mode::PosesOnly;
    let given = at.map_or(&options.poses, |at| &at.poses);
    let mut findings: Vec<Finding> = grid
        .as_ref()
        .and_then(|g| checks::outlying_centers(g.outliers, observations.centers.len(), g.rms_px))
        .into_iter()
        .chain(checks::array_beyond_image(&initial))
        .chain(misfocused)
        .chain(outlying)
        .chain(contradicted(&results))
        .chain(checks::undetermined(&refinement.camera, &uncertainty))
        .chain(checks::fit(&refinement.camera, &reprojection))
        .chain(checks::poses_of_no_frame(given, &observations))
        .chain(blur.as_ref().and_then(BlurMeasurement::contradiction))
        .chain(frames.left_out.iter().map(LeftOut::finding))
        .collect();
    if estimates_camera {
        findings.extend(checks::fronto_parallel(&poses));
        findings.extend(findings_of(&board));
    }
    Ok(Calibration {
        camera: refinement.camera.clone(),
        board,
        m_mm: start.internal().map(|internal| internal.m_mm),
        poses,
        initial_poses: frames.poses,
        left_out: frames.left_out,
        grid,
        initial_centers_rmse_px: initial_centers_rmse(&initial, &observations)?,
        shifted_frames: observations.shifted_frames,
        initial,
        refinement,
        reprojection,
        uncertainty,
        converged,
        options: options.clone(),
        priors: results,
        blur,
        cost,
        findings,
    })
}

/// Refines. If the options leave the loss open and features state no σ, there is no loss at first. If some features are
/// then outliers, refines once more with a loss, and returns a finding.
fn withstanding(
    settings: &Settings,
    problem: &Problem,
    cost: &mut CostOptions,
    priors: &[(Prior, PriorSource)],
    progress: &mut dyn FnMut(&Iteration) -> bool,
) -> Result<(Settled, Option<Finding>)> {
    let settled = settings.refine_with_board(problem, cost, priors, progress)?;
    let refinement = &settled.refined.refinement;
    let has_loss = settings.options.loss.is_some() || cost.loss.kind != LossKind::None;
    if has_loss || refinement.termination == Termination::Stopped {
        return Ok((settled, None));
    }
    let refined = at_end(problem, Some(refinement));
    let residuals = feature_residuals(&refined, &settings.frames.features)?;
    let Some((loss, finding)) = loss_by_residuals(&residuals, cost) else {
        return Ok((settled, None));
    };
    debug!("{finding}");
    cost.loss = loss;
    Ok((settings.refine_with_board(problem, cost, priors, progress)?, Some(finding)))
}

pub(super) fn center_residuals(
    camera: &PlenopticCamera,
    centers: &[MicroImageCenter],
) -> Result<Vec<CenterResidual>> {
    let projected = solver::project_centers(camera, centers.iter().map(|c| (c.k, c.l)))?;
    let residual = |(&center, [u, v]): (&MicroImageCenter, [f64; 2])| CenterResidual {
        center,
        lens_type: camera.lens_type(center.k, center.l),
        du_px: center.u_px - u,
        dv_px: center.v_px - v,
    };
    Ok(centers.iter().zip(projected).map(residual).collect())
}

/// Returns the cost with its parts that depend on the input: default priors, and the loss.
fn cost_for(
    options: &CalibrationOptions,
    camera: &PlenopticCamera,
    observations: &Observations,
    priors: &[(Prior, PriorSource)],
) -> CostOptions {
    let mut cost = options.cost();
    cost.priors = priors.iter().map(|(prior, _)| prior.clone()).collect();
    if options.loss.is_none() {
        let stated = observations.features.iter().all(|f| f.std_dev_px.is_some());
        cost.loss.kind = if stated { LossKind::Huber } else { LossKind::None };
        cost.loss.scale = LOSS_SCALE;
    }
    if options.mode == Mode::PosesOnly {
        let all = Parameter::shared(camera.lens_types());
        cost.fixed = all.iter().map(|parameter| parameter.name().to_owned()).collect();
    }
    cost
}

fn initial_centers_rmse(
    initial: &PlenopticCamera,
    observations: &Observations,
) -> Result<Option<f64>> {
    let centers = center_residuals(initial, &observations.centers)?;
    Ok(Reprojection { features: Vec::new(), centers }.centers_rmse_px())
}

fn refined_poses(frames: &Frames, refinement: &Refinement) -> Vec<FramePose> {
    let pose = |(p, &camera_from_board): (&FramePose, &Isometry3<f64>)| FramePose {
        frame: p.frame,
        camera_from_board,
    };
    frames.poses.iter().zip(&refinement.poses).map(pose).collect()
}

/// Returns true if a further step would not lower the cost noticeably.
fn is_minimum(
    refinement: &Refinement,
    uncertainty: &Uncertainty,
    reprojection: &Reprojection,
) -> bool {
    debug!(
        "a further step would lower the cost by {:.3e}; rank {} of the information",
        uncertainty.expected_decrease, uncertainty.rank
    );
    let residuals = 3 * reprojection.features.len() + 2 * reprojection.centers.len();
    let negligible =
        (MAX_EXPECTED_DECREASE * refinement.cost).max(ZERO_COST_PER_RESIDUAL * residuals as f64);
    uncertainty.expected_decrease <= negligible
}
