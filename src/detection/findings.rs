//! Findings about a set of images of boards.

use super::edge_width::{MOVED, MOVED_PX2};
use super::flat_field::unlike;
use super::{DetectedFrame, MicroImages};
use crate::checks::boards as checks;
use crate::finding::{Finding, Issue};
use crate::model::{Board, Subset};
use crate::quantity::Estimate;

/// Returns findings about frames that are left out or blurred, and about a doubtful board.
pub(super) fn findings(frames: &[DetectedFrame], board: &Board, subset: Subset) -> Vec<Finding> {
    let left_out = |frame: &DetectedFrame| {
        let why = frame.result.as_ref().err()?.clone();
        Some(Finding::left_out(frame.frame, Some(&frame.name), why))
    };
    // These come first, since other light may be the reason why frames are left out.
    let compared = frames
        .iter()
        // An image without a board, such as a white image, need not be of the same exposure.
        .filter(|f| !matches!(f.result, Err(Issue::Uniform)))
        .filter_map(|f| Some((f.frame, f.name.as_str(), f.likeness.as_ref()?)));
    let mut findings = unlike(&compared.collect::<Vec<_>>());
    let few_levels = frames.iter().filter_map(|f| Some((f.frame, f.few_levels?)));
    findings.extend(checks::few_levels(&few_levels.collect::<Vec<_>>()));
    findings.extend(frames.iter().filter_map(left_out));
    let found = || frames.iter().filter_map(|f| Some((f, f.result.as_ref().ok()?)));
    if found().next().is_none() {
        return findings;
    }
    let shifted: Vec<u32> =
        found().filter_map(|(frame, detection)| detection.elsewhere.map(|_| frame.frame)).collect();
    findings.extend(
        (!shifted.is_empty()).then(|| Finding::note(Issue::ShiftedNumbers { frames: shifted })),
    );
    findings.extend(checks::enough(found().count(), subset));
    let widths: Vec<(u32, &str, Estimate)> = found()
        .filter_map(|(frame, detection)| {
            Some((frame.frame, frame.name.as_str(), detection.edges?.spread_px2))
        })
        .collect();
    findings.extend(checks::motion_blur(&widths, (MOVED_PX2, MOVED)));
    let corners: Vec<Vec<i32>> =
        found().map(|(_, found)| found.corners.iter().map(|c| c.corner).collect()).collect();
    findings.extend(checks::all_sides(&corners, board));
    findings
}

/// Returns a finding if boards show another aperture ratio than the boards of the calibration, with which their corners were
/// fitted.
pub(super) fn of_other_boards(found: &Estimate, micro_images: &MicroImages) -> Option<Finding> {
    checks::aperture_ratio(micro_images.aperture_ratio(), micro_images.settled()?, *found)
}

#[cfg(test)]
mod tests {
    use super::super::micro_images::tests::micro_images;
    use super::*;
    use crate::model::at_most_full;

    /// Checks that the ratio shown by other boards is limited to 1, and that both σ count.
    #[test]
    fn boards_may_show_another_aperture_ratio_than_those_for_calibration() {
        let of = |value: f64, std_dev: f64| Estimate { value, std_dev };
        let told = |known: Estimate, found: Estimate| {
            of_other_boards(&found, &micro_images(16.0).settled_at(&known))
        };
        let (wide, narrow) = (of(1.04, 0.004), of(0.93, 0.004));
        assert_eq!(told(at_most_full(&wide), wide), None);
        assert_eq!(told(of(1.02, 0.001), wide), None);
        assert!(told(of(1.02, 0.001), narrow).is_some());
        assert_eq!(told(narrow, of(0.945, 0.004)), None);
        let finding = told(narrow, of(0.96, 0.004)).unwrap();
        assert_eq!(finding.code(), "aperture-ratio-of-other-boards");
        assert!(finding.to_string().contains("give 0.9600 ± 0.0040"), "{finding}");
        assert_eq!(of_other_boards(&narrow, &micro_images(16.0)), None);
    }
}
