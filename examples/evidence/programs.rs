//! Tables that slow tests and benchmarks print.

use std::process::{Command, Stdio};

use plenocal::{Error, Result};

use crate::sets::{Extent, step};
use crate::text::Table;

/// Runs cargo, and returns what it prints.
fn cargo(arguments: &[&str]) -> Result<String> {
    step(&format!("cargo {}", arguments.join(" ")));
    let output = Command::new(std::env::var_os("CARGO").unwrap_or("cargo".into()))
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .args(arguments)
        .stderr(Stdio::inherit())
        .output()
        .map_err(|error| Error::invalid(format!("cargo: {error}")))?;
    let printed = String::from_utf8_lossy(&output.stdout).into_owned();
    if output.status.success() { Ok(printed) } else { Err(Error::invalid(printed)) }
}

/// Runs a slow test, and returns the rows of the table that it prints, cell by cell.
fn rows_of_test(name: &str) -> Result<Vec<Vec<String>>> {
    let of_test =
        ["test", "--release", "--test", "it", "--", "--ignored", "--nocapture", "--exact"];
    let printed = cargo(&[&of_test[..], &[name]].concat())?;
    // The name of the test may stand before the first row.
    let rows = printed.lines().filter_map(|line| {
        let (_, row) = line.trim_end().strip_suffix('|')?.split_once('|')?;
        Some(row.split('|').map(|cell| cell.trim().to_owned()).collect())
    });
    let rows: Vec<Vec<String>> = rows.collect();
    if rows.is_empty() {
        return Err(Error::invalid(format!("the test {name} printed no table")));
    }
    Ok(rows)
}

/// Scatter of the shape of boards over its σ.
pub fn board(_: &Extent) -> Result<Vec<String>> {
    let mut table = Table::new(&[
        "board",
        "sag_x",
        "sag_y",
        "twist",
        "aspect",
        "bend, aspect found",
        "error of d, %",
    ]);
    rows_of_test("board_scatter::monte_carlo_of_boards")?.iter().for_each(|row| table.row(row));
    Ok(vec![table.text()])
}

/// Scatter of the parameters over their σ.
pub fn standard_deviations(_: &Extent) -> Result<Vec<String>> {
    let of = |test: &str| rows_of_test(&format!("uncertainty::monte_carlo_of_{test}"));
    let independent = of("independent_errors_weights_and_priors")?;
    let shared = of("errors_that_frames_share")?;
    let mut table = Table::new(&[
        "",
        "independent errors: σ",
        "if independent",
        "shared errors: σ",
        "if independent",
    ]);
    for row in &independent {
        let other = shared.iter().find(|other| other[0] == row[0]);
        let other = other.ok_or_else(|| Error::invalid(format!("{} is not in both", row[0])))?;
        table.row(row.iter().chain(&other[1..]));
    }
    Ok(vec![table.text()])
}

/// Speed against a plain Ceres program.
pub fn ceres(_: &Extent) -> Result<Vec<String>> {
    let printed = cargo(&["bench", "--bench", "calibration"])?;
    // Without the plain program, the benchmark says what to set.
    if printed.lines().any(|line| line.starts_with('|')) {
        Ok(vec![printed])
    } else {
        Err(Error::invalid(printed))
    }
}

/// How the time grows with the work.
pub fn growth(_: &Extent) -> Result<Vec<String>> {
    Ok(vec![cargo(&["bench", "--bench", "scaling"])?])
}
