//! A frame with its features.

use nalgebra::Vector2;

use super::super::drawing::{Color, Drawing, YELLOW};
use super::super::photograph::Photograph;
use crate::detection::Detection;
use crate::error::Result;
use crate::model::Board;

/// Draws a frame with its features as blur circles, coloured by corner, and the grid of the board.
pub fn features_figure(
    photograph: &Photograph,
    detection: &Detection,
    board: &Board,
) -> Result<String> {
    let size = Vector2::from(photograph.size).map(|edge| edge as f64);
    let reduced = photograph.reduced as f64;
    let view = [-0.5, -0.5, size.x * reduced, size.y * reduced];
    let mut drawing = Drawing::on_photograph(size, view, "jpeg", &photograph.jpeg()?);
    for line in board_lines(detection, board) {
        drawing.line(&line, YELLOW, reduced);
    }
    let first = detection.pinhole(0.0, 0.0);
    drawing.discs(&[Vector2::new(first.x, first.y)], 4.0 * reduced, YELLOW);
    for f in &detection.features {
        // Neighbours on the board differ in hue.
        let color = Color::of_hue(f64::from(f.corner * 137 % 360));
        let radius = f.rho_px.map_or(0.0, f64::abs).max(0.3);
        drawing.circle(Vector2::new(f.u_px, f.v_px), radius, color, 0.6);
    }
    Ok(drawing.finish("Features of a frame"))
}

/// Returns the lines of a board in its image, px: the rows of corners, then the columns.
pub(in super::super) fn board_lines(
    detection: &Detection,
    board: &Board,
) -> impl Iterator<Item = Vec<Vector2<f64>>> {
    let (columns, rows) = (board.columns, board.rows);
    let place = |column: i32, row: i32| {
        let at = detection.pinhole(f64::from(column), f64::from(row));
        Vector2::new(at.x, at.y)
    };
    let along = move |row: i32| (0..columns).map(|column| place(column, row)).collect();
    let down = move |column: i32| (0..rows).map(|row| place(column, row)).collect();
    (0..rows).map(along).chain((0..columns).map(down))
}
