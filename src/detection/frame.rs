//! The features of one frame.

use std::time::Instant;

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};
use rayon::prelude::*;
use tracing::{debug, info, trace};

use super::board::{LatticePoint, TiedBoard};
use super::corner::{Corner, Free, Spread, saddles};
use super::dbscan::dbscan;
use super::line::{
    Group, LineSearch, SightLine, groups_on_lines, is_texture, median_inverse_virtual_depth,
};
use super::micro_images::{MicroImages, MicroOptics};
use super::patch::{Pair, Patch, Unusable};
use super::{DepthEstimator, Detection, Sight};
use crate::image::Grey;
use crate::model::{BapFeature, Board, Configuration, MIN_CORNERS, Sensor};
use crate::vignetting::Shade;

/// What is looked for, and with what.
#[derive(Debug, Clone, Copy)]
pub struct Search<'a> {
    /// The micro-images.
    pub micro_images: &'a MicroImages,
    /// The board.
    pub board: &'a Board,
    /// The sensor.
    pub sensor: &'a Sensor,
    /// How 1/ν is taken from the sights of a corner.
    pub estimator: DepthEstimator,
}

/// A corner of the board as a whole.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DetectedCorner {
    /// Board corner, `row · columns + column`.
    pub corner: i32,
    /// Its line of sights.
    pub line: SightLine,
    /// 1/ν as the paper has it, by the median over pairs with λ = 1.
    pub median_inverse_virtual_depth: f64,
    /// Number of its features.
    pub features: usize,
}

/// What was done with the micro-images of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct FrameCounts {
    /// Micro-images looked at.
    pub looked_at: usize,
    /// Cut by the border, without light in the white image, or saturated.
    pub unusable: usize,
    /// Corners found in single micro-images.
    pub corners: usize,
    /// DBSCAN's clusters of them.
    pub clusters: usize,
    /// Corners in no cluster.
    pub alone: usize,
    /// Corners off the line of their cluster.
    pub off_line: usize,
    /// Corners in clusters that are texture: large, and hardly any of them on a line.
    pub texture: usize,
    /// Corners on lines that are no corner of the board.
    pub off_board: usize,
    /// Board corners tied at first, but not found again where they are expected.
    pub lost: usize,
    /// Board corners tied.
    pub board_corners: usize,
    /// Micro-images in which a board corner should be but none was found: unusable, too little contrast
    /// or too uncertain.
    pub unclear: usize,
    /// Those in which one was found of a board corner that was given up: its sights are on no line, or
    /// few of them look like a corner.
    pub given_up: usize,
    /// Those in which it was found off its line.
    pub misplaced: usize,
}

