//! Tilt of the array against the sensor, from the discs of micro-images all over white images.
//!
//! Both discs grow with the distance d of the array from the sensor: a and q' are d times an angle. If the array is
//! tilted, d grows across the image, and every micro-image shows this growth. It does not depend on the main lens,
//! whereas the perspective of the centres, ∇d/(D + e_z + d), depends on the position of the exit pupil.
//!
//! Vignetting by the main lens cuts discs too, but equally on both sides of the axis. So a part of the growth that is
//! even in the position is also fitted.

use nalgebra::{Matrix3, SMatrix, SVector, Vector1, Vector2, Vector3, Vector6};

use crate::model::TiltGradient;
use crate::numerics::{self, NormalEquations, Outliers, Reweighted, Scale, Weight};

/// Relative growth of the discs of a micro-image over the mean of its type.
#[derive(Debug, Clone, Copy)]
pub(super) struct Growth {
    /// Position of the micro-image, px.
    pub place: Vector2<f64>,
    /// Distance d over its mean, less 1.
    pub value: f64,
    /// Weight: one over the variance of `value`.
    pub weight: f64,
}

/// Micro-images of one lens type in one white image.
#[derive(Debug, Clone)]
pub(super) struct Group {
    pub growths: Vec<Growth>,
    /// True if their brightest light is clipped.
    pub is_clipped: bool,
}

/// Relative model error of the change of light with d, from simulated cameras: of all groups together, of each group
/// alone, and of each whose brightest light is clipped. The light of the widest aperture, which has the least noise, is 3 %
/// off if blur and pupil nearly cancel. Clipped groups of an R12, which only show edges, are 5 to 11 % off at large apertures.
const MODEL: f64 = 0.01;
const OF_GROUP: f64 = 0.02;
const OF_CLIPPED: f64 = 0.1;
/// Fewest micro-images of a type in an image.
const FEWEST: usize = 30;
/// Outliers, due to dust and faults: micro-images this many times further from the surface than the typical one.
const OUTLIERS: Outliers =
    Outliers { weight: Weight::Cut, scale: Scale::Median, scales: 5.0, least: 1e-9, slack: 0.0 };
/// Largest number of rounds of the fit, and change of its solution below which it has settled.
const ROUNDS: usize = 6;
const SETTLED: f64 = 1e-12;
/// Unit of positions in the fit, px, which keeps the equations in scale.
const UNIT_PX: f64 = 1000.0;
/// Unit of slopes in the mean of the groups, px⁻¹.
const UNIT: f64 = 1e-6;

/// Slope of the growth over the image along u and v in one group, px⁻¹, with its variances, and its change if H is larger by its
/// σ.
#[derive(Debug, Clone, Copy)]
struct Slope {
    value: Vector2<f64>,
    variance: Vector2<f64>,
    by_law: Vector2<f64>,
    /// Relative model error.
    of_model: f64,
}

/// Estimates the tilt gradient about `middle` from all groups, each of one lens type in one white image. `otherwise` are the
/// groups with H larger by its σ, if this is known: where blur and pupil nearly cancel, growth depends on H, so that groups
/// which disagree show H. Returns `None` without two groups that show the tilt. Groups differ by more than their noise if the
/// discs are not as modelled. σ includes their scatter, H and the model error; both axes share the latter two.
pub(super) fn tilt_gradient(
    groups: &[Group],
    otherwise: Option<&[Group]>,
    middle: &Vector2<f64>,
) -> Option<TiltGradient> {
    let of_group = |(i, group): (usize, &Group)| {
        let (value, variance) = slope(&group.growths, middle)?;
        let by_law = match otherwise {
            Some(otherwise) => slope(&otherwise[i].growths, middle)?.0 - value,
            None => Vector2::zeros(),
        };
        let of_model = if group.is_clipped { OF_CLIPPED } else { OF_GROUP };
        Some(Slope { value, variance, by_law, of_model })
    };
    let all: Vec<Slope> = groups.iter().enumerate().filter_map(of_group).collect();
    // The errors of clipped groups are alike, so that many are no better than one.
    let whole: Vec<Slope> = all.iter().copied().filter(|s| s.of_model < OF_CLIPPED).collect();
    let slopes = if whole.len() < 2 { all } else { whole };
    if slopes.len() < 2 {
        return None;
    }
    let mut variances: Vec<Vector2<f64>> = slopes.iter().map(|slope| slope.variance).collect();
    let (first, _) = common(&slopes, &variances)?;
    for (variance, slope) in variances.iter_mut().zip(&slopes) {
        *variance += first.xy().map(|growth| (slope.of_model * growth).powi(2));
    }
    let (found, _) = common(&slopes, &variances)?;
    let excess = Vector2::from_fn(|i, _| {
        let square = |(slope, variance): (&Slope, &Vector2<f64>)| {
            (slope.value[i] + found.z * slope.by_law[i] - found[i]).powi(2) / variance[i]
        };
        let squares: f64 = slopes.iter().zip(&variances).map(square).sum();
        (squares / (slopes.len() as f64 - 1.0)).max(1.0)
    });
    for variance in &mut variances {
        variance.component_mul_assign(&excess);
    }
    let (found, covariance) = common(&slopes, &variances)?;
    let of_law = covariance.column(2) / covariance[(2, 2)].sqrt();
    let own = TiltGradient {
        growth_per_px: [found.x, found.y],
        std_dev_per_px: [0, 1].map(|i| covariance[(i, i)].sqrt()),
        shared_per_px: [of_law.x, of_law.y],
        by_aperture_ratio_per_px: [0.0; 2],
        by_aperture_ratio_squared_per_px: [0.0; 2],
    };
    Some(with_shared(&own, own.growth_per_px.map(|growth| MODEL * growth)))
}

