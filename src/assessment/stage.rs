//! The assessment as one function of a calibration.

use super::next_board::{NextBoard, next_board};
use super::object_space::{ObjectSpace, object_space};
use super::outliers::{Outliers, outliers};
use super::patterns::{Patterns, patterns};
use super::verdict::{Verdict, findings};
use crate::calibration::{Calibration, Mode};
use crate::error::Result;
use crate::finding::{self, Finding};
use crate::model::Board;

/// The assessment of a calibration: whether it can be trusted, and its σ in space.
#[derive(Debug, Clone, PartialEq)]
pub struct Assessment {
    /// Verdict on the camera.
    pub verdict: Verdict,
    /// The findings of the calibration and of this assessment, the heaviest first.
    pub findings: Vec<Finding>,
    /// Observations and frames that do not fit.
    pub outliers: Outliers,
    /// Systematic parts of the residuals.
    pub patterns: Patterns,
    /// Standard deviations of reconstructed points; `None` if the camera is fixed, not determined or not
    /// converged.
    pub object_space: Option<ObjectSpace>,
    /// Further board that would help most; `None` in the same cases, or if none helps.
    pub next_board: Option<NextBoard>,
}

impl Assessment {
    /// Adds findings about the input of the calibration, which affect the verdict.
    pub fn add(&mut self, findings: Vec<Finding>) {
        self.findings.extend(findings);
        finding::sort(&mut self.findings);
        self.verdict = Verdict::of(&self.findings);
    }
}

/// Assesses a calibration made with this board.
///
/// Fails if the camera cannot be evaluated, which does not happen for a camera from `calibrate`.
pub fn assess(calibration: &Calibration, board: &Board) -> Result<Assessment> {
    let _span = tracing::info_span!("assessment").entered();
    let outliers = outliers(calibration);
    let patterns = patterns(calibration)?;
    let findings = findings(calibration, &outliers, &patterns);
    let verdict = Verdict::of(&findings);
    let uncertainty = &calibration.uncertainty;
    let known = calibration.converged
        && calibration.options.mode != Mode::PosesOnly
        && !uncertainty.free_intrinsics.is_empty()
        && uncertainty.rank == uncertainty.size();
    let object_space = if known { object_space(calibration, board)? } else { None };
    let next_board = match &object_space {
        Some(space) => next_board(calibration, board, space)?,
        None => None,
    };
    Ok(Assessment { verdict, findings, outliers, patterns, object_space, next_board })
}
