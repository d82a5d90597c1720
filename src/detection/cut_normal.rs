//! Normal distributions that the rim of the pupil cuts off, and steps seen through normal distributions.

// Only what is inlined into a dispatched function is compiled for its registers.
#![allow(clippy::inline_always)]

/// Smaller parts of the light are none: of their tails the series say nothing.
const LEAST: f32 = 1e-3;
/// Variances along a normal are not below this, px².
const LEAST_PX2: f32 = 1e-3;

/// The rim of the pupil, which cuts off the places that a pixel sees.
pub(super) struct Rim {
    /// a, px.
    pupil: f32,
    /// 1/σ, px⁻¹.
    pub per_spread: f32,
    /// σ/a.
    per_pupil: f32,
}

/// What the rim leaves of the light about a place, in powers of σ. Places at t along the rim are t²/2a nearer to it than
/// those at 0, so the distance z of the rim in σ has the variance σ²/2a²; angle brackets are means over that, to its first
/// order. λ = ⟨φ(z)⟩/⟨Φ(z)⟩ and κ = λσ/a. What is said of the direction along the rim is an
/// interpolation: right to the first order of σ/a near it, and in the limit far outside, where the variance is 1/(1 + κ).
pub(super) struct Cut {
    /// Its part, ⟨Φ⟩.
    pub visible: f32,
    /// How far what is left is inwards on average: λ.
    pub mean: f32,
    /// By how much its variance is less along the rim: κ (1 + (z + λ) σ/a)/(1 + κ).
    pub sideways: f32,
    /// By how much more it is less across the rim: ⟨zφ⟩/⟨Φ⟩ + λ², less that.
    pub narrower: f32,
    /// Third central moment across the rim: −⟨(z² + 2) φ⟩/⟨Φ⟩ + 3λ (1 − ⟨zφ⟩/⟨Φ⟩) − 2λ³.
    skew: f32,
    /// Third moment once across and twice along it: −(⟨zφ⟩/⟨Φ⟩ + λ²) σ/a (1 + κ)⁻².
    skew_sideways: f32,
}

impl Rim {
    #[inline(always)]
    pub fn new(pupil: f32, seen: f32) -> Self {
        let spread = seen.sqrt();
        Self { pupil, per_spread: spread.recip(), per_pupil: spread / pupil }
    }

    /// About a place at a distance from the middle of the pupil, by its square, px².
    #[inline(always)]
    pub fn cut(&self, square: f32) -> Cut {
        let z = (self.pupil - square.sqrt()) * self.per_spread - 0.5 * self.per_pupil;
        let (below, density) = normal(z);
        let (squared, half_variance) = (z * z, 0.25 * self.per_pupil * self.per_pupil);
        let visible = (below - half_variance * z * density).max(0.0);
        let lit = if visible > LEAST { 1.0 } else { 0.0 };
        let density = lit * density / visible.max(LEAST);
        let lambda = density * (1.0 + half_variance * (squared - 1.0));
        let first = density * z * (1.0 + half_variance * (squared - 3.0));
        let second = density * (squared + half_variance * (2.0 + squared * (squared - 5.0)));
        let lost = first + lambda * lambda;
        let kappa = lambda * self.per_pupil;
        let per_kappa = (1.0 + kappa).recip();
        let sideways = kappa * (1.0 + (z + lambda) * self.per_pupil) * per_kappa;
        Cut {
            visible: lit * visible,
            mean: lambda,
            sideways,
            narrower: lost - sideways,
            skew: lambda * (3.0 * (1.0 - first) - 2.0 * (1.0 + lambda * lambda)) - second,
            skew_sideways: -lost * self.per_pupil * per_kappa * per_kappa,
        }
    }
}

impl Cut {
    /// Third moments of the distances of places from two edges, and the mixed ones with the first or the second squared:
    /// their normals have these parts across the rim and along it.
    #[inline(always)]
    pub fn thirds(&self, [n1, t1]: [f32; 2], [n2, t2]: [f32; 2]) -> [f32; 4] {
        let (across, along) = (self.skew, self.skew_sideways);
        let mixed = across * n1 * n2 + 2.0 * along * t1 * t2;
        [
            n1 * (across * n1 * n1 + 3.0 * along * t1 * t1),
            n2 * (across * n2 * n2 + 3.0 * along * t2 * t2),
            n1 * mixed + along * t1 * t1 * n2,
            n2 * mixed + along * t2 * t2 * n1,
        ]
    }
}

