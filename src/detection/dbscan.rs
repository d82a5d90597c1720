//! DBSCAN: density-based clusters (Ester et al. 1996).

use nalgebra::Vector2;

use super::cells::Cells;

/// Returns the cluster of every point, counted from 0 in the order of the first member; `None` for points in no dense region.
///
/// A point with at least `fewest` points (itself included) up to `reach` away is a core. Cores within reach of each other form
/// a cluster, with all points within their reach. A reach of 0 connects points at the same position; points that are not finite
/// have no neighbours.
pub(super) fn dbscan(points: &[Vector2<f64>], reach: f64, fewest: usize) -> Vec<Option<usize>> {
    let cells = Cells::new(points, reach);
    let near = |i: usize| cells.near(&points[i], reach);
    let mut clusters = vec![None; points.len()];
    let mut count = 0;
    for first in 0..points.len() {
        if clusters[first].is_some() {
            continue;
        }
        let of_first = near(first);
        if of_first.len() < fewest {
            continue;
        }
        clusters[first] = Some(count);
        let mut open = of_first;
        while let Some(next) = open.pop() {
            if clusters[next].is_some() {
                continue;
            }
            clusters[next] = Some(count);
            let of_next = near(next);
            if of_next.len() >= fewest {
                open.extend(of_next.into_iter().filter(|&i| clusters[i].is_none()));
            }
        }
        count += 1;
    }
    clusters
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
            // This point is within reach of a member of the first cluster, but has too few neighbours itself.
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

    /// Checks that neither takes memory or time without bound, or overflows.
    #[test]
    fn any_reach_and_any_spread_will_do() {
        let places = [0.0, 0.0, 1.0, 1e300, -1e300, 1e18, f64::INFINITY, f64::NAN];
        let points: Vec<Vector2<f64>> = places.iter().map(|&x| Vector2::new(x, -x)).collect();
        let pair = [Some(0), Some(0), None, None, None, None, None, None];
        for reach in [0.0, 1e-300, 0.5] {
            assert_eq!(dbscan(&points, reach, 2), pair, "{reach}");
        }
        assert_eq!(dbscan(&points, f64::NAN, 2), [None; 8]);
        assert_eq!(dbscan(&points, -1.0, 2), [None; 8]);
        let near = [Some(0), Some(0), Some(0), None, None, Some(0), None, None];
        assert_eq!(dbscan(&points, 1e20, 2), near);
    }
}
