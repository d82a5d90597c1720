//! Which corner of the board is which: the lattice that pinhole images of corners make.

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

/// The pinhole image of a corner, and how the squares about it lie.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LatticePoint {
    /// Position, px.
    pub place: Vector2<f64>,
    /// A form that is positive along directions to bright squares and negative to dark ones; zero if
    /// that is not known.
    pub squares: Matrix2<f64>,
}

/// Points labelled with the corners of a board.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct LabelledBoard {
    /// The corner that each point is; `None` for those that are no corner of the board.
    pub corners: Vec<Option<i32>>,
    /// From (column, row, 1) of a corner to its pinhole image, px.
    pub homography: Matrix3<f64>,
}

/// Corners of the largest board that is searched for, and how many times as many points there may be with
/// clutter.
const MOST_CORNERS: usize = 2500;
const MOST_CLUTTER: usize = 10;
/// Placements whose scores differ by less than this part of the corners are equally good.
const ALIKE: f64 = 0.08;
/// So many corners beyond the board show that it is larger.
const BEYOND: usize = 4;
/// Rows whose directions to the right, as cosines, differ by less run in the same direction.
const SAME_DIRECTION: f64 = 0.3;
/// Least part of the corners in view that are found.
const FOUND: f64 = 0.5;

/// A node, or a place on the board, and the point there.
type NodePoint = ((i32, i32), usize);

/// A corner is where the homography puts it within this part of a step.
const PLACE_ERROR: f64 = 0.15;
/// Of the points of a lattice that no homography agrees with one in so many is dropped at a time.
const DROPPED: usize = 40;
/// A row of corners may be missing between others, as where each is seen in a single micro-image.
const GAP: i32 = 2;
/// What a point of the lattice beyond the board takes from the score, in corners.
const BEYOND_SCORE: f64 = 2.0;
/// Outer corners less than this part of a step apart are at the same place.
const SAME_PLACE: f64 = 0.4;

/// An error unless boards of this size can be found.
pub fn check_board_size(board: &Board) -> Result<(), Error> {
    size_in_reach(board).map(|_| ()).map_err(|rejection| Error::invalid(rejection.to_string()))
}

impl LabelledBoard {
    /// Labels points with the corners of a board; the reason if they show none, or could be several parts
    /// of it.
    ///
    /// Corners at places out of view may be missing, so that a board that is cut by the border of the
    /// image is recognised by its other sides. Colours of the squares count where they are known; corner
    /// 0 has a dark square before it. Where the board, or what shows of it, is the same when turned, the
    /// placement is taken whose rows run most to the right; of those whose rows run up and down or
    /// diagonally, the one with corner 0 on top.
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
        let best = best_of(&placements, board)?;
        let (found, in_view) = (best.labelled(), best.labelled() + best.missing);
        if (found as f64) < FOUND * in_view as f64 || found < FEWEST {
            return Err(Issue::TooFewInView { found, in_view });
        }
        let labelled = view.completed(best);
        let beyond = view.beyond(&labelled);
        if beyond >= BEYOND {
            let (columns, rows) = (board.columns, board.rows);
            return Err(Issue::BeyondBoard { corners: beyond, columns, rows });
        }
        Ok(labelled)
    }

    /// Pinhole image of a corner, px.
    pub fn pinhole(&self, board: &Board, corner: i32) -> Vector2<f64> {
        project(&self.homography, &coordinates(board, corner))
    }

    /// Directions of row and column at a corner, in px of the pinhole image to the next corner.
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

/// Number of corners of a board; the reason if boards of this size are not searched for.
fn size_in_reach(board: &Board) -> Result<usize, Issue> {
    let corners = usize::try_from(board.corners()).unwrap_or(usize::MAX);
    if (FEWEST..=MOST_CORNERS).contains(&corners) {
        return Ok(corners);
    }
    let (columns, rows) = (board.columns, board.rows);
    Err(Issue::BoardSize { columns, rows, fewest: FEWEST, most: MOST_CORNERS })
}

