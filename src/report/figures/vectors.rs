//! Residuals as arrows over the sensor.

use std::collections::BTreeMap;

use nalgebra::Vector2;

use super::super::drawing::{
    Anchor, Area, Axis, BLUE, Color, Drawing, INK, Plane, ROOM, TYPE_COLORS, axis_number, quantile,
    round_below,
};
use super::super::tree::Figure;
use crate::assessment::{CameraComparison, DistanceDifference};
use crate::calibration::Calibration;
use crate::model::{FeatureResidual, Sensor};
use crate::precalibration::ArrayMeasurement;

/// Largest number of arrows. More would hide each other, so their means over cells are drawn.
const MOST_ARROWS: usize = 3000;
/// Number of cells along the longer side of the sensor.
const CELLS: f64 = 28.0;
/// Fewest arrows of a cell, as a fraction of the usual number. The mean of fewer is mostly noise.
const FEWEST: f64 = 0.25;
/// Largest enlargement. Arrows smaller than rounding errors are not enlarged.
const MOST_ENLARGED: f64 = 1e6;
/// Largest width and height of the sensor in a picture, and their lower limit, px.
const LARGEST: (f64, f64) = (820.0, 640.0);
const SMALLEST: f64 = 120.0;
/// Largest width and height of two pictures side by side, px, and the ratio of their cells to the usual ones.
const HALF: (f64, f64) = (430.0, 430.0);
const WIDER: f64 = 1.4;
/// Largest length of the arrow in the key, px.
const KEY: f64 = 90.0;

/// A vector and its position, px of the sensor.
pub(super) struct Arrow {
    pub at: Vector2<f64>,
    pub along: Vector2<f64>,
    pub lens_type: usize,
}

/// Creates the page for a picture of an image of `image_px` px, with equal scales along u and v. `scale_width` px are left
/// free on the right.
pub(super) fn sensor_picture(
    image_px: Vector2<f64>,
    scale_width: f64,
    title: &str,
) -> (Drawing, Plane) {
    let size = with_room(image_px, LARGEST);
    let mut drawing = Drawing::new(size.x + scale_width, size.y);
    let plane = sensor_axes(&mut drawing, &Area::new(0.0, 0.0, size.x, size.y), image_px, title);
    (drawing, plane)
}

/// Returns the size of a picture of the sensor with its margins, px.
fn with_room(image_px: Vector2<f64>, largest: (f64, f64)) -> Vector2<f64> {
    let [left, top, right, below] = ROOM;
    let scale = (largest.0 / image_px.x).min(largest.1 / image_px.y);
    let shown = (image_px * scale).map(|edge| edge.max(SMALLEST).round());
    shown + Vector2::new(left + right, top + below)
}

fn sensor_axes(drawing: &mut Drawing, area: &Area, image_px: Vector2<f64>, title: &str) -> Plane {
    let chart = area.within_axes();
    drawing.title(&chart, title);
    // The axes end at the outer edges of the pixels; v grows downwards.
    let far = image_px - Vector2::repeat(0.5);
    let (u, v) = (Axis::new("u, px", [-0.5, far.x]), Axis::new("v, px", [far.y, -0.5]));
    drawing.axes(&chart, &u, &v)
}

/// Draws mean residuals of features over cells, for two cameras side by side and equally enlarged; returns cells and
/// enlargement for the caption.
pub(super) fn means_side_by_side(
    sensor: &Sensor,
    residuals: [&[FeatureResidual]; 2],
    titles: [&str; 2],
) -> (Drawing, String) {
    let image_px = size_of(sensor);
    let cell = (WIDER * cell_of(image_px)).ceil();
    let [with, without] = residuals.map(|of| cell_means(&feature_arrows(of), cell).0);
    let both: Vec<Arrow> = with.iter().chain(&without).map(|a| Arrow { ..*a }).collect();
    let factor = enlargement(&both, 1.3 * cell);
    let half = with_room(image_px, HALF);
    let mut drawing = Drawing::new(2.0 * half.x, half.y);
    let areas = Area::new(0.0, 0.0, 2.0 * half.x, half.y).split(1, 2);
    for ((area, means), title) in areas.zip([&with, &without]).zip(titles) {
        let plane = sensor_axes(&mut drawing, &area, image_px, title);
        draw_arrows(means, BLUE, factor, &plane, &mut drawing);
        key(&plane, image_px, factor, &mut drawing);
    }
    (drawing, format!("means over cells of {cell} px, {}", enlarged(factor)))
}

/// Returns the factor by which arrows are enlarged so that few are longer than `longest_px`.
pub(super) fn enlargement(arrows: &[Arrow], longest_px: f64) -> f64 {
    let mut lengths: Vec<f64> = arrows.iter().map(|a| a.along.norm()).collect();
    let long = quantile(&mut lengths, 0.95).unwrap_or(0.0);
    round_below((longest_px / long).clamp(1.0 / MOST_ENLARGED, MOST_ENLARGED))
}

