//! The calibration as one stage: from observations to a refined camera (paper, section 5.3).

use nalgebra::Isometry3;

use crate::bridge::{self, Problem};
use crate::calibration::frames::{Frames, feature_residuals, initial_frames, solver_features};
use crate::calibration::{
    Calibration, CalibrationOptions, FramePose, Iteration, Mode, Refinement, Start, Termination,
    initial_camera,
};
use crate::camera::{Board, PlenopticCamera, intrinsic_parameters};
use crate::error::{Error, Result};
use crate::evaluation::{CenterResidual, Reprojection};
use crate::observations::{MicroImageCenter, Observations};
use crate::precalibration::{MicroImageArray, fit_grid};

/// The minimum counts as reached when one more Gauss-Newton step would gain less than this part of
/// the cost: the parameters are then within 10⁻³ of their standard deviations for as many
/// observations as a calibration has.
const MAX_EXPECTED_DECREASE: f64 = 1e-9;
/// Below this part of ½ per residual, px², a cost is zero up to rounding: (10⁻⁶ px)²/2.
const ZERO_COST_PER_RESIDUAL_PX2: f64 = 0.5e-12;
/// Boards tilted by less than this, rad (5°), look alike in a projection.
const FRONTO_PARALLEL_RAD: f64 = 0.087;

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
    let mut warnings = Vec::new();
    let start = start.for_mode(options.mode);
    options.validate(&start)?;
    start.validate()?;
    check_observations(&start, board, observations, options.mode)?;

    let grid = match observations.centers.as_slice() {
        [] => None,
        centers => {
            let (kind, columns, rows) = start.array();
            Some(fit_grid(centers, kind, columns, rows)?)
        }
    };
    if let Some(grid) = grid.filter(|grid| grid.outliers > 0) {
        warnings.push(format!(
            "{} of {} micro-image centres lie far from the grid (its RMS is {:.3} px); they are \
             kept, a robust loss (--loss) lessens their weight",
            grid.outliers,
            observations.centers.len(),
            grid.rms_px
        ));
    }
    let initial = start_camera(&start, grid.as_ref())?;
    let Frames { poses, features: used, left_out } =
        initial_frames(&initial, board, observations, &options.cost, &options.solver)?;
    if poses.is_empty() {
        let reasons: Vec<String> =
            left_out.iter().map(|l| format!("frame {}: {}", l.frame, l.reason)).collect();
        return Err(Error::invalid(format!("no frame could be used: {}", reasons.join("; "))));
    }

    let features = solver_features(&used, &poses, board);
    let start_poses: Vec<Isometry3<f64>> = poses.iter().map(|p| p.camera_from_board).collect();
    let problem = Problem {
        camera: &initial,
        poses: &start_poses,
        features: &features,
        centers: &observations.centers,
    };
    let initial_centers =
        Reprojection { features: Vec::new(), centers: center_residuals(&problem)? };
    let mut cost = options.cost.clone();
    if options.mode == Mode::PosesOnly {
        let all = intrinsic_parameters(initial.lens_types());
        cost.held = all.into_iter().map(|parameter| parameter.name).collect();
    }
    let refinement = bridge::refine(&problem, &cost, &options.solver, progress)?;
    check_finite(&refinement)?;

    let refined = Problem { camera: &refinement.camera, poses: &refinement.poses, ..problem };
    let uncertainty = bridge::uncertainty(&refined, &cost)?;
    let reprojection = Reprojection {
        features: feature_residuals(&refined, &used)?,
        centers: center_residuals(&refined)?,
    };
    let residuals = 3 * features.len() + 2 * observations.centers.len();
    let negligible = (MAX_EXPECTED_DECREASE * refinement.cost)
        .max(ZERO_COST_PER_RESIDUAL_PX2 * residuals as f64);
    let converged = refinement.termination == Termination::Converged
        && uncertainty.expected_decrease <= negligible;
    if uncertainty.rank < uncertainty.size() {
        warnings.push(format!(
            "the observations determine {} of {} parameters: {} direction(s) of parameter space \
             are free, and standard deviations hold only for what is determined; hold a parameter \
             (--fix) or add frames at other distances and tilts",
            uncertainty.rank,
            uncertainty.size(),
            uncertainty.size() - uncertainty.rank
        ));
    }
    let poses: Vec<FramePose> = poses
        .iter()
        .zip(&refinement.poses)
        .map(|(p, &camera_from_board)| FramePose { frame: p.frame, camera_from_board })
        .collect();
    warnings.extend(fronto_parallel(&poses, options.mode));
    Ok(Calibration {
        camera: refinement.camera.clone(),
        initial,
        poses,
        left_out,
        grid,
        initial_centers_rmse_px: initial_centers.centers_rmse_px(),
        refinement,
        reprojection,
        uncertainty,
        converged,
        warnings,
    })
}

