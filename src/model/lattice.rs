//! Lattices of micro-lenses: position and lens type of node (k, l).
//!
//! The C++ core contains the same formulas in `plenocal/camera.hpp`, since the simulator must not depend on the core that it
//! tests. A test compares both.

use std::fmt;

use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};

/// Packing of the micro-lenses without the parity of its shifted rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LatticeKind {
    /// Square lattice.
    Orthogonal,
    /// Hexagonal with straight rows: every other row is shifted by half a pitch along u.
    HexagonalRows,
    /// Hexagonal with straight columns: every other column is shifted by half a pitch along v.
    HexagonalColumns,
}

/// Packing of the micro-lenses with the parity of the shifted rows (columns) of a hexagonal lattice.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Packing {
    /// Square lattice, see [`LatticeKind::Orthogonal`].
    Orthogonal,
    /// Straight rows, see [`LatticeKind::HexagonalRows`]; rows of this parity are shifted by +½ pitch.
    HexagonalRows(Parity),
    /// Straight columns, see [`LatticeKind::HexagonalColumns`]; columns of this parity are shifted by +½ pitch.
    HexagonalColumns(Parity),
}

impl Packing {
    /// Creates a packing of this kind; only a hexagonal one has a parity.
    #[must_use]
    pub fn new(kind: LatticeKind, shifted: Parity) -> Self {
        match kind {
            LatticeKind::Orthogonal => Self::Orthogonal,
            LatticeKind::HexagonalRows => Self::HexagonalRows(shifted),
            LatticeKind::HexagonalColumns => Self::HexagonalColumns(shifted),
        }
    }

    /// Returns all packings of a kind.
    #[must_use]
    pub fn of_kind(kind: LatticeKind) -> &'static [Self] {
        match kind {
            LatticeKind::Orthogonal => &[Self::Orthogonal],
            LatticeKind::HexagonalRows => {
                &[Self::HexagonalRows(Parity::Even), Self::HexagonalRows(Parity::Odd)]
            }
            LatticeKind::HexagonalColumns => {
                &[Self::HexagonalColumns(Parity::Even), Self::HexagonalColumns(Parity::Odd)]
            }
        }
    }

    /// Returns the kind: orthogonal, or hexagonal by rows or by columns.
    #[must_use]
    pub fn kind(self) -> LatticeKind {
        match self {
            Self::Orthogonal => LatticeKind::Orthogonal,
            Self::HexagonalRows(_) => LatticeKind::HexagonalRows,
            Self::HexagonalColumns(_) => LatticeKind::HexagonalColumns,
        }
    }

    /// Returns the parity of the shifted rows (columns); `None` for an orthogonal lattice.
    #[must_use]
    pub fn shifted(self) -> Option<Parity> {
        match self {
            Self::Orthogonal => None,
            Self::HexagonalRows(parity) | Self::HexagonalColumns(parity) => Some(parity),
        }
    }
}

impl LatticeKind {
    /// Returns the name used in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Orthogonal => "orthogonal",
            Self::HexagonalRows => "hexagonal-rows",
            Self::HexagonalColumns => "hexagonal-columns",
        }
    }
}

/// Parity of the rows (columns) of a hexagonal lattice that are shifted by +½ pitch.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Parity {
    /// Rows (columns) of even index.
    Even,
    /// Rows (columns) of odd index.
    Odd,
}

impl Parity {
    fn name(self) -> &'static str {
        match self {
            Self::Even => "even",
            Self::Odd => "odd",
        }
    }

    /// Returns true if an index has this parity.
    #[must_use]
    pub fn holds(self, index: i32) -> bool {
        match self {
            Self::Even => index % 2 == 0,
            Self::Odd => index % 2 != 0,
        }
    }
}

/// Distance between the straight rows of a hexagonal lattice, in pitches: √3/2.
pub const ROW_DISTANCE: f64 = 0.866_025_403_784_438_6;

/// Lattice of `columns` × `rows` nodes (k, l); k grows along u and l along v.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Lattice {
    /// Packing of the nodes.
    pub packing: Packing,
    /// Number of nodes along k.
    pub columns: i32,
    /// Number of nodes along l.
    pub rows: i32,
}

