//! The second pass: every corner of the board where its line, or that of its neighbours, expects it.

use nalgebra::{Matrix2, Matrix4, Vector2, Vector3};
use rayon::prelude::*;

use super::aberration::Aberration;
use super::blur::{Blur, Rays};
use super::board::LabelledBoard;
use super::corner::Corner;
use super::corner_fit::Free;
use super::distortion::Distortion;
use super::edge_width::{EdgeWidth, WidthChange};
use super::first_pass::{LEAST_CONTRAST, REACH};
use super::frame::{Frame, FrameCounts, MARGIN};
use super::grouping::Group;
use super::levers::{ByTaken, Levers, STEPS};
use super::line::possible_slope;
use super::patch::{Pair, Patch};
use super::seen::Seen;
use super::slope_field::SlopeField;
use super::{CornerLine, CornerObservation, MicroOptics};
#[cfg(doc)]
use crate::model::BapFeature;
use crate::model::TAKEN;
use crate::numerics::median;

/// Rounds in which every corner is searched for; in the second one its line is that of the first.
const ROUNDS: usize = 2;
/// How far from where it is expected a corner is found, px.
const EXPECTED_PX: f64 = 1.2;
/// The first round looks at one pixel of so many, and for the widths of edges at one observation of so many: it tells how all
/// corners of the frame are blurred.
const ROUGH_PIXELS: usize = 3;
const ROUGH_WIDTHS: i32 = 4;
/// One pixel of so many shows how a corner depends on what is taken from white images: that is summed over all corners.
const FEW: usize = 5;
/// Boards with edges that are wider than this, px², are not sharp enough to be found.
const MOST_WIDER_PX2: f64 = 9.0;
/// Least part of the light of its micro-image that a corner explains.
const EXPLAINED: f64 = 0.4;
/// Largest median imbalance of its observations, see [`Corner::imbalance`].
const IMBALANCE: f64 = 0.5;
/// Largest standard deviation of an observation, px.
const UNCERTAIN_PX: f64 = 0.35;
/// Corners are not searched for nearer than this, px, to where none of their light arrives.
const EDGE_PX: f64 = 0.15;
/// Observations further than this many root mean square distances from their line are misplaced; the
/// distance is not taken below the second number, px.
const OUTLIER: f64 = 4.0;
const LEAST_RMS_PX: f64 = 0.08;

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

/// A corner of the board that was searched for: what was seen of it, without what is off its line.
struct Sought {
    corner: i32,
    seen: Vec<Seen>,
}

/// What the second pass finds in a frame.
pub(super) struct SecondPassed {
    /// The corners of the board with all their observations.
    pub corners: Vec<BoardCorner>,
    /// The aberrations that were taken out of them.
    pub aberration: Aberration,
    /// Variance along an axis by which edges are wider than blur and pixels make them, px².
    pub wider_px2: f64,
    /// What is left of the fill factor and of that, by the edges of all corners, if these determine it.
    pub width: Option<WidthChange>,
}

/// What came of the search for a board corner, in numbers of micro-images that should show it.
struct Outcome {
    found: Option<Sought>,
    unclear: usize,
    misplaced: usize,
    given_up: usize,
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
        let mut corners: Vec<BoardCorner> =
            groups.iter().zip(&labelled.corners).filter_map(of_group).collect();
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
            let pass = SecondPass {
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
            let widths: Vec<EdgeWidth> =
                found.iter().flat_map(|s| &s.seen).filter_map(|seen| seen.width).collect();
            width = WidthChange::fit(&widths, wider_px2);
            if let Some(width) = width.filter(|width| !last && width.edges_differ()) {
                let least = -self.search.micro_images.point_spread_px2();
                wider_px2 = (wider_px2 + width.change.y).clamp(least, MOST_WIDER_PX2);
            }
            corners.clear();
            for sought in found {
                let seen = sought.seen.len();
                match pass.on_line(sought, &change) {
                    Some(corner) => corners.push(corner),
                    None => counts.given_up += seen,
                }
            }
        }
        // There are none if there was no round.
        corners.retain(|c| !c.observations.is_empty());
        let is_lost = |corner: &&i32| corners.iter().all(|c| c.corner != **corner);
        counts.lost = at_first.iter().filter(is_lost).count();
        counts.board_corners = corners.len();
        SecondPassed { corners, aberration, wider_px2, width }
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

struct SecondPass<'a> {
    frame: &'a Frame<'a>,
    labelled: &'a LabelledBoard,
    field: &'a SlopeField,
    distortion: &'a Distortion,
    /// Of the frame.
    contrast: f64,
    /// As far as it is known.
    aberration: Aberration,
    /// See [`SecondPassed::wider_px2`].
    wider_px2: f64,
    /// Whether this is the last round.
    last: bool,
}

