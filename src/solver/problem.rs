//! Problem for the solver.

use nalgebra::Isometry3;

use super::bridge::ffi::{ProblemParts, SolverCenter, SolverFeature};
use super::conversions::rows;
use crate::model::{BentBoard, PlenopticCamera};

/// Problem for the solver.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Problem<'a> {
    pub camera: &'a PlenopticCamera,
    pub board: BentBoard,
    pub poses: &'a [Isometry3<f64>],
    pub features: &'a [SolverFeature],
    pub centers: &'a [SolverCenter],
}

impl<'a> Problem<'a> {
    pub(super) fn parts(&self) -> ProblemParts<'a> {
        ProblemParts {
            camera: self.camera.into(),
            board: (&self.board).into(),
            poses: rows(self.poses),
            features: self.features,
            centers: self.centers,
        }
    }
}
