//! Calibration as sentences: how it ended, and its weakest directions.

use crate::calibration::Calibration;
use crate::quantity::{display_unit, signed, significant};
use crate::solver::{Termination, WeakDirection};

/// Share of its variance from which on a direction names the distance of the boards.
const BOARDS_NAMED_SHARE: f64 = 0.5;

/// Returns a sentence that says how the refinement ended.
#[must_use]
pub fn termination_text(calibration: &Calibration) -> String {
    let decrease = significant(calibration.uncertainty.expected_decrease, 2);
    let refinement = &calibration.refinement;
    match (refinement.termination, calibration.converged) {
        (_, true) => {
            format!("Converged: a further Gauss-Newton step would lower the cost by {decrease}.")
        }
        (Termination::Converged, false) => format!(
            "The solver stopped ({}), but a further step would still lower the cost by \
             {decrease}.",
            refinement.message
        ),
        (Termination::IterationLimit, _) => format!(
            "Stopped at the limit of iterations; a further step would still lower the cost by \
             {decrease}."
        ),
        (Termination::Stopped, _) => "Stopped by the caller.".to_owned(),
        _ => format!("The solver failed: {}", refinement.message),
    }
}

/// Returns the weakest directions, one sentence each, the weakest first.
#[must_use]
pub fn weakest_directions_text(calibration: &Calibration) -> Vec<String> {
    let lens_types = calibration.camera.lens_types();
    let directions = calibration.uncertainty.weakest_directions(lens_types);
    directions.iter().map(direction_text).collect()
}

fn direction_text(direction: &WeakDirection) -> String {
    let mut names: Vec<&str> = direction.components.iter().map(|c| c.name.as_str()).collect();
    let mut changes: Vec<String> = direction
        .components
        .iter()
        .map(|c| {
            let (unit, factor) = display_unit(&c.name, c.unit);
            format!("{} {} {unit} ({:.0} %)", c.name, signed(c.change * factor), 100.0 * c.share)
        })
        .collect();
    let boards = direction.board_distance_share >= BOARDS_NAMED_SHARE;
    if boards {
        changes.push(format!(
            "board distance {} mm ({:.0} %)",
            signed(direction.board_distance_mm),
            100.0 * direction.board_distance_share
        ));
    }
    let last = names.pop().unwrap_or_default();
    let subject = match (names.is_empty(), boards) {
        (true, true) => format!("{last} trades off against board distance"),
        (true, false) => format!("{last} has the largest uncertainty"),
        (false, true) => {
            format!("{} and {last} trade off against board distance", names.join(", "))
        }
        (false, false) => format!("{} and {last} trade off against each other", names.join(", ")),
    };
    let along = if direction.determined {
        "change along one σ, with the share of each variance"
    } else {
        "NOT DETERMINED by these observations; change along this direction, with the share of each"
    };
    format!("{subject}; {along}: {}", changes.join(", "))
}
