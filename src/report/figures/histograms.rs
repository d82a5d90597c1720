//! Histograms of residuals with the normal curve that they should follow.

use nalgebra::Vector2;

use super::super::drawing::{Area, Axis, BLUE, Drawing, FITTED, quantile};
use super::super::tree::Figure;
use crate::calibration::Calibration;
use crate::quantity::{fixed, significant};
use crate::solver::LossKind;

const BINS: usize = 40;
/// Least half range of a histogram, in standard deviations. Residuals outside the range are counted, not drawn.
const SHOWN_STD_DEVS: f64 = 4.5;
/// Narrowest half range, px.
const NARROWEST: f64 = 1e-9;
const CURVE_POINTS: u32 = 120;

struct Panel {
    name: &'static str,
    values: Vec<f64>,
    std_dev: f64,
}

pub(super) fn residual_histograms(calibration: &Calibration) -> Option<Figure> {
    let (features, centers) =
        (&calibration.reprojection.features, &calibration.reprojection.centers);
    let [uv, rho, of_centers] = calibration.uncertainty.residual_std_dev_px;
    // The standard deviation is not measured if ρ does not count.
    let rms = calibration.reprojection.rmse().rho_px.unwrap_or(f64::NAN);
    let rho = if rho.is_nan() { rms } else { rho };
    let panel = |name, values: Vec<f64>, std_dev| Panel {
        name,
        values: values.into_iter().filter(|v| v.is_finite()).collect(),
        std_dev,
    };
    let mut panels = vec![
        panel("u", features.iter().map(|f| f.du_px).collect(), uv),
        panel("v", features.iter().map(|f| f.dv_px).collect(), uv),
        panel("ρ", features.iter().filter_map(|f| f.drho_px).collect(), rho),
        panel(
            "centres, u and v",
            centers.iter().flat_map(|c| [c.du_px, c.dv_px]).collect(),
            of_centers,
        ),
    ];
    panels.retain(|panel| !panel.values.is_empty());
    if panels.is_empty() {
        return None;
    }
    let rows = panels.len().div_ceil(2);
    let height = 300.0 * rows as f64;
    let mut drawing = Drawing::new(900.0, height);
    let areas = Area::new(0.0, 0.0, 900.0, height).split(rows, panels.len().min(2));
    for (panel, area) in panels.iter().zip(areas) {
        histogram(&area.within_axes(), panel, &mut drawing);
    }
    let spread = if calibration.cost.loss.kind == LossKind::None {
        "the measured standard deviation"
    } else {
        "the standard deviation after weighting by the loss"
    };
    let caption = format!(
        "Residuals with the normal distribution of {spread}. Bars that do not follow the curve, or \
         lie far out, show errors other than noise: false observations, or effects outside the \
         model."
    );
    Some(drawing.figure("residual-histograms", caption))
}

fn histogram(chart: &Area, panel: &Panel, drawing: &mut Drawing) {
    let mut sizes: Vec<f64> = panel.values.iter().map(|v| v.abs()).collect();
    let most = quantile(&mut sizes, 0.98).unwrap_or(0.0);
    let has_curve = panel.std_dev.is_finite() && panel.std_dev > 0.0;
    let std_dev = if has_curve { panel.std_dev } else { 0.0 };
    // Under a robust loss the standard deviation may be much below the spread.
    let half = (SHOWN_STD_DEVS * std_dev).max(1.2 * most).max(NARROWEST);
    let bin_width = 2.0 * half / BINS as f64;
    let mut counts = [0_u32; BINS];
    let mut beyond = 0;
    for value in &panel.values {
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // negative is beyond
        match ((value + half) / bin_width).floor() {
            bin if (0.0..BINS as f64).contains(&bin) => counts[bin as usize] += 1,
            _ => beyond += 1,
        }
    }
    let drawn = panel.values.len() as f64;
    let normal = |x: f64| {
        let z = x / std_dev;
        drawn * bin_width / std_dev / (2.0 * std::f64::consts::PI).sqrt() * (-z * z / 2.0).exp()
    };
    let highest = f64::from(counts.iter().copied().max().unwrap_or(1));
    let highest =
        1.08 * if has_curve { highest.max(normal(0.0).min(2.0 * highest)) } else { highest };
    let x = Axis::new("residual, px", [-half, half]);
    let plane = drawing.axes(chart, &x, &Axis::new("number", [0.0, highest]));
    for (bin, &count) in counts.iter().enumerate().filter(|(_, count)| **count > 0) {
        let corner = plane.place(-half + bin as f64 * bin_width, f64::from(count));
        let size = Vector2::new(bin_width, f64::from(count)).component_mul(&plane.scale).abs();
        drawing.rectangle(corner, size - Vector2::new(1.0, 0.0), BLUE, 0.75);
    }
    let mut title = format!("{}: {}", panel.name, panel.values.len());
    if has_curve {
        let points: Vec<_> = (0..=CURVE_POINTS)
            .map(|i| -half + 2.0 * half * f64::from(i) / f64::from(CURVE_POINTS))
            .map(|x| plane.place(x, normal(x).min(highest)))
            .collect();
        drawing.line(&points, FITTED, 2.0);
        title = format!("{title}, σ {} px", short(panel.std_dev));
    }
    if beyond > 0 {
        title = format!("{title}, {beyond} beyond");
    }
    drawing.title(chart, &title);
}

/// Formats a standard deviation in px with its significant digits.
fn short(value: f64) -> String {
    if value >= 1e-3 { fixed(value, 4) } else { significant(value, 2) }
}
