//! Checks shared by several values.

use crate::error::{Error, Result};

/// Returns an error that names the value unless it is positive and finite.
pub(crate) fn positive(value: f64, name: &str) -> Result<()> {
    if value.is_finite() && value > 0.0 {
        Ok(())
    } else {
        Err(Error::invalid(format!("{name} is {value}, but has to be positive and finite")))
    }
}