/// Describes an enlargement.
pub(super) fn enlarged(factor: f64) -> String {
    if (factor - 1.0).abs() < 1e-9 {
        "drawn at their size in the image".to_owned()
    } else if factor > 1.0 {
        format!("enlarged {} times", axis_number(factor))
    } else {
        format!("drawn at {} of their size in the image", axis_number(factor))
    }
}

/// Draws the key: an arrow of known length at the upper right.
pub(super) fn key(plane: &Plane, image_px: Vector2<f64>, factor: f64, drawing: &mut Drawing) {
    let scale = plane.scale.x * factor;
    let length = round_below(KEY / scale);
    let right = plane.place(image_px.x - 0.5, -0.5);
    let from = Vector2::new(right.x - length * scale, ROOM[1] / 2.0);
    drawing.arrows(&[(from, Vector2::new(length * scale, 0.0))], INK, 1.4);
    let words = format!("{} px", axis_number(length));
    drawing.text(from - Vector2::new(8.0, 0.0), Anchor::End, 13.0, &words);
}

pub(super) fn draw_arrows(
    arrows: &[Arrow],
    color: Color,
    factor: f64,
    plane: &Plane,
    drawing: &mut Drawing,
) {
    let drawn: Vec<_> = arrows
        .iter()
        .map(|a| (plane.place(a.at.x, a.at.y), a.along.component_mul(&plane.scale) * factor))
        .collect();
    drawing.arrows(&drawn, color, 1.0);
}

/// Returns means over square cells, and the fewest arrows that a cell needs.
fn cell_means(arrows: &[Arrow], cell_px: f64) -> (Vec<Arrow>, usize) {
    let mut cells: BTreeMap<(i64, i64), Vec<&Arrow>> = BTreeMap::new();
    for arrow in arrows {
        #[allow(clippy::cast_possible_truncation)] // a small index
        let index = |position: f64| ((position + 0.5) / cell_px).floor() as i64;
        cells.entry((index(arrow.at.x), index(arrow.at.y))).or_default().push(arrow);
    }
    let mut counts: Vec<f64> = cells.values().map(|cell| cell.len() as f64).collect();
    let typical = quantile(&mut counts, 0.5).unwrap_or(1.0);
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a count
    let fewest = ((typical * FEWEST).floor() as usize).max(1);
    let mean_of = |cell: &Vec<&Arrow>| {
        let mean = |of: fn(&Arrow) -> Vector2<f64>| {
            cell.iter().map(|arrow| of(arrow)).sum::<Vector2<f64>>() / cell.len() as f64
        };
        Arrow { at: mean(|a| a.at), along: mean(|a| a.along), lens_type: 0 }
    };
    (cells.values().filter(|cell| cell.len() >= fewest).map(mean_of).collect(), fewest)
}

fn finite(arrow: &Arrow) -> bool {
    arrow.at.iter().chain(&arrow.along).all(|v| v.is_finite())
}

fn cell_of(image_px: Vector2<f64>) -> f64 {
    (image_px.max() / CELLS).ceil()
}

/// Draws mean arrows; returns cells and enlargement for the caption.
fn means_picture(arrows: &[Arrow], image_px: Vector2<f64>, title: &str) -> (Drawing, String) {
    let cell = cell_of(image_px);
    let (means, fewest) = cell_means(arrows, cell);
    let factor = enlargement(&means, 1.3 * cell);
    let (mut drawing, plane) = sensor_picture(image_px, 0.0, title);
    draw_arrows(&means, BLUE, factor, &plane, &mut drawing);
    key(&plane, image_px, factor, &mut drawing);
    let left_out = match fewest {
        1 => String::new(),
        fewest => format!(" (cells with fewer than {fewest} are left out as mostly noise)"),
    };
    (drawing, format!("means over cells of {cell} px{left_out}, {}", enlarged(factor)))
}

fn size_of(sensor: &Sensor) -> Vector2<f64> {
    Vector2::new(f64::from(sensor.width_px), f64::from(sensor.height_px))
}

fn feature_arrows(residuals: &[FeatureResidual]) -> Vec<Arrow> {
    let arrow = |f: &FeatureResidual| Arrow {
        at: Vector2::new(f.feature.u_px, f.feature.v_px),
        along: Vector2::new(f.du_px, f.dv_px),
        lens_type: f.lens_type,
    };
    residuals.iter().map(arrow).filter(finite).collect()
}

