//! Which corner of the board is which: the lattice that pinhole images of corners make.

mod homography;
mod lattice;
mod placement;
#[cfg(test)]
mod tests;

use nalgebra::{Matrix2, Matrix3, Vector2};

use self::homography::project;
use self::lattice::lattices;
use self::placement::{Placement, View};
use super::Rejection;
use crate::error::Error;
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

/// Fewest points that make a lattice, and its homography with some redundancy.
const FEWEST: usize = 6;
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
    ) -> Result<Self, Rejection> {
        if points.len() < FEWEST {
            return Err(Rejection::TooFewCorners { corners: points.len() });
        }
        let corners = size_in_reach(board)?;
        if points.len() > MOST_CLUTTER * corners.max(FEWEST * FEWEST) {
            return Err(Rejection::TooMuchTexture { places: points.len(), corners });
        }
        let view = View { points, board, in_view };
        let mut placements: Vec<Placement> =
            lattices(points, board).iter().flat_map(|nodes| view.placements(nodes)).collect();
        placements.sort_by(|a, b| b.score.total_cmp(&a.score));
        let best = best_of(&placements, board)?;
        let (found, in_view) = (best.labelled(), best.labelled() + best.missing);
        if (found as f64) < FOUND * in_view as f64 || found < FEWEST {
            return Err(Rejection::TooFewInView { found, in_view });
        }
        let labelled = view.completed(best);
        let beyond = view.beyond(&labelled);
        if beyond >= BEYOND {
            let (columns, rows) = (board.columns, board.rows);
            return Err(Rejection::BeyondBoard { corners: beyond, columns, rows });
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
fn size_in_reach(board: &Board) -> Result<usize, Rejection> {
    let corners = usize::try_from(board.corners()).unwrap_or(usize::MAX);
    if (FEWEST..=MOST_CORNERS).contains(&corners) {
        return Ok(corners);
    }
    let (columns, rows) = (board.columns, board.rows);
    Err(Rejection::BoardSize { columns, rows, fewest: FEWEST, most: MOST_CORNERS })
}

/// The best of some placements, the one with the highest score first.
fn best_of<'a>(placements: &'a [Placement], board: &Board) -> Result<&'a Placement, Rejection> {
    let best = placements.first().ok_or(Rejection::NoLattice)?;
    let limit = best.score - ALIKE * f64::from(board.corners());
    // Of those that are equally good the one whose rows run most to the right; that has to be one place.
    let alike = || placements.iter().filter(|p| p.score >= limit);
    let rightmost = alike().map(Placement::rightwards).fold(f64::MIN, f64::max);
    let towards = || alike().filter(|p| p.rightwards() > rightmost - SAME_DIRECTION);
    let best = towards().next().unwrap_or(best);
    if let Some(other) = towards().find(|p| !p.covers(best)) {
        let (corners, elsewhere) = (best.labelled(), other.labelled());
        return Err(Rejection::SeveralPlaces { corners, elsewhere });
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
