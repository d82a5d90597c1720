//! What has to come of a damaged file: values that are finite, or an error that names it.

use std::fs;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::time::{Duration, Instant};

use super::readers::Target;

/// Longest time for one file.
pub const PATIENCE: Duration = Duration::from_secs(10);
/// Quantities that may be infinite.
const MAY_BE_INFINITE: [&str; 2] = ["focus_distance_mm: ", "radius_mm: "];
/// More digits in a row are no number that a person reads.
const DIGITS: usize = 40;

/// Reads damaged bytes with a target. An error says what is wrong with what came of it; `true` if the bytes were
/// accepted.
pub fn judge(target: &Target, path: &Path, bytes: &[u8]) -> Result<bool, String> {
    fs::write(path, bytes).map_err(|e| format!("the case cannot be written: {e}"))?;
    let begun = Instant::now();
    let outcome = catch_unwind(AssertUnwindSafe(|| (target.read)(path)));
    let time = begun.elapsed();
    if time > PATIENCE {
        return Err(format!("it took {:.1} s", time.as_secs_f64()));
    }
    match outcome {
        Err(panic) => Err(format!("panic: {}", panic_text(panic.as_ref()))),
        Ok(Ok(text)) => match not_finite(&text) {
            Some(found) => Err(format!("not a finite number was accepted: {found}")),
            None => Ok(true),
        },
        Ok(Err(error)) => judge_message(&error.to_string(), path, bytes).map(|()| false),
    }
}

fn panic_text(panic: &(dyn std::any::Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().cloned();
    let text = text.or_else(|| panic.downcast_ref::<&str>().map(|text| (*text).to_owned()));
    text.unwrap_or_else(|| "of an unknown kind".to_owned())
}

fn judge_message(message: &str, path: &Path, bytes: &[u8]) -> Result<(), String> {
    if !message.contains(&path.display().to_string()) {
        return Err(format!("the error does not name the file: {message}"));
    }
    // Digits of the file itself may be quoted.
    let digits = longest_digits(message.as_bytes());
    if digits > DIGITS && digits > longest_digits(bytes) {
        return Err(format!("{digits} digits in a row: {message}"));
    }
    Ok(())
}

fn longest_digits(bytes: &[u8]) -> usize {
    bytes.split(|byte| !byte.is_ascii_digit()).map(<[u8]>::len).max().unwrap_or(0)
}

/// The first number in a debug output that is not finite and may not be.
pub fn not_finite(text: &str) -> Option<String> {
    const BEFORE: usize = 60;
    for (word, may_be) in [("NaN", false), ("inf", true)] {
        for (at, _) in text.match_indices(word) {
            let (before, after) = (&text[..at], &text[at + word.len()..]);
            let alone = !before.ends_with(|c: char| c.is_alphanumeric() || c == '_')
                && !after.starts_with(|c: char| c.is_alphanumeric() || c == '_');
            // Texts, such as paths, are quoted.
            let quoted = before.matches('"').count() % 2 == 1;
            let before = before.trim_end_matches('-');
            let allowed = may_be && MAY_BE_INFINITE.iter().any(|name| before.ends_with(name));
            if alone && !quoted && !allowed {
                let from = before.char_indices().rev().nth(BEFORE).map_or(0, |(i, _)| i);
                return Some(format!("{}{word}", &before[from..]));
            }
        }
    }
    None
}
