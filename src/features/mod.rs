//! BAP features from raw images of a checkerboard (paper, section 4).

mod board;
mod dbscan;
mod line;

use nalgebra::{Matrix2, Vector2};

pub use board::{LatticePoint, TiedBoard};
pub use dbscan::dbscan;
pub use line::{Group, SightLine, groups_on_lines, median_inverse_virtual_depth, possible_slope};

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
