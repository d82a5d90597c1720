//! Options of the cost function and of its minimisation.

use clap::ValueEnum;
use serde::{Deserialize, Serialize};

use crate::model::SHAPE_PARAMETERS;

/// Names of the intrinsic parameters that the paper's camera does not have: curvature of the field, exit
/// pupil, a second pitch.
pub const BEYOND_THE_PAPER: [&str; 6] = ["kappa", "kappa_m", "e_x", "e_y", "e_z", "dC_ratio"];

/// Names of the parameters of a board's shape.
pub(crate) fn shape_names() -> impl Iterator<Item = &'static str> {
    SHAPE_PARAMETERS.iter().map(|parameter| parameter.name)
}

/// Shape of the loss on the norm of an observation's standardised residual.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum LossKind {
    /// Least squares (the paper).
    None,
    /// Linear beyond the scale.
    Huber,
    /// Logarithmic beyond the scale.
    Cauchy,
}

/// Robust loss.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Loss {
    /// Its shape.
    pub kind: LossKind,
    /// Residual norm at which it sets in, in standard deviations; no effect with [`LossKind::None`].
    pub scale: f64,
}

/// What is known of a camera beforehand: one more residual in the cost, (quantity − value)/σ.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Anchor {
    /// Name of a parameter of the camera or of the board's shape, or `m` for |m| = dpF/2(D + e_z) (mm).
    pub quantity: String,
    /// Its value, in the unit of the parameter.
    pub value: f64,
    /// σ of the value, likewise.
    pub std_dev: f64,
}

/// The cost: ½ Σ loss(|r/σ|²) + w/2 Σ (anchor residual)². The σ of an observation's residual is its own
/// (1 px unless given) times the factor given here for its kind.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CostOptions {
    /// Factor on σ of u and v of a feature; σ in px if the feature has none of its own.
    pub uv_std_dev_px: f64,
    /// Factor on σ of ρ, likewise.
    pub rho_std_dev_px: f64,
    /// Factor on σ of u and v of a micro-image centre, likewise.
    pub centers_std_dev_px: f64,
    /// Whether the ρ of features counts, as in the paper. It is made of q'ᵢ and of the same u and v: with anchors
    /// on the q'ᵢ, which determine the fᵢ, it says nothing more.
    pub rho: bool,
    /// Loss on features and on centres.
    pub loss: Loss,
    /// Names of the parameters of camera and board that keep their value.
    pub fixed: Vec<String>,
    /// What is known beforehand, each of another quantity.
    pub anchors: Vec<Anchor>,
    /// w: how many times larger the variance of what the observations say is than their σ claims. It
    /// keeps observations and anchors in proportion.
    pub anchor_weight: f64,
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

/// Options of the minimisation.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SolverOptions {
    /// Largest number of Levenberg-Marquardt iterations.
    pub max_iterations: usize,
    /// Threads of the solver.
    pub threads: usize,
    /// The solve ends with a step that lowers the cost by less than this part.
    pub function_tolerance: f64,
    /// Whether to jump to the extrapolated limit of the steps when they converge slowly; if false, Ceres
    /// does all the work.
    pub extrapolate: bool,
    /// Initial trust-region radius; large, so that the first steps are nearly Gauss-Newton steps.
    pub initial_trust_region_radius: f64,
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