/// Returns the slopes along u and v that all groups have in common and the error of H over its σ, with their covariance.
fn common(slopes: &[Slope], variances: &[Vector2<f64>]) -> Option<(Vector3<f64>, Matrix3<f64>)> {
    let mut equations = NormalEquations::<f64, 3, 1>::new();
    equations.add(&Vector3::z(), &Vector1::new(0.0), 1.0);
    for (slope, variance) in slopes.iter().zip(variances) {
        for i in 0..2 {
            let mut row = Vector3::new(0.0, 0.0, -slope.by_law[i] / UNIT);
            row[i] = 1.0;
            let weight = UNIT * UNIT / variance[i];
            equations.add(&row, &Vector1::new(slope.value[i] / UNIT), weight);
        }
    }
    let unit = Vector3::new(UNIT, UNIT, 1.0);
    let covariance = equations.normal().try_inverse()?;
    Some((
        equations.solve()?.component_mul(&unit),
        covariance.component_mul(&(unit * unit.transpose())),
    ))
}

/// Adds an error that both axes share to a tilt gradient.
fn with_shared(tilt_gradient: &TiltGradient, by_per_px: [f64; 2]) -> TiltGradient {
    let signed = |i: usize| {
        tilt_gradient.shared_per_px[i].hypot(by_per_px[i]).copysign(tilt_gradient.growth_per_px[i])
    };
    TiltGradient {
        std_dev_per_px: [0, 1].map(|i| tilt_gradient.std_dev_per_px[i].hypot(by_per_px[i])),
        shared_per_px: [0, 1].map(signed),
        ..*tilt_gradient
    }
}

/// Fits the linear part of the growth over the image, and its variances.
fn slope(growths: &[Growth], middle: &Vector2<f64>) -> Option<(Vector2<f64>, Vector2<f64>)> {
    if growths.len() < FEWEST {
        return None;
    }
    let surface = Surface { growths, middle: *middle };
    let fitted = numerics::fit(&surface, None, ROUNDS, &OUTLIERS)?;
    let (solution, inverse) = fitted.model;
    let used = || growths.iter().zip(&fitted.weights).filter(|(_, weight)| **weight > 0.0);
    let freedom = (used().count() as f64 - 6.0).max(1.0);
    let square = |growth: &Growth| surface.residual(&solution, growth).powi(2) * growth.weight;
    let variance = used().map(|(growth, _)| square(growth)).sum::<f64>() / freedom;
    let linear = |x: f64, power: i32| x / UNIT_PX.powi(power);
    Some((
        Vector2::new(linear(solution[1], 1), linear(solution[2], 1)),
        Vector2::new(inverse[(1, 1)], inverse[(2, 2)]).map(|x| linear(x * variance, 2)),
    ))
}

/// Surface of second order through the growths.
struct Surface<'a> {
    growths: &'a [Growth],
    middle: Vector2<f64>,
}

impl Surface<'_> {
    fn row(&self, growth: &Growth) -> Vector6<f64> {
        let p = (growth.place - self.middle) / UNIT_PX;
        Vector6::new(1.0, p.x, p.y, p.x * p.x, p.x * p.y, p.y * p.y)
    }

    fn residual(&self, solution: &Vector6<f64>, growth: &Growth) -> f64 {
        growth.value - self.row(growth).dot(solution)
    }
}

