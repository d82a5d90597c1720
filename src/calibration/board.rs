//! Test whether the board is flat.
//!
//! A board counts as flat until the frames contradict that. After the refinement with a flat board, its shape is set
//! free, with priors at 0 that state how flat boards are. Parts that are more than 3 σ from 0 are kept: the bend as a
//! whole (both sags and the twist), and the aspect. Otherwise the result is the one with the flat board, which the
//! trial has not touched.

use tracing::info;

use crate::calibration::refine::{Refined, Settings, at_end};
use crate::calibration::{BoardModel, PriorSource};
use crate::checks::calibration as checks;
use crate::error::{Error, Result};
use crate::finding::{Finding, Issue};
use crate::model::{BentBoard, Parameter, SHAPE};
use crate::numerics::normal_deviate;
use crate::solver::{CostOptions, Iteration, Prior, Problem, Refinement, Termination};

/// Flatness of boards: σ of sags and twist as a fraction of the diagonal, and σ of the aspect.
const FLAT: f64 = 1e-3;
/// Distance from 0, in σ, beyond which a value is not due to chance.
const SIGNIFICANT: f64 = 3.0;
/// Ratio of costs below which a minimum is another one. Costs at the same minimum differ by the weight of the priors.
const CLEARLY_LOWER: f64 = 0.99;
/// Index of the aspect in the table of parameters; the parameters of the bend precede it.
const ASPECT: usize = 3;

/// Board as a calibration has found it.
#[derive(Debug, Clone, PartialEq)]
pub struct BoardResult {
    /// Size and shape of the board.
    pub bent: BentBoard,
    /// σ of its shape, in the order of [`Parameter::SHAPE`]; `None` for parameters that were not estimated.
    pub std_devs: [Option<f64>; SHAPE],
    /// Result of the flatness trial.
    pub trial: Trial,
    /// Refinements that only served the trial.
    pub aside: Effort,
}

/// Result of the flatness trial of a board.
#[derive(Debug, Clone, PartialEq)]
pub enum Trial {
    /// Trial omitted: the shape of the board is stated, or is estimated in any case.
    NotTried,
    /// Trial omitted: there are too few frames.
    TooFewFrames,
    /// Failed trial: the shape could not be found, for this reason.
    Failed(String),
    /// Completed trial.
    Tried {
        /// Value and σ of each parameter with all of them free; `None` for fixed parameters.
        values: [Option<(f64, f64)>; SHAPE],
        /// Distance of the bend and the aspect from 0, in σ of a normal variable; `None` if it is not determined.
        std_devs_from_zero: [Option<f64>; 2],
        /// Reason why the parameters that are not 0 keep the values of the trial: the refinement of these alone failed.
        unsettled: Option<String>,
    },
}

/// Refinements whose result was not kept.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Effort {
    /// Number of their iterations.
    pub iterations: usize,
    /// Time that they took, s.
    pub time_s: f64,
}

impl Effort {
    fn of(refinement: &Refinement) -> Self {
        let iterations = refinement.iterations.len().saturating_sub(1);
        Self { iterations, time_s: refinement.time_s }
    }
}

impl BoardResult {
    /// Returns value and σ of each parameter when all were free; `None` for parameters that were fixed or not tried.
    #[must_use]
    pub fn tried(&self) -> [Option<(f64, f64)>; SHAPE] {
        match self.trial {
            Trial::Tried { values, .. } => values,
            Trial::NotTried | Trial::TooFewFrames | Trial::Failed(_) => [None; SHAPE],
        }
    }

    /// Returns a limit (2 σ) of each parameter that was tried and is set to 0.
    #[must_use]
    pub fn limits(&self) -> [Option<f64>; SHAPE] {
        let tried = self.tried();
        let limit = |i: usize| {
            let (value, std_dev) = tried[i]?;
            self.std_devs[i].is_none().then_some(value.abs() + 2.0 * std_dev)
        };
        std::array::from_fn(limit)
    }
}

/// Refinement with its priors, and the trial before it.
pub(super) struct Settled {
    pub refined: Refined,
    pub priors: Vec<(Prior, PriorSource)>,
    pub trial: Trial,
    pub aside: Effort,
}

/// Free parameters of a shape, and σ of their priors.
#[derive(Clone, Copy, PartialEq)]
struct Free {
    parameters: [bool; SHAPE],
    bend_mm: f64,
    aspect: f64,
}