impl fmt::Display for Lattice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "a lattice '{}' of {} x {}", self.kind().name(), self.columns, self.rows)?;
        match self.packing {
            Packing::Orthogonal => Ok(()),
            Packing::HexagonalRows(parity) => write!(f, " with {} rows shifted", parity.name()),
            Packing::HexagonalColumns(parity) => {
                write!(f, " with {} columns shifted", parity.name())
            }
        }
    }
}

impl Lattice {
    /// Returns the kind: orthogonal, or hexagonal by rows or by columns.
    #[must_use]
    pub fn kind(&self) -> LatticeKind {
        self.packing.kind()
    }

    /// Returns the number of nodes.
    #[must_use]
    pub fn nodes(&self) -> usize {
        let count = |n: i32| usize::try_from(n).unwrap_or(0);
        count(self.columns) * count(self.rows)
    }

    /// Returns true if the indices name a node.
    #[must_use]
    pub fn contains(&self, k: i32, l: i32) -> bool {
        (0..self.columns).contains(&k) && (0..self.rows).contains(&l)
    }

    /// Returns the number of a node, counted row by row; `None` if the indices name none.
    #[must_use]
    pub fn index(&self, k: i32, l: i32) -> Option<usize> {
        if !self.contains(k, l) {
            return None;
        }
        let [k, l, columns] = [k, l, self.columns].map(usize::try_from);
        Some(l.ok()? * columns.ok()? + k.ok()?)
    }

    /// Returns the position of node (k, l) in pitches along u and v, from the midpoint of the bounding box of all nodes.
    #[must_use]
    pub fn node(&self, k: i32, l: i32) -> Vector2<f64> {
        let centred = |index: i32, count: i32| f64::from(index) - f64::from(count - 1) / 2.0;
        let shift = |row: i32, shifted: Parity| if shifted.holds(row) { 0.5 } else { 0.0 };
        // `across` is the number of straight rows: shifted and unshifted rows together extend half a pitch further.
        let staggered = |index: i32, count: i32, row: i32, across: i32, shifted: Parity| {
            let mean_shift = if across > 1 { 0.25 } else { shift(0, shifted) };
            centred(index, count) + shift(row, shifted) - mean_shift
        };
        match self.packing {
            Packing::Orthogonal => Vector2::new(centred(k, self.columns), centred(l, self.rows)),
            Packing::HexagonalRows(shifted) => Vector2::new(
                staggered(k, self.columns, l, self.rows, shifted),
                ROW_DISTANCE * centred(l, self.rows),
            ),
            Packing::HexagonalColumns(shifted) => Vector2::new(
                ROW_DISTANCE * centred(k, self.columns),
                staggered(l, self.rows, k, self.columns, shifted),
            ),
        }
    }

    /// Returns the index of the lens type of node (k, l), from 0.
    ///
    /// Three types follow the unique 3-colouring of the hexagonal lattice. They are numbered so that (0, 0) has type 0, and its
    /// successor along the straight rows (columns) type 1. With fewer than three types, every node has type 0.
    #[must_use]
    pub fn lens_type(&self, k: i32, l: i32, types: usize) -> usize {
        if types < 3 {
            return 0;
        }
        let (along, across, shifted) = match self.packing {
            // Validated cameras have one type here.
            Packing::Orthogonal => return 0,
            Packing::HexagonalRows(shifted) => (k, l, shifted),
            Packing::HexagonalColumns(shifted) => (l, k, shifted),
        };
        let step = match shifted {
            Parity::Even => 1,
            Parity::Odd => 2,
        };
        usize::try_from((along + step * across.rem_euclid(2)).rem_euclid(3)).unwrap_or(0)
    }
}

/// Focus of the main lens with respect to the micro-lens array.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Configuration {
    /// Focus behind the array (and the sensor): f > d.
    Galilean,
    /// Focus in front of the array: f < d.
    Keplerian,
    /// Focus on the array: f = d.
    Unfocused,
}

/// Largest number of micro-lenses along a side, more than any sensor has pixels for.
pub const MAX_MICRO_LENSES: i32 = 1 << 16;

