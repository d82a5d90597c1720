//! `calibration.json`: a calibration with all details of how it was obtained.

use serde_json::{Value, json};

use super::{camera_document, poses_document};
use crate::calibration::{Calibration, termination_text, weakest_directions_text};
use crate::model::Rmse;
use crate::solver::LossKind;

/// The content of `camera.json` for a calibration, `converged` included.
#[must_use]
pub fn calibrated_camera_document(calibration: &Calibration) -> Value {
    let mut camera = camera_document(&calibration.camera, Some(&calibration.uncertainty));
    camera["converged"] = calibration.converged.into();
    camera
}

pub(super) fn rmse_document(rmse: &Rmse) -> Value {
    json!({ "features": rmse.count, "all": rmse.all_px, "uv": rmse.uv_px, "rho": rmse.rho_px })
}

/// The result of a calibration as one JSON object. `time_s` is the wall time of the whole command.
#[must_use]
pub fn calibration_document(calibration: &Calibration, time_s: f64) -> Value {
    let (refinement, reprojection) = (&calibration.refinement, &calibration.reprojection);
    let mut rmse = rmse_document(&reprojection.rmse());
    rmse["centers"] = json!(reprojection.centers_rmse_px());
    let frames: Vec<Value> = calibration
        .poses
        .iter()
        .map(|p| {
            let mut entry = rmse_document(&reprojection.frame_rmse(p.frame));
            entry["frame"] = json!(p.frame);
            entry
        })
        .collect();
    let types: Vec<Value> = (0..calibration.camera.lens_types())
        .map(|i| rmse_document(&reprojection.lens_type_rmse(i)))
        .collect();
    let left_out: Vec<Value> = calibration
        .left_out
        .iter()
        .map(
            |l| json!({ "frame": l.frame, "features": l.features, "reason": l.reason.to_string() }),
        )
        .collect();
    let [uv, rho, centers] = calibration.uncertainty.residual_std_dev_px;
    let uncertainty = Some(&calibration.uncertainty);
    let warnings: Vec<String> = calibration.warnings.iter().map(ToString::to_string).collect();
    json!({
        "converged": calibration.converged,
        "termination": termination_text(calibration),
        "cost": refinement.cost,
        "initial_cost": refinement.initial_cost,
        "expected_decrease": calibration.uncertainty.expected_decrease,
        "iterations": refinement.iterations.last().map_or(0, |i| i.number),
        "rmse": rmse,
        "rmse_by_frame": frames,
        "rmse_by_lens_type": types,
        "m_error": calibration.m_error(),
        "initial_centers_rmse": calibration.initial_centers_rmse_px,
        "noise": {
            "uv": uv,
            "rho": rho,
            "centers": centers,
            "weighted_by_loss": calibration.cost.loss.kind != LossKind::None,
        },
        "counts": {
            "features": reprojection.features.len(),
            "centers": reprojection.centers.len(),
            "frames": calibration.poses.len(),
            "frames_left_out": calibration.left_out.len(),
            "features_left_out":
                calibration.left_out.iter().map(|l| l.features).sum::<usize>(),
            "parameters": calibration.uncertainty.size(),
        },
        "frames_left_out": left_out,
        "time_s": time_s,
        "solver_time_s": refinement.time_s,
        "weakest_directions": weakest_directions_text(calibration),
        "warnings": warnings,
        "initial_camera": camera_document(&calibration.initial, None),
        "camera": calibrated_camera_document(calibration),
        "poses": poses_document(&calibration.poses, uncertainty)["poses"],
    })
}