pub(super) fn residual_vectors(calibration: &Calibration) -> Option<Figure> {
    let arrows = feature_arrows(&calibration.reprojection.features);
    if arrows.is_empty() {
        return None;
    }
    let image_px = size_of(&calibration.camera.sensor);
    let title = "Residuals of features";
    let what = format!("Observed minus projected (u, v) of {} features", arrows.len());
    let (drawing, how) = if arrows.len() > MOST_ARROWS {
        means_picture(&arrows, image_px, title)
    } else {
        let spacing = (image_px.product() / arrows.len() as f64).sqrt();
        let longest = (2.0 * spacing).clamp(0.03 * image_px.max(), 0.08 * image_px.max());
        let factor = enlargement(&arrows, longest);
        let types = calibration.camera.lens_types();
        let (mut drawing, plane) = sensor_picture(image_px, 0.0, title);
        single_arrows(&arrows, types, factor, &plane, &mut drawing);
        key(&plane, image_px, factor, &mut drawing);
        let colored = if types > 1 { ", coloured by lens type" } else { "" };
        (drawing, format!("{}{colored}", enlarged(factor)))
    };
    let caption = format!(
        "{what}: {how}. Good residuals point in random directions everywhere; a pattern over the \
         sensor means that the model is incomplete."
    );
    Some(drawing.figure("residual-vectors", caption))
}

/// Draws shifts of pixels over the sensor.
fn shifts(shifts: &[(Vector2<f64>, Vector2<f64>)], sensor: &Sensor, title: &str) -> Drawing {
    let arrows: Vec<Arrow> = shifts
        .iter()
        .map(|(at, along)| Arrow { at: *at, along: *along, lens_type: 0 })
        .filter(finite)
        .collect();
    let image_px = size_of(sensor);
    let spacing = (image_px.product() / arrows.len().max(1) as f64).sqrt();
    let factor = enlargement(&arrows, 2.0 * spacing);
    let (mut drawing, plane) = sensor_picture(image_px, 0.0, title);
    draw_arrows(&arrows, BLUE, factor, &plane, &mut drawing);
    key(&plane, image_px, factor, &mut drawing);
    drawing
}

/// Draws the shifts between two cameras over the sensor, for each distance.
#[must_use]
pub fn comparison_figures(comparison: &CameraComparison, sensor: &Sensor) -> Vec<Figure> {
    let of = |d: &DistanceDifference| {
        // The name is exact to the micrometre, without zeros at its end, so that the names of distances differ.
        let at_mm = (1e3 * d.at_mm).round() / 1e3;
        let title = format!("Second camera minus first at {at_mm} mm");
        let caption =
            format!("{title}: shifts of pixels after the alignment of the camera frames.");
        shifts(&d.shifts_px, sensor, &title).figure(&format!("shifts-{at_mm}-mm"), caption)
    };
    comparison.distances.iter().map(of).collect()
}

fn single_arrows(
    arrows: &[Arrow],
    types: usize,
    factor: f64,
    plane: &Plane,
    drawing: &mut Drawing,
) {
    if types < 2 {
        return draw_arrows(arrows, BLUE, factor, plane, drawing);
    }
    for (lens_type, color) in TYPE_COLORS.into_iter().enumerate().take(types) {
        let of_type: Vec<Arrow> =
            arrows.iter().filter(|a| a.lens_type == lens_type).map(|a| Arrow { ..*a }).collect();
        draw_arrows(&of_type, color, factor, plane, drawing);
    }
    // To the right of the title, which is never wider than this.
    let at = Vector2::new(plane.origin_px.x + 190.0, ROOM[1] / 2.0);
    drawing.type_legend(at, types);
}

pub(super) fn center_residuals(calibration: &Calibration) -> Option<Figure> {
    let arrows: Vec<Arrow> = calibration
        .reprojection
        .centers
        .iter()
        .map(|c| Arrow {
            at: Vector2::new(c.center.u_px, c.center.v_px),
            along: Vector2::new(c.du_px, c.dv_px),
            lens_type: 0,
        })
        .filter(finite)
        .collect();
    if arrows.is_empty() {
        return None;
    }
    let image_px = size_of(&calibration.camera.sensor);
    let (drawing, how) = means_picture(&arrows, image_px, "Residuals of centres");
    let caption = format!(
        "Observed minus projected centres of {} micro-images: {how}. A pattern over the sensor suggests \
         an array that is not flat or not regular, or centres measured with a bias.",
        arrows.len()
    );
    Some(drawing.figure("center-residuals", caption))
}

/// Draws measured centres of a white image minus the fitted grid.
#[must_use]
pub fn array_residuals_figure(array: &ArrayMeasurement) -> Figure {
    let arrows: Vec<Arrow> = array
        .centers
        .iter()
        .map(|c| {
            let at = Vector2::new(c.u_px, c.v_px);
            Arrow { at, along: at - array.grid.center_of(c.k, c.l), lens_type: 0 }
        })
        .filter(finite)
        .collect();
    // The image ends roughly at the outermost micro-images.
    let margin = Vector2::repeat(array.grid.pitch_px / 2.0);
    let image_px = arrows.iter().fold(2.0 * margin, |far, a| far.sup(&(a.at + margin)));
    let (drawing, how) =
        means_picture(&arrows, image_px.map(f64::ceil), "Measured centres minus the fitted grid");
    let caption = format!(
        "Measured centres of {} micro-images minus the fitted grid: {how}. Arrows in random directions \
         are noise; a pattern over the image means that the array is not regular, or that vignetting \
         moves the centres.",
        arrows.len()
    );
    drawing.figure("array-residuals", caption)
}
