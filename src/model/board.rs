//! The checkerboard and its poses.

use nalgebra::{Isometry3, Point3};
use serde::{Deserialize, Serialize};

use super::checks::positive;
use crate::error::{Error, Result};

/// The largest number of inner corners along a side of a board.
const MAX_BOARD_CORNERS: i32 = 10_000;

/// A checkerboard, by its inner corners.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Board {
    /// Inner corners along a row.
    pub columns: i32,
    /// Inner corners along a column.
    pub rows: i32,
    /// Edge of a square, mm.
    pub square_mm: f64,
}

impl Board {
    /// Number of inner corners.
    #[must_use]
    pub fn corners(&self) -> i32 {
        self.columns * self.rows
    }

    /// Position of corner `row · columns + column` in the board frame, mm: x along the columns, y
    /// along the rows, z = 0.
    #[must_use]
    pub fn point_mm(&self, corner: i32) -> Point3<f64> {
        let (row, column) = (corner.div_euclid(self.columns), corner.rem_euclid(self.columns));
        Point3::new(f64::from(column) * self.square_mm, f64::from(row) * self.square_mm, 0.0)
    }

    /// The corners at its four corners, mm.
    #[must_use]
    pub fn outer_corners_mm(&self) -> [Point3<f64>; 4] {
        let (last_column, last) = (self.columns - 1, self.corners() - 1);
        [0, last_column, last - last_column, last].map(|corner| self.point_mm(corner))
    }

    /// Its middle, mm.
    #[must_use]
    pub fn middle_mm(&self) -> Point3<f64> {
        Point3::from(self.point_mm(self.corners() - 1).coords / 2.0)
    }

    /// An error unless the board has corners and a size.
    pub fn validate(&self) -> Result<()> {
        let possible = 2..=MAX_BOARD_CORNERS;
        if !possible.contains(&self.columns) || !possible.contains(&self.rows) {
            return Err(Error::invalid(format!(
                "a board of {} x {} inner corners cannot be used; each side takes 2 to \
                 {MAX_BOARD_CORNERS}",
                self.columns, self.rows
            )));
        }
        positive(self.square_mm, "the edge of the board's squares (mm)")
    }
}

/// A frame and the pose of its board.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FramePose {
    /// Number of the frame.
    pub frame: u32,
    /// Takes points of the board frame into the camera frame, mm.
    pub camera_from_board: Isometry3<f64>,
}

/// What a set of frames is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Subset {
    /// Boards to calibrate with.
    Calibration,
    /// Boards to evaluate with.
    Evaluation,
    /// A board moved along the optical axis.
    Translation,
}

impl Subset {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Calibration, Self::Evaluation, Self::Translation];

    /// The name in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Calibration => "calibration",
            Self::Evaluation => "evaluation",
            Self::Translation => "translation",
        }
    }
}
