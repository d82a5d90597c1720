//! A whole least-squares problem in a folder: what `plenocal::io::read_problem` in C++ reads.

use std::io::{self, Write};

use serde_json::{Value, json};

use super::{OutputFolder, camera_document, poses_document};
use crate::calibration::{ProblemFeature, SolvedProblem};
use crate::error::Result;
use crate::model::{MicroImageCenter, Parameter};

/// `format` of `problem.json`.
pub const PROBLEM_FORMAT: &str = "plenocal-problem";
/// `version` of `problem.json`.
pub const PROBLEM_VERSION: u64 = 1;

/// Stages `problem.json` (the cost and the board), `camera.json` and `poses.json` (the start), `features.csv` and
/// `centers.csv` (the observations).
pub fn stage_problem(output: &mut OutputFolder, problem: &SolvedProblem) -> Result<()> {
    output.stage_json("problem.json", &problem_document(problem))?;
    output.stage_json("camera.json", &camera_document(&problem.camera, None))?;
    output.stage_json("poses.json", &poses_document(&problem.poses, None))?;
    output.stage("features.csv", |out| write_problem_features(out, &problem.features))?;
    output.stage("centers.csv", |out| write_problem_centers(out, &problem.centers))
}

/// The content of `problem.json`.
fn problem_document(problem: &SolvedProblem) -> Value {
    let board = &problem.board;
    let [half_width, half_height] = [board.board.columns, board.board.rows]
        .map(|corners| 0.5 * board.board.square_mm * f64::from(corners - 1));
    let mut of_board = json!({
        "columns": board.board.columns,
        "rows": board.board.rows,
        "square_mm": board.board.square_mm,
        "half_width_mm": half_width,
        "half_height_mm": half_height,
    });
    for parameter in Parameter::SHAPE {
        of_board[&parameter.key()[1..]] = board.shape.value(parameter).into();
    }
    let cost = &problem.cost;
    json!({
        "format": PROBLEM_FORMAT,
        "version": PROBLEM_VERSION,
        "rho": cost.rho,
        "loss": cost.loss,
        "fixed": cost.fixed,
        "priors": cost.priors,
        "prior_weight": cost.prior_weight,
        "board": of_board,
        "cost_of_plenocal": problem.minimum,
    })
}

// Both with all digits of sigma, so that other programs find the same cost.

fn write_problem_centers(out: &mut dyn Write, centers: &[MicroImageCenter]) -> io::Result<()> {
    writeln!(out, "k,l,u,v,std_dev")?;
    centers.iter().try_for_each(|c| {
        let std_dev = c.std_dev_px.unwrap_or(1.0);
        writeln!(out, "{},{},{},{},{std_dev}", c.k, c.l, c.u_px, c.v_px)
    })
}

fn write_problem_features(out: &mut dyn Write, features: &[ProblemFeature]) -> io::Result<()> {
    writeln!(out, "frame,x,y,z,k,l,u,v,rho,std_u,std_v,std_rho,cluster")?;
    features.iter().try_for_each(|of| {
        let (f, p, [u, v, rho]) = (&of.feature, &of.board_point_mm, of.std_dev_px);
        write!(out, "{},{},{},{},{},{},{},{},", f.frame, p.x, p.y, p.z, f.k, f.l, f.u_px, f.v_px)?;
        match f.rho_px {
            Some(radius) => writeln!(out, "{radius},{u},{v},{rho},{}", f.corner),
            None => writeln!(out, ",{u},{v},,{}", f.corner),
        }
    })
}
