//! Whether samples are linear in light.
//!
//! The light of a micro-image is the overlap of two discs, whose radii all f-numbers share. A gamma or
//! another tone curve raises its dim part: that is the light of no discs. So the discs are fitted with a
//! power of the samples that is free, to the first order ([`Discs::exponent`](super::discs::Discs)).
//! Where a strong gamma leaves no discs to begin with, the samples are raised to the power that undoes
//! the usual one, and then it is seen whether discs appear.

use tracing::debug;

use super::discs::Discs;
use super::measurement::measured;
use super::options::{PrecalibrationOptions, White};
use crate::checks::whites::{self as checks, LINEAR};
use crate::error::Error;

/// Where the power is looked for: what undoes the gamma of pictures, a weaker one, and the
/// opposite.
const STARTS: [f64; 3] = [2.2, 1.5, 0.5];
/// From each it is followed so many times.
const ROUNDS: usize = 3;
/// Discs that appear tell their power to 0.002 to 0.007. A power makes a wide point spread sharper too, and
/// discs of that tell theirs to 0.02 at best.
const CERTAIN: f64 = 0.01;

/// The power of the samples that light is, where that is not 1; 1 within what discs tell is `None`, and
/// so are discs too small to tell.
pub(super) fn power_of_discs(discs: &Discs) -> Option<f64> {
    discs
        .exponent
        .filter(|(exponent, std_dev)| !checks::is_linear(*exponent, *std_dev))
        .map(|(exponent, _)| 1.0 + exponent)
}

/// The power to which samples have to be raised for discs to appear in them; `None` if they appear with
/// none.
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
    // What was stated is of the samples as they are.
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

/// The error instead of another one that a gamma explains.
pub(super) fn explained(error: Error, power: Option<f64>) -> Error {
    power.map_or(error, |power| Error::invalid(checks::not_linear(power).to_string()))
}
