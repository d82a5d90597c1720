//! The shape of the board in words.

use super::assessment::two_digits;
use crate::calibration::{BoardModel, Calibration, Effort, Trial};
use crate::model::SHAPE_PARAMETERS;
use crate::quantity::with_std_dev;

/// What a calibration says of the board: a sentence.
pub(super) fn board_text(calibration: &Calibration) -> String {
    let board = &calibration.board;
    let of = |name: &str, value: &str, unit: &str| match unit {
        "1" => format!("{name} {value}"),
        unit => format!("{name} {value} {unit}"),
    };
    let found: Vec<String> = SHAPE_PARAMETERS
        .iter()
        .zip(board.std_devs)
        .filter_map(|(parameter, std_dev)| {
            let (value, std_dev) = with_std_dev(parameter.value(&board.bent.shape), Some(std_dev?));
            Some(of(parameter.name, &format!("{value} ± {std_dev}"), parameter.unit))
        })
        .collect();
    let limits: Vec<String> = SHAPE_PARAMETERS
        .iter()
        .zip(board.limits())
        .filter_map(|(parameter, limit)| {
            Some(of(parameter.name, &two_digits(limit?), parameter.unit))
        })
        .collect();
    let limits = (!limits.is_empty()).then(|| format!("below {} (2 σ)", limits.join(", ")));
    let flat = found.is_empty();
    let found: Vec<String> = (!flat).then(|| found.join(", ")).into_iter().chain(limits).collect();
    let found = found.join("; ");
    match (&board.trial, calibration.options.board) {
        (Trial::NotTried, _) if !flat => format!("The shape of the board: {found}."),
        (Trial::NotTried, BoardModel::Known(_)) => {
            "The shape of the board is taken as known.".to_owned()
        }
        (Trial::NotTried, _) => "The board is taken to be flat.".to_owned(),
        (Trial::TooFewFrames, _) => {
            "The board is taken to be flat: so few frames do not show whether it is.".to_owned()
        }
        (Trial::Failed(reason), _) => format!(
            "The board is taken to be flat, since whether it is could not be found out: {reason}."
        ),
        (Trial::Tried { std_devs_from_zero, .. }, _) => format!(
            "The board is {}flat: {found}. {}",
            if flat { "" } else { "not " },
            why(std_devs_from_zero)
        ),
    }
}

/// Why a board is held to be flat, or not.
fn why(std_devs_from_zero: &[Option<f64>; 2]) -> String {
    let known = ["bend", "aspect"].into_iter().zip(std_devs_from_zero);
    let parts: Vec<String> = known
        .filter_map(|(name, std_devs)| Some(format!("the {name} by {:.1} σ", (*std_devs)?)))
        .collect();
    if parts.is_empty() {
        return "The frames do not determine its shape.".to_owned();
    }
    format!("From 0 differ {}; more than 3 σ count.", parts.join(", "))
}

/// What was refined only to find out whether the board is flat; empty if nothing was.
pub(super) fn aside_text(aside: &Effort) -> String {
    match aside.iterations {
        0 => String::new(),
        iterations => format!(
            " Trying whether the board is flat took {iterations} more, and {:.3} s.",
            aside.time_s
        ),
    }
}