/// Micro-images along the edge of a tile that is looked at at once.
const TILE: i32 = 16;
/// One micro-image in so many tells how bright the frame is.
const LEVELS: usize = 5;
/// Darkest and brightest part of the micro-images that are left out for the levels.
const TAIL: f64 = 0.02;
/// A frame whose light differs by less, relative to the white image, shows nothing.
const FEWEST_LEVELS: f64 = 0.04;
/// Micro-images that are saturated beyond this part count as such, in a board's image and in the white
/// image, of which more is bright.
const SATURATED: f32 = 0.2;
const SATURATED_WHITE: f32 = 0.5;
/// Saturated micro-images beyond this part make a frame over-exposed.
const OVER_EXPOSED: f64 = 0.25;
/// Corners have at least this part of the frame's contrast.
const CONTRAST: f64 = 0.35;
/// and at most this part: beyond the frame's bright and dark squares there is nothing.
const MOST_CONTRAST: f64 = 1.5;
/// What a corner explains at least of the light of its micro-image, alone and where it is expected.
const EXPLAINED: f64 = 0.8;
const EXPLAINED_EXPECTED: f64 = 0.4;
/// Steps across single edges, over that across both.
const IMBALANCE: f64 = 0.25;
const IMBALANCE_EXPECTED: f64 = 0.5;
/// Saddles of a micro-image that are tried.
const STARTS: usize = 2;
/// Sine of the least angle between two edges.
const OPENING: f64 = 0.4;
/// Corners that are less certain than this, px, alone and where they are expected, are not told.
const UNCERTAIN_PX: f64 = 0.6;
const UNCERTAIN_EXPECTED_PX: f64 = 0.35;
/// Corners nearer than this, px, to where no light of theirs arrives are not looked for.
const EDGE_PX: f64 = 0.15;
/// Alone they are not looked for nearer to the edge of the micro-image, px.
const ALONE_EDGE_PX: f64 = 1.5;
/// Neighbours in a cluster are up to this many times as far from each other as they would be without
/// a missing one.
const GAP: f64 = 1.5;
/// Sights of a line before the pupil's shade is known, in pitches.
const ROUGH: f64 = 0.06;
/// Rounds in which every corner is looked for where its line expects it.
const ROUNDS: usize = 2;
/// How far from there, px.
const EXPECTED_PX: f64 = 1.2;
/// Sights further than this many robust standard deviations from the line are misplaced; the standard
/// deviation is not taken below the second number, px.
const OUTLIER: f64 = 4.0;
const LINE_PX: f64 = 0.08;
/// A side of the board with so many corners surely in view has to show one of them; surely is this
/// many pitches from the border.
const SIDE: usize = 3;
const SURE_MARGIN: f64 = 2.5;
/// Border of the image that counts as out of view, in pitches.
const MARGIN: f64 = 1.0;

/// Detects the features of a frame; the reason in words if it cannot be tied to the board.
pub fn detect_frame(
    frame: u32,
    image: &Grey,
    white: &Grey,
    search: &Search,
) -> (Result<Detection, String>, FrameCounts) {
    let mut counts = FrameCounts::default();
    if image.size() != white.size() {
        let ((a, b), (c, d)) = (image.size(), white.size());
        let why = format!("it has {a} x {b} px, but the white image {c} x {d}");
        return (Err(why), counts);
    }
    let begun = Instant::now();
    let result = Frame { frame, image, white, search }.detect(&mut counts);
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

struct Frame<'a> {
    frame: u32,
    image: &'a Grey<'a>,
    white: &'a Grey<'a>,
    search: &'a Search<'a>,
}

/// A board corner to look for.
#[derive(Clone)]
struct Target {
    corner: i32,
    line: SightLine,
    sights: Vec<(Sight, Corner)>,
}

/// What came of looking for a board corner in the micro-images that should show it, in numbers of these.
struct Look {
    target: Option<Target>,
    unclear: usize,
    misplaced: usize,
    given_up: usize,
}

