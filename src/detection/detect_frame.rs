//! Detection in one frame: its passes, and the checks of their results.

use std::time::Instant;

use nalgebra::Vector2;
use tracing::{debug, info, trace};

use super::CornerObservation;
use super::board::{LabelledBoard, LatticePoint};
use super::exposure::{contrast, count_unusable};
use super::features::Detection;
use super::first_pass::{FirstPass, groups};
use super::frame::{Frame, FrameCounts, MARGIN, Search};
use super::grouping::Group;
use super::second_pass::{ExpectedCorner, second_pass};
use crate::finding::Issue;
use crate::image::Grey;
use crate::model::MIN_CORNERS;

/// Number of corners along a side of the board, surely in view, of which one has to be found; and distance from the border, in
/// pitches, from which they are surely in view.
const SIDE: usize = 3;
const SURE_MARGIN: f64 = 2.5;
/// Largest part of the corners off the board, and smallest part of the corners in view that are found, for sure labels. With
/// labels of other squares, corners are left over on one side of the board and missing on the other.
const OFF_BOARD: f64 = 0.05;
const FOUND: f64 = 0.9;
/// Number and part of the labelled corners that the second pass loses if labels are wrong. In simulated frames with right
/// labels it lost two at most and less than a tenth; on a lattice with other rows than the board's it lost half.
const MANY_LOST: usize = 4;
const LOST: f64 = 0.25;
/// Detects the features of a frame, and counts what was found and dropped in it. Returns an error if it does not show the
/// board.
pub fn detect_frame(
    frame: u32,
    image: &Grey,
    white: &Grey,
    search: &Search,
) -> (Result<Detection, Issue>, FrameCounts) {
    let mut counts = FrameCounts::default();
    let begun = Instant::now();
    let result = detect(&Frame { frame, image, white, search }, &mut counts);
    match &result {
        Ok(detection) => info!(
            "frame {frame}: {} features of {} board corners in {:.3} s",
            detection.features.len(),
            counts.board_corners,
            begun.elapsed().as_secs_f64()
        ),
        Err(why) => info!("frame {frame}: left out, {why}"),
    }
    debug!("frame {frame}: {counts:?}");
    (result, counts)
}

fn detect(frame: &Frame, counts: &mut FrameCounts) -> Result<Detection, Issue> {
    let (image, white) = (frame.image.size(), frame.white.size());
    if image != white {
        return Err(Issue::SizesDiffer { image_px: image.into(), white_px: white.into() });
    }
    let nodes = frame.nodes();
    let contrast = contrast(frame, &nodes).inspect_err(|_| {
        counts.looked_at = nodes.len();
        counts.unusable = count_unusable(frame, &nodes);
    })?;
    let mut first = FirstPass::new(frame, &nodes, contrast);
    first.search_some();
    let found = of_board(frame, &first, counts);
    if let Ok((detection, true)) = found {
        return Ok(detection);
    }
    first.search_rest();
    of_board(frame, &first, counts).map(|(detection, _)| detection)
}

