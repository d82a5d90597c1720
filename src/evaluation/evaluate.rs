//! The evaluation as one stage: cameras on boards that they were not calibrated with (paper, section 6).

use super::{Displacements, ParameterError, Reprojection, parameter_errors};
use crate::calibration::{CalibrationOptions, FramePose, LeftOut, Mode, Start, calibrate};
use crate::camera::{Board, PlenopticCamera};
use crate::error::Result;
use crate::observations::{BapFeature, Observations};

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
    Ok(Posed { poses: result.poses, reprojection: result.reprojection, left_out: result.left_out })
}

/// Evaluates cameras.
///
/// An error if boards cannot be posed, motions are none, or the true camera is of another kind.
pub fn evaluate(candidates: &[Candidate], input: &EvaluationInput) -> Result<Evaluation> {
    let of_candidate = |candidate: &Candidate| {
        let posed = |features: &[BapFeature]| pose_boards(&candidate.camera, input.board, features);
        let evaluation =
            (!input.evaluation.is_empty()).then(|| posed(input.evaluation)).transpose()?;
        let translation = input
            .translation
            .map(|(features, step_mm)| {
                Displacements::of_poses(&posed(features)?.poses, input.board, step_mm)
            })
            .transpose()?;
        let truth = input
            .truth
            .map(|truth| parameter_errors(truth, &candidate.camera, &candidate.std_devs))
            .transpose()?;
        Ok(CandidateResult { name: candidate.name.clone(), evaluation, translation, truth })
    };
    let step_mm = input.translation.map(|(_, step_mm)| step_mm);
    let clouds = step_mm
        .filter(|_| !input.clouds_mm.is_empty())
        .map(|step_mm| Displacements::of(input.clouds_mm, step_mm))
        .transpose()?;
    let candidates = candidates.iter().map(of_candidate).collect::<Result<_>>()?;
    Ok(Evaluation { candidates, clouds })
}
