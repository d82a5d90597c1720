//! Measured against predicted blur radii.

use nalgebra::Vector2;

use super::super::drawing::{Area, Axis, Drawing, FITTED, INK, TYPE_COLORS, quantile};
use super::super::tree::Figure;
use crate::calibration::Calibration;
use crate::numerics::weighted_mean;
use crate::quantity::Estimate;

/// Number of dots per lens type, each with the same number of features.
const DOTS: usize = 24;
/// Fewest features per dot.
const FEWEST: usize = 8;

/// The features of one lens type with about the same blur.
struct Dot {
    /// Predicted blur radius ρ, with openings as wide as the pitch, px.
    predicted_px: f64,
    /// Measured blur radius, with σ from the scatter of the features, px.
    measured_px: Estimate,
}

/// Draws measured blur radii over ρ, by lens type; `None` without measured blur.
pub(super) fn measured_blur(calibration: &Calibration) -> Option<Figure> {
    let blur = calibration.blur.as_ref()?;
    let of_types: Vec<Vec<Dot>> =
        (0..calibration.camera.lens_types()).map(|i| dots(calibration, i)).collect();
    let all = || of_types.iter().flatten();
    let spans = |of: &dyn Fn(&Dot) -> f64| {
        let (low, high) = all().map(of).fold((0.0_f64, 0.0_f64), |(a, b), x| (a.min(x), b.max(x)));
        (low - 0.06 * (high - low), high + 0.06 * (high - low))
    };
    if all().count() < 2 {
        return None;
    }
    let across = spans(&|dot| dot.predicted_px);
    let up = spans(&|dot| dot.measured_px.value);
    let slope = blur.aperture_ratio.value;
    let mut drawing = Drawing::new(900.0, 360.0);
    let panels = Area::new(0.0, 0.0, 900.0, 360.0).split(1, of_types.len());
    for ((lens_type, dots), area) in of_types.iter().enumerate().zip(panels) {
        panel(&area.within_axes(), lens_type, dots, slope, [across, up], &mut drawing);
    }
    let caption = format!(
        "Measured blur radii against ρ, the blur radius for an aperture ratio of 1, by lens type. \
         Dots are means of features with similar ρ, bars their σ. The line has the slope \
         {slope:.3}, the aperture ratio; the dashed line has the slope 1. If the dots of one type \
         lie off the line, q' of this type or the order of the types is wrong."
    );
    Some(drawing.figure("measured-blur", caption))
}

fn dots(calibration: &Calibration, lens_type: usize) -> Vec<Dot> {
    let mut all: Vec<(f64, Estimate)> = calibration
        .reprojection
        .features
        .iter()
        .filter(|residual| residual.lens_type == lens_type)
        .filter_map(|residual| {
            let (blur, rho) = (residual.feature.blur?, residual.feature.rho_px?);
            Some((rho, Estimate::new(blur.radius_px, blur.std_dev_px)))
        })
        .collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    let dot = |some: &[(f64, Estimate)]| {
        // Single features may measure something else.
        let mut off: Vec<f64> = some.iter().map(|(rho, blur)| blur.value - rho).collect();
        let middle = quantile(&mut off, 0.5)?;
        let mut far: Vec<f64> = off.iter().map(|x| (x - middle).abs()).collect();
        let limit = 5.0 * quantile(&mut far, 0.5)?;
        let kept = || some.iter().filter(|(rho, blur)| (blur.value - rho - middle).abs() <= limit);
        let rhos = kept().map(|(rho, blur)| Estimate::new(*rho, blur.std_dev));
        let predicted_px = weighted_mean(rhos)?.value;
        let measured_px = weighted_mean(kept().map(|(_, measured)| *measured))?;
        Some(Dot { predicted_px, measured_px })
    };
    all.chunks((all.len() / DOTS).max(FEWEST)).filter_map(dot).collect()
}

fn panel(
    chart: &Area,
    lens_type: usize,
    dots: &[Dot],
    slope: f64,
    [(left, right), (bottom, top)]: [(f64, f64); 2],
    drawing: &mut Drawing,
) {
    let x = Axis::new("ρ, px", [left, right]).with_grid();
    let y = Axis::new("measured blur radius, px", [bottom, top]).with_grid();
    let plane = drawing.axes(chart, &x, &y);
    // The line is limited to the chart.
    let line = |slope: f64| {
        let within = |x: f64| (x * slope).clamp(bottom, top) / slope;
        [within(left), within(right)].map(|x| plane.place(x, x * slope))
    };
    drawing.dashed(&line(1.0), INK, 1.2);
    drawing.line(&line(slope), FITTED, 1.6);
    let color = TYPE_COLORS[lens_type % TYPE_COLORS.len()];
    for dot in dots {
        let Estimate { value: measured, std_dev } = dot.measured_px;
        let end = |sign: f64| plane.place(dot.predicted_px, measured + sign * std_dev);
        drawing.line(&[end(-1.0), end(1.0)], color, 1.2);
    }
    let middles: Vec<Vector2<f64>> =
        dots.iter().map(|dot| plane.place(dot.predicted_px, dot.measured_px.value)).collect();
    drawing.discs(&middles, 2.6, color);
    drawing.title(chart, &format!("lens type {}", lens_type + 1));
}
