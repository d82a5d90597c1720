//! Observations as CSV: `k,l,u,v` for micro-image centres and `k,l,u,v,rho,cluster,frame` for BAP features, u, v and ρ in px,
//! as in COMPOTE's files. Standard deviations, px, may follow: `std_dev` of centres, `std_u`, `std_v` and `std_rho` of
//! features. `blur`, `std_blur`, `shared_blur` and `aperture_ratio` of features are their [`BapFeature::blur`], and columns
//! such as `du_pupil` and `dv_pupil` their [`BapFeature::sensitivities_px`]. Columns are found by their names in the first
//! line; others are ignored. Gzip-compressed files are COMPOTE's binary form.

use std::io::{self, Write};
use std::path::Path;

use csv::{ReaderBuilder, StringRecord, Trim};
use nalgebra::Point3;

use super::spelling::meant;
use super::{compote, not_utf8, read_bytes};
use crate::calibration::ProblemFeature;
use crate::error::{Error, Observed, Result};
use crate::model::{
    BapFeature, Board, MeasuredBlur, MicroImageCenter, Observations, TAKEN, check_aperture_ratio,
    taken,
};
use crate::quantity::Estimate;
use crate::solver::{MicroPixel, VirtualPoint};

/// Reads micro-image centres from CSV.
pub fn read_centers(path: &Path) -> Result<Vec<MicroImageCenter>> {
    let bytes = read_bytes(path)?;
    if compote::is_linked_observations(&bytes) {
        return Ok(compote::linked_observations(&bytes).map_err(|e| e.in_file(path))?.centers);
    }
    rows(path, &bytes, &["k", "l", "u", "v"], &["std_dev"], |row| {
        Ok(MicroImageCenter {
            k: row.integer("k")?,
            l: row.integer("l")?,
            u_px: row.number("u")?,
            v_px: row.number("v")?,
            std_dev_px: row.std_dev("std_dev")?,
        })
    })
}

/// Reads BAP features from CSV, or features and centres from COMPOTE's binary form.
///
/// With `rho` false the column `rho` may be missing.
pub fn read_features(path: &Path, rho: bool) -> Result<Observations> {
    let bytes = read_bytes(path)?;
    if compote::is_linked_observations(&bytes) {
        return compote::linked_observations(&bytes).map_err(|e| e.in_file(path));
    }
    let mut required = vec!["k", "l", "u", "v", "cluster", "frame"];
    required.extend(rho.then_some("rho"));
    let optional = optional_of_features();
    let features = rows(path, &bytes, &required, &optional, feature)?;
    Ok(Observations { features, ..Observations::default() })
}

fn optional_of_features() -> Vec<&'static str> {
    ["rho", "std_u", "std_v", "std_rho", CORRELATION]
        .into_iter()
        .chain(BLUR)
        .chain(SENSITIVITIES.into_iter().flatten())
        .collect()
}

fn feature(row: &Row) -> Result<BapFeature> {
    Ok(BapFeature {
        k: row.integer("k")?,
        l: row.integer("l")?,
        u_px: row.number("u")?,
        v_px: row.number("v")?,
        corner: row.integer("cluster")?,
        frame: row.integer("frame")?,
        rho_px: row.measured("rho")?,
        std_dev_px: match (row.std_dev("std_u")?, row.std_dev("std_v")?) {
            (Some(u), Some(v)) => Some([u, v]),
            (None, None) => None,
            _ => return Err(row.error("std_u and std_v are needed together, but one is missing")),
        },
        correlation: row.correlation()?,
        rho_std_dev_px: row.std_dev("std_rho")?,
        sensitivities_px: row.sensitivities()?,
        blur: row.blur()?,
    })
}

