//! The report of a pre-calibration.

use super::tree::{Cell, Column, Figure, Part, Section, Table};
use crate::model::{Opening, full_scale};
use crate::precalibration::{ArrayMeasurement, LensTypes, Precalibration};
use crate::quantity::{Estimate, fixed_signed, significant};

/// Returns array, lens types, radii, internal parameters, and figures.
#[must_use]
pub fn precalibration_section(result: &Precalibration, figures: Vec<Figure>) -> Section {
    let mut parts: Vec<Part> = Part::paragraphs(&array_text(&result.array)).collect();
    parts.push(Part::Text(format!(
        "The pitch is corrected for vignetting, which had changed it by {}.",
        significant(-result.pitch_correction, 2)
    )));
    parts.push(Part::Text(types_text(&result.lens_types)));
    parts.extend(levels_text(result).map(Part::Text));
    parts.push(Part::Text(opening_text(result)));
    parts.push(Part::Table(internal_table(result)));
    parts.push(Part::details("Radii by f-number", vec![Part::Table(radii_table(result))]));
    parts.extend(figures.into_iter().map(Part::Figure));
    Section {
        warnings: result.findings.iter().map(ToString::to_string).collect(),
        ..Section::new("Pre-calibration", parts)
    }
}

/// Returns black level and saturation level in a line; `None` if samples go from 0 to full scale.
fn levels_text(result: &Precalibration) -> Option<String> {
    let levels = result.internal.parameters.levels?;
    let black = (levels.black_level > 0.0).then(|| match levels.black_level_std_dev {
        Some(std_dev) => {
            format!("Black level {:.2} ± {std_dev:.2} grey levels.", levels.black_level)
        }
        None => format!("Black level {} grey levels, as stated.", levels.black_level),
    });
    let full = levels.saturation_level.map(|level| {
        format!("Pixels saturate at {level:.0} of {:.0} grey levels.", full_scale(levels.bits))
    });
    let parts: Vec<String> = black.into_iter().chain(full).collect();
    (!parts.is_empty()).then(|| parts.join(" "))
}

/// Returns a sentence on the shape of the openings.
fn opening_text(result: &Precalibration) -> String {
    let cell = Opening::cell(result.array.grid.lattice.kind()).name();
    let evidence = result.cell_share.map_or(
        "assumed, since micro-images are too large or too small to show it".to_owned(),
        |Estimate { value, std_dev }| {
            format!("cell share {value:.2} ± {std_dev:.2}, 0 for a disc and 1 for a {cell}")
        },
    );
    format!(
        "Opening of the micro-lenses: {} ({evidence}).",
        result.internal.parameters.opening.name()
    )
}

/// Returns a text on the lens types.
#[must_use]
pub fn types_text(types: &LensTypes) -> String {
    if types.types == 1 {
        return "One lens type, or several whose micro-images have the same size.".to_owned();
    }
    let apart = types.separation.map(|s| format!(", {s:.0} standard deviations apart"));
    let agree = types
        .agreement
        .map(|a| format!("; {:.2} % of the micro-images have the size of their type", 100.0 * a));
    let [apart, agree] = [apart, agree].map(Option::unwrap_or_default);
    format!("{} lens types{apart}{agree}.", types.types)
}

/// Returns a text on the array.
#[must_use]
pub fn array_text(array: &ArrayMeasurement) -> String {
    let (grid, out) = (&array.grid, &array.left_out);
    let left_out: Vec<String> = [
        (out.cut, "cut by the border"),
        (out.dark, "dark"),
        (out.saturated, "fully saturated"),
        (out.misplaced, "misplaced"),
    ]
    .into_iter()
    .filter(|&(count, _)| count > 0)
    .map(|(count, why)| format!("{count} {why}"))
    .collect();
    let left_out = if left_out.is_empty() {
        String::new()
    } else {
        format!(" (left out: {})", left_out.join(", "))
    };
    format!(
        "Lattice {}, {} x {}, pitch {:.5} px, rotation {} mrad, middle at ({:.2}, {:.2}) px.\n{} \
         centres, {:.3} px RMS from a regular grid{left_out}.",
        grid.lattice.kind().name(),
        grid.lattice.columns,
        grid.lattice.rows,
        grid.pitch_px,
        fixed_signed(grid.rotation_rad * 1e3, 4),
        grid.center_px.x,
        grid.center_px.y,
        array.centers.len(),
        grid.rms_px,
    )
}

fn radii_table(result: &Precalibration) -> Table {
    let types = result.lens_types.types;
    let of_type = |i: usize| {
        [format!("Type {i}"), "± σ".to_owned(), "off its line".to_owned()]
            .map(|n| Column::number(&n))
    };
    let mut table = Table::new(
        "Radii of the micro-images by f-number and lens type, px",
        std::iter::once(Column::number("N")).chain((1..=types).flat_map(of_type)),
    );
    for of_image in result.radii.chunks(types) {
        let cells = of_image.iter().flat_map(|r| {
            [
                Cell::fixed(r.radius_px, 3),
                Cell::fixed(r.std_dev_px, 3),
                Cell::signed(r.residual_px, 3),
            ]
        });
        table.push(std::iter::once(Cell::fixed(of_image[0].f_number, 2)).chain(cells));
    }
    table
}

fn internal_table(result: &Precalibration) -> Table {
    let internal = &result.internal.parameters;
    let mut table = Table::new(
        "Internal parameters (paper, Table 2)",
        [Column::text("Internal parameter"), Column::of("Value", "µm"), Column::of("± σ", "µm")],
    );
    let mut add = |name: String, value: f64, std_dev: f64| {
        table.push([name.into(), Cell::fixed(value * 1e3, 3), Cell::fixed(std_dev * 1e3, 3)]);
    };
    add("|m|".to_owned(), internal.m_mm, internal.m_std_dev_mm.unwrap_or(f64::NAN));
    for (i, (&q, &s)) in internal.q_prime_mm.iter().zip(&internal.q_prime_std_dev_mm).enumerate() {
        add(format!("q'_{}", i + 1), q, s);
    }
    table
}
