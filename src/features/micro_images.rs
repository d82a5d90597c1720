//! What the pre-calibration says of every micro-image.

use std::collections::HashMap;

use nalgebra::Vector2;

use super::shade::Shade;
use crate::camera::{Configuration, Datasheet, InternalParameters};
use crate::error::{Error, Result};
use crate::observations::MicroImageCenter;
use crate::precalibration::{MicroImageArray, Precalibration};

/// Micro-images: where they are, and how points are blurred in them.
#[derive(Debug, Clone, PartialEq)]
pub struct MicroImages {
    /// The regular grid.
    pub grid: MicroImageArray,
    /// Behind or before the array.
    pub configuration: Configuration,
    centers: HashMap<(i32, i32), Vector2<f64>>,
    /// a: radius of the main lens's pupil seen through the middle of a micro-lens, px.
    pupil_px: f64,
    /// q'ᵢ, px.
    q_prime_px: Vec<f64>,
    /// What the pupil leaves of the micro-lenses, by type.
    shades: Vec<Shade>,
}

/// Discs of light and blur are smaller than this many pitches.
const MOST_PITCHES: f64 = 10.0;

impl MicroImages {
    /// From a pre-calibration, at the f-number N of the boards. Micro-images without a measured centre
    /// are where the grid puts them.
    pub fn new(
        grid: &MicroImageArray,
        centers: &[MicroImageCenter],
        internal: &InternalParameters,
        sheet: &Datasheet,
    ) -> Result<Self> {
        let pixel_size_mm = sheet.sensor.pixel_size_mm;
        let types = internal.q_prime_mm.len();
        if types == 0 {
            return Err(Error::invalid(
                "the pre-calibration has no lens types: it takes white images at several f-numbers",
            ));
        }
        let place = |c: &MicroImageCenter| ((c.k, c.l), Vector2::new(c.u_px, c.v_px));
        let pupil_px = internal.m_mm.abs() / sheet.f_number / pixel_size_mm;
        let sizes = internal.q_prime_mm.iter().map(|q| q / pixel_size_mm);
        for size in sizes.chain(std::iter::once(pupil_px)) {
            if size.is_nan() || size.abs() > MOST_PITCHES * grid.pitch_px {
                return Err(Error::invalid(format!(
                    "the internal parameters make discs of {size:.1} px in micro-images with a pitch of \
                     {:.1} px: they are of another camera, or not in mm",
                    grid.pitch_px
                )));
            }
        }
        let q_prime_px: Vec<f64> = internal.q_prime_mm.iter().map(|q| q / pixel_size_mm).collect();
        let shade = |q_prime: &f64| Shade::new(pupil_px, q_prime - grid.pitch_px / 2.0);
        Ok(Self {
            grid: *grid,
            configuration: sheet.configuration,
            centers: centers.iter().map(place).collect(),
            pupil_px,
            shades: q_prime_px.iter().map(shade).collect(),
            q_prime_px,
        })
    }

    /// Centre of a micro-image, px.
    #[must_use]
    pub fn center(&self, k: i32, l: i32) -> Vector2<f64> {
        self.centers.get(&(k, l)).copied().unwrap_or_else(|| self.grid.center_of(k, l))
    }

    /// As the white images of a camera have them.
    pub fn of_precalibration(measured: &Precalibration, sheet: &Datasheet) -> Result<Self> {
        Self::new(
            &measured.array.grid,
            &measured.array.centers,
            &measured.internal.parameters,
            sheet,
        )
    }

    /// Number of lens types.
    #[must_use]
    pub fn types(&self) -> usize {
        self.q_prime_px.len()
    }

    /// Lens type, from 0.
    #[must_use]
    pub fn lens_type(&self, k: i32, l: i32) -> usize {
        self.grid.lattice.lens_type(k, l, self.q_prime_px.len())
    }

    /// ρ of a point with slope γ, px: Eq. (radiusfinal) with 1/ν = 1 − γ/λ, in which λ drops out.
    #[must_use]
    pub fn blur_radius_px(&self, slope: f64, lens_type: usize) -> f64 {
        self.q_prime_px[lens_type] - slope * self.grid.pitch_px / 2.0
    }

    /// ρ by Eq. (radiusfinal) from 1/ν, with λ = 1 as the paper has it, px.
    #[must_use]
    pub fn blur_radius_of_depth_px(&self, inverse_virtual_depth: f64, lens_type: usize) -> f64 {
        let half_pitch = self.grid.pitch_px / 2.0;
        half_pitch * inverse_virtual_depth + self.q_prime_px[lens_type] - half_pitch
    }

    pub(super) fn shade(&self, lens_type: usize) -> &Shade {
        &self.shades[lens_type]
    }

    /// qᵢ, px: the blur radius of the pupil itself, which has the slope 1.
    #[must_use]
    pub fn q_px(&self, lens_type: usize) -> f64 {
        self.blur_radius_px(1.0, lens_type)
    }

    /// Outer radius a + |qᵢ| of a white micro-image, px.
    #[must_use]
    pub fn outer_radius_px(&self, lens_type: usize) -> f64 {
        self.pupil_px + self.q_px(lens_type).abs()
    }

    /// How far from the centre a point of blur radius ρ has light that comes through the pupil, px.
    #[must_use]
    pub fn lit_px(&self, rho_px: f64, lens_type: usize) -> f64 {
        let overlap = self.pupil_px + (rho_px - self.q_px(lens_type)).abs();
        overlap.min(self.grid.pitch_px / 2.0)
    }

    /// Micro-images whose centre is up to `reach` from a place, px.
    #[must_use]
    pub fn about(&self, place: &Vector2<f64>, reach: f64) -> Vec<(i32, i32)> {
        let lattice = &self.grid.lattice;
        let from_middle = (place - self.grid.center_px) / self.grid.pitch_px;
        let turn = nalgebra::Rotation2::new(-self.grid.rotation_rad);
        let at = turn * from_middle;
        let middle = lattice.node(0, 0);
        // Rows of a hexagonal lattice are closer than a pitch, and shifted by up to half a one.
        let wide = reach / self.grid.pitch_px / 0.86 + 1.5;
        #[allow(clippy::cast_possible_truncation)] // indices of a lattice
        let range = |at: f64, first: f64, spacing: f64, count: i32| {
            let index = (at - first) / spacing;
            ((index - wide).floor() as i32).max(0)..=((index + wide).ceil() as i32).min(count - 1)
        };
        let (along_u, along_v) = match lattice.kind {
            crate::lattice::LatticeKind::Orthogonal => (1.0, 1.0),
            crate::lattice::LatticeKind::HexagonalRows => (1.0, 0.75_f64.sqrt()),
            crate::lattice::LatticeKind::HexagonalColumns => (0.75_f64.sqrt(), 1.0),
        };
        let columns = range(at.x, middle.x, along_u, lattice.columns);
        let rows = range(at.y, middle.y, along_v, lattice.rows);
        rows.flat_map(|l| columns.clone().map(move |k| (k, l)))
            .filter(|&(k, l)| (self.center(k, l) - place).norm() <= reach)
            .collect()
    }
}
