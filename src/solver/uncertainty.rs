//! Standard deviations, correlations and weakest directions.

use nalgebra::DMatrix;

use super::bridge::ffi::{self, CostOptions, Matrix, SystematicError, Uncertainty};
use super::problem::Problem;
use crate::error::Result;
use crate::model::{Parameter, SHAPE};

/// Number of parameters of a pose.
const POSE_PARAMETERS: usize = 6;
/// Index of the translation along z in a pose (rotation first).
const POSE_Z: usize = 5;

/// Component of a weak direction along a parameter.
#[derive(Debug, Clone, PartialEq)]
pub struct Component {
    /// Name of the parameter.
    pub name: String,
    /// Change along the direction, in the unit of the parameter.
    pub change: f64,
    /// Unit of the parameter.
    pub unit: &'static str,
    /// Share of the variance of the parameter that the direction explains or, if the direction is not determined, share of the
    /// parameter in the length of the direction; 0 to 1.
    pub share: f64,
}

/// Direction of parameter space that the observations determine weakly.
#[derive(Debug, Clone, PartialEq)]
pub struct WeakDirection {
    /// True if the observations determine it at all. Otherwise its changes have no relation to standard deviations.
    pub determined: bool,
    /// Intrinsic parameters that change most along it, the largest share first.
    pub components: Vec<Component>,
    /// Mean change of the board distance along it, mm.
    pub board_distance_mm: f64,
    /// Largest share of the variance of any board distance that it explains, 0 to 1.
    pub board_distance_share: f64,
}

/// Least explained share of the variance of a parameter for which it is named.
const NAMED_SHARE: f64 = 0.5;
/// Least share of a parameter in the length of a direction that is not determined, for which it is named.
const NAMED_SHARE_UNDETERMINED: f64 = 0.01;

impl Uncertainty {
    /// Returns the number of parameters.
    #[must_use]
    pub fn size(&self) -> usize {
        self.covariance.rows
    }

    /// Returns the index of the intrinsic parameter on which boards and micro-image centres contradict each other most, and the
    /// contradiction in σ; `None` if they agree within 3 σ. No covariance contains it.
    #[must_use]
    pub fn contradiction(&self) -> Option<(usize, f64)> {
        let row = usize::try_from(self.contradicted_row).ok()?;
        Some((self.free_intrinsics[row], self.contradiction_std_devs))
    }

    /// Returns the standard deviation of each intrinsic parameter in the order of `PlenopticCamera::intrinsics`; `None` for
    /// fixed ones, infinite for undetermined ones.
    #[must_use]
    pub fn intrinsic_std_devs(&self, lens_types: usize) -> Vec<Option<f64>> {
        self.by_intrinsic(lens_types, |row| self.std_dev(row))
    }

    /// Returns the indices into [`Parameter::shared`] of the free parameters that are not determined.
    #[must_use]
    pub fn undetermined_intrinsics(&self) -> Vec<usize> {
        let of_row = |(&index, &known): (&usize, &bool)| (!known).then_some(index);
        self.free_intrinsics.iter().zip(&self.determined).filter_map(of_row).collect()
    }

    /// Returns for each parameter of camera and board its standard deviation, its standard deviation for independent errors,
    /// and the relative uncertainty of the first, if known; `None` for fixed parameters.
    #[must_use]
    pub fn shared_std_devs(&self, lens_types: usize) -> Vec<Option<(f64, f64, Option<f64>)>> {
        let of_row = |row: usize| {
            let independent = self.std_dev_in(&self.independent_covariance, row);
            let relative = self.freedom.get(row).map(|freedom| (0.5 / freedom).sqrt());
            (self.std_dev(row), independent, relative)
        };
        self.by_shared(lens_types, of_row)
    }

    /// Returns the standard deviation of each parameter of the board shape; `None` for fixed parameters.
    #[must_use]
    pub fn shape_std_devs(&self, lens_types: usize) -> [Option<f64>; SHAPE] {
        let all = self.by_shared(lens_types, |row| self.std_dev(row));
        std::array::from_fn(|i| all[all.len() - SHAPE + i])
    }

    /// Returns the row of each parameter of the board shape among the free ones; `None` for fixed ones.
    pub(crate) fn shape_rows(&self, lens_types: usize) -> [Option<usize>; SHAPE] {
        let all = self.by_shared(lens_types, |row| row);
        std::array::from_fn(|i| all[all.len() - SHAPE + i])
    }

    /// Returns the standard deviations of the parameters of a pose: rotation vector (rad), translation (mm); infinite if not
    /// determined.
    #[must_use]
    pub fn pose_std_devs(&self, pose: usize) -> [f64; POSE_PARAMETERS] {
        let first = self.free_intrinsics.len() + POSE_PARAMETERS * pose;
        std::array::from_fn(|i| self.std_dev(first + i))
    }

