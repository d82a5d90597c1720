//! A frame with its features.

use image::codecs::jpeg::JpegEncoder;
use image::{GrayImage, Luma};
use nalgebra::Vector2;

use super::super::drawing::{Color, Drawing, YELLOW};
use crate::detection::Detection;
use crate::error::{Error, Result};
use crate::image::RawImage;
use crate::model::Board;

/// Largest width of the picture under the features, px.
const PICTURE: usize = 1400;
/// JPEG quality of the picture, up to 100.
const QUALITY: u8 = 60;

/// Draws a frame with its features as blur circles, coloured by corner, and the grid of the board.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // pixels
pub fn features_figure(image: &RawImage, detection: &Detection, board: &Board) -> Result<String> {
    let (width, height) = (image.width, image.height);
    let reduced = width.div_ceil(PICTURE).max(1);
    let grey = image.grey();
    let (columns, rows) = ((width / reduced).max(1), (height / reduced).max(1));
    let mut values = Vec::with_capacity(columns * rows);
    let mut sums = vec![0.0; width];
    for y in 0..rows {
        sums.fill(0.0);
        for row in grey.part(0, y * reduced, width, reduced).pixels.chunks_exact(width) {
            for (sum, pixel) in sums.iter_mut().zip(row) {
                *sum += pixel;
            }
        }
        let mean = |block: &[f32]| block.iter().sum::<f32>() / (reduced * reduced) as f32;
        values.extend(sums.chunks(reduced).take(columns).map(mean));
    }
    let brightest = values.iter().copied().fold(f32::MIN_POSITIVE, f32::max);
    let picture = GrayImage::from_fn(columns as u32, rows as u32, |x, y| {
        Luma([(values[y as usize * columns + x as usize] / brightest * 255.0) as u8])
    });
    let mut jpeg = Vec::new();
    JpegEncoder::new_with_quality(&mut jpeg, QUALITY)
        .encode_image(&picture)
        .map_err(|e| Error::invalid(format!("a figure could not be drawn: {e}")))?;
    let size = Vector2::new(columns as f64, rows as f64);
    let view = [-0.5, -0.5, (columns * reduced) as f64, (rows * reduced) as f64];
    let mut drawing = Drawing::on_photograph(size, view, "jpeg", &jpeg);
    let place = |column: i32, row: i32| {
        let at = detection.pinhole(f64::from(column), f64::from(row));
        Vector2::new(at.x, at.y)
    };
    let line_width = reduced as f64;
    for row in 0..board.rows {
        for column in 0..board.columns {
            for (right, down) in [(1, 0), (0, 1)] {
                if column + right < board.columns && row + down < board.rows {
                    let ends = [place(column, row), place(column + right, row + down)];
                    drawing.line(&ends, YELLOW, line_width);
                }
            }
        }
    }
    drawing.discs(&[place(0, 0)], 4.0 * line_width, YELLOW);
    for f in &detection.features {
        // Neighbours on the board differ in hue.
        let color = Color::of_hue(f64::from(f.corner * 137 % 360));
        let radius = f.rho_px.map_or(0.0, f64::abs).max(0.3);
        drawing.circle(Vector2::new(f.u_px, f.v_px), radius, color, 0.6);
    }
    Ok(drawing.finish("Features of a frame"))
}
