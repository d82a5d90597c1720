//! The shape of the board in words.

use super::assessment::two_digits;
use crate::calibration::{BoardModel, Calibration};
use crate::model::{SHAPE_PARAMETERS, with_std_dev};

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
    let found = found.join(", ");
    match (calibration.options.board, found.is_empty(), limits) {
        (BoardModel::Bent, false, _) => format!("The shape of the board: {found}."),
        (_, false, None) => format!("The board is not flat: {found}."),
        (_, false, Some(limits)) => format!("The board is not flat: {found}; {limits}."),
        (_, true, Some(limits)) => format!("The board is flat: {limits}."),
        (BoardModel::Known(_), true, None) => {
            "The shape of the board is taken as known.".to_owned()
        }
        (_, true, None) => "The board is taken to be flat.".to_owned(),
    }
}