    fn std_dev(&self, row: usize) -> f64 {
        self.std_dev_in(&self.covariance, row)
    }

    fn std_dev_in(&self, covariance: &Matrix, row: usize) -> f64 {
        if self.determined[row] { covariance[(row, row)].sqrt() } else { f64::INFINITY }
    }

    /// Returns the values of [`Uncertainty::intrinsic_std_devs`] for independent errors.
    #[must_use]
    pub fn independent_std_devs(&self, lens_types: usize) -> Vec<Option<f64>> {
        self.by_intrinsic(lens_types, |row| self.std_dev_in(&self.independent_covariance, row))
    }

    /// Returns the relative uncertainty of each standard deviation, √(1/2ν) with ν degrees of freedom; `None` for fixed
    /// parameters, and if errors are taken as independent.
    #[must_use]
    pub fn std_dev_uncertainties(&self, lens_types: usize) -> Vec<Option<f64>> {
        let of_row = |row: usize| self.freedom.get(row).map(|freedom| (0.5 / freedom).sqrt());
        self.by_intrinsic(lens_types, of_row).into_iter().map(Option::flatten).collect()
    }

    /// Returns the standard deviations from the jackknife over frames, √((n − 1)/n Σ(θᵢ − θ̄)²), with the changes θᵢ to first
    /// order instead of n calibrations; `None` for fixed parameters.
    #[must_use]
    pub fn jackknife_std_devs(&self, lens_types: usize) -> Vec<Option<f64>> {
        let frames = self.left_out_changes.rows as f64;
        let changes = DMatrix::from(&self.left_out_changes);
        let variance = |row: usize| changes.column(row).variance();
        self.by_intrinsic(lens_types, |row| ((frames - 1.0) * variance(row)).sqrt())
    }

    /// Returns a value for each intrinsic parameter, from its row among the free ones.
    fn by_intrinsic<T: Clone>(
        &self,
        lens_types: usize,
        of_row: impl Fn(usize) -> T,
    ) -> Vec<Option<T>> {
        let mut values = self.by_shared(lens_types, of_row);
        values.truncate(Parameter::intrinsic(lens_types).len());
        values
    }

    /// Returns a value for each parameter of camera and board, from its row among the free ones.
    fn by_shared<T: Clone>(
        &self,
        lens_types: usize,
        of_row: impl Fn(usize) -> T,
    ) -> Vec<Option<T>> {
        let mut values = vec![None; Parameter::shared(lens_types).len()];
        for (row, &index) in self.free_intrinsics.iter().enumerate() {
            values[index] = Some(of_row(row));
        }
        values
    }

    /// Returns the correlation matrix of the free parameters of camera and board; 0 if one is not determined.
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

    /// Returns the weakest directions that change intrinsic parameters, the weakest first.
    #[must_use]
    pub fn weakest_directions(&self, lens_types: usize) -> Vec<WeakDirection> {
        let undetermined = self.size() - self.rank;
        let parameters = Parameter::shared(lens_types);
        let describe =
            |i: usize| self.describe(self.weakest.row(i), i >= undetermined, &parameters);
        let mut directions: Vec<WeakDirection> = (0..self.weakest.rows).map(describe).collect();
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
                // Without any information, the scaled space has the unit of the parameter.
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
                name: parameters[index].name().to_owned(),
                change: direction[row],
                unit: parameters[index].unit(),
                share: share(row),
            })
            .zip(&self.determined)
            // The variance of a parameter that is not determined is meaningless.
            .filter(|(component, known)| **known == determined && component.share >= least)
            .map(|(component, _)| component)
            .collect();
        components.sort_by(|a, b| b.share.total_cmp(&a.share));
        // The sign of a direction is arbitrary: with this choice the first named parameter grows.
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

/// Computes the uncertainty of the parameters at a minimum, with systematic errors of the observations.
pub(crate) fn uncertainty(
    problem: &Problem,
    cost: &CostOptions,
    systematic: &[SystematicError],
    threads: usize,
) -> Result<Uncertainty> {
    Ok(ffi::uncertainty(&problem.parts(), cost, systematic, threads)?)
}

/// Computes the information of the features of each pose on the free parameters of camera and board, with the pose unknown.
pub(crate) fn frame_information(
    problem: &Problem,
    cost: &CostOptions,
    threads: usize,
) -> Result<Vec<DMatrix<f64>>> {
    let of_frames = ffi::frame_information(&problem.parts(), cost, threads)?;
    Ok(of_frames.iter().map(DMatrix::from).collect())
}
