//! Errors by lens type and frame, and the cost over the iterations.

use nalgebra::Vector2;
use plotters::prelude::*;

use super::figure;
use crate::calibration::Calibration;
use crate::error::Result;
use crate::model::Rmse;
use crate::report::drawing::{
    Anchor, Area, BLUE, INK, ORANGE, Overlay, Plane, axis_number, drawing, font, picture,
};
use crate::report::html::Figure;

/// Height of a name under a bar, px.
const NAME: f64 = 26.0;

struct Bars<'a> {
    what: &'a str,
    names: Vec<String>,
    values: Vec<Rmse>,
}

pub(super) fn rmse(calibration: &Calibration) -> Result<Option<Figure>> {
    let reprojection = &calibration.reprojection;
    let all = reprojection.rmse();
    if !all.uv_px.is_finite() {
        return Ok(None);
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
    let svg = picture((900, 360), |root, overlay| {
        let (left, right) = root.split_horizontally(if types > 0 { 250 } else { 0 });
        if types > 0 {
            bars(&left, &of_types, &all, largest, overlay)?;
        }
        bars(&right, &of_frames, &all, largest, overlay)?;
        // The legend, at the upper right.
        let mut at = Vector2::new(884.0, 18.0);
        for (words, color) in
            [("ρ", ORANGE), ("(u, v)", BLUE)].into_iter().skip(usize::from(all.rho_px.is_none()))
        {
            overlay.text(at, Anchor::End, 14.0, words);
            at.x -= if color == ORANGE { 26.0 } else { 54.0 };
            overlay.rectangle(at - Vector2::new(6.0, 6.0), Vector2::new(12.0, 12.0), color, 1.0);
            at.x -= 18.0;
        }
        overlay.text(Vector2::new(12.0, 18.0), Anchor::Start, 16.0, "RMSE of features");
        Ok(())
    })?;
    let (by, which) =
        if types > 0 { ("lens type and by frame", "frame or type") } else { ("frame", "frame") };
    let caption = format!(
        "Root mean square errors of features by {by}; the dashed lines are those of all features. A \
         {which} that stands out has worse observations than the others, or the model fits it worst."
    );
    Ok(Some(figure("rmse", caption, svg)))
}

fn bars(area: &Area, bars: &Bars, all: &Rmse, largest: f64, overlay: &mut Overlay) -> Result<()> {
    let (count, highest) = (bars.names.len() as f64, 1.12 * largest);
    let area = area.margin(36, 6, 8, 16);
    let mut chart = ChartBuilder::on(&area)
        .x_label_area_size(44)
        .y_label_area_size(62)
        .build_cartesian_2d(0.0..count, 0.0..highest)
        .map_err(drawing)?;
    chart
        .configure_mesh()
        .disable_x_mesh()
        .light_line_style(TRANSPARENT)
        .axis_style(INK)
        .x_labels(0)
        .y_labels(6)
        .y_label_formatter(&|y| axis_number(*y))
        .x_desc(bars.what)
        .y_desc("RMSE, px")
        .label_style(font(13))
        .draw()
        .map_err(drawing)?;
    let plane = Plane::of_chart(
        chart.plotting_area().get_pixel_range(),
        Vector2::new(0.0, 0.0),
        Vector2::new(count, highest),
    );
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
            // A bar of 0 is visible too.
            overlay.rectangle(corner, size.sup(&Vector2::new(1.0, 0.8)), color, 1.0);
        }
    }
    for (value, color) in series {
        if let Some(value) = value {
            overlay.dashed(&[plane.place(0.0, value), plane.place(count, value)], color, 1.2);
        }
    }
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a small number
    let every = ((NAME / plane.scale.x).ceil() as usize).max(1);
    for (i, name) in bars.names.iter().enumerate().step_by(every) {
        let below = plane.place(i as f64 + 0.5, 0.0) + Vector2::new(0.0, 12.0);
        overlay.text(below, Anchor::Middle, 13.0, name);
    }
    Ok(())
}

/// Costs that exceed the lowest by less than this fraction of it count as the lowest.
const AT_LOWEST: f64 = 1e-15;

pub(super) fn convergence(calibration: &Calibration) -> Result<Option<Figure>> {
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
        return Ok(None);
    };
    let above = |cost: f64| {
        let excess = cost - lowest;
        (excess > AT_LOWEST * lowest.abs() && excess > f64::MIN_POSITIVE).then(|| excess.log10())
    };
    let decades = || costs.iter().filter_map(|c| above(c.1));
    let least = decades().reduce(f64::min).unwrap_or(0.0).floor() - 1.0;
    let most = decades().reduce(f64::max).unwrap_or(0.0).ceil().max(least + 2.0);
    let furthest = last.0.max(1.0);
    let svg = picture((900, 380), |root, overlay| {
        let area = root.margin(36, 8, 8, 24);
        let mut chart = ChartBuilder::on(&area)
            .x_label_area_size(44)
            .y_label_area_size(76)
            .build_cartesian_2d(-0.02 * furthest..furthest * 1.02, least..most)
            .map_err(drawing)?;
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .axis_style(INK)
            .x_labels(10)
            .y_labels(8)
            .x_label_formatter(&|x| {
                if x.fract().abs() < 1e-9 { axis_number(*x) } else { String::new() }
            })
            .y_label_formatter(&|y| decade(*y))
            .x_desc("iteration")
            .y_desc("cost above the lowest")
            .label_style(font(13))
            .draw()
            .map_err(drawing)?;
        let plane = Plane::of_chart(
            chart.plotting_area().get_pixel_range(),
            Vector2::new(-0.02 * furthest, least),
            Vector2::new(furthest * 1.02, most),
        );
        let places: Vec<Vector2<f64>> =
            costs.iter().map(|c| plane.place(c.0, above(c.1).unwrap_or(least))).collect();
        overlay.line(&places, BLUE, 1.6);
        let (at_lowest, higher): (Vec<_>, Vec<_>) =
            costs.iter().zip(&places).partition(|(c, _)| above(c.1).is_none());
        let middles = |of: Vec<(&(f64, f64), &Vector2<f64>)>| -> Vec<Vector2<f64>> {
            of.into_iter().map(|(_, place)| *place).collect()
        };
        let lowest_places = middles(at_lowest);
        overlay.discs(&middles(higher), 3.5, BLUE);
        overlay.discs(&lowest_places, 4.5, BLUE);
        overlay.discs(&lowest_places, 2.8, WHITE);
        let words =
            format!("Cost: {} at the start, {} at the end", short(costs[0].1), short(last.1));
        overlay.text(Vector2::new(84.0, 18.0), Anchor::Start, 16.0, &words);
        Ok(())
    })?;
    let caption =
        "Cost above the lowest cost at every iteration; a hollow dot marks the lowest itself. A \
                   straight fall to the end shows sound convergence, a long flat stretch a valley of \
                   weak directions."
            .to_owned();
    Ok(Some(figure("convergence", caption, svg)))
}

fn decade(exponent: f64) -> String {
    let whole = exponent.round();
    if (whole - exponent).abs() > 1e-9 { String::new() } else { format!("1e{whole:.0}") }
}

fn short(cost: f64) -> String {
    if (1e-2..1e7).contains(&cost) { format!("{cost:.3}") } else { format!("{cost:.3e}") }
}
