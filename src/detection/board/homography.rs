//! Homographies from positions on a board, in columns and rows, to pinhole images.

use nalgebra::{DMatrix, Matrix3, Vector2, Vector3};

/// Position on the board, and in the image.
pub(super) type Pair = (Vector2<f64>, Vector2<f64>);

pub(super) fn project(homography: &Matrix3<f64>, at: &Vector2<f64>) -> Vector2<f64> {
    let p = homography * Vector3::new(at.x, at.y, 1.0);
    p.xy() / p.z
}

/// Returns the distance from a corner to the nearest of the next ones, px.
pub(super) fn step_at(homography: &Matrix3<f64>, at: &Vector2<f64>) -> f64 {
    let here = project(homography, at);
    let to = |step: Vector2<f64>| (project(homography, &(at + step)) - here).norm();
    to(Vector2::x()).min(to(Vector2::y()))
}

/// Fits the homography between pairs of points, by the linear method on coordinates of unit size; `None` if they do not
/// determine it.
pub(super) fn homography(pairs: &[Pair]) -> Option<Matrix3<f64>> {
    let count = pairs.len() as f64;
    let unit = |of: fn(&Pair) -> Vector2<f64>| {
        let middle = pairs.iter().map(of).sum::<Vector2<f64>>() / count;
        let size = pairs.iter().map(|pair| (of(pair) - middle).norm()).sum::<f64>() / count;
        let scale = 1.0 / size.max(1e-12);
        Matrix3::new(scale, 0.0, -middle.x * scale, 0.0, scale, -middle.y * scale, 0.0, 0.0, 1.0)
    };
    let (from, to) = (unit(|pair| pair.0), unit(|pair| pair.1));
    // Each pair has two rows; at least nine are needed for all nine singular vectors.
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
