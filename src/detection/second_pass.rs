//! Second pass: every corner of the board is searched for where its line, or its neighbours' lines, predict it, in all
//! micro-images that should show it.

use std::borrow::Cow;

use nalgebra::{Matrix2, Vector2};
use rayon::prelude::*;

#[cfg(doc)]
use super::Detection;
use super::aberration_fit::{AberrationInformation, width_by_ratio};
use super::board::LabelledBoard;
use super::corner::Corner;
use super::corner_fit::{FitRoom, FittedCorner, Held};
use super::corner_measurement::CornerMeasurement;
use super::distortion::Distortion;
use super::edge_width::{EdgeWidth, WidthChange};
use super::first_pass::LEAST_CONTRAST;
use super::frame::{Frame, FrameCounts, MARGIN, Search};
use super::line::{CornerLine, FittedLine, possible_slope};
use super::patch::{self, Patch};
use super::slope_field::SlopeField;
use super::{Aberration, MicroImages, MicroOptics};
use crate::model::taken::{ABERRATIONS, APERTURE_RATIO};
use crate::numerics::median;
use crate::optics::aberration::{AberrationEstimate, UNKNOWNS, field_terms};

/// Numbers of rounds in which every corner is searched for. A round uses the lines, the aberrations and the width of edges of
/// the previous one. There are at least two, and more while the aperture ratio or the width of edges changes.
const ROUNDS: std::ops::RangeInclusive<usize> = 2..=4;
/// Change of ln φ up to which [`Detection::settle`] can make it, to first order: it leaves a few ten-thousandths.
const SETTLED: f64 = 0.025;
/// Range of aperture ratios from the edges of one frame: noise may exceed possible values a little.
const RATIOS: std::ops::RangeInclusive<f64> = 0.2..=1.15;
/// Largest excess edge variance, px²; boards with wider edges are not sharp enough to be found.
const MOST_WIDER_PX2: f64 = 9.0;

/// Largest distance of a corner from its expected position, px.
const EXPECTED_PX: f64 = 1.2;
/// Step between the pixels that the first round uses.
const ROUGH_PIXELS: usize = 3;
/// Smallest part of the light of its micro-image that a corner explains.
const EXPLAINED: f64 = 0.4;
/// Largest median imbalance of the observations of a corner, see [`Corner::imbalance`].
const IMBALANCE: f64 = 0.5;
/// Number of observations that suffice for this median.
const ENOUGH: usize = 12;
/// Largest standard deviation of an observation, px.
const UNCERTAIN_PX: f64 = 0.35;
/// Smallest distance of corners from where none of their light arrives, px.
const EDGE_PX: f64 = 0.15;
/// Distance from their line, in root mean square distances, above which observations are misplaced; and lower limit of the
/// latter, px.
const OUTLIER: f64 = 4.0;
const LEAST_RMS_PX: f64 = 0.08;

/// Corner of the board that is expected on a line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ExpectedCorner {
    pub corner: i32,
    pub line: CornerLine,
    /// True if it was not searched for before.
    pub is_new: bool,
}

/// Corner of the board with its measurements near its line.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct MeasuredCorner {
    pub corner: i32,
    pub seen: Vec<CornerMeasurement>,
}

/// Corner of the board with its line, for known aberrations and aperture ratio.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct SettledCorner {
    pub corner: i32,
    pub line: CornerLine,
    /// Derivative of the slope of the line by ln φ.
    pub slope_by_ratio: f64,
    pub seen: Vec<CornerMeasurement>,
}

/// Change of what corners were measured with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Change<'a> {
    pub from: &'a Aberration,
    pub to: &'a AberrationEstimate,
    /// Change of ln φ.
    pub log_ratio: f64,
}

/// Result of the second pass in a frame.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct SecondPassed {
    /// Aperture ratio, aberrations, and excess edge variance along an axis, px², that the corners were measured with.
    pub aperture_ratio: f64,
    pub measured_with: Aberration,
    pub wider_px2: f64,
    /// Corners of the board.
    pub corners: Vec<MeasuredCorner>,
    /// Aberrations that the corners show, and their information about them.
    pub aberration: AberrationEstimate,
    pub information: AberrationInformation,
    /// Remaining changes of the aperture ratio and of the excess edge variance, from the edges of all corners, if they
    /// determine them.
    pub width: Option<WidthChange>,
}

impl ExpectedCorner {
    /// Creates a corner that was not searched for before.
    pub fn new(corner: i32, line: CornerLine) -> Self {
        Self { corner, line, is_new: true }
    }
}