/// The best of some placements, the one with the highest score first.
fn best_of<'a>(placements: &'a [Placement], board: &Board) -> Result<&'a Placement, Issue> {
    let best = placements.first().ok_or(Issue::NoLattice)?;
    let limit = best.score - ALIKE * f64::from(board.corners());
    // Of those that are equally good the one whose rows run most to the right; that has to be one place.
    let alike = || placements.iter().filter(|p| p.score >= limit);
    let rightmost = alike().map(Placement::rightwards).fold(f64::MIN, f64::max);
    let towards = || alike().filter(|p| p.rightwards() > rightmost - SAME_DIRECTION);
    let best = towards().next().unwrap_or(best);
    if let Some(other) = towards().find(|p| !p.covers(best)) {
        let (corners, elsewhere) = (best.labelled(), other.labelled());
        return Err(Issue::SeveralPlaces { corners, elsewhere });
    }
    // What is left is the board, turned.
    let top = |p: &&Placement| p.outline[0].y;
    let best = towards().min_by(|a, b| top(a).total_cmp(&top(b))).unwrap_or(best);
    // Another placement there may label more of its corners.
    Ok(towards().find(|p| p.is_at(best)).unwrap_or(best))
}

fn coordinates(board: &Board, corner: i32) -> Vector2<f64> {
    Vector2::new(
        f64::from(corner.rem_euclid(board.columns)),
        f64::from(corner.div_euclid(board.columns)),
    )
}

/// Points, the board that they may be corners of, and where corners would show.
struct View<'a> {
    pub points: &'a [LatticePoint],
    pub board: &'a Board,
    pub in_view: &'a (dyn Fn(&Vector2<f64>) -> bool + Sync),
}

/// Points placed on the board.
struct Placement {
    /// The corner that each point is.
    pub corners: Vec<Option<i32>>,
    homography: Matrix3<f64>,
    /// The four outer corners, px.
    pub outline: [Vector2<f64>; 4],
    /// Number of corners that should show but do not.
    pub missing: usize,
    /// Number of points that are corners, less what speaks against it.
    pub score: f64,
}

impl View<'_> {
    /// Every way to place a lattice on the board.
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
                // From corners of the board to nodes.
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

    /// The points of a lattice that a homography agrees with, by node, and the homography.
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

    /// These and the points that a lattice cannot grow to, since all corners of a row between are missing.
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
        // Of several at one node the nearest counts.
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

    /// Points by place on the board (column, row), some of them beyond it.
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
            // A corner beyond the board is none of it, and nothing else makes a lattice go on there.
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
                // The square before corner 0 is dark, and so are those after even corners.
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

    /// Number of points inside the board that are no corners of it: a lattice of steps across corners leaves some out.
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

    /// Number of points at the next places of the lattice beyond the board.
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

    /// Labels points at the places of corners that have none yet, and fits the homography to all of them.
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
        LabelledBoard { corners, homography: homography(&pairs).unwrap_or(placement.homography) }
    }
}

impl Placement {
    /// Number of points that are corners.
    pub fn labelled(&self) -> usize {
        self.corners.iter().flatten().count()
    }

    /// Whether the board is at the same place.
    pub fn is_at(&self, other: &Self) -> bool {
        let step = step_at(&self.homography, &Vector2::zeros());
        self.outline.iter().zip(&other.outline).all(|(a, b)| (a - b).norm() < SAME_PLACE * step)
    }

    /// Whether the board is at the same place, or turned there.
    pub fn covers(&self, other: &Self) -> bool {
        let step = step_at(&self.homography, &Vector2::zeros());
        let is_outer =
            |a: &Vector2<f64>| other.outline.iter().any(|b| (a - b).norm() < SAME_PLACE * step);
        self.outline.iter().all(is_outer)
    }

    /// How far to the right rows run, from −1 to 1.
    pub fn rightwards(&self) -> f64 {
        let row = self.outline[1] - self.outline[0];
        row.x / row.norm()
    }
}