impl Reweighted for Surface<'_> {
    /// Solution with the inverse of its normal matrix.
    type Model = (SVector<f64, 6>, SMatrix<f64, 6, 6>);

    fn count(&self) -> usize {
        self.growths.len()
    }

    fn solve(&self, weights: &[f64], _: Option<&Self::Model>) -> Option<Self::Model> {
        let mut equations = NormalEquations::<f64, 6, 1>::new();
        for (growth, weight) in self.growths.iter().zip(weights) {
            equations.add(&self.row(growth), &Vector1::new(growth.value), weight * growth.weight);
        }
        Some((equations.solve()?, equations.normal().try_inverse()?))
    }

    fn length(&self, (solution, _): &Self::Model, datum: usize) -> f64 {
        self.residual(solution, &self.growths[datum]).abs()
    }

    fn settled(&self, (last, _): &Self::Model, (next, _): &Self::Model) -> bool {
        (last - next).norm() < SETTLED
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TILT_GRADIENT: [f64; 2] = [-1.0e-5, 1.4e-5];
    const NOISE: f64 = 3e-3;
    const MIDDLE: [f64; 2] = [500.0, 400.0];

    /// Creates micro-images all over an image, vignetted towards its border and with noise of their own; every fortieth
    /// shows dust. `bias` is the relative error of the tilt gradient of the group.
    fn group(seed: u32, bias: f64) -> Group {
        let mut noise = seed;
        let mut error = || {
            noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            NOISE * (f64::from(noise >> 8) / f64::from(1 << 23) - 1.0) * 3.0_f64.sqrt()
        };
        let middle = Vector2::from(MIDDLE);
        let growths = (0..400)
            .map(|i| {
                let place = Vector2::new(f64::from(i % 20), f64::from(i / 20))
                    .component_mul(&Vector2::new(50.0, 40.0));
                let p = place - middle;
                let dust = if i % 40 == 7 { 0.3 } else { 0.0 };
                let tilt_gradient = Vector2::from(TILT_GRADIENT) * (1.0 + bias);
                let value = tilt_gradient.dot(&p) - 2e-8 * p.norm_squared() + error() + dust;
                Growth { place, value, weight: NOISE.powi(-2) }
            })
            .collect();
        Group { growths, is_clipped: false }
    }

    fn found(groups: &[Group]) -> TiltGradient {
        tilt_gradient(groups, None, &Vector2::from(MIDDLE)).unwrap()
    }

    #[test]
    fn the_tilt_gradient_is_found_through_vignetting_and_dust() {
        let found = found(&[group(1, 0.0), group(2, 0.0), group(3, 0.0), group(4, 0.0)]);
        for (i, truth) in TILT_GRADIENT.into_iter().enumerate() {
            let (error, std_dev) = (found.growth_per_px[i] - truth, found.std_dev_per_px[i]);
            assert!(error.abs() < 3.0 * std_dev, "{found:?}");
            assert!((1e-7..5e-7).contains(&std_dev), "{found:?}");
        }
    }

    /// Two groups depend on H, which is wrong by 2 σ.
    #[test]
    fn an_error_of_the_angular_response_shows_in_groups_that_disagree() {
        let (by_law, wrong) = (0.1, 2.0);
        let depends = [true, true, false, false, false];
        let groups_at = |h: f64| -> Vec<Group> {
            let bias = |depends: bool| if depends { by_law * h } else { 0.0 };
            (1..).zip(depends).map(|(seed, depends)| group(seed, bias(depends))).collect()
        };
        let middle = Vector2::from(MIDDLE);
        let (assumed, otherwise) = (groups_at(-wrong), groups_at(1.0 - wrong));
        let joint = tilt_gradient(&assumed, Some(&otherwise), &middle).unwrap();
        let held = found(&assumed);
        for (i, truth) in TILT_GRADIENT.into_iter().enumerate() {
            let error = |of: &TiltGradient| (of.growth_per_px[i] - truth).abs();
            assert!(error(&joint) < 2.0 * joint.std_dev_per_px[i], "{joint:?}");
            assert!(error(&joint) < 0.5 * error(&held), "{joint:?} {held:?}");
        }
    }

    #[test]
    fn clipped_groups_do_not_count_beside_whole_ones() {
        let clipped = |seed: u32| Group { is_clipped: true, ..group(seed, -0.1) };
        let with = found(&[group(1, 0.0), group(2, 0.0), clipped(3), clipped(4), clipped(5)]);
        let whole = found(&[group(1, 0.0), group(2, 0.0)]);
        assert_eq!(with, whole);
        let alone = found(&[clipped(3), clipped(4), clipped(5)]);
        let same = found(&[3, 4, 5].map(|seed| group(seed, -0.1)));
        assert!(alone.std_dev_per_px[1] > 1.3 * same.std_dev_per_px[1], "{alone:?} {same:?}");
    }

    #[test]
    fn groups_that_disagree_are_less_certain() {
        let agree = found(&[group(1, 0.0), group(2, 0.0)]);
        let disagree = found(&[group(1, -0.5), group(2, 0.5)]);
        assert!(disagree.std_dev_per_px[0] > 4.0 * agree.std_dev_per_px[0], "{disagree:?}");
        // The model error is the same for both axes, however the groups differ.
        for (tilt_gradient, axis) in [(agree, 0), (agree, 1), (disagree, 0), (disagree, 1)] {
            let of_model = tilt_gradient.shared_per_px[axis] / tilt_gradient.growth_per_px[axis];
            assert!((of_model - MODEL).abs() < 1e-9, "{tilt_gradient:?}");
        }
        assert!(tilt_gradient(&[group(1, 0.0)], None, &Vector2::from(MIDDLE)).is_none());
        let mut few = group(1, 0.0);
        few.growths.truncate(20);
        assert!(tilt_gradient(&[few, group(2, 0.0)], None, &Vector2::zeros()).is_none());
    }
}
