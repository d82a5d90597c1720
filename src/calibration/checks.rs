//! Checks before and after the refinement: whether camera and observations belong together, and
//! warnings about the result.

use crate::calibration::{CalibrationOptions, LeftOut, Mode, NoPose, Start, Warning};
use crate::error::{Error, Result};
use crate::model::{
    BapFeature, Board, FramePose, Observations, PlenopticCamera, Reprojection, shared_parameters,
};
use crate::precalibration::MicroImageArray;
use crate::solver::{self, LossKind, Refinement, Uncertainty};

/// Boards tilted by less than this, rad (5°), can hardly be distinguished in a projection.
const FRONTO_PARALLEL_RAD: f64 = 0.087;
/// A reprojection error above this fraction of the micro-image pitch is not noise of a detector. On
/// the R12 the limit is 2.3 px; real data have 0.9 px.
const BAD_FIT: f64 = 0.1;
/// A model that explains the blur radii leaves residuals below this fraction of their spread.
const UNEXPLAINED_RHO: f64 = 0.5;
/// An array may be larger than the image by this factor.
const ARRAY_OVER_IMAGE: f64 = 1.5;

/// The observations without the given frames, and those frames.
pub(super) fn without_frames(
    observations: &Observations,
    frames: &[u32],
) -> Result<(Observations, Vec<LeftOut>)> {
    let known = observations.frames();
    if let Some(frame) = frames.iter().find(|frame| !known.contains(frame)) {
        return Err(Error::invalid(format!(
            "frame {frame} is to be left out, but it does not exist; the frames are {known:?}"
        )));
    }
    let (out, kept): (Vec<BapFeature>, Vec<BapFeature>) =
        observations.features.iter().partition(|f| frames.contains(&f.frame));
    let excluded = known.into_iter().filter(|frame| frames.contains(frame)).map(|frame| LeftOut {
        frame,
        features: out.iter().filter(|f| f.frame == frame).count(),
        reason: NoPose::Excluded,
    });
    Ok((Observations { centers: observations.centers.clone(), features: kept }, excluded.collect()))
}

/// Losses act where residuals are; these are not much smaller than 1.
const LEAST_SCALE: f64 = 0.01;

/// An error unless there is enough to calibrate from, and every observation is possible.
pub(super) fn check_observations(
    start: &Start,
    board: &Board,
    observations: &Observations,
    options: &CalibrationOptions,
) -> Result<()> {
    board.validate()?;
    let (_, size) = start.array(&observations.centers);
    let needs_rho = options.cost.rho && start.lens_types() > 0;
    observations.validate(start.sensor(), size, board, needs_rho)?;
    if observations.features.is_empty() {
        return Err(Error::invalid(if options.exclude_frames.is_empty() {
            "there are no features"
        } else {
            "there are no features: all frames that have some are left out (exclude_frames)"
        }));
    }
    let loss = options.cost.loss;
    if loss.kind != LossKind::None && loss.scale < LEAST_SCALE {
        return Err(Error::invalid(format!(
            "with a loss scale of {} nothing that has noise counts: it is the residual, in standard deviations (px where \
             observations have none), beyond which an observation counts less; 2 to 5 is usual",
            loss.scale
        )));
    }
    if observations.centers.is_empty() && options.mode != Mode::PosesOnly {
        return Err(Error::NoCenters);
    }
    Ok(())
}

/// An error if a feature lies far from the micro-image whose index it has. Centres are those of the
/// grid, or, without one, those of the camera.
pub(super) fn check_indices(
    camera: &PlenopticCamera,
    grid: Option<&MicroImageArray>,
    observations: &Observations,
) -> Result<()> {
    let features = &observations.features;
    let (centers, pitch) = if let Some(grid) = grid {
        (features.iter().map(|f| grid.center_of(f.k, f.l).into()).collect(), grid.pitch_px)
    } else {
        let named = features.iter().map(|f| (f.k, f.l));
        (solver::project_centers(camera, named)?, camera.micro_image_pitch_px())
    };
    let mut far = features
        .iter()
        .zip(centers)
        .map(|(f, [u, v])| (f, (f.u_px - u).hypot(f.v_px - v)))
        .filter(|(_, distance)| *distance > pitch);
    let Some((f, distance)) = far.next() else { return Ok(()) };
    Err(Error::invalid(format!(
        "corner {} of frame {} is {distance:.0} px from the centre of its micro-image ({}, {}), and {} \
         more features are too far from theirs; a micro-image is {pitch:.1} px wide, so indices and \
         positions do not belong together",
        f.corner,
        f.frame,
        f.k,
        f.l,
        far.count()
    )))
}

