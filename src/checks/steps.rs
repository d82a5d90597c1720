//! Checks of a board that was moved in known steps.

use crate::finding::{Finding, Issue, Severity};
use crate::numerics::{mean_and_std_dev, median};

/// Relative difference from the typical step above which a step does not belong to the series.
const UNEVEN: f64 = 0.3;
/// Smallest relative error of the steps that contradicts the scale, and the same in σ; and the error from which a camera
/// whose distances may have it should not be used.
const SCALE: f64 = 0.01;
const SCALE_STD_DEVS: f64 = 3.0;
const WRONG_SCALE: f64 = 0.03;

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
    let mut findings = Vec::new();
    if reversed {
        findings.push(Finding::caution(Issue::StepsReversed));
    }
    // Images in the wrong order hardly change the whole way.
    let of_steps = || median(steps.iter().map(|step| step.ratio)).unwrap_or(whole);
    let typical = if (whole - 1.0).abs() < UNEVEN { 1.0 } else { of_steps() };
    let is_uneven = |step: &&Step| steps.len() > 2 && (step.ratio / typical - 1.0).abs() > UNEVEN;
    findings.extend(steps.iter().filter(is_uneven).map(|step| {
        let ratio = step.ratio / typical;
        Finding::caution(Issue::StepUneven { from: step.from, to: step.to, ratio })
    }));
    if !steps.iter().any(|step| is_uneven(&step)) {
        let (ratio, std_dev) = mean_and_std_dev(steps.iter().map(|step| step.ratio));
        let std_dev = std_dev.unwrap_or(0.0) / (steps.len() as f64).sqrt();
        if (ratio - 1.0).abs() > SCALE.max(SCALE_STD_DEVS * std_dev) {
            let wrong = (ratio - 1.0).abs() > WRONG_SCALE.max(SCALE_STD_DEVS * std_dev);
            let severity = if wrong { Severity::Unusable } else { Severity::Caution };
            findings.push(Finding::new(severity, Issue::StepScale { ratio, step_mm, square_mm }));
        }
    }
    findings
}