/// A step from −1 to 1 seen through a normal spread, and its derivatives, px⁻¹ to px⁻⁴.
pub(super) struct Step {
    pub value: f32,
    pub first: f32,
    pub second: f32,
    pub third: f32,
    fourth: f32,
}

impl Step {
    /// At a distance from it, px, with a variance, px².
    #[inline(always)]
    pub fn new(distance: f32, variance: f32) -> Self {
        let inverse = variance.max(LEAST_PX2).sqrt().recip();
        let distance = distance * inverse;
        let (below, density) = normal(distance);
        let first = 2.0 * density * inverse;
        let second = -distance * inverse * first;
        let third = (distance * distance - 1.0) * inverse * inverse * first;
        let fourth = distance * (3.0 - distance * distance) * inverse * inverse * inverse * first;
        Self { value: 2.0 * below - 1.0, first, second, third, fourth }
    }

    /// The step seen through a spread with a third and a fourth cumulant, px³ and px⁴.
    #[inline(always)]
    pub fn of_cumulants(&self, third: f32, fourth: f32) -> f32 {
        self.value + third / 6.0 * self.third + fourth / 24.0 * self.fourth
    }
}

/// The normal distribution below x, to 2e-7, and its density there: Abramowitz and Stegun (1964), Eq. 7.1.28, and its
/// derivative.
#[inline(always)]
fn normal(x: f32) -> (f32, f32) {
    const A: [f32; 6] = [
        0.070_523_08,
        0.042_282_01,
        0.009_270_527,
        0.000_152_014_3,
        0.000_276_567_2,
        0.000_043_063_8,
    ];
    const SCALE: f32 = std::f32::consts::FRAC_1_SQRT_2;
    let z = (x.abs() * SCALE).min(4.0);
    let series = 1.0 + z * (A[0] + z * (A[1] + z * (A[2] + z * (A[3] + z * (A[4] + z * A[5])))));
    let slope = A[0]
        + z * (2.0 * A[1]
            + z * (3.0 * A[2] + z * (4.0 * A[3] + z * (5.0 * A[4] + z * 6.0 * A[5]))));
    let inverse = series.recip();
    let squared = inverse * inverse;
    let fourth = squared * squared;
    let eighth = fourth * fourth;
    let tail = 0.5 * eighth * eighth;
    (if x < 0.0 { tail } else { 1.0 - tail }, 16.0 * SCALE * tail * inverse * slope)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Against sums over the places of a normal distribution that lie in the pupil.
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
        let cut = rim.cut((from_middle * from_middle) as f32);
        let found = |value: f32, moment: f64, power: i32, limit: f64| {
            let expected = moment / spread.powi(power);
            assert!((f64::from(value) - expected).abs() < limit, "{value} for {expected}");
        };
        let variance = square - mean * mean;
        found(cut.visible, sum / all, 0, 1.5e-3);
        found(-cut.mean, mean, 1, 3e-3);
        found(1.0 - cut.sideways, along, 2, 3e-3);
        found(1.0 - cut.narrower - cut.sideways, variance, 2, 3e-3);
        found(cut.skew, cube - mean * (3.0 * variance + mean * mean), 3, 4e-3);
        found(cut.skew_sideways, mixed - mean * along, 3, 4e-3);
    }

    #[test]
    #[allow(clippy::cast_possible_truncation)] // single precision, as the light
    fn normal_distribution() {
        for i in -60..=60_i16 {
            let x = f64::from(i) / 15.0;
            let (below, density) = normal(x as f32);
            let expected = 0.5 * libm::erfc(-x * std::f64::consts::FRAC_1_SQRT_2);
            assert!((f64::from(below) - expected).abs() < 1e-6, "{x}: {below} for {expected}");
            let expected = (-x * x / 2.0).exp() / std::f64::consts::TAU.sqrt();
            assert!((f64::from(density) - expected).abs() < 1e-5, "{x}: {density} for {expected}");
        }
    }
}
