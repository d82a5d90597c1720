//! Lattices that points may lie on: integer coordinates, grown from neighbours.

use std::collections::HashMap;

use nalgebra::Vector2;
use rayon::prelude::*;

use crate::detection::cells::Cells;
use crate::model::Board;

/// Points at the nodes of a lattice, as indices.
pub(super) type Nodes = HashMap<(i32, i32), usize>;

/// Smallest number of points of a lattice, for its homography with some redundancy.
pub(super) const FEWEST: usize = 6;
/// Number of neighbours that a lattice may start with.
const NEIGHBOURS: usize = 6;
/// Number of points that lattices are grown from.
const SEEDS: usize = 40;
/// Largest distance of a neighbour from the end of the last step, as a part of it; perspective changes steps slowly.
const STEP_ERROR: f64 = 0.3;
/// Number of lattices that are placed on the board.
const TRIED: usize = 12;
/// Limits for the sides of a square in perspective: smallest sine of the angle between them, and largest ratio.
const LEAST_SINE: f64 = 0.35;
const LARGEST_RATIO: f64 = 3.0;

/// Returns lattices that points lie on, in descending order of the number of their points that fit on the board.
pub(super) fn lattices(places: &[Vector2<f64>], board: &Board) -> Vec<Nodes> {
    let (low, high) = places.iter().fold((places[0], places[0]), |(a, b), p| (a.inf(p), b.sup(p)));
    let cells = Cells::new(places, ((high - low).product() / places.len() as f64).sqrt());
    let of_seed = |seed: usize| {
        let mut others: Vec<usize> = (0..places.len()).filter(|&i| i != seed).collect();
        let away = |i: usize| places[i] - places[seed];
        others.sort_by(|&a, &b| away(a).norm().total_cmp(&away(b).norm()));
        others.truncate(NEIGHBOURS);
        let mut found: Vec<(usize, Nodes)> = Vec::new();
        for &right in &others {
            for &down in &others {
                let (a, b) = (away(right), away(down));
                // The steps are neither mirrored nor too skew to be the sides of a square in perspective.
                if a.perp(&b) > LEAST_SINE * a.norm() * b.norm()
                    && ratio(a.norm(), b.norm()) < LARGEST_RATIO
                {
                    let nodes = grow(places, &cells, [seed, right, down]);
                    let fitting = fitting(&nodes, board);
                    if fitting >= FEWEST {
                        found.push((fitting, nodes));
                    }
                }
            }
        }
        found
    };
    let seeds: Vec<usize> = (0..places.len()).step_by(places.len().div_ceil(SEEDS)).collect();
    let mut all: Vec<(usize, Nodes)> =
        seeds.par_iter().flat_map_iter(|&seed| of_seed(seed)).collect();
    // Skewed lattices hold as many points as the true one, but these do not fit on the board.
    all.sort_by_key(|(fitting, _)| std::cmp::Reverse(*fitting));
    // A lattice grown from another seed or in another direction has the same points with the same steps.
    let mut kept: Vec<Nodes> = Vec::new();
    for (_, nodes) in all {
        if kept.len() < TRIED && !kept.iter().any(|other| same_steps(other, &nodes)) {
            kept.push(nodes);
        }
    }
    kept
}

/// Returns the largest number of points that a board covers, upright or on its side.
fn fitting(nodes: &Nodes, board: &Board) -> usize {
    let most = |columns: i32, rows: i32| {
        let xs = || nodes.keys().map(|at| at.0);
        let (left, right) = (xs().min().unwrap_or(0), xs().max().unwrap_or(0));
        let top = nodes.keys().map(|at| at.1).min().unwrap_or(0);
        let index = |y: i32| usize::try_from(y - top).unwrap_or(0);
        let height = nodes.keys().map(|at| index(at.1)).max().unwrap_or(0) + 1;
        let from = |left: i32| {
            let mut in_row = vec![0; height];
            for at in nodes.keys().filter(|at| (left..left + columns).contains(&at.0)) {
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

/// Returns true if two lattices of the same points differ only by a shift and quarter turns of the coordinates.
fn same_steps(a: &Nodes, b: &Nodes) -> bool {
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

/// Returns a node after quarter turns about (0, 0).
pub(super) fn turned((x, y): (i32, i32), quarter_turns: u8) -> (i32, i32) {
    match quarter_turns {
        0 => (x, y),
        1 => (-y, x),
        2 => (-x, -y),
        _ => (y, -x),
    }
}

/// Grows a lattice from a point and its neighbours to the right and below.
fn grow(places: &[Vector2<f64>], cells: &Cells, [seed, right, down]: [usize; 3]) -> Nodes {
    let mut nodes = Nodes::from([((0, 0), seed), ((1, 0), right), ((0, 1), down)]);
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
        let here = place(nodes[&(x, y)]);
        for (dx, dy) in [(1, 0), (-1, 0), (0, 1), (0, -1)] {
            let to = (x + dx, y + dy);
            if nodes.contains_key(&to) {
                continue;
            }
            // The step is the one that led here, the same one beside it, or the first one.
            let at = |x, y| nodes.get(&(x, y)).map(|&i| place(i));
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
                nodes.insert(to, i);
                open.push(to);
            }
        }
    }
    nodes
}
