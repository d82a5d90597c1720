//! Checks of white images and of the array in them.

use crate::finding::{Finding, Issue};

/// A radius that is this part away from the radius of its f-number is the sign of another f-number: half a stop at f/4 changes
/// a radius by 10 %.
const APERTURE: f64 = 0.05;
/// Part of the micro-images that agrees with its lens type where nothing is wrong.
const AGREEMENT: f64 = 0.9;
/// Images with this part of their pixels full are over-exposed.
pub(crate) const MOSTLY_FULL: f64 = 0.85;
/// Arrays are this regular, root mean square in pitches: real ones that were measured to 0.012.
const IRREGULAR: f64 = 0.025;
/// A pitch along one direction equals the pitch across it within this part, where pixels are square: four real arrays were
/// measured to 0.6, 0.7, 1.5 and 3.5 in 10⁴.
const STRETCHED: f64 = 1e-3;
/// In a white image all but this part of the micro-images are about as bright as their neighbours.
const UNEVEN: f64 = 0.03;
/// How much narrower micro-images may be at the corners of the image, as a part of their width. Real lenses at their
/// full aperture have 0 to 0.01 without a second stop.
const NARROW: f64 = 0.02;
/// It counts where it is so many σ from none.
const SURE: f64 = 5.0;
/// How far off m and q' are by straight lines through the radii with f-numbers 2 % off at random, relative
/// (docs/precalibration.md).
pub(crate) const BY_LINES: (f64, f64) = (0.06, 0.03);

/// The radius of micro-images of type 1, and what it should be at the f-number of the image; `looks_like` is the f-number of
/// the radius.
pub(crate) fn aperture(
    f_number: f64,
    radius_px: f64,
    expected_px: f64,
    looks_like: f64,
) -> Option<Finding> {
    ((radius_px / expected_px - 1.0).abs() > APERTURE).then(|| {
        Finding::caution(Issue::ApertureContradicted {
            f_number,
            radius_px,
            expected_px,
            looks_like,
        })
    })
}

/// The part of the micro-images that has the size of its lens type.
pub(crate) fn lens_types(agreement: Option<f64>) -> Option<Finding> {
    let agreement = agreement.filter(|agreement| *agreement < AGREEMENT)?;
    Some(Finding::caution(Issue::LensTypesDisagree { agreement }))
}

/// By which part of their width micro-images at the corners are narrower towards the middle, with σ.
pub(crate) fn roundness((narrower, std_dev): (f64, f64)) -> Option<Finding> {
    (narrower > NARROW && narrower > SURE * std_dev)
        .then(|| Finding::caution(Issue::ObliquePupil { narrower }))
}

/// m and q' by straight lines, for want of discs.
pub(crate) fn no_discs() -> Finding {
    let (m_error, q_prime_error) = BY_LINES;
    Finding::caution(Issue::NoDiscs { m_error, q_prime_error })
}

/// Samples that are not linear in light, which is their power of `power`.
pub(crate) fn not_linear(power: f64) -> Finding {
    Finding::caution(Issue::NotLinear { power })
}

/// An image that is no white image, over-exposed, or not regular: the part of its micro-images that are not as bright as
/// their neighbours, the root mean square distance from the grid, how much longer the lattice is along one direction, and the
/// part of the pixels that are full.
pub(crate) fn array(
    uneven: f64,
    (rms_px, pitch_px): (f64, f64),
    stretch: Option<f64>,
    full: f64,
) -> Vec<Finding> {
    let not_white = (uneven > UNEVEN).then_some(Issue::NotWhite { uneven });
    let irregular =
        (rms_px > IRREGULAR * pitch_px).then_some(Issue::IrregularArray { rms_px, pitch_px });
    let stretched = stretch
        .filter(|stretch| *stretch > STRETCHED)
        .map(|stretch| Issue::StretchedArray { stretch });
    let over_exposed = (full > MOSTLY_FULL).then_some(Issue::OverExposed { full });
    let issues = [not_white, irregular, stretched, over_exposed];
    issues.into_iter().flatten().map(Finding::caution).collect()
}
