//! How obliquely light reaches a micro-image, and the effect: natural vignetting, and what pixels add.

// Only what is inlined into a dispatched function is compiled for its registers.
#![allow(clippy::inline_always)]

use nalgebra::Vector2;

/// The fall-off of light inside a micro-image. Light from the point M of the micro-lens to the point y, both
/// from their middles, changes by exp(−g·(y − M) − H |y − M|²/2).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Obliquity {
    /// g, px⁻¹: the micro-image lies off the axis.
    pub gradient_per_px: Vector2<f64>,
    /// H, px⁻²: light is more oblique off the middle of the micro-image, n/d² for a law cosⁿ.
    pub within_per_px2: f64,
    /// The part of H that pixels add to cos⁴, px⁻²: their light is exponential in |y − M|². From 0 to H.
    pub of_pixels_per_px2: f64,
    /// Δc/2, half the micro-image pitch, px. It stands for the radius ΔC/2 of the micro-lens, which is
    /// smaller by the factor D/(D + d).
    pub half_pitch_px: f64,
}

impl Obliquity {
    /// In the middle of the image, with H where the array is so far from the sensor: what H is above that of cos⁴
    /// is due to the pixels.
    pub fn in_the_middle(within_per_px2: f64, mla_to_sensor_px: f64, half_pitch_px: f64) -> Self {
        let natural = 4.0 / mla_to_sensor_px.powi(2);
        let of_pixels_per_px2 = (within_per_px2 - natural).max(0.0);
        let gradient_per_px = Vector2::zeros();
        Self { gradient_per_px, within_per_px2, of_pixels_per_px2, half_pitch_px }
    }

    /// How the light changes over the part of a micro-lens that a pixel sees. `from_lens` is the vector from the
    /// centroid of that part to the pixel, px; `spread` is its standard deviations, in units of half a radius,
    /// along `outwards` and across it.
    #[inline(always)]
    pub(crate) fn over_part(
        &self,
        from_lens: &Vector2<f64>,
        outwards: &Vector2<f64>,
        [along, across]: [f64; 2],
    ) -> Slant {
        let (hp, pixels) = (self.half_pitch_px, self.of_pixels_per_px2);
        let natural = self.within_per_px2 - pixels;
        // The gradient of the law of light() at the mean square of y − M.
        let square = from_lens.norm_squared() + hp * hp * (along * along + across * across) / 4.0;
        let within = natural / (1.0 + (natural * square / 4.0).max(-0.5)) + pixels;
        let gradient = (self.gradient_per_px + from_lens * within) * hp;
        let perpendicular = Vector2::new(-outwards.y, outwards.x);
        Slant {
            gradient: [along * gradient.dot(outwards), across * gradient.dot(&perpendicular)],
            curvature: within * hp * hp / 2.0 * along * across,
        }
    }

    /// Light over that at normal incidence, in the middle of the image, from the mean square of the vectors from
    /// the part of the micro-lens that it comes through to the pixel, px².
    pub(crate) fn light(&self, square: f64) -> f64 {
        // To the fourth order of the angle, in which the two laws differ.
        let natural = self.within_per_px2 - self.of_pixels_per_px2;
        (1.0 + (natural * square / 4.0).max(-0.5)).powi(-2)
            * (-self.of_pixels_per_px2 * square / 2.0).exp()
    }

    /// In single precision, as the light.
    #[allow(clippy::cast_possible_truncation)]
    pub(crate) fn in_single(&self) -> Falling {
        Falling {
            gradient: self.gradient_per_px.map(|x| x as f32).into(),
            natural: ((self.within_per_px2 - self.of_pixels_per_px2) / 4.0) as f32,
            of_pixels: (self.of_pixels_per_px2 / 2.0) as f32,
            half_pitch: self.half_pitch_px as f32,
        }
    }

