//! The second pass: every corner of the board where its line, or that of its neighbours, expects it.

use rayon::prelude::*;

use super::aberration::Aberration;
use super::board::LabelledBoard;
use super::corner::Corner;
use super::corner_search::{CornerSearch, Outcome, Sought};
use super::distortion::Distortion;
use super::edge_width::{EdgeWidth, WidthChange};
use super::features::{DetectedCorner, Detection};
use super::frame::{Frame, FrameCounts, MARGIN};
use super::grouping::Group;
use super::levers::ByTaken;
use super::slope_field::SlopeField;
use super::{CornerLine, CornerObservation};
#[cfg(doc)]
use crate::model::BapFeature;

/// Rounds in which every corner is searched for; in the second one its line is that of the first.
const ROUNDS: usize = 2;
/// Boards with edges that are wider than this, px², are not sharp enough to be found.
const MOST_WIDER_PX2: f64 = 9.0;

/// A corner of the board with its line and, once it was searched for, its observations.
#[derive(Clone)]
pub(super) struct BoardCorner {
    pub corner: i32,
    pub line: CornerLine,
    pub observations: Vec<Found>,
}

/// What was found of it in a micro-image.
#[derive(Clone)]
pub(super) struct Found {
    pub observation: CornerObservation,
    pub corner: Corner,
    /// How the place changes with what is taken from white images, px: see [`BapFeature::levers_px`].
    pub by_taken: ByTaken,
    /// What its edges say of the blur.
    pub width: Option<EdgeWidth>,
}

/// What the second pass finds in a frame.
pub(super) struct SecondPassed {
    /// The corners of the board with all their observations.
    pub corners: Vec<BoardCorner>,
    /// The aberrations that were taken out of them.
    pub aberration: Aberration,
    /// That of the frame.
    pub contrast: f64,
    /// Variance along an axis by which edges are wider than blur and pixels make them, px².
    pub wider_px2: f64,
    /// What is left of the fill factor and of that, by the edges of all corners, if these determine it.
    pub width: Option<WidthChange>,
}

impl Frame<'_> {
    /// Searches for all corners of the board.
    pub(super) fn second_pass(
        &self,
        groups: &[Group],
        labelled: &LabelledBoard,
        contrast: f64,
        counts: &mut FrameCounts,
    ) -> SecondPassed {
        let of_group = |(group, corner): (&Group, &Option<i32>)| {
            Some(BoardCorner { corner: (*corner)?, line: group.line, observations: Vec::new() })
        };
        let corners = groups.iter().zip(&labelled.corners).filter_map(of_group).collect();
        self.rounds(corners, labelled, contrast, counts)
    }

    /// The same for corners that were found with other micro-images.
    pub(super) fn second_pass_again(
        &self,
        found: &Detection,
        labelled: &LabelledBoard,
        counts: &mut FrameCounts,
    ) -> SecondPassed {
        let of_corner = |found: &DetectedCorner| BoardCorner {
            corner: found.corner,
            line: found.line,
            observations: Vec::new(),
        };
        let corners = found.corners.iter().map(of_corner).collect();
        self.rounds(corners, labelled, found.contrast, counts)
    }

    fn rounds(
        &self,
        mut corners: Vec<BoardCorner>,
        labelled: &LabelledBoard,
        contrast: f64,
        counts: &mut FrameCounts,
    ) -> SecondPassed {
        let at_first: Vec<i32> = corners.iter().map(|c| c.corner).collect();
        let (middle, pupil) = (self.search.sensor.center_px(), self.search.micro_images.pupil_px());
        let mut aberration = Aberration::none(middle, pupil);
        let (mut wider_px2, mut width) = (0.0, None);
        for round in 1..=ROUNDS {
            let lines: Vec<CornerLine> = corners.iter().map(|c| c.line).collect();
            let Some(field) = SlopeField::fit(&lines) else { break };
            let pinholes =
                |c: &BoardCorner| (labelled.pinhole(self.search.board, c.corner), c.line.pinhole());
            let pinholes: Vec<_> = corners.iter().map(pinholes).collect();
            let distortion = &Distortion::fit(&pinholes, middle);
            corners.extend(self.missing(&corners, labelled, &field));
            let (field, last) = (&field, round == ROUNDS);
            let pass = CornerSearch {
                frame: self,
                labelled,
                field,
                distortion,
                contrast,
                aberration,
                wider_px2,
                last,
            };
            let outcomes: Vec<Outcome> = corners.par_iter().map(|c| pass.search(c)).collect();
            // Those of the last round count.
            counts.unclear = outcomes.iter().map(|o| o.unclear).sum();
            counts.misplaced = outcomes.iter().map(|o| o.misplaced).sum();
            counts.given_up = outcomes.iter().map(|o| o.given_up).sum();
            let mut found: Vec<Sought> = outcomes.into_iter().filter_map(|o| o.found).collect();
            found.sort_by_key(|c| c.corner);
            let all = found.iter().map(|sought| sought.seen.as_slice());
            let change = aberration.change(all).unwrap_or_default();
            aberration = aberration.changed(&change);
            corners.clear();
            for sought in found {
                let seen = sought.seen.len();
                match pass.on_line(sought, &change) {
                    Some(corner) => corners.push(corner),
                    None => counts.given_up += seen,
                }
            }
            let observations = corners.iter().flat_map(|c| &c.observations);
            let widths: Vec<EdgeWidth> = observations.filter_map(|found| found.width).collect();
            width = WidthChange::fit(&widths, wider_px2);
            if let Some(width) = width.filter(|width| !last && width.edges_differ()) {
                let least = -self.search.micro_images.point_spread_px2();
                wider_px2 = (wider_px2 + width.change.y).clamp(least, MOST_WIDER_PX2);
            }
        }
        // There are none if there was no round.
        corners.retain(|c| !c.observations.is_empty());
        let is_lost = |corner: &&i32| corners.iter().all(|c| c.corner != **corner);
        counts.lost += at_first.iter().filter(is_lost).count();
        counts.board_corners = corners.len();
        SecondPassed { corners, aberration, contrast, wider_px2, width }
    }

    /// Corners in view that are not among some, on the lines that these lead to expect.
    fn missing(
        &self,
        corners: &[BoardCorner],
        labelled: &LabelledBoard,
        field: &SlopeField,
    ) -> Vec<BoardCorner> {
        let board = self.search.board;
        (0..board.corners())
            .filter(|corner| corners.iter().all(|c| c.corner != *corner))
            .map(|corner| (corner, labelled.pinhole(board, corner)))
            .filter(|(_, p)| self.in_view(p, MARGIN))
            .map(|(corner, p)| BoardCorner {
                corner,
                line: CornerLine::through(&p, field.at(&p)),
                observations: Vec::new(),
            })
            .collect()
    }
}
