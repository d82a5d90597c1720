//! What a calibration looks at before and after the refinement: whether camera and observations
//! belong together, and what the user should know of the result.

use crate::calibration::{LeftOut, Mode, Start};
use crate::error::{Error, Result};
use crate::model::{
    BapFeature, Board, Datasheet, FramePose, InternalParameters, Observations, PlenopticCamera,
    Reprojection, intrinsic_parameters,
};
use crate::precalibration::MicroImageArray;
use crate::solver::{self, Refinement, Uncertainty};

/// Boards tilted by less than this, rad (5°), look alike in a projection.
const FRONTO_PARALLEL_RAD: f64 = 0.087;
/// Stated and fitted pitch of the micro-images may differ by this part: both are known to a few
/// parts in 10⁴, so beyond it they are of different cameras.
const PITCH_AGREEMENT: f64 = 0.01;
/// A reprojection error beyond this part of the micro-image pitch is no noise of a detector: on the
/// R12 it is 2.3 px, real data have 0.9.
const BAD_FIT: f64 = 0.1;
/// A model that explains the blur radii leaves less than this part of their spread.
const UNEXPLAINED_RHO: f64 = 0.5;
/// An array may be larger than the image by this factor.
const ARRAY_OVER_IMAGE: f64 = 1.5;

/// The observations without some frames, and these.
pub(super) fn without_frames(
    observations: &Observations,
    frames: &[u32],
) -> Result<(Observations, Vec<LeftOut>)> {
    let known = observations.frames();
    if let Some(frame) = frames.iter().find(|frame| !known.contains(frame)) {
        return Err(Error::invalid(format!(
            "frame {frame} is to be left out, but there is none; the frames are {known:?}"
        )));
    }
    let (out, kept): (Vec<BapFeature>, Vec<BapFeature>) =
        observations.features.iter().partition(|f| frames.contains(&f.frame));
    let excluded = known.into_iter().filter(|frame| frames.contains(frame)).map(|frame| LeftOut {
        frame,
        features: out.iter().filter(|f| f.frame == frame).count(),
        reason: "excluded on request".to_owned(),
    });
    Ok((Observations { centers: observations.centers.clone(), features: kept }, excluded.collect()))
}

/// An error unless there is enough to calibrate from, and every observation can be.
pub(super) fn check_observations(
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

/// An error if the camera's file or the internal parameters state another pitch than the centres have.
pub fn check_stated_pitch(
    sheet: &Datasheet,
    internal: &InternalParameters,
    grid: &MicroImageArray,
) -> Result<()> {
    let measured = internal.micro_image_pitch_mm.map(|mm| mm / sheet.sensor.pixel_size_mm);
    for (stated, whose) in [
        (sheet.micro_image_pitch_px, "the camera states"),
        (measured, "the internal parameters state"),
    ] {
        if let Some(stated) = stated
            && (stated / grid.pitch_px - 1.0).abs() > PITCH_AGREEMENT
        {
            return Err(Error::invalid(format!(
                "{whose} a micro-image pitch of {stated:.4} px, but the centres have one of {:.4} \
                 px: they are of different cameras, or the pixel size is wrong",
                grid.pitch_px
            )));
        }
    }
    Ok(())
}

/// An error if a feature lies far from the micro-image whose index it carries, by the grid of the
/// centres, or without them by the camera.
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
        "corner {} of frame {} is {distance:.0} px from the centre of micro-image ({}, {}) that it is \
         said to lie in, as are {} more features; a micro-image is {pitch:.1} px wide, so indices and \
         positions do not belong together",
        f.corner,
        f.frame,
        f.k,
        f.l,
        far.count()
    )))
}

/// An error if the refinement left what a camera can be.
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
         check the focus distance, the board's size and the frames"
    )))
}

/// A warning of centres far from the grid.
pub(super) fn outlying_centers(grid: &MicroImageArray, centers: usize) -> Option<String> {
    (grid.outliers > 0).then(|| {
        format!(
            "{} of {centers} micro-image centres lie far from the grid (its RMS is {:.3} px); they \
             are kept, a robust loss (--loss) lessens their weight",
            grid.outliers, grid.rms_px
        )
    })
}

/// A warning of an array that reaches far out of the image.
pub(super) fn array_beyond_image(camera: &PlenopticCamera) -> Option<String> {
    let lattice = &camera.lattice;
    let extent = camera.micro_image_pitch_px()
        * (lattice.node(lattice.columns - 1, lattice.rows - 1) - lattice.node(0, 0));
    let beyond = |extent: f64, image: u32| extent > ARRAY_OVER_IMAGE * f64::from(image);
    let sensor = &camera.sensor;
    (beyond(extent.x, sensor.width_px) || beyond(extent.y, sensor.height_px)).then(|| {
        format!(
            "{} x {} micro-lenses cover {:.0} x {:.0} px, but the image has {} x {}: is the size of \
             the array right? D, d, t_x and t_y hold at its middle",
            lattice.columns, lattice.rows, extent.x, extent.y, sensor.width_px, sensor.height_px
        )
    })
}

/// A warning of parameters that the observations say nothing of.
pub(super) fn undetermined(camera: &PlenopticCamera, uncertainty: &Uncertainty) -> Option<String> {
    if uncertainty.rank == uncertainty.size() {
        return None;
    }
    let parameters = intrinsic_parameters(camera.lens_types());
    let names: Vec<&str> = uncertainty
        .undetermined_intrinsics()
        .into_iter()
        .map(|index| parameters[index].name)
        .collect();
    let which = if names.is_empty() { "some poses".to_owned() } else { names.join(", ") };
    Some(format!(
        "the observations determine {} of {} parameters; not determined: {which}. Hold parameters \
         (--fix), or add what would determine them: frames at other distances and tilts, every lens \
         type",
        uncertainty.rank,
        uncertainty.size()
    ))
}

/// A warning of residuals that no noise explains.
pub(super) fn bad_fit(camera: &PlenopticCamera, reprojection: &Reprojection) -> Option<String> {
    let (rmse, pitch) = (reprojection.rmse(), camera.micro_image_pitch_px());
    if rmse.all_px > BAD_FIT * pitch {
        return Some(format!(
            "the features are missed by {:.2} px RMS, a good part of a micro-image ({pitch:.1} px): \
             this is no noise; check the board, the sign of rho and the frames of large error",
            rmse.all_px
        ));
    }
    let count = rmse.count as f64;
    let radii = || reprojection.features.iter().map(|r| r.feature.rho_px);
    let mean = radii().sum::<f64>() / count;
    let spread = (radii().map(|rho| (rho - mean).powi(2)).sum::<f64>() / count).sqrt();
    let rho_px = rmse.rho_px.filter(|rho_px| *rho_px > UNEXPLAINED_RHO * spread)?;
    Some(format!(
        "the blur radii are missed by {rho_px:.3} px RMS, though they spread by {spread:.3} px only: \
         the camera does not explain them; check the sign of rho and the order of q'"
    ))
}

/// A warning of boards that leave F and distance open.
pub(super) fn fronto_parallel(poses: &[FramePose], mode: Mode) -> Option<String> {
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
