//! Conversions between types of the bridge, cameras and boards, and types of nalgebra.

use std::ops::Index;

use nalgebra::{DMatrix, Isometry3, Point3, Translation3, UnitQuaternion, Vector2, Vector3};

use super::bridge::ffi;
use crate::model::{BentBoard, BoardShape, Packing, Parameter, Parity, PlenopticCamera, SHAPE};

impl From<&PlenopticCamera> for ffi::CameraParts {
    fn from(camera: &PlenopticCamera) -> Self {
        let packing = match camera.lattice.packing {
            Packing::Orthogonal => ffi::Packing::Orthogonal,
            Packing::HexagonalRows(Parity::Even) => ffi::Packing::HexagonalRowsEven,
            Packing::HexagonalRows(Parity::Odd) => ffi::Packing::HexagonalRowsOdd,
            Packing::HexagonalColumns(Parity::Even) => ffi::Packing::HexagonalColumnsEven,
            Packing::HexagonalColumns(Parity::Odd) => ffi::Packing::HexagonalColumnsOdd,
        };
        Self {
            packing,
            columns: camera.lattice.columns,
            rows: camera.lattice.rows,
            pixel_size_mm: camera.sensor.pixel_size_mm,
            lens_types: camera.lens_types(),
            parameters: camera.intrinsics(),
        }
    }
}

impl From<&BentBoard> for ffi::BoardParts {
    fn from(bent: &BentBoard) -> Self {
        let middle = bent.board.middle_mm();
        let shape = Parameter::SHAPE.map(|parameter| bent.shape.value(parameter));
        Self { half_mm: [middle.x, middle.y], shape }
    }
}

/// Creates the shape with these parameters.
pub(super) fn shape(values: &[f64; SHAPE]) -> BoardShape {
    let mut shape = BoardShape::default();
    for (parameter, &value) in Parameter::SHAPE.into_iter().zip(values) {
        shape.set(parameter, value);
    }
    shape
}

impl From<&Isometry3<f64>> for ffi::PoseBlock {
    fn from(pose: &Isometry3<f64>) -> Self {
        let (r, t) = (pose.rotation.scaled_axis(), pose.translation.vector);
        Self { block: [r.x, r.y, r.z, t.x, t.y, t.z] }
    }
}

impl From<&ffi::PoseBlock> for Isometry3<f64> {
    fn from(pose: &ffi::PoseBlock) -> Self {
        let [rx, ry, rz, tx, ty, tz] = pose.block;
        let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(rx, ry, rz));
        Isometry3::from_parts(Translation3::new(tx, ty, tz), rotation)
    }
}

impl From<&Point3<f64>> for ffi::PointRow {
    fn from(point: &Point3<f64>) -> Self {
        Self { point_mm: point.coords.into() }
    }
}

impl From<&Vector2<f64>> for ffi::Pair {
    fn from(v: &Vector2<f64>) -> Self {
        Self { x: v.x, y: v.y }
    }
}

/// Converts all items to or from types of the bridge.
pub(super) fn rows<'a, T, Row: From<&'a T>>(all: &'a [T]) -> Vec<Row> {
    all.iter().map(Row::from).collect()
}

/// Replaces missing results of the core by `None`: it marks them by NaN in `number`.
pub(super) fn found<T>(rows: Vec<T>, number: impl Fn(&T) -> f64) -> Vec<Option<T>> {
    rows.into_iter().map(|row| (!number(&row).is_nan()).then_some(row)).collect()
}

impl Index<(usize, usize)> for ffi::Matrix {
    type Output = f64;

    fn index(&self, (row, column): (usize, usize)) -> &f64 {
        &self.row(row)[column]
    }
}

impl ffi::Matrix {
    /// Returns the values of a row.
    #[must_use]
    pub fn row(&self, row: usize) -> &[f64] {
        &self.values[row * self.columns..][..self.columns]
    }
}

impl From<&ffi::Matrix> for DMatrix<f64> {
    fn from(matrix: &ffi::Matrix) -> Self {
        DMatrix::from_row_slice(matrix.rows, matrix.columns, &matrix.values)
    }
}