/// Detects the board in the micro-images that were searched. The flag is true if its labels are sure: few corners do not belong
/// to the board, and most of its own are found.
fn of_board(
    frame: &Frame,
    first: &FirstPass,
    counts: &mut FrameCounts,
) -> Result<(Detection, bool), Issue> {
    let FirstPass { observations, contrast, .. } = first;
    *counts = FrameCounts {
        looked_at: first.looked_at,
        unusable: first.unusable,
        corners: observations.len(),
        ..FrameCounts::default()
    };
    let groups = groups(frame, observations, counts);
    trace!("frame {}: contrast {contrast:.3}, {} lines", frame.frame, groups.len());
    let labelled = labelled_board(frame, observations, &groups, counts)?;
    let of_group =
        |(group, corner): (&Group, &Option<i32>)| Some(ExpectedCorner::new((*corner)?, group.line));
    let corners = groups.iter().zip(&labelled.corners).filter_map(of_group).collect();
    let passed = second_pass(frame, corners, &labelled, *contrast, counts);
    let corners = &passed.corners;
    check_sides(frame, &labelled, |corner| corners.iter().any(|c| c.corner == corner))?;
    if corners.len() < MIN_CORNERS {
        return Err(Issue::TooFewForPose { corners: corners.len(), fewest: MIN_CORNERS });
    }
    check_lost(counts.lost, labelled.corners.iter().flatten().count())?;
    let in_view =
        |corner: &i32| frame.in_view(&labelled.pinhole(frame.search.board, *corner), SURE_MARGIN);
    let in_view = (0..frame.search.board.corners()).filter(in_view).count();
    let is_sure = counts.off_board as f64 <= OFF_BOARD * counts.corners as f64
        && corners.len() as f64 >= FOUND * in_view as f64;
    let detection = Detection::new(frame, passed, &labelled);
    Ok((detection, is_sure))
}

/// Labels the pinhole images of groups with the corners of the board.
fn labelled_board(
    frame: &Frame,
    observations: &[CornerObservation],
    groups: &[Group],
    counts: &mut FrameCounts,
) -> Result<LabelledBoard, Issue> {
    let points: Vec<LatticePoint> = groups
        .iter()
        .map(|group| LatticePoint {
            place: group.line.pinhole(),
            squares: group.members.iter().map(|&i| observations[i].squares).sum(),
        })
        .collect();
    let in_view = |place: &Vector2<f64>| frame.in_view(place, MARGIN);
    let labelled = LabelledBoard::label(&points, frame.search.board, &in_view);
    let labelled = labelled.map_err(|reason| match counts.texture {
        0 => reason,
        corners => Issue::Texture { reason: Box::new(reason), corners },
    })?;
    let off_board = groups.iter().zip(&labelled.corners).filter(|(_, c)| c.is_none());
    counts.off_board = off_board.map(|(group, _)| group.members.len()).sum();
    Ok(labelled)
}

/// Returns an error if none of the corners along a side of the board was found, though it is in view.
fn check_sides(
    frame: &Frame,
    labelled: &LabelledBoard,
    found: impl Fn(i32) -> bool,
) -> Result<(), Issue> {
    let board = frame.search.board;
    let in_view = |corner: &i32| frame.in_view(&labelled.pinhole(board, *corner), SURE_MARGIN);
    let (columns, rows) = (board.columns, board.rows);
    let column = |c: i32| (0..rows).map(move |r| r * columns + c).collect::<Vec<i32>>();
    let row = |r: i32| (0..columns).map(move |c| r * columns + c).collect::<Vec<i32>>();
    let sides = [
        ("first column", column(0)),
        ("last column", column(columns - 1)),
        ("first row", row(0)),
        ("last row", row(rows - 1)),
    ];
    for (side, corners) in sides {
        let seen: Vec<i32> = corners.into_iter().filter(in_view).collect();
        if seen.len() >= SIDE && !seen.iter().any(|&corner| found(corner)) {
            return Err(Issue::SideMissing { side, columns, rows });
        }
    }
    Ok(())
}

/// Returns an error if so many labelled corners were lost that their labels are wrong.
fn check_lost(lost: usize, labelled: usize) -> Result<(), Issue> {
    if lost >= MANY_LOST && lost as f64 > LOST * labelled as f64 {
        return Err(Issue::LabelsLost { lost, labelled });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_are_wrong_where_many_corners_are_lost() {
        for (lost, labelled) in [(2, 28), (3, 6), (4, 16)] {
            assert_eq!(check_lost(lost, labelled), Ok(()));
        }
        for (lost, labelled) in [(4, 8), (4, 15), (14, 28)] {
            assert_eq!(check_lost(lost, labelled), Err(Issue::LabelsLost { lost, labelled }));
        }
    }
}
