//! Result of the pre-calibration.

use tracing::info;

use super::array::{ArrayMeasurement, LensTypes};
use super::checks::check_stated_pitch;
use super::internal::{InternalFit, RadiusMeasurement};
use crate::error::{Error, Result};
use crate::finding::Finding;
use crate::model::Datasheet;
use crate::quantity::{Estimate, counted};

/// Measurements of a camera from white images.
#[derive(Debug, Clone, PartialEq)]
pub struct Precalibration {
    /// Micro-image array, with its centres corrected for the shift of centroids by oblique light.
    pub array: ArrayMeasurement,
    /// Lens types.
    pub lens_types: LensTypes,
    /// Names of the white images that were measured.
    pub images: Vec<String>,
    /// Radii of these images, by lens type.
    pub radii: Vec<RadiusMeasurement>,
    /// The internal parameters.
    pub internal: InternalFit,
    /// Cell share of the openings, 0 for discs and 1 for cells of the lattice, if micro-images are small enough to show it.
    pub cell_share: Option<Estimate>,
    /// Relative change of the pitch by the correction of the centres.
    pub pitch_correction: f64,
    /// Findings for the user.
    pub findings: Vec<Finding>,
}

impl Precalibration {
    /// Returns the radii by lens type in one of the white images, px.
    ///
    /// # Panics
    /// If there were fewer white images.
    #[must_use]
    pub fn radii_px(&self, white: usize) -> Vec<f64> {
        let types = self.lens_types.types;
        self.radii[white * types..(white + 1) * types].iter().map(|r| r.radius_px).collect()
    }

    /// Logs the main figures.
    pub(super) fn log(&self) {
        let (grid, internal) = (&self.array.grid, &self.internal);
        info!(
            "{} centres, {:.3} px RMS about a grid of {} x {} with a pitch of {:.5} px; {}",
            self.array.centers.len(),
            grid.rms_px,
            grid.lattice.columns,
            grid.lattice.rows,
            grid.pitch_px,
            counted(self.lens_types.types, "lens type")
        );
        info!(
            "|m| = {:.6} mm, q' = {:.6?} mm; radii {:.4} px RMS about the lines",
            internal.parameters.m_mm, internal.parameters.q_prime_mm, internal.rms_px
        );
    }

    /// Returns an error that names both values if the images contradict the stated camera.
    pub fn check_stated(&self, sheet: &Datasheet) -> Result<()> {
        let grid = &self.array.grid;
        if grid.lattice.kind() != sheet.lattice_kind {
            return Err(Error::invalid(format!(
                "the micro-images lie on a '{}' lattice, but the camera is stated to have a '{}' \
                 lattice: correct it, or give the images of this camera",
                grid.lattice.kind().name(),
                sheet.lattice_kind.name()
            )));
        }
        check_stated_pitch(sheet, &self.internal.parameters, grid)?;
        let types = self.lens_types.types;
        // Pinholes cannot show lens types.
        if sheet.lens_types > 0 && types != sheet.lens_types {
            return Err(Error::invalid(format!(
                "the white images show {}, but the camera is stated to have {}: correct this, or take \
                 sharper white images",
                counted(types, "lens type"),
                sheet.lens_types
            )));
        }
        Ok(())
    }
}
