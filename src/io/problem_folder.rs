//! Complete least-squares problem in a folder, which `plenocal::io::read_problem` in C++ reads too.

use std::collections::BTreeSet;
use std::io::{self, Write};
use std::path::Path;

use serde::Deserialize;
use serde_json::{Value, json};

use super::json_file::{check_version, document_of, read_json};
use super::observations_file::read_problem_features;
use super::{
    OutputFolder, camera_document, poses_document, read_camera, read_centers, read_poses, read_text,
};
use crate::calibration::{ProblemFeature, SolvedProblem};
use crate::error::{Error, Result};
use crate::model::{BentBoard, Board, BoardShape, MicroImageCenter, Parameter};
use crate::solver::{CostOptions, Loss, LossKind, Prior};

/// Value of `format` in `problem.json`.
pub const PROBLEM_FORMAT: &str = "plenocal-problem";
/// Value of `version` in `problem.json`.
pub const PROBLEM_VERSION: u64 = 1;
/// Name of the file of a problem with its cost and its board.
pub const PROBLEM: &str = "problem.json";

/// Fields of `problem.json` that are read.
#[derive(Deserialize)]
struct ProblemFile {
    rho: bool,
    loss: LossFile,
    fixed: Vec<Parameter>,
    // Problems exported before 0.1.0 call priors anchors.
    #[serde(alias = "anchors")]
    priors: Vec<PriorFile>,
    #[serde(alias = "anchor_weight")]
    prior_weight: f64,
    board: BoardFile,
    cost_of_plenocal: f64,
}

#[derive(Deserialize)]
struct LossFile {
    kind: LossKind,
    scale: f64,
}

#[derive(Deserialize)]
struct PriorFile {
    quantity: String,
    value: f64,
    std_dev: f64,
}

/// Size and shape of the board; half its width and height follow from the size.
#[derive(Deserialize)]
struct BoardFile {
    columns: i32,
    rows: i32,
    square_mm: f64,
    sag_x_mm: f64,
    sag_y_mm: f64,
    twist_mm: f64,
    aspect: f64,
}

/// Reads an exported problem.
///
/// An error names the file if one is missing, if features have frames without a pose, or if their corners do not agree with the
/// board.
pub fn read_problem(folder: &Path) -> Result<SolvedProblem> {
    let path = folder.join(PROBLEM);
    let value = read_json(&path)?;
    let ProblemFile { rho, loss, fixed, priors, prior_weight, board, cost_of_plenocal } =
        problem_from(value).map_err(|e| e.in_file(&path))?;
    let BoardFile { columns, rows, square_mm, sag_x_mm, sag_y_mm, twist_mm, aspect } = board;
    let board = BentBoard {
        board: Board { columns, rows, square_mm },
        shape: BoardShape { sag_x_mm, sag_y_mm, twist_mm, aspect },
    };
    board.board.validate().map_err(|e| e.in_file(&path))?;
    let features_path = folder.join("features.csv");
    let features = read_problem_features(&features_path, &board.board)?;
    let poses = read_poses(&folder.join("poses.json"))?;
    let known: BTreeSet<u32> = poses.iter().map(|pose| pose.frame).collect();
    if let Some(of) = features.iter().find(|of| !known.contains(&of.feature.frame)) {
        let message = format!("frame {} has no pose in poses.json", of.feature.frame);
        return Err(Error::content(&features_path, message));
    }
    let prior = |PriorFile { quantity, value, std_dev }: PriorFile| Prior {
        quantity: quantity.replace("lean_", "tilt_"),
        value,
        std_dev,
    };
    Ok(SolvedProblem {
        camera: read_camera(&folder.join("camera.json"))?,
        poses,
        board,
        features,
        centers: read_problem_centers(&folder.join("centers.csv"))?,
        cost: CostOptions {
            rho,
            loss: Loss { kind: loss.kind, scale: loss.scale },
            fixed: fixed.iter().map(ToString::to_string).collect(),
            priors: priors.into_iter().map(prior).collect(),
            prior_weight,
            ..CostOptions::default()
        },
        minimum: cost_of_plenocal,
    })
}

fn problem_from(value: Value) -> Result<ProblemFile> {
    if value["format"] != PROBLEM_FORMAT {
        return Err(Error::invalid(format!(
            "its format is {} instead of \"{PROBLEM_FORMAT}\": give a problem that was exported by \
             a calibration",
            value["format"]
        )));
    }
    check_version(&value, PROBLEM_FORMAT, PROBLEM_VERSION)?;
    document_of(value, PROBLEM_FORMAT)
}

/// Reads the centres of a problem; none if only poses are estimated.
fn read_problem_centers(path: &Path) -> Result<Vec<MicroImageCenter>> {
    if read_text(path)?.trim_end().lines().count() == 1 {
        Ok(Vec::new())
    } else {
        read_centers(path)
    }
}

/// Stages `problem.json` (the cost and the board), `camera.json` and `poses.json` (the start), `features.csv` and `centers.csv`
/// (the observations).
pub fn stage_problem(output: &mut OutputFolder, problem: &SolvedProblem) -> Result<()> {
    output.stage_json(PROBLEM, &problem_document(problem))?;
    output.stage_json("camera.json", &camera_document(&problem.camera, None))?;
    output.stage_json("poses.json", &poses_document(&problem.poses, None, &BTreeSet::new()))?;
    output.stage("features.csv", |out| write_problem_features(out, &problem.features))?;
    output.stage("centers.csv", |out| write_problem_centers(out, &problem.centers))
}

/// Returns the content of `problem.json`.
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

// Both files have all digits of σ, so that other programs find the same cost.

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
