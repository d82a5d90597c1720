//! Numbers and units as they are shown to people.

/// The unit in which a parameter is shown, and the factor to it.
pub(crate) fn display_unit(name: &str, unit: &'static str) -> (&'static str, f64) {
    match name {
        "d" | "dC" | "m" => ("µm", 1e3),
        name if name.starts_with("f_") => ("µm", 1e3),
        name if name.starts_with("theta") => ("mrad", 1e3),
        _ => (unit, 1.0),
    }
}

/// A signed value with three significant digits.
pub(crate) fn signed(value: f64) -> String {
    match decade(value) {
        d if (-3..3).contains(&d) => {
            format!("{value:+.precision$}", precision = usize::try_from(2 - d).unwrap_or(0))
        }
        _ => format!("{value:+.2e}"),
    }
}

/// A value with two digits of its standard deviation; six significant digits without one.
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
            (format!("{value:.precision$}"), format!("{s:.precision$}"))
        }
        None if value == 0.0 => ("0".to_owned(), String::new()),
        None if decade(value) < -3 => (format!("{value:.5e}"), String::new()),
        None => (format!("{value:.precision$}", precision = digits(value, 6)), String::new()),
    }
}

/// Power of ten of the first digit.
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
    fn signed_values_have_three_digits() {
        assert_eq!(signed(6.7551), "+6.76");
        assert_eq!(signed(-0.036_46), "-0.0365");
        assert_eq!(signed(123.4), "+123");
        assert_eq!(signed(-5.17e-5), "-5.17e-5");
    }
}
