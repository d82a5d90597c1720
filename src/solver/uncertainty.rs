//! Standard deviations, correlations and weakest directions.

use nalgebra::DMatrix;

use crate::model::{Named, SHAPE, intrinsic_parameters, shared_parameters};

/// Number of parameters of a pose.
const POSE_PARAMETERS: usize = 6;
/// Index of the translation along z in a pose (rotation first).
const POSE_Z: usize = 5;

/// How well observations and anchors determine the parameters.
///
/// The parameters are those of the camera and of the board's shape that are free, which are called intrinsic here,
/// then six for every pose (angle-axis rotation
/// in rad, translation in mm). There are two covariances. That of independent errors takes every
/// observation for itself, with the measured variance of its kind. That of shared errors lets all
/// residuals of a frame, and those of neighbouring centres, have errors in common; it comes from how
/// much frames contradict each other. Both are valid whether or not the weights match the noise, and
/// both contain anchors and what all features of a lens type share. Equations: `Uncertainty` in
/// `plenocal/refine.hpp`.
#[derive(Debug, Clone, PartialEq)]
pub struct Uncertainty {
    /// Indices of the free parameters into [`shared_parameters`]: of the camera, then of the board's shape.
    pub free_intrinsics: Vec<usize>,
    /// Number of independent directions of parameter space that are determined.
    pub rank: usize,
    /// Whether `covariance` is that of shared errors: from six frames on, or if only poses are
    /// estimated.
    pub shared: bool,
    /// Covariance of all parameters, in their units: the one to trust.
    pub covariance: DMatrix<f64>,
    /// Covariance if errors of all observations are independent.
    pub independent_covariance: DMatrix<f64>,
    /// If errors are shared: degrees of freedom of the variance of each free intrinsic parameter.
    pub freedom: Vec<f64>,
    /// By how much the free intrinsic parameters would change if a frame were left out, to first order:
    /// a row for each frame; not a number where they would not all be determined any more.
    pub left_out_changes: DMatrix<f64>,
    /// The share of each frame (a row) in what the weights claim the variance of the free intrinsic
    /// parameters to be, 0 to 1.
    pub frame_shares: DMatrix<f64>,
    /// What each common error changes: its source, and the change of each free intrinsic parameter.
    pub common_changes: Vec<(String, Vec<f64>)>,
    /// How the poses follow the free intrinsic parameters: six rows for each.
    pub poses_by_intrinsics: DMatrix<f64>,
    /// How many times larger the variance of the anchored quantities is than the weights claim, as far as
    /// the observations cause it; 1 without anchors.
    pub dispersion: f64,
    /// The intrinsic parameter (its index) on which boards and micro-image centres contradict each other
    /// most, and by how many σ; `None` if they agree within 3 σ. No covariance contains it.
    pub contradiction: Option<(usize, f64)>,
    /// Diagonal of the information matrix J'J.
    pub information: Vec<f64>,
    /// The directions of parameter space with the least information in proportion to that on each
    /// parameter alone; the weakest first. Each is the change of all parameters along one standard
    /// deviation, or, if the observations do not determine it at all (the first size − rank), along
    /// the unit of the scaled space.
    pub weakest: Vec<Vec<f64>>,
    /// Whether each parameter is determined at all; if not, its variance is meaningless.
    pub determined: Vec<bool>,
    /// Measured standard deviation of a residual, px: u and v of features, ρ, u and v of centres; root of
    /// the sum of squares over their redundancy, not a number for a kind without observations. With a
    /// robust loss it is that of the weighted residuals, smaller than the noise.
    pub residual_std_dev_px: [f64; 3],
    /// By how much the errors of each kind are larger than their σ in the cost says; 1 if it is right.
    pub std_dev_factors: [f64; 3],
    /// How much a further Gauss-Newton step would lower the cost; almost 0 at a true minimum.
    pub expected_decrease: f64,
    /// That step: the change of each parameter.
    pub next_step: Vec<f64>,
    /// The gradient of the cost by each parameter.
    pub gradient: Vec<f64>,
}

/// An error that observations have in common: one standard deviation of it.
#[derive(Debug, Clone, PartialEq)]
pub struct CommonError {
    /// Of what.
    pub source: String,
    /// By how much it moves u, v and ρ of each feature, px.
    pub features_px: Vec<[f64; 3]>,
    /// By how much it moves u and v of each centre, px; empty for none.
    pub centers_px: Vec<[f64; 2]>,
    /// By how much it moves the value of each anchor, in its σ; empty for none.
    pub anchors: Vec<f64>,
    /// Whether the σ of the anchors contains it already.
    pub in_anchors: bool,
}

