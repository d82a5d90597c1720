//! The discs of pupil and blur that make a micro-image, and through which part of the micro-lens each of its
//! pixels sees the pupil.

use nalgebra::Vector2;

use super::grid::MicroImageArray;
use super::options::PrecalibrationOptions;
use crate::model::{InternalParameters, TiltGradient, growth_per_px};
use crate::optics::{Obliquity, Pixel};

/// Slices that a part of a micro-lens is summed over, and places in them: Gauss and Legendre, one of both sides.
const SLICES: u32 = 24;
const GAUSS: [(f64, f64); 2] = [(0.0, 8.0 / 9.0), (0.774_596_669_241_483_4, 10.0 / 9.0)];
/// Step of the derivative by the growth of d.
pub(super) const GROWTH: f64 = 1e-2;

/// The discs of pupil and blur in a white image.
#[derive(Debug)]
pub(super) struct DiscGeometry {
    /// a, px.
    pupil_px: f64,
    /// φqᵢ with its sign, by lens type, px.
    q_px: Vec<f64>,
    /// φΔC/2, the radius of a micro-lens, px.
    lens_px: f64,
    /// (D + d)/d.
    lens_to_sensor: f64,
    pixel: Pixel,
}

impl DiscGeometry {
    /// Of an image at this f-number.
    pub fn new(
        internal: &InternalParameters,
        f_number: f64,
        pitch_px: f64,
        options: &PrecalibrationOptions,
    ) -> Self {
        let (pixel, ratio) = (options.pixel_size_mm, internal.aperture_ratio());
        let (lens_to_sensor_px, distance_px) = options.distances_px(internal.m_mm);
        Self {
            pupil_px: internal.pupil_radius_mm(f_number) / pixel,
            q_px: internal
                .q_prime_mm
                .iter()
                .map(|q| ratio * (q / pixel - pitch_px / 2.0))
                .collect(),
            // The micro-image pitch is that of the lenses as projected from the pupil. Where a large pupil and
            // a large blur nearly cancel in how far light shifts a centroid, the 2 % show.
            lens_px: ratio * pitch_px / 2.0 * (1.0 - distance_px / lens_to_sensor_px),
            lens_to_sensor: lens_to_sensor_px / distance_px,
            pixel: Pixel::new(internal.point_spread_px2()),
        }
    }

    /// How d grows over the image, px⁻¹.
    pub fn growth_per_px(
        &self,
        tilt_gradient: Option<&TiltGradient>,
        grid: &MicroImageArray,
    ) -> Vector2<f64> {
        growth_per_px(tilt_gradient, &grid.perspective_per_px, self.lens_to_sensor)
    }

    /// What its pixels collect.
    pub fn pixel(&self) -> &Pixel {
        &self.pixel
    }

    /// Radii a and b of the discs of pupil and blur, px.
    pub fn radii(&self, lens_type: usize) -> (f64, f64) {
        (self.pupil_px, self.q_px[lens_type].abs())
    }

    /// How much light at distance r from the middle changes with the gradient g, over g: |y − M|, outwards, the
    /// mean over the light of a pixel and over the part of the micro-lens that it sees the pupil through. With
    /// s = y − M, light f(s²) off the axis is f(|s + t|²), and changes along t as s f′(s²).
    pub fn sensitivity(&self, lens_type: usize, r: f64, law: &Obliquity) -> f64 {
        self.light_and_sensitivity(lens_type, r, 0.0, law).1
    }

    /// The light at distance r in units of its own, and its sensitivity, where d is larger by `growth`.
    pub fn light_and_sensitivity(
        &self,
        lens_type: usize,
        r: f64,
        growth: f64,
        law: &Obliquity,
    ) -> (f64, f64) {
        let (mut light, mut sum) = (0.0, 0.0);
        let less_oblique = (1.0 + growth).powi(-2);
        self.over_pixel(lens_type, r, growth, &mut |s, outwards, weight| {
            let (of_law, slope) = law.light_and_slope(s.norm_squared() * less_oblique);
            light += weight * of_law;
            sum += weight * slope * s.x * outwards;
        });
        (light, if light > 0.0 { sum / light } else { 0.0 })
    }

    /// The light at distance r, and how it changes where d grows, over its relative growth; both over the light in
    /// the middle. a and φ(qᵢ + ΔC/2) grow in proportion, the micro-lens stays, and light arrives less obliquely.
    /// `law` is how light falls off inside a micro-image.
    pub fn light_and_growth(&self, lens_type: usize, r: f64, law: &Obliquity) -> (f64, f64) {
        let light = |r: f64, growth: f64| self.light_and_sensitivity(lens_type, r, growth, law).0;
        let middle = light(0.0, 0.0);
        let growth = (light(r, GROWTH) - light(r, -GROWTH)) / (2.0 * GROWTH * middle);
        (light(r, 0.0) / middle, growth)
    }

    /// Calls `add` for places y of a pixel at distance r and points M of the part of the micro-lens that they see the
    /// pupil through, where d is larger by `growth`: with y − M, px, in the direction to y and across it; with how
    /// much of that direction is outwards, and with the weight.
    fn over_pixel(
        &self,
        lens_type: usize,
        r: f64,
        growth: f64,
        add: &mut dyn FnMut(Vector2<f64>, f64, f64),
    ) {
        let (a, q) = (self.pupil_px, self.q_px[lens_type]);
        // The sensor stays where it is, so the pupil comes nearer: a is (pupil's radius) d/D.
        let nearer = self.lens_to_sensor / (self.lens_to_sensor - 1.0);
        let (a, q) = (a * (1.0 + growth * nearer), q + (q + self.lens_px) * growth);
        let size = q.abs().max(1e-6);
        for (along, weight) in self.pixel.along {
            // Across the direction to the middle the mean square will do.
            let distance = ((r + along).powi(2) + self.pixel.variance).sqrt();
            let outwards = (r + along) / distance;
            let (to_pupil, pupil) = (distance / size, a / size);
            // From end to end of the overlap, where its height has the slope of a root.
            let (low, high) = ((-1.0_f64).max(to_pupil - pupil), 1.0_f64.min(to_pupil + pupil));
            let half = (high - low) / 2.0;
            for i in 0..if half > 0.0 { SLICES } else { 0 } {
                let angle = std::f64::consts::PI * ((f64::from(i) + 0.5) / f64::from(SLICES) - 0.5);
                let x = low + half * (1.0 + angle.sin());
                let chord = |radius: f64, x: f64| (radius * radius - x * x).max(0.0).sqrt();
                let height = chord(1.0, x).min(chord(pupil, x - to_pupil));
                let slice = weight * half * angle.cos() * height;
                for (y, part) in GAUSS {
                    let from_lens = Vector2::new(x * q.signum(), y * height) * self.lens_px;
                    add(from_lens + Vector2::new(distance, 0.0), outwards, slice * part);
                }
            }
        }
    }
}
