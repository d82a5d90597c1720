//! Distortion of the main lens over the sensor.

use nalgebra::Vector2;

use super::figure;
use super::vectors::{Arrow, draw_arrows, enlarged, enlargement, key, sensor_picture};
use crate::camera::PlenopticCamera;
use crate::error::Result;
use crate::report::drawing::{Anchor, BLUE, INK, Overlay, Plane, axis_number};
use crate::report::html::Figure;

/// Cells along the longer side: those of the colour, and every third of them has an arrow.
const CELLS: f64 = 54.0;
const ARROW_EVERY: usize = 3;
/// The colour of the largest distortion lets arrows be seen on any page.
const MOST_OPAQUE: f64 = 0.55;
const SCALE_WIDTH: u32 = 74;

pub(super) fn distortion(camera: &PlenopticCamera) -> Result<Option<Figure>> {
    let lens = &camera.main_lens;
    if lens.radial.iter().chain(&lens.tangential).all(|&c| c == 0.0) {
        return Ok(None);
    }
    let sensor = &camera.sensor;
    let image_px = Vector2::new(f64::from(sensor.width_px), f64::from(sensor.height_px));
    let cell = image_px.max() / CELLS;
    // The image is stored upright: pixels run against the optical image.
    let shift_px = |at: Vector2<f64>| {
        let image_point = (camera.mla.principal_point_px - at) * sensor.pixel_size_mm;
        -lens.distortion_mm(image_point) / sensor.pixel_size_mm
    };
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a small number
    let [columns, rows] = [image_px.x, image_px.y].map(|edge| (edge / cell).ceil() as usize);
    let places = (0..rows).flat_map(|row| (0..columns).map(move |column| (column, row)));
    let cells: Vec<((usize, usize), Arrow)> = places
        .map(|(column, row)| {
            let at = (Vector2::new(column as f64, row as f64) + Vector2::repeat(0.5)) * cell
                - Vector2::repeat(0.5);
            ((column, row), Arrow { at, along: shift_px(at), lens_type: 0 })
        })
        .filter(|(_, arrow)| arrow.along.iter().all(|v| v.is_finite()))
        .collect();
    let largest = cells.iter().map(|(_, a)| a.along.norm()).fold(f64::MIN_POSITIVE, f64::max);
    let middle = ARROW_EVERY / 2;
    let arrows: Vec<Arrow> = cells
        .iter()
        .filter(|((c, r), _)| c % ARROW_EVERY == middle && r % ARROW_EVERY == middle)
        .map(|(_, arrow)| Arrow { ..*arrow })
        .collect();
    let factor = enlargement(&arrows, 1.5 * ARROW_EVERY as f64 * cell);
    let title = "Distortion of the main lens";
    let svg = sensor_picture(image_px, SCALE_WIDTH, title, |plane, overlay| {
        for (_, arrow) in &cells {
            let half = Vector2::repeat(cell / 2.0);
            let end = (arrow.at + half).inf(&(image_px - Vector2::repeat(0.5)));
            let corner = plane.place(arrow.at.x - half.x, arrow.at.y - half.y);
            // A little larger, so that no gap shows.
            let size = plane.place(end.x, end.y) - corner + Vector2::repeat(0.3);
            let opacity = MOST_OPAQUE * arrow.along.norm() / largest;
            overlay.rectangle(corner, size, BLUE, opacity);
        }
        draw_arrows(&arrows, INK, factor, plane, overlay);
        key(plane, image_px, factor, overlay);
        scale(plane, image_px, largest, overlay);
    })?;
    let caption = format!(
        "By how much the main lens moves an image point at each place, in px of the sensor (up to {}); \
         the arrows are {}. It counts as known only as far out as the features reach.",
        digits(largest),
        enlarged(factor)
    );
    Ok(Some(figure("distortion", caption, svg)))
}

/// The colours and what they mean.
fn scale(plane: &Plane, image_px: Vector2<f64>, largest: f64, overlay: &mut Overlay) {
    const STEPS: u32 = 30;
    let top = plane.place(image_px.x - 0.5, -0.5) + Vector2::new(18.0, 10.0);
    let step = 6.0;
    for i in 0..STEPS {
        let part = 1.0 - (f64::from(i) + 0.5) / f64::from(STEPS);
        let corner = top + Vector2::new(0.0, step * f64::from(i));
        overlay.rectangle(corner, Vector2::new(16.0, step), BLUE, MOST_OPAQUE * part);
    }
    for part in [0.0, 0.5, 1.0] {
        let at = top + Vector2::new(22.0, step * f64::from(STEPS) * (1.0 - part));
        overlay.text(at, Anchor::Start, 13.0, &format!("{} px", digits(part * largest)));
    }
}

/// Three significant digits.
fn digits(value: f64) -> String {
    match value {
        v if v >= 100.0 => format!("{v:.0}"),
        v if v >= 10.0 => format!("{v:.1}"),
        v if v >= 0.01 => format!("{v:.2}"),
        v => axis_number(v),
    }
}
