//! `evaluation.json`: what an evaluation found.

use serde_json::{Value, json};

use super::calibration_file::rmse_document;
use crate::assessment::{
    Displacement, Displacements, Evaluation, ParameterError, Reconstruction, Spread,
};

/// The content of `evaluation.json`: values in px, mm, rad; relative errors as fractions.
#[must_use]
pub fn evaluation_document(evaluation: &Evaluation) -> Value {
    let candidates: Vec<Value> = evaluation
        .candidates
        .iter()
        .map(|candidate| {
            json!({
                "name": candidate.name,
                "evaluation": candidate.evaluation.as_ref().map(|found| {
                    let mut value = rmse_document(&found.reprojection.rmse());
                    value["frames"] = json!(found.poses.len());
                    value["frames_left_out"] = json!(found.left_out.len());
                    value
                }),
                "reconstruction": candidate.reconstruction.as_ref().map(reconstruction_json),
                "translation": candidate.translation.as_ref().map(displacements_json),
                "truth": candidate.truth.as_ref().map(|errors| {
                    errors.iter().map(parameter_json).collect::<Vec<_>>()
                }),
            })
        })
        .collect();
    let poses: Vec<Value> = evaluation
        .poses
        .iter()
        .map(|(name, e)| {
            json!({
                "boards": name,
                "frames": e.frames,
                "across_mm": e.across_mm,
                "along_mm": e.along_mm,
                "rotation_rad": e.rotation_rad,
            })
        })
        .collect();
    json!({
        "format": "plenocal-evaluation",
        "version": 1,
        "cameras": candidates,
        "point_clouds": evaluation.clouds.as_ref().map(displacements_json),
        "poses_against_truth": poses,
        "problems": evaluation.findings.iter().map(ToString::to_string).collect::<Vec<_>>(),
        "findings": evaluation.findings,
        "cross_validation": evaluation.folds.as_ref().map(|folds| json!({
            "rmse": rmse_document(&folds.rmse),
            "jackknife_standard_deviations": folds.jackknife_std_devs(),
            "folds": folds.folds.iter().map(|fold| json!({
                "frames": fold.frames,
                "without_pose": fold.left_out,
                "converged": fold.converged,
                "rmse": rmse_document(&fold.rmse),
            })).collect::<Vec<_>>(),
        })),
    })
}

fn parameter_json(e: &ParameterError) -> Value {
    json!({
        "parameter": e.name,
        "unit": e.unit,
        "truth": e.truth,
        "estimate": e.estimate,
        "standard_deviation": e.std_dev,
    })
}

fn reconstruction_json(r: &Reconstruction) -> Value {
    json!({
        "frames": r.frames,
        "points": r.points,
        "left_out": r.left_out,
        "distances_too_long": { "mean": r.too_long, "standard_deviation": r.too_long_std_dev },
        "across_mm": r.across_mm,
        "along_mm": r.along_mm,
    })
}

fn displacements_json(displacements: &Displacements) -> Value {
    let spread = |s: Spread| json!({ "mean": s.mean, "standard_deviation": s.std_dev });
    json!({
        "whole_way": step_json(&displacements.whole),
        "relative_error": spread(displacements.relative()),
        "absolute_error_mm": spread(displacements.absolute_mm()),
        "steps": displacements.steps.iter().map(step_json).collect::<Vec<_>>(),
    })
}

fn step_json(s: &Displacement) -> Value {
    json!({
        "from": s.from,
        "to": s.to,
        "true_mm": s.true_mm,
        "measured_mm": s.measured_mm,
    })
}