/// An error if the refined camera or a pose is impossible.
pub(super) fn check_refined(refinement: &Refinement) -> Result<()> {
    let poses = refinement.poses.iter().all(|p| p.to_homogeneous().iter().all(|v| v.is_finite()));
    let reason = match refinement.camera.validate() {
        Err(error) => error.to_string(),
        Ok(()) if !refinement.cost.is_finite() => format!("the cost is {}", refinement.cost),
        Ok(()) if !poses => "a pose is not finite".to_owned(),
        Ok(()) => return Ok(()),
    };
    Err(Error::invalid(format!(
        "the refinement diverged ({reason}): the observations do not fit this camera and board; \
         check the focus distance (focus_distance_mm), the size of the squares (square_mm) and the frames"
    )))
}

/// A warning if centres lie far from the grid.
pub(super) fn outlying_centers(grid: &MicroImageArray, centers: usize) -> Option<Warning> {
    let (outliers, grid_rms_px) = (grid.outliers, grid.rms_px);
    (outliers > 0).then_some(Warning::OutlyingCenters { outliers, centers, grid_rms_px })
}

/// A warning if the array extends far beyond the image.
pub(super) fn array_beyond_image(camera: &PlenopticCamera) -> Option<Warning> {
    let (lattice, sensor) = (&camera.lattice, &camera.sensor);
    let extent = camera.micro_image_pitch_px()
        * (lattice.node(lattice.columns - 1, lattice.rows - 1) - lattice.node(0, 0));
    let beyond = |extent: f64, image: u32| extent > ARRAY_OVER_IMAGE * f64::from(image);
    (beyond(extent.x, sensor.width_px) || beyond(extent.y, sensor.height_px)).then_some(
        Warning::ArrayBeyondImage {
            array: (lattice.columns, lattice.rows),
            extent_px: (extent.x, extent.y),
            image_px: (sensor.width_px, sensor.height_px),
        },
    )
}

/// A warning if the observations do not determine all parameters.
pub(super) fn undetermined(camera: &PlenopticCamera, uncertainty: &Uncertainty) -> Option<Warning> {
    let (rank, parameters) = (uncertainty.rank, uncertainty.size());
    if rank == parameters {
        return None;
    }
    let all = shared_parameters(camera.lens_types());
    let names = uncertainty.undetermined_intrinsics().into_iter().map(|i| all[i].name).collect();
    Some(Warning::Undetermined { rank, parameters, names })
}

/// A warning if noise cannot explain the residuals.
pub(super) fn bad_fit(camera: &PlenopticCamera, reprojection: &Reprojection) -> Option<Warning> {
    let (rmse, micro_image_pitch_px) = (reprojection.rmse(), camera.micro_image_pitch_px());
    if rmse.all_px > BAD_FIT * micro_image_pitch_px {
        return Some(Warning::BadFit { rms_px: rmse.all_px, micro_image_pitch_px });
    }
    let count = rmse.count as f64;
    let radii = || reprojection.features.iter().filter_map(|r| r.feature.rho_px);
    let mean = radii().sum::<f64>() / count;
    let spread_px = (radii().map(|rho| (rho - mean).powi(2)).sum::<f64>() / count).sqrt();
    let rms_px = rmse.rho_px.filter(|rms_px| *rms_px > UNEXPLAINED_RHO * spread_px)?;
    Some(Warning::UnexplainedBlur { rms_px, spread_px })
}

/// A warning if F and the distance of the boards can hardly be separated.
pub(super) fn fronto_parallel(poses: &[FramePose], mode: Mode) -> Option<Warning> {
    let tilt = |p: &FramePose| {
        let normal = p.camera_from_board.rotation * nalgebra::Vector3::z();
        normal.z.abs().min(1.0).acos()
    };
    let largest = poses.iter().map(tilt).fold(0.0, f64::max);
    let largest_tilt_deg = largest.to_degrees();
    (mode != Mode::PosesOnly && largest < FRONTO_PARALLEL_RAD)
        .then_some(Warning::FrontoParallel { largest_tilt_deg })
}
