//! Labels of the corners of a board, from the lattice of their pinhole images.

mod homography;
mod lattice;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

use nalgebra::{Matrix2, Matrix3, Vector2};
use rayon::prelude::*;

use self::homography::{Pair, homography, project, step_at};
use self::lattice::{FEWEST, Nodes, lattices, turned};
use crate::error::Error;
use crate::finding::Issue;
use crate::model::Board;

/// Pinhole image of a corner, with the directions to its bright and dark squares.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LatticePoint {
    /// Position, px.
    pub place: Vector2<f64>,
    /// Quadratic form that is positive along directions to bright squares and negative to dark ones; zero if they are not
    /// known.
    pub squares: Matrix2<f64>,
}

/// Points labelled with the corners of a board.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct LabelledBoard {
    /// Corner of each point; `None` for points that are no corner of the board.
    pub corners: Vec<Option<i32>>,
    /// Homography from (column, row, 1) of a corner to its pinhole image, px.
    pub homography: Matrix3<f64>,
    /// Number of points that match another part of the board, if they do: labels are known up to a shift by whole squares.
    pub elsewhere: Option<usize>,
}

/// Largest number of corners of a board, and largest number of points, with clutter, over the number of corners.
const MOST_CORNERS: usize = 2500;
const MOST_CLUTTER: usize = 10;
/// Difference of scores, as a part of the corners, below which placements are equally good.
const ALIKE: f64 = 0.08;
/// Number of corners beyond the board that show that it is larger.
const BEYOND: usize = 4;
/// Difference of the cosines of the directions of rows below which they run in the same direction.
const SAME_DIRECTION: f64 = 0.3;
/// Smallest part of the corners in view that must be found.
const FOUND: f64 = 0.5;

/// Node or position on the board, and the index of the point there.
type NodePoint = ((i32, i32), usize);

/// Largest distance of a corner from the prediction of the homography, as a part of a step.
const PLACE_ERROR: f64 = 0.15;
/// Number of points of a lattice of which one is dropped at a time, if no homography agrees with them.
const DROPPED: usize = 40;
/// Largest distance to the next node, in steps: a row of corners may be missing, for example if each is in a single
/// micro-image.
const GAP: i32 = 2;
/// Decrease of the score by a point of the lattice beyond the board, in corners.
const BEYOND_SCORE: f64 = 2.0;
/// Distance, as a part of a step, below which outer corners are at the same position.
const SAME_PLACE: f64 = 0.4;

/// Returns an error if boards of this size cannot be found.
pub fn check_board_size(board: &Board) -> Result<(), Error> {
    size_in_reach(board).map(|_| ()).map_err(|rejection| Error::invalid(rejection.to_string()))
}

impl LabelledBoard {
    /// Labels points with the corners of a board. Returns an error if they show no board, or if corners are missing and the rest
    /// could be several parts of it.
    ///
    /// Corners out of view may be missing, so a board that is cut by the border of the image is recognised by its other sides.
    /// If none of these tells, labels are in the middle of the board.
    /// Colours of the squares count if they are known; the square before corner 0 is dark. If the board, or its visible part,
    /// is the same when turned, the placement is taken whose rows run most to the right. If rows run up and down or diagonally,
    /// it is the placement with corner 0 on top.
    pub fn label(
        points: &[LatticePoint],
        board: &Board,
        in_view: &(dyn Fn(&Vector2<f64>) -> bool + Sync),
    ) -> Result<Self, Issue> {
        if points.len() < FEWEST {
            return Err(Issue::TooFewCorners { corners: points.len() });
        }
        let corners = size_in_reach(board)?;
        if points.len() > MOST_CLUTTER * corners.max(FEWEST * FEWEST) {
            return Err(Issue::TooMuchTexture { places: points.len(), corners });
        }
        let view = View { points, board, in_view };
        let places: Vec<Vector2<f64>> = points.iter().map(|point| point.place).collect();
        let mut placements: Vec<Placement> =
            lattices(&places, board).iter().flat_map(|nodes| view.placements(nodes)).collect();
        placements.sort_by(|a, b| b.score.total_cmp(&a.score));
        let (best, elsewhere) = best_of(&placements, board)?;
        let (found, in_view) = (best.labelled(), best.labelled() + best.missing);
        if (found as f64) < FOUND * in_view as f64 || found < FEWEST {
            return Err(Issue::TooFewInView { found, in_view });
        }
        let labelled = Self { elsewhere, ..view.completed(best) };
        let beyond = view.beyond(&labelled);
        if beyond >= BEYOND {
            let (columns, rows) = (board.columns, board.rows);
            return Err(Issue::BeyondBoard { corners: beyond, columns, rows });
        }
        Ok(labelled)
    }