impl Free {
    fn bends(&self) -> bool {
        self.parameters[..ASPECT].contains(&true)
    }
}

impl Settings<'_> {
    /// Refines camera, board and poses. `priors` are the priors of `cost`.
    pub fn refine_with_board(
        &self,
        problem: &Problem,
        cost: &CostOptions,
        priors: &[(Prior, PriorSource)],
        progress: &mut dyn FnMut(&Iteration) -> bool,
    ) -> Result<Settled> {
        let free = Free {
            parameters: Parameter::SHAPE.each_ref().map(|p| !is_fixed(cost, p.name())),
            bend_mm: FLAT * problem.board.board.diagonal_mm(),
            aspect: FLAT,
        };
        // A stated prior on the shape means that the board does not count as flat.
        let stated =
            priors.iter().any(|(a, _)| Parameter::SHAPE.iter().any(|p| p.name() == a.quantity));
        let model = match self.options.board {
            BoardModel::Auto if stated => BoardModel::Bent,
            model => model,
        };
        if model == BoardModel::Bent {
            let trial = self.refine_free(problem, (cost, priors), &free, progress)?;
            let (settled, failed) =
                self.settle(problem, trial, (cost, priors), (&free, free), progress);
            return failed.map_or(Ok(settled), Err);
        }
        let mut flat = self.refine(problem, with_fixed(cost, |_| true), progress)?;
        let known =
            |refined, trial, aside| Settled { refined, priors: priors.to_vec(), trial, aside };
        let none = Effort::default();
        let stopped = flat.refinement.termination == Termination::Stopped;
        let open = model == BoardModel::Auto && self.tries_shape;
        if !open || stopped || !free.parameters.contains(&true) {
            return Ok(known(flat, Trial::NotTried, none));
        }
        if !flat.uncertainty.shared {
            return Ok(known(flat, Trial::TooFewFrames, none));
        }
        let start = at_end(problem, Some(&flat.refinement));
        let near = Settings {
            systematic: self.systematic.clone(),
            known_weight: Some(flat.cost.prior_weight),
            ..*self
        };
        let trial = near.refine_free(&start, (cost, priors), &free, progress);
        // A strongly bent board leads a refinement with a flat one to a camera from which no way may lead back.
        let may_be_astray = match &trial {
            Ok(trial) if trial.refined.refinement.termination == Termination::Stopped => false,
            Ok(trial) => {
                flat.refinement.termination != Termination::Converged || is_bent(trial, &free)
            }
            Err(_) => true,
        };
        let again = may_be_astray
            .then(|| self.refine_free(problem, (cost, priors), &free, progress))
            .and_then(Result::ok);
        let (free_trial, is_again) = match (trial, again) {
            (Ok(trial), Some(again)) if cost_of(&again) < CLEARLY_LOWER * cost_of(&trial) => {
                (again, true)
            }
            (Ok(trial), _) => (trial, false),
            (Err(_), Some(again)) => (again, true),
            // The result with a flat board stands.
            (Err(error), None) => {
                return Ok(known(flat, Trial::Failed(error.to_string()), none));
            }
        };
        let (settings, start) = if is_again { (self, *problem) } else { (&near, start) };
        let aside = Effort::of(&free_trial.refined.refinement);
        if free_trial.refined.refinement.termination == Termination::Stopped {
            flat.refinement.termination = Termination::Stopped;
            return Ok(known(flat, Trial::NotTried, aside));
        }
        let std_devs_from_zero = std_devs_from_zero(&free_trial.refined);
        let parameters = shown(&std_devs_from_zero, &free);
        let values = values(&free_trial.refined);
        let tried = |failed: Option<Error>| {
            let unsettled = failed.map(|error| error.to_string());
            let trial = Trial::Tried { values, std_devs_from_zero, unsettled };
            info!("the frames show of the board: {trial:?}");
            trial
        };
        if parameters == [false; SHAPE] {
            return Ok(known(flat, tried(None), aside));
        }
        let found = Free { parameters, ..free };
        let (mut settled, failed) =
            settings.settle(&start, free_trial, (cost, priors), (&free, found), progress);
        if !is_again {
            settled.refined.refinement = flat.refinement.followed_by(settled.refined.refinement);
        }
        Ok(Settled { trial: tried(failed), ..settled })
    }

    /// Evaluates the cost at a problem, with the shape of its board. With `keeps_shape` the shape is fixed.
    pub fn evaluated(
        &self,
        problem: &Problem,
        cost: &CostOptions,
        priors: &[(Prior, PriorSource)],
        keeps_shape: bool,
    ) -> Result<Settled> {
        let refined = self.evaluate(problem, with_fixed(cost, |_| keeps_shape))?;
        let (trial, aside) = (Trial::NotTried, Effort::default());
        Ok(Settled { refined, priors: priors.to_vec(), trial, aside })
    }

    /// Refines with free parameters of the shape, each of which has a prior at 0 unless another is stated.
    fn refine_free(
        &self,
        problem: &Problem,
        (cost, priors): (&CostOptions, &[(Prior, PriorSource)]),
        free: &Free,
        progress: &mut dyn FnMut(&Iteration) -> bool,
    ) -> Result<Settled> {
        let mut cost = with_fixed(cost, |i| !free.parameters[i]);
        let mut priors = priors.to_vec();
        for (i, parameter) in Parameter::SHAPE.iter().enumerate() {
            let quantity = parameter.name().to_owned();
            let stated = priors.iter().any(|(prior, _)| prior.quantity == quantity);
            let wanted = self.options.priors.is_default(&quantity);
            if free.parameters[i] && wanted && !stated {
                let std_dev = if i == ASPECT { free.aspect } else { free.bend_mm };
                let prior = Prior { quantity, value: 0.0, std_dev };
                priors.push((prior, PriorSource::FlatBoard));
            }
        }
        cost.priors = priors.iter().map(|(prior, _)| prior.clone()).collect();
        let mut systematic = self.systematic.clone();
        for error in systematic.iter_mut().filter(|error| !error.priors.is_empty()) {
            error.priors.resize(cost.priors.len(), 0.0);
        }
        let refined = Settings { systematic, ..*self }.refine(problem, cost, progress)?;
        Ok(Settled { refined, priors, trial: Trial::NotTried, aside: Effort::default() })
    }

    /// Refines again if only some of the tried parameters stay free, or if the board is bent by more than its priors
    /// allow for; then the priors allow for as much. If the refinement fails, returns the trial with the reason.
    fn settle(
        &self,
        problem: &Problem,
        trial: Settled,
        known: (&CostOptions, &[(Prior, PriorSource)]),
        (before, found): (&Free, Free),
        progress: &mut dyn FnMut(&Iteration) -> bool,
    ) -> (Settled, Option<Error>) {
        let BentBoard { shape, .. } = at_end(problem, Some(&trial.refined.refinement)).board;
        let bend_mm = BentBoard { shape, ..problem.board }.bend_mm();
        let free = Free {
            bend_mm: found.bend_mm.max(if found.bends() { bend_mm } else { 0.0 }),
            aspect: found.aspect.max(if found.parameters[ASPECT] {
                shape.aspect.abs()
            } else {
                0.0
            }),
            ..found
        };
        if free == *before || trial.refined.refinement.termination == Termination::Stopped {
            return (trial, None);
        }
        match self.refine_free(problem, known, &free, progress) {
            Ok(settled) => {
                (Settled { aside: Effort::of(&trial.refined.refinement), ..settled }, None)
            }
            Err(error) => (trial, Some(error)),
        }
    }
}

