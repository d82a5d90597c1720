//! Tables of TOML: replacement of values, and the check that numbers are finite.

use toml::{Table, Value};

use crate::error::{Error, Result};

/// Values that may be infinite in a file: a focus distance, the radius of a plane, and the full well of pixels without noise.
const MAY_BE_INFINITE: [&str; 3] = ["focus_distance_mm", "radius_mm", "full_well_electrons"];

/// Replaces a value, as in `imaging.bits=16`; a value that is not TOML is text.
///
/// Returns an error if the text has another form, or names a value inside another that is not a table.
pub(crate) fn replace(table: &mut Table, pair: &str) -> Result<()> {
    let (key, text) = pair.split_once('=').ok_or_else(|| {
        Error::invalid(format!(
            "'{pair}' is not a setting: write KEY=VALUE with the tables of the key, as in \
             imaging.bits=16"
        ))
    })?;
    let text = text.trim();
    if text.contains('\n') {
        return Err(Error::invalid(format!("the value of '{key}' has more than one line")));
    }
    let value = format!("value = {text}")
        .parse::<Table>()
        .ok()
        .and_then(|mut parsed| parsed.remove("value"))
        .unwrap_or_else(|| Value::String(text.to_owned()));
    let mut path: Vec<&str> = key.split('.').map(str::trim).collect();
    let last = path.pop().unwrap_or_default();
    let mut inner = table;
    for part in path {
        inner = inner
            .entry(part)
            .or_insert_with(|| Value::Table(Table::new()))
            .as_table_mut()
            .ok_or_else(|| Error::invalid(format!("'{key}': {part} is not a table of settings")))?;
    }
    inner.insert(last.to_owned(), value);
    Ok(())
}

/// Replaces values of a table by the values of another; tables inside are merged.
pub(crate) fn merge(table: &mut Table, over: Table) {
    for (key, value) in over {
        match (table.get_mut(&key), value) {
            (Some(Value::Table(inner)), Value::Table(over)) => merge(inner, over),
            (_, value) => {
                table.insert(key, value);
            }
        }
    }
}

/// Returns an error that names a value that is not a number, or is infinite and may not be: TOML can express both.
pub(crate) fn finite(table: &Table) -> Result<()> {
    table.iter().try_for_each(|(key, value)| finite_value(key, value))
}

fn finite_value(key: &str, value: &Value) -> Result<()> {
    match value {
        Value::Float(x) if x.is_nan() || (x.is_infinite() && !MAY_BE_INFINITE.contains(&key)) => {
            Err(Error::invalid(format!("{key} is {x}: give a finite number")))
        }
        Value::Array(items) => items.iter().try_for_each(|item| finite_value(key, item)),
        Value::Table(inner) => {
            finite(inner).map_err(|error| Error::invalid(format!("in [{key}]: {error}")))
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_toml_are_finite() {
        let check = |text: &str| finite(&text.parse().unwrap()).map_err(|e| e.to_string());
        assert_eq!(check("a = 1.5\nfocus_distance_mm = inf\n[b]\nradius_mm = -inf"), Ok(()));
        assert_eq!(check("[imaging]\nfull_well_electrons = inf"), Ok(()));
        let refused = check("[b.c]\nd = [1.0, nan]").unwrap_err();
        assert_eq!(refused, "in [b]: in [c]: d is NaN: give a finite number");
        assert!(check("a = inf").is_err() && check("focus_distance_mm = nan").is_err());
    }
}
