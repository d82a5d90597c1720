//! The verdict and its reasons in words.

use std::fmt;

use super::outliers::{Influence, OutlyingFrame};
use super::{Reason, Verdict};

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
                 for (moved or processed images, another f-number), or frames are not of one and the same camera"
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
                 of their size: the corners are biased",
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
        write!(
            f,
            "frame {frame} does not fit the others: its residuals are {residual_ratio:.1} times theirs"
        )?;
        match influence {
            Some(Influence { parameter, std_devs }) => {
                write!(f, ", and without it {parameter} moves by {std_devs:.1} σ")
            }
            None => Ok(()),
        }
    }
}
