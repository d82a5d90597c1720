//! `evaluation.json`: results of an evaluation.

use serde::Serialize;

use crate::assessment::{
    CandidateResult, CrossValidation, Displacement, Displacements, Evaluation, Fold,
    ParameterError, PoseErrors, Reconstruction, Spread,
};
use crate::finding::Finding;
use crate::model::Rmse;

#[derive(Serialize)]
struct EvaluationFile<'a> {
    format: &'static str,
    version: u64,
    cameras: Vec<CameraEntry<'a>>,
    point_clouds: Option<SeriesEntry<'a>>,
    poses_against_truth: Vec<PosesEntry<'a>>,
    problems: Vec<String>,
    findings: &'a [Finding],
    cross_validation: Option<FoldsEntry<'a>>,
}

#[derive(Serialize)]
struct CameraEntry<'a> {
    name: &'a str,
    evaluation: Option<BoardsEntry>,
    reconstruction: Option<ReconstructionEntry>,
    translation: Option<SeriesEntry<'a>>,
    truth: Option<&'a [ParameterError]>,
}

/// Errors on boards that were not used in the calibration.
#[derive(Serialize)]
struct BoardsEntry {
    #[serde(flatten)]
    rmse: Rmse,
    frames: usize,
    frames_left_out: usize,
}

#[derive(Serialize)]
struct ReconstructionEntry {
    frames: usize,
    points: usize,
    left_out: usize,
    distances_too_long: Spread,
    across_mm: f64,
    along_mm: f64,
}

/// Errors on a board moved in known steps.
#[derive(Serialize)]
struct SeriesEntry<'a> {
    whole_way: Displacement,
    relative_error: Spread,
    absolute_error_mm: Spread,
    steps: &'a [Displacement],
}

#[derive(Serialize)]
struct PosesEntry<'a> {
    boards: &'a str,
    #[serde(flatten)]
    errors: PoseErrors,
}

#[derive(Serialize)]
struct FoldsEntry<'a> {
    rmse: Rmse,
    jackknife_standard_deviations: Vec<f64>,
    folds: Vec<FoldEntry<'a>>,
}

#[derive(Serialize)]
struct FoldEntry<'a> {
    frames: &'a [u32],
    without_pose: usize,
    converged: bool,
    rmse: Rmse,
}

/// Returns the content of `evaluation.json`: values in px, mm, rad; relative errors as fractions.
#[must_use]
pub fn evaluation_document(evaluation: &Evaluation) -> impl Serialize {
    let poses = evaluation.poses.iter();
    EvaluationFile {
        format: "plenocal-evaluation",
        version: 1,
        cameras: evaluation.candidates.iter().map(camera).collect(),
        point_clouds: evaluation.clouds.as_ref().map(series),
        poses_against_truth: poses
            .map(|(boards, errors)| PosesEntry { boards, errors: *errors })
            .collect(),
        problems: evaluation.findings.iter().map(ToString::to_string).collect(),
        findings: &evaluation.findings,
        cross_validation: evaluation.folds.as_ref().map(cross_validation),
    }
}

fn camera(candidate: &CandidateResult) -> CameraEntry<'_> {
    CameraEntry {
        name: &candidate.name,
        evaluation: candidate.evaluation.as_ref().map(|found| BoardsEntry {
            rmse: found.reprojection.rmse(),
            frames: found.poses.len(),
            frames_left_out: found.left_out.len(),
        }),
        reconstruction: candidate.reconstruction.as_ref().map(reconstruction),
        translation: candidate.translation.as_ref().map(series),
        truth: candidate.truth.as_deref(),
    }
}

fn reconstruction(r: &Reconstruction) -> ReconstructionEntry {
    ReconstructionEntry {
        frames: r.frames,
        points: r.points,
        left_out: r.left_out,
        distances_too_long: Spread { mean: r.too_long.value, std_dev: Some(r.too_long.std_dev) },
        across_mm: r.across_mm,
        along_mm: r.along_mm,
    }
}

fn series(displacements: &Displacements) -> SeriesEntry<'_> {
    SeriesEntry {
        whole_way: displacements.whole,
        relative_error: displacements.relative(),
        absolute_error_mm: displacements.absolute_mm(),
        steps: &displacements.steps,
    }
}

fn cross_validation(folds: &CrossValidation) -> FoldsEntry<'_> {
    FoldsEntry {
        rmse: folds.rmse,
        jackknife_standard_deviations: folds.jackknife_std_devs(),
        folds: folds.folds.iter().map(fold).collect(),
    }
}

fn fold(fold: &Fold) -> FoldEntry<'_> {
    FoldEntry {
        frames: &fold.frames,
        without_pose: fold.left_out,
        converged: fold.converged,
        rmse: fold.rmse,
    }
}