/// Searches for all corners of the board: where their lines predict them, or the lines of their neighbours for corners without
/// one.
pub(super) fn second_pass(
    frame: &Frame,
    mut expected: Vec<ExpectedCorner>,
    labelled: &LabelledBoard,
    contrast: f64,
    counts: &mut FrameCounts,
) -> SecondPassed {
    let at_first: Vec<i32> = expected.iter().map(|c| c.corner).collect();
    let mut micro_images = Cow::Borrowed(frame.search.micro_images);
    let ideal = frame.search.ideal();
    let mut passed = SecondPassed {
        aperture_ratio: micro_images.aperture_ratio(),
        measured_with: ideal,
        wider_px2: 0.0,
        corners: Vec::new(),
        aberration: micro_images.aberration().unwrap_or(AberrationEstimate::none(ideal)),
        information: AberrationInformation::none(),
        width: None,
    };
    // The aperture ratio shown by other boards is not estimated again from this one.
    let free = micro_images.settled().is_none();
    for round in 1..=*ROUNDS.end() {
        let lines: Vec<CornerLine> = expected.iter().map(|c| c.line).collect();
        let Some(field) = SlopeField::fit(&lines) else { break };
        let pinholes =
            |c: &ExpectedCorner| (labelled.pinhole(frame.search.board, c.corner), c.line.pinhole());
        let pinholes: Vec<_> = expected.iter().map(pinholes).collect();
        let distortion = &Distortion::fit(&pinholes, ideal.axis_px);
        expected.extend(missing(frame, &expected, labelled, &field));
        let (field, rough) = (&field, round == 1);
        (passed.aperture_ratio, passed.measured_with) =
            (micro_images.aperture_ratio(), passed.aberration.aberration);
        let pass = CornerSearch {
            frame,
            micro_images: &micro_images,
            labelled,
            field,
            distortion,
            contrast,
            aberration: passed.measured_with,
            wider_px2: passed.wider_px2,
            rough,
        };
        let outcomes: Vec<Outcome> = expected.par_iter().map(|c| pass.search(c)).collect();
        // The counts of the last round remain.
        counts.unclear = outcomes.iter().map(|o| o.unclear).sum();
        counts.misplaced = outcomes.iter().map(|o| o.misplaced).sum();
        counts.given_up = outcomes.iter().map(|o| o.given_up).sum();
        passed.corners = outcomes.into_iter().filter_map(|o| o.found).collect();
        passed.corners.sort_by_key(|c| c.corner);
        let settled = passed.settle_alone(frame.search, &micro_images, free, counts);
        expected = settled
            .iter()
            .map(|c| ExpectedCorner { corner: c.corner, line: c.line, is_new: false })
            .collect();
        let change = passed.width.filter(|_| free).and_then(|width| width.log_ratio());
        let change = change.filter(|(by, _)| by.abs() > SETTLED);
        let wider = passed.width.filter(WidthChange::edges_differ);
        let settled = change.is_none() && wider.is_none();
        if round == *ROUNDS.end() || (round >= *ROUNDS.start() && settled) {
            break;
        }
        if let Some((by, _)) = change {
            let ratio = micro_images.aperture_ratio() * by.exp();
            let ratio = ratio.clamp(*RATIOS.start(), *RATIOS.end());
            micro_images = Cow::Owned(micro_images.with_aperture_ratio(ratio));
        }
        if let Some(width) = wider {
            let least = -micro_images.point_spread_px2();
            passed.wider_px2 = (passed.wider_px2 + width.change.y).clamp(least, MOST_WIDER_PX2);
        }
    }
    let is_lost = |corner: &&i32| passed.corners.iter().all(|c| c.corner != **corner);
    counts.lost += at_first.iter().filter(is_lost).count();
    counts.board_corners = passed.corners.len();
    passed
}

