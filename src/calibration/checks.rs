//! Checks before and after the refinement, and whether camera and observations belong together.

use crate::calibration::numbering::check_numbering;
use crate::calibration::{BoardModel, CalibrationOptions, LeftOut, Mode, Start};
use crate::error::{Error, Observed, Result};
use crate::finding::{Issue, list};
use crate::model::{BapFeature, Board, Observations, Parameter, PlenopticCamera, Sensor};
use crate::precalibration::MicroImageArray;
use crate::solver::{self, LossKind, Refinement};

/// Returns the observations without the given frames, and those frames.
pub(super) fn without_frames(
    observations: &Observations,
    frames: &[u32],
) -> Result<(Observations, Vec<LeftOut>)> {
    let known = observations.frames();
    if let Some(frame) = frames.iter().find(|frame| !known.contains(frame)) {
        return Err(Error::invalid(format!(
            "frame {frame} cannot be excluded, because it does not exist; the frames are {known:?}"
        )));
    }
    let (out, kept): (Vec<BapFeature>, Vec<BapFeature>) =
        observations.features.iter().partition(|f| frames.contains(&f.frame));
    let excluded = known.into_iter().filter(|frame| frames.contains(frame)).map(|frame| LeftOut {
        frame,
        features: out.iter().filter(|f| f.frame == frame).count(),
        reason: Issue::Excluded,
    });
    let shifted = observations.shifted_frames.iter().filter(|frame| !frames.contains(frame));
    let kept = Observations {
        features: kept,
        shifted_frames: shifted.copied().collect(),
        ..observations.clone()
    };
    Ok((kept, excluded.collect()))
}

/// Smallest scale of a loss. A loss acts where residuals are, and these are not much smaller than 1.
const LEAST_SCALE: f64 = 0.01;

/// Returns an error unless there is enough to calibrate from, and every observation is possible.
pub(super) fn check_observations(
    start: &Start,
    board: &Board,
    observations: &Observations,
    options: &CalibrationOptions,
) -> Result<()> {
    board.validate()?;
    let (_, size) = start.array(&observations.centers);
    let needs_rho = options.has_rho() && start.lens_types() > 0;
    observations.validate(start.sensor(), size, board, needs_rho)?;
    check_axis(observations, start.sensor())?;
    check_shifted(observations, options)?;
    check_numbering(&observations.features, board)?;
    if observations.features.is_empty() {
        return Err(Error::invalid(if options.exclude_frames.is_empty() {
            "there are no features"
        } else {
            "there are no features: all frames with features are excluded (exclude_frames)"
        }));
    }
    let loss = options.cost().loss;
    if loss.kind != LossKind::None && loss.scale < LEAST_SCALE {
        return Err(Error::invalid(format!(
            "a loss scale of {} suppresses all observations with noise: give the residual, in \
             standard deviations (px without them), beyond which an observation counts less; 2 to \
             5 is usual",
            loss.scale
        )));
    }
    if observations.centers.is_empty() && options.mode != Mode::PosesOnly {
        return Err(Error::NoCenters);
    }
    Ok(())
}

/// Returns an error if a bent board is to be estimated from frames that do not show which way round it is.
fn check_shifted(observations: &Observations, options: &CalibrationOptions) -> Result<()> {
    let frames: Vec<u32> = observations.shifted_frames.iter().copied().collect();
    let has_prior = Parameter::SHAPE.iter().any(|parameter| options.priors.knows(parameter.name()));
    let is_bent = options.board == BoardModel::Bent || has_prior;
    if frames.is_empty() || !is_bent {
        return Ok(());
    }
    Err(Error::invalid(format!(
        "the board fills the view in frames {}: these do not show which way round it is, so its shape \
         cannot be estimated. Exclude these frames (exclude_frames), or state a flat board \
         (board = \"flat\")",
        list(&frames)
    )))
}

/// Returns an error if the optical axis of the observations is far outside the image.
fn check_axis(observations: &Observations, sensor: &Sensor) -> Result<()> {
    let far_px = f64::from(sensor.width_px) + f64::from(sensor.height_px);
    let Some(axis) =
        observations.axis_px.filter(|axis| (axis - sensor.center_px()).norm() > far_px)
    else {
        return Ok(());
    };
    Err(Error::invalid(format!(
        "the optical axis (axis_px of detection.json) is at ({:.0}, {:.0}) px, far outside the \
         image: repeat the detection",
        axis.x, axis.y
    )))
}

/// Returns an error if a feature lies far from the micro-image whose index it has. Centres come from the grid or,
/// without one, from the camera.
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
    let sensor = &camera.sensor;
    let [width_mm, height_mm] =
        [sensor.width_px, sensor.height_px].map(|edge| f64::from(edge) * sensor.pixel_size_mm);
    let could_be_mm = |f: &BapFeature| f.u_px.abs() <= width_mm && f.v_px.abs() <= height_mm;
    let remedy = if features.iter().all(could_be_mm) {
        "are u and v in mm? Give them in px"
    } else {
        "give features and camera or centres with the same indices"
    };
    let message = format!(
        "corner {} of frame {} is {distance:.0} px from the centre of its micro-image ({}, {}), \
         and {} more features are too far from their centres; the micro-image pitch is {pitch:.1} \
         px, so indices and positions do not belong together: {remedy}",
        f.corner,
        f.frame,
        f.k,
        f.l,
        far.count()
    );
    let BapFeature { frame, corner, k, l, .. } = *f;
    Err(Error::Observation { observation: Observed::Feature { frame, corner, k, l }, message })
}

/// Returns an error if the refined camera or a pose is impossible.
pub(super) fn check_refined(refinement: &Refinement) -> Result<()> {
    let poses = refinement.poses.iter().all(|p| p.to_homogeneous().iter().all(|v| v.is_finite()));
    let reason = match refinement.camera.validate() {
        Err(error) => error.to_string(),
        Ok(()) if !refinement.cost.is_finite() => format!("the cost is {}", refinement.cost),
        Ok(()) if !poses => "a pose of the result is not finite".to_owned(),
        Ok(()) => return Ok(()),
    };
    Err(Error::invalid(format!(
        "the refinement diverged ({reason}): the observations do not fit this camera and board; \
         check the focus distance (focus_distance_mm), the size of the squares (square_mm) and the frames"
    )))
}
