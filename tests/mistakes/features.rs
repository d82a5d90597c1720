//! Mistakes in files of observations that other programs wrote.

use std::fs;

use crate::Expected::{Refused, Right, Told, Warned};
use crate::set::Set;
use crate::{Expected, Mistake, mistake};

/// Columns of the features, as the simulation writes them.
const K: usize = 0;
const L: usize = 1;
const U: usize = 2;
const V: usize = 3;
const RHO: usize = 4;
const CORNER: usize = 5;
const FRAME: usize = 6;

type Row = Vec<String>;

/// The observations of `mini`, with their noise, to be calibrated.
fn set() -> Set {
    let set = Set::mini();
    for name in ["features.csv", "centers.csv", "project.toml"] {
        set.replace(name, &set.path().join("observed").join(name));
    }
    set.without_step().calibrated(&[])
}

/// A change of the rows of a file.
fn rows(
    name: &str,
    file: &'static str,
    expected: Expected,
    change: impl Fn(usize, &mut Row) + 'static,
) -> Mistake {
    mistake(name, expected, move || {
        let set = set();
        let text = fs::read_to_string(set.path().join(file)).expect("it is there");
        let mut lines = text.lines();
        let mut out = format!("{}\n", lines.next().unwrap_or_default());
        for (i, line) in lines.enumerate() {
            let mut row: Row = line.split(',').map(str::to_owned).collect();
            change(i, &mut row);
            if !row.is_empty() {
                out.push_str(&row.join(","));
                out.push('\n');
            }
        }
        set.write(file, out);
        set
    })
}

fn number(row: &Row, column: usize) -> f64 {
    row[column].parse().expect("a number")
}

/// A number of a row replaced by what becomes of it.
fn set_number(row: &mut Row, column: usize, to: impl Fn(f64) -> f64) {
    row[column] = to(number(row, column)).to_string();
}

pub fn mistakes() -> Vec<Mistake> {
    [of_features(), of_centers(), single()].into_iter().flatten().collect()
}

fn of_features() -> Vec<Mistake> {
    const FILE: &str = "features.csv";
    let shift = |name: &str, column: usize, by: f64, expected| {
        rows(name, FILE, expected, move |_, row| set_number(row, column, |x| x + by))
    };
    let unknown = Refused(&["features.csv"]);
    vec![
        rows("observations as they are", FILE, Right, |_, _| ()),
        rows("rho with the wrong sign", FILE, Warned(&["rho"]), |_, row| {
            set_number(row, RHO, |x| -x);
        }),
        rows("rho as a diameter", FILE, Warned(&["rho"]), |_, row| {
            set_number(row, RHO, |x| 2.0 * x);
        }),
        rows("rho in mm", FILE, Warned(&["rho"]), |_, row| set_number(row, RHO, |x| 0.0055 * x)),
        rows("no rho", FILE, Right, |_, row| row[RHO] = String::new()),
        shift("k from 1", K, 1.0, Told(&["array", "micro-image"])),
        shift("l from 1", L, 1.0, Told(&["array", "micro-image"])),
        rows("k and l swapped", FILE, Told(&["array", "micro-image"]), |_, row| row.swap(K, L)),
        rows("u and v swapped", FILE, Told(&["array", "micro-image"]), |_, row| row.swap(U, V)),
        shift("u from 1", U, 1.0, Right),
        shift("u by half a pixel", U, 0.5, Right),
        shift("corners from 1", CORNER, 1.0, unknown),
        rows("corners column by column", FILE, Told(&["corner", "labels", "board"]), |_, row| {
            set_number(row, CORNER, |c| (c % 8.0) * 5.0 + (c / 8.0).floor());
        }),
        rows("corners in reverse", FILE, Right, |_, row| set_number(row, CORNER, |c| 39.0 - c)),
        rows("corners mirrored", FILE, Right, |_, row| {
            set_number(row, CORNER, |c| 8.0 * (c / 8.0).floor() + 7.0 - c % 8.0);
        }),
        shift("frames from 1", FRAME, 1.0, Right),
        rows("all frames one", FILE, Told(&["frame"]), |_, row| row[FRAME] = "0".into()),
        rows("two frames swapped in part", FILE, Told(&["frame"]), |i, row| {
            if i % 7 == 0 && number(row, FRAME) < 2.0 {
                set_number(row, FRAME, |f| 1.0 - f);
            }
        }),
        rows("v mirrored", FILE, Told(&["micro-image"]), |_, row| {
            set_number(row, V, |v| 749.0 - v);
        }),
        rows("every feature twice", FILE, Told(&["twice"]), |_, row| {
            let again = row.join(",");
            row.push(String::new());
            let last = row.len() - 1;
            row[last - 1] = format!("{}\n{again}", row[last - 1]);
            row.pop();
        }),
        rows("rounded to whole pixels", FILE, Right, |_, row| {
            set_number(row, U, f64::round);
            set_number(row, V, f64::round);
        }),
        rows("every tenth row missing", FILE, Right, |i, row| {
            if i % 10 == 0 {
                row.clear();
            }
        }),
    ]
}

