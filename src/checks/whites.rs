//! Checks of white images and of the array in them.

use crate::finding::{Finding, Issue};
use crate::model::{LatticeKind, Opening};
use crate::quantity::Estimate;

/// Smallest relative difference of a radius from the radius of its f-number that shows another f-number. Half a stop at f/4
/// changes a radius by 10 %.
const APERTURE: f64 = 0.05;
/// Excess of the radius of micro-images over half the pitch, relative, up to which they touch and do not overlap.
pub(crate) const TOUCHING: f64 = 0.02;
/// Smallest part of the micro-images that agrees with its lens type if nothing is wrong.
const AGREEMENT: f64 = 0.9;
/// Part of saturated pixels above which an image is over-exposed.
pub(crate) const MOSTLY_FULL: f64 = 0.85;
/// Largest RMS irregularity of an array, in pitches; real arrays have up to 0.012.
const IRREGULAR: f64 = 0.025;
/// Largest relative difference of the pitch along two directions, if pixels are square; four real arrays have 0.6, 0.7, 1.5 and
/// 3.5 in 10⁴.
const STRETCHED: f64 = 1e-3;
/// Largest error of the places of micro-lenses in real arrays, RMS in pitches. The places may also be stretched as a whole by
/// this much: a microscope's array of 28 x 28 behind square pixels is stretched by 0.0015, which moves its centres by 0.008.
const PLACED: f64 = 0.012;
/// Largest part of the micro-images of an array that may be left out: dust and scratches take less.
const LEFT_OUT: f64 = 0.01;
/// Largest part of the micro-images of a white image that are not about as bright as their neighbours.
const UNEVEN: f64 = 0.03;
/// Largest relative decrease of the width of micro-images at the corners of the image. Real lenses at their full aperture have
/// 0 to 0.01 without a second stop.
const NARROW: f64 = 0.02;
/// Largest distance of the cell share from 0.5 that belongs to neither shape. Clipped samples raise the share of cells to 1.3.
const BETWEEN: f64 = 0.25;
/// Smallest difference of the cell share that counts, in σ.
const SHARE_STD_DEVS: f64 = 3.0;
/// Smallest decrease that counts, in σ.
const SURE: f64 = 5.0;
/// Relative errors of m and q' from straight lines through the radii, if f-numbers are 2 % off at random (docs/accuracy.md).
pub(crate) const BY_LINES: (f64, f64) = (0.06, 0.03);

/// Light of the darkest points, as a part of the light of the micro-images, below which the black level does not matter.
const HARMLESS: f64 = 0.01;
/// Difference of a stated black level, in σ and in grey levels, above which it is wrong. Stray light may brighten the darkest
/// points by up to `HARMLESS`.
const BLACK_STD_DEVS: f64 = 3.0;
const BLACK_SLACK: f64 = 0.5;
/// Largest deviation from 1 of the power of linear samples. On simulated cameras discs give it to 0.01, with JPEG to 0.03, and
/// with a point spread as wide as half the narrowest blur to 0.06. At this limit q' has an error of up to 2 %.
pub(crate) const LINEAR: f64 = 0.08;
/// Largest deviation of the power from 1, in σ, if noise makes it uncertain.
const LINEAR_STD_DEVS: f64 = 3.0;

/// Darkest points of a white image, as parts of full scale.
pub(crate) struct Darkest {
    /// Mean sample.
    pub level: f64,
    /// Standard deviation of the mean sample.
    pub std_dev: f64,
    /// Light of the micro-images above this sample.
    pub light: f64,
    /// Step from one sample to the next.
    pub grey_level: f64,
    /// True if no light reaches them. Otherwise micro-images touch, and the black level is below.
    pub is_dark: bool,
}

/// Compares a stated black level, in grey levels of `full`, with the darkest points of an image.
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

/// Finds a black level that is neither stated nor shown by any image, although it matters.
pub(crate) fn black_level_unknown<'d>(
    mut all: impl Iterator<Item = &'d Darkest>,
) -> Option<Finding> {
    let matters = |d: &Darkest| !d.is_dark && d.level >= HARMLESS * (d.level + d.light);
    all.all(matters).then(|| Finding::caution(Issue::BlackLevelUnknown))
}

/// Returns true if samples are linear in light; light is their power of 1 + `exponent`.
pub(crate) fn is_linear(exponent: f64, std_dev: f64) -> bool {
    exponent.abs() <= LINEAR.max(LINEAR_STD_DEVS * std_dev)
}

/// Returns the finding that white images do not show the angular response.
pub(crate) fn response_unknown() -> Finding {
    Finding::caution(Issue::ResponseUnknown)
}

/// Compares the radius of micro-images of type 1 with the radius expected at the f-number of the image; `looks_like` is the
/// f-number of the measured radius.
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

/// Checks the part of the micro-images that has the size of its lens type.
pub(crate) fn lens_types(agreement: Option<f64>) -> Option<Finding> {
    let agreement = agreement.filter(|agreement| *agreement < AGREEMENT)?;
    Some(Finding::caution(Issue::LensTypesDisagree { agreement }))
}

/// Returns true if the main lens vignettes by a part that counts, from `vignetting` of the internal parameters.
pub(crate) fn vignettes(vignetting: Option<Estimate>) -> bool {
    vignetting.is_some_and(|Estimate { value, std_dev }| value > NARROW && value > SURE * std_dev)
}