/// Reads the features of a problem with the positions of their corners, mm, which have to agree with its board.
pub(super) fn read_problem_features(path: &Path, board: &Board) -> Result<Vec<ProblemFeature>> {
    let bytes = read_bytes(path)?;
    let required = ["frame", "x", "y", "z", "k", "l", "u", "v", "cluster"];
    rows(path, &bytes, &required, &optional_of_features(), |row| {
        let feature = feature(row)?;
        let place = [row.number("x")?, row.number("y")?, row.number("z")?];
        let board_point_mm = board.point_mm(feature.corner);
        let off_mm = (Point3::from(place) - board_point_mm).norm();
        let on_board = (0..board.corners()).contains(&feature.corner);
        if !on_board || off_mm > SAME_CORNER * board.square_mm {
            return Err(row.error(&format!(
                "corner {} is at ({}, {}, {}) mm, which is not its position on the board in \
                 problem.json: only problems with the corners of this board are evaluated",
                feature.corner, place[0], place[1], place[2]
            )));
        }
        let [u, v] = feature.std_dev_px.unwrap_or([1.0; 2]);
        let std_dev_px = [u, v, feature.rho_std_dev_px.unwrap_or(1.0)];
        Ok(ProblemFeature { feature, board_point_mm, std_dev_px })
    })
}

/// Largest difference between equal corners, as a fraction of a square.
const SAME_CORNER: f64 = 1e-6;

/// Reads points at virtual depths: CSV with the columns k, l, u, v and nu and, if known, std_u, std_v and std_nu; `std_dev`
/// replaces a missing σ.
pub(super) fn read_virtual_rows(
    path: &Path,
    bytes: &[u8],
    std_dev: [f64; 3],
) -> Result<Vec<VirtualPoint>> {
    let optional = ["std_u", "std_v", "std_nu"];
    rows(path, bytes, &["k", "l", "u", "v", "nu"], &optional, |row| {
        let own = |i: usize| -> Result<f64> { Ok(row.std_dev(optional[i])?.unwrap_or(std_dev[i])) };
        Ok(VirtualPoint {
            at: MicroPixel {
                k: row.integer("k")?,
                l: row.integer("l")?,
                u_px: row.number("u")?,
                v_px: row.number("v")?,
            },
            virtual_depth: row.number("nu")?,
            std_dev: [own(0)?, own(1)?, own(2)?],
        })
    })
}

// Numbers are written with all digits, so that a calibration from files is identical to one within a run.

/// Writes micro-image centres as CSV, with their standard deviations if they have any.
pub fn write_centers(out: &mut dyn Write, centers: &[MicroImageCenter]) -> io::Result<()> {
    let measured = centers.iter().any(|c| c.std_dev_px.is_some());
    writeln!(out, "k,l,u,v{}", if measured { ",std_dev" } else { "" })?;
    centers.iter().try_for_each(|c| {
        write!(out, "{},{},{},{}", c.k, c.l, c.u_px, c.v_px)?;
        if measured { writeln!(out, ",{}", std_dev_text(c.std_dev_px)) } else { writeln!(out) }
    })
}

/// Least σ, px or virtual depth: the weight of a smaller one overflows.
const LEAST_STD_DEV: f64 = 1e-9;

/// Column of [`BapFeature::correlation`].
const CORRELATION: &str = "corr_uv";

/// Columns of [`BapFeature::sensitivities_px`], u and v.
const SENSITIVITIES: [[&str; 2]; TAKEN] = [
    ["du_pupil", "dv_pupil"],
    ["du_intercept", "dv_intercept"],
    ["du_fall_off", "dv_fall_off"],
    ["du_aperture_ratio", "dv_aperture_ratio"],
    ["du_point_spread", "dv_point_spread"],
    ["du_aberration_1", "dv_aberration_1"],
    ["du_aberration_2", "dv_aberration_2"],
    ["du_aberration_3", "dv_aberration_3"],
    ["du_aberration_4", "dv_aberration_4"],
    ["du_aberration_5", "dv_aberration_5"],
];

/// Columns of [`BapFeature::blur`].
const BLUR: [&str; 4] = ["blur", "std_blur", "shared_blur", "aperture_ratio"];

