//! Comparison of a calibration with the true camera and poses.

use nalgebra::Isometry3;
use serde::Serialize;

use crate::error::{Error, Result};
use crate::model::{BoardShape, FramePose, Parameter, PlenopticCamera, SHAPE};

/// An intrinsic parameter and its true value.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ParameterError {
    /// Symbol of the paper.
    #[serde(rename = "parameter")]
    pub name: String,
    /// Unit of the values.
    pub unit: &'static str,
    /// True value.
    pub truth: f64,
    /// Estimated value.
    pub estimate: f64,
    /// Standard deviation of the estimate; `None` if not known.
    #[serde(rename = "standard_deviation")]
    pub std_dev: Option<f64>,
}

impl ParameterError {
    /// Returns estimate minus truth.
    #[must_use]
    pub fn error(&self) -> f64 {
        self.estimate - self.truth
    }

    /// Returns the error in standard deviations; `None` if σ is not known.
    #[must_use]
    pub fn standardised(&self) -> Option<f64> {
        self.std_dev.filter(|s| *s > 0.0 && s.is_finite()).map(|s| self.error() / s)
    }
}

/// Returns the errors of every parameter that both cameras have, in the order of [`Parameter::intrinsic`]. `std_devs` belong
/// to the estimate, in the same order. The estimate may know another part of the
/// array. Fails if the cameras are of different kinds.
pub fn parameter_errors(
    truth: &PlenopticCamera,
    estimate: &PlenopticCamera,
    std_devs: &[Option<f64>],
) -> Result<Vec<ParameterError>> {
    let truth = truth.with_array_of(estimate).ok_or_else(|| {
        Error::invalid(format!(
            "the true camera has {}, but the estimated camera has {}: they belong to different \
             cameras",
            truth.lattice, estimate.lattice
        ))
    })?;
    let types = truth.lens_types().min(estimate.lens_types());
    let values = truth.intrinsics().into_iter().zip(estimate.intrinsics());
    let std_devs = std_devs.iter().copied().chain(std::iter::repeat(None));
    Ok(Parameter::intrinsic(types)
        .iter()
        .zip(values)
        .zip(std_devs)
        .map(|((parameter, (truth, estimate)), std_dev)| ParameterError {
            name: parameter.name().to_owned(),
            unit: parameter.unit(),
            truth,
            estimate,
            std_dev,
        })
        .collect())
}

/// Returns the errors of every parameter of the shape of a board, with their standard deviations.
#[must_use]
pub fn shape_errors(
    truth: &BoardShape,
    estimate: &BoardShape,
    std_devs: [Option<f64>; SHAPE],
) -> Vec<ParameterError> {
    let error = |(parameter, std_dev): (Parameter, Option<f64>)| ParameterError {
        name: parameter.name().to_owned(),
        unit: parameter.unit(),
        truth: truth.value(parameter),
        estimate: estimate.value(parameter),
        std_dev,
    };
    Parameter::SHAPE.into_iter().zip(std_devs).map(error).collect()
}

/// The errors of poses, as root mean squares over the frames that both sets have.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PoseErrors {
    /// Number of frames.
    pub frames: usize,
    /// Error of the position of the board across z, mm.
    pub across_mm: f64,
    /// Error of the distance of the board, mm.
    pub along_mm: f64,
    /// Error of the rotation of the board, rad.
    pub rotation_rad: f64,
}

/// Compares poses by frame. A board that is the same when turned by 180 degrees may have been labelled
/// in this way; `turned` takes the frame of the turned board to the frame of the board. `None` without common frames.
#[must_use]
pub fn pose_errors(
    truth: &[FramePose],
    estimate: &[FramePose],
    turned: &Isometry3<f64>,
) -> Option<PoseErrors> {
    let mut sum = PoseErrors { frames: 0, across_mm: 0.0, along_mm: 0.0, rotation_rad: 0.0 };
    for pose in estimate {
        let Some(truth) = truth.iter().find(|t| t.frame == pose.frame) else { continue };
        let candidates = [pose.camera_from_board, pose.camera_from_board * turned];
        let off = candidates.map(|p| p.rotation.angle_to(&truth.camera_from_board.rotation));
        let best = usize::from(off[1] < off[0]);
        let away = candidates[best].translation.vector - truth.camera_from_board.translation.vector;
        sum.frames += 1;
        sum.across_mm += away.xy().norm_squared();
        sum.along_mm += away.z.powi(2);
        sum.rotation_rad += off[best].powi(2);
    }
    let root = |square: f64| (square / sum.frames as f64).sqrt();
    (sum.frames > 0).then(|| PoseErrors {
        frames: sum.frames,
        across_mm: root(sum.across_mm),
        along_mm: root(sum.along_mm),
        rotation_rad: root(sum.rotation_rad),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shape_is_compared_parameter_by_parameter() {
        let truth = BoardShape { sag_x_mm: 0.1, aspect: 1e-3, ..BoardShape::default() };
        let found = BoardShape { sag_x_mm: 0.12, twist_mm: -0.01, ..BoardShape::default() };
        let errors = shape_errors(&truth, &found, [Some(0.01), Some(0.02), Some(0.01), None]);
        let names: Vec<&str> = errors.iter().map(|e| e.name.as_str()).collect();
        assert_eq!(names, ["sag_x", "sag_y", "twist", "aspect"]);
        let standardised: Vec<Option<f64>> =
            errors.iter().map(ParameterError::standardised).collect();
        assert!((standardised[0].unwrap() - 2.0).abs() < 1e-9);
        assert!((standardised[2].unwrap() + 1.0).abs() < 1e-9 && standardised[3].is_none());
        assert!((errors[3].error() + 1e-3).abs() < 1e-12);
    }
}
