//! Standard deviations, correlations and weakest directions.

use nalgebra::DMatrix;

use crate::model::{Parameter, intrinsic_parameters};

/// Number of parameters of a pose.
const POSE_PARAMETERS: usize = 6;
/// Index of the translation along z in a pose (rotation first).
const POSE_Z: usize = 5;

/// How well the observations determine the parameters.
///
/// The parameters are the free intrinsic parameters, then six for every pose (angle-axis rotation
/// in rad, translation in mm). The covariance is scaled by the measured variance of each kind of
/// residual, so it is valid whether or not the weights of the cost match the noise. It assumes that
/// the errors of different observations are independent.
#[derive(Debug, Clone, PartialEq)]
pub struct Uncertainty {
    /// Indices of the free parameters into `PlenopticCamera::intrinsics`.
    pub free_intrinsics: Vec<usize>,
    /// Number of independent directions of parameter space that the observations determine.
    pub rank: usize,
    /// Covariance of all parameters, in their units.
    pub covariance: DMatrix<f64>,
    /// Diagonal of the information matrix J'J.
    pub information: Vec<f64>,
    /// The directions of parameter space with the least information in proportion to that on each
    /// parameter alone; the weakest first. Each is the change of all parameters along one standard
    /// deviation, or, if the observations do not determine it at all (the first size − rank), along
    /// the unit of the scaled space.
    pub weakest: Vec<Vec<f64>>,
    /// Whether each parameter is determined at all; if not, its variance is meaningless.
    pub determined: Vec<bool>,
    /// Measured standard deviation of a residual, px: u and v of features, ρ, u and v of centres;
    /// not a number for a kind without observations. If observations have their own σ, it is the value
    /// for the root mean square of these. With a robust loss it is that of the weighted residuals,
    /// smaller than the noise.
    pub residual_std_dev_px: [f64; 3],
    /// How much a further Gauss-Newton step would lower the cost; almost 0 at a true minimum.
    pub expected_decrease: f64,
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
        let mut std_devs = vec![None; intrinsic_parameters(lens_types).len()];
        for (row, &index) in self.free_intrinsics.iter().enumerate() {
            std_devs[index] = Some(self.std_dev(row));
        }
        std_devs
    }

    /// Indices into `PlenopticCamera::intrinsics` of the free parameters that are not determined.
    #[must_use]
    pub fn undetermined_intrinsics(&self) -> Vec<usize> {
        let of_row = |(&index, &known): (&usize, &bool)| (!known).then_some(index);
        self.free_intrinsics.iter().zip(&self.determined).filter_map(of_row).collect()
    }

    /// Standard deviations of the parameters of a pose: rotation vector (rad), translation (mm);
    /// infinite if not determined.
    #[must_use]
    pub fn pose_std_devs(&self, pose: usize) -> [f64; POSE_PARAMETERS] {
        let first = self.free_intrinsics.len() + POSE_PARAMETERS * pose;
        std::array::from_fn(|i| self.std_dev(first + i))
    }

    fn std_dev(&self, row: usize) -> f64 {
        if self.determined[row] { self.covariance[(row, row)].sqrt() } else { f64::INFINITY }
    }

    /// Correlation matrix of the free intrinsic parameters; 0 where one is not determined.
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
        let parameters = intrinsic_parameters(lens_types);
        let describe = |(i, direction): (usize, &Vec<f64>)| {
            self.describe(direction, i >= undetermined, parameters)
        };
        let mut directions: Vec<WeakDirection> =
            self.weakest.iter().enumerate().map(describe).collect();
        directions.retain(|direction| !direction.components.is_empty());
        directions
    }

    fn describe(
        &self,
        direction: &[f64],
        determined: bool,
        parameters: &[Parameter],
    ) -> WeakDirection {
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