/// Returns the free parameters of a shape that are significant.
fn shown(std_devs_from_zero: &[Option<f64>; 2], free: &Free) -> [bool; SHAPE] {
    let clear = std_devs_from_zero.map(|from| from.is_some_and(|from| from > SIGNIFICANT));
    std::array::from_fn(|i| free.parameters[i] && clear[usize::from(i == ASPECT)])
}

/// Returns true if a trial with free parameters of the shape shows that the board is not flat.
fn is_bent(trial: &Settled, free: &Free) -> bool {
    shown(&std_devs_from_zero(&trial.refined), free).contains(&true)
}

fn cost_of(settled: &Settled) -> f64 {
    settled.refined.refinement.cost
}

fn is_fixed(cost: &CostOptions, name: &str) -> bool {
    cost.fixed.iter().any(|fixed| fixed == name)
}

/// Returns a cost that fixes further parameters of the shape, by their index.
fn with_fixed(cost: &CostOptions, fixed: impl Fn(usize) -> bool) -> CostOptions {
    let mut cost = cost.clone();
    for (i, parameter) in Parameter::SHAPE.iter().enumerate() {
        if fixed(i) && !is_fixed(&cost, parameter.name()) {
            cost.fixed.push(parameter.name().to_owned());
        }
    }
    cost
}

