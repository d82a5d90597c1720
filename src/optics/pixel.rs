//! What a pixel collects: the light that arrives in its square, blurred by the point spread of micro-lens and sensor.

/// Number of places along an axis.
const ALONG: usize = 9;
/// They reach so many standard deviations to either side.
const REACH: f64 = 3.2;
/// Number of places where there are many, and how far they reach beyond the square, in standard deviations of the point
/// spread.
const MANY: usize = 24;
const BEYOND: f64 = 4.5;
/// Where they would change too fast with the point spread, px².
const SMOOTH_PX2: f64 = 0.0025;
/// Variance of a square of 1 px along an axis, px².
const SQUARE_PX2: f64 = 1.0 / 12.0;

/// The light that a pixel collects, as a few places with weights along each axis: a square of 1 px convolved with a normal
/// point spread.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Pixel {
    /// Places along an axis from the middle of the pixel, px, and their weights: evenly spaced, since light has edges that
    /// are sharper than the pixel, with the variance of the pixel.
    pub along: [(f64, f64); ALONG],
    /// Squares of places along the other axis, px², and their weights: Gauss' rule, exact up to the ninth power of the
    /// places. Across the direction from the centre of a micro-image light changes little.
    pub across: [(f64, f64); 3],
    /// Variance along an axis, px².
    pub variance: f64,
}

impl Pixel {
    /// With a point spread of this variance along an axis, px²; not below 0.
    pub fn new(point_spread_px2: f64) -> Self {
        let spread = point_spread_px2.max(0.0);
        // Even moments of the square, and of the normal distribution.
        let [s2, s4, s6, s8] = [1.0 / 12.0, 1.0 / 80.0, 1.0 / 448.0, 1.0 / 2304.0];
        let [n2, n4, n6, n8] = [(1, 1.0), (2, 3.0), (3, 15.0), (4, 105.0)]
            .map(|(power, factor)| factor * spread.powi(power));
        let m2 = s2 + n2;
        let m4 = s4 + 6.0 * s2 * n2 + n4;
        let m6 = s6 + 15.0 * (s4 * n2 + s2 * n4) + n6;
        let m8 = s8 + 28.0 * (s6 * n2 + s2 * n6) + 70.0 * s4 * n4 + n8;
        // x (x⁴ + α x² + β) is orthogonal to x and x³.
        let determinant = m4 * m4 - m2 * m6;
        let (alpha, beta) = ((m2 * m8 - m4 * m6) / determinant, (m6 * m6 - m4 * m8) / determinant);
        let root = (alpha * alpha / 4.0 - beta).max(0.0).sqrt();
        let (near, far) = (-alpha / 2.0 - root, -alpha / 2.0 + root);
        // Both sides together.
        let of_far = (m4 - near * m2) / (far * (far - near));
        let of_near = (m2 - of_far * far) / near;
        Self {
            along: along(spread.sqrt(), m2),
            across: [(0.0, 1.0 - of_near - of_far), (near, of_near), (far, of_far)],
            variance: m2,
        }
    }
}

/// Places and weights for a square with a normal spread, px, and their variance together.
fn along(spread: f64, variance: f64) -> [(f64, f64); ALONG] {
    let step = 2.0 * REACH * variance.sqrt() / (ALONG - 1) as f64;
    let below = |x: f64| libm::erf(x / (spread.max(1e-6) * std::f64::consts::SQRT_2));
    let places = std::array::from_fn(|i| (i as f64 - (ALONG - 1) as f64 / 2.0) * step);
    with_variance(places.map(|x| (x, below(x + 0.5) - below(x - 0.5))), variance)
}

/// A rule with weights that sum up to 1, and places moved until it has a variance.
fn with_variance<const N: usize>(mut rule: [(f64, f64); N], variance: f64) -> [(f64, f64); N] {
    let sum: f64 = rule.iter().map(|(_, weight)| weight).sum();
    let square: f64 = rule.iter().map(|(x, weight)| x * x * weight).sum();
    let wider = (variance * sum / square).sqrt();
    for (x, weight) in &mut rule {
        (*x, *weight) = (*x * wider, *weight / sum);
    }
    rule
}

impl Pixel {
    /// Many places along an axis, px, with weights, even on both sides of the middle. They change smoothly with the point
    /// spread, down to none.
    pub fn places(&self) -> [(f64, f64); MANY] {
        let spread = (self.variance - SQUARE_PX2).max(1e-12);
        let reach = 0.5 + BEYOND * (spread + SMOOTH_PX2).sqrt();
        let step = 2.0 * reach / MANY as f64;
        let spread = spread.sqrt();
        // The integral of the normal distribution, and of the square with its spread.
        let integral = |x: f64| {
            let z = x / spread;
            let below = 0.5 * libm::erfc(-z * std::f64::consts::FRAC_1_SQRT_2);
            x * below + spread * (-z * z / 2.0).exp() / std::f64::consts::TAU.sqrt()
        };
        let up_to = |x: f64| integral(x + 0.5) - integral(x - 0.5);
        let rule = std::array::from_fn(|i| {
            let left = i as f64 * step - reach;
            (left + step / 2.0, up_to(left + step) - up_to(left))
        });
        with_variance(rule, self.variance)
    }
}

impl Default for Pixel {
    /// Without a point spread.
    fn default() -> Self {
        Self::new(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Means of cosines: sinc(k/2) exp(−k² s²/2).
    #[test]
    fn means_over_a_pixel_are_those_of_its_square_and_spread() {
        for spread in [0.0, 0.1, 0.25, 1.0] {
            let pixel = Pixel::new(spread);
            for k in [0.3_f64, 0.9] {
                let expected = (k / 2.0).sin() / (k / 2.0) * (-k * k * spread / 2.0).exp();
                let along: f64 = pixel.along.iter().map(|(x, w)| w * (k * x).cos()).sum();
                assert!((along - expected).abs() < 1e-3, "{along} for {expected}");
                let across: f64 =
                    pixel.across.iter().map(|(y2, w)| w * (k * y2.sqrt()).cos()).sum();
                assert!((across - expected).abs() < 2e-5, "{across} for {expected}");
            }
            let square: f64 = pixel.along.iter().map(|(x, w)| w * x * x).sum();
            assert!((pixel.variance - 1.0 / 12.0 - spread).abs() < 1e-12);
            assert!((square - pixel.variance).abs() < 1e-12);
        }
    }
}
