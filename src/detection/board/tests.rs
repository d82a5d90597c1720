//! Tests with boards in perspective: turned, symmetric, incomplete, of another size.

use std::collections::BTreeSet;

use super::*;
use crate::finding::Issue;
use crate::model::Sensor;

const BOARD: Board = Board { columns: 8, rows: 5, square_mm: 3.0 };
const SENSOR: Sensor = Sensor { width_px: 1000, height_px: 750, pixel_size_mm: 0.0055 };

/// Returns a board in perspective, turned by some degrees about the middle of the image.
fn seen(board: &Board, degrees: f64, shift: Vector2<f64>) -> Vec<LatticePoint> {
    let turn = nalgebra::Rotation2::new(degrees.to_radians());
    let middle = Vector2::new(f64::from(board.columns - 1), f64::from(board.rows - 1)) / 2.0;
    let point = |corner: i32| {
        let at = coordinates(board, corner);
        let image = |at: Vector2<f64>| {
            let p = turn * ((at - middle) * 90.0);
            Vector2::new(499.5, 374.5) + shift + p / (1.0 + 4e-4 * p.x - 3e-4 * p.y)
        };
        let diagonal = image(at + Vector2::new(0.5, 0.5)) - image(at);
        let across = Vector2::new(-diagonal.y, diagonal.x);
        // Even corners have dark squares along the diagonal.
        let sign = if (at.x + at.y) % 2.0 == 0.0 { 1.0 } else { -1.0 };
        let squares = across * across.transpose() - diagonal * diagonal.transpose();
        LatticePoint { place: image(at), squares: squares * sign }
    };
    (0..board.corners()).map(point).collect()
}

fn in_view(points: Vec<LatticePoint>) -> (Vec<LatticePoint>, Vec<i32>) {
    let inside = |(_, p): &(i32, LatticePoint)| SENSOR.contains(p.place.x, p.place.y);
    let (corners, points) = (0..).zip(points).filter(inside).unzip();
    (points, corners)
}

fn on_sensor(place: &Vector2<f64>) -> bool {
    let margin = Vector2::repeat(20.0);
    let (low, high) = (place - margin, place + margin);
    SENSOR.contains(low.x, low.y) && SENSOR.contains(high.x, high.y)
}

fn labelled(points: &[LatticePoint], board: &Board) -> Result<Vec<Option<i32>>, Issue> {
    LabelledBoard::label(points, board, &on_sensor).map(|board| board.corners)
}

#[test]
fn a_board_is_labelled_at_any_turn_by_its_colours() {
    for degrees in [0.0, 25.0, 90.0, 140.0, 180.0, 265.0] {
        let (points, corners) = in_view(seen(&BOARD, degrees, Vector2::zeros()));
        let expected: Vec<Option<i32>> = corners.into_iter().map(Some).collect();
        assert_eq!(labelled(&points, &BOARD).unwrap(), expected, "{degrees} degrees");
    }
}

#[test]
fn a_symmetric_board_runs_to_the_right() {
    let board = Board { columns: 9, rows: 5, square_mm: 3.0 };
    let points = seen(&board, 170.0, Vector2::zeros());
    let turned: Vec<Option<i32>> = (0..board.corners()).rev().map(Some).collect();
    let corners = labelled(&points, &board).unwrap();
    assert_eq!(corners, turned);
}

/// Checks a board with two columns out of view, though not beyond the sensor.
#[test]
fn what_is_out_of_view_does_not_count_as_missing() {
    let seen = (0..).zip(seen(&BOARD, 0.0, Vector2::zeros()));
    let (corners, points): (Vec<i32>, Vec<LatticePoint>) =
        seen.filter(|(corner, _)| corner % 8 > 1).unzip();
    let between = |a: i32| points[corners.iter().position(|c| *c == a).unwrap()].place.x - 30.0;
    let border = between(2).min(between(34));
    let in_view = |place: &Vector2<f64>| on_sensor(place) && place.x > border;
    let expected: Vec<Option<i32>> = corners.iter().copied().map(Some).collect();
    assert_eq!(LabelledBoard::label(&points, &BOARD, &in_view).unwrap().corners, expected);
    let why = labelled(&points, &BOARD).unwrap_err();
    assert!(matches!(why, Issue::SeveralPlaces { .. }), "{why}");
}

