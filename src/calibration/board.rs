//! Whether the board is flat, as the frames show it.
//!
//! A board is held to be flat until the frames contradict that. After the refinement with a flat board, its shape
//! is set free, with anchors at 0 that say how flat boards are. What then is more than 3 σ from 0 stays: the bend
//! as a whole (both sags and the twist), and the aspect. Otherwise the result is that of the flat board, which the
//! trial has not touched.

use serde::Serialize;
use tracing::info;

use crate::calibration::refine::{Refined, Settings, at_end};
use crate::calibration::{AnchorSource, Warning};
use crate::error::Result;
use crate::model::{BentBoard, BoardShape, SHAPE, SHAPE_PARAMETERS};
use crate::solver::{Anchor, CostOptions, Iteration, Problem, Termination, shape_names};

/// How flat boards are: σ of sags and twist as a fraction of the diagonal, and σ of the aspect.
const FLAT: f64 = 1e-3;
/// What is further from 0 in σ is not chance.
const SIGNIFICANT: f64 = 3.0;
/// A bend by more of the diagonal is a warning.
const WARPED: f64 = 5e-3;
/// Index of the aspect in the table of parameters; before it are those of the bend.
const ASPECT: usize = 3;

/// What the board is taken for.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum BoardModel {
    /// Flat, unless the frames show that it is not.
    #[default]
    Auto,
    /// Flat: the paper.
    Flat,
    /// Bent and stretched, by what comes out.
    Bent,
    /// Of this shape.
    Known(BoardShape),
}

/// The board as a calibration has found it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BoardResult {
    /// Its size and shape.
    pub bent: BentBoard,
    /// σ of its shape, in the order of [`SHAPE_PARAMETERS`]; `None` for what was not estimated.
    pub std_devs: [Option<f64>; SHAPE],
    /// Value and σ of each parameter when all were free; `None` if that was not tried.
    pub tried: Option<[(f64, f64); SHAPE]>,
}

impl BoardResult {
    /// A limit (2 σ) of each parameter that was tried and is taken to be 0.
    #[must_use]
    pub fn limits(&self) -> [Option<f64>; SHAPE] {
        let limit = |i: usize| {
            let (value, std_dev) = self.tried?[i];
            self.std_devs[i].is_none().then_some(value.abs() + 2.0 * std_dev)
        };
        std::array::from_fn(limit)
    }

    /// The limit of both sags, mm, if the board was tried and found flat.
    #[must_use]
    pub fn sag_limit_mm(&self) -> Option<f64> {
        let [x, y, ..] = self.limits();
        Some(x?.max(y?))
    }
}

/// A refinement with the anchors that it had, and what came out when all of the shape was free.
pub(super) struct Settled {
    pub refined: Refined,
    pub anchors: Vec<(Anchor, AnchorSource)>,
    pub tried: Option<[(f64, f64); SHAPE]>,
}