    /// The mean of [`Obliquity::light`] where squares have a variance, px⁴.
    pub(crate) fn mean_light(&self, square: f64, variance: f64) -> f64 {
        let pixels = self.of_pixels_per_px2;
        let natural = self.within_per_px2 - pixels;
        let natural = natural / (1.0 + (natural * square / 4.0).max(-0.5));
        // Of the logarithm: −(natural + pixels)/2, and again natural²/8.
        let second = (natural + pixels).powi(2) / 4.0 + natural * natural / 8.0;
        self.light(square) * (1.0 + second * variance / 2.0)
    }

    /// The same, and how fast it falls with the mean square, over how fast it does at normal incidence.
    pub(crate) fn light_and_slope(&self, square: f64) -> (f64, f64) {
        let (within, pixels) = (self.within_per_px2, self.of_pixels_per_px2);
        let (natural, light) = (within - pixels, self.light(square));
        let oblique = 1.0 + (natural * square / 4.0).max(-0.5);
        // Without any fall-off there is none to compare with: all is as at normal incidence.
        let slope = if within == 0.0 { 1.0 } else { (natural / oblique + pixels) / within };
        (light, light * slope)
    }
}

/// How light falls off between the points of a micro-lens and those of its micro-image: see [`Obliquity::light`].
#[derive(Debug, Clone, Copy)]
pub(crate) struct Falling {
    gradient: [f32; 2],
    /// n/(4d²) of a law cosⁿ, px⁻².
    natural: f32,
    /// Half the part of pixels, px⁻².
    of_pixels: f32,
    /// Δc/2, px.
    pub half_pitch: f32,
}

impl Falling {
    /// The light through the point w of the micro-lens (a disc of radius 1) at a point y from the middle of the
    /// micro-image, px, over that at normal incidence in the middle of the image; and the gradient of its logarithm
    /// there, px⁻¹.
    #[inline(always)]
    pub fn light(&self, y: (f32, f32), w: (f32, f32)) -> (f32, f32, f32) {
        // Points of the micro-lens are half a turn away from where they lie.
        let (x, y) = (y.0 + w.0 * self.half_pitch, y.1 + w.1 * self.half_pitch);
        let square = x * x + y * y;
        let natural = (1.0 + (self.natural * square).max(-0.5)).recip();
        // exp(−z) as a power that is not below 0; z is below 0.5 on sensors.
        let z = self.gradient[0] * x + self.gradient[1] * y + self.of_pixels * square;
        let root = (1.0 - z / 16.0 * (1.0 - z / 32.0)).max(0.0);
        let (second, light) = (root * root, natural * natural);
        let fourth = second * second;
        let eighth = fourth * fourth;
        let light = light * eighth * eighth;
        let by_px = -4.0 * self.natural * natural - 2.0 * self.of_pixels;
        (light, by_px * x - self.gradient[0], by_px * y - self.gradient[1])
    }
}

/// The light through the points w of a disc of radius 1, which falls by exp(−g·w − h |w|²).
#[derive(Debug, Clone, Copy)]
pub(crate) struct Slant {
    /// g, along the two axes of the disc.
    pub gradient: [f64; 2],
    /// h.
    pub curvature: f64,
}

impl Slant {
    /// Where points that stand for equal areas go in order to stand for equal light: the gradient field u with
    /// div u = g·w + h (|w|² − ½) that does not cross the rim. To the first order of g and h.
    ///
    /// The mean moves by −g/4 (1 − h/6): `mean_square` is that of the points along an axis, which is less than the ¼ of
    /// the disc.
    #[allow(clippy::cast_possible_truncation)] // single precision, as the light
    #[inline(always)]
    pub fn field(&self, mean_square: f64) -> Field {
        // The light that the curvature leaves comes from a smaller disc.
        let smaller = 1.0 - self.curvature / 6.0;
        let whole = 0.25 / (0.375 - mean_square / 2.0) * smaller;
        Field {
            gradient: [(self.gradient[0] * whole) as f32, (self.gradient[1] * whole) as f32],
            curvature: self.curvature as f32,
        }
    }
}