impl SecondPassed {
    /// Estimates aberrations, unless other boards have shown them, and widths of edges from the corners of this frame alone.
    /// Corners without a possible line are given up. The others are returned with their lines.
    fn settle_alone(
        &mut self,
        search: &Search,
        micro_images: &MicroImages,
        free: bool,
        counts: &mut FrameCounts,
    ) -> Vec<SettledCorner> {
        let seen = self.corners.iter().map(|c| c.seen.as_slice());
        let (information, widths) =
            AberrationInformation::of(&self.measured_with, micro_images, seen);
        let log_ratio = WidthChange::fit(&widths, self.wider_px2)
            .filter(|_| free)
            .and_then(|width| width.log_ratio())
            .map_or(0.0, |(change, _)| change);
        let log_ratio = micro_images.aperture_ratio().ln() + log_ratio;
        let fitted = || information.fit(log_ratio, &search.ideal(), search.sensor.mount_px());
        self.aberration = micro_images.aberration().unwrap_or_else(fitted);
        self.information = information;
        let change = Change { from: &self.measured_with, to: &self.aberration, log_ratio: 0.0 };
        let mut settled = Vec::new();
        self.corners.retain(|corner| {
            let with_line = corner.settled(micro_images, &change);
            if with_line.is_none() {
                counts.given_up += corner.seen.len();
            }
            let is_kept = with_line.is_some();
            settled.extend(with_line);
            is_kept
        });
        let of_corner = |c: &SettledCorner| {
            let width = |seen| width_by_ratio(seen, micro_images, c.line.slope, c.slope_by_ratio);
            c.seen.iter().map(width).collect::<Vec<EdgeWidth>>()
        };
        let widths: Vec<EdgeWidth> = settled.iter().flat_map(of_corner).collect();
        self.width = WidthChange::fit(&widths, self.wider_px2);
        settled
    }
}

impl MeasuredCorner {
    /// Fits the line after a change of the aberrations and the aperture ratio; `None` if it is not possible. `micro_images`
    /// have the aperture ratio that the corner was measured with.
    pub fn settled(&self, micro_images: &MicroImages, change: &Change) -> Option<SettledCorner> {
        let mut seen = self.seen.clone();
        let to = &change.to.aberration;
        let field = to.of_field() - change.from.of_field();
        let by_unknowns = to.of_field_by_unknowns();
        for seen in &mut seen {
            let sensitivities = &mut seen.sensitivities;
            let by_field = sensitivities.by_aberration * field_terms(&seen.observation.center);
            let by_ratio = sensitivities.by_taken.column(APERTURE_RATIO).into_owned();
            let by_unknowns = by_field * by_unknowns;
            let by_errors = by_unknowns * change.to.errors;
            sensitivities.by_taken.fixed_columns_mut::<UNKNOWNS>(ABERRATIONS).copy_from(&by_errors);
            // An error of the aperture ratio is also an error of the aberrations that follow from it.
            let by_ratio_too = by_ratio + by_unknowns * change.to.by_log_ratio;
            sensitivities.by_taken.set_column(APERTURE_RATIO, &by_ratio_too);
            seen.moved(&(by_field * field + by_ratio * change.log_ratio));
        }
        let fitted = FittedLine::fit(seen.iter().map(CornerMeasurement::on_line))?;
        let line = fitted.line;
        let by_taken = fitted.derivatives(seen.iter().map(|seen| seen.sensitivities.by_taken))?;
        for seen in &mut seen {
            let optics = micro_images.optics(seen.observation.k, seen.observation.l);
            // A change of positions changes the slope of the line, and this changes the blur.
            seen.take_slope(&by_taken.row(2).into_owned());
            seen.change_slope(line.slope, &optics);
        }
        let slope_by_ratio = by_taken[(2, APERTURE_RATIO)];
        let possible = possible_slope(line.slope, micro_images.configuration);
        possible.then_some(SettledCorner { corner: self.corner, line, slope_by_ratio, seen })
    }

    /// Removes the measurements off the line of a corner; `None` if too few remain.
    fn near_line(corner: i32, mut seen: Vec<CornerMeasurement>) -> Option<Self> {
        let line = CornerLine::fit(seen.iter().map(CornerMeasurement::on_line))?;
        let scale = line.rms_px.max(LEAST_RMS_PX);
        seen.retain(|seen| {
            let o = seen.on_line();
            (o.position - line.at(&o.center)).norm() < OUTLIER * scale
        });
        (seen.len() > 1).then_some(Self { corner, seen })
    }
}

/// Returns the corners in view that are not among some, on the lines that these predict.
fn missing(
    frame: &Frame,
    corners: &[ExpectedCorner],
    labelled: &LabelledBoard,
    field: &SlopeField,
) -> Vec<ExpectedCorner> {
    let board = frame.search.board;
    (0..board.corners())
        .filter(|corner| corners.iter().all(|c| c.corner != *corner))
        .map(|corner| (corner, labelled.pinhole(board, corner)))
        .filter(|(_, p)| frame.in_view(p, MARGIN))
        .map(|(corner, p)| ExpectedCorner::new(corner, CornerLine::through(&p, field.at(&p))))
        .collect()
}

