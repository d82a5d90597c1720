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
/// (docs/accuracy.md).
pub(crate) const BY_LINES: (f64, f64) = (0.06, 0.03);

/// Where the darkest places have less than this part of the light of the micro-images, the black level does not matter.
const HARMLESS: f64 = 0.01;
/// A stated black level is wrong if it is off by more than so many σ and so many grey levels. Stray light may make the
/// darkness brighter, by as much as does not matter.
const BLACK_STD_DEVS: f64 = 3.0;
const BLACK_SLACK: f64 = 0.5;
/// Powers this close to 1 are linear: on simulated cameras discs tell them to 0.01, with JPEG to 0.03, and with a point
/// spread as wide as half the narrowest blur to 0.06. At this limit q' has an error of up to 2 %.
pub(crate) const LINEAR: f64 = 0.08;
/// Where noise hides more, so many σ are linear.
const LINEAR_STD_DEVS: f64 = 3.0;

/// The darkest places of a white image, as parts of full scale.
pub(crate) struct Darkest {
    /// Their mean sample.
    pub level: f64,
    /// Its σ.
    pub std_dev: f64,
    /// The light of the micro-images above it.
    pub light: f64,
    /// Step from one sample to the next.
    pub grey_level: f64,
    /// No light reaches them. Else micro-images touch, and the black level is below.
    pub is_dark: bool,
}

/// A stated black level, grey levels of `full`, against the darkest places of an image.
pub(crate) fn black_level(
    stated: f64,
    full: f64,
    darkest: &Darkest,
    image: &str,
) -> Option<Finding> {
    let noise = BLACK_STD_DEVS * darkest.std_dev + BLACK_SLACK * darkest.grey_level;
    let above = darkest.level - stated / full;
    let brighter = darkest.is_dark && above > noise + HARMLESS * darkest.light;
    (above < -noise || brighter).then(|| {
        let (image, measured) = (image.to_owned(), darkest.level * full);
        Finding::caution(Issue::BlackLevelContradicted { stated, image, measured })
    })
}

/// A black level that is neither stated nor shows in any image, and would change them.
pub(crate) fn black_level_unknown<'d>(
    mut all: impl Iterator<Item = &'d Darkest>,
) -> Option<Finding> {
    let matters = |d: &Darkest| !d.is_dark && d.level >= HARMLESS * (d.level + d.light);
    all.all(matters).then(|| Finding::caution(Issue::BlackLevelUnknown))
}

/// Whether samples are linear in light, which is their power of 1 + `exponent`.
pub(crate) fn is_linear(exponent: f64, std_dev: f64) -> bool {
    exponent.abs() <= LINEAR.max(LINEAR_STD_DEVS * std_dev)
}

/// An angular response that white images do not show.
pub(crate) fn response_unknown() -> Finding {
    Finding::caution(Issue::ResponseUnknown)
}

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stray_light_contradicts_no_black_level_but_darker_places_do() {
        let grey_level = 1.0 / 255.0;
        let darkest = |is_dark| Darkest {
            level: 16.0 * grey_level,
            std_dev: 0.3 * grey_level,
            light: 0.8,
            grey_level,
            is_dark,
        };
        for (stated, in_the_dark, between_touching) in
            [(20.0, true, true), (16.5, false, false), (14.5, false, false), (8.0, true, false)]
        {
            let contradicts = |is_dark| {
                let darkest = darkest(is_dark);
                black_level(stated * grey_level, 1.0, &darkest, "").is_some()
            };
            assert_eq!(contradicts(true), in_the_dark, "{stated}");
            assert_eq!(contradicts(false), between_touching, "{stated}");
        }
    }
}
