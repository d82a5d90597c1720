//! The one error type of the crate.

use std::path::{Path, PathBuf};

/// What went wrong, naming the file or value.
///
/// Some remedies depend on how the library is called. Such errors have a variant of their own, to
/// which the command line adds the option that helps.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A file could not be opened or read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// A file could not be created, written or renamed.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The content of a file is wrong.
    #[error("{}: {error}", path.display())]
    InFile {
        /// The file.
        path: PathBuf,
        /// What is wrong in it.
        error: Box<Error>,
    },
    /// Values that contradict each other, or for which the model is not defined; with the remedy.
    #[error("{0}")]
    Invalid(String),
    /// A feature without a blur radius, where the cost needs one.
    #[error("{feature} has no blur radius")]
    NoBlurRadius {
        /// Description of the feature.
        feature: String,
    },
    /// A frame with too few board corners for a pose.
    #[error("frame {frame} shows {corners} board corner(s), but a pose needs at least {needed}")]
    TooFewCorners {
        /// Number of the frame.
        frame: u32,
        /// Number of its board corners.
        corners: usize,
        /// Smallest number that gives a pose.
        needed: usize,
    },
    /// A calibration without micro-image centres.
    #[error(
        "there are no micro-image centres: without them the position of the array is not determined"
    )]
    NoCenters,
    /// A part of the input that was not given.
    #[error("{} missing", missing.phrase())]
    Missing {
        /// Which part.
        missing: Input,
    },
    /// Only poses were requested, but the camera is given by its datasheet.
    #[error("poses alone need a calibrated camera, but this is a datasheet")]
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

/// Result of every fallible function of the crate.
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    pub(crate) fn content(path: &Path, message: impl Into<String>) -> Self {
        Self::Invalid(message.into()).in_file(path)
    }

    /// An error about values that contradict each other, or for which something is not defined.
    pub fn invalid(message: impl Into<String>) -> Self {
        Self::Invalid(message.into())
    }

    /// Adds the file whose content is wrong; errors that name a file already stay as they are.
    #[must_use]
    pub fn in_file(self, path: &Path) -> Self {
        match self {
            Self::Read { .. } | Self::Write { .. } | Self::InFile { .. } => self,
            other => Self::InFile { path: path.to_owned(), error: Box::new(other) },
        }
    }
}