/// Writes BAP features as CSV, with their standard deviations and sensitivities if they have any.
pub fn write_features(out: &mut dyn Write, features: &[BapFeature]) -> io::Result<()> {
    let measured = |f: &BapFeature| f.std_dev_px.is_some() || f.rho_std_dev_px.is_some();
    let measured = features.iter().any(measured);
    let std_devs = if measured { ",std_u,std_v,std_rho" } else { "" };
    let correlated = measured && features.iter().any(|f| f.correlation != 0.0);
    let correlation = if correlated { format!(",{CORRELATION}") } else { String::new() };
    let with_sensitivities = features.iter().any(|f| f.sensitivities_px.is_some());
    let sensitivities = if with_sensitivities {
        format!(",{}", SENSITIVITIES.as_flattened().join(","))
    } else {
        String::new()
    };
    let with_blur = features.iter().any(|f| f.blur.is_some());
    let blur = if with_blur { format!(",{}", BLUR.join(",")) } else { String::new() };
    writeln!(out, "k,l,u,v,rho,cluster,frame{std_devs}{correlation}{blur}{sensitivities}")?;
    features.iter().try_for_each(|f| {
        let rho = f.rho_px.map(|rho| rho.to_string()).unwrap_or_default();
        write!(out, "{},{},{},{},{rho},{},{}", f.k, f.l, f.u_px, f.v_px, f.corner, f.frame)?;
        if measured {
            let [u, v] = [0, 1].map(|i| std_dev_text(f.std_dev_px.map(|std_devs| std_devs[i])));
            write!(out, ",{u},{v},{}", std_dev_text(f.rho_std_dev_px))?;
        }
        if correlated {
            write!(out, ",{}", f.correlation)?;
        }
        if with_blur {
            match &f.blur {
                Some(MeasuredBlur { radius_px, std_dev_px, shared_px, aperture_ratio }) => {
                    write!(out, ",{radius_px},{std_dev_px},{shared_px},{aperture_ratio}")?;
                }
                None => write!(out, ",,,,")?,
            }
        }
        for sensitivity in f
            .sensitivities_px
            .unwrap_or_default()
            .as_flattened()
            .iter()
            .filter(|_| with_sensitivities)
        {
            let text = f.sensitivities_px.map(|_| sensitivity.to_string()).unwrap_or_default();
            write!(out, ",{text}")?;
        }
        writeln!(out)
    })
}

/// Formats a standard deviation; an empty text if it was not measured.
pub(super) fn std_dev_text(std_dev: Option<f64>) -> String {
    std_dev.map(|s| s.to_string()).unwrap_or_default()
}

struct Row<'a> {
    path: &'a Path,
    line: u64,
    record: &'a StringRecord,
    /// Columns by name.
    columns: &'a [(&'static str, usize)],
}

