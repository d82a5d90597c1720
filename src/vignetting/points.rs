//! A few points that stand for cells of equal area of the visible part of a micro-lens.

use std::sync::LazyLock;

use nalgebra::Vector2;

use super::overlap::Overlap;

/// Numbers of points in rings, from the middle.
const RINGS: [usize; 3] = [1, 5, 10];
/// Number of all points.
pub(crate) const POINTS: usize = RINGS[0] + RINGS[1] + RINGS[2];
/// Room for them that fills registers.
pub(crate) const ROOM: usize = POINTS.next_multiple_of(8);

/// The points of the disc in single precision, as the light: x and y, and their mean square along an axis.
pub(crate) struct DiscPoints {
    pub x: [f32; ROOM],
    pub y: [f32; ROOM],
    /// 1 for a point, 0 in the room behind them.
    pub is_one: [f32; ROOM],
    pub mean_square: f64,
}

/// The points of the disc.
pub(crate) static DISC: LazyLock<DiscPoints> = LazyLock::new(|| {
    let points = of_disc();
    let mean_square = mean_square();
    DiscPoints {
        x: in_room(|j| points[j].x),
        y: in_room(|j| points[j].y),
        is_one: in_room(|_| 1.0),
        mean_square,
    }
});

/// Numbers by point in single precision, and zeros behind them.
#[allow(clippy::cast_possible_truncation)] // as the light
pub(crate) fn in_room(of: impl Fn(usize) -> f64) -> [f32; ROOM] {
    std::array::from_fn(|j| if j < POINTS { of(j) as f32 } else { 0.0 })
}

/// The points of the disc.
pub(crate) fn of_disc() -> [Vector2<f64>; POINTS] {
    cells_of_disc(&RINGS)
}

/// The centroids of cells of equal area that the unit disc is cut into: rings, and equal sectors of them. There are as
/// many in each ring as the numbers say, N in all.
pub(crate) fn cells_of_disc<const N: usize>(rings: &[usize]) -> [Vector2<f64>; N] {
    let all = N as f64;
    let mut points = [Vector2::zeros(); N];
    let mut inside = 0;
    for &count in rings {
        let sector = std::f64::consts::TAU / count as f64;
        // The centroid of a sector of a ring: 2/3 (r₂³ − r₁³)/(r₂² − r₁²), by sin(θ/2)/(θ/2).
        let (inner, outer) = ((inside as f64 / all).sqrt(), ((inside + count) as f64 / all).sqrt());
        let radius = 2.0 / 3.0 * (outer.powi(3) - inner.powi(3)) / (count as f64 / all)
            * (sector / 2.0).sin()
            / (sector / 2.0);
        for i in 0..count {
            let angle = sector * (i as f64 + 0.25);
            points[inside + i] = Vector2::new(angle.cos(), angle.sin()) * radius;
        }
        inside += count;
    }
    points
}

/// Mean square of the points of the disc along an axis; that of the whole disc is a quarter, and the rest is
/// inside the cells.
fn mean_square() -> f64 {
    of_disc().iter().map(|p| p.norm_squared() / 2.0).sum::<f64>() / POINTS as f64
}

/// Strips that areas are summed over.
const STRIPS: usize = 100;

/// The points of the disc moved into the part of it that another disc covers, at a distance along x, so that
/// they still stand for equal shares: strips across x keep their share of the area, and places in a strip
/// their share of its length. So the points are skewed as the part is, and an edge that moves across it
/// darkens as it does. Mean and mean square of the part are kept.
pub(crate) fn in_overlap(
    disc: &[Vector2<f64>; POINTS],
    distance: f64,
    radius: f64,
    part: &Overlap,
) -> [Vector2<f64>; POINTS] {
    let (low, high) = ((-1.0_f64).max(distance - radius), 1.0_f64.min(distance + radius));
    let chord = |radius: f64, x: f64| (radius * radius - x * x).max(0.0).sqrt();
    let half = |x: f64| chord(1.0, x).min(chord(radius, x - distance));
    let width = (high - low) / STRIPS as f64;
    let mut areas = [0.0; STRIPS + 1];
    for i in 0..STRIPS {
        areas[i + 1] = areas[i] + half(low + (i as f64 + 0.5) * width);
    }
    let moved = |p: &Vector2<f64>| {
        // The share of the disc to the left of the point.
        let share = 0.5 + (p.x * chord(1.0, p.x) + p.x.asin()) / std::f64::consts::PI;
        let area = share * areas[STRIPS];
        let i = areas.partition_point(|a| *a < area).clamp(1, STRIPS);
        let within = (area - areas[i - 1]) / (areas[i] - areas[i - 1]).max(1e-12);
        let x = low + (i as f64 - 1.0 + within) * width;
        Vector2::new(x, p.y * half(x) / chord(1.0, p.x).max(1e-12))
    };
    let mut points = disc.map(|p| moved(&p));
    let count = POINTS as f64;
    let mean = points.iter().map(|p| p.x).sum::<f64>() / count;
    let square = |of: fn(&Vector2<f64>) -> f64, mean: f64, points: &[Vector2<f64>]| {
        points.iter().map(|p| (of(p) - mean).powi(2)).sum::<f64>() / count
    };
    let along = (mean_square() / square(|p| p.x, mean, &points).max(1e-12)).sqrt() * part.along;
    let across = (mean_square() / square(|p| p.y, 0.0, &points).max(1e-12)).sqrt() * part.across;
    for p in &mut points {
        *p = Vector2::new(part.mean + (p.x - mean) * along, p.y * across);
    }
    points
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vignetting::overlap;

    /// A half disc: its mean is 4/3π from the cut, half of it lies within 0.404 of it, and of its points too.
    #[test]
    fn points_of_half_a_disc_are_skewed_as_it_is() {
        let (distance, radius) = (1e4, 1e4);
        let part = overlap(distance, radius).unwrap();
        let points = in_overlap(&of_disc(), distance, radius, &part);
        let mean = points.iter().sum::<Vector2<f64>>() / POINTS as f64;
        assert!(
            (mean - Vector2::new(4.0 / 3.0 / std::f64::consts::PI, 0.0)).norm() < 1e-3,
            "{mean}"
        );
        let cubed = points.iter().map(|p| (p.x - mean.x).powi(3)).sum::<f64>() / POINTS as f64;
        // ∫(x − m)³ 2√(1 − x²) dx over the half disc, by its area π/2.
        let steps = 100_000;
        let expected: f64 = (0..steps)
            .map(|i| (f64::from(i) + 0.5) / f64::from(steps))
            .map(|x| (x - mean.x).powi(3) * 4.0 / std::f64::consts::PI * (1.0 - x * x).sqrt())
            .sum::<f64>()
            / f64::from(steps);
        assert!(expected > 0.0 && (cubed / expected - 1.0).abs() < 0.3, "{cubed} for {expected}");
    }

    #[test]
    fn points_of_the_whole_disc_are_its_own() {
        let disc = of_disc();
        let same = in_overlap(&disc, 0.2, 3.0, &Overlap::WHOLE);
        let furthest = disc.iter().zip(&same).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
        assert!(furthest < 0.02, "{furthest}");
    }
}