/// Which parameters of a shape are free, and σ of their anchors.
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
    /// Refines camera, board and poses; `cost` has these anchors.
    pub fn refine_with_board(
        &self,
        problem: &Problem,
        cost: &CostOptions,
        anchors: &[(Anchor, AnchorSource)],
        progress: &mut dyn FnMut(&Iteration) -> bool,
    ) -> Result<Settled> {
        let free = Free {
            parameters: SHAPE_PARAMETERS.each_ref().map(|p| !is_fixed(cost, p.name)),
            bend_mm: FLAT * problem.board.board.diagonal_mm(),
            aspect: FLAT,
        };
        // Who knows something of the shape does not hold the board to be flat.
        let stated = anchors.iter().any(|(a, _)| shape_names().any(|name| name == a.quantity));
        let model = match self.options.board {
            BoardModel::Auto if stated => BoardModel::Bent,
            model => model,
        };
        if model == BoardModel::Bent {
            let trial = self.refine_free(problem, (cost, anchors), &free, progress)?;
            return self.settle(problem, trial, (cost, anchors), (&free, free), progress);
        }
        let mut flat = self.refine(problem, with_fixed(cost, |_| true), progress)?;
        let known = |refined, tried| Settled { refined, anchors: anchors.to_vec(), tried };
        let stopped = flat.refinement.termination == Termination::Stopped;
        let possible = free.parameters.contains(&true) && flat.uncertainty.shared;
        if model != BoardModel::Auto || stopped || !possible {
            return Ok(known(flat, None));
        }
        let start = at_end(problem, Some(&flat.refinement));
        // If a trial fails, the present result stands.
        let trial = match self.refine_free(&start, (cost, anchors), &free, progress) {
            Ok(trial) => trial,
            Err(error) => {
                info!("the shape of the board was not found: {error}");
                return Ok(known(flat, None));
            }
        };
        if trial.refined.refinement.termination == Termination::Stopped {
            flat.refinement.termination = Termination::Stopped;
            return Ok(known(flat, None));
        }
        let found = Free { parameters: significant(&trial.refined), ..free };
        info!("the frames show of the board: {:?}", trial.tried);
        if found.parameters == [false; SHAPE] {
            return Ok(known(flat, trial.tried));
        }
        let mut settled = self.settle(&start, trial, (cost, anchors), (&free, found), progress)?;
        let refinement = flat.refinement.followed_by(settled.refined.refinement);
        settled.refined.refinement = refinement;
        Ok(settled)
    }

    /// Refines with parameters of the shape free that have an anchor at 0 each, unless another is stated.
    fn refine_free(
        &self,
        problem: &Problem,
        (cost, anchors): (&CostOptions, &[(Anchor, AnchorSource)]),
        free: &Free,
        progress: &mut dyn FnMut(&Iteration) -> bool,
    ) -> Result<Settled> {
        let mut cost = with_fixed(cost, |i| !free.parameters[i]);
        let mut anchors = anchors.to_vec();
        for (i, parameter) in SHAPE_PARAMETERS.iter().enumerate() {
            let quantity = parameter.name.to_owned();
            let stated = anchors.iter().any(|(anchor, _)| anchor.quantity == quantity);
            let wanted =
                self.options.default_anchors && !self.options.not_anchored.contains(&quantity);
            if free.parameters[i] && wanted && !stated {
                let std_dev = if i == ASPECT { free.aspect } else { free.bend_mm };
                let anchor = Anchor { quantity, value: 0.0, std_dev };
                anchors.push((anchor, AnchorSource::FlatBoard));
            }
        }
        cost.anchors = anchors.iter().map(|(anchor, _)| anchor.clone()).collect();
        let mut common = self.common.clone();
        for error in common.iter_mut().filter(|error| !error.anchors.is_empty()) {
            error.anchors.resize(cost.anchors.len(), 0.0);
        }
        let refined = Settings { common, ..*self }.refine(problem, cost, progress)?;
        let tried = values(&refined);
        Ok(Settled { refined, anchors, tried })
    }

    /// The same again, if only some of the parameters that were tried stay free, or if the board is bent by more
    /// than its anchors allow for: then the anchors have to allow for as much.
    fn settle(
        &self,
        problem: &Problem,
        trial: Settled,
        known: (&CostOptions, &[(Anchor, AnchorSource)]),
        (before, found): (&Free, Free),
        progress: &mut dyn FnMut(&Iteration) -> bool,
    ) -> Result<Settled> {
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
            return Ok(trial);
        }
        let mut settled = self.refine_free(problem, known, &free, progress)?;
        settled.tried = trial.tried;
        Ok(settled)
    }
}

fn is_fixed(cost: &CostOptions, name: &str) -> bool {
    cost.fixed.iter().any(|fixed| fixed == name)
}

/// A cost that keeps more of the shape's parameters, by their index.
fn with_fixed(cost: &CostOptions, fixed: impl Fn(usize) -> bool) -> CostOptions {
    let mut cost = cost.clone();
    for (i, parameter) in SHAPE_PARAMETERS.iter().enumerate() {
        if fixed(i) && !is_fixed(&cost, parameter.name) {
            cost.fixed.push(parameter.name.to_owned());
        }
    }
    cost
}

