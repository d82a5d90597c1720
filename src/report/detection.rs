//! Detected features.

use super::tree::{Cell, Column, Figure, Part, Section, Table};
use crate::detection::{DetectedBoards, DetectedFrame};

/// Number of frames whose figures are shown at once; the others are shown on demand.
const FRAMES_SHOWN: usize = 1;

/// The boards of a subset: what was found and what was dropped in each frame, and figures of frames.
#[must_use]
pub fn detection_section(subset: &str, boards: &DetectedBoards, figures: Vec<Figure>) -> Section {
    let mut parts = vec![Part::Table(frames_table(&boards.frames))];
    parts.extend(Part::paragraphs(&dropped_text(&boards.frames)));
    let mut figures = figures.into_iter().map(Part::Figure);
    parts.extend(figures.by_ref().take(FRAMES_SHOWN));
    let others: Vec<Part> = figures.collect();
    if !others.is_empty() {
        parts.push(Part::Details { summary: "The other frames".to_owned(), parts: others });
    }
    let section = Section::new(&format!("Boards: {subset}"), parts);
    Section { warnings: boards.findings.iter().map(ToString::to_string).collect(), ..section }
}

fn frames_table(frames: &[DetectedFrame]) -> Table {
    let counts = [
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
    let frame_and_image = [Column::number("Frame"), Column::text("Image")];
    let mut table =
        Table::new("Frame by frame", frame_and_image.into_iter().chain(counts.map(Column::number)));
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
        let frame_and_image = [frame.frame.into(), frame.name.as_str().into()];
        table.push(frame_and_image.into_iter().chain(numbers.map(Cell::from)));
    }
    table
}

/// What the columns mean.
fn dropped_text(frames: &[DetectedFrame]) -> String {
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
