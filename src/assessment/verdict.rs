//! The verdict on a calibration, and its reasons.

use super::outliers::OutlyingFrame;
use super::{Outliers, Patterns};
use crate::calibration::{Calibration, Mode, SLOPE, Warning};
use crate::model::intrinsic_parameters;

/// What to do with a camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Verdict {
    /// Nothing speaks against it.
    Good,
    /// It may be right; the reasons say what to look at.
    UsableWithCare,
    /// It is wrong, or not determined.
    DoNotUse,
}

/// Something that speaks against a calibration.
#[derive(Debug, Clone, PartialEq)]
pub enum Reason {
    /// It is not at a minimum.
    NotConverged,
    /// A warning of the calibration.
    Warning(Warning),
    /// The observations pull on what is known.
    Pulled {
        /// The anchored quantity.
        quantity: String,
        /// By so many σ.
        pull: f64,
    },
    /// m of the white images and of the camera differ.
    SlopeContradicts {
        /// (m* − m)/m*.
        error: f64,
    },
    /// The features scatter by so many times as much as their σ says.
    Scatter(f64),
    /// A frame that does not fit the others.
    Frame(OutlyingFrame),
    /// Features that do not fit.
    Features {
        /// Their number.
        outlying: usize,
        /// Of so many.
        all: usize,
    },
    /// The residuals have a pattern over the image.
    ImagePattern(f64),
    /// The residuals grow with the distance from the centre of the micro-image.
    MicroImagePattern(f64),
    /// One lens type has larger residuals than another.
    LensTypes(f64),
    /// Few frames.
    FewFrames(usize),
    /// Few tilted boards.
    FewTilts {
        /// Number of boards tilted by 10° or more.
        tilted: usize,
        /// Number of boards.
        frames: usize,
    },
    /// All boards at nearly the same distance.
    OneDistance {
        /// Largest over smallest distance.
        ratio: f64,
    },
    /// Boards in a part of the image only.
    Coverage(f64),
    /// One frame has most of the information on a parameter.
    DominantFrame {
        /// The frame.
        frame: u32,
        /// The parameter.
        parameter: &'static str,
        /// Its share, 0 to 1.
        share: f64,
    },
    /// A parameter is not known well.
    Uncertain {
        /// The parameter.
        parameter: &'static str,
        /// σ over its value.
        relative: f64,
    },
}

/// A pull by more σ than this is a contradiction.
pub(super) const PULLED: f64 = 3.0;
/// By this many, what is known or the observations are wrong.
const TORN: f64 = 6.0;
/// What m of the white images is worth besides its own σ: that of f-numbers.
const SLOPE_FLOOR: f64 = 0.02;
/// m of simulated cameras is within 1 % of that of their white images.
const SLOPES_AGREE: f64 = 0.015;
/// The features of clean images, of real lenses too, scatter by 1.1 to 1.4 times as much as their σ says.
const SCATTER: f64 = 1.6;
/// Single features far off do nothing, as the loss weights them down; more than this part says that more is wrong.
const OUTLYING_PART: f64 = 0.002;
/// Patterns above these fractions of the residuals are named.
const IMAGE_PATTERN: f64 = 0.3;
const MICRO_IMAGE_PATTERN: f64 = 0.1;
const LENS_TYPES: f64 = 1.4;
/// Fewer frames do not show what their errors share.
const ENOUGH_FRAMES: usize = 6;
/// Fewer still leave too much to chance.
const MIN_FRAMES: usize = 3;
/// A board tilted by less, rad (10°), says little of F.
const TILTED_RAD: f64 = 0.1745;
const ENOUGH_TILTED: usize = 3;
const DISTANCES: f64 = 1.2;
const COVERAGE: f64 = 0.5;
const DOMINANT: f64 = 0.5;
const UNCERTAIN: f64 = 0.01;
const UNKNOWN: f64 = 0.1;
/// The parameters whose relative σ matters.
const LENGTHS: [&str; 6] = ["F", "D", "d", "f_1", "f_2", "f_3"];

