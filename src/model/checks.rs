//! Checks that several values share.

use toml::{Table, Value};

use crate::error::{Error, Result};

/// What may be infinite in a file: a focus distance, the radius of a plane, and the full well of pixels without noise.
const MAY_BE_INFINITE: [&str; 3] = ["focus_distance_mm", "radius_mm", "full_well_electrons"];

/// An error naming the value unless it is positive and finite.
pub(crate) fn positive(value: f64, name: &str) -> Result<()> {
    if value.is_finite() && value > 0.0 {
        Ok(())
    } else {
        Err(Error::invalid(format!("{name} is {value}; it has to be positive and finite")))
    }
}

/// An error that names a value of a TOML file that is not a number, or is infinite and may not be: TOML can write both.
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
