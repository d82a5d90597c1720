//! Normal distributions truncated by the rim of the pupil, and steps blurred by normal distributions.

// Only functions inlined into a dispatched function are compiled for its registers.
#![allow(clippy::inline_always)]

use pulp::Simd;

use crate::numerics::simd::Lanes;

/// Smallest visible part of the light: the series do not hold for smaller tails.
const LEAST: f32 = 1e-3;
/// Smallest variance along a normal, px².
pub(super) const LEAST_PX2: f32 = 1e-3;

/// Rim of the pupil, which truncates the distribution of points that a pixel sees.
#[derive(Clone, Copy)]
pub(super) struct Rim {
    /// Radius a of the pupil, px.
    pupil: f32,
    /// 1/σ, px⁻¹.
    per_spread: f32,
    /// Ratio σ/a.
    per_pupil: f32,
}

/// Moments of a normal distribution truncated by the rim, in powers of σ. A point at t along the rim is t²/2a nearer to the rim
/// than the point at 0, so the distance z to the rim, in σ, has the variance σ²/2a². Angle brackets are means over this
/// distribution of z, to first order in its variance. λ = ⟨φ(z)⟩/⟨Φ(z)⟩ and κ = λσ/a. Moments along the rim are an
/// interpolation: correct to first order in σ/a near the rim, and in the limit far outside, where the variance is 1/(1 + κ).
#[derive(Clone, Copy)]
pub(super) struct Cut<S: Simd> {
    /// Visible part ⟨Φ⟩.
    pub visible: Lanes<S>,
    /// Distance z to the rim, in σ.
    pub distance: Lanes<S>,
    /// Mean shift λ inwards.
    pub mean: Lanes<S>,
    /// Decrease of the variance along the rim: κ (1 + (z + λ) σ/a)/(1 + κ).
    pub sideways: Lanes<S>,
    /// Further decrease of the variance across the rim: ⟨zφ⟩/⟨Φ⟩ + λ² minus `sideways`.
    pub narrower: Lanes<S>,
    /// Third central moment across the rim: −⟨(z² + 2) φ⟩/⟨Φ⟩ + 3λ (1 − ⟨zφ⟩/⟨Φ⟩) − 2λ³.
    skew: Lanes<S>,
    /// Third moment, once across and twice along the rim: −(⟨zφ⟩/⟨Φ⟩ + λ²) σ/a (1 + κ)⁻².
    skew_sideways: Lanes<S>,
}

impl Rim {
    /// Creates the rim of a pupil of radius a, px, for points with a variance along an axis, px².
    #[inline(always)]
    pub fn new(pupil: f32, variance: f32) -> Self {
        let spread = variance.sqrt();
        Self { pupil, per_spread: spread.recip(), per_pupil: spread / pupil }
    }

    /// Truncates the distribution about a point at a distance from the middle of the pupil, px.
    #[inline(always)]
    pub fn cut<S: Simd>(&self, simd: S, from_middle: Lanes<S>) -> Cut<S> {
        let pupil = Lanes::splat(simd, self.pupil);
        let one = Lanes::splat(simd, 1.0);
        let z = (pupil - from_middle) * self.per_spread - 0.5 * self.per_pupil;
        let (below, density) = normal(simd, z);
        let (squared, half_variance) = (z * z, 0.25 * self.per_pupil * self.per_pupil);
        let zero = Lanes::splat(simd, 0.0);
        let visible = (below - z * density * half_variance).max(zero);
        let visible = visible.where_below(LEAST, zero, visible);
        let density = visible.where_below(
            LEAST,
            zero,
            density * visible.max(Lanes::splat(simd, LEAST)).recip(),
        );
        let lambda = density * ((squared - 1.0) * half_variance + 1.0);
        let first = density * z * ((squared - 3.0) * half_variance + 1.0);
        let second = density * (squared + (squared * (squared - 5.0) + 2.0) * half_variance);
        let lost = lambda.mul_add(lambda, first);
        let kappa = lambda * self.per_pupil;
        let per_kappa = (kappa + 1.0).recip();
        let sideways = kappa * ((z + lambda) * self.per_pupil + 1.0) * per_kappa;
        Cut {
            visible,
            distance: z,
            mean: lambda,
            sideways,
            narrower: lost - sideways,
            skew: lambda * ((one - first) * 3.0 - (lambda * lambda + 1.0) * 2.0) - second,
            skew_sideways: -(lost * per_kappa * per_kappa * self.per_pupil),
        }
    }

