//! The report of detected features.

use super::tree::{Cell, Column, Part, Section, Table};
use crate::detection::{DetectedBoards, DetectedFrame};

/// Returns the report of the boards of a subset: found and dropped features of each frame.
#[must_use]
pub fn detection_section(subset: &str, boards: &DetectedBoards) -> Section {
    let frames = &boards.frames;
    let features: usize = frames.iter().map(DetectedFrame::features).sum();
    let with_features = frames.iter().filter(|frame| frame.features() > 0).count();
    let found = format!("{features} features in {with_features} of {} frames.", frames.len());
    let mut of_frames = vec![Part::Table(frames_table(frames))];
    of_frames.extend(Part::paragraphs(COLUMNS));
    let parts = vec![Part::Text(found), Part::details("Frame by frame", of_frames)];
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

/// Meaning of the columns.
const COLUMNS: &str = "\
Corners: corner observations found in single micro-images. Board: labelled corners.
Dropped: alone (in no cluster), off the line of their cluster, texture (a large cluster with few corners on a line), off the \
board.
Searched for again at the predicted positions: board corners lost; micro-images unclear, with the corner misplaced, or of a \
corner given up.";
