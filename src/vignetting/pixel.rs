//! What a pixel collects: the light that arrives in its square, blurred by the point spread of micro-lens and sensor.

/// Number of places along an axis.
const ALONG: usize = 9;
/// They reach so many standard deviations to either side.
const REACH: f64 = 3.2;

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
    let mut rule: [(f64, f64); ALONG] = std::array::from_fn(|i| {
        let x = (i as f64 - (ALONG - 1) as f64 / 2.0) * step;
        (x, below(x + 0.5) - below(x - 0.5))
    });
    let sum: f64 = rule.iter().map(|(_, weight)| weight).sum();
    let square: f64 = rule.iter().map(|(x, weight)| x * x * weight).sum();
    let wider = (variance * sum / square).sqrt();
    for (x, weight) in &mut rule {
        (*x, *weight) = (*x * wider, *weight / sum);
    }
    rule
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
