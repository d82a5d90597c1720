//! The report of the comparison of two cameras.

use super::tree::{Cell, Column, Part, Section, Table};
use crate::assessment::{CameraComparison, ParameterPair};
use crate::quantity::{display_unit, fixed_signed};

/// Difference of a parameter, in σ, above which it is reported.
const DIFFERENT: f64 = 3.0;
/// RMS shift below which cameras project alike, px: smaller than the noise of detectors.
const HARDLY_PX: f64 = 0.05;
/// RMS difference of blur radii below which cameras blur alike, px.
const HARDLY_BLURRED_PX: f64 = 0.1;

/// Returns the conclusion of the comparison, then the tables.
#[must_use]
pub fn comparison_section(comparison: &CameraComparison) -> Section {
    let motion = &comparison.second_from_first;
    let shift = motion.translation.vector;
    let rms_px = comparison.rms_px();
    let in_std_devs: Vec<(&str, f64)> = comparison
        .parameters
        .iter()
        .filter_map(|pair| Some((pair.name, pair.difference_in_std_devs()?)))
        .collect();
    let most = in_std_devs.iter().map(|(_, std_devs)| std_devs.abs()).fold(0.0, f64::max);
    let blur_px = comparison.blur_rms_px();
    let verdict = if rms_px < HARDLY_PX && blur_px.is_none_or(|blur| blur < HARDLY_BLURRED_PX) {
        "The two cameras project alike"
    } else if rms_px < HARDLY_PX {
        "The two cameras project points alike, but blur them differently"
    } else {
        "The two cameras project differently"
    };
    let differing: Vec<String> = in_std_devs
        .iter()
        .filter(|(_, std_devs)| std_devs.abs() > DIFFERENT)
        .map(|(name, std_devs)| format!("{name} ({std_devs:+.1} σ)"))
        .collect();
    let parameters = if in_std_devs.is_empty() {
        None
    } else if differing.is_empty() {
        Some(format!(
            "No parameter differs by more than {most:.1} σ. Parameters trade off, so the \
             projections are the better criterion."
        ))
    } else {
        Some(format!(
            "Parameters that differ by more than {DIFFERENT:.0} σ: {}.",
            differing.join(", ")
        ))
    };
    let blur = blur_px.map_or(String::new(), |blur| format!(" and blur radii by {blur:.3} px"));
    let seen = format!(
        "{verdict}: pixels differ by {rms_px:.3} px RMS{blur} after the camera frames are aligned \
         by ({}, {}, {}) mm and {:.3} mrad; by {:.3} px before.",
        fixed_signed(shift.x, 3),
        fixed_signed(shift.y, 3),
        fixed_signed(shift.z, 3),
        1e3 * motion.rotation.angle(),
        comparison.raw_rms_px,
    );
    let mut parts: Vec<Part> = std::iter::once(seen).chain(parameters).map(Part::Text).collect();
    parts.push(Part::Table(distances(comparison)));
    let all = vec![Part::Table(parameter_table(&comparison.parameters))];
    parts.push(Part::details("All parameters", all));
    Section::new("Comparison", parts)
}

fn distances(comparison: &CameraComparison) -> Table {
    let mut table = Table::new(
        "Differences by distance from the first camera, after the alignment",
        [
            Column::of("At", "mm"),
            Column::of("RMS", "px"),
            Column::of("Largest", "px"),
            Column::of("Across", "mm"),
            Column::of("Along", "mm"),
            Column::of("Further", "mm"),
            Column::of("Blur", "px"),
            Column::number("Points"),
        ],
    );
    let number = |value: Option<f64>| Cell::or_missing(value, |x| Cell::fixed(x, 4));
    for d in &comparison.distances {
        table.push([
            Cell::fixed(d.at_mm, 1),
            Cell::fixed(d.rms_px, 4),
            Cell::fixed(d.largest_px, 4),
            number(d.rms_mm.map(|[across, _]| across)),
            number(d.rms_mm.map(|[_, along]| along)),
            Cell::or_missing(d.further_mm, |x| Cell::signed(x, 4)),
            number(d.blur_rms_px),
            d.shifts_px.len().into(),
        ]);
    }
    table
}

fn parameter_table(pairs: &[ParameterPair]) -> Table {
    let mut table = Table::new(
        "Parameters",
        [
            Column::text("Parameter"),
            Column::text("Unit"),
            Column::number("First"),
            Column::number("± σ"),
            Column::number("Second"),
            Column::number("± σ"),
            Column::of("Difference", "σ"),
        ],
    );
    for pair in pairs {
        let (unit, factor) = display_unit(pair.name, pair.unit);
        let of = |i: usize| {
            Cell::with_std_dev(pair.values[i] * factor, pair.std_devs[i].map(|s| s * factor))
        };
        let difference = pair.difference_in_std_devs();
        table.push(
            [pair.name.into(), unit.into()]
                .into_iter()
                .chain(of(0))
                .chain(of(1))
                .chain([difference.map_or(Cell::empty(), |d| Cell::signed(d, 1))]),
        );
    }
    table
}
