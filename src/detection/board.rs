//! Which corner of the board is which: the lattice that pinhole images of corners make.

use std::collections::{BTreeMap, HashMap};

use nalgebra::{DMatrix, Matrix2, Matrix3, Vector2, Vector3};
use rayon::prelude::*;

use super::cells::Cells;
use crate::error::Error;
use crate::model::Board;

/// The pinhole image of a corner, and how the squares about it lie.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LatticePoint {
    /// Position, px.
    pub place: Vector2<f64>,
    /// A form that is positive along directions to bright squares and negative to dark ones; zero if
    /// that is not known.
    pub squares: Matrix2<f64>,
}

/// Points tied to the corners of a board.
#[derive(Debug, Clone, PartialEq)]
pub struct TiedBoard {
    /// For each point its corner; `None` for those that are no corner of the board.
    pub corners: Vec<Option<i32>>,
    /// From (column, row, 1) of a corner to its pinhole image, px.
    pub homography: Matrix3<f64>,
}

/// Fewest points that make a lattice and its homography with some redundancy.
const FEWEST: usize = 6;
/// Boards are looked for up to this size, and among so many times as many points.
const MOST_CORNERS: usize = 2500;
const MOST_CLUTTER: usize = 10;
/// Neighbours that a lattice may start with.
const NEIGHBOURS: usize = 6;
/// Points that a lattice is grown from.
const SEEDS: usize = 40;
/// A neighbour is where the last step leads within this part of it; perspective changes steps slowly.
const STEP_ERROR: f64 = 0.3;
/// A corner is where the homography puts it within this part of a step.
const PLACE_ERROR: f64 = 0.15;
/// Of a lattice that no homography agrees with one in so many points is dropped at a time.
const DROPPED: usize = 40;
/// Labellings of the points that are tried on the board.
const TRIED: usize = 12;
/// Placements whose scores differ by less than this part of the corners cannot be told apart.
const ALIKE: f64 = 0.08;
/// Outer corners at places that differ by less than this part of a step are the same.
const SAME_PLACE: f64 = 0.4;
/// So many corners beyond the board say that it is larger.
const BEYOND: usize = 4;
/// Rows whose directions to the right, as cosines, differ by less run in the same direction.
const SAME_DIRECTION: f64 = 0.3;
/// Part of the corners in view that has to be there.
const FOUND: f64 = 0.5;

type Labels = HashMap<(i32, i32), usize>;
/// A place on the board, in columns and rows, and in the image.
type Pair = (Vector2<f64>, Vector2<f64>);

impl TiedBoard {
    /// An error unless boards of this size can be looked for.
    pub fn check_size(board: &Board) -> Result<(), Error> {
        let corners = usize::try_from(board.corners()).unwrap_or(usize::MAX);
        if (FEWEST..=MOST_CORNERS).contains(&corners) {
            return Ok(());
        }
        Err(Error::invalid(format!(
            "a board of {} x {} inner corners cannot be looked for: it takes {FEWEST} to \
             {MOST_CORNERS} of them",
            board.columns, board.rows
        )))
    }

