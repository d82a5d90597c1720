//! Observation of a corner in one micro-image.

use clap::ValueEnum;
use nalgebra::{Matrix2, SMatrix, Vector2};
use serde::{Deserialize, Serialize};

/// Corner of the board observed in a micro-image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct CornerObservation {
    /// Index of the micro-image along u.
    pub k: i32,
    /// Index of the micro-image along v.
    pub l: i32,
    /// Centre c of the micro-image, px.
    pub center: Vector2<f64>,
    /// Position i of the corner, px.
    pub position: Vector2<f64>,
    /// Covariance of the position, px².
    pub covariance: Matrix2<f64>,
    /// Quadratic form of the pinhole image that is positive along directions to bright squares and negative to dark ones; zero
    /// if it is not known.
    pub squares: Matrix2<f64>,
}

impl CornerObservation {
    /// Converts equations of two rows, along u and v, to independent ones of variance 1.
    ///
    /// The covariance has to be positive.
    pub fn whitened<const N: usize>(&self, rows: &SMatrix<f64, 2, N>) -> SMatrix<f64, 2, N> {
        let [a, b, c] = [self.covariance.m11, self.covariance.m12, self.covariance.m22];
        let along_u = rows.row(0) / a.sqrt();
        // The part of v that correlates with u is removed.
        let along_v = (rows.row(1) - rows.row(0) * (b / a)) / (c - b * b / a).sqrt();
        SMatrix::from_rows(&[along_u, along_v])
    }
}

/// Estimator of the virtual depth of a corner from its observations.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum DepthEstimator {
    /// The slope of the line through all micro-images, by robust least squares.
    #[default]
    Line,
    /// The paper's median over pairs of micro-images.
    Median,
}