/// Returns value and σ of each parameter of a shape; `None` for fixed parameters.
fn values(refined: &Refined) -> [Option<(f64, f64)>; SHAPE] {
    let Refined { refinement, uncertainty, .. } = refined;
    let std_devs = uncertainty.shape_std_devs(refinement.camera.lens_types());
    std::array::from_fn(|i| Some((refinement.shape.value(Parameter::SHAPE[i]), std_devs[i]?)))
}

/// Computes the distance of the bend and the aspect from 0, in σ of a normal variable. For the bend it is the largest
/// distance among its parameters and the sum and the difference of the sags: one of these may be well known where
/// another is not.
fn std_devs_from_zero(refined: &Refined) -> [Option<f64>; 2] {
    let Refined { refinement, uncertainty, .. } = refined;
    let rows = uncertainty.shape_rows(refinement.camera.lens_types());
    let value = |i: usize| refinement.shape.value(Parameter::SHAPE[i]);
    let from_zero = |weights: &[(usize, f64)]| {
        let terms: Vec<(usize, f64, f64)> = weights
            .iter()
            .map(|&(i, weight)| Some((rows[i]?, weight, value(i))))
            .collect::<Option<_>>()?;
        let sum: f64 = terms.iter().map(|(_, weight, value)| weight * value).sum();
        let variance: f64 = terms
            .iter()
            .flat_map(|a| terms.iter().map(move |b| (a, b)))
            .map(|(a, b)| a.1 * b.1 * uncertainty.covariance[(a.0, b.0)])
            .sum();
        let known = terms.iter().all(|&(row, ..)| uncertainty.determined[row]);
        let freedom = terms.iter().map(|&(row, ..)| uncertainty.freedom[row]);
        let freedom = freedom.fold(f64::INFINITY, f64::min);
        known.then(|| normal_deviate(sum / variance.sqrt(), freedom))
    };
    let one = |i: usize| from_zero(&[(i, 1.0)]);
    let of_sags = [1.0, -1.0].map(|sign| from_zero(&[(0, 1.0), (1, sign)]));
    let bend = (0..ASPECT).map(one).chain(of_sags).flatten().reduce(f64::max);
    [bend, one(ASPECT)]
}

/// Returns findings about the shape of the board, and about a trial of its shape that failed.
pub(super) fn findings_of(board: &BoardResult) -> Vec<Finding> {
    let estimated = board.std_devs.iter().any(Option::is_some);
    let failed = match &board.trial {
        Trial::Failed(reason) => Some(Issue::BoardShapeNotFound { reason: reason.clone() }),
        Trial::Tried { unsettled: Some(reason), .. } => {
            Some(Issue::BoardShapeNotSettled { reason: reason.clone() })
        }
        Trial::NotTried | Trial::TooFewFrames | Trial::Tried { unsettled: None, .. } => None,
    };
    let failed = failed.map(|issue| Finding::caution(issue).weighing(50.0));
    checks::board_shape(&board.bent, estimated).into_iter().chain(failed).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{Board, BoardShape};

    #[test]
    fn a_shape_that_did_not_settle_is_a_finding() {
        let findings = |unsettled: Option<&str>| {
            let board = BoardResult {
                bent: BentBoard {
                    board: Board { columns: 8, rows: 5, square_mm: 10.0 },
                    shape: BoardShape { sag_x_mm: 0.2, ..BoardShape::default() },
                },
                std_devs: [Some(0.01); SHAPE],
                trial: Trial::Tried {
                    values: [None; SHAPE],
                    std_devs_from_zero: [Some(9.0), Some(0.1)],
                    unsettled: unsettled.map(str::to_owned),
                },
                aside: Effort::default(),
            };
            findings_of(&board)
        };
        assert_eq!(findings(None), []);
        let reason = "no minimum".to_owned();
        let [finding] = &findings(Some("no minimum"))[..] else { panic!("one finding") };
        assert_eq!(finding.issue, Issue::BoardShapeNotSettled { reason });
    }
}
