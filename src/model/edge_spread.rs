//! Aperture ratio and point spread, which change blur and edges with respect to ideal micro-lenses and pixels. The projection
//! of points does not depend on either; depth from blur does.

use super::opening::Opening;
use crate::error::{Error, Result};
use crate::quantity::Estimate;

/// Blur of a camera in addition to its geometry.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct EdgeSpread {
    /// Aperture ratio φ: width of a lenslet over pitch. The rest of the pitch is opaque, so that blur and micro-images are
    /// smaller. `None` if it is not known.
    pub aperture_ratio: Option<Estimate>,
    /// Shape of the aperture of a lenslet.
    pub opening: Opening,
    /// Point spread s²: the variance, along an axis, px², of the blur of a point by diffraction, aberrations, and light and
    /// charge that leave their pixel; modelled as normal, isotropic and uniform. `None` if it is not known.
    pub point_spread_px2: Option<Estimate>,
}

/// Relative σ of the aperture ratio due to the model of a blurred corner: the least σ of an estimate from corners.
pub(crate) const APERTURE_RATIO_MODEL: f64 = 3e-3;
/// Range of possible aperture ratios.
const APERTURE_RATIOS: std::ops::RangeInclusive<f64> = 0.01..=1.3;
/// Largest point spread, px²: a larger one hides all micro-images.
const MOST_PX2: f64 = 100.0;

impl EdgeSpread {
    /// Returns the standard deviation of blurred light along an axis over the blur radius ρ of full apertures: φ/2 for discs,
    /// whose standard deviation is half the radius.
    #[must_use]
    pub fn spread_per_radius(&self) -> Option<Estimate> {
        self.aperture_ratio.map(|ratio| ratio.scaled(self.opening.std_dev()))
    }

    /// Checks both values; an error names an impossible one.
    pub(crate) fn validate(&self) -> Result<()> {
        self.aperture_ratio.as_ref().map_or(Ok(()), check_aperture_ratio)?;
        self.point_spread_px2.as_ref().map_or(Ok(()), check_point_spread)
    }
}

/// Limits an estimate of the aperture ratio to 1: apertures end at their neighbours.
#[must_use]
pub fn at_most_full(aperture_ratio: &Estimate) -> Estimate {
    Estimate { value: aperture_ratio.value.min(1.0), ..*aperture_ratio }
}

/// Checks an aperture ratio.
pub(crate) fn check_aperture_ratio(ratio: &Estimate) -> Result<()> {
    if !APERTURE_RATIOS.contains(&ratio.value) {
        return Err(Error::invalid(format!(
            "an aperture ratio of {} is not possible: give a value from {} to {}",
            ratio.value,
            APERTURE_RATIOS.start(),
            APERTURE_RATIOS.end()
        )));
    }
    check_std_dev("aperture ratio", ratio)
}

/// Checks a point spread, px².
pub(crate) fn check_point_spread(spread_px2: &Estimate) -> Result<()> {
    if !(0.0..=MOST_PX2).contains(&spread_px2.value) {
        return Err(Error::invalid(format!(
            "the variance of the point spread is {} px², but has to be from 0 to {MOST_PX2}",
            spread_px2.value
        )));
    }
    check_std_dev("point spread", spread_px2)
}

fn check_std_dev(name: &str, estimate: &Estimate) -> Result<()> {
    if estimate.std_dev.is_finite() && estimate.std_dev >= 0.0 {
        return Ok(());
    }
    Err(Error::invalid(format!(
        "the standard deviation of the {name} is {}, but has to be 0 or more",
        estimate.std_dev
    )))
}