/// Checks boards turned by about 90 degrees: no rows run to the right, so the first corner is on top.
#[test]
fn a_symmetric_board_on_its_side_is_at_one_place() {
    for (columns, rows, angles) in [
        (9, 5, vec![80, 85, 90, 95, 100, 265, 270]),
        (6, 4, vec![80, 90, 100, 272]),
        // This board is the same when turned by a quarter.
        (8, 8, vec![0, 44, 45, 46, 90, 135]),
    ] {
        let board = Board { columns, rows, square_mm: 3.0 };
        for degrees in angles {
            // The board is far enough away to be seen whole.
            let points: Vec<LatticePoint> = seen(&board, f64::from(degrees), Vector2::zeros())
                .into_iter()
                .map(|p| LatticePoint { place: p.place * 0.7 + Vector2::new(150.0, 112.0), ..p })
                .collect();
            let corners = labelled(&points, &board)
                .unwrap_or_else(|why| panic!("{columns} x {rows}, {degrees} degrees: {why}"));
            let place = |corner: i32| {
                points[corners.iter().position(|c| *c == Some(corner)).unwrap()].place
            };
            let row = (place(columns - 1) - place(0)).normalize();
            let above = |corner: i32| place(0).y <= place(corner).y;
            let last = columns * rows - 1;
            assert!(row.x > 0.1 || above(last), "{columns} x {rows}, {degrees} degrees");
            // The rows of two placements run to the right alike here, and one of them has its first corner on top.
            let is_top = above(columns - 1) && above(last - columns + 1) && above(last);
            assert!(degrees != 45 || is_top, "{columns} x {rows}, {degrees} degrees");
        }
    }
    // If the board continues on both sides, the labels are in its middle.
    let board = Board { columns: 9, rows: 5, square_mm: 3.0 };
    let middle = |corner: &i32| (2..7).contains(&(corner % 9));
    let points: Vec<LatticePoint> = (0..)
        .zip(seen(&board, 90.0, Vector2::zeros()))
        .filter(|(corner, _)| middle(corner))
        .map(|(_, p)| LatticePoint {
            place: (p.place - Vector2::new(499.5, 374.5)) * 2.0 + Vector2::new(499.5, 374.5),
            ..p
        })
        .collect();
    let view = |place: &Vector2<f64>| points.iter().any(|p| (p.place - place).norm() < 20.0);
    let found = LabelledBoard::label(&points, &board, &view).unwrap();
    assert_eq!(found.elsewhere, Some(25));
    // Rows run to the right, so that columns count along v. The colours of the squares leave two equally good placements.
    let columns: BTreeSet<i32> = found.corners.iter().map(|c| c.unwrap() % 9).collect();
    let first = *columns.first().unwrap();
    assert!(
        columns.iter().copied().eq(first..first + 5) && (1..=3).contains(&first),
        "{columns:?}"
    );
    // If corners are missing in view, the board may be another one.
    let why = LabelledBoard::label(&points, &board, &|_| true).unwrap_err();
    assert!(matches!(why, Issue::SeveralPlaces { .. }), "{why}");
}

#[test]
fn missing_corners_and_clutter_do_not_matter() {
    let mut points = seen(&BOARD, 10.0, Vector2::zeros());
    let mut expected: Vec<Option<i32>> = (0..BOARD.corners()).map(Some).collect();
    for lost in [30, 21, 12, 3] {
        points.remove(lost);
        expected.remove(lost);
    }
    for (u, v) in [(20.0, 30.0), (950.0, 60.0), (480.0, 700.0), (500.0, 410.0)] {
        let place = Vector2::new(u, v);
        points.push(LatticePoint { place, squares: Matrix2::zeros() });
        expected.push(None);
    }
    assert_eq!(labelled(&points, &BOARD).unwrap(), expected);
}

/// Checks boards with so many lost corners that lattices of steps across corners leave out hardly more than the true one. Some
/// boards are not found, but none gets wrong labels.
#[test]
fn a_sixth_of_the_corners_may_be_lost_anywhere() {
    const SEEDS: u32 = 200;
    let all: Vec<(i32, LatticePoint)> =
        (0..).zip(seen(&BOARD, -9.0, Vector2::new(120.0, 10.0))).collect();
    let mut labelled_boards = 0;
    for seed in 0..SEEDS {
        let is_lost = |corner: i32| {
            let mut mixed = (corner.unsigned_abs() + 41 * seed).wrapping_mul(2_654_435_761);
            mixed = (mixed ^ (mixed >> 15)).wrapping_mul(2_246_822_519);
            (mixed >> 13).is_multiple_of(6)
        };
        let kept = all.iter().filter(|(corner, p)| !is_lost(*corner) && on_sensor(&p.place));
        let (corners, points): (Vec<i32>, Vec<LatticePoint>) = kept.copied().unzip();
        let expected: Vec<Option<i32>> = corners.into_iter().map(Some).collect();
        if let Ok(found) = labelled(&points, &BOARD) {
            assert_eq!(found, expected, "seed {seed}");
            labelled_boards += 1;
        }
    }
    assert!(labelled_boards > 190, "{labelled_boards} of {SEEDS}");
}

