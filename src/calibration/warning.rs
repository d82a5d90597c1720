//! Warnings of a calibration, and reasons why frames were left out.

use std::fmt;

use crate::calibration::{AnchorResult, SLOPE};
use crate::model::{FillFactor, MIN_CORNERS};
use crate::quantity::{display_unit, with_std_dev};
use crate::solver::Anchor;

/// What may be wrong with a calibration that succeeded.
#[derive(Debug, Clone, PartialEq)]
pub enum Warning {
    /// Micro-image centres far from the grid; they are kept.
    OutlyingCenters {
        /// Number of these centres.
        outliers: usize,
        /// Number of all centres.
        centers: usize,
        /// Root mean square distance from the grid, px.
        grid_rms_px: f64,
    },
    /// Features that state no σ and lie far from where the camera projects them.
    OutlyingFeatures {
        /// Number of these features.
        features: usize,
        /// Number of all features.
        of: usize,
        /// Where Huber's loss sets in, in the unit of the cost.
        scale: f64,
    },
    /// The array reaches far beyond the image.
    ArrayBeyondImage {
        /// Micro-lenses along u and v.
        array: (i32, i32),
        /// Size of the area that they cover, px.
        extent_px: (f64, f64),
        /// Size of the image, px.
        image_px: (u32, u32),
    },
    /// The observations do not determine all parameters.
    Undetermined {
        /// Directions of parameter space that they determine.
        rank: usize,
        /// Number of parameters.
        parameters: usize,
        /// The intrinsic parameters that are not determined; empty if only poses are not.
        names: Vec<&'static str>,
    },
    /// Residuals far larger than noise.
    BadFit {
        /// Root mean square residual of (u, v, ρ), px.
        rms_px: f64,
        /// Micro-image pitch, px.
        micro_image_pitch_px: f64,
    },
    /// The camera does not explain the blur radii.
    UnexplainedBlur {
        /// Root mean square residual of ρ, px.
        rms_px: f64,
        /// Standard deviation of ρ itself, px.
        spread_px: f64,
    },
    /// The observations pull on an anchor.
    AnchorPulled(AnchorResult),
    /// Two lens types have edges of different widths.
    FillFactorsDiffer {
        /// The two, from 0.
        lens_types: [usize; 2],
        /// Their fill factors, the larger first.
        fill_factors: [FillFactor; 2],
    },
    /// The board is bent so far that it should be replaced.
    WarpedBoard {
        /// The largest of its sags and its twist, mm.
        bend_mm: f64,
        /// Its diagonal, mm.
        diagonal_mm: f64,
        /// Whether its shape is estimated, and not known.
        estimated: bool,
    },
    /// The squares of the board are oblong.
    StretchedBoard {
        /// By what part squares are longer along x than along y.
        aspect: f64,
    },
    /// The shape of the board could not be found, and it is taken to be flat.
    BoardShapeNotFound {
        /// Why.
        reason: String,
    },
    /// The shape of the board was found once, and refining that alone failed.
    BoardShapeNotSettled {
        /// Why.
        reason: String,
    },
    /// The main lens is focused at another distance than stated.
    FocusDistance {
        /// As stated, mm from the sensor.
        stated_mm: f64,
        /// By the boards, mm.
        by_boards_mm: f64,
    },
    /// Poses are given of frames that show no features.
    PosesOfNoFrame {
        /// These frames.
        frames: Vec<u32>,
    },
    /// All boards are nearly parallel to the image plane.
    FrontoParallel {
        /// The largest tilt, degrees.
        largest_tilt_deg: f64,
    },
}

