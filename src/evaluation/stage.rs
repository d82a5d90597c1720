//! The evaluation as one stage: cameras on boards that they were not calibrated with (paper, section 6).

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

use super::{
    CrossValidation, Displacements, ParameterError, PoseErrors, cross_validate, parameter_errors,
    pose_errors,
};
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

/// True poses of the boards of a subset, beside those that were found.
#[derive(Debug, Clone, PartialEq)]
pub struct PosePairs {
    /// What tables call the subset.
    pub name: String,
    /// The true ones.
    pub truth: Vec<FramePose>,
    /// Those found.
    pub found: Vec<FramePose>,
}

/// A cross-validation to do.
#[derive(Debug, Clone)]
pub struct Folds {
    /// What the calibrations start from.
    pub start: Start,
    /// What they are made from.
    pub observations: Observations,
    /// Their options.
    pub options: CalibrationOptions,
    /// Number of folds.
    pub count: usize,
}

/// What cameras are evaluated on.
#[derive(Debug, Clone)]
pub struct EvaluationInput {
    /// The board.
    pub board: Board,
    /// Boards that were not calibrated with; empty for none.
    pub evaluation: Vec<BapFeature>,
    /// A board moved along the optical axis, and the steps, mm.
    pub translation: Option<(Vec<BapFeature>, f64)>,
    /// The same motion by other software: distances by frame, mm; empty for none.
    pub clouds_mm: Vec<(u32, f64)>,
    /// The true camera, if it is known.
    pub truth: Option<PlenopticCamera>,
    /// Poses found elsewhere, beside the true ones.
    pub poses: Vec<PosePairs>,
    /// True poses of the boards of `evaluation`; the first candidate's are compared with them.
    pub evaluation_poses: Option<Vec<FramePose>>,
    /// A cross-validation.
    pub folds: Option<Folds>,
}

impl EvaluationInput {
    /// Nothing but a board.
    #[must_use]
    pub fn new(board: Board) -> Self {
        Self {
            board,
            evaluation: Vec::new(),
            translation: None,
            clouds_mm: Vec::new(),
            truth: None,
            poses: Vec::new(),
            evaluation_poses: None,
            folds: None,
        }
    }
}

/// Boards with a fixed camera.
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
    /// The known motion by other software.
    pub clouds: Option<Displacements>,
    /// Errors of poses by subset of the boards.
    pub poses: Vec<(String, PoseErrors)>,
    /// The cross-validation.
    pub folds: Option<CrossValidation>,
    /// What could not be evaluated and why, in words.
    pub problems: Vec<String>,
}

/// Finds the poses of boards with a fixed camera.
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
/// kind) is listed in `problems`, and the rest is evaluated all the same. `progress` is called after every
/// fold of the cross-validation.
#[must_use]
pub fn evaluate(
    candidates: &[Candidate],
    input: &EvaluationInput,
    progress: &(dyn Fn() + Sync),
) -> Evaluation {
    let _span = tracing::info_span!("evaluation").entered();
    let mut problems = Vec::new();
    let results: Vec<CandidateResult> = candidates
        .iter()
        .map(|candidate| candidate_result(candidate, input, &mut problems))
        .collect();
    let step_mm = input.translation.as_ref().map(|(_, step_mm)| *step_mm);
    let clouds = step_mm.filter(|_| !input.clouds_mm.is_empty()).and_then(|step_mm| {
        kept("point clouds", Displacements::of(&input.clouds_mm, step_mm), &mut problems)
    });
    let folds = input.folds.as_ref().and_then(|folds| {
        let Folds { start, observations, options, count } = folds;
        let result = cross_validate(start, &input.board, observations, options, *count, progress);
        kept("cross-validation", result, &mut problems)
    });
    let poses = poses_against_truth(&results, input);
    Evaluation { candidates: results, clouds, poses, folds, problems }
}

fn candidate_result(
    candidate: &Candidate,
    input: &EvaluationInput,
    problems: &mut Vec<String>,
) -> CandidateResult {
    let name = &candidate.name;
    let mut posed = |subset: &str, features: &[BapFeature]| {
        let posed = pose_boards(&candidate.camera, &input.board, features);
        let what = format!("{name}, boards of {subset}");
        if let Ok(posed) = &posed {
            problems.extend(posed.left_out.iter().map(|l| format!("{what}: {l}")));
            if !posed.converged {
                problems.push(format!("{what}: their poses are not converged"));
            }
        }
        kept(&what, posed, problems)
    };
    let evaluation =
        (!input.evaluation.is_empty()).then(|| posed("evaluation", &input.evaluation)).flatten();
    let moved = input
        .translation
        .as_ref()
        .and_then(|(features, step_mm)| Some((posed("translation", features)?, *step_mm)));
    let translation = moved.and_then(|(posed, step_mm)| {
        let found = Displacements::of_poses(&posed.poses, &input.board, step_mm);
        kept(&format!("{name}, known motion"), found, problems)
    });
    let truth = input.truth.as_ref().and_then(|truth| {
        let errors = parameter_errors(truth, &candidate.camera, &candidate.std_devs);
        kept(&format!("{name}, truth"), errors, problems)
    });
    CandidateResult { name: name.clone(), evaluation, translation, truth }
}

fn poses_against_truth(
    results: &[CandidateResult],
    input: &EvaluationInput,
) -> Vec<(String, PoseErrors)> {
    let turned = half_turn(&input.board);
    let of_pair = |pair: &PosePairs| {
        Some((pair.name.clone(), pose_errors(&pair.truth, &pair.found, &turned)?))
    };
    let mut poses: Vec<(String, PoseErrors)> = input.poses.iter().filter_map(of_pair).collect();
    let first = results.first().and_then(|result| result.evaluation.as_ref());
    if let (Some(truth), Some(found)) = (&input.evaluation_poses, first) {
        let errors = pose_errors(truth, &found.poses, &turned);
        poses.extend(errors.map(|errors| ("evaluation".to_owned(), errors)));
    }
    poses
}

/// From the frame of a board to that of the same board turned by 180 degrees.
fn half_turn(board: &Board) -> Isometry3<f64> {
    let last = board.point_mm(board.corners() - 1);
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::PI);
    Isometry3::from_parts(Translation3::new(last.x, last.y, 0.0), turn)
}

fn kept<T>(what: &str, result: Result<T>, problems: &mut Vec<String>) -> Option<T> {
    result.map_err(|error| problems.push(format!("{what}: {error}"))).ok()
}
