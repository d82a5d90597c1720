//! Measured values with their standard deviations, and the format of numbers and units.

use std::fmt;

use serde::{Deserialize, Serialize};

/// Measured value with its standard deviation.
///
/// It is displayed with two significant digits of σ, as in `54.74 ± 0.11` (GUM, 7.2.6).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Estimate {
    /// The value.
    #[serde(alias = "variance_px2")] // of a point spread, in earlier files
    pub value: f64,
    /// Standard deviation σ, in the same unit; 0 for a given value.
    #[serde(alias = "std_dev_px2")]
    pub std_dev: f64,
}

impl Estimate {
    /// Creates an estimate with a standard deviation.
    #[must_use]
    pub const fn new(value: f64, std_dev: f64) -> Self {
        Self { value, std_dev }
    }

    /// Creates an estimate of a given value, with σ = 0.
    #[must_use]
    pub const fn exact(value: f64) -> Self {
        Self { value, std_dev: 0.0 }
    }

    /// Converts the estimate to another unit, `factor` of which make one of this.
    #[must_use]
    pub fn scaled(&self, factor: f64) -> Self {
        Self { value: self.value * factor, std_dev: self.std_dev * factor.abs() }
    }

    /// Returns the square root, for example of a variance: 0 for a negative value. Its σ follows from the root of value + σ,
    /// which stays finite at 0.
    #[must_use]
    pub fn square_root(&self) -> Self {
        let variance = self.value.max(0.0);
        let value = variance.sqrt();
        Self { value, std_dev: (variance + self.std_dev).sqrt() - value }
    }

    /// Returns the difference from an independent estimate, in standard deviations of this difference.
    #[must_use]
    pub fn std_devs_from(&self, other: &Self) -> f64 {
        (self.value - other.value) / self.std_dev.hypot(other.std_dev)
    }

    /// Formats value and σ, with two significant digits of σ; the text of σ is empty if it is 0.
    #[must_use]
    pub fn text(&self) -> (String, String) {
        with_std_dev(self.value, Some(self.std_dev))
    }
}

impl fmt::Display for Estimate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (value, std_dev) = self.text();
        if std_dev.is_empty() { f.write_str(&value) } else { write!(f, "{value} ± {std_dev}") }
    }
}

/// Formats a number of things: `1 frame`, `3 frames`.
#[must_use]
pub fn counted(number: usize, noun: &str) -> String {
    let ending = if number == 1 { "" } else { "s" };
    format!("{number} {noun}{ending}")
}

/// Returns the display unit of a parameter, and the factor to it.
pub(crate) fn display_unit(name: &str, unit: &'static str) -> (&'static str, f64) {
    match name {
        "d" | "dC" | "m" => ("µm", 1e3),
        name if name.starts_with("f_") => ("µm", 1e3),
        name if name.starts_with("theta") => ("mrad", 1e3),
        _ => (unit, 1.0),
    }
}

/// Formats a number with so many decimals. A value that rounds to 0 has no sign.
#[must_use]
pub fn fixed(value: f64, decimals: usize) -> String {
    plain_zero(format!("{value:.decimals$}"))
}

/// Formats a number with so many decimals, with the sign of positive values too.
pub(crate) fn fixed_signed(value: f64, decimals: usize) -> String {
    plain_zero(format!("{value:+.decimals$}"))
}

/// Formats a number with so many significant digits. It has a power of ten below 0.001, or if it is too large for these digits
/// and two more.
#[must_use]
pub fn significant(value: f64, digits: usize) -> String {
    let most = i32::try_from(digits.max(1)).unwrap_or(i32::MAX - 2);
    match decade(value) {
        decade if (-3..most + 2).contains(&decade) => {
            fixed(value, usize::try_from(most - 1 - decade).unwrap_or(0))
        }
        _ => format!("{value:.precision$e}", precision = digits.max(1) - 1),
    }
}

/// Formats a signed value with three significant digits.
pub(crate) fn signed(value: f64) -> String {
    let text = significant(value, 3);
    if value > 0.0 { format!("+{text}") } else { text }
}

