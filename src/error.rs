//! Error type of the crate.

use std::path::{Path, PathBuf};

/// Error that names the file or value.
///
/// Some remedies depend on how the library is called. Such errors have a variant of their own, to which the command line adds
/// the helpful option.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A file could not be opened or read.
    #[error("cannot read {}: {}", path.display(), reason(source))]
    Read {
        /// Path of the file.
        path: PathBuf,
        /// Reason from the system.
        source: std::io::Error,
    },
    /// A file could not be created, written or renamed.
    #[error("cannot write {}: {}", path.display(), reason(source))]
    Write {
        /// Path of the file.
        path: PathBuf,
        /// Reason from the system.
        source: std::io::Error,
    },
    /// The content of a file is wrong.
    #[error("{}: {error}", path.display())]
    InFile {
        /// Path of the file.
        path: PathBuf,
        /// Error in its content.
        error: Box<Error>,
    },
    /// Values that contradict each other, or for which the model is not defined; with the remedy.
    #[error("{}", legible(.0))]
    Invalid(String),
    /// An observation that is impossible, alone or together with the others.
    #[error("{}", legible(message))]
    Observation {
        /// The observation, to find its line.
        observation: Observed,
        /// Description of the error.
        message: String,
    },
    /// A feature without the blur radius that the cost needs.
    #[error("{feature} has no blur radius")]
    NoBlurRadius {
        /// Description of the feature.
        feature: String,
    },
    /// A frame with too few board corners for a pose.
    #[error("a pose needs at least {needed} board corners, but frame {frame} shows {corners}")]
    TooFewCorners {
        /// Number of the frame.
        frame: u32,
        /// Number of its board corners.
        corners: usize,
        /// Smallest number that a pose needs.
        needed: usize,
    },
    /// A calibration without micro-image centres.
    #[error(
        "there are no micro-image centres, which are needed to determine the position of the array"
    )]
    NoCenters,
    /// A part of the input that was not given.
    #[error("{} missing", missing.phrase())]
    Missing {
        /// The missing part.
        missing: Input,
    },
    /// Only poses were requested, but the camera is given by its datasheet.
    #[error("poses alone need a calibrated camera, but the input is a datasheet")]
    NotCalibrated,
}

/// A part of the input of a calibration.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Input {
    /// The camera: a datasheet, or one calibrated before.
    Camera,
    /// Internal parameters from white images.
    InternalParameters,
    /// The board.
    Board,
    /// BAP features.
    Features,
}

impl Input {
    fn phrase(self) -> &'static str {
        match self {
            Self::Camera => "a camera is",
            Self::InternalParameters => "the internal parameters (m and q') are",
            Self::Board => "a board is",
            Self::Features => "features are",
        }
    }
}

/// Identity of an observation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Observed {
    /// The centre of micro-image (k, l).
    Center {
        /// Index along u.
        k: i32,
        /// Index along v.
        l: i32,
    },
    /// A board corner in micro-image (k, l) of a frame.
    Feature {
        /// Number of the frame.
        frame: u32,
        /// Number of the corner.
        corner: i32,
        /// Index along u.
        k: i32,
        /// Index along v.
        l: i32,
    },
}

/// Returns the reason of a system error in words, without its number.
fn reason(source: &std::io::Error) -> String {
    let text = source.to_string();
    match text.rfind(" (os error ") {
        Some(end) => text[..end].to_owned(),
        None => text,
    }
}

/// Largest number of digits that is legible.
const MOST_DIGITS: usize = 24;

/// Writes numbers of very many digits with an exponent: 1e308 rather than a 1 with 308 zeros.
fn legible(text: &str) -> String {
    let is_part = |c: char| c.is_ascii_digit() || c == '.';
    let mut legible = String::new();
    let mut rest = text;
    while let Some(begin) = rest.find(|c: char| c.is_ascii_digit()) {
        let (before, from) = rest.split_at(begin);
        let (number, after) = from.split_at(from.find(|c| !is_part(c)).unwrap_or(from.len()));
        legible.push_str(before);
        let short = number.parse::<f64>().ok().filter(|_| number.len() > MOST_DIGITS);
        legible += &short.map_or_else(|| number.to_owned(), |value| format!("{value:e}"));
        rest = after;
    }
    legible + rest
}

/// Result of every fallible function of the crate.
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    pub(crate) fn content(path: &Path, message: impl Into<String>) -> Self {
        Self::Invalid(message.into()).in_file(path)
    }

    /// Creates an error for values that contradict each other, or for which something is not defined.
    pub fn invalid(message: impl Into<String>) -> Self {
        Self::Invalid(message.into())
    }

    /// Adds the file whose content is wrong. Errors that name a file are returned unchanged.
    #[must_use]
    pub fn in_file(self, path: &Path) -> Self {
        match self {
            Self::Read { .. } | Self::Write { .. } | Self::InFile { .. } => self,
            other => Self::InFile { path: path.to_owned(), error: Box::new(other) },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn very_long_numbers_are_written_with_an_exponent() {
        let text =
            |value: f64| Error::invalid(format!("it is {value}, not 1.5.2 or 12.5")).to_string();
        assert_eq!(text(-1e308), "it is -1e308, not 1.5.2 or 12.5");
        assert_eq!(text(5e-324), "it is 5e-324, not 1.5.2 or 12.5");
        assert_eq!(text(0.125), "it is 0.125, not 1.5.2 or 12.5");
    }
}
