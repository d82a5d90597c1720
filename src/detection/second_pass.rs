//! The second pass: every corner of the board where its line, or that of its neighbours, expects it, in all micro-images that
//! should show it.

use nalgebra::{Matrix2, Matrix4, Vector2, Vector3};
use rayon::prelude::*;

use super::aberration::Aberration;
use super::aberration_fit::aberration_change;
use super::blur::Blur;
use super::board::LabelledBoard;
use super::corner::{Corner, FitRoom, Free};
use super::corner_measurement::CornerMeasurement;
use super::corner_sensitivity::{ByTaken, OnEdges, Sensitivities, sensitivities};
use super::distortion::Distortion;
use super::edge_width::{EdgeWidth, WidthChange};
use super::first_pass::LEAST_CONTRAST;
use super::frame::{Frame, FrameCounts, MARGIN};
use super::line::{CornerLine, possible_slope};
use super::micro_images::STEPS;
use super::patch::{self, Patch};
use super::rays::Rays;
use super::slope_field::SlopeField;
use super::summed::summed;
use super::{CornerObservation, MicroOptics};
#[cfg(doc)]
use crate::model::BapFeature;
use crate::model::TAKEN;
use crate::numerics::median;

/// Rounds in which every corner is searched for; in the second one its line is that of the first.
const ROUNDS: usize = 2;
/// Boards with edges that are wider than this, px², are not sharp enough to be found.
const MOST_WIDER_PX2: f64 = 9.0;

/// How far from where it is expected a corner is found, px.
const EXPECTED_PX: f64 = 1.2;
/// The first round looks at one pixel of so many, and for the widths of edges at one observation of so many: it tells how all
/// corners of the frame are blurred.
const ROUGH_PIXELS: usize = 3;
const ROUGH_WIDTHS: i32 = 4;
/// One pixel of so many shows how a corner depends on what is taken from white images: that is summed over all corners.
const FEW: usize = 5;
/// Least part of the light of its micro-image that a corner explains.
const EXPLAINED: f64 = 0.4;
/// Largest median imbalance of its observations, see [`Corner::imbalance`].
const IMBALANCE: f64 = 0.5;
/// So many of them are enough for that.
const ENOUGH: usize = 16;
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
    /// How the place changes with what is taken from white images, px: see [`BapFeature::sensitivities_px`].
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
    /// What is left of the aperture ratio and of that, by the edges of all corners, if these determine it.
    pub width: Option<WidthChange>,
}

impl BoardCorner {
    /// One that is expected on a line, before it was searched for.
    pub fn expected(corner: i32, line: CornerLine) -> Self {
        Self { corner, line, observations: Vec::new() }
    }
}

