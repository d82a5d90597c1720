//! The σ of reconstructed points over field and distance.

use nalgebra::Vector2;

use super::super::drawing::{Anchor, BLUE, Drawing, INK, ORANGE};
use super::super::tree::Figure;
use crate::assessment::{Distance, ObjectSpace, PointTrust};
use crate::quantity::two_digits;

/// Size of a cell, px, and margins beside and above the cells of a panel.
const CELL: Vector2<f64> = Vector2::new(52.0, 30.0);
const LEFT: f64 = 74.0;
const TOP: f64 = 52.0;
const GAP: f64 = 44.0;
/// Largest σ, mm, below which the numbers are in µm.
const IN_MICROMETRES: f64 = 0.2;
/// Opacities of the lightest and the darkest cell.
const OPACITY: (f64, f64) = (0.06, 0.75);

/// Draws two maps: σ across the axis and along it, for points seen along the middle row of the image.
pub(super) fn object_space(space: &ObjectSpace) -> Option<Figure> {
    let rows: Vec<(&Distance, Vec<&PointTrust>)> =
        space.distances.iter().rev().map(|d| (d, middle_row(d))).collect();
    let mut columns: Vec<f64> =
        rows.iter().flat_map(|(_, points)| points.iter().map(|p| p.pixel_px[0])).collect();
    columns.sort_by(f64::total_cmp);
    columns.dedup_by(|a, b| (*a - *b).abs() < 0.5);
    if columns.is_empty() {
        return None;
    }
    let panel = LEFT + CELL.x * columns.len() as f64;
    let height = TOP + CELL.y * rows.len() as f64 + 52.0;
    let mut drawing = Drawing::new(2.0 * panel + GAP, height);
    for (i, title) in ["across the axis", "along the axis"].into_iter().enumerate() {
        let left = i as f64 * (panel + GAP) + LEFT;
        let unit = map(&rows, &columns, i, left, &mut drawing);
        drawing.text(Vector2::new(left, 18.0), Anchor::Start, 15.0, &format!("σ {title}, {unit}"));
    }
    let caption = "σ of a point reconstructed with this camera, relative to the boards of the \
                   calibration, against its position in the middle row of the image (u, px) and \
                   its distance (mm). The noise of an observation adds to it. Distances in orange lie \
                   outside the range of the boards: the camera is extrapolated there. Empty cells: \
                   fewer than two micro-lenses image the point."
        .to_owned();
    Some(drawing.figure("object-space", caption))
}

/// Returns the points nearest to the middle of the image along v.
fn middle_row(distance: &Distance) -> Vec<&PointTrust> {
    let mut rows: Vec<f64> = distance.points.iter().map(|p| p.pixel_px[1]).collect();
    rows.sort_by(f64::total_cmp);
    let middle = rows[rows.len() / 2];
    distance.points.iter().filter(|p| (p.pixel_px[1] - middle).abs() < 0.5).collect()
}

/// Draws the map of a direction and returns its unit.
fn map(
    rows: &[(&Distance, Vec<&PointTrust>)],
    columns: &[f64],
    direction: usize,
    left: f64,
    drawing: &mut Drawing,
) -> &'static str {
    let values =
        || rows.iter().flat_map(|(_, points)| points.iter().map(|p| p.std_dev_mm[direction]));
    let least = values().fold(f64::INFINITY, f64::min).max(f64::MIN_POSITIVE);
    let most = values().fold(0.0, f64::max).max(least * 1.01);
    let (unit, factor) = if most < IN_MICROMETRES { ("µm", 1e3) } else { ("mm", 1.0) };
    for (row, (distance, points)) in rows.iter().enumerate() {
        let top = TOP + CELL.y * row as f64;
        let color = if distance.within_boards { INK } else { ORANGE };
        let name = format!("{:.0}", distance.distance_mm);
        let beside = Vector2::new(left - 8.0, top + CELL.y / 2.0);
        drawing.colored_text(beside, Anchor::End, 13.0, color, &name);
        for point in points {
            let column = columns.iter().position(|u| (u - point.pixel_px[0]).abs() < 0.5);
            let corner = Vector2::new(left + CELL.x * column.unwrap_or(0) as f64, top);
            let value = point.std_dev_mm[direction];
            let part = (value / least).ln() / (most / least).ln();
            let opacity = OPACITY.0 + (OPACITY.1 - OPACITY.0) * part.clamp(0.0, 1.0);
            drawing.rectangle(corner, CELL, BLUE, opacity);
            drawing.text(corner + CELL / 2.0, Anchor::Middle, 12.0, &two_digits(value * factor));
        }
    }
    let below = TOP + CELL.y * rows.len() as f64 + 16.0;
    for (i, u) in columns.iter().enumerate() {
        let at = Vector2::new(left + CELL.x * (i as f64 + 0.5), below);
        drawing.text(at, Anchor::Middle, 12.0, &format!("{u:.0}"));
    }
    let middle = left + CELL.x * columns.len() as f64 / 2.0;
    drawing.text(Vector2::new(middle, below + 20.0), Anchor::Middle, 13.0, "u, px");
    drawing.text(Vector2::new(left - 8.0, TOP - 14.0), Anchor::End, 13.0, "z, mm");
    unit
}
