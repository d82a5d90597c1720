//! Figures of a pre-calibration.

use std::io::Cursor;

use image::{GrayImage, ImageFormat, Luma};
use nalgebra::Vector2;

use super::super::drawing::{Area, Axis, Drawing, FITTED, TYPE_COLORS, Ticks, quantile};
use super::super::tree::Figure;
use super::vectors::array_residuals_figure;
use crate::error::{Error, Result};
use crate::image::RawImage;
use crate::precalibration::{ArrayMeasurement, Precalibration, RadiusMeasurement};

/// Draws all figures of a pre-calibration; `image` is the white image at the middle f-number.
pub fn precalibration_figures(result: &Precalibration, image: &RawImage) -> Result<Vec<Figure>> {
    let radii_px = result.radii_px(result.images.len() / 2);
    Ok(vec![
        radii_figure(result),
        micro_images_figure(image, &result.array, &radii_px)?,
        array_residuals_figure(&result.array),
    ])
}

/// Draws radii of micro-images as in the paper's figure: over 1/N with the fitted lines, and a histogram
/// for each type at the middle f-number.
#[must_use]
pub fn radii_figure(result: &Precalibration) -> Figure {
    let types = result.lens_types.types;
    let mut drawing = Drawing::new(900.0, 640.0);
    lines(&Area::new(0.0, 0.0, 900.0, 380.0).within_axes(), result, &mut drawing);
    let below = Area::new(0.0, 380.0, 900.0, 260.0).split(1, types);
    for (lens_type, area) in below.enumerate() {
        histogram(&area.within_axes(), result, lens_type, &mut drawing);
    }
    let caption = "Radii of the micro-images against 1/N with the fitted lines, and below the \
                   scatter of the radii of single micro-images. The lines of all lens types \
                   have the same slope m."
        .to_owned();
    drawing.figure("radii", caption)
}

fn lines(chart: &Area, result: &Precalibration, drawing: &mut Drawing) {
    let radii = &result.radii;
    let largest_inverse = radii.iter().map(|r| 1.0 / r.f_number).fold(0.0, f64::max) * 1.05;
    let largest_radius = radii.iter().map(|r| r.radius_px).fold(0.0, f64::max) * 1.08;
    let x = Axis::new("1/N", [0.0, largest_inverse]).with_grid();
    let plane =
        drawing.axes(chart, &x, &Axis::new("radius, px", [0.0, largest_radius]).with_grid());
    drawing.title(chart, "Radii of micro-images");
    for (lens_type, color) in TYPE_COLORS.into_iter().enumerate().take(result.lens_types.types) {
        let of_type = || radii.iter().filter(move |r| r.lens_type == lens_type);
        // A point of the fitted line is the measured value minus its residual.
        let mut fitted: Vec<(f64, f64)> =
            of_type().map(|r| (1.0 / r.f_number, r.radius_px - r.residual_px)).collect();
        fitted.sort_by(|a, b| a.0.total_cmp(&b.0));
        if let (Some(&first), Some(&last)) = (fitted.first(), fitted.last()) {
            let at = |x: f64| first.1 + (last.1 - first.1) * (x - first.0) / (last.0 - first.0);
            drawing.line(&[0.0, largest_inverse].map(|x| plane.place(x, at(x))), FITTED, 1.2);
        }
        let points: Vec<_> =
            of_type().map(|r| plane.place(1.0 / r.f_number, r.radius_px)).collect();
        drawing.discs(&points, 4.0, color);
    }
    let at = chart.corner + Vector2::new(chart.size.x - 230.0, -20.0);
    drawing.type_legend(at, result.lens_types.types);
}

/// Number of bins of a histogram.
const BINS: u32 = 20;

