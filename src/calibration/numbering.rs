//! Order in which the corners of features are numbered.

use std::collections::BTreeMap;

use nalgebra::{Matrix2, Vector2};

use crate::checks::boards as checks;
use crate::error::{Error, Result};
use crate::finding::{CornerNumbering, Finding};
use crate::model::{BapFeature, Board};

/// Returns an error if the corners are not numbered row by row from 0.
pub(super) fn check_numbering(features: &[BapFeature], board: &Board) -> Result<()> {
    let frames = shown_corners(features);
    let misfits = CornerNumbering::ALL
        .map(|numbering| (numbering, misfit(&frames, |corner| place(corner, board, numbering))));
    match checks::numbering(&misfits, board) {
        Ok(()) => Ok(()),
        Err(issue) => Err(Error::invalid(Finding::unusable(issue).to_string())),
    }
}

/// Corner as a frame shows it.
struct Shown {
    corner: i32,
    /// Mean position of its features, px.
    at: Vector2<f64>,
}

/// Returns the corners by frame.
fn shown_corners(features: &[BapFeature]) -> Vec<Vec<Shown>> {
    let mut sums: BTreeMap<u32, BTreeMap<i32, (Vector2<f64>, f64)>> = BTreeMap::new();
    for f in features {
        let corner = sums.entry(f.frame).or_default().entry(f.corner).or_default();
        corner.0 += Vector2::new(f.u_px, f.v_px);
        corner.1 += 1.0;
    }
    let shown =
        |(corner, (sum, count)): (i32, (Vector2<f64>, f64))| Shown { corner, at: sum / count };
    sums.into_values().map(|corners| corners.into_iter().map(shown).collect()).collect()
}

/// Returns column and row of the corner with a number.
fn place(corner: i32, board: &Board, numbering: CornerNumbering) -> Vector2<f64> {
    let by = |number: i32, length: i32| [number.rem_euclid(length), number.div_euclid(length)];
    let [column, row] = match numbering {
        CornerNumbering::RowByRow => by(corner, board.columns),
        CornerNumbering::ColumnByColumn => {
            let [row, column] = by(corner, board.rows);
            [column, row]
        }
        CornerNumbering::FromOne => by(corner - 1, board.columns),
        CornerNumbering::FromMinusOne => by(corner + 1, board.columns),
    };
    Vector2::new(f64::from(column), f64::from(row))
}

/// Computes the root mean square distance of corners from the best affine image of the board in each frame, relative to
/// their distance from the mean.
fn misfit(frames: &[Vec<Shown>], place: impl Fn(i32) -> Vector2<f64>) -> f64 {
    let (mut left, mut all) = (0.0, 0.0);
    for corners in frames {
        let count = corners.len().max(1) as f64;
        let on_board = corners.iter().map(|c| place(c.corner)).sum::<Vector2<f64>>() / count;
        let in_image = corners.iter().map(|c| c.at).sum::<Vector2<f64>>() / count;
        let (mut squares, mut products) = (Matrix2::zeros(), Matrix2::zeros());
        let mut spread = 0.0;
        for Shown { corner, at } in corners {
            let (from, to) = (place(*corner) - on_board, at - in_image);
            squares += from * from.transpose();
            products += to * from.transpose();
            spread += to.norm_squared();
        }
        let Some(inverse) = squares.try_inverse() else { continue };
        left += (spread - (products * inverse * products.transpose()).trace()).max(0.0);
        all += spread;
    }
    if all > 0.0 { (left / all).sqrt() } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{FramePose, Noise, small_camera};
    use crate::solver::synthesize;
    use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

    const BOARD: Board = Board { columns: 7, rows: 4, square_mm: 3.0 };

    fn features() -> Vec<BapFeature> {
        let pose = |frame: u32, axis: Vector3<f64>| FramePose {
            frame,
            camera_from_board: Isometry3::from_parts(
                Translation3::new(-9.0, -4.5, 110.0),
                UnitQuaternion::from_scaled_axis(axis),
            ),
        };
        let poses = [pose(0, Vector3::new(0.5, 0.1, 0.0)), pose(1, Vector3::new(0.1, -0.5, 2.0))];
        let noise = Noise { uv_px: 0.1, rho_px: 0.1, centers_px: 0.1 };
        synthesize(&small_camera(), &BOARD, &poses, &noise, 1).unwrap().features
    }

    /// Renumbers the corners and returns the error. Features of corners beyond the board are left out.
    fn numbered(number: impl Fn(i32) -> i32) -> String {
        let features: Vec<BapFeature> = features()
            .into_iter()
            .map(|f| BapFeature { corner: number(f.corner), ..f })
            .filter(|f| (0..BOARD.corners()).contains(&f.corner))
            .collect();
        check_numbering(&features, &BOARD).map_or_else(|e| e.to_string(), |()| String::new())
    }

    #[test]
    fn another_numbering_is_named() {
        assert_eq!(numbered(|corner| corner), "");
        let by_columns = numbered(|c| c % BOARD.columns * BOARD.rows + c / BOARD.columns);
        assert!(by_columns.contains("column by column"), "{by_columns}");
        assert!(by_columns.contains("row · columns + column"), "{by_columns}");
        assert!(numbered(|c| c + 1).contains("from 1"), "{}", numbered(|c| c + 1));
        assert!(numbered(|c| c - 1).contains("from -1"), "{}", numbered(|c| c - 1));
    }

    /// Other numberings do not fit better if corners are few, or if their numbers have no order.
    #[test]
    fn numbers_without_an_order_are_left_alone() {
        let few: Vec<BapFeature> = features().into_iter().filter(|f| f.corner < 4).collect();
        assert!(check_numbering(&few, &BOARD).is_ok());
        assert_eq!(numbered(|c| c * 11 % BOARD.corners()), "");
        assert!(check_numbering(&[], &BOARD).is_ok());
    }
}
