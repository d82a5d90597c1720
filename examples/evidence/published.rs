//! The published observations of R12-A.

use std::path::{Path, PathBuf};

use plenocal::assessment::{assess, cross_validate};
use plenocal::calibration::{
    BoardModel, Calibration, CalibrationOptions, Pitches, Priors, SLOPE, Start, calibrate,
};
use plenocal::io::{
    CameraSource, read_board, read_camera_source, read_centers, read_features,
    read_internal_parameters,
};
use plenocal::model::{Board, Observations, Parameter, optics};
use plenocal::quantity::fixed;
use plenocal::{Error, Estimate, Result};

use crate::R12A;
use crate::sets::{Extent, step};
use crate::text::{Table, signed};

struct Data {
    start: Start,
    board: Board,
    observations: Observations,
}

impl Data {
    /// Reads the observations, with the features of a file.
    fn read(features: &str) -> Result<Self> {
        let folder = PathBuf::from(std::env::var_os(R12A).unwrap_or_default());
        let at = |name: &str| folder.join(name);
        let mut observations = read_features(&at(features), true)?;
        // The binary file has the centres too.
        if observations.centers.is_empty() {
            observations.centers = read_centers(&at("center-R12-A.csv"))?;
        }
        Ok(Self { start: start(&folder)?, board: read_board(&at("scene.js"))?, observations })
    }

    fn calibrated(&self, options: &CalibrationOptions) -> Result<Calibration> {
        calibrate(&self.start, &self.board, &self.observations, options, &mut |_| true)
    }
}

fn start(folder: &Path) -> Result<Start> {
    let path = folder.join("camera.js");
    let CameraSource::Datasheet(sheet) = read_camera_source(&path)? else {
        return Err(Error::invalid("it is not a datasheet").in_file(&path));
    };
    let pixel = Some(sheet.sensor.pixel_size_mm);
    Ok(Start::Datasheet(sheet, read_internal_parameters(&folder.join("params.js"), pixel)?))
}

/// Makes all tables.
pub fn tables(_: &Extent) -> Result<Vec<String>> {
    let [csv, binary] = ["bap-R12-A.csv", "linked-observations-R12-A.bin.gz"].map(Data::read);
    let (csv, binary) = (csv?, binary?);
    let paper = CalibrationOptions::paper();
    let with_priors = CalibrationOptions { priors: Priors::default(), ..paper.clone() };
    step("without and with priors");
    let plain = csv.calibrated(&paper)?;
    let priors = csv.calibrated(&with_priors)?;
    let minimum = minimum(&csv, &binary, &plain)?;
    step("without each of the frames");
    let Data { start, board, observations } = &csv;
    let folds = plain.poses.len();
    let without = cross_validate(start, board, observations, &paper, folds, &|| ())?;
    step("other models");
    Ok(vec![
        minimum,
        parameters(&plain, &priors, &without.jackknife_std_devs()),
        results(&priors),
        variants(&csv, &plain, &priors)?,
    ])
}

fn minimum(csv: &Data, binary: &Data, plain: &Calibration) -> Result<String> {
    let two = CalibrationOptions { pitches: Pitches::Two, ..CalibrationOptions::paper() };
    let one = CalibrationOptions::paper();
    let each = csv.calibrated(&two)?;
    let cost = |calibration: &Calibration| fixed(calibration.refinement.cost, 4);
    let mut table = Table::new(&["`--method paper`", "one pitch", "one pitch per axis"]);
    table.row(["cost, CSV files".to_owned(), cost(plain), cost(&each)]);
    let more = [cost(&binary.calibrated(&one)?), cost(&binary.calibrated(&two)?)];
    let name = "cost, `.bin.gz` (the same data, more digits)".to_owned();
    table.row([name].into_iter().chain(more));
    let rmse = |calibration: &Calibration| {
        let rmse = calibration.reprojection.rmse();
        let centers = calibration.reprojection.centers_rmse_px();
        let all = [Some(rmse.all_px), Some(rmse.uv_px), rmse.rho_px, centers];
        all.map(|px| px.map_or("-".to_owned(), |px| fixed(px, 4))).join("; ")
    };
    let name = "RMSE all; (u, v); ρ; centres, px".to_owned();
    table.row([name, rmse(plain), rmse(&each)]);
    let focal_length = |calibration| estimate(calibration, "F").0.to_string();
    table.row(["F, mm".to_owned(), focal_length(plain), focal_length(&each)]);
    Ok(table.text())
}

fn index(name: &str) -> usize {
    let all = Parameter::intrinsic(3);
    all.iter().position(|p| p.name() == name).expect("cameras of three types have the parameter")
}

/// Returns a parameter, and its σ if errors are independent.
fn estimate(calibration: &Calibration, name: &str) -> (Estimate, f64) {
    let (i, u) = (index(name), &calibration.uncertainty);
    let std_dev = |all: Vec<Option<f64>>| all[i].unwrap_or(f64::NAN);
    let value = calibration.camera.intrinsics()[i];
    let found = Estimate::new(value, std_dev(u.intrinsic_std_devs(3)));
    (found, std_dev(u.independent_std_devs(3)))
}

