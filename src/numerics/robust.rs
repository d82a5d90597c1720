//! Iteratively reweighted least squares: estimates that are robust to outliers (Huber, Robust
//! Statistics, 1981; Tukey's biweight: Beaton and Tukey, Technometrics 16, 1974).

use super::median;

/// Weight of a residual of length r; beyond the limit L it is an outlier.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Weight {
    /// Tukey's biweight (1 − r²/L²)², 0 from L on: efficient for normal residuals, without any effect of outliers.
    Biweight,
    /// Weight 1 up to L, 0 beyond: for fits with few rounds.
    Cut,
    /// Weight 1/(1 + r⁴/L⁴), which is never 0, so that a fit to few values stays determined.
    Smooth,
}

/// Unit of the typical length of the residuals, which is their median.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Scale {
    /// The median itself.
    Median,
    /// Standard deviation per axis of residuals in the plane: for normal ones the median length is
    /// √(2 ln 2) standard deviations.
    PerAxis,
}

impl Scale {
    fn of_median(self, median: f64) -> f64 {
        match self {
            Self::Median => median,
            Self::PerAxis => median / 1.177_410_022_515_474_7,
        }
    }
}

/// Rule for outliers: a residual is one beyond `scales` times the typical length, which is at least `least`, plus `slack`. Both
/// are in the unit of the residuals.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Outliers {
    pub weight: Weight,
    pub scale: Scale,
    pub scales: f64,
    /// Smallest typical length: if nearly all residuals are zero, the rest must not become outliers.
    pub least: f64,
    /// Allowance on top of the scatter of the residuals.
    pub slack: f64,
}

impl Outliers {
    /// Returns the typical length of residuals; `None` if there are none.
    pub fn typical(&self, lengths: &[f64]) -> Option<f64> {
        let median = median(lengths.iter().copied())?;
        Some(self.scale.of_median(median).max(self.least))
    }

    /// Returns the length beyond which residuals of this typical length are outliers.
    pub fn limit(&self, typical: f64) -> f64 {
        self.scales * typical + self.slack
    }

    fn weight(&self, length: f64, limit: f64) -> f64 {
        let x = length / limit;
        match self.weight {
            Weight::Biweight if x < 1.0 => (1.0 - x * x).powi(2),
            Weight::Cut if length <= limit => 1.0,
            Weight::Biweight | Weight::Cut => 0.0,
            Weight::Smooth => 1.0 / (1.0 + x.powi(4)),
        }
    }
}

/// Model that is fitted to data by weighted least squares, round by round.
pub(crate) trait Reweighted {
    /// Type of the fitted model.
    type Model;

    /// Returns the number of data.
    fn count(&self) -> usize;

    /// Returns the model that fits best with these weights, one per datum, which multiply the data's own weights; `last` is the
    /// model of the previous round. `None` if the data do not determine it.
    fn solve(&self, weights: &[f64], last: Option<&Self::Model>) -> Option<Self::Model>;

    /// Returns the length of the residual of a datum.
    fn length(&self, model: &Self::Model, datum: usize) -> f64;

    /// Returns true if the last round made no significant change.
    fn settled(&self, _last: &Self::Model, _next: &Self::Model) -> bool {
        false
    }
}

/// Fitted model with its residuals.
#[derive(Debug, Clone)]
pub(crate) struct Fitted<M> {
    pub model: M,
    /// Lengths of the residuals.
    pub lengths: Vec<f64>,
    /// Typical length of the residuals, see [`Outliers::typical`].
    pub typical: f64,
    /// Weights that follow from these lengths.
    pub weights: Vec<f64>,
}

/// Fits a model in at most `rounds` rounds. The residuals of the previous round give the weights of a round; the first round
/// has the weights of `start`, or equal weights. `None` if there are no data, or if they do not determine the model.
pub(crate) fn fit<R: Reweighted>(
    data: &R,
    start: Option<R::Model>,
    rounds: usize,
    outliers: &Outliers,
) -> Option<Fitted<R::Model>> {
    let weighed = |model: R::Model| {
        let lengths: Vec<f64> = (0..data.count()).map(|i| data.length(&model, i)).collect();
        let typical = outliers.typical(&lengths)?;
        let limit = outliers.limit(typical);
        let weights = lengths.iter().map(|&length| outliers.weight(length, limit)).collect();
        Some(Fitted { model, lengths, typical, weights })
    };
    let mut fitted = match start {
        Some(model) => Some(weighed(model)?),
        None => None,
    };
    let equal = vec![1.0; data.count()];
    for _ in 0..rounds {
        let (weights, last) =
            fitted.as_ref().map_or((&equal, None), |f| (&f.weights, Some(&f.model)));
        let next = data.solve(weights, last)?;
        let settled = last.is_some_and(|last| data.settled(last, &next));
        fitted = Some(weighed(next)?);
        if settled {
            break;
        }
    }
    fitted
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Mean(Vec<f64>);

    impl Reweighted for Mean {
        type Model = f64;

        fn count(&self) -> usize {
            self.0.len()
        }

        fn solve(&self, weights: &[f64], _: Option<&f64>) -> Option<f64> {
            let sum: f64 = weights.iter().sum();
            (sum > 0.0).then(|| self.0.iter().zip(weights).map(|(x, w)| x * w).sum::<f64>() / sum)
        }

        fn length(&self, mean: &f64, datum: usize) -> f64 {
            (self.0[datum] - mean).abs()
        }
    }

    #[test]
    fn outliers_do_not_move_the_estimate() {
        let data = Mean(vec![1.0, 1.1, 0.9, 1.05, 0.95, 1.0, 50.0]);
        for weight in [Weight::Biweight, Weight::Cut, Weight::Smooth] {
            let outliers =
                Outliers { weight, scale: Scale::Median, scales: 4.0, least: 1e-6, slack: 0.0 };
            let fitted = fit(&data, None, 20, &outliers).unwrap();
            assert!((fitted.model - 1.0).abs() < 0.02, "{weight:?}: {}", fitted.model);
            assert!(fitted.weights[6] < 1e-6 && fitted.weights[0] > 0.5, "{weight:?}");
        }
        let none = Mean(Vec::new());
        let outliers = Outliers {
            weight: Weight::Cut,
            scale: Scale::PerAxis,
            scales: 4.0,
            least: 0.0,
            slack: 0.0,
        };
        assert!(fit(&none, None, 20, &outliers).is_none());
    }
}
