//! Robust statistics.

use crate::quantity::Estimate;

/// Returns the median; of an even number of values, the upper of the middle two. `None` without values.
pub(crate) fn median(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.into_iter().collect();
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// Returns mean and standard deviation of a sample; the latter is `None` for a single value.
pub(crate) fn mean_and_std_dev(values: impl Iterator<Item = f64> + Clone) -> (f64, Option<f64>) {
    let count = values.clone().count() as f64;
    let mean = values.clone().sum::<f64>() / count;
    let square: f64 = values.map(|v| (v - mean).powi(2)).sum();
    (mean, (count > 1.0).then(|| (square / (count - 1.0)).sqrt()))
}

/// Returns the weighted mean of estimates. Its standard deviation follows from theirs or from the scatter of the values,
/// whichever is larger. `None` without values.
pub(crate) fn weighted_mean(values: impl IntoIterator<Item = Estimate>) -> Option<Estimate> {
    let values: Vec<Estimate> = values.into_iter().collect();
    let weight = |v: &Estimate| v.std_dev.powi(-2);
    let weights: f64 = values.iter().map(weight).sum();
    let mean = values.iter().map(|v| v.value * weight(v)).sum::<f64>() / weights;
    let scatter: f64 = values.iter().map(|v| weight(v) * (v.value - mean).powi(2)).sum();
    let excess = (scatter / (values.len() as f64 - 1.0).max(1.0)).max(1.0);
    mean.is_finite().then(|| Estimate::new(mean, (excess / weights).sqrt()))
}

/// Returns the normal deviate that is as rare as a value of `ratio` times its σ, if σ has so many degrees of freedom. Few
/// frames often differ by several of the σ that they show (Student's t, with the approximation of Wallace 1959).
pub(crate) fn normal_deviate(ratio: f64, freedom: f64) -> f64 {
    if freedom.is_infinite() {
        return ratio.abs();
    }
    let scale = (8.0 * freedom + 1.0) / (8.0 * freedom + 3.0);
    scale * (freedom * (ratio * ratio / freedom).ln_1p()).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_median_is_the_middle_value() {
        assert_eq!(median([3.0, 1.0, 2.0]), Some(2.0));
        assert_eq!(median([4.0, 1.0, 3.0, 2.0]), Some(3.0));
        assert_eq!(median([]), None);
    }

    #[test]
    fn the_mean_is_as_uncertain_as_its_values_or_as_they_scatter() {
        assert_eq!(weighted_mean([Estimate::new(1.0, 0.2); 4]), Some(Estimate::new(1.0, 0.1)));
        let mean = weighted_mean([1.0, 3.0, 2.0].map(|x| Estimate::new(x, 0.1))).unwrap();
        assert!((mean.value - 2.0).abs() < 1e-12);
        assert!((mean.std_dev - 1.0 / 3.0_f64.sqrt()).abs() < 1e-12);
        assert_eq!(weighted_mean([]), None);
    }

    /// Compares with tables of Student's t: these ratios are exceeded as rarely as 3 σ of a normal variable, by 0.27 %.
    #[test]
    fn few_frames_need_a_larger_ratio() {
        for (freedom, ratio) in [(4.0, 6.62), (5.0, 5.507), (10.0, 3.957), (30.0, 3.270)] {
            let deviate = normal_deviate(ratio, freedom);
            assert!((deviate - 3.0).abs() < 0.03, "{freedom}: {deviate}");
        }
        assert!((normal_deviate(-3.0, f64::INFINITY) - 3.0).abs() < 1e-12);
    }
}
