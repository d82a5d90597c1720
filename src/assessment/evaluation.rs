//! The evaluation as one stage: cameras on boards that are not used in their calibration (paper, section 6).

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

use super::{
    CrossValidation, Displacements, ParameterError, PoseErrors, Posed, Reconstruction,
    cross_validate, parameter_errors, pose_boards, pose_errors, shape_errors,
};
use crate::calibration::{CalibrationOptions, LeftOut, Start};
use crate::error::{Error, Result};
use crate::finding::{Finding, Issue, Subject};
use crate::model::{
    BapFeature, BentBoard, Board, BoardShape, FramePose, Observations, PlenopticCamera, SHAPE,
};

/// A camera to evaluate.
#[derive(Debug, Clone, PartialEq)]
pub struct Candidate {
    /// Name of the camera in tables.
    pub name: String,
    /// The camera.
    pub camera: PlenopticCamera,
    /// Standard deviations of the intrinsic parameters; `None` if not known.
    pub std_devs: Vec<Option<f64>>,
    /// Shape of the board, from the calibration or from another source.
    pub board_shape: BoardShape,
    /// Standard deviations of the shape, in the order of [`Parameter::SHAPE`](crate::model::Parameter::SHAPE); `None` for
    /// parameters that are not estimated.
    pub shape_std_devs: [Option<f64>; SHAPE],
}

/// True and estimated poses of the boards of a subset.
#[derive(Debug, Clone, PartialEq)]
pub struct PosePairs {
    /// Name of the subset in tables.
    pub name: String,
    /// The true poses.
    pub truth: Vec<FramePose>,
    /// The estimated poses.
    pub found: Vec<FramePose>,
}

/// Input of a cross-validation.
#[derive(Debug, Clone)]
pub struct Folds {
    /// Start of the calibrations.
    pub start: Start,
    /// Observations of the calibrations.
    pub observations: Observations,
    /// Options of the calibrations.
    pub options: CalibrationOptions,
    /// Number of folds.
    pub count: usize,
}

/// Input of an evaluation.
#[derive(Debug, Clone)]
pub struct EvaluationInput {
    /// The board.
    pub board: Board,
    /// Features of boards not used in the calibration; empty for none.
    pub evaluation: Vec<BapFeature>,
    /// Features of a board moved along the optical axis, and the step, mm.
    pub translation: Option<(Vec<BapFeature>, f64)>,
    /// Distances of the moved board from other software, by frame, mm; empty for none.
    pub clouds_mm: Vec<(u32, f64)>,
    /// True camera; `None` if not known.
    pub truth: Option<PlenopticCamera>,
    /// True shape of the board; `None` if not known.
    pub true_board: Option<BoardShape>,
    /// True and estimated poses of other subsets.
    pub poses: Vec<PosePairs>,
    /// True poses of the boards of `evaluation`, which are compared with the poses from the first candidate.
    pub evaluation_poses: Option<Vec<FramePose>>,
    /// Input of a cross-validation.
    pub folds: Option<Folds>,
}

impl EvaluationInput {
    /// Creates an input with a board and nothing else.
    #[must_use]
    pub fn new(board: Board) -> Self {
        Self {
            board,
            evaluation: Vec::new(),
            translation: None,
            clouds_mm: Vec::new(),
            truth: None,
            true_board: None,
            poses: Vec::new(),
            evaluation_poses: None,
            folds: None,
        }
    }
}

/// The evaluation of one camera.
#[derive(Debug, Clone, PartialEq)]
pub struct CandidateResult {
    /// Name of the camera in tables.
    pub name: String,
    /// Boards not used in the calibration (Table 4).
    pub evaluation: Option<Posed>,
    /// Corners of these boards, each reconstructed alone.
    pub reconstruction: Option<Reconstruction>,
    /// Displacements of a board moved in known steps (Table 3).
    pub translation: Option<Displacements>,
    /// Errors of the parameters of camera and board against the truth.
    pub truth: Option<Vec<ParameterError>>,
}

/// The result of an evaluation.
#[derive(Debug, Clone, PartialEq)]
pub struct Evaluation {
    /// Results by camera.
    pub candidates: Vec<CandidateResult>,
    /// Displacements of the moved board from other software.
    pub clouds: Option<Displacements>,
    /// Errors of poses by subset of the boards.
    pub poses: Vec<(String, PoseErrors)>,
    /// Result of the cross-validation.
    pub folds: Option<CrossValidation>,
    /// Parts that could not be evaluated, with the reason; and findings about known steps.
    pub findings: Vec<Finding>,
}