/// Checks a part of the board that would fit in two ways if the corners behind a missing column did not count.
#[test]
fn corners_behind_a_missing_column_tell_which_part_of_the_board_is_in_view() {
    // If the board were turned by 90 degrees, its last rows would be in view but for the border below.
    let shift = Vector2::new(0.0, 500.0 - 374.5);
    let all = seen(&BOARD, 0.0, shift);
    let points: Vec<(i32, LatticePoint)> =
        (0..).zip(all).filter(|(corner, _)| corner % 8 != 5 && corner % 8 != 7).collect();
    let (corners, points): (Vec<i32>, Vec<LatticePoint>) = points.into_iter().unzip();
    let below = |place: &Vector2<f64>| place.y < 700.0 && place.x < 900.0;
    let found = LabelledBoard::label(&points, &BOARD, &below).unwrap().corners;
    assert_eq!(found, corners.into_iter().map(Some).collect::<Vec<_>>());
}

#[test]
fn what_is_no_board_is_rejected_with_the_reason() {
    let points = seen(&BOARD, 0.0, Vector2::zeros());
    let smaller = Board { columns: 7, rows: 4, square_mm: 3.0 };
    // Both issues ask for another size of the board.
    let why = labelled(&points, &smaller).unwrap_err();
    let is_size = matches!(why, Issue::BeyondBoard { .. } | Issue::SeveralPlaces { .. });
    assert!(is_size, "{why}");
    let too_few = Issue::TooFewCorners { corners: 3 };
    assert_eq!(labelled(&points[..3], &BOARD), Err(too_few));
    let large = labelled(&points, &Board { columns: 90, rows: 90, square_mm: 1.0 }).unwrap_err();
    assert!(large.to_string().contains("6 to 2500"), "{large}");
    // A circle holds no lattice.
    let circle: Vec<LatticePoint> = (0..20)
        .map(|i| {
            let (sin, cos) = (f64::from(i) * 0.314).sin_cos();
            let place = Vector2::new(500.0 + 300.0 * cos, 370.0 + 300.0 * sin);
            LatticePoint { place, squares: Matrix2::zeros() }
        })
        .collect();
    assert!(labelled(&circle, &BOARD).is_err());
}

/// Checks points through which skewed lattices have as many points as the true one, in many ways; a quarter are missing.
#[test]
fn the_true_lattice_is_among_those_tried() {
    let found = [
        (7, 699.7, 57.2),
        (5, 489.6, 58.0),
        (4, 389.1, 58.4),
        (3, 292.8, 59.3),
        (2, 199.8, 60.1),
        (1, 110.2, 61.3),
        (8, 38.1, 164.6),
        (9, 124.2, 165.4),
        (10, 213.6, 166.2),
        (11, 306.2, 166.9),
        (12, 402.1, 168.1),
        (13, 501.8, 169.3),
        (14, 604.6, 170.8),
        (17, 138.3, 267.9),
        (18, 226.9, 270.5),
        (19, 319.0, 273.2),
        (21, 514.0, 278.7),
        (22, 616.0, 281.8),
        (23, 721.4, 285.5),
        (24, 67.0, 364.8),
        (26, 240.8, 373.3),
        (27, 332.4, 378.0),
        (29, 525.6, 386.9),
        (30, 627.1, 391.5),
        (31, 731.6, 396.6),
        (33, 166.7, 468.5),
        (34, 254.5, 474.5),
        (35, 345.5, 480.6),
        (36, 439.7, 486.5),
        (37, 537.4, 493.0),
        (39, 741.1, 505.4),
    ];
    let diagonals = Matrix2::new(0.0, -1.0, -1.0, 0.0);
    let point = |&(corner, u, v): &(i32, f64, f64)| LatticePoint {
        place: Vector2::new(u, v),
        squares: diagonals * if (corner / 8 + corner % 8) % 2 == 0 { 1.0 } else { -1.0 },
    };
    let points: Vec<LatticePoint> = found.iter().map(point).collect();
    let expected: Vec<Option<i32>> = found.iter().map(|&(corner, _, _)| Some(corner)).collect();
    assert_eq!(labelled(&points, &BOARD).unwrap(), expected);
}