/// Value and σ of each parameter of a shape; `None` if one is fixed.
fn values(refined: &Refined) -> Option<[(f64, f64); SHAPE]> {
    let Refined { refinement, uncertainty, .. } = refined;
    let std_devs = uncertainty.shape_std_devs(refinement.camera.lens_types());
    let all: Option<Vec<(f64, f64)>> = SHAPE_PARAMETERS
        .iter()
        .zip(std_devs)
        .map(|(parameter, std_dev)| Some((parameter.value(&refinement.shape), std_dev?)))
        .collect();
    all?.try_into().ok()
}

/// Which parameters the frames show not to be 0: those of the bend together, and the aspect. Sum and difference of
/// the sags count too, since one of them may be well known where the other is not.
fn significant(refined: &Refined) -> [bool; SHAPE] {
    let Refined { refinement, uncertainty, .. } = refined;
    let rows = uncertainty.shape_rows(refinement.camera.lens_types());
    let value = |i: usize| SHAPE_PARAMETERS[i].value(&refinement.shape);
    let is_significant = |weights: &[(usize, f64)]| {
        let terms: Option<Vec<(usize, f64, f64)>> =
            weights.iter().map(|&(i, weight)| Some((rows[i]?, weight, value(i)))).collect();
        let Some(terms) = terms else { return false };
        let sum: f64 = terms.iter().map(|(_, weight, value)| weight * value).sum();
        let variance: f64 = terms
            .iter()
            .flat_map(|a| terms.iter().map(move |b| (a, b)))
            .map(|(a, b)| a.1 * b.1 * uncertainty.covariance[(a.0, b.0)])
            .sum();
        let known = terms.iter().all(|&(row, ..)| uncertainty.determined[row]);
        let freedom = terms.iter().map(|&(row, ..)| uncertainty.freedom[row]);
        let freedom = freedom.fold(f64::INFINITY, f64::min);
        known && std_devs_from_zero(sum / variance.sqrt(), freedom) > SIGNIFICANT
    };
    let one = |i: usize| is_significant(&[(i, 1.0)]);
    let bent = (0..ASPECT).any(one)
        || is_significant(&[(0, 1.0), (1, 1.0)])
        || is_significant(&[(0, 1.0), (1, -1.0)]);
    std::array::from_fn(|i| rows[i].is_some() && if i == ASPECT { one(i) } else { bent })
}

/// The normal deviate that is as rare as a value of `ratio` times its σ, if σ has so many degrees of freedom: few
/// frames often differ by several of the σ that they show (Student's t, by the approximation of Wallace 1959).
fn std_devs_from_zero(ratio: f64, freedom: f64) -> f64 {
    if freedom.is_infinite() {
        return ratio.abs();
    }
    let scale = (8.0 * freedom + 1.0) / (8.0 * freedom + 3.0);
    scale * (freedom * (ratio * ratio / freedom).ln_1p()).sqrt()
}

/// A warning if a board bends so far that it should be replaced.
pub(super) fn warped(bent: &BentBoard) -> Option<Warning> {
    let (bend_mm, diagonal_mm) = (bent.bend_mm(), bent.board.diagonal_mm());
    (bend_mm > WARPED * diagonal_mm).then_some(Warning::WarpedBoard { bend_mm, diagonal_mm })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// From tables of Student's t: these are exceeded as rarely as 3 σ of a normal variable, by 0.27 %.
    #[test]
    fn few_frames_need_a_larger_ratio() {
        for (freedom, ratio) in [(4.0, 6.62), (5.0, 5.507), (10.0, 3.957), (30.0, 3.270)] {
            let deviate = std_devs_from_zero(ratio, freedom);
            assert!((deviate - 3.0).abs() < 0.03, "{freedom}: {deviate}");
        }
        assert!((std_devs_from_zero(-3.0, f64::INFINITY) - 3.0).abs() < 1e-12);
    }
}