/// Searches for all corners of the board: those with a line where it expects them, and the others where the lines of their
/// neighbours do.
pub(super) fn second_pass(
    frame: &Frame,
    mut corners: Vec<BoardCorner>,
    labelled: &LabelledBoard,
    contrast: f64,
    counts: &mut FrameCounts,
) -> SecondPassed {
    let at_first: Vec<i32> = corners.iter().map(|c| c.corner).collect();
    let (middle, pupil) = (frame.search.sensor.center_px(), frame.search.micro_images.pupil_px());
    let mut aberration = Aberration::none(middle, pupil);
    let (mut wider_px2, mut width) = (0.0, None);
    for round in 1..=ROUNDS {
        let lines: Vec<CornerLine> = corners.iter().map(|c| c.line).collect();
        let Some(field) = SlopeField::fit(&lines) else { break };
        let pinholes =
            |c: &BoardCorner| (labelled.pinhole(frame.search.board, c.corner), c.line.pinhole());
        let pinholes: Vec<_> = corners.iter().map(pinholes).collect();
        let distortion = &Distortion::fit(&pinholes, middle);
        corners.extend(missing(frame, &corners, labelled, &field));
        let (field, last) = (&field, round == ROUNDS);
        let pass = CornerSearch {
            frame,
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
        let change = aberration_change(&aberration, all).unwrap_or_default();
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
            let least = -frame.search.micro_images.point_spread_px2();
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
    frame: &Frame,
    corners: &[BoardCorner],
    labelled: &LabelledBoard,
    field: &SlopeField,
) -> Vec<BoardCorner> {
    let board = frame.search.board;
    (0..board.corners())
        .filter(|corner| corners.iter().all(|c| c.corner != *corner))
        .map(|corner| (corner, labelled.pinhole(board, corner)))
        .filter(|(_, p)| frame.in_view(p, MARGIN))
        .map(|(corner, p)| BoardCorner::expected(corner, CornerLine::through(&p, field.at(&p))))
        .collect()
}

/// A corner of the board that was searched for: what was seen of it, without what is off its line.
struct Sought {
    pub corner: i32,
    pub seen: Vec<CornerMeasurement>,
}

/// What came of the search for a board corner, in numbers of micro-images that should show it.
struct Outcome {
    pub found: Option<Sought>,
    pub unclear: usize,
    pub misplaced: usize,
    pub given_up: usize,
}

/// The search for corners of the board in a frame, in one round.
struct CornerSearch<'a> {
    pub frame: &'a Frame<'a>,
    pub labelled: &'a LabelledBoard,
    pub field: &'a SlopeField,
    pub distortion: &'a Distortion,
    /// Of the frame.
    pub contrast: f64,
    /// As far as it is known.
    pub aberration: Aberration,
    /// Variance along an axis by which edges are wider than blur and pixels make them, px².
    pub wider_px2: f64,
    /// Whether this is the last round.
    pub last: bool,
}

/// Room for one micro-image after the other.
#[derive(Default)]
struct Room {
    patch: Patch,
    reading: patch::Room,
    rays: Rays,
    fit: FitRoom,
    /// Some of the pixels, and their rays.
    few: Patch,
    few_rays: Rays,
    /// Those of them that see edges, and their rays if something taken from white images were otherwise.
    on_edges: OnEdges,
    others: [Rays; TAKEN],
}

impl CornerSearch<'_> {
    /// Searches for a corner in every micro-image that should show it.
    pub fn search(&self, sought: &BoardCorner) -> Outcome {
        let micro_images = self.frame.search.micro_images;
        let (pinhole, slope) = (sought.line.pinhole(), sought.line.slope);
        let lit = |optics: MicroOptics| optics.lit_px(optics.blur_radius_px(slope));
        let largest = micro_images.all_optics_at(&pinhole).map(lit).fold(0.0, f64::max);
        let nodes = micro_images.about(&pinhole, largest / (1.0 - slope).abs());
        let (mut observations, mut imbalances, mut unclear) = (Vec::new(), Vec::new(), 0);
        let mut room = Room::default();
        let step = nodes.len().div_ceil(ENOUGH).max(1);
        let mut next = 0;
        for (i, node) in nodes.into_iter().enumerate() {
            let center = micro_images.center(node.0, node.1);
            let optics = micro_images.optics(node.0, node.1);
            let expected = sought.line.at(&center) - center;
            let rho = optics.blur_radius_px(slope);
            if expected.norm() > optics.lit_px(rho) - EDGE_PX {
                continue;
            }
            let Some(seen) = self.seen(sought, node, &mut room) else {
                unclear += 1;
                continue;
            };
            if i >= next {
                imbalances.extend(seen.corner.imbalance(&room.patch, &room.rays));
                next = i + step;
            }
            observations.push(seen);
        }
        // The outer corners of the board look like corners in some micro-images, but not in most.
        let is_corner = median(imbalances).is_some_and(|median| median < IMBALANCE);
        let all = observations.len();
        let found = if is_corner { Sought::near_line(sought, observations) } else { None };
        let kept = found.as_ref().map_or(0, |found| found.seen.len());
        let (misplaced, given_up) = if found.is_some() { (all - kept, 0) } else { (0, all) };
        Outcome { found, unclear, misplaced, given_up }
    }

    /// What is seen of a corner in a micro-image; `None` if it does not clearly show.
    fn seen(
        &self,
        sought: &BoardCorner,
        node: (i32, i32),
        room: &mut Room,
    ) -> Option<CornerMeasurement> {
        let micro_images = self.frame.search.micro_images;
        let (center, slope) = (micro_images.center(node.0, node.1), sought.line.slope);
        let optics = micro_images.optics(node.0, node.1);
        let vignetting = micro_images.vignetting(&optics);
        let bend = self.aberration.bend(&center, slope);
        let blur = Blur::new(&optics, slope, bend, vignetting).wider(self.wider_px2);
        self.frame.read(node, &mut room.patch, &mut room.reading).ok()?;
        if !self.last {
            room.patch = room.patch.thinned(ROUGH_PIXELS);
        }
        let start = self.expected_corner(sought, &center, room.patch.mean());
        blur.trace(&room.patch, &mut room.rays);
        let mut corner = self.fitted(&start, room)?;
        let (mut sensitivities, inverse) =
            sensitivities(&corner, &room.patch, &room.rays, slope, &bend)?;
        let has_width = self.last || (node.0 + node.1).rem_euclid(ROUGH_WIDTHS) == 0;
        let mut width = None;
        if has_width {
            let step = if self.last { FEW } else { FEW.div_ceil(ROUGH_PIXELS) };
            room.few = room.patch.thinned(step);
            room.rays.thin(step, &mut room.few_rays);
            let blurred = (&optics, &blur, slope);
            let (found, off) =
                self.by_few(&corner, blurred, (&mut sensitivities, &inverse), room)?;
            corner.place += off;
            width = Some(found);
        }
        if (corner.place - start.place).norm() > EXPECTED_PX {
            return None;
        }
        let observation = self.frame.observation(node, &corner);
        Some(CornerMeasurement { observation, slope_before: slope, sensitivities, width, corner })
    }

    /// What a few pixels of a corner say of the width of its edges, and by how much its place is off, px; and, in the last
    /// round, its sensitivities by what is taken from white images.
    fn by_few(
        &self,
        corner: &Corner,
        (optics, blur, slope): (&MicroOptics, &Blur, f64),
        (sensitivities, inverse): (&mut Sensitivities, &Matrix4<f64>),
        room: &mut Room,
    ) -> Option<(EdgeWidth, Vector2<f64>)> {
        let Room { patch, few, few_rays, on_edges, others, .. } = room;
        let share = few.sum_of_weights() / patch.sum_of_weights();
        if self.last {
            on_edges.find(corner, few, few_rays);
            for (taken, rays) in others.iter_mut().enumerate() {
                let (optics, vignetting) = self.frame.search.micro_images.otherwise(optics, taken);
                let blur = Blur::new(&optics, slope, blur.bend, vignetting);
                blur.wider(self.wider_px2).trace(&on_edges.patch, rays);
            }
            sensitivities.by_taken = on_edges.by_taken(corner, others, inverse, share);
        }
        let summed = summed(blur, corner, few);
        let by_ratio_px = optics.blur_by_ratio_px(slope);
        EdgeWidth::of(corner, few, few_rays, &summed, by_ratio_px, (inverse, share))
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
    fn fitted(&self, expected: &Corner, room: &mut Room) -> Option<Corner> {
        let Room { patch, rays, fit, .. } = room;
        expected.fitted(patch, rays, Free::Place, fit).filter(|corner| {
            (corner.place - expected.place).norm() < EXPECTED_PX
                && corner.explained > EXPLAINED
                && (corner.contrast > 0.0) == (expected.contrast > 0.0)
                && corner.contrast.abs() > LEAST_CONTRAST * self.contrast
                && corner.std_dev_px() < UNCERTAIN_PX
        })
    }

    /// A corner with its line, once the aberrations are known better.
    pub fn on_line(&self, found: Sought, change: &Vector3<f64>) -> Option<BoardCorner> {
        let Sought { corner, mut seen } = found;
        for seen in &mut seen {
            seen.change_aberration(change);
        }
        let line = CornerLine::fit(seen.iter().map(CornerMeasurement::on_line))?;
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
            let CornerObservation { k, l, .. } = seen.observation;
            seen.change_slope(line.slope, &self.frame.search.micro_images.optics(k, l));
        }
        let observations = seen
            .into_iter()
            .map(|seen| Found {
                observation: seen.observation,
                corner: seen.corner,
                by_taken: seen.sensitivities.by_taken,
                width: seen.width,
            })
            .collect();
        let possible = possible_slope(line.slope, self.frame.search.micro_images.configuration);
        possible.then_some(BoardCorner { corner, line, observations })
    }
}

impl Sought {
    /// What was seen of a corner, without what is off its line.
    fn near_line(sought: &BoardCorner, mut seen: Vec<CornerMeasurement>) -> Option<Self> {
        let line = CornerLine::fit(seen.iter().map(CornerMeasurement::on_line))?;
        let scale = line.rms_px.max(LEAST_RMS_PX);
        seen.retain(|seen| {
            let o = seen.on_line();
            (o.position - line.at(&o.center)).norm() < OUTLIER * scale
        });
        (seen.len() > 1).then_some(Self { corner: sought.corner, seen })
    }
}