/// Returns the shape of the openings: as stated, or else the nearer one to the measured cell share; discs if this is not known.
/// Returns a finding if the share contradicts the statement, or belongs to neither shape.
pub(crate) fn opening(
    stated: Option<Opening>,
    kind: LatticeKind,
    cell_share: Option<Estimate>,
) -> (Opening, Option<Finding>) {
    let cell = Opening::cell(kind);
    let Some(share) = cell_share else { return (stated.unwrap_or_default(), None) };
    let measured = if share.value > 0.5 { cell } else { Opening::Disc };
    let taken = stated.unwrap_or(measured);
    let from_middle = (share.value - 0.5).abs();
    let is_clear = |distance: f64| distance > SHARE_STD_DEVS * share.std_dev;
    let issue = if taken != measured && is_clear(from_middle) {
        Issue::OpeningContradicted { stated: taken.name(), cell: cell.name(), share }
    } else if from_middle < BETWEEN && is_clear(0.5 - from_middle) {
        Issue::OpeningBetween { taken: taken.name(), cell: cell.name(), share }
    } else {
        return (taken, None);
    };
    (taken, Some(Finding::caution(issue)))
}

/// Checks whether the main lens vignettes.
pub(crate) fn roundness(vignetting: Option<Estimate>) -> Option<Finding> {
    let narrower = vignetting.filter(|_| vignettes(vignetting))?.value;
    Some(Finding::caution(Issue::ObliquePupil { narrower }))
}

/// Returns the finding that m and q' are from straight lines, for lack of discs.
pub(crate) fn no_discs() -> Finding {
    let (m_error, q_prime_error) = BY_LINES;
    Finding::caution(Issue::NoDiscs { m_error, q_prime_error })
}

/// Returns the finding that samples are not linear in light, which is their power of `power`.
pub(crate) fn not_linear(power: f64) -> Finding {
    Finding::caution(Issue::NotLinear { power })
}

/// Stretch of a lattice along one direction.
pub(crate) struct Stretch {
    /// Length along this direction over the length across it, less 1.
    pub relative: f64,
    /// Root mean square distance by which it moves centres, in pitches.
    pub moved: f64,
    /// Root mean square distance of the centres from the stretched lattice, in pitches.
    pub scatter: f64,
}

impl Stretch {
    /// Returns true if it is neither within the irregularity of arrays nor within that of this one. The latter may be smooth, as
    /// by a distortion, and pass for a stretch of a small array.
    fn counts(&self) -> bool {
        self.relative > STRETCHED && self.moved > PLACED.max(self.scatter)
    }
}

/// Finds micro-images of an array that gave no centre: of `dark` and `misplaced` ones beside `measured` ones.
pub(crate) fn left_out(measured: usize, dark: usize, misplaced: usize) -> Option<Finding> {
    let all = measured + dark + misplaced;
    let many = (dark + misplaced) as f64 > LEFT_OUT * all as f64;
    many.then(|| Finding::note(Issue::MicroImagesLeftOut { dark, misplaced, all }))
}

/// Finds micro-images of two lens types, whose radii differ by a part of their mean, in an array of one type.
pub(crate) fn alternating(apart: Option<f64>) -> Option<Finding> {
    apart.map(|apart| Finding::unusable(Issue::AlternatingSizes { apart }))
}

/// Finds an image that is no white image, over-exposed, or not regular. The values are the part of its micro-images that are
/// not as bright as their neighbours, the root mean square distance from the grid and the pitch, the stretch of the lattice, and
/// the part of saturated pixels.
pub(crate) fn array(
    uneven: f64,
    (rms_px, pitch_px): (f64, f64),
    stretch: Option<Stretch>,
    full: f64,
) -> Vec<Finding> {
    let not_white = (uneven > UNEVEN).then_some(Issue::NotWhite { uneven });
    let irregular =
        (rms_px > IRREGULAR * pitch_px).then_some(Issue::IrregularArray { rms_px, pitch_px });
    let stretched = stretch
        .filter(Stretch::counts)
        .map(|stretch| Issue::StretchedArray { stretch: stretch.relative });
    let over_exposed = (full > MOSTLY_FULL).then_some(Issue::OverExposed { full });
    let issues = [not_white, irregular, stretched, over_exposed];
    issues.into_iter().flatten().map(Finding::caution).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_cell_share_decides_unless_the_shape_is_stated() {
        let kind = LatticeKind::HexagonalRows;
        for (stated, share, taken, code) in [
            (None, 0.02, Opening::Disc, None),
            (None, 1.26, Opening::Hexagon, None),
            (None, 0.6, Opening::Hexagon, Some("opening-between")),
            (Some(Opening::Disc), 0.97, Opening::Disc, Some("opening-contradicted")),
            (Some(Opening::Hexagon), 0.97, Opening::Hexagon, None),
        ] {
            let (found, finding) = opening(stated, kind, Some(Estimate::new(share, 0.03)));
            let found_code = finding.map(|finding| finding.issue.code());
            assert_eq!((found, found_code), (taken, code), "{stated:?} {share}");
        }
        let unsure = Some(Estimate::new(0.6, 0.2));
        assert_eq!(opening(None, kind, unsure), (Opening::Hexagon, None));
        assert_eq!(opening(None, kind, None), (Opening::Disc, None));
    }

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
