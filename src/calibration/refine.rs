//! The calibration as one stage: from observations to a refined camera (paper, section 5.3).

use nalgebra::Isometry3;
use tracing::{debug, info};

use crate::calibration::checks::{
    array_beyond_image, bad_fit, check_indices, check_observations, check_refined, fronto_parallel,
    outlying_centers, undetermined, without_frames,
};
use crate::calibration::frames::{
    Frames, feature_residuals, initial_frames, reconsidered_poses, solver_centers, solver_features,
};
use crate::calibration::{Calibration, CalibrationOptions, Mode, Start, initial_camera};
use crate::error::{Error, Result};
use crate::model::{
    Board, CenterResidual, FramePose, MicroImageCenter, Observations, PlenopticCamera,
    Reprojection, intrinsic_parameters,
};
use crate::precalibration::{MicroImageArray, check_stated_pitch, fit_grid};
use crate::solver::{
    self, CostOptions, Iteration, Problem, Refinement, SolverOptions, Termination,
};

/// The minimum counts as reached when one more Gauss-Newton step would gain less than this part of
/// the cost. A parameter n standard deviations from its place adds n² s²/2 to the cost, s² being the
/// variance of the residuals that determine it: with 10⁵ residuals of like variance n < 10⁻³.
const MAX_EXPECTED_DECREASE: f64 = 1e-11;
/// Boards found to lean the other way bring others to light; it has to end.
const MAX_RECONSIDERATIONS: usize = 4;
/// Below this for every (standardised) residual a cost is zero up to rounding: (10⁻⁶)²/2.
const ZERO_COST_PER_RESIDUAL: f64 = 0.5e-12;

/// Calibrates a camera, or with [`Mode::PosesOnly`] finds the poses of the boards.
///
/// `progress` is called after every iteration and stops the solve by returning false.
///
/// An error if the input is inconsistent or no frame can be used.
pub fn calibrate(
    start: &Start,
    board: &Board,
    observations: &Observations,
    options: &CalibrationOptions,
    progress: &mut dyn FnMut(&Iteration) -> bool,
) -> Result<Calibration> {
    let _span = tracing::info_span!("calibration").entered();
    let mut warnings = Vec::new();
    let start = start.for_mode(options.mode);
    start.validate()?;
    options.validate(&start)?;
    let (observations, excluded) = without_frames(observations, &options.exclude_frames)?;
    let observations = &observations;
    check_observations(&start, board, observations, options.mode)?;

    let grid = fitted_grid(&start, observations)?;
    if let Some(grid) = &grid {
        if let Start::Datasheet(sheet, internal) = &start {
            check_stated_pitch(sheet, internal, grid)?;
        }
        warnings.extend(outlying_centers(grid, observations.centers.len()));
    }
    let initial = start_camera(&start, grid.as_ref())?;
    check_indices(&initial, grid.as_ref(), observations)?;
    warnings.extend(array_beyond_image(&initial));
    let mut frames = initial_frames(&initial, board, observations, &options.cost, &options.solver)?;
    if frames.poses.is_empty() {
        let reasons: Vec<String> =
            frames.left_out.iter().map(|l| format!("frame {}: {}", l.frame, l.reason)).collect();
        return Err(Error::invalid(format!("no frame could be used: {}", reasons.join("; "))));
    }
    frames.left_out.extend(excluded);

    let features = solver_features(&frames.features, &frames.poses, board);
    let centers = solver_centers(&observations.centers);
    let start_poses: Vec<Isometry3<f64>> =
        frames.poses.iter().map(|p| p.camera_from_board).collect();
    let problem =
        Problem { camera: &initial, poses: &start_poses, features: &features, centers: &centers };
    let initial_centers = Reprojection {
        features: Vec::new(),
        centers: center_residuals(&initial, &observations.centers)?,
    };
    let mut cost = options.cost.clone();
    if options.mode == Mode::PosesOnly {
        let all = intrinsic_parameters(initial.lens_types());
        cost.fixed = all.iter().map(|parameter| parameter.name.to_owned()).collect();
    }
    let refinement = refine(&problem, board, &frames, &cost, options, progress)?;

    let refined = Problem { camera: &refinement.camera, poses: &refinement.poses, ..problem };
    let uncertainty = solver::uncertainty(&refined, &cost)?;
    debug!(
        "a further step would lower the cost by {:.3e}; rank {} of the information",
        uncertainty.expected_decrease, uncertainty.rank
    );
    let reprojection = Reprojection {
        features: feature_residuals(&refined, &frames.features)?,
        centers: center_residuals(&refinement.camera, &observations.centers)?,
    };
    let residuals = 3 * features.len() + 2 * observations.centers.len();
    let negligible =
        (MAX_EXPECTED_DECREASE * refinement.cost).max(ZERO_COST_PER_RESIDUAL * residuals as f64);
    let converged = refinement.termination == Termination::Converged
        && uncertainty.expected_decrease <= negligible;
    warnings.extend(undetermined(&refinement.camera, &uncertainty));
    warnings.extend(bad_fit(&refinement.camera, &reprojection));
    let poses: Vec<FramePose> = frames
        .poses
        .iter()
        .zip(&refinement.poses)
        .map(|(p, &camera_from_board)| FramePose { frame: p.frame, camera_from_board })
        .collect();
    warnings.extend(fronto_parallel(&poses, options.mode));
    Ok(Calibration {
        camera: refinement.camera.clone(),
        initial,
        m_mm: match &start {
            Start::Datasheet(_, internal) => Some(internal.m_mm),
            Start::Camera(_) => None,
        },
        poses,
        left_out: frames.left_out,
        grid,
        initial_centers_rmse_px: initial_centers.centers_rmse_px(),
        refinement,
        reprojection,
        uncertainty,
        converged,
        options: options.clone(),
        warnings,
    })
}

/// The camera that a calibration of these observations starts from.
pub fn initial_from(start: &Start, observations: &Observations) -> Result<PlenopticCamera> {
    start_camera(start, fitted_grid(start, observations)?.as_ref())
}

fn fitted_grid(start: &Start, observations: &Observations) -> Result<Option<MicroImageArray>> {
    let (kind, columns, rows) = start.array();
    let centers = &observations.centers;
    (!centers.is_empty()).then(|| fit_grid(centers, kind, columns, rows)).transpose()
}

/// Refines, and again for boards that turn out to lean the other way.
fn refine(
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
        // Whatever fails on the way is no better than what there is.
        let Ok(Some(poses)) =
            reconsidered_poses(camera, board, frames, poses, &options.cost, &options.solver)
        else {
            break;
        };
        info!("boards that may lean the other way are reconsidered");
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
        "cost {:.6} (at the start {:.6}) after {} iterations in {:.3} s",
        refinement.cost,
        refinement.initial_cost,
        refinement.iterations.len().saturating_sub(1),
        refinement.time_s
    );
    Ok(refinement)
}

fn start_camera(start: &Start, grid: Option<&MicroImageArray>) -> Result<PlenopticCamera> {
    match (start, grid) {
        (Start::Datasheet(datasheet, internal), Some(grid)) => {
            initial_camera(datasheet, internal, grid)
        }
        (Start::Datasheet(..), None) => Err(Error::invalid("there are no micro-image centres")),
        (Start::Camera(camera), Some(grid)) if camera.lattice != grid.lattice => {
            Err(Error::invalid(format!(
                "the camera has the lattice {:?}, but the centres lie on {:?}: they are of different \
                 cameras",
                camera.lattice, grid.lattice
            )))
        }
        (Start::Camera(camera), _) => Ok(camera.clone()),
    }
}

fn center_residuals(
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
