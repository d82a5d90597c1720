//! DBSCAN: density-based clusters (Ester et al. 1996).

use nalgebra::Vector2;

/// The cluster of every point, counted from 0 in the order of the first member; `None` for points
/// that are in no dense place.
///
/// A point with at least `fewest` points (itself included) up to `reach` away is in the core of a
/// cluster; clusters are what cores within reach connect, with the points within their reach.
#[must_use]
pub fn dbscan(points: &[Vector2<f64>], reach: f64, fewest: usize) -> Vec<Option<usize>> {
    let cells = Cells::new(points, reach);
    let mut clusters = vec![None; points.len()];
    let mut count = 0;
    for first in 0..points.len() {
        if clusters[first].is_some() {
            continue;
        }
        let near = cells.near(points, first);
        if near.len() < fewest {
            continue;
        }
        clusters[first] = Some(count);
        let mut open = near;
        while let Some(next) = open.pop() {
            if clusters[next].is_some() {
                continue;
            }
            clusters[next] = Some(count);
            let near = cells.near(points, next);
            if near.len() >= fewest {
                open.extend(near.into_iter().filter(|&i| clusters[i].is_none()));
            }
        }
        count += 1;
    }
    clusters
}

/// Points sorted into square cells as large as the reach.
struct Cells {
    reach: f64,
    low: Vector2<f64>,
    columns: usize,
    rows: usize,
    members: Vec<Vec<usize>>,
}

impl Cells {
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // not below 0
    fn new(points: &[Vector2<f64>], reach: f64) -> Self {
        let first = points.first().copied().unwrap_or_else(Vector2::zeros);
        let (low, high) = points.iter().fold((first, first), |(a, b), p| (a.inf(p), b.sup(p)));
        let count = |length: f64| ((length / reach) as usize).saturating_add(1);
        let (columns, rows) = (count(high.x - low.x), count(high.y - low.y));
        let mut cells =
            Self { reach, low, columns, rows, members: vec![Vec::new(); columns * rows] };
        for (i, point) in points.iter().enumerate() {
            let (x, y) = cells.cell(point);
            cells.members[y * columns + x].push(i);
        }
        cells
    }

    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // not below 0
    fn cell(&self, point: &Vector2<f64>) -> (usize, usize) {
        let cell = (point - self.low) / self.reach;
        ((cell.x as usize).min(self.columns - 1), (cell.y as usize).min(self.rows - 1))
    }

    /// Points up to the reach away from one, with it.
    fn near(&self, points: &[Vector2<f64>], from: usize) -> Vec<usize> {
        let (x, y) = self.cell(&points[from]);
        let columns = x.saturating_sub(1)..(x + 2).min(self.columns);
        let rows = y.saturating_sub(1)..(y + 2).min(self.rows);
        rows.flat_map(|y| columns.clone().map(move |x| (x, y)))
            .flat_map(|(x, y)| &self.members[y * self.columns + x])
            .copied()
            .filter(|&i| (points[i] - points[from]).norm() <= self.reach)
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dense_places_are_clusters_and_lone_points_are_not() {
        let points: Vec<Vector2<f64>> = [
            (0.0, 0.0),
            (1.0, 0.0),
            (50.0, 50.0),
            (2.0, 0.0),
            // Within reach of a member of the first cluster, but with too few neighbours itself.
            (3.4, 0.0),
            (20.0, 20.0),
            (20.0, 21.0),
            (21.0, 20.0),
            (4.9, 0.0),
        ]
        .map(|(x, y)| Vector2::new(x, y))
        .to_vec();
        let clusters = dbscan(&points, 1.5, 3);
        let expected = [Some(0), Some(0), None, Some(0), Some(0), Some(1), Some(1), Some(1), None];
        assert_eq!(clusters, expected);
        assert!(dbscan(&[], 1.0, 2).is_empty());
        assert_eq!(dbscan(&points[..1], 1.0, 1), [Some(0)]);
    }
}
