//! The evaluation as one stage: cameras on boards that they were not calibrated with (paper, section 6).

use super::{Displacements, ParameterError, parameter_errors};
use crate::calibration::{Calibration, CalibrationOptions, LeftOut, Mode, Start, calibrate};
use crate::error::Result;
use crate::model::{BapFeature, Board, FramePose, Observations, PlenopticCamera, Reprojection};

/// A camera to evaluate.
#[derive(Debug, Clone, PartialEq)]
pub struct Candidate {
    /// What tables call it.
    pub name: String,
    /// The camera.
    pub camera: PlenopticCamera,
    /// Standard deviations of its intrinsic parameters where they are known.
    pub std_devs: Vec<Option<f64>>,
}

/// What cameras are evaluated on.
#[derive(Debug, Clone, Copy)]
pub struct EvaluationInput<'a> {
    /// The board.
    pub board: &'a Board,
    /// Boards that were not calibrated with; empty for none.
    pub evaluation: &'a [BapFeature],
    /// A board moved along the optical axis, and the steps, mm.
    pub translation: Option<(&'a [BapFeature], f64)>,
    /// The same motion as other software has it: distances by frame, mm; empty for none.
    pub clouds_mm: &'a [(u32, f64)],
    /// The camera as it is, if that is known.
    pub truth: Option<&'a PlenopticCamera>,
}

/// Boards with a camera that is held.
#[derive(Debug, Clone, PartialEq)]
pub struct Posed {
    /// Their poses.
    pub poses: Vec<FramePose>,
    /// Reprojection errors.
    pub reprojection: Reprojection,
    /// Frames without a pose.
    pub left_out: Vec<LeftOut>,
    /// Whether their poses are at a minimum.
    pub converged: bool,
}

/// What was found of one camera.
#[derive(Debug, Clone, PartialEq)]
pub struct CandidateResult {
    /// What tables call it.
    pub name: String,
    /// Boards that it was not calibrated with (Table 4).
    pub evaluation: Option<Posed>,
    /// A board moved in known steps (Table 3).
    pub translation: Option<Displacements>,
    /// Its parameters against the true ones.
    pub truth: Option<Vec<ParameterError>>,
}

/// What was found.
#[derive(Debug, Clone, PartialEq)]
pub struct Evaluation {
    /// By camera.
    pub candidates: Vec<CandidateResult>,
    /// The motion as other software has it.
    pub clouds: Option<Displacements>,
    /// What could not be evaluated and why, in words.
    pub problems: Vec<String>,
}

/// Finds the poses of boards with a camera that is held.
pub fn pose_boards(
    camera: &PlenopticCamera,
    board: &Board,
    features: &[BapFeature],
) -> Result<Posed> {
    let options = CalibrationOptions { mode: Mode::PosesOnly, ..CalibrationOptions::default() };
    let seen = Observations { centers: Vec::new(), features: features.to_vec() };
    let start = Start::Camera(camera.clone());
    let result = calibrate(&start, board, &seen, &options, &mut |_| true)?;
    let Calibration { poses, reprojection, left_out, converged, .. } = result;
    Ok(Posed { poses, reprojection, left_out, converged })
}

/// Evaluates cameras. What fails (boards without a pose, a motion of one frame, a true camera of another
/// kind) is told in `problems` and does not keep the rest from being evaluated.
#[must_use]
pub fn evaluate(candidates: &[Candidate], input: &EvaluationInput) -> Evaluation {
    let mut problems = Vec::new();
    let mut results = Vec::new();
    for candidate in candidates {
        let mut posed = |what: &str, features: &[BapFeature]| {
            let posed = pose_boards(&candidate.camera, input.board, features);
            let what = format!("{}, boards of {what}", candidate.name);
            if let Ok(posed) = &posed {
                let left_out = posed.left_out.iter().map(|l| format!("{what}: {l}"));
                problems.extend(left_out);
                if !posed.converged {
                    problems.push(format!("{what}: their poses are not converged"));
                }
            }
            kept(&what, posed, &mut problems)
        };
        let evaluation =
            (!input.evaluation.is_empty()).then(|| posed("evaluation", input.evaluation)).flatten();
        let moved = input
            .translation
            .and_then(|(features, step_mm)| Some((posed("translation", features)?, step_mm)));
        let translation = moved.and_then(|(posed, step_mm)| {
            let found = Displacements::of_poses(&posed.poses, input.board, step_mm);
            kept(&format!("{}, known motion", candidate.name), found, &mut problems)
        });
        let truth = input.truth.and_then(|truth| {
            let errors = parameter_errors(truth, &candidate.camera, &candidate.std_devs);
            kept(&format!("{}, truth", candidate.name), errors, &mut problems)
        });
        let name = candidate.name.clone();
        results.push(CandidateResult { name, evaluation, translation, truth });
    }
    let step_mm = input.translation.map(|(_, step_mm)| step_mm);
    let clouds = step_mm.filter(|_| !input.clouds_mm.is_empty()).and_then(|step_mm| {
        kept("point clouds", Displacements::of(input.clouds_mm, step_mm), &mut problems)
    });
    Evaluation { candidates: results, clouds, problems }
}

fn kept<T>(what: &str, result: Result<T>, problems: &mut Vec<String>) -> Option<T> {
    result.map_err(|error| problems.push(format!("{what}: {error}"))).ok()
}