impl Row<'_> {
    fn error(&self, message: &str) -> Error {
        Error::content(self.path, format!("line {}: {message}", self.line))
    }

    /// Returns the text in a column; `None` if there is no such column, or it is empty.
    fn text(&self, name: &str) -> Option<&str> {
        let (_, column) = self.columns.iter().find(|(column, _)| *column == name)?;
        self.record.get(*column).filter(|text| !text.is_empty())
    }

    fn field<T: std::str::FromStr>(&self, name: &str, what: &str) -> Result<T> {
        let text = self.text(name).unwrap_or_default();
        let decimals = if text.contains(',') { ": write decimals with points" } else { "" };
        text.parse().map_err(|_| self.error(&format!("{name} is '{text}', not {what}{decimals}")))
    }

    fn integer<T: std::str::FromStr>(&self, name: &str) -> Result<T> {
        self.field(name, "a whole number in range")
    }

    fn number(&self, name: &str) -> Result<f64> {
        let value: f64 = self.field(name, "a number")?;
        if value.is_finite() {
            return Ok(value);
        }
        Err(self.error(&format!("{name} is {value}, but has to be a finite number")))
    }

    /// Reads a number; `None` if it was not measured.
    fn measured(&self, name: &str) -> Result<Option<f64>> {
        self.text(name).map(|_| self.number(name)).transpose()
    }

    /// Reads all sensitivities; `None` if there are none. Files of older versions have none to aberrations, which are 0 then.
    fn sensitivities(&self) -> Result<Option<[[f64; 2]; TAKEN]>> {
        let mut sensitivities = [[0.0; 2]; TAKEN];
        let (whites, aberrations) = SENSITIVITIES.split_at(taken::ABERRATIONS);
        let mut missing = [0; 2];
        for (i, name) in SENSITIVITIES.as_flattened().iter().enumerate() {
            match self.measured(name)? {
                Some(value) => sensitivities.as_flattened_mut()[i] = value,
                None => missing[usize::from(i >= 2 * whites.len())] += 1,
            }
        }
        let all = [whites, aberrations].map(|names| 2 * names.len());
        match missing {
            [0, aberrations] if aberrations == 0 || aberrations == all[1] => {
                Ok(Some(sensitivities))
            }
            missing if missing == all => Ok(None),
            _ => Err(self.error(&format!(
                "the columns {} are needed together, but some are missing: detect the boards again \
                 if an older version wrote the file; otherwise remove all of these columns",
                SENSITIVITIES.as_flattened().join(", ")
            ))),
        }
    }

    /// Reads the measured blur radius; `None` if there is none.
    fn blur(&self) -> Result<Option<MeasuredBlur>> {
        let [blur, std_dev, shared, ratio] = BLUR;
        let std_dev = self.std_dev(std_dev)?;
        match (self.measured(blur)?, std_dev, self.measured(shared)?, self.measured(ratio)?) {
            (Some(radius_px), Some(std_dev_px), Some(shared_px), Some(aperture_ratio)) => {
                check_aperture_ratio(&Estimate::exact(aperture_ratio))
                    .map_err(|e| self.error(&e.to_string()))?;
                Ok(Some(MeasuredBlur { radius_px, std_dev_px, shared_px, aperture_ratio }))
            }
            (None, None, None, None) => Ok(None),
            _ => Err(self.error(&format!(
                "the columns {} are needed together, but one is missing: detect the boards again \
                 if an older version wrote the file; otherwise remove all of these columns",
                BLUR.join(", ")
            ))),
        }
    }

    /// Reads the correlation of u and v; 0 if it was not measured.
    fn correlation(&self) -> Result<f64> {
        match self.measured(CORRELATION)? {
            Some(value) if value.abs() >= 1.0 => {
                Err(self
                    .error(&format!("{CORRELATION} is {value}, but has to lie between -1 and 1")))
            }
            value => Ok(value.unwrap_or(0.0)),
        }
    }

    fn std_dev(&self, name: &str) -> Result<Option<f64>> {
        match self.measured(name)? {
            Some(value) if value <= 0.0 => Err(self.error(&format!(
                "{name} is {value}, but a standard deviation has to be positive; leave it empty if \
                 it was not measured"
            ))),
            Some(value) if value < LEAST_STD_DEV => Err(self.error(&format!(
                "{name} is {value}, but a standard deviation has to be at least {LEAST_STD_DEV}; \
                 leave it empty if it was not measured"
            ))),
            value => Ok(value),
        }
    }
}

