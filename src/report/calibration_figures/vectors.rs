//! Residuals as arrows over the sensor.

use std::collections::BTreeMap;

use nalgebra::Vector2;
use plotters::prelude::*;

use super::figure;
use crate::calibration::Calibration;
use crate::error::Result;
use crate::model::{FeatureResidual, Sensor};
use crate::precalibration::ArrayMeasurement;
use crate::report::drawing::{
    Anchor, Area, BLUE, INK, Overlay, Plane, TYPE_COLORS, axis_number, drawing, font, picture,
    quantile, round_below,
};
use crate::report::html::Figure;

/// More arrows than this would hide each other, so their means over cells are drawn.
const MOST_ARROWS: usize = 3000;
/// Cells along the longer side of the sensor.
const CELLS: f64 = 28.0;
/// The mean of a cell with less than this fraction of the usual number is mostly noise.
const FEWEST: f64 = 0.25;
/// Arrows smaller than rounding errors are not enlarged.
const MOST_ENLARGED: f64 = 1e6;
/// Largest width and height of the sensor in a picture, and the smallest, px.
const LARGEST: (f64, f64) = (820.0, 640.0);
const SMALLEST: f64 = 120.0;
/// The largest, where two are side by side, and how much wider their cells are.
const HALF: (f64, f64) = (430.0, 430.0);
const WIDER: f64 = 1.4;
/// Room around it: left, top, right, below.
const ROOM: [u32; 4] = [66, 40, 18, 50];
/// Greatest length of the arrow in the key, px.
const KEY: f64 = 90.0;

/// A vector and its position, px of the sensor.
pub(super) struct Arrow {
    pub at: Vector2<f64>,
    pub along: Vector2<f64>,
    pub lens_type: usize,
}

/// Draws over an image of `image_px` px, with equal scales along u and v. `scale_width` px are left
/// free on the right.
pub(super) fn sensor_picture(
    image_px: Vector2<f64>,
    scale_width: u32,
    title: &str,
    draw: impl FnOnce(&Plane, &mut Overlay),
) -> Result<String> {
    let (width, height) = shown(image_px, LARGEST);
    picture((width + scale_width, height), |root, overlay| {
        draw_sensor(root, image_px, scale_width, title, overlay, draw)
    })
}

/// Size of a picture of the sensor with the room around it, px.
fn shown(image_px: Vector2<f64>, largest: (f64, f64)) -> (u32, u32) {
    let [left, top, right, below] = ROOM;
    let scale = (largest.0 / image_px.x).min(largest.1 / image_px.y);
    let shown = (image_px * scale).map(|edge| edge.max(SMALLEST).round());
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // of a picture
    let (width, height) = (shown.x as u32, shown.y as u32);
    (left + width + right, top + height + below)
}

fn draw_sensor(
    area: &Area,
    image_px: Vector2<f64>,
    scale_width: u32,
    title: &str,
    overlay: &mut Overlay,
    draw: impl FnOnce(&Plane, &mut Overlay),
) -> Result<()> {
    let [left, top, right, below] = ROOM;
    let area = area.margin(top, 8, 8, right + scale_width);
    let mut chart = ChartBuilder::on(&area)
        .x_label_area_size(below - 8)
        .y_label_area_size(left - 8)
        // The outer edges of the pixels; v grows downwards.
        .build_cartesian_2d(-0.5..image_px.x - 0.5, image_px.y - 0.5..-0.5)
        .map_err(drawing)?;
    chart
        .configure_mesh()
        .disable_mesh()
        .axis_style(INK)
        .x_labels(8)
        .y_labels(8)
        .x_label_formatter(&|x| axis_number(*x))
        .y_label_formatter(&|y| axis_number(*y))
        .x_desc("u, px")
        .y_desc("v, px")
        .label_style(font(13))
        .draw()
        .map_err(drawing)?;
    let plane = Plane::of_chart(
        chart.plotting_area().get_pixel_range(),
        Vector2::new(-0.5, image_px.y - 0.5),
        Vector2::new(image_px.x - 0.5, -0.5),
    );
    let title_at = Vector2::new(plane.place(-0.5, 0.0).x, f64::from(top) / 2.0);
    overlay.text(title_at, Anchor::Start, 16.0, title);
    draw(&plane, overlay);
    Ok(())
}

