//! Checkerboard and its poses.

use clap::ValueEnum;
use nalgebra::{Isometry3, Point3, Vector3};
use serde::{Deserialize, Serialize, Serializer};

use super::checks::positive;
use crate::error::{Error, Result};

/// Largest number of inner corners along a side of a board.
const MAX_BOARD_CORNERS: i32 = 10_000;

/// Largest relative difference between the edges of squares of one board, as stated twice.
const SAME_SQUARE: f64 = 0.01;

/// Checkerboard, described by its inner corners.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Board {
    /// Number of inner corners along a row.
    pub columns: i32,
    /// Number of inner corners along a column.
    pub rows: i32,
    /// Edge of a square, mm.
    pub square_mm: f64,
}

impl Board {
    /// Returns the number of inner corners.
    #[must_use]
    pub fn corners(&self) -> i32 {
        self.columns * self.rows
    }

    /// Returns the position of corner `row · columns + column` in the board frame, mm: x along the columns, y along the rows, z
    /// = 0.
    #[must_use]
    pub fn point_mm(&self, corner: i32) -> Point3<f64> {
        // This only avoids a division by zero: a board without columns has no corners.
        let columns = self.columns.max(1);
        let (row, column) = (corner.div_euclid(columns), corner.rem_euclid(columns));
        Point3::new(f64::from(column) * self.square_mm, f64::from(row) * self.square_mm, 0.0)
    }

    /// Returns the inner corners at the four corners of the board, mm.
    #[must_use]
    pub fn outer_corners_mm(&self) -> [Point3<f64>; 4] {
        let (last_column, last) = (self.columns - 1, self.corners() - 1);
        [0, last_column, last - last_column, last].map(|corner| self.point_mm(corner))
    }

    /// Returns the middle of the board, mm.
    #[must_use]
    pub fn middle_mm(&self) -> Point3<f64> {
        Point3::from(self.point_mm(self.corners() - 1).coords / 2.0)
    }

    /// Returns the distance from the first corner to the last, mm.
    #[must_use]
    pub fn diagonal_mm(&self) -> f64 {
        self.point_mm(self.corners() - 1).coords.norm()
    }

    /// Returns true if another board is the same: edges of squares that were measured twice differ by less than 1 %.
    #[must_use]
    pub fn is_same(&self, other: &Self) -> bool {
        let of = |board: &Self| (board.columns, board.rows);
        of(self) == of(other)
            && (self.square_mm - other.square_mm).abs() <= SAME_SQUARE * self.square_mm
    }

    /// Returns an error unless the board has corners and a size.
    pub fn validate(&self) -> Result<()> {
        let possible = 2..=MAX_BOARD_CORNERS;
        if !possible.contains(&self.columns) || !possible.contains(&self.rows) {
            return Err(Error::invalid(format!(
                "a board of {} x {} inner corners is not possible: columns and rows have to be \
                 from 2 to {MAX_BOARD_CORNERS}",
                self.columns, self.rows
            )));
        }
        positive(self.square_mm, "the size of the squares of the board (square_mm)")
    }
}

/// Deviation of a board from a flat grid of squares, the same in all frames.
///
/// With (x, y) from corner 0, and ξ and η from −1 to 1 over the corners along x and y, a corner is at
///
/// (x (1 + aspect/2), y (1 − aspect/2), sag_x ξ² + sag_y η² + twist ξη)
///
/// in the board frame, whose z points away from the camera. All parameters are 0 for a flat board.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BoardShape {
    /// Distance of the ends of the rows behind their middle, mm.
    pub sag_x_mm: f64,
    /// Distance of the ends of the columns behind their middle, mm.
    pub sag_y_mm: f64,
    /// Distance of the first and the last corner behind the middle, mm; the other two are nearer by the same distance.
    pub twist_mm: f64,
    /// Fraction by which squares are longer along x than along y.
    pub aspect: f64,
}

/// Board with its shape.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BentBoard {
    /// Flat grid of its corners.
    pub board: Board,
    /// Deviation from the flat grid.
    pub shape: BoardShape,
}

impl BentBoard {
    /// Returns the largest of sag and twist, mm.
    #[must_use]
    pub fn bend_mm(&self) -> f64 {
        let BoardShape { sag_x_mm, sag_y_mm, twist_mm, .. } = self.shape;
        [sag_x_mm, sag_y_mm, twist_mm].into_iter().map(f64::abs).fold(0.0, f64::max)
    }

    /// Returns the position of a corner in the board frame, mm, by the formula of [`BoardShape`].
    #[must_use]
    pub fn point_mm(&self, corner: i32) -> Point3<f64> {
        let BoardShape { sag_x_mm, sag_y_mm, twist_mm, aspect } = self.shape;
        let (flat, middle) = (self.board.point_mm(corner), self.board.middle_mm());
        let (xi, eta) = (flat.x / middle.x - 1.0, flat.y / middle.y - 1.0);
        let z = sag_x_mm * xi * xi + sag_y_mm * eta * eta + twist_mm * xi * eta;
        Point3::new(flat.x * (1.0 + aspect / 2.0), flat.y * (1.0 - aspect / 2.0), z)
    }

    /// Returns the mean displacement of the corners due to a small change of each shape parameter, mm per unit of the
    /// parameter, in the board frame; in the order of [`Parameter::SHAPE`](super::Parameter::SHAPE).
    #[must_use]
    pub fn mean_motion_mm(&self) -> [Vector3<f64>; 4] {
        // This is the mean of ξ² over n equidistant values from −1 to 1.
        let square = |n: i32| f64::from(n + 1) / f64::from(3 * (n - 1));
        let middle = self.board.middle_mm() / 2.0;
        [
            Vector3::new(0.0, 0.0, square(self.board.columns)),
            Vector3::new(0.0, 0.0, square(self.board.rows)),
            Vector3::zeros(),
            Vector3::new(middle.x, -middle.y, 0.0),
        ]
    }
}

impl From<Board> for BentBoard {
    fn from(board: Board) -> Self {
        Self { board, shape: BoardShape::default() }
    }
}

/// Frame and the pose of its board.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct FramePose {
    /// Number of the frame.
    pub frame: u32,
    /// Transformation from the board frame to the camera frame, mm.
    #[serde(serialize_with = "as_vectors")]
    pub camera_from_board: Isometry3<f64>,
}

/// Writes rotation vector, rad, and translation, mm.
fn as_vectors<S: Serializer>(pose: &Isometry3<f64>, to: S) -> std::result::Result<S::Ok, S::Error> {
    let rotation: [f64; 3] = pose.rotation.scaled_axis().into();
    let translation: [f64; 3] = pose.translation.vector.into();
    (rotation, translation).serialize(to)
}

/// Purpose of a set of frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Subset {
    /// Boards of the calibration.
    Calibration,
    /// Boards of the evaluation.
    Evaluation,
    /// Board moved along the optical axis.
    Translation,
}

impl Subset {
    /// All subsets.
    pub const ALL: [Self; 3] = [Self::Calibration, Self::Evaluation, Self::Translation];

    /// Returns the name in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Calibration => "calibration",
            Self::Evaluation => "evaluation",
            Self::Translation => "translation",
        }
    }
}