fn histogram(chart: &Area, result: &Precalibration, lens_type: usize, drawing: &mut Drawing) {
    let of_type: Vec<&RadiusMeasurement> =
        result.radii.iter().filter(|r| r.lens_type == lens_type).collect();
    let Some(shown) = of_type.get(of_type.len() / 2) else { return };
    let mut sorted = shown.single_px.clone();
    // A few outliers must not hide the rest.
    let mut at = |part: f64| quantile(&mut sorted, part).unwrap_or_default();
    let (first, last) = (at(0.02), at(0.98));
    let width = ((last - first) * 1.2).max(0.05);
    let low = f64::midpoint(first, last) - width / 2.0;
    let bin_width = width / f64::from(BINS);
    let mut counts = [0_u32; BINS as usize];
    for radius in &sorted {
        let bin = (radius - low) / bin_width;
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // in the range
        if (0.0..f64::from(BINS)).contains(&bin) {
            counts[bin as usize] += 1;
        }
    }
    let highest = 1.12 * f64::from(counts.iter().max().copied().unwrap_or(1).max(1));
    let x = Axis::new("radius, px", [low, low + width]);
    let y = Axis::new("micro-images", [0.0, highest]).with_ticks(Ticks::Whole);
    let plane = drawing.axes(chart, &x, &y);
    drawing.title(chart, &format!("type {} at f/{:.2}", lens_type + 1, shown.f_number));
    let bars: Vec<_> = (0..BINS)
        .zip(counts)
        .filter(|(_, count)| *count > 0)
        .map(|(i, count)| {
            let corner = plane.place(low + f64::from(i) * bin_width, f64::from(count));
            let size = Vector2::new(bin_width * 0.92, f64::from(count));
            (corner, size.component_mul(&plane.scale).abs())
        })
        .collect();
    drawing.rectangles(&bars, TYPE_COLORS[lens_type], 1.0);
}

/// Size of the crop, px, and its enlargement.
const CROP: (usize, usize) = (200, 150);
const ENLARGED: usize = 4;

/// Draws the middle of a white image with a circle about every micro-image, coloured by type. `radii_px` has one radius per
/// type.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a small picture of 8 bits
pub fn micro_images_figure(
    image: &RawImage,
    array: &ArrayMeasurement,
    radii_px: &[f64],
) -> Result<Figure> {
    let (width, height) = (CROP.0.min(image.width), CROP.1.min(image.height));
    let (left, top) = ((image.width - width) / 2, (image.height - height) / 2);
    let part = image.grey().part(left, top, width, height);
    let brightest = part.pixels.iter().copied().fold(f32::MIN_POSITIVE, f32::max);
    let mut crop = GrayImage::new(width as u32, height as u32);
    for (x, y, pixel) in crop.enumerate_pixels_mut() {
        let value = part.at(x as usize, y as usize) / brightest * 255.0;
        *pixel = Luma([value as u8]);
    }
    let mut png = Cursor::new(Vec::new());
    crop.write_to(&mut png, ImageFormat::Png)
        .map_err(|e| Error::invalid(format!("a figure could not be drawn: {e}")))?;
    let size = Vector2::new((width * ENLARGED) as f64, (height * ENLARGED) as f64);
    // The centre of a pixel is half a pixel from its edge.
    let view = [left as f64 - 0.5, top as f64 - 0.5, width as f64, height as f64];
    let mut drawing = Drawing::on_photograph(size, view, "png", png.get_ref());
    for c in &array.centers {
        let lens_type = array.grid.lattice.lens_type(c.k, c.l, radii_px.len());
        let radius = radii_px.get(lens_type).copied().unwrap_or(0.0);
        let from_edge = Vector2::new(c.u_px - view[0], c.v_px - view[1]);
        let is_inside = from_edge
            .iter()
            .zip([width, height])
            .all(|(&at, edge)| (-radius..edge as f64 + radius).contains(&at));
        if is_inside {
            drawing.circle(Vector2::new(c.u_px, c.v_px), radius, TYPE_COLORS[lens_type], 0.5);
        }
    }
    let caption = "The middle of a white image with the micro-images found, coloured by lens type.";
    Ok(drawing.figure("micro-images", caption.to_owned()))
}
