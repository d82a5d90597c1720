//! The verdict and its reasons in words.

use std::fmt;

use super::outliers::{Influence, OutlyingFrame};
use super::{Reason, Verdict};

/// Residuals of a frame that are as large as those of the others are not worth a word.
const LARGER: f64 = 1.25;
/// σ of what is hardly determined say nothing any more.
const MOST_STD_DEVS: f64 = 1e3;

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Good => "good",
            Self::UsableWithCare => "usable with care",
            Self::DoNotUse => "do not use",
        })
    }
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotConverged => f.write_str("it has not converged"),
            Self::Warning(warning) => warning.fmt(f),
            Self::Pulled { quantity, pull } => {
                write!(
                    f,
                    "the observations pull {quantity} by {pull:+.1} σ from what is known of it"
                )
            }
            Self::SlopeContradicts { error } => write!(
                f,
                "|m| of the white images is {:.1} % off that of the camera: F, d and distances may be as much off. Check the \
                 f-numbers (f_number), the size of a pixel (pixel_size_mm) and of the squares (square_mm)",
                100.0 * error.abs()
            ),
            Self::Scatter(ratio) => write!(
                f,
                "the features scatter by {ratio:.1} times what the detection says of them: edges are not what it takes them \
                 for (images that were moved, blurred, sharpened or otherwise processed, or resized: then pixel_size_mm is another; \
                 another f-number), or frames are not of one and the same camera at one focus"
            ),
            Self::Frame(frame) => frame.fmt(f),
            Self::Features { outlying, all } => write!(
                f,
                "{outlying} of {all} features lie far from where the camera projects them"
            ),
            Self::ImagePattern(part) => write!(
                f,
                "the residuals have a pattern over the image, {:.0} % of their size: the model lacks \
                 something, or the board is not flat",
                100.0 * part
            ),
            Self::MicroImagePattern(part) => write!(
                f,
                "the residuals change with the distance from the centre of the micro-image, by {:.0} % \
                 of their size: the corners are biased, as where boards are blurred, sharpened or taken at \
                 another f-number than the white images",
                100.0 * part
            ),
            Self::LensTypes(ratio) => {
                write!(f, "the residuals of one lens type are {ratio:.1} times those of another")
            }
            Self::FewFrames(frames) => write!(
                f,
                "with only {frames} frame(s), shared errors cannot be seen: σ takes all observations \
                 as independent"
            ),
            Self::FewTilts { tilted, frames } => write!(
                f,
                "only {tilted} of {frames} boards are tilted by more than 10 degrees: F and the distances \
                 are hardly told apart"
            ),
            Self::OneDistance { ratio } => write!(
                f,
                "all boards are at nearly the same distance (the largest is {ratio:.2} times the \
                 smallest)"
            ),
            Self::Coverage(part) => {
                write!(f, "boards cover {:.0} % of the image", 100.0 * part)
            }
            Self::DominantFrame { frame, parameter, share } => write!(
                f,
                "frame {frame} alone has {:.0} % of what is known of {parameter}",
                100.0 * share
            ),
            Self::Uncertain { parameter, relative } => {
                write!(f, "{parameter} is known to {:.1} % only", 100.0 * relative)
            }
        }
    }
}

impl fmt::Display for OutlyingFrame {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { frame, residual_ratio, influence } = self;
        write!(f, "frame {frame} does not fit the others: ")?;
        let larger = *residual_ratio > LARGER;
        if larger || influence.is_none() {
            write!(
                f,
                "its residuals are {residual_ratio:.1} times theirs, as if board or camera had moved"
            )?;
        }
        let Some(Influence { parameter, std_devs, unexpected }) = influence else { return Ok(()) };
        f.write_str(if larger { ", and " } else { "" })?;
        if *std_devs > MOST_STD_DEVS {
            write!(f, "without it {parameter} is another one altogether")
        } else {
            write!(
                f,
                "without it {parameter} moves by {std_devs:.1} σ, {unexpected:.0} times as much as the others let expect"
            )
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_described_by_what_is_remarkable_about_them() {
        let frame = |residual_ratio, influence: Option<f64>| {
            let influence =
                influence.map(|std_devs| Influence { parameter: "F", std_devs, unexpected: 6.2 });
            OutlyingFrame { frame: 4, residual_ratio, influence }.to_string()
        };
        let begins = "frame 4 does not fit the others: ";
        assert_eq!(
            frame(2.0, None),
            format!("{begins}its residuals are 2.0 times theirs, as if board or camera had moved")
        );
        let than = "6 times as much as the others let expect";
        assert_eq!(frame(0.7, Some(7.0)), format!("{begins}without it F moves by 7.0 σ, {than}"));
        assert_eq!(
            frame(3.0, Some(5.0)),
            format!(
                "{begins}its residuals are 3.0 times theirs, as if board or camera had moved, and without it F moves by 5.0 σ, {than}"
            )
        );
        assert_eq!(
            frame(1.0, Some(1e9)),
            format!("{begins}without it F is another one altogether")
        );
    }
}
