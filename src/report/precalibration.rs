//! A pre-calibration as text.

use super::table::{Table, table};
use crate::model::full_scale;
use crate::precalibration::{ArrayMeasurement, LensTypes, Precalibration};

/// The result of a pre-calibration on a terminal: array, lens types, radii, internal parameters.
#[must_use]
pub fn precalibration_text(result: &Precalibration) -> String {
    let types = types_text(&result.lens_types);
    let correction = format!(
        "The pitch is corrected for vignetting, which had changed it by {:.1e}.",
        -result.pitch_correction
    );
    let levels = levels_text(result).map_or_else(String::new, |line| format!("\n{line}"));
    [
        format!("{}\n{correction}\n{types}{levels}", array_text(&result.array)),
        radii_table(result).to_string(),
        internal_table(result).to_string(),
    ]
    .join("\n\n")
}

/// Black level and saturation level in a line, unless samples go from 0 to full scale.
pub(super) fn levels_text(result: &Precalibration) -> Option<String> {
    let levels = result.internal.parameters.levels?;
    let black = (levels.black_level > 0.0).then(|| match levels.black_level_std_dev {
        Some(std_dev) => {
            format!("Black level {:.2} ± {std_dev:.2} grey levels.", levels.black_level)
        }
        None => format!("Black level {} grey levels, as stated.", levels.black_level),
    });
    let full = levels.saturation_level.map(|level| {
        format!("Pixels are full at {level:.0} of {:.0} grey levels.", full_scale(levels.bits))
    });
    let parts: Vec<String> = black.into_iter().chain(full).collect();
    (!parts.is_empty()).then(|| parts.join(" "))
}

/// Lens types on a terminal.
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

/// The array on a terminal.
#[must_use]
pub fn array_text(array: &ArrayMeasurement) -> String {
    let (grid, out) = (&array.grid, &array.left_out);
    let left_out: Vec<String> = [
        (out.cut, "cut by the border"),
        (out.dark, "dark"),
        (out.saturated, "saturated all over"),
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
        "Lattice {}, {} x {}, pitch {:.5} px, rotation {:+.4} mrad, middle at ({:.2}, {:.2}) px.\n{} \
         centres, {:.3} px RMS from a regular grid{left_out}.",
        grid.lattice.kind().name(),
        grid.lattice.columns,
        grid.lattice.rows,
        grid.pitch_px,
        grid.rotation_rad * 1e3,
        grid.center_px.x,
        grid.center_px.y,
        array.centers.len(),
        grid.rms_px,
    )
}

pub(super) fn radii_table(result: &Precalibration) -> Table {
    let types = result.lens_types.types;
    let mut header = vec!["Radius, px, at N".to_owned()];
    header.extend((1..=types).map(|i| format!("Type {i} ± σ")));
    header.push("off the lines".to_owned());
    let header: Vec<&str> = header.iter().map(String::as_str).collect();
    let mut table = table(&header, &[]);
    for of_image in result.radii.chunks(types) {
        let mut row = vec![format!("{:.2}", of_image[0].f_number)];
        row.extend(of_image.iter().map(|r| format!("{:.3} ± {:.3}", r.radius_px, r.std_dev_px)));
        let off: Vec<String> = of_image.iter().map(|r| format!("{:+.3}", r.residual_px)).collect();
        row.push(off.join(" "));
        table.add_row(row);
    }
    table
}

pub(super) fn internal_table(result: &Precalibration) -> Table {
    let internal = &result.internal.parameters;
    let mut table = table(&["Internal parameter, µm", "", "± σ"], &[0]);
    let mut add = |name: String, value: f64, std_dev: f64| {
        table.add_row([name, format!("{:.3}", value * 1e3), format!("{:.3}", std_dev * 1e3)]);
    };
    add("|m|".to_owned(), internal.m_mm, internal.m_std_dev_mm.unwrap_or(f64::NAN));
    for (i, (&q, &s)) in internal.q_prime_mm.iter().zip(&internal.q_prime_std_dev_mm).enumerate() {
        add(format!("q'_{}", i + 1), q, s);
    }
    table
}
