//! `calibration.json`: result of a calibration with all details; `cost.json`: the same details at a solution of another
//! program.

use serde::Serialize;
use serde_json::{Map, Value, json};

use super::board_shape_file::board_shape_document;
use super::camera_file::errors_text;
use super::{camera_document, poses_document};
use crate::assessment::{Assessment, Distance, ModelComparison, PointTrust, Verdict, WithoutGroup};
use crate::calibration::{
    BlurMeasurement, Calibration, PriorResult, TypeBlur, termination_text, weakest_directions_text,
};
use crate::finding::{Finding, Severity};
use crate::model::{Parameter, Rmse};
use crate::quantity::Estimate;
use crate::solver::{LossKind, SystematicChange};

/// Returns the content of `camera.json` for a calibration. It also states whether the calibration has converged, the verdict
/// with the codes of its reasons, and the distances of its boards.
#[must_use]
pub fn calibrated_camera_document(calibration: &Calibration, assessment: &Assessment) -> Value {
    let mut camera = camera_document(&calibration.camera, Some(&calibration.uncertainty));
    camera["converged"] = calibration.converged.into();
    let reasons = assessment.findings.iter().filter(|finding| finding.severity > Severity::Note);
    camera["verdict"] = json!({
        "verdict": assessment.verdict.to_string(),
        "reasons": reasons.map(Finding::code).collect::<Vec<_>>(),
    });
    let distances = calibration.poses.iter().map(|p| p.camera_from_board.translation.z);
    let [near_mm, far_mm] =
        distances.fold([f64::INFINITY, 0.0], |[near, far], z: f64| [near.min(z), far.max(z)]);
    camera["boards"] =
        json!({ "frames": calibration.poses.len(), "near_mm": near_mm, "far_mm": far_mm });
    camera
}

/// Errors of the features of a frame.
#[derive(Serialize)]
struct FrameErrors {
    frame: u32,
    #[serde(flatten)]
    rmse: Rmse,
}

fn assessment_document(assessment: &Assessment) -> Value {
    let reasons: Vec<Value> = assessment
        .findings
        .iter()
        .filter(|finding| finding.severity > Severity::Note)
        .map(|finding| {
            let verdict = Verdict::of(std::slice::from_ref(finding)).to_string();
            json!({ "verdict": verdict, "text": finding.to_string(), "code": finding.code() })
        })
        .collect();
    let features: Vec<Value> = assessment
        .outliers
        .features
        .iter()
        .map(|o| {
            let f = &o.residual.feature;
            json!({
                "frame": f.frame, "corner": f.corner, "k": f.k, "l": f.l,
                "distance_px": o.distance_px, "std_devs": o.std_devs,
            })
        })
        .collect();
    let frames: Vec<Value> = assessment
        .outliers
        .frames
        .iter()
        .map(|o| {
            json!({
                "frame": o.frame,
                "residual_ratio": o.residual_ratio,
                "parameter": o.influence.map(|i| i.parameter),
                "influence": o.influence.map(|i| i.std_devs),
                "unexpected": o.influence.map(|i| i.unexpected),
            })
        })
        .collect();
    let space = assessment.object_space.as_ref().map(|space| {
        let points = |d: &Distance| -> Vec<Value> {
            let of = |p: &PointTrust| {
                json!({
                    "pixel_px": p.pixel_px,
                    "point_mm": <[f64; 3]>::from(p.point_mm.coords),
                    "micro_lenses": p.micro_lenses,
                    "std_dev_across_along_mm": p.std_dev_mm,
                    "noise_across_along_mm": p.noise_mm,
                })
            };
            d.points.iter().map(of).collect()
        };
        let of = |d: &Distance| {
            json!({
                "distance_mm": d.distance_mm,
                "within_boards": d.within_boards,
                "points": points(d),
            })
        };
        space.distances.iter().map(of).collect::<Vec<_>>()
    });
    let next = assessment.next_board.as_ref().map(|n| {
        json!({
            "distance_mm": n.distance_mm,
            "tilt_deg": n.tilt_deg,
            "pixel_px": n.pixel_px,
            "largest_std_dev_before_after_mm": n.largest_mm,
        })
    });
    json!({
        "verdict": assessment.verdict.to_string(),
        "reasons": reasons,
        "outlying_features": features,
        "outlying_frames": frames,
        "object_space": space,
        "next_board": next,
    })
}

