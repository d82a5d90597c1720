//! Virtual depths of something else, or damaged: `points`.

use crate::base::{BASE, Row, arguments, own_camera};
use crate::{Case, Expected, case};
use Expected::{Clean, Refused, Right, Told};

/// A change of a row, by its number.
type Change = fn(usize, &mut Row);
/// A change of the text of a file.
type Damage = fn(&str) -> String;

fn points(input: &str, more: &[&str]) -> Vec<String> {
    arguments(&[["points", &own_camera(), input].as_slice(), more].concat())
}

#[allow(clippy::too_many_lines)] // a table
fn changes() -> Vec<(&'static str, Change, Expected)> {
    let sign = Told(&["[depths-of-other-sign]"]);
    let far = Told(&["[far-from-micro-image]"]);
    let outside = Told(&["[outside-array]"]);
    vec![
        ("as measured", |_, _| {}, Clean),
        (
            "nu of the other sign",
            |_, r| {
                let nu = -r.get("nu");
                r.set("nu", nu);
            },
            Told(&["[depths-of-other-sign]", "[beyond-boards]"]),
        ),
        (
            "one nu of 0",
            |i, r| {
                if i == 4 {
                    r.set("nu", 0);
                }
            },
            sign,
        ),
        (
            "one nu of -3",
            |i, r| {
                if i == 4 {
                    r.set("nu", -3);
                }
            },
            sign,
        ),
        (
            "nu in mm",
            |_, r| {
                let nu = 0.33 * r.get("nu");
                r.set("nu", nu);
            },
            Told(&["[beyond-boards]"]),
        ),
        (
            "nu in micrometres",
            |_, r| {
                let nu = 330.0 * r.get("nu");
                r.set("nu", nu);
            },
            Told(&["[beyond-boards]"]),
        ),
        (
            "1/nu",
            |_, r| {
                let nu = 1.0 / r.get("nu");
                r.set("nu", nu);
            },
            Told(&["[beyond-boards]"]),
        ),
        (
            "nu not a number",
            |i, r| {
                if i == 4 {
                    r.set("nu", "nan");
                }
            },
            Refused(&["line 6"]),
        ),
        (
            "nu infinite",
            |i, r| {
                if i == 4 {
                    r.set("nu", "inf");
                }
            },
            Refused(&["line 6"]),
        ),
        (
            "nu empty",
            |i, r| {
                if i == 4 {
                    r.set("nu", "");
                }
            },
            Refused(&["line 6"]),
        ),
        (
            "one k of -1",
            |i, r| {
                if i == 4 {
                    r.set("k", -1);
                }
            },
            outside,
        ),
        (
            "one k of 5000",
            |i, r| {
                if i == 4 {
                    r.set("k", 5000);
                }
            },
            outside,
        ),
        (
            "all l of 500",
            |_, r| r.set("l", 500),
            Refused(&["[outside-array]", "outside the array"]),
        ),
        (
            "one u of 9e9",
            |i, r| {
                if i == 4 {
                    r.set("u", 9e9);
                }
            },
            far,
        ),
        ("u and v exchanged", |_, r| r.swap("u", "v"), far),
        (
            "k and l exchanged",
            |_, r| r.swap("k", "l"),
            Told(&["[far-from-micro-image]", "[outside-array]"]),
        ),
        (
            "k from 1, l from 1",
            |_, r| {
                let (k, l) = (r.get("k") + 1.0, r.get("l") + 1.0);
                r.set("k", k);
                r.set("l", l);
            },
            far,
        ),
        (
            "u in mm",
            |_, r| {
                let (u, v) = (0.0055 * r.get("u"), 0.0055 * r.get("v"));
                r.set("u", u);
                r.set("v", v);
            },
            far,
        ),
        ("sigma of nu 0", |_, r| r.set("std_nu", 0), Refused(&["std_nu"])),
        (
            "sigma of nu negative",
            |_, r| r.set("std_nu", -1),
            Refused(&["std_nu", "standard deviation"]),
        ),
    ]
}

fn texts() -> Vec<(&'static str, Damage, Expected)> {
    vec![
        ("an empty file", |_| String::new(), Refused(&["table.csv"])),
        (
            "the first line alone",
            |t| t.lines().next().unwrap_or_default().to_owned(),
            Refused(&["no point", "no "]),
        ),
        ("semicolons", |t| t.replace(',', ";"), Refused(&["commas"])),
        ("tabs", |t| t.replace(',', "\t"), Refused(&["commas"])),
        (
            "no sigma",
            |t| {
                t.lines()
                    .map(|l| l.rsplit_once(',').map_or(l, |(a, _)| a).to_owned() + "\n")
                    .collect()
            },
            Told(&["[points-without-sigma]"]),
        ),
        ("no column nu", |t| t.replacen("nu,", "depth,", 1), Refused(&["nu"])),
        ("a line cut off", |t| t[..t.len() - 9].to_owned(), Refused(&["line"])),
        ("blank lines at the end", |t| format!("{t}\n\n"), Right),
        ("CRLF", |t| t.replace('\n', "\r\n"), Clean),
        ("a byte order mark", |t| format!("\u{feff}{t}"), Right),
        (
            "columns in another order",
            |t| {
                t.lines().map(|l| l.split(',').rev().collect::<Vec<_>>().join(",") + "\n").collect()
            },
            Right,
        ),
    ]
}

