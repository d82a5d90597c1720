//! The verdict on a calibration, outliers among the features, and the σ of points.

use std::collections::BTreeSet;

use super::figures::OF_RESULT;
use super::summary::summary_parts;
use super::tree::{Cell, Column, Figure, Part, Section, Table, sentence};
use crate::assessment::{Assessment, Evaluation, NextBoard, ObjectSpace, Verdict};
use crate::calibration::{Calibration, OutlyingFeature};
use crate::finding::{Finding, Severity, Subject};
use crate::quantity::{counted, two_digits};

/// Largest number of outliers, and of frames left out, that are named one by one.
const NAMED: usize = 5;

/// Returns the verdict with its first `most` reasons, one line each.
pub(super) fn verdict_parts(findings: &[Finding], most: usize) -> Vec<Part> {
    let verdict = Verdict::of(findings);
    let without = without_text(findings);
    let text = match verdict {
        Verdict::Good => {
            format!("Verdict: good{without}. No finding limits the use of this result.")
        }
        verdict => format!("Verdict: {verdict}{without}, because"),
    };
    let reasons: Vec<&Finding> = findings.iter().filter(|f| f.severity > Severity::Note).collect();
    let line = |(i, reason): (usize, &&Finding)| {
        Part::Text(format!("{}. {}", i + 1, sentence(&reason.to_string())))
    };
    let mut parts = vec![Part::Verdict { verdict, text }];
    parts.extend(reasons.iter().enumerate().take(most).map(line));
    if reasons.len() > most {
        let more = reasons.len() - most;
        parts.push(Part::Text(format!("and {more} more, in the report.")));
    }
    parts
}

/// Names the frames that are left out, as an addition to the verdict; nothing if all are used. Frames of different subsets may
/// have the same number, so their images name them.
fn without_text(findings: &[Finding]) -> String {
    let left_out = |finding: &Finding| match &finding.subject {
        Subject::Frame { frame, image, left_out: true } => {
            Some(image.clone().unwrap_or_else(|| format!("frame {frame}")))
        }
        _ => None,
    };
    let frames: BTreeSet<String> = findings.iter().filter_map(left_out).collect();
    match frames.len() {
        0 => String::new(),
        1..=NAMED => format!(" without {}", Vec::from_iter(frames).join(", ")),
        many => format!(" without {many} frames"),
    }
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
        "Next board: at {:.0} mm {}, {tilt}. Of the boards tried, it lowers the largest σ in space \
         most, from {} to {} mm.",
        next.distance_mm,
        next.place,
        two_digits(before),
        two_digits(after)
    )
}

/// Returns a text on the outliers among the features: their number, and the worst.
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
    let outlying = counted(outlying.len(), "outlying feature");
    vec![format!("{outlying}; {which}: {}.", named.join("; "))]
}

/// Returns the table of σ of reconstructed points, by distance.
pub(super) fn object_space_table(space: &ObjectSpace) -> Table {
    let mut table = Table::new(
        "σ of a reconstructed point relative to the boards, median and worst over the image: from \
         the calibration, and from the noise of one observation",
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

/// Returns the result of a calibration on one screen: the verdict from these findings, the main parameters, errors, σ in space,
/// the results of an evaluation, and the next step; with the figures of [`OF_RESULT`].
#[must_use]
pub fn result_section(
    calibration: &Calibration,
    assessment: &Assessment,
    findings: &[Finding],
    evaluation: Option<&Evaluation>,
    figures: &[Figure],
) -> Section {
    let of_name = |name: &str| figures.iter().find(|figure| figure.name == name).cloned();
    let beside = OF_RESULT.map(of_name);
    let mut parts = verdict_parts(findings, MOST_REASONS);
    parts.extend(summary_parts(calibration, assessment, evaluation, beside));
    parts.extend(assessment.next_board.as_ref().map(next_text).map(Part::Text));
    Section::new("Result", parts)
}

/// Largest number of reasons of a verdict that are listed on one screen.
const MOST_REASONS: usize = 5;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::finding::Issue;

    #[test]
    fn a_verdict_names_frames_that_are_left_out() {
        let text = |frames: &[u32], image: Option<&str>| {
            let left_out = |frame: &u32| Finding::left_out(*frame, None, Issue::Uniform);
            let mut findings: Vec<Finding> = frames.iter().map(left_out).collect();
            findings.extend(image.map(|image| Finding::left_out(4, Some(image), Issue::Uniform)));
            let Part::Verdict { text, .. } = &verdict_parts(&findings, 5)[0] else { panic!() };
            text.split(". ").next().unwrap().to_owned()
        };
        assert_eq!(text(&[], None), "Verdict: good");
        assert_eq!(text(&[4], None), "Verdict: good without frame 4");
        assert_eq!(text(&[7, 4, 4], None), "Verdict: good without frame 4, frame 7");
        // Frame 4 of another subset.
        assert_eq!(text(&[4], Some("e4.png")), "Verdict: good without e4.png, frame 4");
        assert_eq!(text(&[0, 1, 2, 3, 4, 5], None), "Verdict: good without 6 frames");
    }
}
