//! The verdict on a calibration, from its findings.

use std::fmt;

use serde::Serialize;

use super::held_out_boards::{of_fixed_camera, scatter};
use super::outliers::OutlyingFrame;
use super::{Outliers, Patterns};
use crate::calibration::{Calibration, Mode, SLOPE};
use crate::checks::calibration as checks;
use crate::finding::{self, Finding, Issue, Severity};

/// The verdict on a camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// Camera without a finding against it.
    Good,
    /// Camera that may be right; the findings name the parts to check.
    UsableWithCare,
    /// Camera that is wrong, or not determined.
    DoNotUse,
}

impl Verdict {
    /// Returns the verdict that findings lead to.
    #[must_use]
    pub fn of(findings: &[Finding]) -> Self {
        match finding::worst(findings) {
            None | Some(Severity::Note) => Self::Good,
            Some(Severity::Caution) => Self::UsableWithCare,
            Some(Severity::Unusable) => Self::DoNotUse,
        }
    }
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Good => "good",
            Self::UsableWithCare => "usable with care",
            Self::DoNotUse => "do not use",
        })
    }
}

/// Returns all findings about a calibration, the heaviest first.
pub(super) fn findings(
    calibration: &Calibration,
    outliers: &Outliers,
    patterns: &Patterns,
) -> Vec<Finding> {
    let (outlying, all) = (outliers.features.len(), calibration.reprojection.features.len());
    let mut findings: Vec<Finding> = checks::not_converged(calibration.converged)
        .into_iter()
        .chain(calibration.findings.iter().cloned())
        .chain(outliers.frames.iter().map(OutlyingFrame::finding))
        .chain(checks::outlying_features(outlying, all))
        .collect();
    if calibration.options.mode == Mode::PosesOnly {
        findings.extend(of_fixed_camera(calibration));
    } else {
        findings.extend(of_white_images(calibration));
        findings.extend(of_residuals(calibration, patterns));
        findings.extend(checks::boards(&calibration.poses));
        let (camera, uncertainty) = (&calibration.camera, &calibration.uncertainty);
        findings.extend(checks::parameters(camera, uncertainty, &calibration.poses));
    }
    finding::sort(&mut findings);
    findings
}

/// Checks m of the white images against the camera, unless the prior on m is contradicted already.
fn of_white_images(calibration: &Calibration) -> Option<Finding> {
    let told = |finding: &Finding| matches!(&finding.issue, Issue::PriorContradicted { quantity, .. } if quantity == SLOPE);
    let error = calibration.m_error()?;
    if calibration.findings.iter().any(told) {
        return None;
    }
    checks::slope(error, calibration.m_std_dev())
}

fn of_residuals(calibration: &Calibration, patterns: &Patterns) -> Vec<Finding> {
    scatter(calibration)
        .into_iter()
        .chain(checks::image_pattern(patterns.image))
        .chain(checks::micro_image_pattern(patterns.micro_image))
        .chain(checks::lens_type_pattern(patterns.lens_types))
        .chain(checks::coverage(patterns.coverage))
        .collect()
}
