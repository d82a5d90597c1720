//! Pre-calibration as one stage: from white images to the array and the internal parameters.

use super::array_checks::array_findings;
use super::checks::reference_of;
use super::linearity::{explained, power_for_discs, power_of_discs};
use super::measurement::measured;
use super::options::{PrecalibrationOptions, White};
use super::result::Precalibration;
use crate::checks::whites::not_linear;
use crate::error::Result;
use crate::model::positive;

/// Measures the array and the internal parameters.
///
/// The array is measured in `reference`, the white image that belongs to the boards, or else in the white image with
/// the smallest f-number. `progress` is called after every image.
///
/// Returns an error if images do not belong together, show no array, do not span a range of f-numbers, or contradict
/// the stated camera.
pub fn precalibrate(
    whites: &[White],
    reference: Option<&White>,
    options: &PrecalibrationOptions,
    progress: &(dyn Fn() + Sync),
) -> Result<Precalibration> {
    let _span = tracing::info_span!("pre-calibration").entered();
    positive(options.pixel_size_mm, "the pixel size (mm)")?;
    let reference = reference_of(whites, reference, options.stated.as_ref())?;
    let of_strong_gamma = || power_for_discs(whites, reference, options);
    let (mut result, discs) = measured(whites, reference, options, progress)
        .map_err(|error| explained(error, of_strong_gamma()))?;
    let power = discs.as_ref().map_or_else(of_strong_gamma, power_of_discs);
    if let Some(sheet) = &options.stated {
        result.check_stated(sheet).map_err(|error| explained(error, power))?;
    }
    let of_array = array_findings(&result.array, &reference.image).into_iter();
    result.findings.extend(of_array.map(|finding| finding.about_image(&reference.name)));
    if let Some(power) = power {
        // It comes first, since it may cause the others.
        result.findings.insert(0, not_linear(power));
    }
    result.log();
    Ok(result)
}
