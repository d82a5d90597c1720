//! `board_shape` of `calibration.json`: the board as the calibration has found it.

use std::path::Path;

use serde::Deserialize;
use serde_json::{Map, Value, json};

use super::read_text;
use crate::calibration::BoardResult;
use crate::error::{Error, Result};
use crate::model::{Board, BoardShape, SHAPE, SHAPE_PARAMETERS};

#[derive(Deserialize)]
struct ShapeSection {
    board: Board,
    shape: BoardShape,
}

/// Board and shape as JSON, with σ of what was estimated, and limits (2 σ) of what was found to be 0.
#[must_use]
pub(super) fn board_shape_document(result: &BoardResult) -> Value {
    let by_name = |values: [Option<f64>; SHAPE]| -> Map<String, Value> {
        let of = |(parameter, value): (&crate::model::Parameter<BoardShape>, Option<f64>)| {
            Some((parameter.name.to_owned(), json!({ "value": value?, "unit": parameter.unit })))
        };
        SHAPE_PARAMETERS.iter().zip(values).filter_map(of).collect()
    };
    json!({
        "board": result.bent.board,
        "shape": result.bent.shape,
        "standard_deviations": by_name(result.std_devs),
        "limits": by_name(result.limits()),
    })
}

/// Reads the shape of a board from a `calibration.json`; `None` if it is of another board, or of none.
pub fn read_board_shape(path: &Path, board: &Board) -> Result<Option<BoardShape>> {
    let value: Value = serde_json::from_str(&read_text(path)?)
        .map_err(|e| Error::content(path, format!("this is not valid JSON: {e}")))?;
    let Some(section) = value.get("board_shape") else { return Ok(None) };
    let section: ShapeSection = serde_json::from_value(section.clone())
        .map_err(|e| Error::content(path, format!("its board_shape is not valid: {e}")))?;
    Ok((section.board == *board).then_some(section.shape))
}