/// Returns a column whose name differs from a missing one by a letter or two: it would be ignored silently.
fn misspelt(
    header: &StringRecord,
    columns: &[(&str, usize)],
    known: &[&'static str],
) -> Option<(String, &'static str)> {
    let is_there = |name: &str| columns.iter().any(|(column, _)| *column == name);
    header.iter().filter(|found| !is_there(found)).find_map(|found| {
        let absent = known.iter().copied().filter(|name| !is_there(name));
        meant(found, absent).map(|name| (found.to_owned(), name))
    })
}

/// Returns the line of an observation in its CSV file; the last one if the observation is repeated. `None` if the file is not
/// CSV or has no such line.
#[must_use]
pub fn line_of(path: &Path, observation: Observed) -> Option<u64> {
    let bytes = read_bytes(path).ok().filter(|bytes| !compote::is_linked_observations(bytes))?;
    let required: &[&'static str] = match observation {
        Observed::Center { .. } => &["k", "l"],
        Observed::Feature { .. } => &["k", "l", "cluster", "frame"],
    };
    let lines = rows(path, &bytes, required, &[], |row| {
        let (at, line) = ((row.integer("k")?, row.integer("l")?), row.line);
        Ok(match observation {
            Observed::Center { k, l } => (at == (k, l)).then_some(line),
            Observed::Feature { frame, corner, k, l } => {
                let same = at == (k, l)
                    && row.integer::<u32>("frame")? == frame
                    && row.integer::<i32>("cluster")? == corner;
                same.then_some(line)
            }
        })
    });
    lines.ok()?.into_iter().flatten().last()
}

/// Returns the current name of a column: earlier files call the aperture ratio fill factor.
fn current_name(name: &str) -> &str {
    match name {
        "fill_factor" => "aperture_ratio",
        "du_fill_factor" => "du_aperture_ratio",
        "dv_fill_factor" => "dv_aperture_ratio",
        name => name,
    }
}

/// Returns the remedy for a header whose names are not separated by commas; empty if they are.
fn other_separator(header: &StringRecord) -> &'static str {
    let one = header.get(0).filter(|_| header.len() == 1).unwrap_or_default();
    if one.contains(';') {
        ": separate the columns by commas, and write decimals with points"
    } else if one.contains(char::is_whitespace) {
        ": separate the columns by commas, not by tabs or blanks"
    } else {
        ""
    }
}

/// Describes a line that differs in format from the first one.
fn broken_row(error: &csv::Error) -> String {
    match error.kind() {
        csv::ErrorKind::UnequalLengths { pos, expected_len, len } => {
            let line = pos.as_ref().map_or(0, csv::Position::line);
            let decimals = if len > expected_len {
                ": if its numbers contain decimal commas, write decimal points"
            } else {
                ": the file may be cut off"
            };
            format!(
                "line {line} has {len} columns, but the first line names {expected_len}{decimals}"
            )
        }
        _ => error.to_string(),
    }
}

fn rows<T>(
    path: &Path,
    bytes: &[u8],
    required: &[&'static str],
    optional: &[&'static str],
    parse: impl Fn(&Row) -> Result<T>,
) -> Result<Vec<T>> {
    let text = std::str::from_utf8(bytes).map_err(|_| Error::content(path, not_utf8(bytes)))?;
    let text = text.trim_start_matches('\u{feff}'); // the byte order mark of some editors
    let mut reader = ReaderBuilder::new().trim(Trim::All).from_reader(text.as_bytes());
    let broken = |error: csv::Error| Error::content(path, broken_row(&error));
    let header: StringRecord = reader.headers().map_err(broken)?.iter().map(current_name).collect();
    let mut columns = Vec::new();
    for &name in required.iter().chain(optional) {
        let mut places = (0..header.len()).filter(|&i| &header[i] == name);
        columns.extend(places.next().map(|place| (name, place)));
        if places.next().is_some() {
            return Err(Error::content(
                path,
                format!("the first line names the column {name} twice"),
            ));
        }
    }
    if let Some((found, meant)) = misspelt(&header, &columns, &[required, optional].concat()) {
        return Err(Error::content(
            path,
            format!(
                "the first line names a column '{found}', which looks like a misspelt {meant}: \
                 correct it, or give the column a clearly different name"
            ),
        ));
    }
    let is_missing = |name: &&&str| columns.iter().all(|(column, _)| column != *name);
    let missing: Vec<&str> = required.iter().filter(is_missing).copied().collect();
    if !missing.is_empty() {
        return Err(Error::content(
            path,
            format!(
                "the first line has no column '{}'; it has to name the columns {}, but reads \
                 '{}'{}",
                missing.join("', '"),
                required.join(","),
                header.iter().collect::<Vec<_>>().join(",").chars().take(80).collect::<String>(),
                other_separator(&header)
            ),
        ));
    }
    let mut values = Vec::new();
    let mut record = StringRecord::new();
    while reader.read_record(&mut record).map_err(broken)? {
        let line = record.position().map_or(0, csv::Position::line);
        values.push(parse(&Row { path, line, record: &record, columns: &columns })?);
    }
    if values.is_empty() {
        return Err(Error::content(path, "it contains no observations"));
    }
    Ok(values)
}
