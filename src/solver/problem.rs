//! A problem for the solver.

use nalgebra::{Isometry3, Point3};

use crate::model::{MicroImageCenter, PlenopticCamera};

/// A feature as the solver takes it: the frame is an index into the poses.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct SolverFeature {
    pub pose: usize,
    pub board_point_mm: Point3<f64>,
    pub k: i32,
    pub l: i32,
    pub u_px: f64,
    pub v_px: f64,
    pub rho_px: f64,
}

/// A problem for the solver.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Problem<'a> {
    pub camera: &'a PlenopticCamera,
    pub poses: &'a [Isometry3<f64>],
    pub features: &'a [SolverFeature],
    pub centers: &'a [MicroImageCenter],
}
