//! The print on the sheet of a checkerboard, and its illumination.

use nalgebra::Vector2;

use super::target::Target;

/// Least illumination of any part of the sheet, relative to its middle.
const LEAST_LIGHT: f64 = 0.05;

/// A printed sheet. Positions on it are in squares; the first square extends from 0 to 1.
#[derive(Debug, Clone, Copy)]
pub(super) struct BoardTexture {
    /// Numbers of squares along x and y.
    squares: [f64; 2],
    /// Width of the white border, squares.
    border: f64,
    black: f64,
    white: f64,
    /// Radiance beside the sheet.
    pub background: f64,
    /// Illumination of the corner of the first square, relative to the middle of the sheet.
    light_at_first: f64,
    /// Increase of the illumination per square along x and y.
    light_by_square: [f64; 2],
}

impl BoardTexture {
    pub fn new(target: &Target) -> Self {
        let half = [target.columns, target.rows].map(|n| f64::from(n - 1) / 2.0);
        let [along_x, along_y] = target.uneven_light;
        let light_by_square = [along_x / half[0], along_y / half[1]];
        let at_corner = 1.0 - along_x - along_y;
        Self {
            squares: [target.columns + 1, target.rows + 1].map(f64::from),
            border: target.border_mm / target.square_mm,
            black: target.black,
            white: target.white,
            background: target.background,
            light_at_first: at_corner - light_by_square[0] - light_by_square[1],
            light_by_square,
        }
    }

    /// Returns the radiance at a position.
    #[inline(always)]
    #[allow(clippy::inline_always, clippy::needless_bitwise_bool)] // for loops over rays, without branches
    pub fn radiance(&self, place: Vector2<f64>) -> f64 {
        let ((x, y), [columns, rows]) = ((place.x, place.y), self.squares);
        let within = |margin: f64| {
            (x >= -margin) & (x < columns + margin) & (y >= -margin) & (y < rows + margin)
        };
        let pairs = 0.5 * (x.floor() + y.floor());
        // `pairs` is a multiple of one half.
        let is_black = within(0.0) & (pairs - pairs.floor() < 0.25);
        let print = if is_black { self.black } else { self.white };
        let light = print * self.light(place);
        if within(self.border) { light } else { self.background }
    }

    /// Returns the illumination of a position, relative to the middle.
    #[inline(always)]
    #[allow(clippy::inline_always)] // for loops over rays
    fn light(&self, place: Vector2<f64>) -> f64 {
        let [by_x, by_y] = self.light_by_square;
        (self.light_at_first + by_x * place.x + by_y * place.y).max(LEAST_LIGHT)
    }

    /// Returns the radiance of a rectangle; `None` if it is not known to be uniform.
    #[allow(clippy::float_cmp)] // whole numbers, and light that is even or not
    pub fn radiance_between(&self, low: &Vector2<f64>, high: &Vector2<f64>) -> Option<f64> {
        if self.light_by_square != [0.0; 2] {
            return None;
        }
        let (mut is_beside, mut is_plain) = (false, true);
        for axis in 0..2 {
            let (low, high, end) = (low[axis], high[axis], self.squares[axis]);
            is_beside |= high < -self.border || low > end + self.border;
            // Edges of the squares and of the sheet.
            let has_squares = high >= 0.0 && low <= end;
            let edges = [-self.border, 0.0, end, end + self.border];
            let has_edge = edges.iter().any(|edge| (low..=high).contains(edge));
            is_plain &= low <= high && !has_edge && !(has_squares && low.floor() != high.floor());
        }
        if is_beside {
            return Some(self.background);
        }
        is_plain.then(|| self.radiance((low + high) / 2.0))
    }
}

#[cfg(test)]
mod tests {
    use super::super::target::tests::target;
    use super::*;

    fn even() -> Target {
        Target { uneven_light: [0.0; 2], ..target() }
    }

    /// The middle of the corners is at (3, 2).
    #[test]
    fn light_is_even_in_the_middle_and_never_lost() {
        let texture = BoardTexture::new(&target());
        for (x, y, light) in [(3.0, 2.0, 1.0), (5.0, 2.0, 1.5), (3.0, 1.5, 1.5), (1.0, 3.0, 0.05)] {
            assert!((texture.light(Vector2::new(x, y)) - light).abs() < 1e-12, "{x}, {y}");
        }
    }

    /// A rectangle with a reported radiance is uniform. Most small rectangles have one.
    #[test]
    #[allow(clippy::float_cmp)] // of the same print
    fn a_plain_rectangle_shows_one_radiance() {
        let texture = BoardTexture::new(&even());
        let (mut plain, mut mixed) = (0, 0);
        for i in 0..40 {
            for j in 0..30 {
                let low = Vector2::new(f64::from(i) * 0.21 - 1.3, f64::from(j) * 0.23 - 1.4);
                for size in [0.05, 0.3, 1.4] {
                    let high = low.add_scalar(size);
                    let parts = (0..=20).map(|part| f64::from(part) / 20.0);
                    let mut seen = parts.clone().flat_map(|x| {
                        let texture = &texture;
                        parts
                            .clone()
                            .map(move |y| texture.radiance(low + Vector2::new(x, y) * size))
                    });
                    let first = seen.next().unwrap();
                    match texture.radiance_between(&low, &high) {
                        Some(radiance) => {
                            assert!(
                                first == radiance && seen.all(|seen| seen == radiance),
                                "{low}"
                            );
                            plain += 1;
                        }
                        None => mixed += 1,
                    }
                }
            }
        }
        assert!(plain > 1500 && mixed > 1000, "{plain} {mixed}");
        let inside = Vector2::new(2.2, 1.3);
        let uneven = BoardTexture::new(&Target { uneven_light: [0.1, 0.0], ..even() });
        assert!(uneven.radiance_between(&inside, &inside.add_scalar(0.1)).is_none());
        let nowhere = Vector2::repeat(f64::NAN);
        assert!(texture.radiance_between(&nowhere, &nowhere).is_none());
    }
}
