//! The values that an option can take, with their descriptions in the help.

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use plenocal::calibration::{Mode, Weights};
use plenocal::detection::DepthEstimator;
use plenocal::image::Color;
use plenocal::io::{Blur, BoardChoice, FieldCurvature, Method, Pitches};
use plenocal::model::Subset;
use plenocal::precalibration::RadiusEstimator;
use plenocal::solver::LossKind;

/// How the pixels of a map of virtual depths lie.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MapKind {
    /// As those of the raw image.
    Raw,
    /// As those of a total-focus image: straight before the images of points.
    Focused,
}

/// Name, description in the help, value.
type Choice<T> = (&'static str, &'static str, T);

pub const METHODS: &[Choice<Method>] = &[
    (
        "full",
        "Weights, priors, a robust loss, and effects that the paper's camera lacks",
        Method::Full,
    ),
    (
        "paper",
        "Unit weights, no loss, no priors, exit pupil in the lens, flat field, flat board, blur from features",
        Method::Paper,
    ),
];

pub const MODES: &[Choice<Mode>] = &[
    ("full", "Camera and poses, from (u, v), the centres, and q' or rho (--blur)", Mode::Full),
    (
        "corners-only",
        "Camera with pinholes, and poses, from (u, v) and the centres",
        Mode::CornersOnly,
    ),
    ("poses-only", "Poses, with the camera fixed", Mode::PosesOnly),
];

pub const PITCHES: &[Choice<Pitches>] = &[
    ("one", "One for both axes (the paper)", Pitches::One),
    ("two", "One along x, one along y", Pitches::Two),
];

pub const FIELD_CURVATURES: &[Choice<FieldCurvature>] = &[
    (
        "estimated",
        "Images off the axis may be nearer to the lens, by an amount that depends on the magnification",
        FieldCurvature::Estimated,
    ),
    ("constant", "The same at all distances", FieldCurvature::Constant),
    ("flat", "None (the paper)", FieldCurvature::Flat),
];

pub const BOARD_MODELS: &[Choice<BoardChoice>] = &[
    ("auto", "Flat, unless the frames show that it is bent or stretched", BoardChoice::Auto),
    ("flat", "Flat (the paper)", BoardChoice::Flat),
    ("bent", "Bent and stretched, by what comes out", BoardChoice::Bent),
];

pub const BLURS: &[Choice<Blur>] = &[
    ("white-images", "From q' of the white images", Blur::WhiteImages),
    ("features", "From rho of every feature (the paper)", Blur::Features),
];

pub const LOSSES: &[Choice<LossKind>] = &[
    ("none", "Least squares (the paper)", LossKind::None),
    ("huber", "Linear beyond the scale", LossKind::Huber),
    ("cauchy", "Logarithmic beyond the scale", LossKind::Cauchy),
];

pub const ANCHORS: &[Choice<bool>] = &[
    ("default", "What datasheet, white images and sensor say", true),
    ("none", "Only what --anchor states", false),
];

pub const WEIGHTS: &[Choice<Weights>] = &[
    ("own", "Each observation by its own standard deviation, where the file has it", Weights::Own),
    ("unit", "The same for all of a kind (the paper)", Weights::Unit),
];

pub const DEPTH_MAPS: &[Choice<MapKind>] = &[
    ("raw", "As those of the raw image", MapKind::Raw),
    ("focused", "As those of a total-focus image, of any size", MapKind::Focused),
];

pub const SUBSETS: &[Choice<Subset>] = &[
    ("calibration", "Boards to calibrate with", Subset::Calibration),
    ("evaluation", "Boards to evaluate with", Subset::Evaluation),
    ("translation", "A board moved along the optical axis", Subset::Translation),
];

pub const DEPTH_ESTIMATORS: &[Choice<DepthEstimator>] = &[
    ("line", "A line through all micro-images", DepthEstimator::Line),
    ("median", "The paper's median over pairs of micro-images", DepthEstimator::Median),
];

pub const RADIUS_ESTIMATORS: &[Choice<RadiusEstimator>] = &[
    ("profile", "The edge of a fitted profile", RadiusEstimator::Profile),
    ("moments", "The paper's second moments", RadiusEstimator::Moments),
];

pub const COLORS: &[Choice<Color>] = &[
    ("grey", "One sample per pixel", Color::Grey),
    ("rgb", "Red, green and blue of every pixel", Color::Rgb),
    (
        "bayer-rggb",
        "A colour mosaic, named by the first two pixels of its first two rows",
        Color::BayerRggb,
    ),
    ("bayer-grbg", "", Color::BayerGrbg),
    ("bayer-gbrg", "", Color::BayerGbrg),
    ("bayer-bggr", "", Color::BayerBggr),
];

/// Parses one of several choices.
pub fn choice<T: Copy + Send + Sync + 'static>(
    choices: &'static [Choice<T>],
) -> impl TypedValueParser<Value = T> {
    let possible = choices.iter().map(|&(name, help, _)| match help {
        "" => PossibleValue::new(name),
        help => PossibleValue::new(name).help(help),
    });
    PossibleValuesParser::new(possible).map(move |chosen| {
        let (.., value) = choices
            .iter()
            .find(|(name, ..)| *name == chosen)
            .expect("clap accepts only possible values");
        *value
    })
}

#[cfg(test)]
mod tests {
    use serde::Serialize;

    use super::*;

    fn are_named_as_in_files<T: Serialize>(choices: &[Choice<T>]) {
        for (name, _, value) in choices {
            assert_eq!(serde_json::to_value(value).unwrap(), *name);
        }
    }

    #[test]
    fn choices_have_the_names_of_files() {
        are_named_as_in_files(MODES);
        are_named_as_in_files(LOSSES);
        are_named_as_in_files(WEIGHTS);
        are_named_as_in_files(SUBSETS);
        are_named_as_in_files(DEPTH_ESTIMATORS);
        are_named_as_in_files(RADIUS_ESTIMATORS);
        are_named_as_in_files(COLORS);
    }
}
