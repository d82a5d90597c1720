//! BAP features from raw images of a checkerboard (paper, section 4).

mod board;
mod cells;
mod corner;
mod dbscan;
mod frame;
mod line;
mod micro_images;
mod patch;
mod stage;

use crate::model::BapFeature;
use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};
use serde::{Deserialize, Serialize};

pub use board::{LatticePoint, TiedBoard};
pub use dbscan::dbscan;
pub use frame::{DetectedCorner, FrameCounts, Search, detect_frame};
pub use line::{
    Group, LineSearch, SightLine, groups_on_lines, median_inverse_virtual_depth, possible_slope,
};
pub use micro_images::{MicroImages, MicroOptics};
pub use stage::{BoardImage, DetectedBoards, DetectedFrame, NoFeatures, detect};

/// PLACEHOLDER until typed.
pub type Rejection = String;

/// A corner of the board seen in a micro-image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sight {
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

/// How the virtual depth of a corner is taken from its sights.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DepthEstimator {
    /// The slope of the line through all of them, by robust least squares.
    #[default]
    Line,
    /// The paper's: the median over all pairs.
    Median,
}

impl Detection {
    /// Pinhole image of a place on the board in columns and rows, px.
    #[must_use]
    pub fn pinhole(&self, column: f64, row: f64) -> Vector2<f64> {
        let p = self.homography * Vector3::new(column, row, 1.0);
        p.xy() / p.z
    }
}

/// The features of a frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Detection {
    /// Features, corner by corner.
    pub features: Vec<BapFeature>,
    /// The corners of the board.
    pub corners: Vec<DetectedCorner>,
    /// From (column, row, 1) of a corner to its pinhole image, px.
    pub homography: Matrix3<f64>,
}
