//! The result of a calibration.

use std::collections::BTreeSet;

use crate::calibration::{BlurMeasurement, BoardResult, CalibrationOptions, LeftOut, PriorResult};
use crate::finding::Finding;
use crate::model::{FramePose, Parameter, PlenopticCamera, Reprojection, optics};
use crate::precalibration::MicroImageArray;
use crate::solver::{CostOptions, Refinement, Uncertainty};

/// Calibration: the camera, and a record of how it was estimated.
#[derive(Debug, Clone, PartialEq)]
pub struct Calibration {
    /// The camera before the refinement.
    pub initial: PlenopticCamera,
    /// |m| from white images, mm; `None` if the start was a calibrated camera.
    pub m_mm: Option<f64>,
    /// The refined camera.
    pub camera: PlenopticCamera,
    /// The board.
    pub board: BoardResult,
    /// The poses of the frames used, by frame number.
    pub poses: Vec<FramePose>,
    /// Frames whose corners are numbered up to a shift by whole squares and a quarter turn, which their poses contain.
    pub shifted_frames: BTreeSet<u32>,
    /// Initial poses of these frames.
    pub initial_poses: Vec<FramePose>,
    /// The frames left out.
    pub left_out: Vec<LeftOut>,
    /// The grid of the centres; `None` without centres.
    pub grid: Option<MicroImageArray>,
    /// Root mean square centre residual of the initial camera, px; `None` without centres.
    pub initial_centers_rmse_px: Option<f64>,
    /// Result of the solver.
    pub refinement: Refinement,
    /// Residuals of the refined camera.
    pub reprojection: Reprojection,
    /// Uncertainty of the refined camera and poses.
    pub uncertainty: Uncertainty,
    /// True if the calibration is at a minimum: by the tolerances of the solver, and by the decrease of the cost that a
    /// further step would give.
    pub converged: bool,
    /// The options used.
    pub options: CalibrationOptions,
    /// The cost used, with all priors and their weight; without the loss if the solve ended before the
    /// loss took part.
    pub cost: CostOptions,
    /// Aperture ratios from the widths of edges; `None` if the features do not state these widths.
    pub blur: Option<BlurMeasurement>,
    /// Priors, with their values in the refined camera.
    pub priors: Vec<PriorResult>,
    /// Findings for the user.
    pub findings: Vec<Finding>,
}

impl Calibration {
    /// Returns ε_m = (m* − m)/m*: the relative amount by which m of the white images falls short of m* of the refined
    /// camera (paper, Table 2).
    #[must_use]
    pub fn m_error(&self) -> Option<f64> {
        let of_camera = optics::internal_parameters(&self.camera).m_mm;
        self.m_mm.map(|m| (of_camera - m) / of_camera)
    }

    /// Returns the relative standard deviation of m* = d(F + e_z)/2(D + e_z), the slope of Eq. (miradiusfnumber) for a pupil at
    /// e_z ([`optics::internal_parameters`]), from the derivatives of its logarithm; infinite if a parameter is not determined.
    #[must_use]
    pub fn m_std_dev(&self) -> f64 {
        let (camera, uncertainty) = (&self.camera, &self.uncertainty);
        let by_focal_length =
            1.0 / (camera.main_lens.focal_length_mm + camera.main_lens.exit_pupil_mm.z);
        let by_distance = -1.0 / camera.pupil_to_mla_mm();
        let names = Parameter::intrinsic(camera.lens_types());
        let rows = uncertainty.free_intrinsics.iter().enumerate();
        let gradient: Vec<(usize, f64)> = rows
            .filter_map(|(row, &index)| match names.get(index)? {
                Parameter::FocalLength => Some((row, by_focal_length)),
                Parameter::LensToArray => Some((row, by_distance)),
                Parameter::PupilZ => Some((row, by_focal_length + by_distance)),
                Parameter::ArrayToSensor => Some((row, 1.0 / camera.mla.mla_to_sensor_mm)),
                _ => None,
            })
            .collect();
        if gradient.iter().any(|(row, _)| !uncertainty.determined[*row]) {
            return f64::INFINITY;
        }
        let covariance = &uncertainty.covariance;
        let products = gradient
            .iter()
            .flat_map(|(i, a)| gradient.iter().map(move |(j, b)| a * b * covariance[(*i, *j)]));
        products.sum::<f64>().sqrt()
    }
}
