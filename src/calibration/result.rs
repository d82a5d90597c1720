//! What a calibration gives.

use std::fmt;

use crate::calibration::{CalibrationOptions, NoPose, Warning};
use crate::model::{FramePose, PlenopticCamera, Reprojection, optics};
use crate::precalibration::MicroImageArray;
use crate::solver::{Refinement, Uncertainty};

/// A frame that was not used.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LeftOut {
    /// Label of the frame.
    pub frame: u32,
    /// Number of its features.
    pub features: usize,
    /// Why.
    pub reason: NoPose,
}

/// A calibration: the camera and everything one wants to know about how it came about.
#[derive(Debug, Clone, PartialEq)]
pub struct Calibration {
    /// The camera before the refinement.
    pub initial: PlenopticCamera,
    /// |m| as white images had it, mm; `None` if the start was a calibrated camera.
    pub m_mm: Option<f64>,
    /// The refined camera.
    pub camera: PlenopticCamera,
    /// The poses of the frames used, by label.
    pub poses: Vec<FramePose>,
    /// The frames not used.
    pub left_out: Vec<LeftOut>,
    /// The grid of the centres; `None` without centres.
    pub grid: Option<MicroImageArray>,
    /// Root mean square centre residual of the initial camera, px; `None` without centres.
    pub initial_centers_rmse_px: Option<f64>,
    /// What the solver gave.
    pub refinement: Refinement,
    /// Residuals at the end.
    pub reprojection: Reprojection,
    /// Uncertainty at the end.
    pub uncertainty: Uncertainty,
    /// At a minimum: by the solver's tolerances, and by what a further step would gain.
    pub converged: bool,
    /// Its options.
    pub options: CalibrationOptions,
    /// What the user should know.
    pub warnings: Vec<Warning>,
}

impl Calibration {
    /// ε_m = (m* − m)/m*: by how much m of the white images falls short of that of the refined camera
    /// (paper, Table 2).
    #[must_use]
    pub fn m_error(&self) -> Option<f64> {
        let of_camera = optics::internal_parameters(&self.camera).m_mm;
        self.m_mm.map(|m| (of_camera - m) / of_camera)
    }
}

impl fmt::Display for LeftOut {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "frame {} is left out with its {} features: {}",
            self.frame, self.features, self.reason
        )
    }
}