fn priors_document(calibration: &Calibration) -> Value {
    let of = |a: &PriorResult| {
        json!({
            "quantity": a.prior.quantity,
            "unit": a.unit(),
            "value": a.prior.value,
            "std_dev": a.prior.std_dev,
            "result": a.result,
            "normalised_residual": a.normalised_residual(),
            "source": a.source.to_string(),
        })
    };
    json!({
        "weight": (!calibration.priors.is_empty()).then_some(calibration.cost.prior_weight),
        "priors": calibration.priors.iter().map(of).collect::<Vec<_>>(),
    })
}

/// Returns the changes of the parameters due to each systematic error.
fn systematic_errors_document(calibration: &Calibration) -> Vec<Value> {
    let uncertainty = &calibration.uncertainty;
    let names = Parameter::shared(calibration.camera.lens_types());
    let of = |SystematicChange { source, changes }: &SystematicChange| {
        let change = |(&index, change): (&usize, &f64)| {
            (names[index].name().to_owned(), Value::from(*change))
        };
        let changes: Map<String, Value> =
            uncertainty.free_intrinsics.iter().zip(changes).map(change).collect();
        json!({ "source": source, "changes": changes })
    };
    uncertainty.systematic_changes.iter().map(of).collect()
}

/// Returns both σ of every free parameter, and the relative uncertainty of the first.
fn std_devs_document(calibration: &Calibration) -> Value {
    let lens_types = calibration.camera.lens_types();
    let uncertainty = &calibration.uncertainty;
    let parameters: Map<String, Value> = Parameter::shared(lens_types)
        .iter()
        .zip(uncertainty.shared_std_devs(lens_types))
        .filter_map(|(p, std_devs)| {
            let (used, independent, relative) = std_devs?;
            let value = json!({
                "used": used,
                "independent": independent,
                "ratio": used / independent,
                "relative_uncertainty": relative,
                "unit": p.unit(),
            });
            Some((p.name().to_owned(), value))
        })
        .collect();
    json!({ "errors": errors_text(uncertainty), "parameters": parameters })
}

/// Returns the result of a calibration as one JSON object. `time_s` is the wall time of the whole command.
#[must_use]
pub fn calibration_document(
    calibration: &Calibration,
    assessment: &Assessment,
    time_s: f64,
) -> Value {
    let (refinement, reprojection) = (&calibration.refinement, &calibration.reprojection);
    let mut rmse = json!(reprojection.rmse());
    rmse["centers"] = json!(reprojection.centers_rmse_px());
    let frames = calibration.poses.iter().map(|p| p.frame);
    let frames: Vec<FrameErrors> =
        frames.map(|frame| FrameErrors { frame, rmse: reprojection.frame_rmse(frame) }).collect();
    let types: Vec<Rmse> =
        (0..calibration.camera.lens_types()).map(|i| reprojection.lens_type_rmse(i)).collect();
    let left_out: Vec<Value> = calibration
        .left_out
        .iter()
        .map(
            |l| json!({ "frame": l.frame, "features": l.features, "reason": l.reason.to_string() }),
        )
        .collect();
    let [uv, rho, centers] = calibration.uncertainty.residual_std_dev_px;
    let uncertainty = Some(&calibration.uncertainty);
    let warnings: Vec<String> = calibration.findings.iter().map(ToString::to_string).collect();
    json!({
        "verdict": assessment_document(assessment),
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
            "over_stated": calibration.uncertainty.std_dev_factors,
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
        "priors": priors_document(calibration),
        "blur": blur_document(calibration.blur.as_ref()),
        "board_shape": board_shape_document(&calibration.board),
        "standard_deviations": std_devs_document(calibration),
        "systematic_errors": systematic_errors_document(calibration),
        "weakest_directions": weakest_directions_text(calibration),
        "warnings": warnings,
        "findings": calibration.findings,
        "models": null,
        "initial_camera": camera_document(&calibration.initial, None),
        "camera": calibrated_camera_document(calibration, assessment),
        "poses": poses_document(&calibration.poses, uncertainty, &calibration.shifted_frames)["poses"],
    })
}