impl Reason {
    /// The verdict that this reason alone leads to.
    #[must_use]
    pub fn verdict(&self) -> Verdict {
        let care_below = |value: f64, limit: f64| {
            if value < limit { Verdict::UsableWithCare } else { Verdict::DoNotUse }
        };
        match self {
            Self::NotConverged
            | Self::Warning(
                Warning::BadFit { .. }
                | Warning::Undetermined { .. }
                | Warning::UnexplainedBlur { .. },
            ) => Verdict::DoNotUse,
            Self::FewFrames(frames) if *frames < MIN_FRAMES => Verdict::DoNotUse,
            Self::Pulled { pull, .. } => care_below(pull.abs(), TORN),
            Self::SlopeContradicts { error } => care_below(error.abs(), TORN * SLOPE_FLOOR),
            Self::Uncertain { relative, .. } => care_below(*relative, UNKNOWN),
            _ => Verdict::UsableWithCare,
        }
    }

    /// How heavy it is among the reasons for the same verdict.
    fn weight(&self) -> f64 {
        match self {
            Self::NotConverged => 100.0,
            Self::Warning(_) => 50.0,
            Self::Pulled { pull, .. } => 2.0 * pull.abs(),
            Self::SlopeContradicts { error } => 2.0 * error.abs() / SLOPE_FLOOR,
            Self::Frame(frame) => 5.0 + frame.unexpected_influence().max(frame.residual_ratio),
            Self::Scatter(ratio) => 5.0 * ratio / SCATTER,
            Self::Uncertain { relative, .. } => (4.0 * relative / UNCERTAIN).min(40.0),
            Self::ImagePattern(part) => 4.0 * part / IMAGE_PATTERN,
            Self::MicroImagePattern(part) => 4.0 * part / MICRO_IMAGE_PATTERN,
            Self::FewFrames(_) => 4.0,
            Self::FewTilts { .. } | Self::OneDistance { .. } | Self::DominantFrame { .. } => 3.0,
            Self::LensTypes(ratio) => 2.0 * ratio,
            Self::Coverage(_) | Self::Features { .. } => 2.0,
        }
    }
}

/// All reasons, the heaviest first.
pub(super) fn reasons(
    calibration: &Calibration,
    outliers: &Outliers,
    patterns: &Patterns,
) -> Vec<Reason> {
    let mut reasons = Vec::new();
    if !calibration.converged {
        reasons.push(Reason::NotConverged);
    }
    let counts = |w: &&Warning| {
        let withstood =
            matches!(w, Warning::OutlyingCenters { .. } | Warning::OutlyingFeatures { .. });
        !(withstood || matches!(w, Warning::AnchorPulled(_)))
    };
    reasons.extend(calibration.warnings.iter().filter(counts).cloned().map(Reason::Warning));
    reasons.extend(outliers.frames.iter().cloned().map(Reason::Frame));
    let (outlying, all) = (outliers.features.len(), calibration.reprojection.features.len());
    if outlying as f64 > OUTLYING_PART * all as f64 {
        reasons.push(Reason::Features { outlying, all });
    }
    if calibration.options.mode != Mode::PosesOnly {
        reasons.extend(of_anchors(calibration));
        reasons.extend(of_patterns(patterns));
        reasons.extend(of_boards(calibration));
        reasons.extend(of_parameters(calibration));
    }
    let order = |r: &Reason| (r.verdict(), r.weight());
    reasons.sort_by(|a, b| order(b).partial_cmp(&order(a)).unwrap_or(std::cmp::Ordering::Equal));
    reasons
}