impl fmt::Display for Warning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::OutlyingCenters { outliers, centers, grid_rms_px } => write!(
                f,
                "{outliers} of {centers} micro-image centres lie far from the grid (its RMS is \
                 {grid_rms_px:.3} px); they are kept, and a robust loss reduces their weight"
            ),
            Self::OutlyingFeatures { features, of, scale } => {
                f.write_str(&outlying_text(*features, *of, *scale))
            }
            Self::ArrayBeyondImage { array, extent_px, image_px } => write!(
                f,
                "{} x {} micro-lenses cover {:.0} x {:.0} px, but the image has {} x {}: is the size \
                 of the array right? D, d, t_x and t_y are those at its middle",
                array.0, array.1, extent_px.0, extent_px.1, image_px.0, image_px.1
            ),
            Self::Undetermined { rank, parameters, names } => {
                f.write_str(&undetermined_text(*rank, *parameters, names))
            }
            Self::BadFit { rms_px, micro_image_pitch_px } => write!(
                f,
                "the residuals of the features are {rms_px:.2} px RMS, a large part of a micro-image \
                 ({micro_image_pitch_px:.1} px): noise alone is far smaller; check the board (columns, \
                 rows, square_mm), the sign of rho and the frames with large residuals"
            ),
            Self::UnexplainedBlur { rms_px, spread_px } => write!(
                f,
                "the residuals of the blur radii are {rms_px:.3} px RMS, though the radii themselves \
                 spread by only {spread_px:.3} px: the camera does not explain them; check the sign \
                 of rho and the order of q'"
            ),
            Self::AnchorPulled(anchor) => {
                let (unit, factor) = display_unit(&anchor.anchor.quantity, anchor.unit());
                let Anchor { quantity, value, std_dev } = &anchor.anchor;
                let (known, deviation) = with_std_dev(value * factor, Some(std_dev * factor));
                let (result, _) = with_std_dev(anchor.result * factor, Some(std_dev * factor));
                write!(
                    f,
                    "{quantity} is {result} {unit}, but {known} ± {deviation} {unit} is known of it \
                     ({}): the observations pull by {:+.1} σ. {}",
                    anchor.source,
                    anchor.pull(),
                    meaning(quantity)
                )
            }
            Self::FillFactorsDiffer { lens_types, fill_factors } => {
                f.write_str(&fill_factors_text(lens_types, fill_factors))
            }
            Self::WarpedBoard { bend_mm, diagonal_mm, estimated } => write!(
                f,
                "the board is bent by {bend_mm:.2} mm, {:.1} % of its diagonal: its shape is {}, but as a smooth bend \
                 that is the same in all frames; take a flatter board",
                100.0 * bend_mm / diagonal_mm,
                if *estimated { "estimated with the camera" } else { "taken as known" }
            ),
            Self::StretchedBoard { aspect } => f.write_str(&stretched_text(*aspect)),
            Self::BoardShapeNotFound { reason } => write!(
                f,
                "whether the board is flat could not be found out, and it is taken to be flat: {reason}. If you know \
                 that it is, say so; else check it, and the frames with large residuals"
            ),
            Self::BoardShapeNotSettled { reason } => write!(
                f,
                "the board is not flat, and has the shape of a first trial, with anchors that hold it to be flat; \
                 a second refinement without them failed: {reason}. Measure the board, and state its shape"
            ),
            Self::FocusDistance { stated_mm, by_boards_mm } => {
                f.write_str(&focus_text(*stated_mm, *by_boards_mm))
            }
            Self::PosesOfNoFrame { frames } => f.write_str(&poses_of_no_frame_text(frames)),
            Self::FrontoParallel { largest_tilt_deg } => write!(
                f,
                "all boards are fronto-parallel (tilted by at most {largest_tilt_deg:.1} degrees): \
                 the focal length F and the distance of the boards can hardly be separated; add \
                 boards tilted by 20 to 40 degrees"
            ),
        }
    }
}

/// That squares are oblong.
fn stretched_text(aspect: f64) -> String {
    format!(
        "the squares of the board are {:.1} % longer along {}: the stated edge is taken to be the mean of both, and F, d and \
         distances are as much off as it is. Measure both",
        100.0 * aspect.abs(),
        if aspect > 0.0 { "rows than along columns" } else { "columns than along rows" }
    )
}

