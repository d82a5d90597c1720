//! The points where the light that a pixel records would arrive without point spread.

/// Cut of the point spread, in standard deviations along each axis.
const CUT: f64 = 4.0;
/// Steps of the tabulated distribution, each 1/455 px for σ = 1 px, and less for a smaller σ.
const STEPS: u32 = 4096;

/// Distribution, along each axis, of the points where the light that a pixel records would arrive without point spread: a
/// uniform distribution over the pixel, convolved with a Gaussian point spread that is cut at 4σ.
///
/// Since it is one distribution, rays need no further random numbers, with which 64 rays would cover the pixel less evenly.
#[derive(Debug, Clone)]
pub(super) struct Footprint {
    half_px: f64,
    /// Distribution function at steps from one end to the other; empty without point spread.
    cumulative: Vec<f64>,
}

impl Footprint {
    /// Creates the footprint of a point spread with a standard deviation along each axis, px.
    pub fn new(point_spread_px: f64) -> Self {
        let half_px = half_width_px(point_spread_px);
        if point_spread_px == 0.0 {
            return Self { half_px, cumulative: Vec::new() };
        }
        // The pixel, convolved with the point spread.
        let density = |at: f64| {
            normal_within((at + 0.5) / point_spread_px)
                - normal_within((at - 0.5) / point_spread_px)
        };
        let mut cumulative = vec![0.0];
        let mut sum = 0.0;
        for step in 0..STEPS {
            sum += density(half_px * (2.0 * (f64::from(step) + 0.5) / f64::from(STEPS) - 1.0));
            cumulative.push(sum);
        }
        for value in &mut cumulative {
            *value /= sum;
        }
        Self { half_px, cumulative }
    }

    /// Returns the position below which a fraction of the light arrives, px from the middle of the pixel.
    pub fn place(&self, part: f64) -> f64 {
        if self.cumulative.is_empty() {
            return part - 0.5;
        }
        let last = self.cumulative.len() - 1;
        let next = self.cumulative.partition_point(|&value| value <= part).clamp(1, last);
        let [low, high] = [self.cumulative[next - 1], self.cumulative[next]];
        let steps = (next - 1) as f64 + ((part - low) / (high - low)).clamp(0.0, 1.0);
        self.half_px * (2.0 * steps / last as f64 - 1.0)
    }
}

/// Returns half the width of the square from which a pixel records light, px.
pub(super) fn half_width_px(point_spread_px: f64) -> f64 {
    0.5 + CUT * point_spread_px
}

/// Returns the probability that a standard normal variable, truncated at ±4, is below z.
fn normal_within(z: f64) -> f64 {
    let tail = normal(-CUT);
    (normal(z.clamp(-CUT, CUT)) - tail) / (1.0 - 2.0 * tail)
}

/// Returns the probability that a standard normal variable is below z.
fn normal(z: f64) -> f64 {
    0.5 * libm::erfc(-z / std::f64::consts::SQRT_2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_normal_distribution_is_that_of_tables() {
        for (z, below) in [(0.0, 0.5), (1.0, 0.841_344_746_1), (-1.96, 0.024_997_895_1)] {
            assert!((normal(z) - below).abs() < 1e-10, "{z}");
        }
        assert!((normal(-4.0) - 3.167_124e-5).abs() < 1e-11);
    }

    /// The variance is 1/12 px² of the pixel plus σ² of the point spread, less 0.1 % for the cut.
    #[test]
    fn a_footprint_has_the_variance_of_pixel_and_point_spread() {
        let parts = 20_000;
        for sigma in [0.0, 0.01, 0.3, 1.0, 5.0] {
            let footprint = Footprint::new(sigma);
            let place = |i: i32| footprint.place((f64::from(i) + 0.5) / f64::from(parts));
            let mean = |of: &dyn Fn(f64) -> f64| {
                (0..parts).map(|i| of(place(i))).sum::<f64>() / f64::from(parts)
            };
            let expected = 1.0 / 12.0 + sigma * sigma;
            let variance = mean(&|x| x * x);
            assert!((variance / expected - 1.0).abs() < 1.5e-3, "{sigma}: {variance}");
            assert!(mean(&|x| x).abs() < 1e-9 * (1.0 + sigma));
            let half = half_width_px(sigma);
            let ends = [0.0, 1.0].map(|part| footprint.place(part));
            assert!(
                ends[0] >= -half && ends[1] <= half && ends[1] > 0.9 * half,
                "{sigma}: {ends:?}"
            );
        }
    }
}
