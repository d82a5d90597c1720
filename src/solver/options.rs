//! Options of the cost function and of its minimisation.

use clap::ValueEnum;
use clap::builder::PossibleValue;
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::bridge::ffi::{CostOptions, Loss, LossKind, SolverOptions};
use crate::model::Parameter;

impl LossKind {
    /// Returns its name in files and options.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Huber => "huber",
            Self::Cauchy => "cauchy",
            _ => "none",
        }
    }
}

// These implementations are written out because a type of the bridge cannot derive them.
impl ValueEnum for LossKind {
    fn value_variants<'a>() -> &'a [Self] {
        &[Self::None, Self::Huber, Self::Cauchy]
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        let help = match *self {
            Self::Huber => "Linear beyond the scale",
            Self::Cauchy => "Logarithmic beyond the scale",
            _ => "Least squares (the paper)",
        };
        Some(PossibleValue::new(self.name()).help(help))
    }
}

impl Serialize for LossKind {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
    }
}

impl<'de> Deserialize<'de> for LossKind {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let name = String::deserialize(deserializer)?;
        Self::from_str(&name, false).map_err(|_| {
            D::Error::custom(format!("'{name}' is not a loss: write none, huber or cauchy"))
        })
    }
}

/// Returns the names of parameters in the core.
pub(crate) fn names(parameters: &[Parameter]) -> Vec<String> {
    parameters.iter().map(ToString::to_string).collect()
}

impl Default for CostOptions {
    /// Returns the options of the paper: 1 px each, no loss, no priors, a known board, and only the paper's parameters free.
    fn default() -> Self {
        Self {
            uv_std_dev_px: 1.0,
            rho_std_dev_px: 1.0,
            centers_std_dev_px: 1.0,
            rho: true,
            loss: Loss { kind: LossKind::None, scale: 1.0 },
            fixed: names(&[&Parameter::BEYOND_THE_PAPER[..], &Parameter::SHAPE].concat()),
            priors: Vec::new(),
            prior_weight: 1.0,
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
