//! What a calibration gives.

use std::fmt;

use nalgebra::Isometry3;

use crate::calibration::CalibrationOptions;
use crate::camera::PlenopticCamera;
use crate::evaluation::{Reprojection, Uncertainty};
use crate::optics;
use crate::precalibration::MicroImageArray;

/// One iteration of the refinement.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Iteration {
    /// From 0, the start.
    pub number: i32,
    /// The cost.
    pub cost: f64,
    /// Largest component of the gradient.
    pub gradient_max_norm: f64,
    /// Length of the step.
    pub step_norm: f64,
    /// Radius of the trust region.
    pub trust_region_radius: f64,
    /// Wall time since the start of the solve, s.
    pub time_s: f64,
}

/// Why the solver stopped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Termination {
    /// At a minimum, by the solver's tolerances.
    Converged,
    /// At the limit of iterations.
    IterationLimit,
    /// By the progress function.
    Stopped,
    /// By a failure.
    Failed,
}

/// What the solver gives back.
#[derive(Debug, Clone, PartialEq)]
pub struct Refinement {
    /// The refined camera.
    pub camera: PlenopticCamera,
    /// The refined `camera_from_board`, in the order given.
    pub poses: Vec<Isometry3<f64>>,
    /// Cost at the start.
    pub initial_cost: f64,
    /// Cost at the end.
    pub cost: f64,
    /// Why it stopped.
    pub termination: Termination,
    /// The same in Ceres' words.
    pub message: String,
    /// Ceres' full report.
    pub report: String,
    /// Wall time of the solve, s.
    pub time_s: f64,
    /// Every iteration.
    pub iterations: Vec<Iteration>,
}

impl Refinement {
    /// This refinement and one that went on from where it ended, as one.
    pub(super) fn followed_by(self, next: Self) -> Self {
        let last = self.iterations.last().map_or(0, |i| i.number);
        let later = next.iterations.iter().skip(1).map(|i| Iteration {
            number: last + i.number,
            time_s: self.time_s + i.time_s,
            ..*i
        });
        Self {
            initial_cost: self.initial_cost,
            report: format!("{}\n{}", self.report, next.report),
            time_s: self.time_s + next.time_s,
            iterations: self.iterations.iter().copied().chain(later).collect(),
            ..next
        }
    }
}

/// A frame and its pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FramePose {
    /// Label of the frame.
    pub frame: u32,
    /// Takes points of the board frame into the camera frame, mm.
    pub camera_from_board: Isometry3<f64>,
}

/// A frame that was not used.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LeftOut {
    /// Label of the frame.
    pub frame: u32,
    /// Number of its features.
    pub features: usize,
    /// Why.
    pub reason: String,
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
    /// What it was told.
    pub options: CalibrationOptions,
    /// What the user should know, in words.
    pub warnings: Vec<String>,
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