/// A parameter's component of a weak direction.
#[derive(Debug, Clone, PartialEq)]
pub struct Component {
    /// Name of the parameter.
    pub name: String,
    /// Its change along the direction, in its unit.
    pub change: f64,
    /// Its unit.
    pub unit: &'static str,
    /// The share of its variance that the direction explains, or, if the direction is not determined,
    /// the parameter's share of the direction's length; 0 to 1.
    pub share: f64,
}

/// A direction of parameter space that the observations determine weakly.
#[derive(Debug, Clone, PartialEq)]
pub struct WeakDirection {
    /// Whether the observations determine it at all. If not, its changes have no relation to standard
    /// deviations.
    pub determined: bool,
    /// Intrinsic parameters that it moves most, the largest share first.
    pub components: Vec<Component>,
    /// Mean change of the board distance along it, mm.
    pub board_distance_mm: f64,
    /// The largest share of the variance of any board distance that it explains, 0 to 1.
    pub board_distance_share: f64,
}

/// A parameter is named if the direction explains at least this share of its variance.
const NAMED_SHARE: f64 = 0.5;
/// In a direction that is not determined, a parameter is named if it has at least this share of the
/// length.
const NAMED_SHARE_UNDETERMINED: f64 = 0.01;

impl Uncertainty {
    /// Number of parameters.
    #[must_use]
    pub fn size(&self) -> usize {
        self.covariance.nrows()
    }

    /// Standard deviation of each intrinsic parameter in the order of
    /// `PlenopticCamera::intrinsics`; `None` for those fixed, infinite for those not determined.
    #[must_use]
    pub fn intrinsic_std_devs(&self, lens_types: usize) -> Vec<Option<f64>> {
        self.by_intrinsic(lens_types, |row| self.std_dev(row))
    }

    /// Indices into [`shared_parameters`] of the free parameters that are not determined.
    #[must_use]
    pub fn undetermined_intrinsics(&self) -> Vec<usize> {
        let of_row = |(&index, &known): (&usize, &bool)| (!known).then_some(index);
        self.free_intrinsics.iter().zip(&self.determined).filter_map(of_row).collect()
    }

    /// Of each parameter of camera and board its standard deviation, that if errors are taken as independent, and by what
    /// fraction of itself the first is uncertain, if it is known; `None` for fixed parameters.
    #[must_use]
    pub fn shared_std_devs(&self, lens_types: usize) -> Vec<Option<(f64, f64, Option<f64>)>> {
        let of_row = |row: usize| {
            let independent = self.std_dev_in(&self.independent_covariance, row);
            let relative = self.freedom.get(row).map(|freedom| (0.5 / freedom).sqrt());
            (self.std_dev(row), independent, relative)
        };
        self.by_shared(lens_types, of_row)
    }

    /// Standard deviation of each parameter of the board's shape; likewise.
    #[must_use]
    pub fn shape_std_devs(&self, lens_types: usize) -> [Option<f64>; SHAPE] {
        let all = self.by_shared(lens_types, |row| self.std_dev(row));
        std::array::from_fn(|i| all[all.len() - SHAPE + i])
    }

    /// Row of each parameter of the board's shape among the free ones; `None` for those fixed.
    pub(crate) fn shape_rows(&self, lens_types: usize) -> [Option<usize>; SHAPE] {
        let all = self.by_shared(lens_types, |row| row);
        std::array::from_fn(|i| all[all.len() - SHAPE + i])
    }

    /// Standard deviations of the parameters of a pose: rotation vector (rad), translation (mm);
    /// infinite if not determined.
    #[must_use]
    pub fn pose_std_devs(&self, pose: usize) -> [f64; POSE_PARAMETERS] {
        let first = self.free_intrinsics.len() + POSE_PARAMETERS * pose;
        std::array::from_fn(|i| self.std_dev(first + i))
    }

    fn std_dev(&self, row: usize) -> f64 {
        self.std_dev_in(&self.covariance, row)
    }

    fn std_dev_in(&self, covariance: &DMatrix<f64>, row: usize) -> f64 {
        if self.determined[row] { covariance[(row, row)].sqrt() } else { f64::INFINITY }
    }

    /// What [`Uncertainty::intrinsic_std_devs`] would be if all errors were independent.
    #[must_use]
    pub fn independent_std_devs(&self, lens_types: usize) -> Vec<Option<f64>> {
        self.by_intrinsic(lens_types, |row| self.std_dev_in(&self.independent_covariance, row))
    }

