//! Distortion of the main lens over the sensor.

use nalgebra::Vector2;

use super::super::drawing::{Anchor, BLUE, Drawing, INK, Plane, axis_number, round_below};
use super::super::tree::Figure;
use super::vectors::{Arrow, draw_arrows, enlarged, enlargement, key, sensor_picture};
use crate::error::Result;
use crate::model::PlenopticCamera;
use crate::solver::distortion_mm;

/// Number of samples along the longer side: for the colours, and for the arrows.
const CELLS: f64 = 120.0;
const ARROWS: f64 = 18.0;
/// Least number of colour bands. There may be up to 2.5 times as many.
const BANDS: f64 = 5.0;
/// Opacity of the largest distortion. Arrows must be visible on it on any page.
const MOST_OPAQUE: f64 = 0.6;
const SCALE_WIDTH: f64 = 74.0;

pub(super) fn distortion(camera: &PlenopticCamera) -> Result<Option<Figure>> {
    let lens = &camera.main_lens;
    if lens.radial.iter().chain(&lens.tangential).all(|&c| c == 0.0) {
        return Ok(None);
    }
    let sensor = &camera.sensor;
    let image_px = Vector2::new(f64::from(sensor.width_px), f64::from(sensor.height_px));
    let at_arrows = places(image_px, ARROWS).concat();
    let arrows: Vec<Arrow> = shifts_px(camera, at_arrows)?
        .map(|(at, along)| Arrow { at, along, lens_type: 0 })
        .collect();
    let sizes: Vec<Vec<(Vector2<f64>, f64)>> = places(image_px, CELLS)
        .into_iter()
        .map(|row| Ok(shifts_px(camera, row)?.map(|(at, shift)| (at, shift.norm())).collect()))
        .collect::<Result<_>>()?;
    let largest = sizes.iter().flatten().map(|(_, size)| *size).fold(0.0, f64::max);
    if !(largest.is_finite() && largest > 0.0) {
        return Ok(None);
    }
    let bands = Bands::up_to(largest);
    let factor = enlargement(&arrows, 1.5 * image_px.max() / ARROWS);
    let title = "Distortion of the main lens";
    let (mut drawing, plane) = sensor_picture(image_px, SCALE_WIDTH, title);
    bands.draw(&sizes, image_px, &plane, &mut drawing);
    draw_arrows(&arrows, INK, factor, &plane, &mut drawing);
    key(&plane, image_px, factor, &mut drawing);
    bands.draw_scale(&plane, image_px, &mut drawing);
    let caption = format!(
        "Displacement of image points by the distortion of the main lens over the sensor, in px \
         (colours); the arrows are {}. The distortion is known only where there are features.",
        enlarged(factor)
    );
    Ok(Some(drawing.figure("distortion", caption)))
}

/// Returns positions in the image, and their shifts due to distortion, px.
fn shifts_px(
    camera: &PlenopticCamera,
    places: Vec<Vector2<f64>>,
) -> Result<impl Iterator<Item = (Vector2<f64>, Vector2<f64>)>> {
    // The image is stored upright: pixels run against the optical image.
    let pixel_size = camera.sensor.pixel_size_mm;
    let image_points: Vec<Vector2<f64>> =
        places.iter().map(|at| (camera.axis_px() - at) * pixel_size).collect();
    let shifts = distortion_mm(camera, &image_points)?;
    Ok(places.into_iter().zip(shifts).map(move |(at, shift)| (at, -shift / pixel_size)))
}

/// Returns the centres of square cells, row by row; `along` is their number along the longer side.
fn places(image_px: Vector2<f64>, along: f64) -> Vec<Vec<Vector2<f64>>> {
    let cell = image_px.max() / along;
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a small number
    let [columns, rows] =
        [image_px.x, image_px.y].map(|edge| (edge / cell).round().max(1.0) as u32);
    let step = image_px.component_div(&Vector2::new(f64::from(columns), f64::from(rows)));
    let middle = |column: u32, row: u32| {
        let index = Vector2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
        index.component_mul(&step) - Vector2::repeat(0.5)
    };
    (0..rows).map(|row| (0..columns).map(|column| middle(column, row)).collect()).collect()
}

/// Ranges of distortion, each with its own colour.
struct Bands {
    step: f64,
    count: usize,
}

impl Bands {
    fn up_to(largest: f64) -> Self {
        let step = round_below(largest / BANDS);
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // 5 to 13
        Self { step, count: (largest / step).ceil() as usize }
    }

    fn of(&self, size: f64) -> usize {
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // no size is negative
        let band = (size / self.step) as usize;
        band.min(self.count - 1)
    }

    fn opacity(&self, band: usize) -> f64 {
        MOST_OPAQUE * band as f64 / (self.count - 1).max(1) as f64
    }

    fn draw(
        &self,
        sizes: &[Vec<(Vector2<f64>, f64)>],
        image_px: Vector2<f64>,
        plane: &Plane,
        drawing: &mut Drawing,
    ) {
        let cell = image_px.y / sizes.len() as f64;
        let mut runs: Vec<Vec<(Vector2<f64>, Vector2<f64>)>> = vec![Vec::new(); self.count];
        for row in sizes {
            let across = image_px.x / row.len() as f64;
            for run in row.chunk_by(|a, b| self.of(a.1) == self.of(b.1)) {
                let first = run[0].0 - Vector2::new(across, cell) / 2.0;
                let size = Vector2::new(across * run.len() as f64, cell);
                let corner = plane.place(first.x, first.y);
                runs[self.of(run[0].1)].push((corner, size.component_mul(&plane.scale)));
            }
        }
        for (band, runs) in runs.iter().enumerate().skip(1) {
            drawing.rectangles(runs, BLUE, self.opacity(band));
        }
    }

    /// Draws the colour scale.
    fn draw_scale(&self, plane: &Plane, image_px: Vector2<f64>, drawing: &mut Drawing) {
        let size = Vector2::new(16.0, 22.0);
        let top = plane.place(image_px.x - 0.5, -0.5) + Vector2::new(18.0, 10.0);
        let edge = |step: usize| top + Vector2::new(0.0, size.y * (self.count - step) as f64);
        for band in 0..self.count {
            drawing.rectangle(edge(band + 1), size, BLUE, self.opacity(band));
        }
        let (low, high) = (edge(0), edge(self.count));
        let across = Vector2::new(size.x, 0.0);
        drawing.line(&[low, low + across, high + across, high, low], INK, 0.5);
        for step in 0..=self.count {
            let words = format!("{} px", axis_number(step as f64 * self.step));
            drawing.text(edge(step) + Vector2::new(22.0, 0.0), Anchor::Start, 13.0, &words);
        }
    }
}