impl Frame<'_> {
    fn detect(&self, counts: &mut FrameCounts) -> Result<Detection, String> {
        let search = self.search;
        let nodes = self.nodes();
        counts.looked_at = nodes.len();
        let contrast = self.contrast(&nodes).inspect_err(|_| {
            counts.unusable = self.levels(nodes.iter()).iter().filter(|l| l.is_err()).count();
        })?;
        let sights = self.all_corners(nodes, contrast, counts);
        counts.corners = sights.len();
        let groups = self.groups(&sights, counts);
        let points: Vec<LatticePoint> = groups
            .iter()
            .map(|group| LatticePoint {
                place: group.line.pinhole(),
                squares: group.members.iter().map(|&i| sights[i].squares).sum(),
            })
            .collect();
        trace!("frame {}: contrast {contrast:.3}, {} lines", self.frame, groups.len());
        let in_view = |place: &Vector2<f64>| self.in_view(place, MARGIN);
        let tied = TiedBoard::tie(&points, search.board, &in_view).map_err(|why| {
            if counts.texture > 0 {
                format!("{why}; {} more corners are of texture, not of a board", counts.texture)
            } else {
                why
            }
        })?;
        let targets: Vec<Target> = groups
            .iter()
            .zip(&tied.corners)
            .filter_map(|(group, corner)| {
                Some(Target { corner: (*corner)?, line: group.line, sights: Vec::new() })
            })
            .collect();
        let tied_sights: usize = groups
            .iter()
            .zip(&tied.corners)
            .filter(|(_, corner)| corner.is_some())
            .map(|(group, _)| group.members.len())
            .sum();
        counts.off_board = groups.iter().map(|g| g.members.len()).sum::<usize>() - tied_sights;
        let at_first: Vec<i32> = targets.iter().map(|target| target.corner).collect();
        let targets = self.looked_for(targets, &tied, contrast, counts);
        let is_lost = |corner: &&i32| targets.iter().all(|target| target.corner != **corner);
        counts.lost = at_first.iter().filter(is_lost).count();
        counts.board_corners = targets.len();
        self.check_outline(&targets, &tied)?;
        if targets.len() < MIN_CORNERS {
            return Err(format!(
                "only {} corners of the board are left where it was looked for again, but a pose takes \
                 {MIN_CORNERS}",
                targets.len()
            ));
        }
        Ok(self.detection(&targets, tied.homography))
    }

    /// Whether a place is in the micro-images, so many pitches within the border.
    fn in_view(&self, place: &Vector2<f64>, pitches: f64) -> bool {
        let micro_images = self.search.micro_images;
        micro_images.show(place, self.search.sensor, pitches * micro_images.grid.pitch_px)
    }

    /// Mean light of micro-images, relative to the white image, or why it does not tell.
    fn levels<'n>(
        &self,
        nodes: impl Iterator<Item = &'n (i32, i32)>,
    ) -> Vec<Result<f64, Unusable>> {
        let micro_images = self.search.micro_images;
        let of_node = |&(k, l): &(i32, i32)| {
            let place = std::iter::once(micro_images.center(k, l));
            let pair = Pair::about(self.image, self.white, place, micro_images.grid.pitch_px);
            let patch: Patch = pair.patch(micro_images, (k, l))?;
            if patch.saturated_white > SATURATED_WHITE {
                return Err(Unusable::SaturatedWhite);
            }
            if patch.saturated > SATURATED {
                return Err(Unusable::Saturated);
            }
            Ok(patch.mean())
        };
        nodes.collect::<Vec<_>>().into_par_iter().map(of_node).collect()
    }

    /// Half the difference between the bright and the dark squares, relative to the white image.
    fn contrast(&self, nodes: &[(i32, i32)]) -> Result<f64, String> {
        let mut levels = self.levels(nodes.iter().step_by(LEVELS));
        // Those at the border say nothing of the light.
        levels.retain(|level| *level != Err(Unusable::Cut));
        if levels.is_empty() {
            return Err(
                "no micro-image is whole in it: the white images are of another camera, or \
                        the array has too few micro-lenses"
                    .to_owned(),
            );
        }
        let part = |why: Unusable| {
            let count = levels.iter().filter(|level| **level == Err(why)).count();
            count as f64 / levels.len() as f64
        };
        let percent = |why: Unusable| format!("{:.0} % of the micro-images", 100.0 * part(why));
        if part(Unusable::SaturatedWhite) > OVER_EXPOSED {
            return Err(format!(
                "{} are saturated in the white image: take it with a shorter exposure",
                percent(Unusable::SaturatedWhite)
            ));
        }
        if part(Unusable::Saturated) > OVER_EXPOSED {
            return Err(format!(
                "{} are saturated: the frame is over-exposed",
                percent(Unusable::Saturated)
            ));
        }
        if part(Unusable::TooSmall) > OVER_EXPOSED {
            return Err(format!(
                "{} have too few pixels with light to hold a corner: at a pitch of {:.1} px corners \
                 cannot be found in them",
                percent(Unusable::TooSmall),
                self.search.micro_images.grid.pitch_px
            ));
        }
        if part(Unusable::Dark) > OVER_EXPOSED {
            return Err(format!(
                "{} are without light in the white image: it is of another camera, or no white image",
                percent(Unusable::Dark)
            ));
        }
        let mut means: Vec<f64> = levels.into_iter().flatten().collect();
        if means.is_empty() {
            return Err("none of the micro-images can be used".to_owned());
        }
        means.sort_by(f64::total_cmp);
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a part of the length
        let at = |part: f64| means[(part * (means.len() - 1) as f64) as usize];
        let contrast = (at(1.0 - TAIL) - at(TAIL)) / 2.0;
        if contrast < FEWEST_LEVELS * at(1.0 - TAIL).max(0.1) {
            return Err("there is no board in it: all is of one brightness".to_owned());
        }
        Ok(contrast)
    }

    fn nodes(&self) -> Vec<(i32, i32)> {
        let micro_images = self.search.micro_images;
        let lattice = &micro_images.grid.lattice;
        let (width, height) = self.image.size();
        let inside = |&(k, l): &(i32, i32)| {
            let c = micro_images.center(k, l);
            (0.0..=width as f64 - 1.0).contains(&c.x) && (0.0..=height as f64 - 1.0).contains(&c.y)
        };
        let rows = lattice.rows;
        (0..rows).flat_map(|l| (0..lattice.columns).map(move |k| (k, l))).filter(inside).collect()
    }

    /// Corners in all micro-images, each by itself.
    fn all_corners(
        &self,
        mut nodes: Vec<(i32, i32)>,
        contrast: f64,
        counts: &mut FrameCounts,
    ) -> Vec<Sight> {
        let micro_images = self.search.micro_images;
        let tile = |(k, l): (i32, i32)| (l / TILE, k / TILE);
        nodes.sort_by_key(|&node| tile(node));
        let tiles: Vec<&[(i32, i32)]> = nodes.chunk_by(|&a, &b| tile(a) == tile(b)).collect();
        let none = Shade::none();
        let unknown = Spread::unknown(&none);
        let of_tile = |nodes: &&[(i32, i32)]| {
            let places = nodes.iter().map(|&(k, l)| micro_images.center(k, l));
            let reach = 0.6 * micro_images.grid.pitch_px;
            let pair = Pair::about(self.image, self.white, places, reach);
            let mut unusable = 0;
            let mut sights = Vec::new();
            for &node in *nodes {
                let Ok(patch) = pair.patch(micro_images, node) else {
                    unusable += 1;
                    continue;
                };
                let reach = micro_images.optics(node.0, node.1).outer_radius_px() - ALONE_EDGE_PX;
                let clear = |corner: &Corner| {
                    corner.place.norm() < reach
                        && corner.explained > EXPLAINED
                        && (CONTRAST..MOST_CONTRAST).contains(&(corner.contrast.abs() / contrast))
                        && corner.opening() > OPENING
                        && corner.covariance.trace() / 2.0 < UNCERTAIN_PX.powi(2)
                        && corner.imbalance(&patch, &unknown).is_some_and(|part| part < IMBALANCE)
                };
                let corner = saddles(&patch, CONTRAST * contrast)
                    .iter()
                    .filter(|corner| corner.place.norm() < reach)
                    .take(STARTS)
                    .filter_map(|corner| corner.fitted(&patch, &unknown, Free::All))
                    .find(clear);
                if let Some(corner) = corner {
                    sights.push(self.sight(node, &corner));
                }
            }
            (sights, unusable)
        };
        let found: Vec<(Vec<Sight>, usize)> = tiles.par_iter().map(of_tile).collect();
        counts.unusable = found.iter().map(|(_, unusable)| unusable).sum();
        found.into_iter().flat_map(|(sights, _)| sights).collect()
    }

    fn sight(&self, (k, l): (i32, i32), corner: &Corner) -> Sight {
        let center = self.search.micro_images.center(k, l);
        Sight {
            k,
            l,
            center,
            position: center + corner.place,
            std_dev_px: (corner.covariance.trace() / 2.0).max(1e-6).sqrt().max(0.02),
            squares: corner.squares(),
        }
    }

    /// Clusters, and what of them lies on lines.
    fn groups(&self, sights: &[Sight], counts: &mut FrameCounts) -> Vec<Group> {
        let micro_images = self.search.micro_images;
        let pitch = micro_images.grid.pitch_px;
        // Before the array (Keplerian) neighbours are further apart than their micro-lenses.
        let furthest = match micro_images.configuration {
            Configuration::Galilean => 1.0,
            _ => 1.5,
        };
        let places: Vec<Vector2<f64>> = sights.iter().map(|s| s.position).collect();
        let clusters = dbscan(&places, GAP * furthest * pitch, 2);
        let count = clusters.iter().flatten().max().map_or(0, |last| last + 1);
        let mut members = vec![Vec::new(); count];
        for (i, cluster) in clusters.iter().enumerate() {
            match cluster {
                Some(cluster) => members[*cluster].push(i),
                None => counts.alone += 1,
            }
        }
        counts.clusters = count;
        let line_search = LineSearch {
            tolerance_px: ROUGH * pitch,
            reach_px: micro_images.largest_outer_radius_px(),
            pitch_px: pitch,
            configuration: micro_images.configuration,
        };
        let of_cluster = |members: &Vec<usize>| groups_on_lines(sights, members, &line_search);
        let groups: Vec<Vec<Group>> = members.par_iter().map(of_cluster).collect();
        for (members, groups) in members.iter().zip(&groups) {
            let on_line: usize = groups.iter().map(|g| g.members.len()).sum();
            let off_line = members.len() - on_line;
            if is_texture(off_line, on_line) {
                counts.texture += off_line;
            } else {
                counts.off_line += off_line;
            }
        }
        groups.into_iter().flatten().collect()
    }

    /// Looks for every corner of the board where its line, or its neighbours', expects it.
    fn looked_for(
        &self,
        mut targets: Vec<Target>,
        tied: &TiedBoard,
        contrast: f64,
        counts: &mut FrameCounts,
    ) -> Vec<Target> {
        let search = self.search;
        for _ in 0..ROUNDS {
            let Some(field) = slope_field(&targets) else { break };
            let missing: Vec<Target> = (0..search.board.corners())
                .filter(|corner| targets.iter().all(|target| target.corner != *corner))
                .map(|corner| (corner, tied.pinhole(search.board, corner)))
                .filter(|(_, p)| self.in_view(p, MARGIN))
                .map(|(corner, p)| Target {
                    corner,
                    line: SightLine::through(&p, slope_at(&field, &p)),
                    sights: Vec::new(),
                })
                .collect();
            targets.extend(missing);
            let looks: Vec<Look> =
                targets.par_iter().map(|t| self.target(t, tied, &field, contrast)).collect();
            // Those of the last round count.
            counts.unclear = looks.iter().map(|look| look.unclear).sum();
            counts.misplaced = looks.iter().map(|look| look.misplaced).sum();
            counts.given_up = looks.iter().map(|look| look.given_up).sum();
            targets = looks.into_iter().filter_map(|look| look.target).collect();
            targets.sort_by_key(|target| target.corner);
        }
        // None if there was no round.
        targets.retain(|target| !target.sights.is_empty());
        targets
    }

    /// A reason in words if none of the corners along a side of the board is there, though in view.
    fn check_outline(&self, targets: &[Target], tied: &TiedBoard) -> Result<(), String> {
        let board = self.search.board;
        let in_view = |corner: &i32| self.in_view(&tied.pinhole(board, *corner), SURE_MARGIN);
        let found = |corner: &i32| targets.iter().any(|target| target.corner == *corner);
        let (columns, rows) = (board.columns, board.rows);
        let column = |c: i32| (0..rows).map(move |r| r * columns + c).collect::<Vec<i32>>();
        let row = |r: i32| (0..columns).map(move |c| r * columns + c).collect::<Vec<i32>>();
        let sides = [
            ("first column", column(0)),
            ("last column", column(columns - 1)),
            ("first row", row(0)),
            ("last row", row(rows - 1)),
        ];
        for (name, side) in sides {
            let seen: Vec<i32> = side.into_iter().filter(in_view).collect();
            if seen.len() >= SIDE && !seen.iter().any(found) {
                return Err(format!(
                    "no corner of the {name} shows, though it is in view: check that the board has \
                     {columns} x {rows} inner corners and is not hidden there"
                ));
            }
        }
        Ok(())
    }

    /// A corner in every micro-image that should show it.
    fn target(
        &self,
        target: &Target,
        tied: &TiedBoard,
        field: &Vector3<f64>,
        contrast: f64,
    ) -> Look {
        let Search { micro_images, board, .. } = *self.search;
        let (pinhole, slope) = (target.line.pinhole(), target.line.slope);
        let nearness = 1.0 - slope;
        let lit = |optics: MicroOptics| optics.lit_px(optics.blur_radius_px(slope));
        let largest = micro_images.all_optics_at(&pinhole).map(lit).fold(0.0, f64::max);
        let nodes = micro_images.about(&pinhole, largest / nearness.abs());
        let places = nodes.iter().map(|&(k, l)| micro_images.center(k, l));
        let pair = Pair::about(self.image, self.white, places, 0.6 * micro_images.grid.pitch_px);
        // Rows and columns of the board in the pinhole image.
        let (right, down) = tied.steps(board, target.corner);
        let is_even = (target.corner / board.columns + target.corner % board.columns) % 2 == 0;
        let (mut sights, mut imbalances, mut unclear) = (Vec::new(), Vec::new(), 0);
        for node in nodes {
            let center = micro_images.center(node.0, node.1);
            let optics = micro_images.optics(node.0, node.1);
            let expected = target.line.at(&center) - center;
            let rho = optics.blur_radius_px(slope);
            if expected.norm() > optics.lit_px(rho) - EDGE_PX {
                continue;
            }
            let Ok(patch) = pair.patch(micro_images, node) else {
                unclear += 1;
                continue;
            };
            // Towards the next corner the slope changes, and with it the magnification.
            let seen =
                |step: &Vector2<f64>| step * nearness - (pinhole - center) * field.xy().dot(step);
            let (right, down) = (seen(&right), seen(&down));
            let start = Corner {
                place: expected,
                angles: [right.y.atan2(right.x), down.y.atan2(down.x)],
                level: patch.mean(),
                contrast: if is_even { contrast } else { -contrast },
                width: 1.0,
                covariance: Matrix2::zeros(),
                explained: 0.0,
            };
            let spread = Spread::new(rho, micro_images.shade(&optics), optics.obliquity);
            let fitted = start.fitted(&patch, &spread, Free::Place).filter(|corner| {
                (corner.place - expected).norm() < EXPECTED_PX
                    && corner.explained > EXPLAINED_EXPECTED
                    && (corner.contrast > 0.0) == is_even
                    && corner.contrast.abs() > CONTRAST * contrast
                    && corner.covariance.trace() / 2.0 < UNCERTAIN_EXPECTED_PX.powi(2)
            });
            match fitted {
                Some(corner) => {
                    imbalances.extend(corner.imbalance(&patch, &spread));
                    sights.push((self.sight(node, &corner), corner));
                }
                None => unclear += 1,
            }
        }
        imbalances.sort_by(f64::total_cmp);
        let all = sights.len();
        // The outer corners of the board look like corners in some micro-images, but not in most.
        let is_corner =
            imbalances.get(imbalances.len() / 2).is_some_and(|&median| median < IMBALANCE_EXPECTED);
        match Some(sights).filter(|_| is_corner).and_then(|sights| self.on_line(target, sights)) {
            Some(target) => {
                let misplaced = all - target.sights.len();
                Look { target: Some(target), unclear, misplaced, given_up: 0 }
            }
            None => Look { target: None, unclear, misplaced: 0, given_up: all },
        }
    }

    /// A corner with those of its sights that are on one line.
    fn on_line(&self, target: &Target, mut sights: Vec<(Sight, Corner)>) -> Option<Target> {
        let line = SightLine::fit(sights.iter().map(|(sight, _)| sight))?;
        let scale = line.rms_px.max(LINE_PX);
        sights.retain(|(s, _)| (s.position - line.at(&s.center)).norm() < OUTLIER * scale);
        let line = SightLine::fit(sights.iter().map(|(sight, _)| sight))?;
        let possible = super::possible_slope(line.slope, self.search.micro_images.configuration);
        (possible && sights.len() > 1).then_some(Target { corner: target.corner, line, sights })
    }

    fn detection(&self, targets: &[Target], homography: Matrix3<f64>) -> Detection {
        let micro_images = self.search.micro_images;
        let half_pitch = micro_images.grid.pitch_px / 2.0;
        let (mut features, mut corners) = (Vec::new(), Vec::new());
        for target in targets {
            let sights: Vec<Sight> = target.sights.iter().map(|(sight, _)| *sight).collect();
            // A target has two sights at least.
            let median = median_inverse_virtual_depth(&sights).unwrap_or(f64::NAN);
            corners.push(DetectedCorner {
                corner: target.corner,
                line: target.line,
                median_inverse_virtual_depth: median,
                features: sights.len(),
            });
            for (sight, corner) in &target.sights {
                let optics = micro_images.optics(sight.k, sight.l);
                let rho_px = match self.search.estimator {
                    DepthEstimator::Median => optics.blur_radius_of_depth_px(median),
                    DepthEstimator::Line => optics.blur_radius_px(target.line.slope),
                };
                features.push(BapFeature {
                    frame: self.frame,
                    corner: target.corner,
                    k: sight.k,
                    l: sight.l,
                    u_px: sight.position.x,
                    v_px: sight.position.y,
                    rho_px: Some(rho_px),
                    std_dev_px: Some([0, 1].map(|i| corner.covariance[(i, i)].sqrt())),
                    // By the slope of the corner's line; the uncertainty of q'ᵢ, which all features
                    // of a lens type share, is not in it. The median over pairs has none of its own.
                    rho_std_dev_px: Some(half_pitch * target.line.slope_std_dev),
                });
            }
        }
        Detection { features, corners, homography }
    }
}

/// Slope as a linear function of the pinhole image: by u, by v, and at (0, 0).
fn slope_field(targets: &[Target]) -> Option<Vector3<f64>> {
    let mut weights = vec![1.0; targets.len()];
    let mut field = None;
    for _ in 0..10 {
        let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
        for (target, weight) in targets.iter().zip(&weights) {
            let p = target.line.pinhole();
            let row = Vector3::new(p.x, p.y, 1.0);
            normal += row * row.transpose() * *weight;
            right += row * (target.line.slope * weight);
        }
        let solution = normal.cholesky()?.solve(&right);
        let off = |t: &Target| (t.line.slope - slope_at(&solution, &t.line.pinhole())).abs();
        let mut sorted: Vec<f64> = targets.iter().map(off).collect();
        let middle = sorted.len() / 2;
        let scale = sorted.select_nth_unstable_by(middle, f64::total_cmp).1.max(1e-6) * 1.5;
        weights = targets.iter().map(|t| 1.0 / (1.0 + (off(t) / (3.0 * scale)).powi(4))).collect();
        field = Some(solution);
    }
    field
}

fn slope_at(field: &Vector3<f64>, p: &Vector2<f64>) -> f64 {
    field.x * p.x + field.y * p.y + field.z
}
