//! Input of a calibration: its start, what it estimates, and its cost.

use crate::error::{Error, Result};
use crate::model::{
    BoardShape, Datasheet, FramePose, InternalParameters, LatticeKind, MicroImageCenter,
    PlenopticCamera, SHAPE, Sensor, positive, shared_parameters,
};
use crate::solver::{BEYOND_THE_PAPER, CostOptions, SolverOptions, shape_names};
use serde::{Deserialize, Serialize};

/// What is estimated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Mode {
    /// Camera and poses from (u, v), the centres, and q'ᵢ or (in the paper) ρ.
    #[default]
    Full,
    /// Camera (an array of pinholes, I = 0) and poses from (u, v) and the centres: Noury et al.
    /// 2017.
    CornersOnly,
    /// The poses, with the camera fixed.
    PosesOnly,
}

/// What the board is taken for.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum BoardModel {
    /// Flat, unless the frames show that it is not.
    #[default]
    Auto,
    /// Flat: the paper.
    Flat,
    /// Bent and stretched, by what comes out.
    Bent,
    /// Of this shape.
    Known(BoardShape),
}

/// The weights of observations.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Weights {
    /// Each by its own σ, where the detection has measured it.
    #[default]
    Own,
    /// The same for all of a kind: the paper.
    Unit,
}

/// What a calibration starts from.
#[derive(Debug, Clone, PartialEq)]
pub enum Start {
    /// Datasheet and internal parameters: the paper's initialisation.
    Datasheet(Datasheet, InternalParameters),
    /// A calibrated camera.
    Camera(PlenopticCamera),
}

/// Names of the intrinsic parameters that are not estimated unless asked for.
pub const FIXED: [&str; 3] = ["e_x", "e_y", "dC_ratio"];

/// All options of a calibration.
#[derive(Debug, Clone, PartialEq)]
pub struct CalibrationOptions {
    /// What is estimated.
    pub mode: Mode,
    /// How observations are weighted.
    pub weights: Weights,
    /// The cost. Without ρ in it, the white images' q'ᵢ are in it, and with them the fᵢ. Its anchors are those that
    /// the user states. Its `anchor_weight` is not used: that
    /// of these options is, or a measured one ([`Calibration::cost`](crate::calibration::Calibration::cost)
    /// has it).
    pub cost: CostOptions,
    /// Whether to use a robust loss where the observations state their σ, whatever `cost` says: without
    /// σ a loss has no scale.
    pub automatic_loss: bool,
    /// Whether to anchor what datasheet, white images and sensor say.
    pub default_anchors: bool,
    /// Quantities without a default anchor.
    pub not_anchored: Vec<String>,
    /// What the board is taken for.
    pub board: BoardModel,
    /// e_z to begin with, or to keep if `cost` fixes it, mm; if not given, that of the start (0 of a datasheet).
    pub exit_pupil_mm: Option<f64>,
    /// κ to begin with, or to keep, mm⁻¹, likewise.
    pub field_curvature_per_mm: Option<f64>,
    /// κ_m to begin with, or to keep, mm⁻¹, likewise.
    pub field_curvature_growth_per_mm: Option<f64>,
    /// Its minimisation.
    pub solver: SolverOptions,
    /// w of the anchors; measured if not given.
    pub anchor_weight: Option<f64>,
    /// Poses of boards to begin with; those of other frames are found.
    pub poses: Vec<FramePose>,
    /// Frames that are not used.
    pub exclude_frames: Vec<u32>,
}

impl Default for CalibrationOptions {
    fn default() -> Self {
        Self {
            mode: Mode::default(),
            weights: Weights::default(),
            cost: CostOptions {
                rho: false,
                fixed: FIXED.map(str::to_owned).to_vec(),
                ..CostOptions::default()
            },
            automatic_loss: true,
            default_anchors: true,
            not_anchored: Vec::new(),
            board: BoardModel::Auto,
            exit_pupil_mm: None,
            field_curvature_per_mm: None,
            field_curvature_growth_per_mm: None,
            solver: SolverOptions::default(),
            anchor_weight: None,
            poses: Vec::new(),
            exclude_frames: Vec::new(),
        }
    }
}

