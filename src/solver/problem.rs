//! A problem for the solver.

use nalgebra::{DMatrix, Isometry3, Matrix3, Point3};

use crate::model::{BentBoard, PlenopticCamera};

/// A feature as the solver takes it: the frame is an index into the poses.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct SolverFeature {
    pub pose: usize,
    /// Of the flat grid.
    pub board_point_mm: Point3<f64>,
    pub k: i32,
    pub l: i32,
    pub u_px: f64,
    pub v_px: f64,
    /// `None` where the camera is an array of pinholes.
    pub rho_px: Option<f64>,
    /// Standard deviations of u, v and ρ; those of `CostOptions` are factors on them.
    pub std_dev_px: [f64; 3],
}

/// A micro-image centre as the solver takes it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct SolverCenter {
    pub k: i32,
    pub l: i32,
    pub u_px: f64,
    pub v_px: f64,
    /// Standard deviation of u and of v; that of `CostOptions` is a factor on it.
    pub std_dev_px: f64,
}

/// A board point as the camera model images it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Projected {
    pub u_px: f64,
    pub v_px: f64,
    /// `None` for an array of pinholes, which has no blur.
    pub rho_px: Option<f64>,
}

/// How a point, reconstructed from its features by least squares, depends on camera and noise.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct PointSensitivity {
    /// Number of micro-lenses that see it.
    pub micro_lenses: usize,
    /// Its change with every intrinsic parameter, the features being fixed: three rows, mm per unit of the
    /// parameter; `None` if too few micro-lenses see it.
    pub by_intrinsics: Option<DMatrix<f64>>,
    /// Its covariance due to the noise of one observation, mm²; likewise.
    pub covariance: Option<Matrix3<f64>>,
}

/// A problem for the solver.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Problem<'a> {
    pub camera: &'a PlenopticCamera,
    pub board: BentBoard,
    pub poses: &'a [Isometry3<f64>],
    pub features: &'a [SolverFeature],
    pub centers: &'a [SolverCenter],
}
