//! Preparation of a calibration: everything that is known before the poses, and the poses.

use std::collections::BTreeMap;

use nalgebra::Vector2;

use crate::calibration::aperture_ratio::{with_aperture_ratio, with_that_of_start};
use crate::calibration::checks::{check_indices, check_observations, without_frames};
use crate::calibration::focus::refocused;
use crate::calibration::frames::{Frames, given_frames, initial_frames};
use crate::calibration::priors::check_priors;
use crate::calibration::{
    BlurMeasurement, CalibrationOptions, Distortion, ExitPupil, FieldCurvature, LeftOut, LensTilt,
    Mode, SolvedProblem, Start, Weights, initial_camera,
};
use crate::error::{Error, Result};
use crate::finding::{Finding, Issue, list};
use crate::model::{BentBoard, Board, FramePose, Observations, PlenopticCamera};
use crate::precalibration::{MicroImageArray, check_stated_pitch, fit_grid};
use crate::quantity::counted;
use crate::solver::CostOptions;

/// Solution at which a cost is evaluated.
#[derive(Debug, Clone, PartialEq)]
pub struct Solution {
    /// The camera.
    pub camera: PlenopticCamera,
    /// The poses of the boards, by frame number; frames without one are left out.
    pub poses: Vec<FramePose>,
}

/// Calibration before any pose is known.
pub(super) struct Prepared {
    pub start: Start,
    pub initial: PlenopticCamera,
    pub grid: Option<MicroImageArray>,
    pub blur: Option<BlurMeasurement>,
    pub misfocused: Option<Finding>,
    pub observations: Observations,
    pub excluded: Vec<LeftOut>,
    /// The cost of an exported problem; `None` if the options determine it.
    pub cost: Option<CostOptions>,
}

/// Prepares a calibration by everything that is known without poses. Returns an error if the input is inconsistent.
pub(super) fn prepared(
    start: &Start,
    board: &Board,
    observations: &Observations,
    options: &CalibrationOptions,
) -> Result<Prepared> {
    let start = match options.mode {
        Mode::CornersOnly => start.of_pinholes(),
        Mode::Full | Mode::PosesOnly => start.clone(),
    };
    start.validate()?;
    options.validate(&start)?;
    check_priors(options, start.lens_types())?;
    let (mut observations, excluded) = without_frames(observations, &options.exclude_frames)?;
    if options.weights == Weights::Unit {
        observations.forget_std_devs();
    }
    check_observations(&start, board, &observations, options)?;
    let grid = fitted_grid(&start, &observations)?;
    let blur = BlurMeasurement::of(&start, grid.as_ref(), &observations.features)?;
    let start = with_aperture_ratio(start, grid.as_ref(), blur.as_ref());
    let initial = checked_start(&start, grid.as_ref(), &observations, options)?;
    let refocused = refocused(&start, &initial, board, &observations.features, options);
    let (start, misfocused) = refocused.unwrap_or((start, None));
    let initial = start_camera(&start, grid.as_ref(), observations.axis_px, options)?;
    observations.features = with_that_of_start(observations.features, &start, &initial.lattice);
    Ok(Prepared { start, initial, grid, blur, misfocused, observations, excluded, cost: None })
}

impl Prepared {
    /// Takes observations and cost from an exported problem. Returns an error if its numbers are impossible.
    pub fn of_problem(problem: &SolvedProblem, options: &CalibrationOptions) -> Result<Self> {
        let start = Start::Camera(problem.camera.clone());
        start.validate()?;
        options.check_numbers()?;
        check_priors(options, start.lens_types())?;
        let observations = problem.observations();
        check_observations(&start, &problem.board.board, &observations, options)?;
        let grid = fitted_grid(&start, &observations)?;
        Ok(Self {
            initial: problem.camera.clone(),
            start,
            grid,
            blur: None,
            misfocused: None,
            observations,
            excluded: Vec::new(),
            cost: Some(problem.cost.clone()),
        })
    }

    /// Returns the camera and the frames at the start, or at the given solution. Returns an error with the reasons if
    /// no frame has a pose.
    pub fn placed(
        &self,
        board: &BentBoard,
        options: &CalibrationOptions,
        at: Option<&Solution>,
    ) -> Result<(PlenopticCamera, Frames)> {
        let Self { initial, grid, observations, .. } = self;
        let (initial, mut frames) = if let Some(at) = at {
            check_same_array(&at.camera, initial)?;
            check_indices(&at.camera, grid.as_ref(), observations)?;
            (&at.camera, given_frames(observations, &at.poses))
        } else {
            let cost = (&options.cost(), &options.solver());
            (initial, initial_frames(initial, board, observations, cost, &options.poses)?)
        };
        if frames.poses.is_empty() {
            return Err(Error::invalid(no_frame(&frames.left_out)));
        }
        frames.left_out.extend(self.excluded.iter().cloned());
        Ok((initial.clone(), frames))
    }
}