impl Start {
    /// Kind of the array, its columns and rows; where they are not stated, those of its centres.
    pub(super) fn array(&self, centers: &[MicroImageCenter]) -> (LatticeKind, (i32, i32)) {
        match self {
            Self::Datasheet(sheet, _) => (sheet.lattice_kind, sheet.array_size_by(centers)),
            Self::Camera(camera) => {
                (camera.lattice.kind(), (camera.lattice.columns, camera.lattice.rows))
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

    /// The internal parameters; `None` for a calibrated camera.
    pub(super) fn internal(&self) -> Option<&InternalParameters> {
        match self {
            Self::Datasheet(_, internal) => Some(internal),
            Self::Camera(_) => None,
        }
    }

    /// The sensor.
    pub(super) fn sensor(&self) -> &Sensor {
        match self {
            Self::Datasheet(sheet, _) => &sheet.sensor,
            Self::Camera(camera) => &camera.sensor,
        }
    }

    /// This start, without lens types if the mode has none.
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

    /// An error that names the impossible value.
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
    /// The calibration of the paper: every observation has the same weight, no loss, no anchors, the exit
    /// pupil in the lens, a flat field, f from ρ, a flat board.
    #[must_use]
    pub fn paper() -> Self {
        Self {
            weights: Weights::Unit,
            automatic_loss: false,
            default_anchors: false,
            board: BoardModel::Flat,
            exit_pupil_mm: Some(0.0),
            field_curvature_per_mm: Some(0.0),
            field_curvature_growth_per_mm: Some(0.0),
            cost: CostOptions {
                fixed: BEYOND_THE_PAPER.map(str::to_owned).to_vec(),
                ..CostOptions::default()
            },
            ..Self::default()
        }
    }

    /// These options for poses of a board of this shape alone: without what they say of camera and board, which are
    /// then fixed.
    #[must_use]
    pub fn of_poses_only(&self, shape: BoardShape) -> Self {
        Self {
            mode: Mode::PosesOnly,
            board: BoardModel::Known(shape),
            exit_pupil_mm: None,
            field_curvature_per_mm: None,
            field_curvature_growth_per_mm: None,
            not_anchored: Vec::new(),
            cost: CostOptions { anchors: Vec::new(), ..self.cost.clone() },
            ..self.clone()
        }
    }

    /// These options with what a calibration has found of whether the board is flat, where they leave that open: bent in those
    /// parameters of its shape that have a σ, or flat.
    #[must_use]
    pub fn with_decision(&self, shape_std_devs: [Option<f64>; SHAPE]) -> Self {
        let mut decided = self.clone();
        if self.board != BoardModel::Auto {
            return decided;
        }
        let kept = shape_names().zip(shape_std_devs).filter(|(_, std_dev)| std_dev.is_none());
        let kept: Vec<String> = kept.map(|(name, _)| name.to_owned()).collect();
        decided.board = if kept.len() == SHAPE { BoardModel::Flat } else { BoardModel::Bent };
        if decided.board == BoardModel::Bent {
            let new = kept.into_iter().filter(|name| !self.cost.fixed.contains(name));
            decided.cost.fixed.extend(new);
        }
        decided
    }

    /// The shape of the board to begin with, or to keep.
    pub(super) fn known_shape(&self) -> BoardShape {
        match self.board {
            BoardModel::Known(shape) => shape,
            BoardModel::Auto | BoardModel::Flat | BoardModel::Bent => BoardShape::default(),
        }
    }

    /// Whether the board keeps a parameter of its shape.
    pub(super) fn keeps(&self, quantity: &str) -> bool {
        let known = matches!(self.board, BoardModel::Flat | BoardModel::Known(_));
        known && shape_names().any(|name| name == quantity)
    }

    /// An error that names an impossible option, or one that does not fit this start.
    pub(super) fn validate(&self, start: &Start) -> Result<()> {
        if self.mode == Mode::PosesOnly && matches!(start, Start::Datasheet(..)) {
            return Err(Error::NotCalibrated);
        }
        let stated =
            [self.exit_pupil_mm, self.field_curvature_per_mm, self.field_curvature_growth_per_mm];
        if self.mode == Mode::PosesOnly && stated.iter().any(Option::is_some) {
            return Err(Error::invalid(
                "the camera is fixed where only poses are estimated: leave out where its exit pupil is and \
                 whether its field is flat",
            ));
        }
        if self.mode == Mode::PosesOnly && self.board == BoardModel::Bent {
            return Err(Error::invalid(
                "the board is to be bent by what comes out, but the shape of a board is estimated together with a \
                 camera: give the shape that it had there",
            ));
        }
        let is_fixed = |name: &str| self.cost.fixed.iter().any(|fixed| fixed == name);
        if self.board == BoardModel::Bent && shape_names().all(is_fixed) {
            return Err(Error::invalid(format!(
                "the board is to be bent by what comes out, but {} are fixed: free one of them, or take the board to \
                 be flat",
                shape_names().collect::<Vec<_>>().join(", ")
            )));
        }
        positive(self.cost.uv_std_dev_px, "the standard deviation of (u, v) (px)")?;
        positive(self.cost.rho_std_dev_px, "the standard deviation of rho (px)")?;
        if self.mode == Mode::Full && !self.cost.rho && (self.cost.rho_std_dev_px - 1.0).abs() > 0.0
        {
            return Err(Error::invalid(
                "a standard deviation of rho is given, but rho does not count: let it count (blur = \
                 \"features\"), or leave the standard deviation out",
            ));
        }
        positive(self.cost.centers_std_dev_px, "the standard deviation of the centres (px)")?;
        positive(self.cost.loss.scale, "the scale of the loss")?;
        positive(self.anchor_weight.unwrap_or(1.0), "the weight of the anchors")?;
        if self.solver.max_iterations == 0 || self.solver.threads == 0 {
            return Err(Error::invalid("iterations and threads have to be at least 1"));
        }
        let known = shared_parameters(start.lens_types());
        for name in &self.cost.fixed {
            if !known.iter().any(|parameter| parameter.name == *name) {
                let names: Vec<&str> = known.iter().map(|p| p.name).collect();
                return Err(Error::invalid(format!(
                    "there is no parameter '{name}' to fix; this camera has {}",
                    names.join(", ")
                )));
            }
        }
        Ok(())
    }
}