    /// Ties points to a board; an error in words if they show none, or could be several parts of it.
    ///
    /// Corners at places where they should show but do not speak against a placement, so that a board
    /// that is cut by the border of the image is recognised by its other sides. Colours of the squares
    /// count where they are known; corner 0 has a dark square before it. Where the board, or what shows
    /// of it, is the same when turned, the placement is taken whose rows run most to the right; of those
    /// that run up and down, or up and down on a slant, the one with corner 0 on top.
    pub fn tie(
        points: &[LatticePoint],
        board: &Board,
        in_view: &(dyn Fn(&Vector2<f64>) -> bool + Sync),
    ) -> Result<Self, String> {
        if points.len() < FEWEST {
            return Err(format!("{} corners are too few for a board", points.len()));
        }
        Self::check_size(board).map_err(|e| e.to_string())?;
        let corners = usize::try_from(board.corners()).unwrap_or(0);
        if points.len() > MOST_CLUTTER * corners.max(FEWEST * FEWEST) {
            return Err(format!(
                "{} places look like corners, but the board has {corners}: the image is full of texture",
                points.len()
            ));
        }
        let view = View { points, board, in_view };
        let mut placements: Vec<Placement> =
            labellings(points, board).iter().flat_map(|labels| view.placements(labels)).collect();
        placements.sort_by(|a, b| b.score.total_cmp(&a.score));
        let Some(best) = placements.first() else {
            return Err("the corners lie on no lattice".to_owned());
        };
        let limit = best.score - ALIKE * f64::from(board.corners());
        // Of what cannot be told apart, what runs most to the right; that has to be one place.
        let alike = || placements.iter().filter(|p| p.score >= limit);
        let rightmost = alike().map(Placement::rightwards).fold(f64::MIN, f64::max);
        let towards = || alike().filter(|p| p.rightwards() > rightmost - SAME_DIRECTION);
        let best = towards().next().unwrap_or(best);
        if let Some(other) = towards().find(|p| !p.covers(best)) {
            return Err(format!(
                "{} corners could be more than one part of the board (as many as {} at another \
                 place): show more of it, or its edges, or correct [board]",
                best.tied(),
                other.tied()
            ));
        }
        // What is left is the board, turned.
        let top = |p: &&Placement| p.outline[0].y;
        let best = towards().min_by(|a, b| top(a).total_cmp(&top(b))).unwrap_or(best);
        // The same again may tie more of its corners.
        let best = towards().find(|p| p.is_at(best)).unwrap_or(best);
        if (best.tied() as f64) < FOUND * (best.tied() + best.missing) as f64
            || best.tied() < FEWEST
        {
            return Err(format!(
                "only {} of the {} corners in view were found",
                best.tied(),
                best.tied() + best.missing
            ));
        }
        let tied = view.completed(best);
        let beyond = view.beyond(&tied);
        if beyond >= BEYOND {
            return Err(format!(
                "{beyond} corners lie on the lattice beyond the board of {} x {} inner corners: correct \
                 [board]",
                board.columns, board.rows
            ));
        }
        Ok(tied)
    }

    /// Pinhole image of a corner, px.
    #[must_use]
    pub fn pinhole(&self, board: &Board, corner: i32) -> Vector2<f64> {
        project(&self.homography, &coordinates(board, corner))
    }

