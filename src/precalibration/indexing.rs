//! Indices of the micro-images of a pattern.

use nalgebra::Vector2;

use super::pattern::Pattern;
use crate::error::{Error, Result};
use crate::model::{Lattice, LatticeKind, MicroImageCenter, Packing, Parity};

/// Numbering of the nodes of a pattern.
#[derive(Debug, Clone, Copy)]
pub(super) struct Indexing {
    /// Choice of the shifted rows, see [`Pattern::index`].
    later: bool,
    /// Index in the pattern of the first micro-image of the array.
    first: (i32, i32),
    /// Number of columns and rows.
    size: (i32, i32),
}

impl Indexing {
    /// Returns the index (k, l) of a node.
    pub fn index(&self, pattern: &Pattern, node: (i32, i32)) -> (i32, i32) {
        let (k, l) = pattern.index(node, self.later);
        (k - self.first.0, l - self.first.1)
    }

    /// Returns a measured centre with its index.
    pub fn center(
        &self,
        pattern: &Pattern,
        node: (i32, i32),
        place: &Vector2<f64>,
        std_dev_px: Option<f64>,
    ) -> MicroImageCenter {
        let (k, l) = self.index(pattern, node);
        MicroImageCenter { k, l, u_px: place.x, v_px: place.y, std_dev_px }
    }

    /// Returns the lattice with this numbering.
    pub fn lattice(&self, kind: LatticeKind) -> Lattice {
        let row = match kind {
            LatticeKind::HexagonalColumns => self.first.0,
            _ => self.first.1,
        };
        // The odd rows of the pattern are shifted or, with `later`, the even rows.
        let odd = row.rem_euclid(2) == i32::from(self.later);
        let shifted = if odd { Parity::Odd } else { Parity::Even };
        Lattice { packing: Packing::new(kind, shifted), columns: self.size.0, rows: self.size.1 }
    }

    /// Returns every way to number the nodes that show: for an array of the stated size, or else with the fewest
    /// columns and rows.
    pub fn possible(
        pattern: &Pattern,
        nodes: &[(i32, i32)],
        stated: Option<(i32, i32)>,
    ) -> Result<Vec<Self>> {
        if nodes.is_empty() {
            return Err(Error::invalid("the image contains no micro-image: give a larger image"));
        }
        let both = [false, true].map(|later| {
            let indices = || nodes.iter().map(|&node| pattern.index(node, later));
            let low = indices().fold((i32::MAX, i32::MAX), |a, b| (a.0.min(b.0), a.1.min(b.1)));
            let high = indices().fold((i32::MIN, i32::MIN), |a, b| (a.0.max(b.0), a.1.max(b.1)));
            Self { later, first: low, size: (high.0 - low.0 + 1, high.1 - low.1 + 1) }
        });
        let Some((columns, rows)) = stated else {
            let fewest = both.iter().map(|l| l.size).min().unwrap_or((0, 0));
            return Ok(both.into_iter().filter(|l| l.size == fewest).collect());
        };
        let beyond = |l: &Self| (columns - l.size.0, rows - l.size.1);
        // An array may extend beyond the sensor, about as far on either side.
        let before = |beyond: i32| beyond / 2 - 1.min(beyond / 2)..=(beyond / 2 + 1).min(beyond);
        let shifted = |l: Self| {
            let (beyond_k, beyond_l) = beyond(&l);
            let first = l.first;
            before(beyond_k).flat_map(move |dk| {
                before(beyond_l).map(move |dl| Self {
                    first: (first.0 - dk, first.1 - dl),
                    size: (columns, rows),
                    ..l
                })
            })
        };
        let fits = |l: &Self| beyond(l).0 >= 0 && beyond(l).1 >= 0;
        let possible: Vec<Self> = both.into_iter().filter(fits).flat_map(shifted).collect();
        if possible.is_empty() {
            let found = both.map(|l| format!("{} x {}", l.size.0, l.size.1));
            let found = if found[0] == found[1] { found[0].clone() } else { found.join(" or ") };
            return Err(Error::invalid(format!(
                "the array is stated to have {columns} x {rows} micro-lenses, but {found} \
                 micro-images were found: leave columns and rows out, or give an image of this \
                 camera"
            )));
        }
        Ok(possible)
    }
}
