//! `plenocal calibrate --evaluate-only`: the cost at a solution from elsewhere.

use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;

use plenocal::assessment::assess;
use plenocal::calibration::{Calibration, Refit, Solution, SolvedProblem, cost_at};
use plenocal::io::{self, OutputFolder};
use plenocal::model::Board;
use plenocal::{Result, report};

use super::input::Input;
use super::messages::{print_result, tell};

/// Evaluates, and writes cost.json and residuals.csv, and the problem if it is wanted.
pub(super) fn run(
    solution: &Solution,
    input: &Input,
    (mut output, export): (OutputFolder, Option<OutputFolder>),
    json: bool,
) -> Result<ExitCode> {
    let begun = Instant::now();
    let evaluated =
        cost_at(solution, &input.start, &input.board, &input.observations, &input.options);
    let evaluated = evaluated.map_err(|error| input.located(error))?;
    let parts = Refit::new(&evaluated, &input.board).minimum().cost_parts;
    let assessment = assess(&evaluated, &input.board)?;
    let mut document =
        io::calibration_document(&evaluated, &assessment, begun.elapsed().as_secs_f64());
    document["evaluation"] = io::cost_document(&evaluated, parts);
    output.stage_json("cost.json", &document)?;
    output.stage("residuals.csv", |out| io::write_residuals(out, &evaluated.reprojection))?;
    let mut paths = output.commit()?;
    paths.extend(exported(export, &evaluated, &input.board)?);
    tell(&evaluated.findings);
    print_result(json, &document, &report::cost_section(&evaluated, parts).to_text(), &paths)?;
    Ok(ExitCode::SUCCESS)
}

/// Writes the problem that was solved, if it is wanted.
pub(super) fn exported(
    to: Option<OutputFolder>,
    calibration: &Calibration,
    board: &Board,
) -> Result<Vec<PathBuf>> {
    let Some(mut output) = to else { return Ok(Vec::new()) };
    io::stage_problem(&mut output, &SolvedProblem::of(calibration, board))?;
    output.commit()
}
