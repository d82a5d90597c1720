//! The report of the cost at a solution from another solver.

use super::calibration::errors_table;
use super::tree::{Cell, Column, Part, Section, Table};
use crate::calibration::Calibration;
use crate::finding::{Finding, Issue};
use crate::model::Parameter;
use crate::quantity::{display_unit, fixed, significant};

/// Negligible distance from the minimum, in σ of independent errors along the way there.
const NEGLIGIBLE: f64 = 0.01;

/// Returns cost, gradient and residuals at a solution, and the gain of one more step. The cost has a part of the features, one
/// of the centres, and one of the priors.
#[must_use]
pub fn cost_section(evaluated: &Calibration, [features, centers, priors]: [f64; 3]) -> Section {
    let [counted, centred] =
        [evaluated.reprojection.features.len(), evaluated.reprojection.centers.len()];
    let weight = if evaluated.priors.is_empty() {
        String::new()
    } else {
        format!(", weight {:.6}", evaluated.cost.prior_weight)
    };
    let [features, centers, priors] = [features, centers, priors].map(|part| fixed(part, 6));
    let cost = format!(
        "Cost {}: {features} of {counted} features, {centers} of {centred} centres, {priors} of {} priors{weight}.",
        fixed(evaluated.refinement.cost, 9),
        evaluated.priors.len()
    );
    let parts = vec![
        Part::Text(other_cost(evaluated) + &verdict(evaluated)),
        Part::Text(cost),
        Part::Table(steps_table(evaluated)),
        Part::Table(errors_table(evaluated)),
    ];
    Section::new("Cost", parts)
}

/// Returns the differences from the cost of a problem. They precede the verdict, which would else seem to apply to the
/// solution.
fn other_cost(evaluated: &Calibration) -> String {
    let of_problem = |finding: &&Finding| matches!(finding.issue, Issue::OtherCost { .. });
    let found = evaluated.findings.iter().find(of_problem);
    found.map_or(String::new(), |finding| {
        let message = finding.message();
        let mut letters = message.chars();
        let first = letters.next().map(|letter| letter.to_uppercase().to_string());
        format!("{}{}. ", first.unwrap_or_default(), letters.as_str())
    })
}

/// Returns a text on whether this is a minimum.
fn verdict(evaluated: &Calibration) -> String {
    let uncertainty = &evaluated.uncertainty;
    let (gain, cost) = (uncertainty.expected_decrease, evaluated.refinement.cost);
    let gain = format!(
        "One more Gauss-Newton step would lower the cost by {} ({} of the cost)",
        significant(gain, 4),
        significant(gain / cost, 2)
    );
    let farthest =
        steps(evaluated).into_iter().max_by(|a, b| a.std_devs().total_cmp(&b.std_devs()));
    let moves = farthest.map_or(String::new(), |step| {
        format!(", and change {} most, by {} σ", step.name, significant(step.std_devs(), 2))
    });
    let away = std_devs_from_minimum(evaluated);
    let verdict = match (evaluated.converged, away < NEGLIGIBLE) {
        (true, _) => "This is a minimum.".to_owned(),
        (false, true) => "This is a minimum for all practical purposes.".to_owned(),
        (false, false) => format!(
            "This is not a minimum of this cost: the minimum is about {} σ of independent errors \
             away, in the direction of the step.",
            significant(away, 2)
        ),
    };
    format!("{verdict} {gain}{moves}.")
}

/// Returns the distance n from the minimum in σ. It adds n² s²/2 to the cost, where s² is the variance of the residuals.
fn std_devs_from_minimum(evaluated: &Calibration) -> f64 {
    let blurred = evaluated.reprojection.features.iter().filter(|f| f.drho_px.is_some()).count();
    let counts = [evaluated.reprojection.features.len(), evaluated.reprojection.centers.len()];
    let residuals = 2 * (counts[0] + counts[1]) + if evaluated.cost.rho { blurred } else { 0 };
    let variance = 2.0 * evaluated.refinement.cost / residuals as f64;
    (2.0 * evaluated.uncertainty.expected_decrease / variance).sqrt()
}

/// The effect of one more step on a parameter.
struct Step {
    name: &'static str,
    unit: &'static str,
    value: f64,
    std_dev: f64,
    gradient: f64,
    change: f64,
}

impl Step {
    fn std_devs(&self) -> f64 {
        (self.change / self.std_dev).abs()
    }
}

fn steps(evaluated: &Calibration) -> Vec<Step> {
    let uncertainty = &evaluated.uncertainty;
    let names = Parameter::shared(evaluated.camera.lens_types());
    let mut values = evaluated.camera.intrinsics();
    values.extend(Parameter::SHAPE.map(|p| evaluated.board.bent.shape.value(p)));
    let step = |(row, &index): (usize, &usize)| Step {
        name: names[index].name(),
        unit: names[index].unit(),
        value: values[index],
        std_dev: uncertainty.covariance[(row, row)].sqrt(),
        gradient: uncertainty.gradient[row],
        change: uncertainty.next_step[row],
    };
    uncertainty.free_intrinsics.iter().enumerate().map(step).collect()
}

fn steps_table(evaluated: &Calibration) -> Table {
    let mut table = Table::new(
        "Gradient and next step",
        [
            Column::text("Parameter"),
            Column::text("Unit"),
            Column::number("Value"),
            Column::number("± σ"),
            Column::of("Gradient", "1/σ"),
            Column::number("Next step"),
            Column::number("in σ"),
        ],
    );
    for step in steps(evaluated) {
        let (unit, factor) = display_unit(step.name, step.unit);
        let [value, std_dev] = Cell::with_std_dev(step.value * factor, Some(step.std_dev * factor));
        table.push([
            step.name.into(),
            unit.into(),
            value,
            std_dev,
            Cell::significant(step.gradient * step.std_dev, 2),
            Cell::significant(step.change * factor, 3),
            Cell::significant(step.change / step.std_dev, 2),
        ]);
    }
    table
}