    /// Directions of row and column at a corner, in px of the pinhole image to the next corner.
    #[must_use]
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

fn coordinates(board: &Board, corner: i32) -> Vector2<f64> {
    Vector2::new(
        f64::from(corner.rem_euclid(board.columns)),
        f64::from(corner.div_euclid(board.columns)),
    )
}

fn project(homography: &Matrix3<f64>, at: &Vector2<f64>) -> Vector2<f64> {
    let p = homography * Vector3::new(at.x, at.y, 1.0);
    p.xy() / p.z
}

/// Integer coordinates for points that lie on a lattice, those first of which most fit on the board.
fn labellings(points: &[LatticePoint], board: &Board) -> Vec<Labels> {
    let places: Vec<Vector2<f64>> = points.iter().map(|point| point.place).collect();
    let (low, high) = places.iter().fold((places[0], places[0]), |(a, b), p| (a.inf(p), b.sup(p)));
    let cells = Cells::new(&places, ((high - low).product() / places.len() as f64).sqrt());
    let of_seed = |seed: usize| {
        let mut others: Vec<usize> = (0..points.len()).filter(|&i| i != seed).collect();
        let away = |i: usize| places[i] - places[seed];
        others.sort_by(|&a, &b| away(a).norm().total_cmp(&away(b).norm()));
        others.truncate(NEIGHBOURS);
        let mut found: Vec<(usize, Labels)> = Vec::new();
        for &right in &others {
            for &down in &others {
                let (a, b) = (away(right), away(down));
                // Neither mirrored nor too skew to be the sides of a square in perspective.
                if a.perp(&b) > 0.35 * a.norm() * b.norm() && ratio(a.norm(), b.norm()) < 3.0 {
                    let labels = grow(&places, &cells, [seed, right, down]);
                    let fitting = fitting(&labels, board);
                    if fitting >= FEWEST {
                        found.push((fitting, labels));
                    }
                }
            }
        }
        found
    };
    let seeds: Vec<usize> = (0..points.len()).step_by(points.len().div_ceil(SEEDS)).collect();
    let mut all: Vec<(usize, Labels)> =
        seeds.par_iter().flat_map_iter(|&seed| of_seed(seed)).collect();
    // Skewed lattices hold as many points as the true one, but these do not fit on the board.
    all.sort_by_key(|(fitting, _)| std::cmp::Reverse(*fitting));
    // The same lattice, grown from another seed or in another direction, has the same points with the
    // same steps.
    let mut kept: Vec<Labels> = Vec::new();
    for (_, labels) in all {
        if kept.len() < TRIED && !kept.iter().any(|other| same_steps(other, &labels)) {
            kept.push(labels);
        }
    }
    kept
}

/// Most labels that a board covers, upright or on its side.
fn fitting(labels: &Labels, board: &Board) -> usize {
    let most = |columns: i32, rows: i32| {
        let xs = || labels.keys().map(|at| at.0);
        let (left, right) = (xs().min().unwrap_or(0), xs().max().unwrap_or(0));
        let top = labels.keys().map(|at| at.1).min().unwrap_or(0);
        let index = |y: i32| usize::try_from(y - top).unwrap_or(0);
        let height = labels.keys().map(|at| index(at.1)).max().unwrap_or(0) + 1;
        let from = |left: i32| {
            let mut in_row = vec![0; height];
            for at in labels.keys().filter(|at| (left..left + columns).contains(&at.0)) {
                in_row[index(at.1)] += 1;
            }
            let rows = usize::try_from(rows).unwrap_or(1).clamp(1, height);
            in_row.windows(rows).map(|rows| rows.iter().sum::<usize>()).max().unwrap_or(0)
        };
        (left..=left.max(right - columns + 1)).map(from).max().unwrap_or(0)
    };
    most(board.columns, board.rows).max(most(board.rows, board.columns))
}

fn ratio(a: f64, b: f64) -> f64 {
    (a / b).max(b / a)
}

/// Whether two labellings of the same points differ by a shift and quarter turns of the coordinates only.
fn same_steps(a: &Labels, b: &Labels) -> bool {
    if a.len() != b.len() {
        return false;
    }
    let of_point: HashMap<usize, (i32, i32)> = b.iter().map(|(&at, &i)| (i, at)).collect();
    let same = |quarter_turns: u8| {
        let mut shift = None;
        a.iter().all(|(&at, i)| {
            let (x, y) = turned(at, quarter_turns);
            of_point
                .get(i)
                .is_some_and(|&(u, v)| *shift.get_or_insert((x - u, y - v)) == (x - u, y - v))
        })
    };
    (0..4).any(same)
}

fn turned((x, y): (i32, i32), quarter_turns: u8) -> (i32, i32) {
    match quarter_turns {
        0 => (x, y),
        1 => (-y, x),
        2 => (-x, -y),
        _ => (y, -x),
    }
}

/// Grows a lattice from a point and its neighbours to the right and below.
fn grow(places: &[Vector2<f64>], cells: &Cells, [seed, right, down]: [usize; 3]) -> Labels {
    let mut labels = Labels::from([((0, 0), seed), ((1, 0), right), ((0, 1), down)]);
    let mut taken = vec![false; places.len()];
    for i in [seed, right, down] {
        taken[i] = true;
    }
    let place = |i: usize| places[i];
    let first = [place(right) - place(seed), place(down) - place(seed)];
    let mut open = vec![(0, 0), (1, 0), (0, 1)];
    let mut next = 0;
    while let Some(&(x, y)) = open.get(next) {
        next += 1;
        let here = place(labels[&(x, y)]);
        for (dx, dy) in [(1, 0), (-1, 0), (0, 1), (0, -1)] {
            let to = (x + dx, y + dy);
            if labels.contains_key(&to) {
                continue;
            }
            // The step that led here, or the same one beside, or the first one.
            let at = |x, y| labels.get(&(x, y)).map(|&i| place(i));
            let step = at(x - dx, y - dy)
                .map(|before| here - before)
                .or_else(|| {
                    [(dy, dx), (-dy, -dx)]
                        .into_iter()
                        .find_map(|(sx, sy)| Some(at(to.0 + sx, to.1 + sy)? - at(x + sx, y + sy)?))
                })
                .unwrap_or_else(|| first[0] * f64::from(dx) + first[1] * f64::from(dy));
            let expected = here + step;
            let off = |i: &usize| (place(*i) - expected).norm();
            let near = cells.near(&expected, STEP_ERROR * step.norm());
            let free = near.into_iter().filter(|&i| !taken[i]);
            if let Some(i) = free.min_by(|a, b| off(a).total_cmp(&off(b))) {
                taken[i] = true;
                labels.insert(to, i);
                open.push(to);
            }
        }
    }
    labels
}

/// What is looked at.
struct View<'a> {
    points: &'a [LatticePoint],
    board: &'a Board,
    in_view: &'a (dyn Fn(&Vector2<f64>) -> bool + Sync),
}