/// See [`Slant::field`].
#[derive(Debug, Clone, Copy)]
pub(crate) struct Field {
    gradient: [f32; 2],
    curvature: f32,
}

impl Field {
    /// By how much the point (x, y) of the disc moves.
    #[inline(always)]
    pub fn at(&self, x: f32, y: f32) -> [f32; 2] {
        let [g, k] = self.gradient;
        let square = x * x + y * y;
        let first = (square - 3.0) / 8.0;
        let second = (g * x + k * y) / 4.0 + self.curvature * (square - 1.0) / 4.0;
        [g * first + x * second, k * first + y * second]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// f′(s²)/f′(0), by differences, for cos⁴, a pixel's law and none.
    #[test]
    fn light_falls_as_fast_as_its_slope_says() {
        for within in [4.0 / 3600.0, 10.4 / 3600.0, 0.0] {
            let law = Obliquity::in_the_middle(within, 60.0, 11.5);
            let fall = |square: f64| (law.light(square) - law.light(square + 1e-3)) / 1e-3;
            for square in [0.0, 40.0, 150.0] {
                let (light, slope) = law.light_and_slope(square);
                assert!((light - law.light(square)).abs() < 1e-12);
                let expected = if within > 0.0 { fall(square) / fall(0.0) } else { 1.0 };
                assert!((slope - expected).abs() < 1e-4, "{slope} for {expected}");
            }
        }
    }

    /// Against sums over points of the disc of a sensor 60 px away, with cos⁴; both are to second order in
    /// angles of 0.2.
    #[test]
    #[allow(clippy::cast_possible_truncation)] // single precision, as the light
    fn oblique_light_agrees_with_sums() {
        let (chief, distance) = (Vector2::new(0.1, -0.05), 60.0);
        let obliquity = Obliquity {
            gradient_per_px: chief * (4.0 / distance),
            within_per_px2: 4.0 / (distance * distance),
            of_pixels_per_px2: 0.0,
            half_pitch_px: 11.5,
        };
        let pixel = Vector2::new(4.0, 3.0);
        let slant = obliquity.over_part(&pixel, &Vector2::x(), [1.0; 2]);
        // Light, mean and mean square by weights, and mean and mean square of the points that were moved.
        let sums = |chief: Vector2<f64>, slant: &Slant| {
            let field = slant.field(0.25);
            let (mut light, mut first, mut second, mut count) = (0.0, Vector2::zeros(), 0.0, 0.0);
            let (mut moved_first, mut moved_second) = (Vector2::zeros(), 0.0);
            for (i, j) in (-100..=100).flat_map(|i| (-100..=100).map(move |j| (i, j))) {
                let w = Vector2::new(f64::from(i), f64::from(j)) / 100.0;
                if w.norm() < 1.0 {
                    // Points are half a turn away from where they lie.
                    let angle = chief + (pixel + w * obliquity.half_pitch_px) / distance;
                    let weight = angle.norm().atan().cos().powi(4);
                    light += weight;
                    first += w * weight;
                    second += w.norm_squared() * weight;
                    count += 1.0;
                    let moved = w + Vector2::from(field.at(w.x as f32, w.y as f32)).map(f64::from);
                    moved_first += moved;
                    moved_second += moved.norm_squared();
                }
            }
            (
                light / count,
                first / light,
                second / light,
                moved_first / count,
                moved_second / count,
            )
        };
        let (_, mean, square, moved_mean, moved_square) = sums(chief, &slant);
        assert!((moved_mean - mean).norm() < 0.08 * mean.norm(), "{moved_mean} {mean}");
        // Light falls off from the middle: it comes from a smaller disc.
        assert!(square < 0.495 && (moved_square - square).abs() < 3e-3, "{moved_square} {square}");
        let seen = obliquity.light(pixel.norm_squared() + obliquity.half_pitch_px.powi(2) / 2.0);
        let (expected, ..) = sums(Vector2::zeros(), &slant);
        assert!((seen - expected).abs() < 4e-3, "{seen} for {expected}");
    }
}