    /// Returns the derivatives of z by a, px⁻¹, and by the variance of the points, px⁻².
    #[inline(always)]
    pub fn derivatives<S: Simd>(&self, z: Lanes<S>) -> (f32, Lanes<S>) {
        let by_pupil = self.per_spread * (1.0 + 0.5 * self.per_pupil * self.per_pupil);
        // z = (a − r)/σ − σ/2a, and the derivative of σ by σ² is 1/2σ.
        let by_variance = (z + self.per_pupil) * (-0.5 * self.per_spread * self.per_spread);
        (by_pupil, by_variance)
    }
}

impl<S: Simd> Cut<S> {
    /// Creates the moments far inside the rim, where it has no effect.
    #[inline(always)]
    pub fn none(simd: S) -> Self {
        let none = Lanes::splat(simd, 0.0);
        Self {
            visible: Lanes::splat(simd, 1.0),
            distance: none,
            mean: none,
            sideways: none,
            narrower: none,
            skew: none,
            skew_sideways: none,
        }
    }

    /// Returns the derivative of λ by z.
    #[inline(always)]
    pub fn mean_by_distance(&self) -> Lanes<S> {
        -(self.mean * (self.distance + self.mean))
    }

    /// Returns the third moment of the distances of points from an edge, times a scale. `[n, t]` are the components of the
    /// normal of the edge across and along the rim.
    #[inline(always)]
    pub fn third(&self, scale: f32, [n, t]: [Lanes<S>; 2]) -> Lanes<S> {
        n * (self.skew * scale * n * n + self.skew_sideways * (3.0 * scale) * t * t)
    }

    /// Returns the third moments of the distances of points from two edges, and the mixed ones with the first or the second
    /// squared, times a scale. `[n, t]` are the components of their normals across and along the rim.
    #[inline(always)]
    pub fn thirds(
        &self,
        scale: f32,
        [n1, t1]: [Lanes<S>; 2],
        [n2, t2]: [Lanes<S>; 2],
    ) -> [Lanes<S>; 4] {
        let (across, along) = (self.skew * scale, self.skew_sideways * scale);
        let mixed = across * n1 * n2 + (along + along) * t1 * t2;
        [
            self.third(scale, [n1, t1]),
            self.third(scale, [n2, t2]),
            n1 * mixed + along * t1 * t1 * n2,
            n2 * mixed + along * t2 * t2 * n1,
        ]
    }
}

/// Step from −1 to 1, blurred by a normal distribution, with its derivatives, px⁻¹ to px⁻⁴.
pub(super) struct Step<S: Simd> {
    pub value: Lanes<S>,
    pub first: Lanes<S>,
    pub second: Lanes<S>,
    pub third: Lanes<S>,
    fourth: Lanes<S>,
}

impl<S: Simd> Step<S> {
    /// Evaluates the step at a distance, px, with a variance, px².
    #[inline(always)]
    pub fn new(simd: S, distance: Lanes<S>, variance: Lanes<S>) -> Self {
        let inverse = variance.max(Lanes::splat(simd, LEAST_PX2)).sqrt().recip();
        Self::of_inverse(simd, distance, inverse)
    }

    /// Creates the step from a distance, px, and the inverse of the standard deviation, px⁻¹.
    #[inline(always)]
    pub fn of_inverse(simd: S, distance: Lanes<S>, inverse: Lanes<S>) -> Self {
        let distance = distance * inverse;
        let (below, density) = normal(simd, distance);
        let first = (density + density) * inverse;
        let slope = first * inverse;
        let (squared, curvature) = (distance * distance, slope * inverse);
        Self {
            value: below + below - 1.0,
            first,
            second: -(distance * slope),
            third: (squared - 1.0) * curvature,
            fourth: distance * (Lanes::splat(simd, 3.0) - squared) * curvature * inverse,
        }
    }

    /// Returns the step blurred by a distribution with a fourth cumulant, px⁴.
    #[inline(always)]
    pub fn of_fourth_cumulant(&self, fourth: f32) -> Lanes<S> {
        self.fourth.mul_add_scalar(fourth / 24.0, self.value)
    }

    /// Returns the step blurred by a distribution with a third and a fourth cumulant, px³ and px⁴.
    #[inline(always)]
    pub fn of_cumulants(&self, third: Lanes<S>, fourth: f32) -> Lanes<S> {
        (third * (1.0 / 6.0))
            .mul_add(self.third, self.fourth.mul_add_scalar(fourth / 24.0, self.value))
    }
}