fn of_anchors(calibration: &Calibration) -> Vec<Reason> {
    let mut reasons: Vec<Reason> = calibration
        .anchors
        .iter()
        .filter(|anchor| anchor.pull().abs() > PULLED)
        .map(|a| Reason::Pulled { quantity: a.anchor.quantity.clone(), pull: a.pull() })
        .collect();
    let pulled =
        reasons.iter().any(|r| matches!(r, Reason::Pulled { quantity, .. } if quantity == SLOPE));
    let error = calibration.m_error().filter(|e| !pulled && e.abs() > SLOPES_AGREE);
    reasons.extend(error.map(|error| Reason::SlopeContradicts { error }));
    let scatter = calibration.uncertainty.std_dev_factors[0];
    let stated = calibration.reprojection.features.iter().any(|r| r.feature.std_dev_px.is_some());
    reasons.extend((stated && scatter > SCATTER).then_some(Reason::Scatter(scatter)));
    reasons
}

fn of_patterns(patterns: &Patterns) -> Vec<Reason> {
    let mut reasons = Vec::new();
    if patterns.image > IMAGE_PATTERN {
        reasons.push(Reason::ImagePattern(patterns.image));
    }
    if patterns.micro_image > MICRO_IMAGE_PATTERN {
        reasons.push(Reason::MicroImagePattern(patterns.micro_image));
    }
    if patterns.lens_types > LENS_TYPES {
        reasons.push(Reason::LensTypes(patterns.lens_types));
    }
    if patterns.coverage < COVERAGE {
        reasons.push(Reason::Coverage(patterns.coverage));
    }
    reasons
}

fn of_boards(calibration: &Calibration) -> Vec<Reason> {
    let poses = &calibration.poses;
    let frames = poses.len();
    let mut reasons = Vec::new();
    if frames < ENOUGH_FRAMES {
        reasons.push(Reason::FewFrames(frames));
    }
    let tilt = |i: &usize| {
        let normal = poses[*i].camera_from_board.rotation * nalgebra::Vector3::z();
        normal.z.abs().min(1.0).acos() >= TILTED_RAD
    };
    let tilted = (0..frames).filter(tilt).count();
    // The warning says it already.
    let warned = calibration.warnings.iter().any(|w| matches!(w, Warning::FrontoParallel { .. }));
    if tilted < ENOUGH_TILTED && !warned {
        reasons.push(Reason::FewTilts { tilted, frames });
    }
    let distances = poses.iter().map(|p| p.camera_from_board.translation.z);
    let ratio = distances.clone().fold(0.0, f64::max) / distances.fold(f64::INFINITY, f64::min);
    if frames > 1 && ratio < DISTANCES {
        reasons.push(Reason::OneDistance { ratio });
    }
    reasons
}

fn of_parameters(calibration: &Calibration) -> Vec<Reason> {
    let uncertainty = &calibration.uncertainty;
    let parameters = intrinsic_parameters(calibration.camera.lens_types());
    let is_length = |index: usize| parameters.get(index).is_some_and(|p| LENGTHS.contains(&p.name));
    let free = uncertainty.free_intrinsics.iter().enumerate();
    let lengths = free.filter(|(row, index)| is_length(**index) && uncertainty.determined[*row]);
    let mut dominant: Option<(usize, usize, f64)> = None;
    let mut uncertain: Option<(usize, f64)> = None;
    for (row, &index) in lengths {
        for frame in 0..calibration.poses.len() {
            let share = uncertainty.frame_shares[(frame, row)];
            if share > DOMINANT.max(dominant.map_or(0.0, |d| d.2)) {
                dominant = Some((frame, index, share));
            }
        }
        let value = parameters[index].value(&calibration.camera);
        let relative = uncertainty.covariance[(row, row)].sqrt() / value.abs();
        if relative > UNCERTAIN.max(uncertain.map_or(0.0, |u| u.1)) {
            uncertain = Some((index, relative));
        }
    }
    let dominant = dominant.filter(|_| calibration.poses.len() > 1).map(|(frame, index, share)| {
        let (frame, parameter) = (calibration.poses[frame].frame, parameters[index].name);
        Reason::DominantFrame { frame, parameter, share }
    });
    let uncertain = uncertain
        .map(|(index, relative)| Reason::Uncertain { parameter: parameters[index].name, relative });
    dominant.into_iter().chain(uncertain).collect()
}