    /// Returns the pinhole image of a corner, px.
    pub fn pinhole(&self, board: &Board, corner: i32) -> Vector2<f64> {
        project(&self.homography, &coordinates(board, corner))
    }

    /// Returns the steps of the pinhole image along row and column from a corner to the next, px.
    pub fn steps(&self, board: &Board, corner: i32) -> (Vector2<f64>, Vector2<f64>) {
        const PART: f64 = 1e-3;
        let at = coordinates(board, corner);
        let step = |axis: Vector2<f64>| {
            let side = |sign: f64| project(&self.homography, &(at + axis * (sign * PART)));
            (side(0.5) - side(-0.5)) / PART
        };
        (step(Vector2::x()), step(Vector2::y()))
    }
}

/// Returns the number of corners of a board; an error if boards of this size are not searched for.
fn size_in_reach(board: &Board) -> Result<usize, Issue> {
    let corners = usize::try_from(board.corners()).unwrap_or(usize::MAX);
    if (FEWEST..=MOST_CORNERS).contains(&corners) {
        return Ok(corners);
    }
    let (columns, rows) = (board.columns, board.rows);
    Err(Issue::BoardSize { columns, rows, fewest: FEWEST, most: MOST_CORNERS })
}

/// Returns the best of some placements, which are in the order of their scores, highest first, and the number of points at
/// another one that is about as good.
fn best_of<'a>(
    placements: &'a [Placement],
    board: &Board,
) -> Result<(&'a Placement, Option<usize>), Issue> {
    let best = placements.first().ok_or(Issue::NoLattice)?;
    let limit = best.score - ALIKE * f64::from(board.corners());
    // Among equally good placements, those whose rows run most to the right have to be at one position.
    let alike = || placements.iter().filter(|p| p.score >= limit);
    let rightmost = alike().map(Placement::rightwards).fold(f64::MIN, f64::max);
    let towards = || alike().filter(|p| p.rightwards() > rightmost - SAME_DIRECTION);
    let best = towards().next().unwrap_or(best);
    if let Some(other) = towards().find(|p| !p.covers(best)) {
        let (corners, elsewhere) = (best.labelled(), other.labelled());
        // The board continues out of view; otherwise corners in view would be missing.
        if best.missing as f64 > best.score - limit {
            return Err(Issue::SeveralPlaces { corners, elsewhere });
        }
        let as_good = towards().filter(|p| p.score >= best.score);
        let central = as_good
            .min_by(|a, b| a.off_middle(board).total_cmp(&b.off_middle(board)))
            .unwrap_or(best);
        return Ok((central, Some(elsewhere)));
    }
    // The remaining placements differ by turns only.
    let top = |p: &&Placement| p.outline[0].y;
    let best = towards().min_by(|a, b| top(a).total_cmp(&top(b))).unwrap_or(best);
    // Another placement at this position may label more corners of the board.
    Ok((towards().find(|p| p.is_at(best)).unwrap_or(best), None))
}

fn coordinates(board: &Board, corner: i32) -> Vector2<f64> {
    Vector2::new(
        f64::from(corner.rem_euclid(board.columns)),
        f64::from(corner.div_euclid(board.columns)),
    )
}

