//! Observations and frames that do not fit the others.

use std::collections::BTreeMap;

use crate::calibration::{Calibration, OutlyingFeature};
use crate::finding::{Finding, Issue};
use crate::model::{FramePose, Parameter};
use crate::numerics::median;
use crate::solver::Uncertainty;

/// Limit on the logarithm of a frame's typical residual over the median of all frames, in σ of these logarithms. This σ is
/// at least [`LEAST_SPREAD`], since frames of few corners scatter as much by chance.
const OUTLYING_FRAME: f64 = 5.0;
const LEAST_SPREAD: f64 = 0.1;
/// Ratio of σ to the median deviation, for a normal distribution.
const FROM_MEDIAN_DEVIATION: f64 = 1.4826;
/// Limit on the change of a parameter without a frame, in the σ that the other frames predict. There are a few hundred
/// changes, with heavy tails: noise reaches 4.
const INFLUENTIAL: f64 = 5.0;
/// Smallest relevant change of a parameter, in its σ, however unexpected it is: frames of clean sets move weak parameters
/// by 1 σ.
const MATERIAL: f64 = 2.0;
/// Fewest frames among which one can be an outlier.
const MIN_FRAMES: usize = 6;

/// A frame that does not fit the others.
#[derive(Debug, Clone, PartialEq)]
pub struct OutlyingFrame {
    /// Number of the frame.
    pub frame: u32,
    /// Typical residual of the frame over the median of all frames.
    pub residual_ratio: f64,
    /// Least expected change of a parameter without the frame; `None` if there is no relevant one.
    pub influence: Option<Influence>,
}

/// The influence of a frame on the camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Influence {
    /// Parameter whose change is the least expected if the frame is left out.
    pub parameter: &'static str,
    /// Change of the parameter, in its σ.
    pub std_devs: f64,
    /// Change over the one expected from the other frames.
    pub unexpected: f64,
}

impl OutlyingFrame {
    /// Returns a finding about the frame.
    #[must_use]
    pub fn finding(&self) -> Finding {
        let Self { frame, residual_ratio, influence } = *self;
        let issue = Issue::OutlyingFrame {
            frame,
            residual_ratio,
            parameter: influence.map(|i| i.parameter.to_owned()),
            std_devs: influence.map(|i| i.std_devs),
            unexpected: influence.map(|i| i.unexpected),
        };
        let weight = 5.0 + self.unexpected_influence().max(residual_ratio);
        Finding::caution(issue).about_frame(frame, None).weighing(weight)
    }

    pub(super) fn unexpected_influence(&self) -> f64 {
        self.influence.map_or(0.0, |influence| influence.unexpected)
    }
}

/// All observations and frames that do not fit.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Outliers {
    /// Outliers among the features, the farthest first.
    pub features: Vec<OutlyingFeature>,
    /// Outliers among the frames, the worst first.
    pub frames: Vec<OutlyingFrame>,
}

pub(super) fn outliers(calibration: &Calibration) -> Outliers {
    Outliers { features: calibration.outlying_features(), frames: frames(calibration) }
}

fn frames(calibration: &Calibration) -> Vec<OutlyingFrame> {
    let mut by_frame: BTreeMap<u32, Vec<f64>> = BTreeMap::new();
    for r in &calibration.reprojection.features {
        by_frame.entry(r.feature.frame).or_default().push(r.norm());
    }
    let typical: BTreeMap<u32, f64> =
        by_frame.into_iter().filter_map(|(frame, norms)| Some((frame, median(norms)?))).collect();
    if typical.len() < MIN_FRAMES {
        return Vec::new();
    }
    let logarithms = || typical.values().map(|m| m.ln());
    let middle = median(logarithms()).unwrap_or(0.0);
    let deviation = median(logarithms().map(|l| (l - middle).abs())).unwrap_or(0.0);
    let spread = (FROM_MEDIAN_DEVIATION * deviation).max(LEAST_SPREAD);
    let badness = |f: &OutlyingFrame| {
        (f.residual_ratio.ln() / spread / OUTLYING_FRAME)
            .max(f.unexpected_influence() / INFLUENTIAL)
    };
    let scaled = scaled_changes(&calibration.uncertainty);
    let of_pose = |(i, pose): (usize, &FramePose)| {
        let residual_ratio = typical.get(&pose.frame)? / middle.exp();
        let influence = influence(&scaled, i, calibration);
        Some(OutlyingFrame { frame: pose.frame, residual_ratio, influence })
    };
    let all = calibration.poses.iter().enumerate().filter_map(of_pose);
    let mut found: Vec<OutlyingFrame> = all.filter(|frame| badness(frame) > 1.0).collect();
    found.sort_by(|a, b| badness(b).total_cmp(&badness(a)));
    found
}

/// Returns, for each frame, the change of each parameter if the frame is left out, over the σ of this change if
/// errors agree with the weights. A frame with the share s of the information on a parameter of variance V
/// changes it by √(V·s/(1 − s)).
fn scaled_changes(uncertainty: &Uncertainty) -> Vec<Vec<f64>> {
    let (changes, shares) = (&uncertainty.left_out_changes, &uncertainty.frame_shares);
    let of_frame = |frame: usize| {
        let of_row = |row: usize| {
            let share = shares[(frame, row)];
            let variance = uncertainty.independent_covariance[(row, row)] * share / (1.0 - share);
            changes[(frame, row)] / variance.sqrt()
        };
        (0..changes.columns).map(of_row).collect()
    };
    (0..changes.rows).map(of_frame).collect()
}

/// Returns the parameter whose change is the least expected if a frame is left out. The expected change is the root mean square
/// over the other frames and all parameters. Frames without which a parameter is undetermined are not counted.
fn influence(scaled: &[Vec<f64>], frame: usize, calibration: &Calibration) -> Option<Influence> {
    let of_others = scaled.iter().enumerate().filter(|(i, _)| *i != frame);
    let others: Vec<f64> =
        of_others.flat_map(|(_, z)| z).copied().filter(|z| z.is_finite()).collect();
    let typical = (others.iter().map(|z| z * z).sum::<f64>() / others.len() as f64).sqrt();
    let Uncertainty { covariance, left_out_changes, free_intrinsics, .. } =
        &calibration.uncertainty;
    let parameters = Parameter::shared(calibration.camera.lens_types());
    let of = |(row, (&index, z)): (usize, (&usize, &f64))| {
        let std_devs = left_out_changes[(frame, row)].abs() / covariance[(row, row)].sqrt();
        let unexpected = z.abs() / typical;
        (unexpected.is_finite() && std_devs > MATERIAL).then_some(Influence {
            parameter: parameters[index].name(),
            std_devs,
            unexpected,
        })
    };
    let free = free_intrinsics.iter().zip(scaled.get(frame)?).enumerate();
    free.filter_map(of).max_by(|a, b| a.unexpected.total_cmp(&b.unexpected))
}
