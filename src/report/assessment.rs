//! The verdict on a calibration, outlying features, and the σ of points.

use super::summary::summary_parts;
use super::tree::{Cell, Column, Part, Section, Table, sentence};
use crate::assessment::{Assessment, Evaluation, NextBoard, ObjectSpace, Verdict};
use crate::calibration::{Calibration, OutlyingFeature};
use crate::finding::{Finding, Severity};
use crate::quantity::two_digits;

/// Outlying features that are named one by one.
const NAMED: usize = 5;

/// The verdict with its reasons, and what to do next: a line each.
pub(super) fn verdict_lines(findings: &[Finding], next: Option<&NextBoard>) -> Vec<String> {
    let mut lines = vec![match Verdict::of(findings) {
        Verdict::Good => "Verdict: good. Nothing speaks against this calibration.".to_owned(),
        verdict => format!("Verdict: {verdict}, because"),
    }];
    let reasons = findings.iter().filter(|f| f.severity > Severity::Note).enumerate();
    lines
        .extend(reasons.map(|(i, reason)| format!("{}. {}", i + 1, sentence(&reason.to_string()))));
    lines.extend(next.map(next_text));
    lines
}

pub(super) fn next_text(next: &NextBoard) -> String {
    let [x, y] = next.tilt_deg;
    let tilt = match (x == 0.0, y == 0.0) {
        (true, true) => "parallel to the sensor".to_owned(),
        (false, _) => format!("tilted by {x:+.0} degrees about the horizontal axis"),
        (_, false) => format!("tilted by {y:+.0} degrees about the vertical axis"),
    };
    let [before, after] = next.largest_mm;
    format!(
        "Next: of the boards tried, one at {:.0} mm {}, {tilt}, would help most: it would lower the \
         largest σ in space from {} to {} mm.",
        next.distance_mm,
        next.place,
        two_digits(before),
        two_digits(after)
    )
}

/// Features far from where they are expected: how many, and the worst.
#[must_use]
pub fn outliers_text(assessment: &Assessment) -> Vec<String> {
    let outlying = &assessment.outliers.features;
    if outlying.is_empty() {
        return Vec::new();
    }
    let one = |o: &OutlyingFeature| {
        let f = &o.residual.feature;
        format!(
            "frame {}, corner {}, micro-lens ({}, {}): {:.2} px off, {:.0} σ",
            f.frame, f.corner, f.k, f.l, o.distance_px, o.std_devs
        )
    };
    let named: Vec<String> = outlying.iter().take(NAMED).map(one).collect();
    let which = if outlying.len() > NAMED { "the worst" } else { "they are" };
    vec![format!("{} outlying feature(s); {which}: {}.", outlying.len(), named.join("; "))]
}

/// σ of reconstructed points by distance.
pub(super) fn object_space_table(space: &ObjectSpace) -> Table {
    let mut table = Table::new(
        "σ of a reconstructed point against the boards, median and worst over the image: due to the calibration, and due \
         to the noise of one observation of it",
        [
            Column::of("Distance", "mm"),
            Column::of("± across", "mm"),
            Column::number("worst"),
            Column::of("± along", "mm"),
            Column::number("worst"),
            Column::number("Noise across"),
            Column::number("Noise along"),
        ],
    );
    for distance in space.distances.iter().filter(|d| d.within_boards) {
        let [[across, along], [worst_across, worst_along]] = distance.summary_mm();
        let [noise_across, noise_along] = distance.noise_mm();
        let numbers = [across, worst_across, along, worst_along, noise_across, noise_along];
        let distance = Cell::fixed(distance.distance_mm, 1);
        table.push([distance].into_iter().chain(numbers.map(Cell::two_digits)));
    }
    table
}

/// The verdict that findings lead to, as a section of its own.
#[must_use]
pub fn verdict_section(findings: &[Finding], next: Option<&NextBoard>) -> Section {
    Section::new("Verdict", verdict_lines(findings, next).into_iter().map(Part::Text).collect())
}

/// The result of a calibration on one screen: the verdict on these findings, the main parameters, errors, σ in space, what an
/// evaluation has found, and what to do next.
#[must_use]
pub fn result_section(
    calibration: &Calibration,
    assessment: &Assessment,
    findings: &[Finding],
    evaluation: Option<&Evaluation>,
) -> Section {
    let mut verdict = verdict_lines(findings, None);
    let more = verdict.len().saturating_sub(1 + MOST_REASONS);
    if more > 0 {
        verdict.truncate(1 + MOST_REASONS);
        verdict.push(format!("and {more} more, in the report and with --tables."));
    }
    let mut parts: Vec<Part> = verdict.into_iter().map(Part::Text).collect();
    parts.extend(summary_parts(calibration, assessment, evaluation));
    parts.extend(assessment.next_board.as_ref().map(next_text).map(Part::Text));
    Section::new("Result", parts)
}

/// Reasons of a verdict that are listed on one screen.
const MOST_REASONS: usize = 5;
