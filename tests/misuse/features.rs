//! Features that are not those of the camera or the board: `calibrate --mode poses-only`, and `points` of features.

use std::fs;

use crate::base::{BASE, Row, Scratch, arguments, own_camera, own_features, poses_only};
use crate::{Case, Expected, case};
use Expected::{Refused, Right, Told};

/// A change of a row, by its number.
type Change = fn(usize, &mut Row);

fn changed(scratch: &Scratch, change: impl Fn(usize, &mut Row)) -> String {
    let content = fs::read_to_string(BASE.features("evaluation")).expect("there are features");
    scratch.table(&content, change)
}

fn more(row: &mut Row, name: &str, by: f64) {
    let value = row.get(name) + by;
    row.set(name, value);
}

/// What is wrong with features, how they are made, and what has to come of poses and of points.
#[allow(clippy::too_many_lines)] // a table
fn changes() -> Vec<(&'static str, Change, Expected, Expected)> {
    let indices = Refused(&["do not belong together", "outside", "array"]);
    let scatter = Told(&["[scatter]", "[bad-fit]", "[squares-contradicted]", "[corners-scatter]"]);
    vec![
        ("u and v exchanged", |_, r| r.swap("u", "v"), indices, Told(&["[corners-scatter]"])),
        (
            "k and l exchanged",
            |_, r| r.swap("k", "l"),
            indices,
            Expected::Told(&["[corners-scatter]"]),
        ),
        (
            "k from 1",
            |_, r| {
                let k = r.get("k") + 1.0;
                r.set("k", k);
            },
            Refused(&["outside the array"]),
            Told(&["[outside-array]"]),
        ),
        (
            "l from 1",
            |_, r| {
                let l = r.get("l") + 1.0;
                r.set("l", l);
            },
            Refused(&["outside the array", "do not belong together"]),
            Told(&["[corners-scatter]"]),
        ),
        (
            "pixels from 1",
            |_, r| {
                more(r, "u", 1.0);
                more(r, "v", 1.0);
            },
            Right,
            Right,
        ),
        (
            "u in half pixels",
            |_, r| {
                let u = 2.0 * r.get("u");
                r.set("u", u);
            },
            indices,
            scatter,
        ),
        (
            "u mirrored",
            |_, r| {
                let u = 999.0 - r.get("u");
                r.set("u", u);
            },
            indices,
            scatter,
        ),
        (
            "noise of 1 px",
            |i, r| {
                let n = (i * 7919 % 200) as f64 / 100.0 - 1.0;
                more(r, "u", n);
            },
            scatter,
            scatter,
        ),
        (
            "every tenth u off by 5 px",
            |i, r| {
                if i % 10 == 0 {
                    more(r, "u", 5.0);
                }
            },
            Told(&["[outlying-features]", "[scatter]"]),
            Right,
        ),
        (
            "u rounded to pixels",
            |_, r| {
                let u = r.get("u").round();
                r.set("u", u);
            },
            scatter,
            scatter,
        ),
        (
            "corners counted by columns",
            |_, r| {
                let c = r.get("cluster");
                let (row, column) = ((c / 8.0).floor(), c % 8.0);
                r.set("cluster", column * 5.0 + row);
            },
            Refused(&["column by column"]),
            Right,
        ),
        (
            "corner numbers from 1",
            |_, r| {
                let c = r.get("cluster") + 1.0;
                r.set("cluster", c);
            },
            Refused(&["corner 40", "corner"]),
            Right,
        ),
        (
            "a corner number of 1000",
            |i, r| {
                if i == 3 {
                    r.set("cluster", 1000);
                }
            },
            Refused(&["1000"]),
            Right,
        ),
        (
            "all one frame",
            |_, r| r.set("frame", 0),
            Refused(&["given twice"]),
            Told(&["[corners-scatter]"]),
        ),
        (
            "a frame for each feature",
            |i, r| r.set("frame", i),
            Refused(&["at least 4"]),
            Refused(&["no point"]),
        ),
        ("frames negative", |_, r| r.set("frame", -1), Refused(&["frame"]), Refused(&["frame"])),
        (
            "u not a number",
            |i, r| {
                if i == 5 {
                    r.set("u", "NaN");
                }
            },
            Refused(&["line 7", "u"]),
            Refused(&["line 7", "u"]),
        ),
        (
            "u infinite",
            |i, r| {
                if i == 5 {
                    r.set("u", "inf");
                }
            },
            Refused(&["line 7", "u"]),
            Refused(&["line 7", "u"]),
        ),
        (
            "u a word",
            |i, r| {
                if i == 5 {
                    r.set("u", "left");
                }
            },
            Refused(&["line 7", "u"]),
            Refused(&["line 7", "u"]),
        ),
        (
            "k = -1",
            |i, r| {
                if i == 5 {
                    r.set("k", -1);
                }
            },
            Refused(&["k"]),
            Told(&["[outside-array]"]),
        ),
        (
            "k = 2000000000",
            |i, r| {
                if i == 5 {
                    r.set("k", 2_000_000_000);
                }
            },
            Refused(&["k", "2000000000"]),
            Told(&["[outside-array]"]),
        ),
        (
            "sigma of 0",
            |_, r| r.set("std_u", 0),
            Refused(&["std_u", "standard deviation"]),
            Refused(&["std_u", "standard deviation"]),
        ),
        (
            "sigma negative",
            |_, r| r.set("std_u", -0.1),
            Refused(&["std_u", "standard deviation"]),
            Refused(&["std_u", "standard deviation"]),
        ),
        (
            "sigma a hundredth",
            |_, r| {
                let (u, v) = (r.get("std_u") / 100.0, r.get("std_v") / 100.0);
                r.set("std_u", u);
                r.set("std_v", v);
            },
            Told(&["[scatter]"]),
            Told(&["[corners-scatter]"]),
        ),
        (
            "rho of the other sign",
            |_, r| {
                let rho = -r.get("rho");
                r.set("rho", rho);
            },
            Told(&["[blur-contradicted]", "[unexplained-blur]"]),
            Right,
        ),
        (
            "rho halved",
            |_, r| {
                let rho = 0.5 * r.get("rho");
                r.set("rho", rho);
            },
            Told(&["[blur-contradicted]"]),
            Right,
        ),
    ]
}

