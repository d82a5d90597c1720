//! The uncertainty budget in the sense of the GUM: σ of quantities, and the part of each source.

use nalgebra::{DMatrix, DVector, SymmetricEigen};

use super::object_space::{Distance, ObjectSpace, PointTrust, camera_covariance};
use crate::calibration::{APERTURE_RATIO, Calibration, MODEL_ERRORS};
use crate::model::Parameter;
use crate::quantity::{display_unit, fixed};
use crate::solver::Uncertainty;

/// Source of uncertainty.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Source {
    /// Independent errors of observations.
    Noise,
    /// Errors that the observations of a frame, or neighbouring centres, share.
    Shared,
    /// Quantities that the white images determine.
    WhiteImages,
    /// Aperture ratio of the micro-lenses.
    ApertureRatio,
    /// Errors of the models of corners and centroids, and of the aberrations of the main lens.
    Models,
    /// Priors, without what the white images contribute to them.
    Priors,
}

impl Source {
    /// All sources.
    pub const ALL: [Self; 6] = [
        Self::Noise,
        Self::Shared,
        Self::WhiteImages,
        Self::ApertureRatio,
        Self::Models,
        Self::Priors,
    ];

    /// Returns the source in words.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Noise => "Noise",
            Self::Shared => "Shared errors",
            Self::WhiteImages => "White images",
            Self::ApertureRatio => "Aperture ratio",
            Self::Models => "Models",
            Self::Priors => "Priors",
        }
    }
}

/// A quantity of a budget.
#[derive(Debug, Clone, PartialEq)]
pub struct BudgetLine {
    /// Name of the quantity.
    pub name: String,
    /// Value; `None` for a point.
    pub value: Option<f64>,
    /// Unit of the value and of all σ.
    pub unit: &'static str,
    /// Standard deviation.
    pub std_dev: f64,
    /// Standard deviation due to each source, in the order of [`Source::ALL`]; their squares add up. `None` for shared errors
    /// if the frames are too few to show them.
    pub parts: [Option<f64>; 6],
}

/// Parameters in a budget; the focal lengths of the lens types follow.
const SHOWN: [&str; 3] = ["F", "D", "d"];

/// Returns the budget of F, D, d and fᵢ, and of the points with the median σ over the image at the nearest, a middle and the
/// furthest distance of the boards, across the axis and along it. Parameters that are fixed or not determined have no line.
#[must_use]
pub fn uncertainty_budget(
    calibration: &Calibration,
    space: Option<&ObjectSpace>,
) -> Vec<BudgetLine> {
    let uncertainty = &calibration.uncertainty;
    let lens_types = calibration.camera.lens_types();
    let free = &uncertainty.free_intrinsics;
    let parameters = Parameter::intrinsic(lens_types);
    let values = calibration.camera.intrinsics();
    let parts = Parts::of(uncertainty);
    let of_parameter = |row: usize| {
        let parameter = parameters.get(free[row])?;
        let name = parameter.name();
        let shown = SHOWN.contains(&name) || name.starts_with("f_");
        let (unit, factor) = display_unit(name, parameter.unit());
        let along = DVector::from_fn(free.len(), |i, _| if i == row { factor } else { 0.0 });
        let value = values[free[row]] * factor;
        let line = || parts.line(name.to_owned(), Some(value), unit, &along);
        (shown && uncertainty.determined[row]).then(line)
    };
    let mut lines: Vec<BudgetLine> = (0..free.len()).filter_map(of_parameter).collect();
    let place = |line: &BudgetLine| SHOWN.iter().position(|name| *name == line.name);
    lines.sort_by_key(|line| place(line).unwrap_or(SHOWN.len()));
    for distance in space.map(ObjectSpace::spread_distances).unwrap_or_default() {
        let at = fixed(distance.distance_mm, 1);
        let across = parts.most_across(median_point(distance, 0));
        let along = median_point(distance, 1).by_intrinsics.row(2).transpose();
        lines.push(parts.line(format!("point at {at} mm, across"), None, "mm", &across));
        lines.push(parts.line(format!("point at {at} mm, along"), None, "mm", &along));
    }
    lines
}

/// Returns the point with the median σ in a direction.
fn median_point(distance: &Distance, direction: usize) -> &PointTrust {
    let mut points: Vec<&PointTrust> = distance.points.iter().collect();
    points.sort_by(|a, b| a.std_dev_mm[direction].total_cmp(&b.std_dev_mm[direction]));
    points[points.len() / 2]
}

/// Covariance of the free intrinsic parameters by source.
struct Parts<'a> {
    uncertainty: &'a Uncertainty,
    total: DMatrix<f64>,
    noise: DMatrix<f64>,
    priors: DMatrix<f64>,
}

impl<'a> Parts<'a> {
    fn of(uncertainty: &'a Uncertainty) -> Self {
        Self {
            uncertainty,
            total: camera_covariance(uncertainty),
            noise: DMatrix::from(&uncertainty.noise_covariance),
            priors: DMatrix::from(&uncertainty.prior_covariance),
        }
    }

    /// Returns the gradient of a point across the axis in the direction of its largest σ.
    fn most_across(&self, point: &PointTrust) -> DVector<f64> {
        let across = point.by_intrinsics.rows(0, 2);
        let eigen = SymmetricEigen::new(across * &self.total * across.transpose());
        let largest = eigen.eigenvalues.imax();
        across.tr_mul(&eigen.eigenvectors.column(largest))
    }

    /// Returns the line of a quantity with this gradient.
    fn line(
        &self,
        name: String,
        value: Option<f64>,
        unit: &'static str,
        gradient: &DVector<f64>,
    ) -> BudgetLine {
        let variance = |covariance: &DMatrix<f64>| (covariance * gradient).dot(gradient).max(0.0);
        let (total, noise, priors) =
            (variance(&self.total), variance(&self.noise), variance(&self.priors));
        let [mut whites, mut ratio, mut models] = [0.0; 3];
        for change in &self.uncertainty.systematic_changes {
            let by = gradient.iter().zip(&change.changes).map(|(g, c)| g * c).sum::<f64>().powi(2);
            match change.source.as_str() {
                APERTURE_RATIO => ratio += by,
                source if MODEL_ERRORS.contains(&source) => models += by,
                _ => whites += by,
            }
        }
        // The scatter of frames contains the noise; the rest is shared. Along combinations of parameters, a few
        // frames can scatter less than noise by chance.
        let scatter = (total - whites - ratio - models - priors).max(0.0);
        let (noise, shared) = if self.uncertainty.shared {
            (noise.min(scatter), Some((scatter - noise).max(0.0)))
        } else {
            (noise, None)
        };
        let variances =
            [Some(noise), shared, Some(whites), Some(ratio), Some(models), Some(priors)];
        let parts = variances.map(|variance| variance.map(f64::sqrt));
        BudgetLine { name, value, unit, std_dev: total.sqrt(), parts }
    }
}
