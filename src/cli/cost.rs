//! `plenocal calibrate --evaluate-only`: evaluates the cost at a solution of another program.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

use plenocal::assessment::assess;
use plenocal::calibration::{
    Calibration, Refit, Solution, SolvedProblem, cost_at, cost_of_problem_at,
};
use plenocal::io::{self, OutputFolder};
use plenocal::model::{Board, Parameter};
use plenocal::{Error, Finding, Issue, Result, report};

use super::evaluate::calibrated;
use super::input::{Input, located};
use super::messages::{print_result, shown, tell};

/// Destination of the results of an evaluation.
pub(super) struct Output {
    /// Folder of cost.json and residuals.csv.
    pub results: OutputFolder,
    /// Folder of the exported problem; `None` without export.
    pub export: Option<OutputFolder>,
    /// True if one JSON object is printed instead of tables.
    pub json: bool,
}

/// Evaluates the cost of a project at a solution. If the solution is no minimum and a problem lies beside it, a finding reports
/// the differences between both costs.
pub(super) fn of_project(
    solution: &Solution,
    folders: &[&Path],
    input: &Input,
    output: Output,
) -> Result<ExitCode> {
    let begun = Instant::now();
    let evaluated =
        cost_at(solution, &input.start, &input.board, &input.observations, &input.options);
    let mut evaluated = evaluated.map_err(|error| input.located(error))?;
    if !evaluated.converged {
        let beside = folders.iter().find_map(|folder| problem_beside(folder));
        let other = beside.and_then(|problem| other_cost(&evaluated, &input.board, &problem));
        evaluated.findings.splice(0..0, other);
    }
    write(&evaluated, &input.board, output, begun)
}

/// Evaluates the cost of a problem at a solution. The shape of the board is read from `board_shape` if the problem estimates
/// it.
pub(super) fn of_problem(
    solution: &Solution,
    folder: &Path,
    board_shape: Option<&Path>,
    threads: usize,
    output: Output,
) -> Result<ExitCode> {
    let begun = Instant::now();
    let problem = io::read_problem(folder)?;
    let board = problem.board.board;
    let stated = super::input::board_shape(board_shape, None, &board)?.map(|(shape, _)| shape);
    let shape = match (Parameter::SHAPE.into_iter().all(|p| problem.holds(p)), stated) {
        (false, None) => {
            return Err(Error::invalid(
                "the shape of the board is free in the problem, but camera.json does not contain \
                 it: give the shape of the solution (--board-shape, a file with the board_shape of \
                 calibration.json)",
            ));
        }
        (true, Some(shape)) if shape != problem.board.shape => {
            return Err(Error::invalid(
                "the problem fixes another shape of the board: leave --board-shape out",
            )
            .in_file(&folder.join(io::PROBLEM)));
        }
        (_, stated) => stated.unwrap_or(problem.board.shape),
    };
    let evaluated = cost_of_problem_at(&problem, solution, shape, threads);
    let sources = ["features.csv", "centers.csv"].map(|name| folder.join(name));
    let evaluated = evaluated.map_err(|error| located(error, &sources))?;
    write(&evaluated, &board, output, begun)
}

/// Writes cost.json and residuals.csv, and the problem if it is exported.
fn write(
    evaluated: &Calibration,
    board: &Board,
    output: Output,
    begun: Instant,
) -> Result<ExitCode> {
    let Output { mut results, export, json } = output;
    let parts = Refit::new(evaluated, board).minimum().cost_parts;
    let assessment = assess(evaluated, board)?;
    let mut document =
        io::calibration_document(evaluated, &assessment, begun.elapsed().as_secs_f64());
    document["evaluation"] = io::cost_document(evaluated, parts);
    results.stage_json("cost.json", &document)?;
    results.stage("residuals.csv", |out| io::write_residuals(out, &evaluated.reprojection))?;
    let mut paths = results.commit()?;
    paths.extend(exported(export, evaluated, board)?);
    tell(&evaluated.findings);
    print_result(json, &document, &shown(&report::cost_section(evaluated, parts)), &paths)?;
    Ok(ExitCode::SUCCESS)
}

/// Writes the solved problem if it is exported.
pub(super) fn exported(
    to: Option<OutputFolder>,
    calibration: &Calibration,
    board: &Board,
) -> Result<Vec<PathBuf>> {
    let Some(mut output) = to else { return Ok(Vec::new()) };
    io::stage_problem(&mut output, &SolvedProblem::of(calibration, board))?;
    output.commit()
}

/// Returns the folder of a problem: the folder of the solution, the one above it, or the only one beside it.
fn problem_beside(solution: &Path) -> Option<PathBuf> {
    let is_problem = |folder: &Path| folder.join(io::PROBLEM).is_file();
    let own = if solution.as_os_str().is_empty() { Path::new(".") } else { solution };
    let above = own.join("..");
    if let Some(folder) = [own, &above].into_iter().find(|folder| is_problem(folder)) {
        return Some(folder.to_owned());
    }
    let beside = fs::read_dir(&above).ok()?.flatten().map(|entry| entry.path());
    let mut beside = beside.filter(|folder| is_problem(folder));
    beside.next().filter(|_| beside.next().is_none())
}

/// Returns a finding with the differences between the cost of an evaluation and a problem. A problem that cannot be read is
/// ignored, since the user did not name it.
fn other_cost(evaluated: &Calibration, board: &Board, folder: &Path) -> Option<Finding> {
    let differences =
        io::read_problem(folder).ok()?.differences(&SolvedProblem::of(evaluated, board));
    let folder = fs::canonicalize(folder).unwrap_or_else(|_| folder.to_owned());
    let here = std::env::current_dir().unwrap_or_default();
    let problem = folder.strip_prefix(here).unwrap_or(&folder).display().to_string();
    (!differences.is_empty())
        .then(|| Finding::caution(Issue::OtherCost { problem, differences }).weighing(100.0))
}

/// Reads the solution given on the command line.
pub(super) fn solution(camera: &Path, poses: &Path) -> Result<Solution> {
    Ok(Solution { camera: calibrated(camera)?, poses: io::read_poses(poses)? })
}