/// Row: symbol, parameter, unit, factor to the unit, and the value of Noury et al. in the paper.
const ROWS: [(&str, &str, &str, f64, &str); 9] = [
    ("F", "F", "mm", 1.0, "54.888"),
    ("D", "D", "mm", 1.0, "62.425"),
    ("d", "d", "µm", 1e3, "402.32"),
    ("ΔC", "dC", "µm", 1e3, "127.38"),
    ("f₁", "f_1", "µm", 1e3, "-"),
    ("f₂", "f_2", "µm", 1e3, "-"),
    ("f₃", "f_3", "µm", 1e3, "-"),
    ("u₀", "u0", "px", 1.0, "2289.83"),
    ("v₀", "v0", "px", 1.0, "1528.24"),
];

fn parameters(plain: &Calibration, priors: &Calibration, jackknife: &[f64]) -> String {
    let mut table = Table::new(&[
        "",
        "unit",
        "paper: Noury et al.",
        "no priors ± σ",
        "σ if independent",
        "σ by the jackknife",
        "default priors ± σ",
        "σ if independent",
    ]);
    let digits = |std_dev: f64| Estimate::new(std_dev, std_dev).text().0;
    for (symbol, name, unit, factor, paper) in ROWS {
        let of = |calibration: &Calibration| {
            let (found, independent) = estimate(calibration, name);
            [found.scaled(factor).to_string(), digits(independent * factor)]
        };
        let [found, independent] = of(plain);
        let by_frames = digits(jackknife[index(name)] * factor);
        let [with_priors, of_these] = of(priors);
        let first = [symbol, unit, paper].map(str::to_owned);
        let rest = [found, independent, by_frames, with_priors, of_these];
        table.row(first.into_iter().chain(rest));
    }
    let slope = |c: &Calibration| fixed(1e3 * optics::internal_parameters(&c.camera).m_mm, 1);
    table.row(["\\|m\\|", "µm", "", &slope(plain), "", "", &slope(priors), ""]);
    let rmse = |c: &Calibration| fixed(c.reprojection.rmse().all_px, 4);
    table.row(["RMSE", "px", "", &rmse(plain), "", "", &rmse(priors), ""]);
    table.text()
}

fn results(calibration: &Calibration) -> String {
    let mut table = Table::new(&["quantity", "prior", "result", "residual"]);
    for known in &calibration.priors {
        let quantity = known.prior.quantity.as_str();
        let (name, factor, decimals) = match quantity {
            "F" => ("F, mm", 1.0, 2),
            SLOPE => ("\\|m\\|, µm", 1e3, 1),
            "u0" => ("u₀, px", 1.0, 0),
            "v0" => ("v₀, px", 1.0, 0),
            other => (other, 1.0, 4),
        };
        let residual = known.normalised_residual();
        let text = format!("{} σ", signed(residual, 1));
        table.row([
            name.to_owned(),
            Estimate::new(known.prior.value, known.prior.std_dev).scaled(factor).to_string(),
            fixed(known.result * factor, decimals),
            if residual.abs() > 3.0 { format!("**{text}**") } else { text },
        ]);
    }
    table.text()
}

/// Other models of the camera and of the board.
fn variants(data: &Data, plain: &Calibration, priors: &Calibration) -> Result<String> {
    let flat = CalibrationOptions { board: BoardModel::Flat, ..CalibrationOptions::default() };
    let none = Priors { default: false, ..Priors::default() };
    let unknown = CalibrationOptions { priors: none, ..flat.clone() };
    let [flat, unknown, default] =
        [flat, unknown, CalibrationOptions::default()].map(|options| data.calibrated(&options));
    let mut table = Table::new(&[
        "model",
        "F, mm",
        "\\|m\\|, µm",
        "u₀, px",
        "e_z, mm",
        "D, mm",
        "d, µm",
        "verdict",
    ]);
    for (name, calibration) in [
        ("paper, no priors", plain),
        ("paper, default priors", priors),
        ("exit pupil and field curvature, flat board", &flat?),
        ("the same, no priors", &unknown?),
        ("also the shape of the board (default)", &default?),
    ] {
        let of = |name: &str, factor: f64| {
            let (found, _) = estimate(calibration, name);
            let found = if found.std_dev.is_nan() { Estimate::exact(found.value) } else { found };
            found.scaled(factor).to_string()
        };
        table.row([
            name.to_owned(),
            of("F", 1.0),
            fixed(1e3 * optics::internal_parameters(&calibration.camera).m_mm, 1),
            of("u0", 1.0),
            of("e_z", 1.0),
            of("D", 1.0),
            of("d", 1e3),
            assess(calibration, &data.board)?.verdict.to_string(),
        ]);
    }
    Ok(table.text())
}