/// Returns the camera from which a calibration of these observations starts.
pub fn initial_from(
    start: &Start,
    board: &Board,
    observations: &Observations,
    options: &CalibrationOptions,
) -> Result<PlenopticCamera> {
    let grid = fitted_grid(start, observations)?;
    let blur = BlurMeasurement::of(start, grid.as_ref(), &observations.features)?;
    let start = with_aperture_ratio(start.clone(), grid.as_ref(), blur.as_ref());
    let initial = start_camera(&start, grid.as_ref(), observations.axis_px, options)?;
    match refocused(&start, &initial, board, &observations.features, options) {
        Some((start, _)) => start_camera(&start, grid.as_ref(), observations.axis_px, options),
        None => Ok(initial),
    }
}

/// Returns the camera from which the calibration starts. Returns an error unless it, the grid of the centres, if any,
/// and the observations belong to one camera.
fn checked_start(
    start: &Start,
    grid: Option<&MicroImageArray>,
    observations: &Observations,
    options: &CalibrationOptions,
) -> Result<PlenopticCamera> {
    if let (Some(grid), Start::Datasheet(sheet, internal)) = (grid, start) {
        check_stated_pitch(sheet, internal, grid)?;
    }
    let initial = start_camera(start, grid, observations.axis_px, options)?;
    check_indices(&initial, grid, observations)?;
    Ok(initial)
}

fn fitted_grid(start: &Start, observations: &Observations) -> Result<Option<MicroImageArray>> {
    let centers = &observations.centers;
    let (kind, (columns, rows)) = start.array(centers);
    (!centers.is_empty()).then(|| fit_grid(centers, kind, columns, rows)).transpose()
}

fn start_camera(
    start: &Start,
    grid: Option<&MicroImageArray>,
    axis_px: Option<Vector2<f64>>,
    options: &CalibrationOptions,
) -> Result<PlenopticCamera> {
    let mut camera = match (start, grid) {
        (Start::Datasheet(datasheet, internal), Some(grid)) => {
            let axis_px = axis_px.unwrap_or(datasheet.sensor.center_px());
            let exit_pupil_mm = options.exit_pupil_mm().unwrap_or(0.0);
            initial_camera(datasheet, internal, grid, exit_pupil_mm, axis_px)?
        }
        (Start::Datasheet(..), None) => return Err(Error::NoCenters),
        (Start::Camera(camera), Some(grid)) if camera.lattice != grid.lattice => {
            return Err(Error::invalid(format!(
                "the camera has {}, but the centres lie on {}: they belong to different cameras",
                camera.lattice, grid.lattice
            )));
        }
        (Start::Camera(camera), _) => camera.clone(),
    };
    let lens = &mut camera.main_lens;
    lens.exit_pupil_mm.z = options.exit_pupil_mm().unwrap_or(lens.exit_pupil_mm.z);
    if options.exit_pupil == ExitPupil::AT_LENS {
        lens.pupil_aberration_per_mm = 0.0;
    }
    if options.distortion == Distortion::Constant {
        lens.q1_growth_per_mm2 = 0.0;
    }
    if options.lens_tilt == LensTilt::None {
        lens.rotation_rad = [0.0; 2];
    }
    if options.field_curvature == FieldCurvature::Flat {
        lens.field_curvature_per_mm = 0.0;
    }
    if options.field_curvature != FieldCurvature::Estimated {
        lens.field_curvature_growth_per_mm = 0.0;
    }
    camera.validate()?;
    Ok(camera)
}

/// Returns an error unless a solution has a camera with this array.
fn check_same_array(solution: &PlenopticCamera, camera: &PlenopticCamera) -> Result<()> {
    let is_same = solution.lattice.packing == camera.lattice.packing
        && solution.lens_types() == camera.lens_types();
    if is_same {
        return Ok(());
    }
    let of = |camera: &PlenopticCamera| {
        format!("{} on {}", counted(camera.lens_types(), "lens type"), camera.lattice)
    };
    Err(Error::invalid(format!(
        "the camera of the solution has {}, but the camera of the observations has {}: give a \
         solution for this array",
        of(solution),
        of(camera)
    )))
}

/// Explains why no frame could be used.
fn no_frame(left_out: &[LeftOut]) -> String {
    if left_out.iter().all(|frame| frame.reason == Issue::PoseBehindFocalPlane) {
        return "no frame could be used: all boards would be nearer to the main lens than its focal \
                length. Check the size of the squares (square_mm), the pixel size (pixel_size_mm) \
                and the focal length (focal_length_mm)"
            .to_owned();
    }
    let mut by_reason: BTreeMap<String, Vec<u32>> = BTreeMap::new();
    for LeftOut { frame, reason, .. } in left_out {
        by_reason.entry(reason.to_string()).or_default().push(*frame);
    }
    let reasons = by_reason.iter();
    let reasons: Vec<String> =
        reasons.map(|(reason, frames)| format!("{reason} (frames {})", list(frames))).collect();
    format!("no frame could be used: {}", reasons.join("; "))
}
