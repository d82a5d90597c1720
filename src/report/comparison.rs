//! Two cameras compared, as text and pictures.

use super::calibration_figures::shifts_picture;
use super::table::{Table, table};
use crate::assessment::{CameraComparison, DistanceDifference, ParameterPair};
use crate::error::Result;
use crate::model::Sensor;
use crate::quantity::{display_unit, with_std_dev};

/// Beyond so many σ a parameter is named as different.
const DIFFERENT: f64 = 3.0;
/// A shift below this is smaller than what detectors see, px.
const HARDLY_PX: f64 = 0.05;

/// The comparison for the terminal: what it comes to, then the tables.
#[must_use]
pub fn comparison_text(comparison: &CameraComparison) -> String {
    let motion = &comparison.second_from_first;
    let shift = motion.translation.vector;
    let rms_px = comparison.rms_px();
    let in_std_devs: Vec<(&str, f64)> = comparison
        .parameters
        .iter()
        .filter_map(|pair| Some((pair.name, pair.difference_in_std_devs()?)))
        .collect();
    let most = in_std_devs.iter().map(|(_, std_devs)| std_devs.abs()).fold(0.0, f64::max);
    let verdict = if rms_px < HARDLY_PX {
        "The two cameras see the same"
    } else {
        "The two cameras see differently"
    };
    let differing: Vec<String> = in_std_devs
        .iter()
        .filter(|(_, std_devs)| std_devs.abs() > DIFFERENT)
        .map(|(name, std_devs)| format!("{name} ({std_devs:+.1} σ)"))
        .collect();
    let parameters = if in_std_devs.is_empty() {
        String::new()
    } else if differing.is_empty() {
        format!(
            "\nNo parameter is more than {most:.1} σ apart. Parameters trade off, so what the cameras see says more."
        )
    } else {
        format!("\nParameters apart by more than {DIFFERENT:.0} σ: {}.", differing.join(", "))
    };
    format!(
        "{verdict}: pixels are {rms_px:.3} px RMS apart, after their frames were brought together by ({:+.3}, {:+.3}, {:+.3}) mm \
         and {:.3} mrad; {:.3} px without that.{parameters}\n\nBy distance from the first camera, after the motion\n{}\n\n\
         Parameters\n{}",
        shift.x,
        shift.y,
        shift.z,
        1e3 * motion.rotation.angle(),
        comparison.raw_rms_px,
        distances(comparison),
        parameter_table(&comparison.parameters),
    )
}

fn distances(comparison: &CameraComparison) -> Table {
    let mut rows = table(
        &["At, mm", "RMS, px", "Largest, px", "Across, mm", "Along, mm", "Further, mm", "Points"],
        &[],
    );
    let number = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |x| format!("{x:.4}"));
    for d in &comparison.distances {
        rows.add_row([
            format!("{:.1}", d.at_mm),
            format!("{:.4}", d.rms_px),
            format!("{:.4}", d.largest_px),
            number(d.rms_mm.map(|[across, _]| across)),
            number(d.rms_mm.map(|[_, along]| along)),
            d.further_mm.map_or_else(|| "-".to_owned(), |x| format!("{x:+.4}")),
            d.shifts_px.len().to_string(),
        ]);
    }
    rows
}

fn parameter_table(pairs: &[ParameterPair]) -> Table {
    let mut rows =
        table(&["Parameter", "Unit", "First", "± σ", "Second", "± σ", "Difference, σ"], &[0, 1]);
    for pair in pairs {
        let (unit, factor) = display_unit(pair.name, pair.unit);
        let [first, second] = [0, 1].map(|i| {
            let std_dev = pair.std_devs[i].map(|s| s * factor);
            let (value, std_dev_text) = with_std_dev(pair.values[i] * factor, std_dev);
            (value, if std_dev.is_some() { std_dev_text } else { String::new() })
        });
        let difference = pair.difference_in_std_devs();
        rows.add_row([
            pair.name.to_owned(),
            unit.to_owned(),
            first.0,
            first.1,
            second.0,
            second.1,
            difference.map_or_else(String::new, |d| format!("{d:+.1}")),
        ]);
    }
    rows
}

/// A picture of the shifts at each distance: file names and SVG.
pub fn comparison_pictures(
    comparison: &CameraComparison,
    sensor: &Sensor,
) -> Result<Vec<(String, String)>> {
    let picture = |d: &DistanceDifference| {
        // To the micrometre, without zeros at its end: distances apart have names apart.
        let at_mm = (1e3 * d.at_mm).round() / 1e3;
        let title = format!("Second camera minus first at {at_mm} mm");
        Ok((format!("shifts-{at_mm}-mm.svg"), shifts_picture(&d.shifts_px, sensor, &title)?))
    };
    comparison.distances.iter().map(picture).collect()
}
