//! What errors that all observations share do to the camera.

use super::table::{Table, table};
use crate::calibration::Calibration;
use crate::model::shared_parameters;

/// Caption of the table.
pub(super) const COMMON_ERRORS: &str =
    "What was taken from the white images, and the change of parameters, in their σ";
/// Parameters that the table shows, if they are free.
const SHOWN: [&str; 6] = ["F", "D", "d", "e_z", "theta_x", "theta_y"];

/// By how many of its σ each parameter changes with one σ of what was taken from the white images;
/// `None` if nothing is known of that.
pub(super) fn common_errors_table(calibration: &Calibration) -> Option<Table> {
    let uncertainty = &calibration.uncertainty;
    let lens_types = calibration.camera.lens_types();
    let names = shared_parameters(lens_types);
    let std_devs = uncertainty.intrinsic_std_devs(lens_types);
    let shown: Vec<usize> = (0..uncertainty.free_intrinsics.len())
        .filter(|&row| SHOWN.contains(&names[uncertainty.free_intrinsics[row]].name))
        .collect();
    let mut header = vec!["One σ of"];
    header.extend(shown.iter().map(|&row| names[uncertainty.free_intrinsics[row]].name));
    let mut table = table(&header, &[0]);
    for (source, changes) in &uncertainty.common_changes {
        let share = |&row: &usize| {
            let std_dev = std_devs[uncertainty.free_intrinsics[row]].unwrap_or(f64::INFINITY);
            format!("{:+.2}", changes[row] / std_dev)
        };
        table.add_row(std::iter::once(source.clone()).chain(shown.iter().map(share)));
    }
    (!shown.is_empty() && !uncertainty.common_changes.is_empty()).then_some(table)
}