/// Removes the sign from the text of a number that is 0.
fn plain_zero(text: String) -> String {
    let is_zero = text.contains('0') && !text.contains(|c| ('1'..='9').contains(&c));
    if is_zero { text.trim_start_matches(['-', '+']).to_owned() } else { text }
}

/// Formats a positive value with two significant digits; returns `-` for any other.
pub(crate) fn two_digits(value: f64) -> String {
    if !(value > 0.0 && value.is_finite()) {
        return "-".to_owned();
    }
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a few digits
    let digits = (1.0 - value.log10().floor()).clamp(0.0, 9.0) as usize;
    format!("{value:.digits$}")
}

/// Formats a value with two digits of its standard deviation, or with six significant digits without one.
pub(crate) fn with_std_dev(value: f64, std_dev: Option<f64>) -> (String, String) {
    let digits = |reference: f64, significant: i32| {
        usize::try_from(significant - 1 - decade(reference)).unwrap_or(0)
    };
    match std_dev.filter(|s| *s > 0.0 && s.is_finite()) {
        Some(s) if decade(s) < -6 => {
            let precision = usize::try_from(decade(value) - decade(s) + 1).unwrap_or(0).min(16);
            (format!("{value:.precision$e}"), format!("{s:.1e}"))
        }
        Some(s) => {
            let precision = digits(s, 2);
            (fixed(value, precision), fixed(s, precision))
        }
        None if value == 0.0 => ("0".to_owned(), String::new()),
        None if decade(value) < -3 => (format!("{value:.5e}"), String::new()),
        None => (fixed(value, digits(value, 6)), String::new()),
    }
}

/// Returns the power of ten of the first digit.
#[allow(clippy::cast_possible_truncation)]
fn decade(value: f64) -> i32 {
    if value == 0.0 { 0 } else { value.abs().log10().floor() as i32 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_carry_two_digits_of_their_uncertainty() {
        let text = |value, std_dev| with_std_dev(value, std_dev);
        assert_eq!(text(54.741_46, Some(0.108)), ("54.74".into(), "0.11".into()));
        assert_eq!(text(2559.25, Some(19.3)), ("2559".into(), "19".into()));
        assert_eq!(text(-0.000_281_004, Some(9.6e-6)), ("-0.0002810".into(), "0.0000096".into()));
        assert_eq!(text(-3.3352e-8, Some(6.9e-8)), ("-3.3e-8".into(), "6.9e-8".into()));
        assert_eq!(text(0.0, None), ("0".into(), String::new()));
        assert_eq!(text(318.632_4, None), ("318.632".into(), String::new()));
    }

    #[test]
    fn zeros_have_no_sign() {
        assert_eq!(fixed(-0.000_04, 3), "0.000");
        assert_eq!(fixed(-0.0, 0), "0");
        assert_eq!(fixed(-0.04, 2), "-0.04");
        assert_eq!(fixed_signed(-0.000_04, 3), "0.000");
        assert_eq!(fixed_signed(0.04, 2), "+0.04");
        assert_eq!(with_std_dev(-1e-5, Some(0.1)).0, "0.00");
    }

    #[test]
    fn powers_of_ten_are_for_what_is_very_small_or_large() {
        assert_eq!(significant(7.9, 2), "7.9");
        assert_eq!(significant(44.576, 4), "44.58");
        assert_eq!(significant(0.001_234, 2), "0.0012");
        assert_eq!(significant(1.234e-5, 2), "1.2e-5");
        assert_eq!(significant(43210.0, 2), "4.3e4");
        assert_eq!(significant(4321.0, 2), "4321");
        assert_eq!(significant(0.0, 2), "0.0");
        assert_eq!(significant(-0.0, 3), "0.00");
    }

    #[test]
    fn signed_values_have_three_digits() {
        assert_eq!(signed(6.7551), "+6.76");
        assert_eq!(signed(-0.036_46), "-0.0365");
        assert_eq!(signed(123.4), "+123");
        assert_eq!(signed(-5.17e-5), "-5.17e-5");
    }
}
