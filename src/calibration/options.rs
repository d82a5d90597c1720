//! What a calibration is told: where it starts, what it estimates, and at which cost.

use crate::camera::{
    Datasheet, InternalParameters, PlenopticCamera, Sensor, intrinsic_parameters, positive,
};
use crate::error::{Error, Result};
use crate::lattice::LatticeKind;

/// Robust loss on the norm of an observation's standardised residual.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Loss {
    /// Least squares, the paper.
    None,
    /// Linear beyond `scale` standard deviations.
    Huber {
        /// In standard deviations.
        scale: f64,
    },
    /// Logarithmic beyond `scale` standard deviations.
    Cauchy {
        /// In standard deviations.
        scale: f64,
    },
}

/// The cost: ½ Σ loss(|r/σ|²).
#[derive(Debug, Clone, PartialEq)]
pub struct CostOptions {
    /// σ of u and v of a feature, px.
    pub uv_std_dev_px: f64,
    /// σ of ρ, px.
    pub rho_std_dev_px: f64,
    /// σ of u and v of a micro-image centre, px.
    pub centers_std_dev_px: f64,
    /// Loss on features and on centres.
    pub loss: Loss,
    /// Names of the intrinsic parameters that keep their value.
    pub held: Vec<String>,
}

impl Default for CostOptions {
    /// The paper's cost: 1 px each, no loss, one pitch.
    fn default() -> Self {
        Self {
            uv_std_dev_px: 1.0,
            rho_std_dev_px: 1.0,
            centers_std_dev_px: 1.0,
            loss: Loss::None,
            held: vec!["dC_ratio".to_owned()],
        }
    }
}

/// How to minimise the cost.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SolverOptions {
    /// Limit of Levenberg-Marquardt iterations.
    pub max_iterations: usize,
    /// Threads of the solver.
    pub threads: usize,
    /// Go to the extrapolated limit of the steps where they become slow; false leaves all to Ceres.
    pub extrapolate: bool,
    /// Initial trust-region radius; large, since the first steps are nearly Gauss-Newton's.
    pub initial_trust_region_radius: f64,
}

impl Default for SolverOptions {
    fn default() -> Self {
        let threads = std::thread::available_parallelism().map_or(1, usize::from);
        Self { max_iterations: 200, threads, initial_trust_region_radius: 1e10, extrapolate: true }
    }
}

/// What is estimated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Mode {
    /// Camera and poses from (u, v, ρ) and the centres: the paper.
    #[default]
    Full,
    /// Camera (an array of pinholes, I = 0) and poses from (u, v) and the centres: Noury et al.
    /// 2017.
    CornersOnly,
    /// The poses, with the camera held.
    PosesOnly,
}

/// What the calibration starts from.
#[derive(Debug, Clone, PartialEq)]
pub enum Start {
    /// Datasheet and internal parameters: the paper's initialisation.
    Datasheet(Datasheet, InternalParameters),
    /// A camera calibrated before.
    Camera(PlenopticCamera),
}

/// All options of a calibration.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct CalibrationOptions {
    /// What is estimated.
    pub mode: Mode,
    /// The cost.
    pub cost: CostOptions,
    /// Its minimisation.
    pub solver: SolverOptions,
    /// Frames that are not used.
    pub exclude_frames: Vec<u32>,
}

impl Start {
    /// Kind, columns and rows of the array.
    pub(super) fn array(&self) -> (LatticeKind, i32, i32) {
        match self {
            Self::Datasheet(sheet, _) => (sheet.lattice_kind, sheet.columns, sheet.rows),
            Self::Camera(camera) => {
                (camera.lattice.kind, camera.lattice.columns, camera.lattice.rows)
            }
        }
    }

    /// Number I of lens types.
    #[must_use]
    pub fn lens_types(&self) -> usize {
        match self {
            Self::Datasheet(sheet, _) => sheet.lens_types,
            Self::Camera(camera) => camera.lens_types(),
        }
    }

    /// The sensor.
    pub(super) fn sensor(&self) -> &Sensor {
        match self {
            Self::Datasheet(sheet, _) => &sheet.sensor,
            Self::Camera(camera) => &camera.sensor,
        }
    }

    /// The same start without lens types where the mode does not want them.
    pub(super) fn for_mode(&self, mode: Mode) -> Self {
        let mut start = self.clone();
        if mode == Mode::CornersOnly {
            match &mut start {
                Self::Datasheet(sheet, _) => sheet.lens_types = 0,
                Self::Camera(camera) => camera.mla.focal_lengths_mm.clear(),
            }
        }
        start
    }

    /// An error naming the value that cannot be.
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

impl CalibrationOptions {
    /// An error naming the option that cannot be with this start.
    pub(super) fn validate(&self, start: &Start) -> Result<()> {
        if self.mode == Mode::PosesOnly && matches!(start, Start::Datasheet(..)) {
            return Err(Error::invalid(
                "poses alone need a calibrated camera: give its camera.json or intrinsics.js \
                 (--camera) instead of a datasheet",
            ));
        }
        positive(self.cost.uv_std_dev_px, "the standard deviation of (u, v) (px)")?;
        positive(self.cost.rho_std_dev_px, "the standard deviation of rho (px)")?;
        positive(self.cost.centers_std_dev_px, "the standard deviation of the centres (px)")?;
        if let Loss::Huber { scale } | Loss::Cauchy { scale } = self.cost.loss {
            positive(scale, "the scale of the loss")?;
        }
        if self.solver.max_iterations == 0 || self.solver.threads == 0 {
            return Err(Error::invalid("iterations and threads have to be at least 1"));
        }
        let known = intrinsic_parameters(start.lens_types());
        for name in &self.cost.held {
            if !known.iter().any(|parameter| parameter.name == *name) {
                let names: Vec<String> = known.into_iter().map(|p| p.name).collect();
                return Err(Error::invalid(format!(
                    "there is no parameter '{name}' to hold; this camera has {}",
                    names.join(", ")
                )));
            }
        }
        Ok(())
    }
}