fn check_observations(
    start: &Start,
    board: &Board,
    observations: &Observations,
    mode: Mode,
) -> Result<()> {
    board.validate()?;
    let (_, columns, rows) = start.array();
    observations.validate(start.sensor(), (columns, rows), board, start.lens_types() > 0)?;
    if observations.features.is_empty() {
        return Err(Error::invalid("there are no features"));
    }
    if observations.centers.is_empty() && mode != Mode::PosesOnly {
        return Err(Error::invalid(
            "there are no micro-image centres: without them the array's place is not determined; \
             give them (--centers)",
        ));
    }
    Ok(())
}

fn start_camera(start: &Start, grid: Option<&MicroImageArray>) -> Result<PlenopticCamera> {
    match (start, grid) {
        (Start::Datasheet(datasheet, internal), Some(grid)) => {
            initial_camera(datasheet, internal, grid)
        }
        (Start::Datasheet(..), None) => Err(Error::invalid("there are no micro-image centres")),
        (Start::Camera(camera), Some(grid)) if camera.lattice != grid.lattice => {
            Err(Error::invalid(format!(
                "the camera's shifted rows are those of {:?} index, but the centres show the \
                 {:?} ones shifted: they are of different cameras",
                camera.lattice.shifted, grid.lattice.shifted
            )))
        }
        (Start::Camera(camera), _) => Ok(camera.clone()),
    }
}

fn fronto_parallel(poses: &[FramePose], mode: Mode) -> Option<String> {
    let tilt = |p: &FramePose| {
        let normal = p.camera_from_board.rotation * nalgebra::Vector3::z();
        normal.z.abs().min(1.0).acos()
    };
    let largest = poses.iter().map(tilt).fold(0.0, f64::max);
    (mode != Mode::PosesOnly && largest < FRONTO_PARALLEL_RAD).then(|| {
        format!(
            "all boards are fronto-parallel (tilted by at most {:.1} degrees): the focal length F \
             and the distance of the boards can hardly be separated; add tilted boards (20 to 40 \
             degrees)",
            largest.to_degrees()
        )
    })
}

fn center_residuals(problem: &Problem) -> Result<Vec<CenterResidual>> {
    let residual = |(&center, [u, v]): (&MicroImageCenter, [f64; 2])| CenterResidual {
        center,
        lens_type: problem.camera.lens_type(center.k, center.l),
        du_px: center.u_px - u,
        dv_px: center.v_px - v,
    };
    Ok(problem.centers.iter().zip(bridge::project_centers(problem)?).map(residual).collect())
}

fn check_finite(refinement: &Refinement) -> Result<()> {
    let finite = refinement.cost.is_finite()
        && refinement.camera.intrinsics().iter().all(|v| v.is_finite())
        && refinement.poses.iter().all(|p| p.to_homogeneous().iter().all(|v| v.is_finite()));
    if finite {
        Ok(())
    } else {
        Err(Error::invalid(format!("the refinement failed: {}", refinement.message)))
    }
}