fn of_centers() -> Vec<Mistake> {
    const FILE: &str = "centers.csv";
    vec![
        rows("centres: u and v swapped", FILE, Refused(&["centers.csv", "centre"]), |_, row| {
            row.swap(2, 3);
        }),
        rows("centres: k and l swapped", FILE, Refused(&["centers.csv", "centre"]), |_, row| {
            row.swap(0, 1);
        }),
        rows("centres: shifted by 1 px", FILE, Right, |_, row| set_number(row, 2, |u| u + 1.0)),
        rows("centres: shifted by 0.3 px", FILE, Right, |_, row| set_number(row, 2, |u| u + 0.3)),
        rows("centres: scaled by 1.01", FILE, Told(&["centers.csv", "centre"]), |_, row| {
            set_number(row, 2, |u| 1.01 * u);
            set_number(row, 3, |v| 1.01 * v);
        }),
        rows("centres: one a pitch off", FILE, Right, |i, row| {
            if i == 700 {
                set_number(row, 2, |u| u + 23.0);
            }
        }),
        rows("centres: a tenth of them", FILE, Right, |i, row| {
            if i % 10 != 0 {
                row.clear();
            }
        }),
    ]
}

/// One faulty feature of some thousands.
fn single() -> Vec<Mistake> {
    let one_is = |name: &str, expected: Expected, change: fn(&mut Row)| {
        rows(name, "features.csv", expected, move |i, row| {
            if i == 1000 {
                change(row);
            }
        })
    };
    let one = |name: &str, change: fn(&mut Row)| one_is(name, Right, change);
    // What no micro-image of this array can show is refused, with its line.
    let impossible =
        |name: &str, change: fn(&mut Row)| one_is(name, Refused(&["corner", "line"]), change);
    vec![
        one("one feature of the wrong corner", |row| {
            set_number(row, CORNER, |c| (c + 17.0) % 40.0);
        }),
        one("one feature of the next corner", |row| {
            set_number(row, CORNER, |c| if c < 39.0 { c + 1.0 } else { c - 1.0 });
        }),
        one("one feature of the wrong frame", |row| set_number(row, FRAME, |f| (f + 5.0) % 10.0)),
        impossible("one feature of the wrong micro-image", |row| set_number(row, K, |k| k + 1.0)),
        one("one feature 3 px off", |row| set_number(row, U, |u| u + 3.0)),
        impossible("one feature 300 px off", |row| set_number(row, U, |u| u + 300.0)),
        impossible("one feature at 1e5 px", |row| row[U] = "99999".into()),
        one("one rho of 1000", |row| row[RHO] = "1000".into()),
        impossible("one corner 9999", |row| row[CORNER] = "9999".into()),
        impossible("one k of 500", |row| row[K] = "500".into()),
        impossible("one NaN", |row| row[V] = "nan".into()),
    ]
}