/// Result of the search for a board corner, with numbers of micro-images that should show it.
struct Outcome {
    pub found: Option<MeasuredCorner>,
    pub unclear: usize,
    pub misplaced: usize,
    pub given_up: usize,
}

/// Search for corners of the board in a frame, in one round.
struct CornerSearch<'a> {
    pub frame: &'a Frame<'a>,
    /// Micro-images with the aperture ratio that is known so far.
    pub micro_images: &'a MicroImages,
    pub labelled: &'a LabelledBoard,
    pub field: &'a SlopeField,
    pub distortion: &'a Distortion,
    /// Contrast of the frame.
    pub contrast: f64,
    /// Aberrations that are known so far.
    pub aberration: Aberration,
    /// Excess edge variance along an axis, px².
    pub wider_px2: f64,
    /// True if a part of the pixels suffices.
    pub rough: bool,
}

/// Buffers for one micro-image at a time.
#[derive(Default)]
struct Room {
    patch: Patch,
    reading: patch::Room,
    fit: FitRoom,
}

impl CornerSearch<'_> {
    /// Searches for a corner in every micro-image that should show it.
    pub fn search(&self, sought: &ExpectedCorner) -> Outcome {
        let micro_images = self.micro_images;
        let (pinhole, slope) = (sought.line.pinhole(), sought.line.slope);
        let lit = |optics: MicroOptics| optics.lit_px(optics.blur_radius_px(slope));
        let largest = micro_images.all_optics_at(&pinhole).map(lit).fold(0.0, f64::max);
        let nodes = micro_images.about(&pinhole, largest / (1.0 - slope).abs());
        let (mut observations, mut imbalances, mut unclear) = (Vec::new(), Vec::new(), 0);
        let mut room = Room::default();
        let step = nodes.len().div_ceil(ENOUGH).max(1);
        let (mut next, is_new) = (0, sought.is_new);
        for (i, node) in nodes.into_iter().enumerate() {
            let center = micro_images.center(node.0, node.1);
            let optics = micro_images.optics(node.0, node.1);
            let expected = sought.line.at(&center) - center;
            let rho = optics.blur_radius_px(slope);
            if expected.norm() > optics.lit_px(rho) - EDGE_PX {
                continue;
            }
            let Some((seen, imbalance)) = self.seen(sought, node, is_new && i >= next, &mut room)
            else {
                unclear += 1;
                continue;
            };
            if is_new && i >= next {
                imbalances.extend(imbalance);
                next = i + step;
            }
            observations.push(seen);
        }
        // The outer corners of the board look like corners in some micro-images, but not in most.
        let is_corner = !is_new || median(imbalances).is_some_and(|median| median < IMBALANCE);
        let all = observations.len();
        let found =
            if is_corner { MeasuredCorner::near_line(sought.corner, observations) } else { None };
        let kept = found.as_ref().map_or(0, |found| found.seen.len());
        let (misplaced, given_up) = if found.is_some() { (all - kept, 0) } else { (0, all) };
        Outcome { found, unclear, misplaced, given_up }
    }

    /// Measures a corner in a micro-image, and its imbalance if requested; `None` if it is not clearly visible.
    fn seen(
        &self,
        sought: &ExpectedCorner,
        node: (i32, i32),
        with_imbalance: bool,
        room: &mut Room,
    ) -> Option<(CornerMeasurement, Option<f64>)> {
        let micro_images = self.micro_images;
        let center = micro_images.center(node.0, node.1);
        let slope = sought.line.slope;
        let held = Held {
            optics: &micro_images.optics(node.0, node.1),
            slope,
            aberration: &self.aberration,
            center,
            point_spread_px2: micro_images.point_spread_px2(),
            wider_px2: self.wider_px2,
        };
        self.frame.read(node, &mut room.patch, &mut room.reading).ok()?;
        if self.rough {
            room.patch = room.patch.thinned(ROUGH_PIXELS);
        }
        let expected = self.expected_corner(sought, &center, room.patch.mean());
        let fitted = held.fit(&expected, self.rough, &room.patch, &mut room.fit)?;
        let FittedCorner { corner, sensitivities, width } = fitted;
        let clear = (corner.place - expected.place).norm() < EXPECTED_PX
            && corner.explained > EXPLAINED
            && (corner.contrast > 0.0) == (expected.contrast > 0.0)
            && corner.contrast.abs() > LEAST_CONTRAST * self.contrast
            && corner.std_dev_px() < UNCERTAIN_PX;
        if !clear {
            return None;
        }
        let imbalance =
            with_imbalance.then(|| held.imbalance(&corner, &room.patch, &mut room.fit)).flatten();
        let measurement = CornerMeasurement {
            observation: self.frame.observation(node, &corner),
            slope_before: slope,
            sensitivities,
            width,
            corner,
        };
        Some((measurement, imbalance))
    }

    /// Returns the expected corner in the micro-image about `center`, whose mean light is `level`.
    fn expected_corner(
        &self,
        sought: &ExpectedCorner,
        center: &Vector2<f64>,
        level: f64,
    ) -> Corner {
        let (pinhole, nearness) = (sought.line.pinhole(), 1.0 - sought.line.slope);
        // Towards the next corner the slope changes, and with it the magnification.
        let seen = |step: &Vector2<f64>| {
            step * nearness - (pinhole - center) * self.field.gradient().dot(step)
        };
        // The labels give the directions of rows and columns in the pinhole image.
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

    /// Returns true for even corners. Squares alternate: the squares after an even corner are dark, see
    /// [`LabelledBoard::label`].
    fn is_even(&self, corner: i32) -> bool {
        let columns = self.frame.search.board.columns;
        (corner / columns + corner % columns) % 2 == 0
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

    use super::super::aberration_fit::moved;
    use super::super::aberration_fit::tests::seen_with;
    use super::super::micro_images::tests::micro_images;
    use super::*;

    const STEP: f64 = 1e-3;

    /// Checks the sensitivities of features against settling again with each quantity changed, the slopes of lines included. Noise
    /// is small, since the derivatives leave the robust weights as they are.
    #[test]
    fn sensitivities_to_aberrations_are_those_of_the_settled_features() {
        let micro_images = micro_images(23.0);
        let axis_px = Vector2::new(480.0, 420.0);
        let from = Aberration::none(axis_px, 6.0);
        let coefficients_per_px2 = Vector3::new(2e-3, -8e-6, 3e-8);
        let to = Aberration { coefficients_per_px2, ..from };
        let mut errors = SMatrix::<f64, UNKNOWNS, UNKNOWNS>::zeros();
        let scale = Vector3::new(2e-4, 1e-6, 1e-8);
        let mix = Matrix3::new(1.0, 0.0, 0.0, 0.5, 1.0, 0.0, -0.3, 0.2, 1.0);
        errors.fixed_view_mut::<3, 3>(0, 0).copy_from(&(Matrix3::from_diagonal(&scale) * mix));
        (errors[(3, 1)], errors[(3, 3)], errors[(4, 4)]) = (4.0, 20.0, 30.0);
        let by_log_ratio = SVector::from([-3e-3, 2e-5, 1e-7, 50.0, -40.0]);
        let mut seen = seen_with(&to, 0.002, 0.0).swap_remove(12);
        for (i, seen) in seen.iter_mut().enumerate() {
            seen.sensitivities.by_slope = Vector2::new(0.3, -0.2) * i as f64;
        }
        let corner = MeasuredCorner { corner: 3, seen };
        let settled = |by: SVector<f64, UNKNOWNS>, log_ratio: f64| {
            let to = AberrationEstimate { aberration: moved(&to, &by), errors, by_log_ratio };
            let change = Change { from: &from, to: &to, log_ratio };
            corner.settled(&micro_images, &change).unwrap().seen
        };
        let check = |column: usize, by: SVector<f64, UNKNOWNS>, log_ratio: f64| {
            let more = settled(by * STEP, log_ratio * STEP);
            let less = settled(-by * STEP, -log_ratio * STEP);
            let at = settled(SVector::zeros(), 0.0);
            let (mut error, mut largest) = (0.0_f64, 0.0_f64);
            for ((more, less), at) in more.iter().zip(&less).zip(&at) {
                let expected =
                    (more.observation.position - less.observation.position) / (2.0 * STEP);
                let found = at.sensitivities.by_taken.column(column);
                error = error.max((found - expected).norm());
                largest = largest.max(expected.norm());
            }
            println!("column {column}: {error:.1e} of {largest:.1e} px");
            assert!(largest > 1e-4 && error < 1e-3 * largest, "{column}: {error} of {largest}");
        };
        for i in 0..UNKNOWNS {
            check(ABERRATIONS + i, errors.column(i).into_owned(), 0.0);
        }
        check(APERTURE_RATIO, by_log_ratio, 1.0);
    }
}