/// That poses are given of frames without features.
fn poses_of_no_frame_text(frames: &[u32]) -> String {
    let frames: Vec<String> = frames.iter().map(u32::to_string).collect();
    format!(
        "poses are given of frames without features, which are not used: {}. Do they count frames as the features do?",
        frames.join(", ")
    )
}

/// That parameters are not determined.
fn undetermined_text(rank: usize, parameters: usize, names: &[&str]) -> String {
    let which = if names.is_empty() { "some poses".to_owned() } else { names.join(", ") };
    format!(
        "the observations determine {rank} of {parameters} parameters; not determined: {which}. Fix parameters, or add \
         observations that determine them: frames at other distances and tilts, every lens type"
    )
}

/// That features without σ outlie.
fn outlying_text(features: usize, of: usize, scale: f64) -> String {
    format!(
        "{features} of {of} features lie more than 10 times as far as usual from where the camera projects them: features \
         without σ are refined again with Huber's loss, which sets in at {scale:.2} as their residuals let expect. Look for \
         them in residuals.csv, or choose a loss"
    )
}

/// That the lens is focused at another distance.
fn focus_text(stated_mm: f64, by_boards_mm: f64) -> String {
    format!(
        "the boards say that the lens is focused at about {by_boards_mm:.0} mm and not at {stated_mm} mm: the calibration starts \
         from there. Check the focus distance (focus_distance_mm), the focal length (focal_length_mm) and the size of the \
         squares (square_mm)"
    )
}

/// That two lens types, from 0, have other fill factors.
fn fill_factors_text([a, b]: &[usize; 2], [of_a, of_b]: &[FillFactor; 2]) -> String {
    format!(
        "the edges of lens type {} say that micro-lenses fill {:.3} ± {:.3} of their pitch, those of type {} {:.3} ± \
         {:.3}: the camera has one fill factor for all, so the focal lengths of both types are off; check the white \
         images, and that lens types are in the same order everywhere",
        a + 1,
        of_a.value,
        of_a.std_dev,
        b + 1,
        of_b.value,
        of_b.std_dev
    )
}

/// What a contradiction of an anchor may mean.
fn meaning(quantity: &str) -> &'static str {
    match quantity {
        "F" | "D" => {
            "Check the focal length (focal_length_mm), the size of the squares (square_mm) and of a pixel \
             (pixel_size_mm), and where the exit pupil of the lens is if you have stated that"
        }
        SLOPE => {
            "Check the f-numbers of the white images (f_number), the size of a pixel (pixel_size_mm) and of the \
             squares (square_mm), and where the exit pupil of the lens is if you have stated that"
        }
        "u0" | "v0" => {
            "Check whether the images are cropped; with few tilted boards, or corners that are biased \
             towards the border, the axis drifts off"
        }
        "lean_u" | "lean_v" => {
            "Check that the white images are of this camera, and where the exit pupil of the lens is if you have \
             stated that; else the corners are biased towards one side of the image"
        }
        _ => "Check the value, its unit, and whether it is of this camera and setting",
    }
}

/// Why a frame has no pose.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub enum NoPose {
    /// The caller left it out.
    Excluded,
    /// It shows too few corners.
    TooFewCorners(usize),
    /// Its corners lie on one line.
    Collinear,
    /// `solvePnP` failed, with OpenCV's reason.
    PnpFailed(String),
    /// No solution has the whole board beyond the focal plane of the main lens.
    BehindFocalPlane,
    /// Poses are given, but none of it.
    NotGiven,
}

impl fmt::Display for NoPose {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Excluded => f.write_str("excluded on request"),
            Self::TooFewCorners(corners) => {
                write!(f, "{corners} corner(s) are too few; a pose needs {MIN_CORNERS}")
            }
            Self::Collinear => f.write_str("its corners lie on one line"),
            Self::PnpFailed(reason) => write!(f, "solvePnP failed: {reason}"),
            Self::BehindFocalPlane => f.write_str(
                "solvePnP found no pose with the whole board in front of the focal plane of the main \
                 lens",
            ),
            Self::NotGiven => f.write_str("no pose of it is given"),
        }
    }
}
