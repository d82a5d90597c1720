//! Figures of a pre-calibration as SVG.

use std::fmt::Write as _;
use std::io::Cursor;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use image::{GrayImage, ImageFormat, Luma};
use plotters::prelude::*;

use super::drawing::{Area, FITTED, INK, TYPE_COLORS, drawing, font, quantile};
use crate::error::{Error, Result};
use crate::image::RawImage;
use crate::precalibration::{ArrayMeasurement, Precalibration};

/// Radii of micro-images as in the paper's figure: over 1/N with the fitted lines, and a histogram
/// for each type at the middle f-number.
pub fn radii_figure(result: &Precalibration) -> Result<String> {
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, (900, 640)).into_drawing_area();
        root.fill(&WHITE).map_err(drawing)?;
        let (upper, lower) = root.split_vertically(380);
        lines(&upper, result)?;
        let types = result.lens_types.types;
        for (lens_type, area) in lower.split_evenly((1, types)).iter().enumerate() {
            histogram(area, result, lens_type)?;
        }
        root.present().map_err(drawing)?;
    }
    Ok(svg)
}

fn lines(area: &Area, result: &Precalibration) -> Result<()> {
    let radii = &result.radii;
    let largest_inverse = radii.iter().map(|r| 1.0 / r.f_number).fold(0.0, f64::max) * 1.05;
    let largest_radius = radii.iter().map(|r| r.radius_px).fold(0.0, f64::max) * 1.08;
    let mut chart = ChartBuilder::on(area)
        .caption("Radii of micro-images", font(18))
        .margin(8)
        .x_label_area_size(40)
        .y_label_area_size(52)
        .build_cartesian_2d(0.0..largest_inverse, 0.0..largest_radius)
        .map_err(drawing)?;
    chart
        .configure_mesh()
        .light_line_style(WHITE)
        .axis_style(INK)
        .x_desc("1/N")
        .y_desc("radius, px")
        .label_style(font(13))
        .draw()
        .map_err(drawing)?;
    for (lens_type, color) in TYPE_COLORS.into_iter().enumerate().take(result.lens_types.types) {
        let of_type = || radii.iter().filter(move |r| r.lens_type == lens_type);
        // Two points of the fitted line: each is the measured value minus its residual.
        let mut fitted: Vec<(f64, f64)> =
            of_type().map(|r| (1.0 / r.f_number, r.radius_px - r.residual_px)).collect();
        fitted.sort_by(|a, b| a.0.total_cmp(&b.0));
        if let (Some(&first), Some(&last)) = (fitted.first(), fitted.last()) {
            let at = |x: f64| first.1 + (last.1 - first.1) * (x - first.0) / (last.0 - first.0);
            let line = [0.0, largest_inverse].map(|x| (x, at(x)));
            chart.draw_series(LineSeries::new(line, FITTED)).map_err(drawing)?;
        }
        let points = of_type().map(|r| (1.0 / r.f_number, r.radius_px));
        chart
            .draw_series(points.map(|p| Circle::new(p, 4, color.filled())))
            .map_err(drawing)?
            .label(format!("type {}", lens_type + 1))
            .legend(move |(x, y)| Circle::new((x + 8, y), 4, color.filled()));
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::LowerRight)
        .border_style(INK)
        .label_font(font(13))
        .draw()
        .map_err(drawing)
}

/// Bins of a histogram.
const BINS: u32 = 20;

fn histogram(area: &Area, result: &Precalibration, lens_type: usize) -> Result<()> {
    let of_type: Vec<_> = result.radii.iter().filter(|r| r.lens_type == lens_type).collect();
    let Some(shown) = of_type.get(of_type.len() / 2) else { return Ok(()) };
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
    let highest = counts.iter().max().copied().unwrap_or(1).max(1);
    let title = format!("type {} at f/{:.2}", lens_type + 1, shown.f_number);
    let mut chart = ChartBuilder::on(area)
        .caption(title, font(15))
        .margin(8)
        .x_label_area_size(38)
        .y_label_area_size(40)
        .build_cartesian_2d(low..low + width, 0..highest + highest / 8 + 1)
        .map_err(drawing)?;
    chart
        .configure_mesh()
        .disable_mesh()
        .axis_style(INK)
        .x_labels(4)
        .x_desc("radius, px")
        .y_desc("micro-images")
        .label_style(font(12))
        .draw()
        .map_err(drawing)?;
    let bars = (0..BINS).zip(counts).map(|(i, count)| {
        let left = low + f64::from(i) * bin_width;
        Rectangle::new(
            [(left, 0), (left + bin_width * 0.92, count)],
            TYPE_COLORS[lens_type].filled(),
        )
    });
    chart.draw_series(bars).map_err(drawing)?;
    Ok(())
}

/// Size of the crop, px, and its enlargement.
const CROP: (usize, usize) = (200, 150);
const ENLARGED: usize = 4;

/// The middle of a white image with a circle about every micro-image, coloured by type; `radii_px` by
/// type.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a small picture of 8 bits
pub fn micro_images_figure(
    image: &RawImage,
    array: &ArrayMeasurement,
    radii_px: &[f64],
) -> Result<String> {
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
    let (shown_width, shown_height) = (width * ENLARGED, height * ENLARGED);
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{shown_width}\" \
         height=\"{shown_height}\" viewBox=\"0 0 {width} {height}\" role=\"img\">\n\
         <title>White image with micro-images found</title>\n\
         <image width=\"{width}\" height=\"{height}\" style=\"image-rendering:pixelated\" \
         href=\"data:image/png;base64,{}\"/>\n",
        STANDARD.encode(png.get_ref())
    );
    for c in &array.centers {
        // The centre of a pixel is half a pixel from its edge.
        let (x, y) = (c.u_px - left as f64 + 0.5, c.v_px - top as f64 + 0.5);
        let lens_type = array.grid.lattice.lens_type(c.k, c.l, radii_px.len());
        let radius = radii_px.get(lens_type).copied().unwrap_or(0.0);
        let inside =
            x > -radius && y > -radius && x < width as f64 + radius && y < height as f64 + radius;
        if inside {
            let RGBColor(r, g, b) = TYPE_COLORS[lens_type];
            let _ = writeln!(
                svg,
                "<circle cx=\"{x:.2}\" cy=\"{y:.2}\" r=\"{radius:.2}\" fill=\"none\" \
                 stroke=\"rgb({r},{g},{b})\" stroke-width=\"0.5\"/>"
            );
        }
    }
    svg.push_str("</svg>\n");
    Ok(svg)
}