/// Points, the board that they may be corners of, and the region in view.
struct View<'a> {
    pub points: &'a [LatticePoint],
    pub board: &'a Board,
    pub in_view: &'a (dyn Fn(&Vector2<f64>) -> bool + Sync),
}

/// Placement of points on the board.
struct Placement {
    /// Corner of each point.
    pub corners: Vec<Option<i32>>,
    homography: Matrix3<f64>,
    /// Positions of the four outer corners, px.
    pub outline: [Vector2<f64>; 4],
    /// Number of corners in view without a point.
    pub missing: usize,
    /// Number of points that are corners, less penalties.
    pub score: f64,
}

impl View<'_> {
    /// Returns all placements of a lattice on the board.
    pub fn placements(&self, nodes: &Nodes) -> Vec<Placement> {
        let Some((nodes, homography)) = self.regular(nodes) else { return Vec::new() };
        let nodes = self.across_gaps(nodes, &homography);
        let of_turn = |quarter_turns: u8| {
            let turned: Vec<NodePoint> =
                nodes.iter().map(|&(at, i)| (turned(at, quarter_turns), i)).collect();
            let shifts = |of: fn(&(i32, i32)) -> i32, count: i32| {
                let values = || turned.iter().map(|(at, _)| of(at));
                let (low, high) = (values().min().unwrap_or(0), values().max().unwrap_or(0));
                let last = high - count + 1;
                low.min(last)..=low.max(last)
            };
            let lefts = shifts(|at| at.0, self.board.columns);
            let places: Vec<(i32, i32)> = shifts(|at| at.1, self.board.rows)
                .flat_map(|top| lefts.clone().map(move |left| (left, top)))
                .collect();
            let at_place = |&(left, top): &(i32, i32)| {
                // The matrix maps corners of the board to nodes.
                let (ex, ey, origin) = match quarter_turns {
                    0 => ((1, 0), (0, 1), (left, top)),
                    1 => ((0, -1), (1, 0), (top, -left)),
                    2 => ((-1, 0), (0, -1), (-left, -top)),
                    _ => ((0, 1), (-1, 0), (-top, left)),
                };
                let to_nodes = Matrix3::new(
                    ex.0, ey.0, origin.0, //
                    ex.1, ey.1, origin.1, //
                    0, 0, 1,
                )
                .map(f64::from);
                let shifted = turned.iter().map(|&((x, y), i)| ((x - left, y - top), i));
                self.placement(shifted, homography * to_nodes)
            };
            places.par_iter().map(at_place).collect::<Vec<Placement>>()
        };
        (0..4).flat_map(of_turn).collect()
    }

    /// Returns the points of a lattice that a homography agrees with, by node, and the homography.
    fn regular(&self, nodes: &Nodes) -> Option<(Vec<NodePoint>, Matrix3<f64>)> {
        let mut kept: Vec<NodePoint> = nodes.iter().map(|(&at, &i)| (at, i)).collect();
        // The order of a hash map changes from run to run.
        kept.sort_unstable();
        loop {
            let pairs: Vec<Pair> = kept
                .iter()
                .map(|&((x, y), i)| {
                    (Vector2::new(f64::from(x), f64::from(y)), self.points[i].place)
                })
                .collect();
            let homography = homography(&pairs)?;
            let off = |(at, place): &Pair| {
                (project(&homography, at) - place).norm() / step_at(&homography, at)
            };
            let mut errors: Vec<(f64, usize)> = pairs.iter().map(off).zip(0..).collect();
            // NaN comes first.
            errors.sort_by(|a, b| b.0.total_cmp(&a.0));
            if !errors[0].0.is_finite() {
                return None;
            }
            let mut wrong: Vec<usize> = errors
                .into_iter()
                .take_while(|(error, _)| *error >= PLACE_ERROR)
                .map(|(_, i)| i)
                .take(kept.len().div_ceil(DROPPED))
                .collect();
            if wrong.is_empty() {
                return Some((kept, homography));
            }
            wrong.sort_unstable();
            for i in wrong.into_iter().rev() {
                kept.swap_remove(i);
            }
            if kept.len() < FEWEST {
                return None;
            }
        }
    }

    /// Adds points that a lattice cannot grow to, since all corners of a row between are missing.
    fn across_gaps(&self, mut nodes: Vec<NodePoint>, homography: &Matrix3<f64>) -> Vec<NodePoint> {
        let Some(inverse) = homography.try_inverse() else { return nodes };
        let mut known: BTreeMap<(i32, i32), usize> = nodes.iter().copied().collect();
        let at_node = |i: usize| {
            let at = project(&inverse, &self.points[i].place);
            let rounded = at.map(f64::round);
            ((at - rounded).norm(), rounded, i)
        };
        let mut free: Vec<usize> = (0..self.points.len()).collect();
        free.retain(|i| nodes.iter().all(|(_, known)| known != i));
        let mut free: Vec<_> = free.into_iter().map(at_node).collect();
        // If several points are at one node, the nearest counts.
        free.sort_by(|a, b| a.0.total_cmp(&b.0));
        for (error, rounded, i) in free {
            #[allow(clippy::cast_possible_truncation)] // saturates far from the lattice
            let (x, y) = (rounded.x as i32, rounded.y as i32);
            let near = || {
                let reach = |of: i32| of.saturating_sub(GAP)..=of.saturating_add(GAP);
                reach(y).any(|y| reach(x).any(|x| known.contains_key(&(x, y))))
            };
            if error < PLACE_ERROR && !known.contains_key(&(x, y)) && near() {
                known.insert((x, y), i);
                nodes.push(((x, y), i));
            }
        }
        nodes
    }

    /// Creates the placement of points at positions on the board (column, row), some of them beyond it.
    fn placement(
        &self,
        points: impl Iterator<Item = NodePoint>,
        homography: Matrix3<f64>,
    ) -> Placement {
        let board = self.board;
        let mut corners = vec![None; self.points.len()];
        let mut found = vec![false; usize::try_from(board.corners()).unwrap_or(0)];
        let mut score = 0.0;
        for ((column, row), i) in points {
            // Only a larger board continues the lattice, so points beyond the board contradict the placement.
            score -= BEYOND_SCORE;
            if (0..board.columns).contains(&column) && (0..board.rows).contains(&row) {
                let corner = row * board.columns + column;
                corners[i] = Some(corner);
                found[usize::try_from(corner).unwrap_or(0)] = true;
                score += BEYOND_SCORE + 1.0;
                let at = coordinates(board, corner);
                let diagonal = project(&homography, &(at + Vector2::new(1.0, 1.0)))
                    - project(&homography, &at);
                let bright = diagonal.dot(&(self.points[i].squares * diagonal));
                let is_even = (column + row) % 2 == 0;
                // The squares before corner 0 and after even corners are dark.
                if bright != 0.0 && (bright < 0.0) != is_even {
                    score -= 2.0;
                }
            }
        }
        score -= self.between(&corners, &homography) as f64;
        let in_view =
            |corner: &i32| (self.in_view)(&project(&homography, &coordinates(board, *corner)));
        let missing = (0..board.corners())
            .filter(|&corner| !found[usize::try_from(corner).unwrap_or(0)])
            .filter(in_view)
            .count();
        let last = board.corners() - 1;
        let outline = [0, board.columns - 1, last, last - board.columns + 1]
            .map(|corner| project(&homography, &coordinates(board, corner)));
        Placement { corners, homography, outline, missing, score: score - missing as f64 }
    }

    /// Returns the number of points inside the board that are no corners of it: a lattice of steps across corners leaves some
    /// out.
    fn between(&self, corners: &[Option<i32>], homography: &Matrix3<f64>) -> usize {
        let Some(inverse) = homography.try_inverse() else { return 0 };
        let (right, bottom) = (f64::from(self.board.columns - 1), f64::from(self.board.rows - 1));
        let is_inside = |point: &LatticePoint| {
            let at = project(&inverse, &point.place);
            (0.0..=right).contains(&at.x) && (0.0..=bottom).contains(&at.y)
        };
        let free = self.points.iter().zip(corners).filter(|(_, corner)| corner.is_none());
        free.filter(|(point, _)| is_inside(point)).count()
    }

    /// Returns the number of points at the next nodes of the lattice beyond the board.
    pub fn beyond(&self, labelled: &LabelledBoard) -> usize {
        let inverse = labelled.homography.try_inverse().unwrap_or_else(Matrix3::zeros);
        let (right, bottom) = (self.board.columns, self.board.rows);
        let is_beyond = |point: &LatticePoint| {
            let at = project(&inverse, &point.place);
            let node = at.map(f64::round);
            let outside = node.x < 0.0
                || node.y < 0.0
                || node.x >= f64::from(right)
                || node.y >= f64::from(bottom);
            let next = (-1.0..=f64::from(right)).contains(&node.x)
                && (-1.0..=f64::from(bottom)).contains(&node.y);
            outside && next && (at - node).norm() < PLACE_ERROR
        };
        let free = self.points.iter().zip(&labelled.corners).filter(|(_, corner)| corner.is_none());
        free.filter(|(point, _)| is_beyond(point)).count()
    }

    /// Adds points at the positions of corners without one, and fits the homography to all points.
    pub fn completed(&self, placement: &Placement) -> LabelledBoard {
        let mut by_corner: BTreeMap<i32, usize> = BTreeMap::new();
        for (i, corner) in placement.corners.iter().enumerate() {
            by_corner.extend(corner.map(|corner| (corner, i)));
        }
        for corner in 0..self.board.corners() {
            let at = coordinates(self.board, corner);
            let expected = project(&placement.homography, &at);
            let off = |i: &usize| (self.points[*i].place - expected).norm();
            let free = (0..self.points.len()).filter(|&i| placement.corners[i].is_none());
            let nearest = free.min_by(|a, b| off(a).total_cmp(&off(b)));
            let near = PLACE_ERROR * step_at(&placement.homography, &at);
            if let Some(i) = nearest.filter(|i| off(i) < near) {
                by_corner.entry(corner).or_insert(i);
            }
        }
        let pairs: Vec<Pair> = by_corner
            .iter()
            .map(|(&corner, &i)| (coordinates(self.board, corner), self.points[i].place))
            .collect();
        let mut corners = vec![None; self.points.len()];
        for (corner, i) in by_corner {
            corners[i] = Some(corner);
        }
        let homography = homography(&pairs).unwrap_or(placement.homography);
        LabelledBoard { corners, homography, elsewhere: None }
    }
}

