//! Options of the cost function and of its minimisation.

use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::bridge::ffi::{CostOptions, Loss, LossKind, SolverOptions};
use crate::model::SHAPE_PARAMETERS;

/// Names of the intrinsic parameters that the paper's camera does not have: curvature of the field, exit
/// pupil, a second pitch.
pub const BEYOND_THE_PAPER: [&str; 6] = ["kappa", "kappa_m", "e_x", "e_y", "e_z", "dC_ratio"];

/// Names of the parameters of a board's shape.
pub(crate) fn shape_names() -> impl Iterator<Item = &'static str> {
    SHAPE_PARAMETERS.iter().map(|parameter| parameter.name)
}

/// Names of the losses in files.
const LOSSES: [&str; 3] = ["none", "huber", "cauchy"];
const LOSS_KINDS: [LossKind; 3] = [LossKind::None, LossKind::Huber, LossKind::Cauchy];

impl Serialize for LossKind {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let at = LOSS_KINDS.iter().position(|kind| kind == self).unwrap_or(0);
        serializer.serialize_str(LOSSES[at])
    }
}

impl<'de> Deserialize<'de> for LossKind {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let name = String::deserialize(deserializer)?;
        let at = LOSSES.iter().position(|loss| *loss == name);
        at.map(|at| LOSS_KINDS[at]).ok_or_else(|| D::Error::unknown_variant(&name, &LOSSES))
    }
}

impl Default for CostOptions {
    /// The paper's cost: 1 px each, no loss, no anchors, a known board, and only the paper's parameters free.
    fn default() -> Self {
        Self {
            uv_std_dev_px: 1.0,
            rho_std_dev_px: 1.0,
            centers_std_dev_px: 1.0,
            rho: true,
            loss: Loss { kind: LossKind::None, scale: 1.0 },
            fixed: BEYOND_THE_PAPER.into_iter().chain(shape_names()).map(str::to_owned).collect(),
            anchors: Vec::new(),
            anchor_weight: 1.0,
        }
    }
}

impl Default for SolverOptions {
    fn default() -> Self {
        let threads = std::thread::available_parallelism().map_or(1, usize::from);
        Self {
            max_iterations: 200,
            threads,
            function_tolerance: 1e-13,
            initial_trust_region_radius: 1e10,
            extrapolate: true,
        }
    }
}
