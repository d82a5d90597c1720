//! Check whether samples are linear in light.
//!
//! The light of a micro-image is the overlap of two discs, whose radii all f-numbers share. A gamma or another tone
//! curve raises its dim part, and no discs give such light. So the discs are fitted with a free power of the samples,
//! to first order ([`Discs::exponent`](super::discs::Discs)). A strong gamma may leave no discs to begin with. Then the
//! samples are raised to the power that undoes the usual gamma, to see whether discs appear.

use tracing::debug;

use super::discs::Discs;
use super::measurement::measured;
use super::options::{PrecalibrationOptions, White};
use crate::checks::whites::{self as checks, LINEAR};
use crate::error::Error;

/// Powers at which the search starts: one that undoes the gamma of pictures, a weaker one, and the opposite.
const STARTS: [f64; 3] = [2.2, 1.5, 0.5];
/// Rounds of the search from each start.
const ROUNDS: usize = 3;
/// Largest σ of a power that counts. Discs that appear determine their power to 0.002 to 0.007. A power also makes a
/// wide point spread sharper; its discs determine theirs to 0.02 at best.
const CERTAIN: f64 = 0.01;

/// Returns the power of the samples to which light is proportional. Returns `None` if it is 1 within its tolerance, or
/// if the discs are too small to show it.
pub(super) fn power_of_discs(discs: &Discs) -> Option<f64> {
    discs
        .exponent
        .filter(|(exponent, std_dev)| !checks::is_linear(*exponent, *std_dev))
        .map(|(exponent, _)| 1.0 + exponent)
}

/// Finds the power of the samples with which discs appear; `None` if they appear with none.
pub(super) fn power_for_discs(
    whites: &[White],
    reference: &White,
    options: &PrecalibrationOptions,
) -> Option<f64> {
    STARTS.into_iter().find_map(|start| power_from(start, whites, reference, options))
}

fn power_from(
    start: f64,
    whites: &[White],
    reference: &White,
    options: &PrecalibrationOptions,
) -> Option<f64> {
    // A stated black level is one of the unchanged samples.
    let options = PrecalibrationOptions { black_level: None, ..*options };
    let mut power = start;
    for _ in 0..ROUNDS {
        let raised =
            |white: &White| White { image: white.image.to_the_power(power), ..white.clone() };
        let all: Vec<White> = whites.iter().map(raised).collect();
        let (_, discs) = measured(&all, &raised(reference), &options, &|| ()).ok()?;
        let (exponent, std_dev) = discs?.exponent?;
        debug!("samples to the power of {power:.3}: another {:.3} ± {std_dev:.3}", 1.0 + exponent);
        if std_dev > CERTAIN {
            return None;
        }
        if exponent.abs() < LINEAR {
            return ((power - 1.0).abs() > LINEAR).then_some(power * (1.0 + exponent));
        }
        power *= 1.0 + exponent;
    }
    None
}

/// Returns an error about the gamma if there is one, otherwise the given error.
pub(super) fn explained(error: Error, power: Option<f64>) -> Error {
    power.map_or(error, |power| Error::invalid(checks::not_linear(power).to_string()))
}