impl SecondPass<'_> {
    /// Searches for a corner in every micro-image that should show it.
    fn search(&self, sought: &BoardCorner) -> Outcome {
        let micro_images = self.frame.search.micro_images;
        let (pinhole, slope) = (sought.line.pinhole(), sought.line.slope);
        let lit = |optics: MicroOptics| optics.lit_px(optics.blur_radius_px(slope));
        let largest = micro_images.all_optics_at(&pinhole).map(lit).fold(0.0, f64::max);
        let nodes = micro_images.about(&pinhole, largest / (1.0 - slope).abs());
        let places = nodes.iter().map(|&(k, l)| micro_images.center(k, l));
        let reach = REACH * micro_images.grid.pitch_px;
        let pair = Pair::about(self.frame.image, self.frame.white, places, reach);
        let (mut observations, mut imbalances, mut unclear) = (Vec::new(), Vec::new(), 0);
        for node in nodes {
            let center = micro_images.center(node.0, node.1);
            let optics = micro_images.optics(node.0, node.1);
            let expected = sought.line.at(&center) - center;
            let rho = optics.blur_radius_px(slope);
            if expected.norm() > optics.lit_px(rho) - EDGE_PX {
                continue;
            }
            let vignetting = micro_images.vignetting(&optics);
            let bend = self.aberration.bend(&center, slope);
            let blur = Blur::new(&optics, slope, bend, vignetting).wider(self.wider_px2);
            let fitted = pair.patch(micro_images, node).ok().and_then(|patch| {
                let patch = if self.last { patch } else { patch.thinned(ROUGH_PIXELS) };
                let start = self.expected_corner(sought, &center, patch.mean());
                let rays = blur.rays(&patch);
                let mut corner = self.fitted(&start, &patch, &rays)?;
                let fitted = (&patch, &rays, slope);
                let (mut levers, inverse) = corner.levers(&patch, &rays, slope, &bend)?;
                let has_width = self.last || (node.0 + node.1).rem_euclid(ROUGH_WIDTHS) == 0;
                let width = if has_width {
                    let (width, off) =
                        self.by_few(&corner, fitted, (&optics, &blur), (&mut levers, &inverse))?;
                    corner.place += off;
                    Some(width)
                } else {
                    None
                };
                if (corner.place - start.place).norm() > EXPECTED_PX {
                    return None;
                }
                Some((corner, levers, width, corner.imbalance(&patch, &rays)))
            });
            let Some((corner, levers, width, imbalance)) = fitted else {
                unclear += 1;
                continue;
            };
            imbalances.extend(imbalance);
            observations.push(Seen {
                observation: self.frame.observation(node, &corner),
                slope_before: slope,
                levers,
                width,
                corner,
            });
        }
        // The outer corners of the board look like corners in some micro-images, but not in most.
        let is_corner = median(imbalances).is_some_and(|median| median < IMBALANCE);
        let all = observations.len();
        let found = if is_corner { Sought::near_line(sought, observations) } else { None };
        let kept = found.as_ref().map_or(0, |found| found.seen.len());
        let (misplaced, given_up) = if found.is_some() { (all - kept, 0) } else { (0, all) };
        Outcome { found, unclear, misplaced, given_up }
    }

    /// What a few pixels of a corner say of the width of its edges, and by how much its place is off, px; and, in the last
    /// round, its levers by what is taken from white images.
    fn by_few(
        &self,
        corner: &Corner,
        (patch, rays, slope): (&Patch, &Rays, f64),
        (optics, blur): (&MicroOptics, &Blur),
        (levers, inverse): (&mut Levers, &Matrix4<f64>),
    ) -> Option<(EdgeWidth, Vector2<f64>)> {
        let step = if self.last { FEW } else { FEW.div_ceil(ROUGH_PIXELS) };
        let (few, rays) = (patch.thinned(step), rays.thinned(step));
        let share = few.sum_of_weights() / patch.sum_of_weights();
        if self.last {
            let others: [Rays; TAKEN] = std::array::from_fn(|taken| {
                let (optics, vignetting) = self.frame.search.micro_images.otherwise(optics, taken);
                let blur = Blur::new(&optics, slope, blur.bend, vignetting);
                blur.wider(self.wider_px2).rays(&few)
            });
            levers.by_taken = corner.by_taken(&few, &rays, &others, inverse, share);
        }
        let summed = blur.summed(corner, &few);
        let by_fill_px = optics.blur_by_fill_px(slope);
        EdgeWidth::of(corner, &few, &rays, &summed, by_fill_px, (inverse, share))
    }

    /// A corner as it should show in the micro-image about `center`, whose mean light is `level`.
    fn expected_corner(&self, sought: &BoardCorner, center: &Vector2<f64>, level: f64) -> Corner {
        let (pinhole, nearness) = (sought.line.pinhole(), 1.0 - sought.line.slope);
        // Towards the next corner the slope changes, and with it the magnification.
        let seen = |step: &Vector2<f64>| {
            step * nearness - (pinhole - center) * self.field.gradient().dot(step)
        };
        // Rows and columns of the board in the pinhole image.
        let board = self.frame.search.board;
        let (right, down) = self.labelled.steps(board, sought.corner);
        let sheared = self.distortion.jacobian(&self.labelled.pinhole(board, sought.corner));
        let (right, down) = (seen(&(sheared * right)), seen(&(sheared * down)));
        Corner {
            place: sought.line.at(center) - center,
            angles: [right.y.atan2(right.x), down.y.atan2(down.x)],
            level,
            contrast: if self.is_even(sought.corner) { self.contrast } else { -self.contrast },
            width: 1.0,
            covariance: Matrix2::zeros(),
            explained: 0.0,
        }
    }

    /// Squares alternate: those after an even corner are dark, see [`LabelledBoard::label`].
    fn is_even(&self, corner: i32) -> bool {
        let columns = self.frame.search.board.columns;
        (corner / columns + corner % columns) % 2 == 0
    }

    /// The corner where it is expected; `None` if it does not clearly show there.
    fn fitted(&self, expected: &Corner, patch: &Patch, rays: &Rays) -> Option<Corner> {
        expected.fitted(patch, rays, Free::Place).filter(|corner| {
            (corner.place - expected.place).norm() < EXPECTED_PX
                && corner.explained > EXPLAINED
                && (corner.contrast > 0.0) == (expected.contrast > 0.0)
                && corner.contrast.abs() > LEAST_CONTRAST * self.contrast
                && corner.std_dev_px() < UNCERTAIN_PX
        })
    }

    /// A corner with its line, once the aberrations are known better.
    fn on_line(&self, found: Sought, change: &Vector3<f64>) -> Option<BoardCorner> {
        let Sought { corner, mut seen } = found;
        for seen in &mut seen {
            seen.change_aberration(change);
        }
        let line = CornerLine::fit(seen.iter().map(Seen::on_line))?;
        if self.last {
            // With other places the line has another slope, and that blurs otherwise.
            for (taken, step) in STEPS.into_iter().enumerate() {
                let other = CornerLine::fit(seen.iter().map(|seen| seen.on_line_with(taken)))?;
                let slope = (other.slope - line.slope) / step;
                for seen in &mut seen {
                    seen.take_slope(taken, slope);
                }
            }
        }
        for seen in &mut seen {
            seen.change_slope(line.slope);
        }
        let observations = seen
            .into_iter()
            .map(|seen| Found {
                observation: seen.observation,
                corner: seen.corner,
                by_taken: seen.levers.by_taken,
                width: seen.width,
            })
            .collect();
        let possible = possible_slope(line.slope, self.frame.search.micro_images.configuration);
        possible.then_some(BoardCorner { corner, line, observations })
    }
}

impl Sought {
    /// What was seen of a corner, without what is off its line.
    fn near_line(sought: &BoardCorner, mut seen: Vec<Seen>) -> Option<Self> {
        let line = CornerLine::fit(seen.iter().map(Seen::on_line))?;
        let scale = line.rms_px.max(LEAST_RMS_PX);
        seen.retain(|seen| {
            let o = seen.on_line();
            (o.position - line.at(&o.center)).norm() < OUTLIER * scale
        });
        (seen.len() > 1).then_some(Self { corner: sought.corner, seen })
    }
}
