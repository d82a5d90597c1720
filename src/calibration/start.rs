//! Start of a calibration: a datasheet with white images, or a calibrated camera.

use crate::error::Result;
use crate::model::{
    Datasheet, InternalParameters, LatticeKind, MicroImageCenter, PlenopticCamera, Sensor,
};

/// Start of a calibration.
#[derive(Debug, Clone, PartialEq)]
pub enum Start {
    /// Datasheet and internal parameters: the paper's initialisation.
    Datasheet(Datasheet, InternalParameters),
    /// A calibrated camera.
    Camera(PlenopticCamera),
}

impl Start {
    /// Returns the kind of the array, and its columns and rows. If these are not stated, they follow from the centres.
    pub(super) fn array(&self, centers: &[MicroImageCenter]) -> (LatticeKind, (i32, i32)) {
        match self {
            Self::Datasheet(sheet, _) => (sheet.lattice_kind, sheet.array_size_by(centers)),
            Self::Camera(camera) => {
                (camera.lattice.kind(), (camera.lattice.columns, camera.lattice.rows))
            }
        }
    }

    /// Returns the number I of lens types.
    #[must_use]
    pub fn lens_types(&self) -> usize {
        match self {
            Self::Datasheet(sheet, _) => sheet.lens_types,
            Self::Camera(camera) => camera.lens_types(),
        }
    }

    /// Returns the internal parameters; `None` for a calibrated camera.
    pub(super) fn internal(&self) -> Option<&InternalParameters> {
        match self {
            Self::Datasheet(_, internal) => Some(internal),
            Self::Camera(_) => None,
        }
    }

    /// Returns the sensor.
    pub(super) fn sensor(&self) -> &Sensor {
        match self {
            Self::Datasheet(sheet, _) => &sheet.sensor,
            Self::Camera(camera) => &camera.sensor,
        }
    }

    /// Returns the start without lens types: with an array of pinholes.
    pub(super) fn of_pinholes(&self) -> Self {
        let mut start = self.clone();
        match &mut start {
            Self::Datasheet(sheet, _) => sheet.lens_types = 0,
            Self::Camera(camera) => camera.mla.focal_lengths_mm.clear(),
        }
        start
    }

    /// Returns an error that names the impossible value.
    pub(super) fn validate(&self) -> Result<()> {
        match self {
            Self::Datasheet(sheet, internal) => {
                sheet.validate()?;
                internal.validate(sheet.lens_types)
            }
            Self::Camera(camera) => camera.validate(),
        }
    }
}
