//! Observations as CSV: `k,l,u,v` for micro-image centres and `k,l,u,v,rho,cluster,frame` for BAP
//! features, u, v and ρ in px; the same columns as COMPOTE's. Columns are found by their names in
//! the first line; others are passed over. Gzip-compressed files are COMPOTE's binary form.

use std::io::{self, Write};
use std::path::Path;

use csv::{ReaderBuilder, StringRecord, Trim};

use super::{compote, read_bytes};
use crate::detection::DetectedFeature;
use crate::error::{Error, Result};
use crate::model::{BapFeature, MicroImageCenter, Observations};

/// Reads micro-image centres from CSV.
pub fn read_centers(path: &Path) -> Result<Vec<MicroImageCenter>> {
    let bytes = read_bytes(path)?;
    if compote::is_linked_observations(&bytes) {
        return Ok(compote::linked_observations(&bytes).map_err(|e| e.in_file(path))?.centers);
    }
    rows(path, &bytes, ["k", "l", "u", "v"], |row| {
        Ok(MicroImageCenter {
            k: row.integer(0)?,
            l: row.integer(1)?,
            u_px: row.number(2)?,
            v_px: row.number(3)?,
        })
    })
}

/// Reads BAP features from CSV, or features and centres from COMPOTE's binary form.
///
/// With `rho` false the column `rho` need not be there and is not read.
pub fn read_features(path: &Path, rho: bool) -> Result<Observations> {
    let bytes = read_bytes(path)?;
    if compote::is_linked_observations(&bytes) {
        return compote::linked_observations(&bytes).map_err(|e| e.in_file(path));
    }
    let feature = |row: &Row| {
        Ok(BapFeature {
            k: row.integer(0)?,
            l: row.integer(1)?,
            u_px: row.number(2)?,
            v_px: row.number(3)?,
            corner: row.integer(4)?,
            frame: row.integer(5)?,
            rho_px: f64::NAN,
        })
    };
    let features = if rho {
        rows(path, &bytes, ["k", "l", "u", "v", "cluster", "frame", "rho"], |row| {
            Ok(BapFeature { rho_px: row.number(6)?, ..feature(row)? })
        })?
    } else {
        rows(path, &bytes, ["k", "l", "u", "v", "cluster", "frame"], feature)?
    };
    Ok(Observations { centers: Vec::new(), features })
}

/// Writes micro-image centres as CSV.
pub fn write_centers(out: &mut dyn Write, centers: &[MicroImageCenter]) -> io::Result<()> {
    writeln!(out, "k,l,u,v")?;
    centers.iter().try_for_each(|c| writeln!(out, "{},{},{},{}", c.k, c.l, c.u_px, c.v_px))
}

/// Writes BAP features as CSV.
pub fn write_features(out: &mut dyn Write, features: &[BapFeature]) -> io::Result<()> {
    writeln!(out, "k,l,u,v,rho,cluster,frame")?;
    features.iter().try_for_each(|f| {
        writeln!(out, "{},{},{},{},{},{},{}", f.k, f.l, f.u_px, f.v_px, f.rho_px, f.corner, f.frame)
    })
}

/// Writes detected features as CSV: the columns of BAP features, and the standard deviations of u, v
/// and ρ, px.
pub fn write_detected_features(
    out: &mut dyn Write,
    features: &[DetectedFeature],
) -> io::Result<()> {
    writeln!(out, "k,l,u,v,rho,cluster,frame,std_u,std_v,std_rho")?;
    features.iter().try_for_each(|detected| {
        let f = &detected.feature;
        let std_dev = |i: usize| detected.covariance[(i, i)].sqrt();
        write!(
            out,
            "{},{},{},{},{},{},{},",
            f.k, f.l, f.u_px, f.v_px, f.rho_px, f.corner, f.frame
        )?;
        writeln!(out, "{:.4},{:.4},{:.4}", std_dev(0), std_dev(1), detected.rho_std_dev_px)
    })
}

struct Row<'a> {
    path: &'a Path,
    line: u64,
    record: &'a StringRecord,
    names: &'a [&'static str],
    places: &'a [usize],
}

impl Row<'_> {
    fn field<T: std::str::FromStr>(&self, column: usize, what: &str) -> Result<T> {
        let text = &self.record[self.places[column]];
        text.parse().map_err(|_| {
            Error::content(
                self.path,
                format!("line {}: {} is '{text}', not {what}", self.line, self.names[column]),
            )
        })
    }

    fn integer<T: std::str::FromStr>(&self, column: usize) -> Result<T> {
        self.field(column, "a whole number in range")
    }

    fn number(&self, column: usize) -> Result<f64> {
        let value: f64 = self.field(column, "a number")?;
        if value.is_finite() {
            return Ok(value);
        }
        Err(Error::content(
            self.path,
            format!("line {}: {} is {value}, not a finite number", self.line, self.names[column]),
        ))
    }
}

fn rows<T, const N: usize>(
    path: &Path,
    bytes: &[u8],
    names: [&'static str; N],
    parse: impl Fn(&Row) -> Result<T>,
) -> Result<Vec<T>> {
    let mut reader = ReaderBuilder::new().trim(Trim::All).from_reader(bytes);
    let broken = |error: csv::Error| Error::content(path, error.to_string());
    let header = reader.headers().map_err(broken)?.clone();
    let place = |name: &&'static str| header.iter().position(|field| field == *name);
    if let Some(name) = names.iter().find(|name| header.iter().filter(|f| f == *name).count() > 1) {
        return Err(Error::content(path, format!("the first line names the column {name} twice")));
    }
    let places: Vec<usize> = names.iter().filter_map(place).collect();
    if places.len() < N {
        let missing: Vec<&str> = names.into_iter().filter(|n| place(n).is_none()).collect();
        return Err(Error::content(
            path,
            format!(
                "the first line has no column '{}'; it has to name the columns {}, and reads '{}'",
                missing.join("', '"),
                names.join(","),
                header.iter().collect::<Vec<_>>().join(",").chars().take(80).collect::<String>()
            ),
        ));
    }
    let mut values = Vec::new();
    let mut record = StringRecord::new();
    while reader.read_record(&mut record).map_err(broken)? {
        let line = record.position().map_or(0, csv::Position::line);
        values.push(parse(&Row { path, line, record: &record, names: &names, places: &places })?);
    }
    if values.is_empty() {
        return Err(Error::content(path, "there are no observations in it"));
    }
    Ok(values)
}
