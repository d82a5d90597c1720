//! Checks of a board that was moved in known steps.

use crate::finding::{Finding, Issue};
use crate::numerics::{mean_and_std_dev, median};

/// Relative difference from the typical step above which a step does not belong to the series.
const UNEVEN: f64 = 0.3;
/// Smallest relative error of the steps that contradicts the scale, and the same in σ.
const SCALE: f64 = 0.01;
const SCALE_STD_DEVS: f64 = 3.0;

/// Step between two frames: the measured length over the known one.
pub(crate) struct Step {
    pub from: u32,
    pub to: u32,
    pub ratio: f64,
}

/// Checks the steps of a translation. `whole` is the ratio of the whole way, `reversed` is true if the board moved the other
/// way, `step_mm` is the known step, and `square_mm` the edge of the squares.
pub(crate) fn steps(
    steps: &[Step],
    whole: f64,
    reversed: bool,
    (step_mm, square_mm): (f64, f64),
) -> Vec<Finding> {
    let mut issues = Vec::new();
    if reversed {
        issues.push(Issue::StepsReversed);
    }
    // Images in the wrong order hardly change the whole way.
    let of_steps = || median(steps.iter().map(|step| step.ratio)).unwrap_or(whole);
    let typical = if (whole - 1.0).abs() < UNEVEN { 1.0 } else { of_steps() };
    let is_uneven = |step: &&Step| steps.len() > 2 && (step.ratio / typical - 1.0).abs() > UNEVEN;
    issues.extend(steps.iter().filter(is_uneven).map(|step| Issue::StepUneven {
        from: step.from,
        to: step.to,
        ratio: step.ratio / typical,
    }));
    if !steps.iter().any(|step| is_uneven(&step)) {
        let (ratio, std_dev) = mean_and_std_dev(steps.iter().map(|step| step.ratio));
        let std_dev = std_dev.unwrap_or(0.0) / (steps.len() as f64).sqrt();
        if (ratio - 1.0).abs() > SCALE.max(SCALE_STD_DEVS * std_dev) {
            issues.push(Issue::StepScale { ratio, step_mm, square_mm });
        }
    }
    issues.into_iter().map(Finding::caution).collect()
}
