//! Optics of a micro-lens.

use crate::model::Opening;
use crate::optics::Obliquity;

/// Optics of one micro-lens, with its micro-image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MicroOptics {
    /// Lens type, from 0.
    pub lens_type: usize,
    /// Radius a of the main lens's pupil, seen through the middle of the micro-lens, px.
    pub pupil_px: f64,
    /// Internal parameter q'ᵢ, px.
    pub q_prime_px: f64,
    /// Half the micro-image pitch Δc/2, px.
    pub half_pitch_px: f64,
    /// Distance from the centre up to which there is no light of neighbours, px: half the pitch, or less if micro-images
    /// overlap.
    pub alone_px: f64,
    /// Aperture ratio φ.
    pub aperture_ratio: f64,
    /// Shape of the opening.
    pub opening: Opening,
    /// Direction of the normal of one of its sides, rad.
    pub normal_rad: f64,
    /// Angular response.
    pub obliquity: Obliquity,
    /// Relative difference of d from its value in the middle of the image.
    pub(super) growth: f64,
}

impl MicroOptics {
    /// Returns ρ of a point with slope γ, px: Eq. (radiusfinal) with 1/ν = 1 − γ/λ, in which λ drops out. It is the blur radius
    /// of micro-lenses whose openings are as wide as the pitch.
    #[must_use]
    pub fn rho_px(&self, slope: f64) -> f64 {
        self.q_prime_px - slope * self.half_pitch_px
    }

    /// Returns ρ from 1/ν by Eq. (radiusfinal), with λ = 1 as in the paper, px.
    #[must_use]
    pub fn rho_of_depth_px(&self, inverse_virtual_depth: f64) -> f64 {
        self.rho_px(1.0 - inverse_virtual_depth)
    }

    /// Returns the blur radius φρ of a point with slope γ, px.
    #[must_use]
    pub fn blur_radius_px(&self, slope: f64) -> f64 {
        self.aperture_ratio * self.rho_px(slope)
    }

    /// Returns the derivative of the blur radius by ln φ, px, of a point whose slope γ has the derivative `slope_by_ratio`. The
    /// blur radius of the pupil is held, since white images show it.
    #[must_use]
    pub fn blur_by_ratio_px(&self, slope: f64, slope_by_ratio: f64) -> f64 {
        -self.blur_by_slope_px() * (1.0 - slope - slope_by_ratio)
    }

    /// Returns the derivative of the blur radius by the slope, px.
    #[must_use]
    pub fn blur_by_slope_px(&self) -> f64 {
        -self.aperture_ratio * self.half_pitch_px
    }

    /// Returns φqᵢ, px: the blur radius of the pupil itself, which has the slope 1.
    #[must_use]
    pub fn q_px(&self) -> f64 {
        self.blur_radius_px(1.0)
    }

    /// Returns the outer radius a + |φqᵢ| of the white micro-image, px.
    #[must_use]
    pub fn outer_radius_px(&self) -> f64 {
        self.pupil_px + self.q_px().abs()
    }

    /// Returns the distance from the centre that its own light reaches without light of neighbours, px.
    #[must_use]
    pub fn reach_px(&self) -> f64 {
        self.outer_radius_px().min(self.alone_px)
    }

    /// Returns the distance from the centre up to which light of a point with the blur radius ρ comes through the pupil, px.
    #[must_use]
    pub fn lit_px(&self, rho_px: f64) -> f64 {
        (self.pupil_px + (rho_px - self.q_px()).abs()).min(self.alone_px)
    }
}
