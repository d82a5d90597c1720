//! Points in square cells, for the search near a position.

use std::collections::HashMap;

use nalgebra::Vector2;

type Cell = (i64, i64);

/// Points sorted into square cells. Only cells with points take memory, so the number of points bounds it however far they
/// spread.
pub(super) struct Cells<'a> {
    points: &'a [Vector2<f64>],
    size: f64,
    members: HashMap<Cell, Vec<usize>>,
}

impl<'a> Cells<'a> {
    /// Creates cells of a size, which should be about the distance of later searches. A size that is not positive and finite is
    /// replaced by 1.
    pub fn new(points: &'a [Vector2<f64>], size: f64) -> Self {
        let size = if size.is_finite() && size > 0.0 { size } else { 1.0 };
        let mut cells = Self { points, size, members: HashMap::new() };
        for (i, point) in points.iter().enumerate() {
            let cell = cells.cell(point);
            cells.members.entry(cell).or_default().push(i);
        }
        cells
    }

    #[allow(clippy::cast_possible_truncation)] // saturates: points so far away share a cell
    fn cell(&self, place: &Vector2<f64>) -> Cell {
        let cell = place / self.size;
        (cell.x.floor() as i64, cell.y.floor() as i64)
    }

    /// Returns the points up to `reach` away from a position.
    pub fn near(&self, place: &Vector2<f64>, reach: f64) -> Vec<usize> {
        let is_near = |i: &usize| (self.points[*i] - place).norm() <= reach;
        let corner = Vector2::repeat(reach);
        let (low, high) = (self.cell(&(place - corner)), self.cell(&(place + corner)));
        let count = |low: i64, high: i64| high.saturating_sub(low).saturating_add(1);
        let cells = count(low.0, high.0).saturating_mul(count(low.1, high.1));
        // If the reach covers more cells than there are, comparing all points is faster.
        if usize::try_from(cells).is_ok_and(|cells| cells <= self.members.len()) {
            (low.1..=high.1)
                .flat_map(|y| (low.0..=high.0).map(move |x| (x, y)))
                .filter_map(|cell| self.members.get(&cell))
                .flatten()
                .copied()
                .filter(is_near)
                .collect()
        } else {
            (0..self.points.len()).filter(is_near).collect()
        }
    }
}
