//! Detected features.

use super::table::{Table, table};
use crate::detection::{DetectedBoards, DetectedFrame};

/// What was found and what was dropped in each frame.
#[must_use]
pub fn detection_text(frames: &[DetectedFrame]) -> String {
    format!("{}\n\n{}", detection_table(frames), dropped_text(frames))
}

pub(super) fn detection_table(frames: &[DetectedFrame]) -> Table {
    let header = [
        "Frame",
        "Image",
        "Micro-images",
        "Corners",
        "Clusters",
        "Board",
        "Features",
        "Alone",
        "Off line",
        "Texture",
        "Off board",
        "Lost",
        "Unclear",
        "Misplaced",
        "Given up",
    ];
    let mut text = table(&header, &[1]);
    for frame in frames {
        let c = &frame.counts;
        let numbers = [
            c.looked_at - c.unusable,
            c.corners,
            c.clusters,
            c.board_corners,
            frame.features(),
            c.alone,
            c.off_line,
            c.texture,
            c.off_board,
            c.lost,
            c.unclear,
            c.misplaced,
            c.given_up,
        ];
        let mut cells = vec![frame.frame.to_string(), frame.name.clone()];
        cells.extend(numbers.iter().map(ToString::to_string));
        text.add_row(cells);
    }
    text
}

/// What the columns mean.
pub(super) fn dropped_text(frames: &[DetectedFrame]) -> String {
    let features: usize = frames.iter().map(DetectedFrame::features).sum();
    let with_features = frames.iter().filter(|frame| frame.features() > 0).count();
    format!(
        "{features} features in {with_features} of {} frames. Corners: corner observations found in \
         single micro-images. Board: labelled corners.\nDropped: alone (in no cluster), off the line of \
         their cluster, texture (a large cluster with hardly a line), off the board.\nSearched for again \
         where they are expected: board corners lost; micro-images unclear, with the corner misplaced, \
         or of a corner given up.",
        frames.len()
    )
}