/// Points placed on the board.
struct Placement {
    corners: Vec<Option<i32>>,
    homography: Matrix3<f64>,
    /// The four outer corners, px.
    outline: [Vector2<f64>; 4],
    /// Corners that should show.
    missing: usize,
    score: f64,
}

impl View<'_> {
    /// Every way to lay a labelled lattice onto the board.
    fn placements(&self, labels: &Labels) -> Vec<Placement> {
        let Some((labels, homography)) = self.regular(labels) else { return Vec::new() };
        let of_turn = |quarter_turns: u8| {
            let turned: Vec<((i32, i32), usize)> =
                labels.iter().map(|&(at, i)| (turned(at, quarter_turns), i)).collect();
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
                // From corners of the board to the labels.
                let (ex, ey, origin) = match quarter_turns {
                    0 => ((1, 0), (0, 1), (left, top)),
                    1 => ((0, -1), (1, 0), (top, -left)),
                    2 => ((-1, 0), (0, -1), (-left, -top)),
                    _ => ((0, 1), (-1, 0), (-top, left)),
                };
                let to_labels = Matrix3::new(
                    ex.0, ey.0, origin.0, //
                    ex.1, ey.1, origin.1, //
                    0, 0, 1,
                )
                .map(f64::from);
                let shifted = turned.iter().map(|&((x, y), i)| ((x - left, y - top), i));
                self.placement(shifted, homography * to_labels)
            };
            places.par_iter().map(at_place).collect::<Vec<Placement>>()
        };
        (0..4).flat_map(of_turn).collect()
    }

    /// The labels that a homography agrees with, and that.
    #[allow(clippy::type_complexity)] // named by the sentence above
    fn regular(&self, labels: &Labels) -> Option<(Vec<((i32, i32), usize)>, Matrix3<f64>)> {
        let mut kept: Vec<((i32, i32), usize)> = labels.iter().map(|(&at, &i)| (at, i)).collect();
        // The order of a hash map changes from run to run.
        kept.sort_unstable();
        loop {
            let pairs: Vec<(Vector2<f64>, Vector2<f64>)> = kept
                .iter()
                .map(|&((x, y), i)| {
                    (Vector2::new(f64::from(x), f64::from(y)), self.points[i].place)
                })
                .collect();
            let homography = homography(&pairs)?;
            let off = |(at, place): &(Vector2<f64>, Vector2<f64>)| {
                (project(&homography, at) - place).norm() / step_at(&homography, at)
            };
            let mut errors: Vec<(f64, usize)> = pairs.iter().map(off).zip(0..).collect();
            // Not a number comes first.
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

    fn placement(
        &self,
        labelled: impl Iterator<Item = ((i32, i32), usize)>,
        homography: Matrix3<f64>,
    ) -> Placement {
        let board = self.board;
        let mut corners = vec![None; self.points.len()];
        let mut found = vec![false; usize::try_from(board.corners()).unwrap_or(0)];
        let mut score = 0.0;
        for ((column, row), i) in labelled {
            if (0..board.columns).contains(&column) && (0..board.rows).contains(&row) {
                let corner = row * board.columns + column;
                corners[i] = Some(corner);
                found[usize::try_from(corner).unwrap_or(0)] = true;
                score += 1.0;
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

    /// Points at the next places of the lattice beyond the board.
    fn beyond(&self, tied: &TiedBoard) -> usize {
        let inverse = tied.homography.try_inverse().unwrap_or_else(Matrix3::zeros);
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
        let free = self.points.iter().zip(&tied.corners).filter(|(_, corner)| corner.is_none());
        free.filter(|(point, _)| is_beyond(point)).count()
    }

    /// Ties what is at the place of a corner without a point, and fits the homography to all.
    fn completed(&self, placement: &Placement) -> TiedBoard {
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
        let pairs: Vec<(Vector2<f64>, Vector2<f64>)> = by_corner
            .iter()
            .map(|(&corner, &i)| (coordinates(self.board, corner), self.points[i].place))
            .collect();
        let mut corners = vec![None; self.points.len()];
        for (corner, i) in by_corner {
            corners[i] = Some(corner);
        }
        TiedBoard { corners, homography: homography(&pairs).unwrap_or(placement.homography) }
    }
}

impl Placement {
    fn tied(&self) -> usize {
        self.corners.iter().flatten().count()
    }

    /// Whether the board is at the same place.
    fn is_at(&self, other: &Self) -> bool {
        let step = step_at(&self.homography, &Vector2::zeros());
        self.outline.iter().zip(&other.outline).all(|(a, b)| (a - b).norm() < SAME_PLACE * step)
    }

    /// Whether the board is at the same place, be it turned.
    fn covers(&self, other: &Self) -> bool {
        let step = step_at(&self.homography, &Vector2::zeros());
        let is_outer =
            |a: &Vector2<f64>| other.outline.iter().any(|b| (a - b).norm() < SAME_PLACE * step);
        self.outline.iter().all(is_outer)
    }

    /// How far to the right rows run, from −1 to 1.
    fn rightwards(&self) -> f64 {
        let row = self.outline[1] - self.outline[0];
        row.x / row.norm()
    }
}

/// Distance of a corner to the next, px.
fn step_at(homography: &Matrix3<f64>, at: &Vector2<f64>) -> f64 {
    let here = project(homography, at);
    let to = |step: Vector2<f64>| (project(homography, &(at + step)) - here).norm();
    to(Vector2::x()).min(to(Vector2::y()))
}

/// The homography between pairs of points, by the linear method on coordinates of unit size; `None`
/// if they do not determine it.
fn homography(pairs: &[Pair]) -> Option<Matrix3<f64>> {
    let count = pairs.len() as f64;
    let unit = |of: fn(&Pair) -> Vector2<f64>| {
        let middle = pairs.iter().map(of).sum::<Vector2<f64>>() / count;
        let size = pairs.iter().map(|pair| (of(pair) - middle).norm()).sum::<f64>() / count;
        let scale = 1.0 / size.max(1e-12);
        Matrix3::new(scale, 0.0, -middle.x * scale, 0.0, scale, -middle.y * scale, 0.0, 0.0, 1.0)
    };
    let (from, to) = (unit(|pair| pair.0), unit(|pair| pair.1));
    // Two rows a pair; at least nine rows, so that all nine singular vectors come out.
    let mut rows = DMatrix::zeros((2 * pairs.len()).max(9), 9);
    for (i, (a, b)) in pairs.iter().enumerate() {
        let (a, b) = (project(&from, a), project(&to, b));
        let first = [a.x, a.y, 1.0, 0.0, 0.0, 0.0, -b.x * a.x, -b.x * a.y, -b.x];
        let second = [0.0, 0.0, 0.0, a.x, a.y, 1.0, -b.y * a.x, -b.y * a.y, -b.y];
        for (j, (first, second)) in first.into_iter().zip(second).enumerate() {
            rows[(2 * i, j)] = first;
            rows[(2 * i + 1, j)] = second;
        }
    }
    let v = rows.svd(false, true).v_t?;
    let last = v.row(8);
    let unit_homography = Matrix3::from_row_iterator(last.iter().copied());
    let homography = to.try_inverse()? * unit_homography * from;
    homography.iter().all(|x| x.is_finite()).then_some(homography)
}

#[cfg(test)]
mod tests;