impl Placement {
    /// Returns the number of points that are corners.
    pub fn labelled(&self) -> usize {
        self.corners.iter().flatten().count()
    }

    /// Returns the distance of the mean of the labels from the middle of the board, in squares.
    pub fn off_middle(&self, board: &Board) -> f64 {
        let sum: Vector2<f64> =
            self.corners.iter().flatten().map(|&corner| coordinates(board, corner)).sum();
        let middle = Vector2::new(f64::from(board.columns - 1), f64::from(board.rows - 1)) / 2.0;
        (sum / self.labelled().max(1) as f64 - middle).norm()
    }

    /// Returns true if the board is at the same position.
    pub fn is_at(&self, other: &Self) -> bool {
        let step = step_at(&self.homography, &Vector2::zeros());
        self.outline.iter().zip(&other.outline).all(|(a, b)| (a - b).norm() < SAME_PLACE * step)
    }

    /// Returns true if the board is at the same position, or turned there.
    pub fn covers(&self, other: &Self) -> bool {
        let step = step_at(&self.homography, &Vector2::zeros());
        let is_outer =
            |a: &Vector2<f64>| other.outline.iter().any(|b| (a - b).norm() < SAME_PLACE * step);
        self.outline.iter().all(is_outer)
    }

    /// Returns the cosine of the direction of rows to the right, from −1 to 1.
    pub fn rightwards(&self) -> f64 {
        let row = self.outline[1] - self.outline[0];
        row.x / row.norm()
    }
}
