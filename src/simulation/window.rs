//! The part of a disc from which rays are drawn.

use nalgebra::Vector2;

/// Largest area of a rectangle, as a fraction of the disc, for which it is used.
const WORTH: f64 = 0.8;

/// The part of the unit disc from which rays are drawn: all of it, or a rectangle that contains its overlap with another
/// disc. At the rim of a micro-image the overlap is small: few of the rays from the whole disc would arrive, and their
/// number would have far more noise than a sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Window {
    /// Whole disc.
    Disc,
    /// Rectangle from `low` to `high` along a direction, with the half-width `half` across it.
    Rectangle { along: Vector2<f64>, low: f64, high: f64, half: f64 },
}

impl Window {
    /// Creates the window for another disc with this middle and radius.
    pub fn about(middle: Vector2<f64>, radius: f64) -> Self {
        let distance = middle.norm();
        let (low, high) = ((distance - radius).max(-1.0), (distance + radius).min(1.0));
        let widest = if low > 0.0 { (1.0 - low * low).max(0.0).sqrt() } else { 1.0 };
        let half = widest.min(radius);
        let window = Self::Rectangle { along: middle / distance, low, high, half };
        let worth = distance > 1e-9 && low < high && window.area() < WORTH * Self::Disc.area();
        if worth { window } else { Self::Disc }
    }

    /// Returns the area.
    pub fn area(&self) -> f64 {
        match self {
            Self::Disc => std::f64::consts::PI,
            Self::Rectangle { low, high, half, .. } => (high - low) * 2.0 * half,
        }
    }

    /// Maps a position on the disc and one in the square from −1 to 1 to the point of the unit disc from which a ray is drawn.
    /// Returns the point, and true if it is on the disc.
    #[inline(always)]
    #[allow(clippy::inline_always)] // compiled for the registers of loops over rays
    pub fn place(&self, disc: Vector2<f64>, square: Vector2<f64>) -> (Vector2<f64>, bool) {
        match *self {
            Self::Disc => (disc, true),
            Self::Rectangle { along, low, high, half } => {
                let x = 0.5 * (low + high) + 0.5 * (high - low) * square.x;
                let y = half * square.y;
                let place = Vector2::new(along.x * x - along.y * y, along.y * x + along.x * y);
                (place, x * x + y * y <= 1.0)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::sampling::{BLOCK, Points, RaySets};
    use super::super::spread::Footprint;
    use super::*;
    use crate::optics::WhiteDiscs;

    /// The area that another disc covers agrees with the rays that lie in it, with and without a window.
    #[test]
    fn windows_contain_what_the_other_disc_covers() {
        let sets = RaySets::new(4096, &Footprint::new(0.0));
        let cases = [(0.0, 2.0), (1.2, 1.3), (1.0, 0.5), (2.0, 1.3), (2.2, 1.3), (3.4, 3.0)];
        for (distance, radius) in cases {
            let middle = Vector2::new(0.6, -0.8) * distance;
            let window = Window::about(middle, radius);
            let set = sets.set(0);
            let covered = |points: &Points, i: usize| {
                let (place, inside) = window.place(points.disc(i), points.square(i));
                inside && (place - middle).norm() < radius
            };
            let in_block = |points: Points| (0..BLOCK).filter(|&i| covered(&points, i)).count();
            let all: usize = (0..set.blocks()).map(|i| in_block(set.block(i))).sum();
            let share = all as f64 / set.rays() as f64;
            let smaller = radius.min(1.0);
            let expected = WhiteDiscs::plain(radius, 1.0).light(distance)
                * std::f64::consts::PI
                * smaller
                * smaller;
            let area = share * window.area();
            assert!((area - expected).abs() < 0.01 * expected, "{area} for {expected}");
            assert_eq!(window == Window::Disc, distance < 0.5, "{distance} {radius}");
        }
    }
}