/// Mean residuals of features over cells, of two cameras side by side and equally enlarged; and how.
pub(super) fn means_side_by_side(
    sensor: &Sensor,
    residuals: [&[FeatureResidual]; 2],
    titles: [&str; 2],
) -> Result<(String, String)> {
    let image_px = size_of(sensor);
    let cell = (WIDER * cell_of(image_px)).ceil();
    let [with, without] = residuals.map(|of| cell_means(&feature_arrows(of), cell).0);
    let both: Vec<Arrow> = with.iter().chain(&without).map(|a| Arrow { ..*a }).collect();
    let factor = enlargement(&both, 1.3 * cell);
    let (width, height) = shown(image_px, HALF);
    let svg = picture((2 * width, height), |root, overlay| {
        let (left, right) = root.split_horizontally(width);
        for ((area, means), title) in [(&left, &with), (&right, &without)].into_iter().zip(titles) {
            draw_sensor(area, image_px, 0, title, overlay, |plane, overlay| {
                draw_arrows(means, BLUE, factor, plane, overlay);
                key(plane, image_px, factor, overlay);
            })?;
        }
        Ok(())
    })?;
    Ok((svg, format!("means over cells of {cell} px, {}", enlarged(factor))))
}

/// The factor by which arrows are enlarged so that few are longer than `longest_px`.
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

/// The key: an arrow of known length at the upper right.
pub(super) fn key(plane: &Plane, image_px: Vector2<f64>, factor: f64, overlay: &mut Overlay) {
    let scale = plane.scale.x * factor;
    let length = round_below(KEY / scale);
    let right = plane.place(image_px.x - 0.5, -0.5);
    let from = Vector2::new(right.x - length * scale, f64::from(ROOM[1]) / 2.0);
    overlay.arrows(&[(from, Vector2::new(length * scale, 0.0))], INK, 1.4);
    let words = format!("{} px", axis_number(length));
    overlay.text(from - Vector2::new(8.0, 0.0), Anchor::End, 13.0, &words);
}

pub(super) fn draw_arrows(
    arrows: &[Arrow],
    color: RGBColor,
    factor: f64,
    plane: &Plane,
    overlay: &mut Overlay,
) {
    let drawn: Vec<_> = arrows
        .iter()
        .map(|a| (plane.place(a.at.x, a.at.y), a.along.component_mul(&plane.scale) * factor))
        .collect();
    overlay.arrows(&drawn, color, 1.0);
}

/// Means over square cells, and the fewest arrows that a cell needs.
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

