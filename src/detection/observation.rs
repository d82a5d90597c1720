//! A corner as one micro-image shows it.

use nalgebra::{Matrix2, Vector2};
use serde::{Deserialize, Serialize};

/// A corner of the board observed in a micro-image.
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
    /// Standard deviation of the position per axis, px.
    pub std_dev_px: f64,
    /// A form that is positive along directions to bright squares and negative to dark ones, for the
    /// pinhole image; zero if it is not known.
    pub squares: Matrix2<f64>,
}

/// How the virtual depth of a corner is estimated from its observations.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DepthEstimator {
    /// By the slope of the line through all of them, by robust least squares.
    #[default]
    Line,
    /// By the paper's median over all pairs.
    Median,
}