/// Returns the aperture ratio and the excess edge variance of each lens type; null without measured blur.
fn blur_document(measured: Option<&BlurMeasurement>) -> Value {
    let of_type = |of: &TypeBlur| {
        let Estimate { value: excess_px, std_dev: std_dev_px } = of.excess_px;
        json!({
            "aperture_ratio": of.aperture_ratio,
            "excess_px": excess_px,
            "excess_std_dev_px": std_dev_px,
            "features": of.features,
        })
    };
    measured.map_or(Value::Null, |measured| {
        let types: Vec<Option<Value>> =
            measured.types.iter().map(|of| of.as_ref().map(of_type)).collect();
        json!({ "aperture_ratio": measured.aperture_ratio, "lens_types": types })
    })
}

/// Returns `models`: the comparison of models without groups of parameters.
#[must_use]
pub fn models_document(comparison: &ModelComparison) -> Value {
    let of_group = |without: &WithoutGroup| {
        let (mean, std_error) = without.mean_growth();
        let [features, centers, priors] = without.cost_growth;
        let (longer_mm, std_devs) = without.focal_length_change;
        let frames: Vec<Value> = without
            .growth
            .iter()
            .map(|(frame, growth)| json!({ "frame": frame, "growth": growth }))
            .collect();
        json!({
            "group": without.group.to_string(),
            "parameters": without.parameters,
            "verdict": without.worth().to_string(),
            "error_growth": { "mean": mean, "standard_error": std_error, "frames": frames },
            "chi_square_growth": { "features": features, "centers": centers, "priors": priors },
            "focal_length_mm": without.camera.main_lens.focal_length_mm,
            "focal_length_change": { "mm": longer_mm, "std_devs": std_devs },
            "pattern": without.pattern,
            "converged": without.converged,
        })
    };
    let errors: Vec<Value> = comparison
        .errors
        .iter()
        .map(|(frame, error)| json!({ "frame": frame, "error": error }))
        .collect();
    json!({
        "folds": comparison.folds,
        "frames": errors,
        "error": comparison.mean_error(),
        "pattern": comparison.pattern,
        "groups": comparison.groups.iter().map(of_group).collect::<Vec<_>>(),
        "problems": comparison.findings.iter().map(ToString::to_string).collect::<Vec<_>>(),
    })
}

/// Returns `evaluation` of `cost.json`: the parts of the cost (features, centres, priors), its gradient and the gain of one
/// more step, by the names of the free parameters and in their units.
#[must_use]
pub fn cost_document(evaluated: &Calibration, [features, centers, priors]: [f64; 3]) -> Value {
    let uncertainty = &evaluated.uncertainty;
    let names = Parameter::shared(evaluated.camera.lens_types());
    let by_name = |values: &[f64]| -> Map<String, Value> {
        let free = uncertainty.free_intrinsics.iter().zip(values);
        free.map(|(&index, value)| (names[index].name().to_owned(), json!(value))).collect()
    };
    json!({
        "cost": evaluated.refinement.cost,
        "of_features": features,
        "of_centers": centers,
        "of_priors": priors,
        "prior_weight": (!evaluated.priors.is_empty()).then_some(evaluated.cost.prior_weight),
        "is_minimum": evaluated.converged,
        "gradient_max_norm": uncertainty.gradient.iter().fold(0.0_f64, |most, g| most.max(g.abs())),
        "gradient": by_name(&uncertainty.gradient),
        "expected_decrease": uncertainty.expected_decrease,
        "next_step": by_name(&uncertainty.next_step),
    })
}