/// Largest number of micro-lenses, since every micro-image takes memory; an R12 has 26 000.
const MOST_IN_ALL: i64 = 1 << 24;

/// Returns an error unless an array can have these numbers of micro-lenses.
pub(crate) fn check_array_size(columns: i32, rows: i32) -> Result<()> {
    let possible = 1..=MAX_MICRO_LENSES;
    if possible.contains(&columns) && possible.contains(&rows) {
        if i64::from(columns) * i64::from(rows) <= MOST_IN_ALL {
            return Ok(());
        }
        return Err(Error::invalid(format!(
            "a micro-lens array of {columns} x {rows} is not possible: the limit is {MOST_IN_ALL} \
             micro-lenses"
        )));
    }
    Err(Error::invalid(format!(
        "a micro-lens array of {columns} x {rows} is not possible: each side has to have 1 to \
         {MAX_MICRO_LENSES} micro-lenses"
    )))
}

/// Returns an error unless the lattice can have this number of lens types.
pub(crate) fn check_lens_types(types: usize, kind: LatticeKind) -> Result<()> {
    match (types, kind) {
        (0 | 1, _) | (3, LatticeKind::HexagonalRows | LatticeKind::HexagonalColumns) => Ok(()),
        _ => Err(Error::invalid(format!(
            "{types} lens types on the lattice '{}' are not supported: give 0 (pinholes) or 1, or \
             3 on a hexagonal lattice",
            kind.name()
        ))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lattices() -> Vec<Lattice> {
        let mut lattices = Vec::new();
        for packing in [
            Packing::Orthogonal,
            Packing::HexagonalRows(Parity::Even),
            Packing::HexagonalRows(Parity::Odd),
            Packing::HexagonalColumns(Parity::Even),
            Packing::HexagonalColumns(Parity::Odd),
        ] {
            for (columns, rows) in [(7, 6), (6, 7), (1, 5), (5, 1)] {
                lattices.push(Lattice { packing, columns, rows });
            }
        }
        lattices
    }

    fn nodes(lattice: &Lattice) -> Vec<(i32, i32)> {
        (0..lattice.rows).flat_map(|l| (0..lattice.columns).map(move |k| (k, l))).collect()
    }

    #[test]
    fn nodes_are_centred_and_one_pitch_from_their_nearest() {
        for lattice in lattices() {
            let all = nodes(&lattice);
            let positions: Vec<_> = all.iter().map(|&(k, l)| lattice.node(k, l)).collect();
            let low = positions.iter().fold(positions[0], |a, b| a.inf(b));
            let high = positions.iter().fold(positions[0], |a, b| a.sup(b));
            assert!((low + high).norm() < 1e-12, "{lattice:?} is centred");
            for (i, p) in positions.iter().enumerate() {
                let nearest = positions
                    .iter()
                    .enumerate()
                    .filter(|&(j, _)| i != j)
                    .map(|(_, q)| (p - q).norm())
                    .fold(f64::INFINITY, f64::min);
                let one_row_across = nearest < 2.0;
                assert!((nearest - 1.0).abs() < 1e-12 || !one_row_across, "{lattice:?}: {nearest}");
            }
        }
    }

    #[test]
    fn neighbours_on_a_hexagonal_lattice_have_three_different_types() {
        for lattice in lattices() {
            if lattice.packing == Packing::Orthogonal {
                continue;
            }
            assert_eq!(lattice.lens_type(0, 0, 3), 0);
            let all = nodes(&lattice);
            for &(k, l) in &all {
                for &(m, n) in &all {
                    let distance = (lattice.node(k, l) - lattice.node(m, n)).norm();
                    if (distance - 1.0).abs() < 1e-9 {
                        assert_ne!(lattice.lens_type(k, l, 3), lattice.lens_type(m, n, 3));
                    }
                }
            }
        }
    }

    #[test]
    fn types_of_the_r12_follow_the_published_rule() {
        let lattice =
            Lattice { packing: Packing::HexagonalRows(Parity::Even), columns: 176, rows: 152 };
        for (k, l) in nodes(&lattice) {
            assert_eq!(lattice.lens_type(k, l, 3), usize::try_from((l % 2 + k) % 3).unwrap());
        }
    }
}