    /// By what fraction of itself each standard deviation is uncertain, √(1/2ν) with ν degrees of
    /// freedom; `None` for fixed parameters, and if errors are taken as independent.
    #[must_use]
    pub fn std_dev_uncertainties(&self, lens_types: usize) -> Vec<Option<f64>> {
        let of_row = |row: usize| self.freedom.get(row).map(|freedom| (0.5 / freedom).sqrt());
        self.by_intrinsic(lens_types, of_row).into_iter().map(Option::flatten).collect()
    }

    /// The standard deviations that the jackknife over frames gives, √((n − 1)/n Σ(θᵢ − θ̄)²), with the
    /// changes θᵢ to first order instead of n calibrations; `None` for fixed parameters.
    #[must_use]
    pub fn jackknife_std_devs(&self, lens_types: usize) -> Vec<Option<f64>> {
        let frames = self.left_out_changes.nrows() as f64;
        let variance = |row: usize| self.left_out_changes.column(row).variance();
        self.by_intrinsic(lens_types, |row| ((frames - 1.0) * variance(row)).sqrt())
    }

    /// A value for each intrinsic parameter, from the row of the free ones.
    fn by_intrinsic<T: Clone>(
        &self,
        lens_types: usize,
        of_row: impl Fn(usize) -> T,
    ) -> Vec<Option<T>> {
        let mut values = self.by_shared(lens_types, of_row);
        values.truncate(intrinsic_parameters(lens_types).len());
        values
    }

    /// A value for each parameter of camera and board, from the row of the free ones.
    fn by_shared<T: Clone>(
        &self,
        lens_types: usize,
        of_row: impl Fn(usize) -> T,
    ) -> Vec<Option<T>> {
        let mut values = vec![None; shared_parameters(lens_types).len()];
        for (row, &index) in self.free_intrinsics.iter().enumerate() {
            values[index] = Some(of_row(row));
        }
        values
    }

    /// Correlation matrix of the free parameters of camera and board; 0 where one is not determined.
    #[must_use]
    pub fn intrinsic_correlations(&self) -> DMatrix<f64> {
        let n = self.free_intrinsics.len();
        DMatrix::from_fn(n, n, |i, j| {
            let scale = (self.covariance[(i, i)] * self.covariance[(j, j)]).sqrt();
            match (i == j, scale > 0.0) {
                (true, _) => 1.0,
                (false, true) => self.covariance[(i, j)] / scale,
                (false, false) => 0.0,
            }
        })
    }

    /// The weakest directions that move intrinsic parameters, the weakest first.
    #[must_use]
    pub fn weakest_directions(&self, lens_types: usize) -> Vec<WeakDirection> {
        let undetermined = self.size() - self.rank;
        let parameters = shared_parameters(lens_types);
        let describe = |(i, direction): (usize, &Vec<f64>)| {
            self.describe(direction, i >= undetermined, &parameters)
        };
        let mut directions: Vec<WeakDirection> =
            self.weakest.iter().enumerate().map(describe).collect();
        directions.retain(|direction| !direction.components.is_empty());
        directions
    }

    fn describe(&self, direction: &[f64], determined: bool, parameters: &[Named]) -> WeakDirection {
        let share = |row: usize| {
            let square = direction[row].powi(2);
            if determined {
                (square / self.covariance[(row, row)].max(f64::MIN_POSITIVE)).min(1.0)
            } else {
                // Without any information, the unit of the scaled space is that of the parameter.
                let information = self.information[row];
                square * if information > 0.0 { information } else { 1.0 }
            }
        };
        let least = if determined { NAMED_SHARE } else { NAMED_SHARE_UNDETERMINED };
        let mut components: Vec<Component> = self
            .free_intrinsics
            .iter()
            .enumerate()
            .map(|(row, &index)| Component {
                name: parameters[index].name.to_owned(),
                change: direction[row],
                unit: parameters[index].unit,
                share: share(row),
            })
            .zip(&self.determined)
            // The variance of a parameter that is not determined is meaningless.
            .filter(|(component, known)| **known == determined && component.share >= least)
            .map(|(component, _)| component)
            .collect();
        components.sort_by(|a, b| b.share.total_cmp(&a.share));
        // The sign of a direction is arbitrary: choose it so that the first parameter named grows.
        let sign = components.first().map_or(1.0, |first| first.change.signum());
        for component in &mut components {
            component.change *= sign;
        }
        let first = self.free_intrinsics.len() + POSE_Z;
        let distances: Vec<usize> = (first..self.size()).step_by(POSE_PARAMETERS).collect();
        let sum: f64 = distances.iter().map(|&row| sign * direction[row]).sum();
        WeakDirection {
            determined,
            components,
            board_distance_mm: sum / distances.len().max(1) as f64,
            board_distance_share: distances.into_iter().map(share).fold(0.0, f64::max),
        }
    }
}
