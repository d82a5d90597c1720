//! Errors by lens type and frame, and the cost over the iterations.

use nalgebra::Vector2;

use super::super::drawing::{Anchor, Area, Axis, BLUE, Drawing, ORANGE, Ticks, WHITE};
use super::super::tree::Figure;
use crate::calibration::Calibration;
use crate::model::Rmse;

/// Width of the name under a bar, px.
const NAME: f64 = 26.0;

struct Bars<'a> {
    what: &'a str,
    names: Vec<String>,
    values: Vec<Rmse>,
}

pub(super) fn rmse(calibration: &Calibration) -> Option<Figure> {
    let reprojection = &calibration.reprojection;
    let all = reprojection.rmse();
    if !all.uv_px.is_finite() {
        return None;
    }
    let types = calibration.camera.lens_types();
    let of_types = Bars {
        what: "lens type",
        names: (1..=types).map(|i| i.to_string()).collect(),
        values: (0..types).map(|i| reprojection.lens_type_rmse(i)).collect(),
    };
    let of_frames = Bars {
        what: "frame",
        names: calibration.poses.iter().map(|p| p.frame.to_string()).collect(),
        values: calibration.poses.iter().map(|p| reprojection.frame_rmse(p.frame)).collect(),
    };
    let largest = of_types
        .values
        .iter()
        .chain(&of_frames.values)
        .chain([&all])
        .flat_map(|rmse| [Some(rmse.uv_px), rmse.rho_px])
        .flatten()
        .filter(|v| v.is_finite())
        .fold(1e-9, f64::max);
    let mut drawing = Drawing::new(900.0, 360.0);
    let [left, right] =
        Area::new(0.0, 0.0, 900.0, 360.0).split_at(if types > 0 { 250.0 } else { 0.0 });
    if types > 0 {
        bars(&left, &of_types, &all, largest, &mut drawing);
    }
    bars(&right, &of_frames, &all, largest, &mut drawing);
    let names = [("(u, v)", BLUE), ("ρ", ORANGE)];
    let shown = if all.rho_px.is_some() { &names[..] } else { &names[..1] };
    drawing.legend(Vector2::new(760.0, 18.0), 80.0, shown);
    drawing.text(Vector2::new(12.0, 18.0), Anchor::Start, 16.0, "RMSE of features");
    let (by, which) =
        if types > 0 { ("lens type and by frame", "frame or type") } else { ("frame", "frame") };
    let caption = format!(
        "Root mean square errors of features by {by}; the dashed lines are for all features. A \
         {which} that stands out has worse observations than the others, or the model fits it \
         worse."
    );
    Some(drawing.figure("rmse", caption))
}

fn bars(area: &Area, bars: &Bars, all: &Rmse, largest: f64, drawing: &mut Drawing) {
    let (count, highest) = (bars.names.len() as f64, 1.12 * largest);
    let x = Axis::new(bars.what, [0.0, count]).with_ticks(Ticks::None);
    let y = Axis::new("RMSE, px", [0.0, highest]).with_grid();
    let plane = drawing.axes(&area.within_axes(), &x, &y);
    let series = [(Some(all.uv_px), BLUE), (all.rho_px, ORANGE)];
    let shown = series.iter().filter(|(value, _)| value.is_some()).count() as f64;
    // Bars side by side fill most of the width of their group.
    let width = 0.76 / shown;
    for (i, rmse) in bars.values.iter().enumerate() {
        for (side, (value, color)) in
            [(Some(rmse.uv_px), BLUE), (rmse.rho_px, ORANGE)].into_iter().enumerate()
        {
            let Some(value) = value.filter(|v| v.is_finite()) else { continue };
            let left = i as f64 + 0.12 + side as f64 * width;
            let corner = plane.place(left, value);
            let size = Vector2::new(width, value).component_mul(&plane.scale).abs();
            // A bar of 0 must be visible too.
            drawing.rectangle(corner, size.sup(&Vector2::new(1.0, 0.8)), color, 1.0);
        }
    }
    for (value, color) in series {
        if let Some(value) = value {
            drawing.dashed(&[plane.place(0.0, value), plane.place(count, value)], color, 1.2);
        }
    }
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a small number
    let every = ((NAME / plane.scale.x).ceil() as usize).max(1);
    for (i, name) in bars.names.iter().enumerate().step_by(every) {
        let below = plane.place(i as f64 + 0.5, 0.0) + Vector2::new(0.0, 12.0);
        drawing.text(below, Anchor::Middle, 13.0, name);
    }
}

/// Relative excess of a cost over the lowest cost, below which it counts as the lowest.
const AT_LOWEST: f64 = 1e-15;

pub(super) fn convergence(calibration: &Calibration) -> Option<Figure> {
    let costs: Vec<(f64, f64)> = calibration
        .refinement
        .iterations
        .iter()
        .map(|i| (f64::from(i.number), i.cost))
        .filter(|(_, cost)| cost.is_finite())
        .collect();
    let (Some(last), Some(lowest)) =
        (costs.last(), costs.iter().map(|c| c.1).min_by(f64::total_cmp))
    else {
        return None;
    };
    let above = |cost: f64| {
        let excess = cost - lowest;
        (excess > AT_LOWEST * lowest.abs() && excess > f64::MIN_POSITIVE).then(|| excess.log10())
    };
    let decades = || costs.iter().filter_map(|c| above(c.1));
    let least = decades().reduce(f64::min).unwrap_or(0.0).floor() - 1.0;
    let most = decades().reduce(f64::max).unwrap_or(0.0).ceil().max(least + 2.0);
    let furthest = last.0.max(1.0);
    let mut drawing = Drawing::new(900.0, 380.0);
    let x = [-0.02 * furthest, furthest * 1.02];
    let x = Axis::new("iteration", x).with_ticks(Ticks::Whole).with_grid();
    let y = Axis::new("cost above the lowest", [least, most]);
    let y = y.with_ticks(Ticks::Decades).with_grid();
    let chart = Area::new(0.0, 0.0, 900.0, 380.0).within_axes();
    let plane = drawing.axes(&chart, &x, &y);
    let places: Vec<Vector2<f64>> =
        costs.iter().map(|c| plane.place(c.0, above(c.1).unwrap_or(least))).collect();
    drawing.line(&places, BLUE, 1.6);
    let (at_lowest, higher): (Vec<_>, Vec<_>) =
        costs.iter().zip(&places).partition(|(c, _)| above(c.1).is_none());
    let middles = |of: Vec<(&(f64, f64), &Vector2<f64>)>| -> Vec<Vector2<f64>> {
        of.into_iter().map(|(_, place)| *place).collect()
    };
    let lowest_places = middles(at_lowest);
    drawing.discs(&middles(higher), 3.5, BLUE);
    drawing.discs(&lowest_places, 4.5, BLUE);
    drawing.discs(&lowest_places, 2.8, WHITE);
    let words = format!("Cost: {} at the start, {} at the end", short(costs[0].1), short(last.1));
    drawing.title(&chart, &words);
    let caption = "Cost above the lowest cost at every iteration; a hollow dot marks the lowest \
                   cost. A steady decrease to the end shows good convergence, a long plateau weak \
                   directions."
        .to_owned();
    Some(drawing.figure("convergence", caption))
}

fn short(cost: f64) -> String {
    if (1e-2..1e7).contains(&cost) { format!("{cost:.3}") } else { format!("{cost:.3e}") }
}