/// The picture of mean arrows, with the cell and the enlargement for its caption.
fn means_picture(
    arrows: &[Arrow],
    image_px: Vector2<f64>,
    title: &str,
) -> Result<(String, String)> {
    let cell = cell_of(image_px);
    let (means, fewest) = cell_means(arrows, cell);
    let factor = enlargement(&means, 1.3 * cell);
    let svg = sensor_picture(image_px, 0, title, |plane, overlay| {
        draw_arrows(&means, BLUE, factor, plane, overlay);
        key(plane, image_px, factor, overlay);
    })?;
    let left_out = match fewest {
        1 => String::new(),
        fewest => format!(" (cells with fewer than {fewest} are left out as mostly noise)"),
    };
    Ok((svg, format!("means over cells of {cell} px{left_out}, {}", enlarged(factor))))
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

pub(super) fn residual_vectors(calibration: &Calibration) -> Result<Option<Figure>> {
    let arrows = feature_arrows(&calibration.reprojection.features);
    if arrows.is_empty() {
        return Ok(None);
    }
    let image_px = size_of(&calibration.camera.sensor);
    let title = "Residuals of features";
    let what = format!("Observed minus projected (u, v) of {} features", arrows.len());
    let (svg, how) = if arrows.len() > MOST_ARROWS {
        means_picture(&arrows, image_px, title)?
    } else {
        let spacing = (image_px.product() / arrows.len() as f64).sqrt();
        let longest = (2.0 * spacing).clamp(0.03 * image_px.max(), 0.08 * image_px.max());
        let factor = enlargement(&arrows, longest);
        let types = calibration.camera.lens_types();
        let svg = sensor_picture(image_px, 0, title, |plane, overlay| {
            single_arrows(&arrows, types, factor, plane, overlay);
            key(plane, image_px, factor, overlay);
        })?;
        let colored = if types > 1 { ", coloured by lens type" } else { "" };
        (svg, format!("{}{colored}", enlarged(factor)))
    };
    let caption = format!(
        "{what}: {how}. Good residuals point in random directions everywhere; a pattern over the \
         sensor means that the model lacks something."
    );
    Ok(Some(figure("residual-vectors", caption, svg)))
}

/// Shifts of pixels over the sensor.
pub(in crate::report) fn shifts_picture(
    shifts: &[(Vector2<f64>, Vector2<f64>)],
    sensor: &Sensor,
    title: &str,
) -> Result<String> {
    let arrows: Vec<Arrow> = shifts
        .iter()
        .map(|(at, along)| Arrow { at: *at, along: *along, lens_type: 0 })
        .filter(finite)
        .collect();
    let image_px = size_of(sensor);
    let spacing = (image_px.product() / arrows.len().max(1) as f64).sqrt();
    let factor = enlargement(&arrows, 2.0 * spacing);
    sensor_picture(image_px, 0, title, |plane, overlay| {
        draw_arrows(&arrows, BLUE, factor, plane, overlay);
        key(plane, image_px, factor, overlay);
    })
}

fn single_arrows(
    arrows: &[Arrow],
    types: usize,
    factor: f64,
    plane: &Plane,
    overlay: &mut Overlay,
) {
    if types < 2 {
        return draw_arrows(arrows, BLUE, factor, plane, overlay);
    }
    // To the right of the title, which is never wider than this.
    let mut at = Vector2::new(plane.origin_px.x + 190.0, f64::from(ROOM[1]) / 2.0);
    for (lens_type, color) in TYPE_COLORS.into_iter().enumerate().take(types) {
        let of_type: Vec<Arrow> =
            arrows.iter().filter(|a| a.lens_type == lens_type).map(|a| Arrow { ..*a }).collect();
        draw_arrows(&of_type, color, factor, plane, overlay);
        overlay.arrows(&[(at, Vector2::new(16.0, 0.0))], color, 1.4);
        let words = format!("type {}", lens_type + 1);
        overlay.text(at + Vector2::new(22.0, 0.0), Anchor::Start, 13.0, &words);
        at.x += 80.0;
    }
}

pub(super) fn center_residuals(calibration: &Calibration) -> Result<Option<Figure>> {
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
        return Ok(None);
    }
    let image_px = size_of(&calibration.camera.sensor);
    let (svg, how) = means_picture(&arrows, image_px, "Residuals of centres")?;
    let caption = format!(
        "Observed minus projected centres of {} micro-images: {how}. A pattern over the sensor suggests \
         an array that is not flat or not regular, or centres measured with a bias.",
        arrows.len()
    );
    Ok(Some(figure("center-residuals", caption, svg)))
}

/// Measured centres of a white image minus the grid fitted to them.
pub fn array_residuals_figure(array: &ArrayMeasurement) -> Result<Figure> {
    let arrows: Vec<Arrow> = array
        .centers
        .iter()
        .map(|c| {
            let at = Vector2::new(c.u_px, c.v_px);
            Arrow { at, along: at - array.grid.center_of(c.k, c.l), lens_type: 0 }
        })
        .filter(finite)
        .collect();
    // The image ends roughly where the micro-images do.
    let margin = Vector2::repeat(array.grid.pitch_px / 2.0);
    let image_px = arrows.iter().fold(2.0 * margin, |far, a| far.sup(&(a.at + margin)));
    let (svg, how) =
        means_picture(&arrows, image_px.map(f64::ceil), "Measured centres minus the fitted grid")?;
    let caption = format!(
        "Measured centres of {} micro-images minus the fitted grid: {how}. Arrows in random directions \
         are noise; a pattern over the image means that the array is not regular, or that vignetting \
         moves the centres.",
        arrows.len()
    );
    Ok(figure("array-residuals", caption, svg))
}
