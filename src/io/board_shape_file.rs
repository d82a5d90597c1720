//! `board_shape` of `calibration.json`: shape of the board estimated by a calibration.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Deserialize;
use serde_json::{Map, Value, json};

use super::json_file::read_json;
use super::read_text;
use crate::calibration::{BoardResult, Trial};
use crate::error::{Error, Result};
use crate::model::{Board, BoardShape, Parameter, SHAPE};
use crate::table::finite;

#[derive(Deserialize)]
struct ShapeSection {
    board: Board,
    shape: BoardShape,
    #[serde(default)]
    standard_deviations: BTreeMap<String, StdDev>,
}

#[derive(Deserialize)]
struct StdDev {
    value: f64,
}

/// Content of `truth/board.toml` of a simulation.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TrueBoard {
    sag_mm: [f64; 2],
    twist_mm: f64,
    aspect: f64,
}

/// Reads the true shape of a board: the `board.toml` of a simulation.
pub fn read_true_board(path: &Path) -> Result<BoardShape> {
    let text = read_text(path)?;
    let TrueBoard { sag_mm: [sag_x_mm, sag_y_mm], twist_mm, aspect } = toml::from_str(&text)
        .map_err(|e| Error::content(path, format!("not a valid true shape of a board: {e}")))?;
    let table = text.parse().map_err(|e: toml::de::Error| Error::content(path, e.to_string()))?;
    finite(&table).map_err(|e| e.in_file(path))?;
    Ok(BoardShape { sag_x_mm, sag_y_mm, twist_mm, aspect })
}

/// Returns board and shape as JSON, with σ of what was estimated, and limits (2 σ) of what was found to be 0.
#[must_use]
pub(super) fn board_shape_document(result: &BoardResult) -> Value {
    let by_name = |values: [Option<f64>; SHAPE]| -> Map<String, Value> {
        let of = |(parameter, value): (Parameter, Option<f64>)| {
            Some((
                parameter.name().to_owned(),
                json!({ "value": value?, "unit": parameter.unit() }),
            ))
        };
        Parameter::SHAPE.into_iter().zip(values).filter_map(of).collect()
    };
    let (outcome, reason, [bend, aspect]) = match &result.trial {
        Trial::NotTried => ("not-tried", None, [None; 2]),
        Trial::TooFewFrames => ("too-few-frames", None, [None; 2]),
        Trial::Failed(reason) => ("failed", Some(reason), [None; 2]),
        Trial::Tried { std_devs_from_zero, unsettled, .. } => {
            ("tried", unsettled.as_ref(), *std_devs_from_zero)
        }
    };
    json!({
        "board": result.bent.board,
        "shape": result.bent.shape,
        "standard_deviations": by_name(result.std_devs),
        "limits": by_name(result.limits()),
        "trial": {
            "outcome": outcome,
            "reason": reason,
            "bend_std_devs": bend,
            "aspect_std_devs": aspect,
            "iterations": result.aside.iterations,
            "time_s": result.aside.time_s,
        },
    })
}

/// Reads the shape of a board from a `calibration.json`, with its σ in the order of [`Parameter::SHAPE`], `None` for what was
/// not estimated. Returns `None` if the file is about another board ([`Board::is_same`]) or about none.
pub fn read_board_shape(
    path: &Path,
    board: &Board,
) -> Result<Option<(BoardShape, [Option<f64>; SHAPE])>> {
    let value = read_json(path)?;
    let Some(section) = value.get("board_shape") else { return Ok(None) };
    let section: ShapeSection = serde_json::from_value(section.clone())
        .map_err(|e| Error::content(path, format!("its board_shape is not valid: {e}")))?;
    let std_dev =
        |i: usize| Some(section.standard_deviations.get(Parameter::SHAPE[i].name())?.value);
    Ok(section.board.is_same(board).then(|| (section.shape, std::array::from_fn(std_dev))))
}
