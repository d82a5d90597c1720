//! How a micro-lens blurs.

use crate::optics::Obliquity;

/// How one micro-lens blurs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MicroOptics {
    /// Lens type, from 0.
    pub lens_type: usize,
    /// a: radius of the main lens's pupil seen through the middle of the micro-lens, px.
    pub pupil_px: f64,
    /// q'ᵢ, px.
    pub q_prime_px: f64,
    /// Δc/2, px.
    pub half_pitch_px: f64,
    /// φ, the aperture ratio.
    pub aperture_ratio: f64,
    /// The angles at which light arrives.
    pub obliquity: Obliquity,
    /// d over that in the middle of the image, less 1.
    pub(super) growth: f64,
}

impl MicroOptics {
    /// ρ of a point with slope γ, px: Eq. (radiusfinal) with 1/ν = 1 − γ/λ, in which λ drops out. It is the blur radius of
    /// micro-lenses whose openings fill the distance between them.
    #[must_use]
    pub fn rho_px(&self, slope: f64) -> f64 {
        self.q_prime_px - slope * self.half_pitch_px
    }

    /// ρ by Eq. (radiusfinal) from 1/ν, with λ = 1 as the paper has it, px.
    #[must_use]
    pub fn rho_of_depth_px(&self, inverse_virtual_depth: f64) -> f64 {
        self.rho_px(1.0 - inverse_virtual_depth)
    }

    /// The blur radius of a point with slope γ, φρ, px.
    #[must_use]
    pub fn blur_radius_px(&self, slope: f64) -> f64 {
        self.aperture_ratio * self.rho_px(slope)
    }

    /// Derivative of the blur radius by ln φ, px, of a point whose slope γ has the derivative `slope_by_ratio`. The blur radius of
    /// the pupil is held, since white images show it.
    #[must_use]
    pub fn blur_by_ratio_px(&self, slope: f64, slope_by_ratio: f64) -> f64 {
        -self.blur_by_slope_px() * (1.0 - slope - slope_by_ratio)
    }

    /// Derivative of the blur radius by the slope, px.
    #[must_use]
    pub fn blur_by_slope_px(&self) -> f64 {
        -self.aperture_ratio * self.half_pitch_px
    }

    /// φqᵢ, px: the blur radius of the pupil itself, which has the slope 1.
    #[must_use]
    pub fn q_px(&self) -> f64 {
        self.blur_radius_px(1.0)
    }

    /// Outer radius a + |φqᵢ| of the white micro-image, px.
    #[must_use]
    pub fn outer_radius_px(&self) -> f64 {
        self.pupil_px + self.q_px().abs()
    }

    /// How far from the centre its own light reaches, px: beyond half the pitch it may be a neighbour's.
    #[must_use]
    pub fn reach_px(&self) -> f64 {
        self.outer_radius_px().min(self.half_pitch_px)
    }

    /// How far from the centre a point of blur radius ρ has light that comes through the pupil, px.
    #[must_use]
    pub fn lit_px(&self, rho_px: f64) -> f64 {
        (self.pupil_px + (rho_px - self.q_px()).abs()).min(self.half_pitch_px)
    }
}
