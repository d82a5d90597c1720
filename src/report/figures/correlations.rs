//! Correlations of the intrinsic parameters.

use nalgebra::Vector2;

use super::super::drawing::{Anchor, BLUE, Color, Drawing, INK, ORANGE, WHITE};
use super::super::tree::Figure;
use crate::calibration::Calibration;
use crate::model::Parameter;

/// Correlation above which a cell is labelled with its value.
const STRONG: f64 = 0.9;
/// Edge of a cell, px, and margin at the upper left for names.
const CELL: f64 = 40.0;
const NAMES: f64 = 86.0;

pub(super) fn correlations(calibration: &Calibration) -> Option<Figure> {
    let uncertainty = &calibration.uncertainty;
    let parameters = Parameter::shared(calibration.camera.lens_types());
    let names: Vec<&str> =
        uncertainty.free_intrinsics.iter().map(|&i| parameters[i].name()).collect();
    if names.len() < 2 {
        return None;
    }
    let matrix = uncertainty.intrinsic_correlations();
    let edge = NAMES + CELL * names.len() as f64;
    let mut drawing = Drawing::new(edge + 110.0, (edge + 16.0).max(230.0));
    for (row, name) in names.iter().enumerate() {
        let middle = NAMES + (row as f64 + 0.5) * CELL;
        let known = uncertainty.determined.get(row).copied().unwrap_or(true);
        let name = if known { (*name).to_owned() } else { format!("{name} ?") };
        drawing.text(Vector2::new(NAMES - 8.0, middle), Anchor::End, 14.0, &name);
        drawing.upward_text(Vector2::new(middle, NAMES - 8.0), Anchor::Start, 14.0, &name);
        for column in 0..names.len() {
            let value = matrix[(row, column)];
            let value = if value.is_finite() { value.clamp(-1.0, 1.0) } else { 0.0 };
            cell(row, column, value, &mut drawing);
        }
    }
    grid(names.len(), &mut drawing);
    scale(edge + 28.0, &mut drawing);
    let mut caption = format!(
        "Correlations of the free intrinsic parameters; those beyond ±{STRONG} are labelled with their \
         value in per cent. A strong correlation means that the observations determine only a \
         combination of the two parameters well."
    );
    if uncertainty.determined[..names.len()].contains(&false) {
        caption.push_str(" A question mark marks parameters that are not determined.");
    }
    Some(drawing.figure("correlations", caption))
}

fn cell(row: usize, column: usize, value: f64, drawing: &mut Drawing) {
    let corner = Vector2::new(NAMES + CELL * column as f64, NAMES + CELL * row as f64);
    if row == column {
        // The correlation of a parameter with itself is always 1.
        drawing.rectangle(corner, Vector2::repeat(CELL), INK, 0.25);
        return;
    }
    drawing.rectangle(corner, Vector2::repeat(CELL), sign_color(value), value.abs());
    if value.abs() > STRONG {
        // Truncated rather than rounded: only a value of 1 shows as 100.
        let words = format!("{:+.1}", (1000.0 * value).trunc() / 10.0);
        let middle = corner + Vector2::repeat(CELL / 2.0);
        drawing.colored_text(middle, Anchor::Middle, 12.0, WHITE, &words);
    }
}

fn sign_color(value: f64) -> Color {
    if value < 0.0 { ORANGE } else { BLUE }
}

fn grid(count: usize, drawing: &mut Drawing) {
    let far = NAMES + CELL * count as f64;
    for i in 0..=count {
        let at = NAMES + CELL * i as f64;
        drawing.line(&[Vector2::new(NAMES, at), Vector2::new(far, at)], INK, 0.3);
        drawing.line(&[Vector2::new(at, NAMES), Vector2::new(at, far)], INK, 0.3);
    }
}

/// Draws the colour scale.
fn scale(left: f64, drawing: &mut Drawing) {
    const STEPS: u32 = 20;
    const STEP: f64 = 6.0;
    for i in 0..STEPS {
        let value = 1.0 - 2.0 * (f64::from(i) + 0.5) / f64::from(STEPS);
        let corner = Vector2::new(left, NAMES + STEP * f64::from(i));
        drawing.rectangle(corner, Vector2::new(18.0, STEP), sign_color(value), value.abs());
    }
    for (value, words) in [(1.0, "+1"), (0.0, "0"), (-1.0, "−1")] {
        let at = NAMES + STEP * f64::from(STEPS) * (1.0 - value) / 2.0;
        drawing.text(Vector2::new(left + 26.0, at), Anchor::Start, 13.0, words);
    }
}
