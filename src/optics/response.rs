//! Angular response inside a micro-image: natural vignetting and the response of pixels.

// Only functions inlined into a dispatched function are compiled for its registers.
#![allow(clippy::inline_always)]

use nalgebra::Vector2;
use pulp::Simd;

use crate::numerics::simd::Lanes;

/// Angular response inside a micro-image. Light from the point M of the micro-lens to the point y, each relative to its middle,
/// changes by exp(−g·(y − M) − H |y − M|²/2).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Obliquity {
    /// Gradient g of a micro-image off the axis, px⁻¹.
    pub gradient_per_px: Vector2<f64>,
    /// Decrease H off the middle of the micro-image, where light is more oblique, px⁻²: n/d² for a law cosⁿ.
    pub within_per_px2: f64,
    /// Part of H that the pixels add to cos⁴, px⁻², from 0 to H. Their response is exponential in |y − M|².
    pub of_pixels_per_px2: f64,
    /// Half the micro-image pitch Δc/2, px. It stands for the radius ΔC/2 of the micro-lens, which is smaller by the factor
    /// D/(D + d).
    pub half_pitch_px: f64,
}

impl Obliquity {
    /// Creates the response in the middle of the image for the distance from array to sensor. The pixels are taken to cause the
    /// part of H above cos⁴.
    pub fn in_the_middle(within_per_px2: f64, mla_to_sensor_px: f64, half_pitch_px: f64) -> Self {
        let natural = 4.0 / mla_to_sensor_px.powi(2);
        let of_pixels_per_px2 = (within_per_px2 - natural).max(0.0);
        let gradient_per_px = Vector2::zeros();
        Self { gradient_per_px, within_per_px2, of_pixels_per_px2, half_pitch_px }
    }

    /// Returns light relative to normal incidence in the middle of the image. `square` is the mean square of the vectors to the
    /// pixel from the points of the micro-lens that the light passes, px².
    pub(crate) fn light(&self, square: f64) -> f64 {
        // The result is correct to the fourth order of the angle, in which the two laws differ.
        let natural = self.within_per_px2 - self.of_pixels_per_px2;
        (1.0 + (natural * square / 4.0).max(-0.5)).powi(-2)
            * (-self.of_pixels_per_px2 * square / 2.0).exp()
    }

    /// Returns the mean of [`Obliquity::light`] over squares with a variance, px⁴.
    pub(crate) fn mean_light(&self, square: f64, variance: f64) -> f64 {
        let pixels = self.of_pixels_per_px2;
        let natural = self.within_per_px2 - pixels;
        let natural = natural / (1.0 + (natural * square / 4.0).max(-0.5));
        // The logarithm has the derivatives −(natural + pixels)/2 and natural²/8.
        let second = (natural + pixels).powi(2) / 4.0 + natural * natural / 8.0;
        self.light(square) * (1.0 + second * variance / 2.0)
    }
}

/// Angular response as in [`Obliquity::light`], in single precision.
#[derive(Debug, Clone, Copy)]
pub(super) struct Response {
    gradient: [f32; 2],
    /// Coefficient n/(4d²) of a law cosⁿ, px⁻².
    natural: f32,
    /// Half the part of H that the pixels add, px⁻².
    of_pixels: f32,
}

/// Light of a ray, relative to normal incidence in the middle of the image.
pub(super) struct RayLight<S: Simd> {
    pub light: Lanes<S>,
    /// Gradient of the logarithm of the light with the position of the pixel, px⁻¹.
    pub gradient: [Lanes<S>; 2],
    /// Derivatives by H: of the logarithm, px², and of its gradient, px.
    pub by_within: Lanes<S>,
    pub gradient_by_within: [Lanes<S>; 2],
}

impl Response {
    #[allow(clippy::cast_possible_truncation)] // single precision, as the light
    pub fn new(law: &Obliquity) -> Self {
        Self {
            gradient: law.gradient_per_px.map(|x| x as f32).into(),
            natural: ((law.within_per_px2 - law.of_pixels_per_px2) / 4.0) as f32,
            of_pixels: (law.of_pixels_per_px2 / 2.0) as f32,
        }
    }

    /// Returns the light of rays. Their vectors from the point of the micro-lens to the pixel are in px.
    #[inline(always)]
    pub fn light<S: Simd>(&self, simd: S, [x, y]: [Lanes<S>; 2]) -> RayLight<S> {
        let square = x.mul_add(x, y * y);
        let natural = ((square * self.natural).max(Lanes::splat(simd, -0.5)) + 1.0).recip();
        // A power that is never negative approximates exp(−z); z is below 0.5 on sensors.
        let z = x * self.gradient[0] + y * self.gradient[1] + square * self.of_pixels;
        let root = z
            .mul_add((z * (1.0 / 512.0)) - 1.0 / 16.0, Lanes::splat(simd, 1.0))
            .max(Lanes::splat(simd, 0.0));
        let second = root * root;
        let fourth = second * second;
        let eighth = fourth * fourth;
        let light = natural * natural * eighth * eighth;
        let by_px = natural * (-4.0 * self.natural) - 2.0 * self.of_pixels;
        RayLight {
            light,
            gradient: [by_px * x - self.gradient[0], by_px * y - self.gradient[1]],
            by_within: -(square * natural * 0.5),
            gradient_by_within: [-(natural * natural * x), -(natural * natural * y)],
        }
    }
}

#[cfg(test)]
mod tests {
    use pulp::Scalar;

    use super::*;

    /// Checks light in single precision, and the derivatives of its logarithm.
    #[test]
    #[allow(clippy::cast_possible_truncation)] // single precision, as the light
    fn single_precision_is_enough() {
        let law = |within: f64| Obliquity {
            gradient_per_px: Vector2::new(3e-3, -2e-3),
            within_per_px2: within,
            of_pixels_per_px2: 1e-3,
            half_pitch_px: 11.5,
        };
        let exact = |law: &Obliquity, s: &Vector2<f64>| {
            law.light(s.norm_squared()) * (-law.gradient_per_px.dot(s)).exp()
        };
        let (law, more, simd) = (law(2e-3), law(2.001e-3), Scalar::new());
        for place in [Vector2::new(0.5, 0.0), Vector2::new(9.0, -6.0), Vector2::new(-14.0, 3.0)] {
            let single = [place.x, place.y].map(|x| Lanes::splat(simd, x as f32));
            let found = Response::new(&law).light(simd, single);
            let light = exact(&law, &place);
            assert!((f64::from(found.light.sum()) / light - 1.0).abs() < 1e-4);
            for (i, step) in [Vector2::x(), Vector2::y()].into_iter().enumerate() {
                let by = (exact(&law, &(place + step * 1e-4)) / light).ln() / 1e-4;
                let found = f64::from(found.gradient[i].sum());
                assert!((found - by).abs() < 1e-4, "{found} for {by}");
            }
            let by = (exact(&more, &place) / light).ln() / 1e-6;
            let found = f64::from(found.by_within.sum());
            assert!((found - by).abs() < 0.01 * by.abs(), "{found} for {by}");
        }
    }
}