/// Returns the cumulative normal distribution at x, to 2e-7, and the density: Abramowitz and Stegun (1964), Eq. 7.1.28, and its
/// derivative.
#[inline(always)]
fn normal<S: Simd>(simd: S, x: Lanes<S>) -> (Lanes<S>, Lanes<S>) {
    const A: [f32; 6] = [
        0.070_523_08,
        0.042_282_01,
        0.009_270_527,
        0.000_152_014_3,
        0.000_276_567_2,
        0.000_043_063_8,
    ];
    const SCALE: f32 = std::f32::consts::FRAC_1_SQRT_2;
    let z = (x.abs() * SCALE).min(Lanes::splat(simd, 4.0));
    // Horner's scheme for the series and its derivative.
    let (mut series, mut slope) = (Lanes::splat(simd, A[5]), Lanes::splat(simd, 0.0));
    let mut power = A.len();
    while power > 0 {
        power -= 1;
        slope = slope.mul_add(z, series);
        let a = if power > 0 { A[power - 1] } else { 1.0 };
        series = series.mul_add(z, Lanes::splat(simd, a));
    }
    let inverse = series.recip();
    let squared = inverse * inverse;
    let fourth = squared * squared;
    let eighth = fourth * fourth;
    let tail = eighth * eighth * 0.5;
    let density = tail * inverse * slope * (16.0 * SCALE);
    (x.where_below(0.0, tail, Lanes::splat(simd, 1.0) - tail), density)
}

#[cfg(test)]
mod tests {
    use pulp::Scalar;

    use super::*;

    /// Compares with sums over the points of a normal distribution that lie in the pupil.
    #[test]
    #[allow(clippy::cast_possible_truncation)] // single precision, as the light
    fn a_cut_normal_distribution_has_the_moments_of_its_places() {
        let (pupil, spread, from_middle) = (6.5, 1.1_f64, 6.9);
        let [mut all, mut sum, mut s1, mut s2, mut s3, mut t2, mut st2] = [0.0_f64; 7];
        for i in -150..=150 {
            for j in -150..=150 {
                let [s, t] = [i, j].map(|k| f64::from(k) * 0.03 * spread);
                let weight = (-(s * s + t * t) / (2.0 * spread * spread)).exp();
                all += weight;
                if (from_middle + s).hypot(t) < pupil {
                    sum += weight;
                    s1 += weight * s;
                    s2 += weight * s * s;
                    t2 += weight * t * t;
                    s3 += weight * s * s * s;
                    st2 += weight * s * t * t;
                }
            }
        }
        let [mean, square, cube, along, mixed] = [s1, s2, s3, t2, st2].map(|x| x / sum);
        let rim = Rim::new(pupil as f32, (spread * spread) as f32);
        let simd = Scalar::new();
        let cut = rim.cut(simd, Lanes::splat(simd, from_middle as f32));
        let found = |value: Lanes<Scalar>, moment: f64, power: i32, limit: f64| {
            let expected = moment / spread.powi(power);
            let value = value.sum();
            assert!((f64::from(value) - expected).abs() < limit, "{value} for {expected}");
        };
        let variance = square - mean * mean;
        found(cut.visible, sum / all, 0, 1.5e-3);
        found(-cut.mean, mean, 1, 3e-3);
        found(-(cut.sideways - 1.0), along, 2, 3e-3);
        found(-(cut.narrower + cut.sideways - 1.0), variance, 2, 3e-3);
        found(cut.skew, cube - mean * (3.0 * variance + mean * mean), 3, 4e-3);
        found(cut.skew_sideways, mixed - mean * along, 3, 4e-3);
    }

    #[test]
    #[allow(clippy::cast_possible_truncation)] // single precision, as the light
    fn normal_distribution() {
        for i in -60..=60_i16 {
            let x = f64::from(i) / 15.0;
            let simd = Scalar::new();
            let (below, density) = normal(simd, Lanes::splat(simd, x as f32));
            let (below, density) = (below.sum(), density.sum());
            let expected = 0.5 * libm::erfc(-x * std::f64::consts::FRAC_1_SQRT_2);
            assert!((f64::from(below) - expected).abs() < 1e-6, "{x}: {below} for {expected}");
            let expected = (-x * x / 2.0).exp() / std::f64::consts::TAU.sqrt();
            assert!((f64::from(density) - expected).abs() < 1e-5, "{x}: {density} for {expected}");
        }
    }
}
