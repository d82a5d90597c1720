//! The discs of pupil and blur that make a micro-image, and through which part of the micro-lens each of its
//! pixels sees the pupil.

use super::profile::PIXEL;
use super::stage::PrecalibrationOptions;
use crate::model::InternalParameters;
use crate::vignetting::{Obliquity, overlap, overlap_area};

/// What a pixel, and a point spread, take from the plateau of a micro-image, px.
const PLATEAU_MARGIN_PX: f64 = 1.2;

/// Step of the derivative by the growth of d.
const GROWTH: f64 = 1e-2;

/// The discs of pupil and blur in a white image.
#[derive(Debug)]
pub(super) struct Levers {
    /// a, px.
    pupil_px: f64,
    /// qᵢ with its sign, by lens type, px.
    q_px: Vec<f64>,
    /// ΔC/2, the radius of a micro-lens, px.
    lens_px: f64,
    /// d, px.
    distance_px: f64,
    /// D/d.
    distances: f64,
}

impl Levers {
    /// Of an image at this f-number.
    pub fn new(
        internal: &InternalParameters,
        f_number: f64,
        pitch_px: f64,
        options: &PrecalibrationOptions,
    ) -> Self {
        let pixel = options.pixel_size_mm;
        let (lens_to_sensor_px, distance_px) = options.distances_px(internal.m_mm);
        Self {
            pupil_px: internal.pupil_radius_mm(f_number) / pixel,
            q_px: internal.q_prime_mm.iter().map(|q| q / pixel - pitch_px / 2.0).collect(),
            // The micro-image pitch is that of the lenses as projected from the pupil. Where a large pupil and
            // a large blur nearly cancel in how far light shifts a centroid, the 2 % show.
            lens_px: pitch_px / 2.0 * (1.0 - distance_px / lens_to_sensor_px),
            distance_px,
            distances: lens_to_sensor_px / distance_px - 1.0,
        }
    }

    /// Radii a and b of the discs of pupil and blur, px.
    pub fn radii(&self, lens_type: usize) -> (f64, f64) {
        (self.pupil_px, self.q_px[lens_type].abs())
    }

    /// How much light at distance r from the middle changes with the gradient g, over g: |y − M|, outwards,
    /// the mean over the light of a pixel and over the part of the micro-lens that it sees the pupil through.
    ///
    /// That part is so large that the mean of light that falls off as cos⁴ over it is not the light of its
    /// mean: with s = y − M, what changes with g is s/(1 + s²/d²), weighted by (1 + s²/d²)⁻². `strength` is
    /// the fall-off over that of cos⁴; what pixels add is taken to be exponential in s².
    pub fn lever(&self, lens_type: usize, r: f64, strength: f64) -> f64 {
        let q = self.q_px[lens_type];
        let size = q.abs().max(1e-6);
        let (mut light, mut sum) = (0.0, 0.0);
        for (along, weight) in PIXEL {
            // Across the direction to the middle a pixel has a mean square of 1/12.
            let distance = ((r + along).powi(2) + 1.0 / 12.0).sqrt();
            // Where nothing is visible there is no light either.
            let Some(part) = overlap(distance / size, self.pupil_px / size) else { continue };
            let s = distance + part.mean * q.signum() * self.lens_px;
            // Variances of the part, along s and across it.
            let variance = |of_half: f64| (of_half * self.lens_px / 2.0).powi(2);
            let (v, across) = (variance(part.along), variance(part.across));
            let bent = (s * s + 3.0 * v + across) / strength + 4.0 * strength * v;
            let lever = s / (1.0 + bent / self.distance_px.powi(2));
            light += weight * part.area;
            sum += weight * part.area * lever * (r + along) / distance;
        }
        if light > 0.0 { sum / light } else { 0.0 }
    }

    /// How fast the moment X of whole discs, (a² + qᵢ² + qᵢ ΔC/2)/4, grows along a perspective of the centres,
    /// c = p (1 + t · p), over t, px². That is a tilt of the array by t D: d grows by its part t D/d, and with it
    /// a, qᵢ + ΔC/2 and their moment. X is often a small difference of them and grows ten times as fast.
    pub fn moment_growth(&self, lens_type: usize) -> f64 {
        let (a, q, lens) = (self.pupil_px, self.q_px[lens_type], self.lens_px);
        (2.0 * a * a + (2.0 * q + lens) * (q + lens)) / 4.0 * self.distances
    }

    /// The light at distance r, and how it changes where d grows, over its relative growth; both over the light in
    /// the middle. a and qᵢ + ΔC/2 grow in proportion, the micro-lens stays, and light arrives less obliquely.
    /// `law` is how light falls off inside a micro-image.
    pub fn light_and_growth(&self, lens_type: usize, r: f64, law: &Obliquity) -> (f64, f64) {
        let light = |r: f64, growth: f64| {
            let (a, q) = (self.pupil_px, self.q_px[lens_type]);
            let (a, q) = (a * (1.0 + growth), q + (q + self.lens_px) * growth);
            let size = q.abs().max(1e-6);
            let of_pixel = |(along, weight): (f64, f64)| {
                let distance_px = ((r + along).powi(2) + 1.0 / 12.0).sqrt();
                let Some(part) = overlap(distance_px / size, a / size) else { return 0.0 };
                let s = distance_px + part.mean * q.signum() * self.lens_px;
                let variances = part.along.powi(2) + part.across.powi(2);
                let square = s * s + variances * (self.lens_px / 2.0).powi(2);
                let (outer, inner) = (a + size, (a - size).abs());
                let area = overlap_area(distance_px, outer, inner) * (a.min(size) / size).powi(2);
                weight * area * law.light(square / (1.0 + growth).powi(2))
            };
            PIXEL.into_iter().map(of_pixel).sum::<f64>()
        };
        let middle = light(0.0, 0.0);
        let growth = (light(r, GROWTH) - light(r, -GROWTH)) / (2.0 * GROWTH * middle);
        (light(r, 0.0) / middle, growth)
    }

    /// How far from the centre all pixels see the whole pupil, or the whole micro-lens, px, and |y − M|/|y|
    /// there.
    pub fn plateau(&self, lens_type: usize) -> (f64, f64) {
        let (a, q) = (self.pupil_px, self.q_px[lens_type]);
        let lever = if a < q.abs() { 1.0 + self.lens_px / q } else { 1.0 };
        ((a - q.abs()).abs() - PLATEAU_MARGIN_PX, lever)
    }
}