pub fn cases() -> Vec<Case> {
    let mut all = Vec::new();
    for (name, change, poses, points) in changes() {
        all.push(case(format!("poses-only: {name}"), poses, move |s| {
            poses_only(&own_camera(), &changed(s, change), &[])
        }));
        // Points of corners have their own distances: only what is told or refused counts.
        if !matches!(points, Right) {
            all.push(case(format!("points of features: {name}"), points, move |s| {
                arguments(&["points", &own_camera(), &changed(s, change)])
            }));
        }
    }
    let set = |name: &'static str, value: &'static str, expected| {
        case(format!("poses-only: {name}"), expected, move |_| {
            poses_only(&own_camera(), &own_features("evaluation"), &["--set", value])
        })
    };
    let squares = Told(&["[squares-contradicted]"]);
    all.extend([
        set("squares 1 % too large", "board.square_mm=3.03", squares),
        set("squares 1 % too small", "board.square_mm=2.97", squares),
        set("squares 0.5 % too large", "board.square_mm=3.015", squares),
        set("squares in inches", "board.square_mm=0.118", Refused(&["no frame could be used"])),
        set(
            "squares in metres",
            "board.square_mm=0.003",
            Refused(&["no frame could be used", "square"]),
        ),
        set("squares of 0", "board.square_mm=0", Refused(&["square_mm"])),
        set("a board of 9 x 5", "board.columns=9", Refused(&["no frame could be used"])),
        set("a board of 5 x 8", "board.columns=5", Refused(&["corner"])),
        set("a board of 2 x 2", "board.rows=2", Refused(&["corner"])),
    ]);
    all
}
