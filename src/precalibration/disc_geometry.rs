//! Discs of pupil and blur that form the micro-images of a white image, and their light by distance from the middle.

use nalgebra::Vector2;

use super::grid::MicroImageArray;
use super::options::PrecalibrationOptions;
use crate::model::{InternalParameters, Opening, TiltGradient, growth_per_px};
use crate::optics::{Obliquity, RadialPixels, Seen, WhiteDiscs};

/// Step of derivatives by the relative growth of d.
pub(super) const GROWTH: f64 = 1e-2;

/// Discs of pupil and blur in a white image.
#[derive(Debug)]
pub(super) struct DiscGeometry {
    /// Pupil radius a, px.
    pupil_px: f64,
    /// Signed blur radius φqᵢ by lens type, px.
    q_px: Vec<f64>,
    /// Half the width φΔC of a micro-lens, px.
    lens_px: f64,
    opening: Opening,
    /// Ratio (D + d)/d.
    lens_to_sensor: f64,
    /// Variance of the point spread, px².
    point_spread_px2: f64,
}

impl DiscGeometry {
    /// Creates the geometry of an image at this f-number.
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
            // The micro-image pitch is the lens pitch projected from the pupil. If a large pupil and a large blur
            // nearly cancel in the centroid shift, these 2 % matter.
            lens_px: ratio * pitch_px / 2.0 * (1.0 - distance_px / lens_to_sensor_px),
            opening: internal.opening,
            lens_to_sensor: lens_to_sensor_px / distance_px,
            point_spread_px2: internal.point_spread_px2(),
        }
    }

    /// Computes the relative growth of d over the image, px⁻¹.
    pub fn growth_per_px(
        &self,
        tilt_gradient: Option<&TiltGradient>,
        grid: &MicroImageArray,
    ) -> Vector2<f64> {
        growth_per_px(tilt_gradient, &grid.perspective_per_px, self.lens_to_sensor)
    }

    /// Returns the point spread of the pixels, px².
    pub fn point_spread_px2(&self) -> f64 {
        self.point_spread_px2
    }

    /// Returns the shape of the openings.
    pub fn opening(&self) -> Opening {
        self.opening
    }

    /// Returns the radii a and b of the discs of pupil and blur, px.
    pub fn radii(&self, lens_type: usize) -> (f64, f64) {
        (self.pupil_px, self.q_px[lens_type].abs())
    }

    /// Returns the largest blur radius |φqᵢ| of the pupil, px.
    pub fn widest_blur_px(&self) -> f64 {
        self.q_px.iter().fold(0.0, |widest: f64, q| widest.max(q.abs()))
    }

    /// Computes the light up to a distance from the middle, px, where d is larger by the fraction `growth`. `law` is
    /// the angular response inside a micro-image without growth.
    pub fn light(
        &self,
        lens_type: usize,
        growth: f64,
        law: &Obliquity,
        reach_px: f64,
    ) -> DiscLight {
        let (a, q) = (self.pupil_px, self.q_px[lens_type]);
        // The sensor does not move, so the pupil is nearer: a is (radius of the pupil) d/D. φ(qᵢ + ΔC/2) is
        // proportional to d, and the micro-lens does not change.
        let nearer = self.lens_to_sensor / (self.lens_to_sensor - 1.0);
        let (by_growth, q_by_growth) = (a * nearer, q + self.lens_px);
        // Light arrives less obliquely.
        let less_oblique = (1.0 + growth).powi(-2);
        let law = Obliquity {
            within_per_px2: law.within_per_px2 * less_oblique,
            of_pixels_per_px2: law.of_pixels_per_px2 * less_oblique,
            ..*law
        };
        let discs = WhiteDiscs {
            pupil_px: a + by_growth * growth,
            q_px: q + q_by_growth * growth,
            opening_px: self.lens_px,
            opening: self.opening,
            law,
        };
        let pixels = RadialPixels::new(self.point_spread_px2, reach_px);
        let [light, by_growth] = pixels.see(|t| {
            let (point, [by_pupil, by_blur]) = (discs.point(t), discs.by_radii(t));
            let by_radii = by_pupil * by_growth + by_blur * q_by_growth * q.signum();
            [point.light, by_radii - 2.0 * point.by_obliquity]
        });
        let [sensitivity] = pixels.see_outwards(|t| [discs.point(t).sensitivity]);
        DiscLight { light, by_growth, sensitivity }
    }
}

/// The light of a micro-image by distance from its middle.
#[derive(Debug)]
pub(super) struct DiscLight {
    light: Seen,
    by_growth: Seen,
    sensitivity: Seen,
}

impl DiscLight {
    /// Returns the light at a distance, px, and its derivative by the relative growth of d, both relative to the light
    /// in the middle.
    pub fn with_growth(&self, r: f64) -> (f64, f64) {
        let middle = self.light.at(0.0);
        (self.light.at(r) / middle, self.by_growth.at(r) / middle)
    }

    /// Returns the light at a distance, px, in a unit of its own, and its slope, px⁻¹.
    pub fn with_slope(&self, r: f64) -> (f64, f64) {
        self.light.with_slope(r)
    }

    /// Returns the relative decrease of the light with the gradient g: |y − M| outwards, px. It is averaged over the
    /// light of a pixel and over the part of the micro-lens through which the pixel sees the pupil.
    pub fn sensitivity(&self, r: f64) -> f64 {
        let light = self.light.at(r);
        if light > DARK { self.sensitivity.at(r) / light } else { 0.0 }
    }
}

/// Fraction of the brightest light below which light has no direction.
const DARK: f64 = 1e-6;