/// A `.npy` file.
fn npy(header: &str, data: &[u8]) -> Vec<u8> {
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    let header = format!("{header}\n");
    bytes.extend(u16::try_from(header.len()).expect("a short header").to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes.extend(data);
    bytes
}

fn maps() -> Vec<(&'static str, Vec<u8>, &'static [&'static str], Expected)> {
    let of = |kind: &str, order: &str, shape: &str| {
        format!("{{'descr': '{kind}', 'fortran_order': {order}, 'shape': {shape}, }}")
    };
    let whole = |value: f32, count: usize| -> Vec<u8> {
        std::iter::repeat_n(value.to_le_bytes(), count).flatten().collect()
    };
    let plane = whole(3.25, 1000 * 750);
    vec![
        (
            "of another size",
            npy(&of("<f4", "False", "(100, 100)"), &whole(3.0, 10_000)),
            &[],
            Refused(&["100 x 100"]),
        ),
        ("turned", npy(&of("<f4", "False", "(1000, 750)"), &plane), &[], Refused(&["750 x 1000"])),
        (
            "in Fortran order",
            npy(&of("<f4", "True", "(750, 1000)"), &plane),
            &[],
            Refused(&["Fortran"]),
        ),
        (
            "of whole numbers",
            npy(&of("<i4", "False", "(750, 1000)"), &plane),
            &[],
            Refused(&["floating-point"]),
        ),
        (
            "big-endian",
            npy(&of(">f4", "False", "(750, 1000)"), &plane),
            &[],
            Refused(&["floating-point"]),
        ),
        (
            "of three dimensions",
            npy(&of("<f4", "False", "(750, 1000, 1)"), &plane),
            &[],
            Refused(&["two dimensions"]),
        ),
        (
            "cut off",
            npy(&of("<f4", "False", "(750, 1000)"), &plane[..4000]),
            &[],
            Refused(&["as many numbers"]),
        ),
        (
            "of an endless shape",
            npy(&of("<f4", "False", "(4294967296, 4294967296)"), &[]),
            &[],
            Refused(&["as many numbers"]),
        ),
        ("without a header", b"\x93NUMPY".to_vec(), &[], Refused(&["cut off"])),
        ("of version 9", b"\x93NUMPY\x09\x00\x00\x00".to_vec(), &[], Refused(&["version"])),
        (
            "of nothing but NaN",
            npy(&of("<f4", "False", "(750, 1000)"), &whole(f32::NAN, 750_000)),
            &[],
            Refused(&["no point"]),
        ),
        (
            "of the other sign",
            npy(&of("<f4", "False", "(750, 1000)"), &whole(-3.0, 750_000)),
            &[],
            Told(&["[depths-of-other-sign]", "[beyond-boards]"]),
        ),
        (
            "without sigma",
            npy(&of("<f4", "False", "(750, 1000)"), &plane),
            &[],
            Told(&["[points-without-sigma]"]),
        ),
        (
            "of total focus, of any size",
            npy(&of("<f4", "False", "(75, 100)"), &whole(3.25, 7500)),
            &["--map", "focused", "--depth-std-dev", "0.01"],
            Right,
        ),
        (
            "a negative sigma",
            npy(&of("<f4", "False", "(750, 1000)"), &plane),
            &["--depth-std-dev", "-1"],
            Refused(&["depth-std-dev", "standard deviation", "σ"]),
        ),
    ]
}

pub fn cases() -> Vec<Case> {
    let mut all = Vec::new();
    for (name, change, expected) in changes() {
        all.push(case(format!("points: {name}"), expected, move |s| {
            let input = s.table(&BASE.depths, change);
            points(&input, &[])
        }));
    }
    for (name, change, expected) in texts() {
        all.push(case(format!("points: {name}"), expected, move |s| {
            let input = s.write("table.csv", change(&BASE.depths));
            points(&input, &[])
        }));
    }
    for (name, bytes, more, expected) in maps() {
        all.push(case(format!("points: a map {name}"), expected, move |s| {
            let input = s.write("map.npy", &bytes);
            points(&input, more)
        }));
    }
    all
}