/// Evaluates cameras. A part that fails (boards without a pose, a translation with only one frame, a true
/// camera of another kind) is listed in `findings`, and the rest is evaluated. `progress`
/// is called after every fold of the cross-validation.
#[must_use]
pub fn evaluate(
    candidates: &[Candidate],
    input: &EvaluationInput,
    progress: &(dyn Fn() + Sync),
) -> Evaluation {
    let _span = tracing::info_span!("evaluation").entered();
    let mut findings = Vec::new();
    let results: Vec<CandidateResult> = candidates
        .iter()
        .map(|candidate| candidate_result(candidate, input, &mut findings))
        .collect();
    let moved = results.first().and_then(|result| result.translation.as_ref());
    findings.extend(moved.into_iter().flat_map(|moved| moved.findings(input.board.square_mm)));
    let step_mm = input.translation.as_ref().map(|(_, step_mm)| *step_mm);
    let clouds = step_mm.filter(|_| !input.clouds_mm.is_empty()).and_then(|step_mm| {
        kept("point clouds", Displacements::of(&input.clouds_mm, step_mm), &mut findings)
    });
    let folds = input.folds.as_ref().and_then(|folds| {
        let Folds { start, observations, options, count } = folds;
        let result = cross_validate(start, &input.board, observations, options, *count, progress);
        kept("cross-validation", result, &mut findings)
    });
    let poses = poses_against_truth(&results, input);
    Evaluation { candidates: results, clouds, poses, folds, findings }
}

fn candidate_result(
    candidate: &Candidate,
    input: &EvaluationInput,
    findings: &mut Vec<Finding>,
) -> CandidateResult {
    let name = &candidate.name;
    let board = BentBoard { board: input.board, shape: candidate.board_shape };
    let mut posed = |subset: &str, features: &[BapFeature]| {
        let posed = pose_boards(&candidate.camera, &board, features);
        let what = format!("{name}, boards of {subset}");
        if let Ok(posed) = &posed {
            findings.extend(posed.left_out.iter().map(LeftOut::finding));
            let about = |finding: &Finding| finding.clone().about(Subject::Part(what.clone()));
            findings.extend(posed.findings.iter().map(about));
            if !posed.converged {
                findings.push(
                    Finding::caution(Issue::PosesNotConverged).about(Subject::Part(what.clone())),
                );
            }
        }
        kept(&what, posed, findings)
    };
    let evaluation =
        (!input.evaluation.is_empty()).then(|| posed("evaluation", &input.evaluation)).flatten();
    let moved = input
        .translation
        .as_ref()
        .and_then(|(features, step_mm)| Some((posed("translation", features)?, *step_mm)));
    let translation = moved.and_then(|(posed, step_mm)| {
        let found = Displacements::of_poses(&posed.poses, &input.board, step_mm);
        kept(&format!("{name}, known displacement"), found, findings)
    });
    let reconstruction = evaluation.as_ref().and_then(|posed| {
        let found = Reconstruction::of(&candidate.camera, &board, posed);
        let what = format!("{name}, reconstructed points");
        let found = kept(&what, found, findings)?;
        if found.is_none() {
            findings.push(Finding::caution(Issue::TooFewPoints).about(Subject::Part(what)));
        }
        found
    });
    let of_camera = input.truth.as_ref().and_then(|truth| {
        let errors = parameter_errors(truth, &candidate.camera, &candidate.std_devs);
        kept(&format!("{name}, truth"), errors, findings)
    });
    let of_board = input
        .true_board
        .map(|truth| shape_errors(&truth, &candidate.board_shape, candidate.shape_std_devs));
    let known: Vec<_> = of_camera.into_iter().chain(of_board).flatten().collect();
    let truth = (!known.is_empty()).then_some(known);
    CandidateResult { name: name.clone(), evaluation, reconstruction, translation, truth }
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

/// Returns the rigid transform from the frame of a board to the frame of the board turned by 180 degrees.
fn half_turn(board: &Board) -> Isometry3<f64> {
    let last = board.point_mm(board.corners() - 1);
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::PI);
    Isometry3::from_parts(Translation3::new(last.x, last.y, 0.0), turn)
}

/// Returns the result; if the part failed, adds a finding and returns `None`.
fn kept<T>(part: &str, result: Result<T>, findings: &mut Vec<Finding>) -> Option<T> {
    let failed = |error: Error| {
        Finding::caution(Issue::PartFailed { reason: error.to_string() })
            .about(Subject::Part(part.to_owned()))
    };
    result.map_err(|error| findings.push(failed(error))).ok()
}
