//! Mistakes in what the project states: the camera, the board, f-numbers, the step of the translation.

use crate::Expected::{Clean, Refused, Right, Warned};
use crate::set::Set;
use crate::{Expected, Mistake, mistake};

/// One value of a key for another.
fn value(key: &'static str, value: &'static str, expected: Expected) -> Mistake {
    mistake(format!("{key} = {value}"), expected, move || Set::mini().value(key, value))
}

pub fn mistakes() -> Vec<Mistake> {
    [sensor(), lens(), array(), board(), f_numbers(), steps(), options()]
        .into_iter()
        .flatten()
        .collect()
}

fn sensor() -> Vec<Mistake> {
    let size = Warned(&["square_mm", "pixel_size_mm"]);
    let mut all: Vec<Mistake> =
        ["0.005", "0.0053", "0.0054", "0.0056", "0.0057", "0.006", "0.0066", "0.004"]
            .into_iter()
            .map(|v| value("pixel_size_mm", v, size))
            .collect();
    all.extend(
        ["5.5", "0.000055", "0.11"].map(|v| value("pixel_size_mm", v, Refused(&["pixel_size_mm"]))),
    );
    all.extend(
        ["750", "999", "2000", "1001"]
            .map(|v| value("width_px", v, Refused(&["width_px", "1000"]))),
    );
    all.extend(["749", "1000"].map(|v| value("height_px", v, Refused(&["height_px", "750"]))));
    all
}

fn lens() -> Vec<Mistake> {
    let focal = Warned(&["focal_length_mm", "focal length"]);
    let mut all = Vec::new();
    all.extend(["15", "15.5", "16.5", "17", "18"].map(|v| value("focal_length_mm", v, Right)));
    all.extend(["8", "10", "12", "14", "20", "24"].map(|v| value("focal_length_mm", v, focal)));
    all.extend(["35", "50", "160", "1600"].map(|v| value("focal_length_mm", v, Refused(&["4 F"]))));
    let no_lens = Refused(&["focal_length_mm", "focal length"]);
    all.extend(["0.016", "1.6"].map(|v| value("focal_length_mm", v, no_lens)));
    all.extend(["100", "110", "130", "150"].map(|v| value("focus_distance_mm", v, Right)));
    let focus = Warned(&["focus_distance_mm", "focus distance"]);
    all.extend(["80", "200", "400", "1000", "inf"].map(|v| value("focus_distance_mm", v, focus)));
    all.extend(
        ["12", "1.2", "0.12"].map(|v| {
            value("focus_distance_mm", v, Refused(&["focus_distance_mm", "focus distance"]))
        }),
    );
    all
}

fn array() -> Vec<Mistake> {
    let mut all = Vec::new();
    all.extend(["44", "86", "70"].map(|v| value("columns", v, Right)));
    all.extend(["42", "20"].map(|v| value("columns", v, Refused(&["columns"]))));
    all.extend(["38", "62"].map(|v| value("rows", v, Right)));
    all.push(value("rows", "36", Refused(&["rows"])));
    all.push(mistake("columns and rows not stated", Clean, || {
        Set::mini().text("columns = 43\nrows = 37\n", "")
    }));
    all.push(value("configuration", "\"keplerian\"", Refused(&["configuration", "Keplerian"])));
    all.push(value("lattice", "\"hexagonal-columns\"", Refused(&["lattice"])));
    all.push(value("lattice", "\"orthogonal\"", Refused(&["lattice"])));
    all.push(value("lens_types", "1", Refused(&["lens types"])));
    all.push(value("lens_types", "2", Refused(&["lens types", "lens_types"])));
    all
}

fn board() -> Vec<Mistake> {
    // The first columns and rows are those of the array.
    let board = |name: &'static str, size: &'static str, expected| {
        mistake(format!("board {name}"), expected, move || {
            Set::mini().text("columns = 8\nrows = 5\n", size)
        })
    };
    let size = Warned(&["square_mm"]);
    let mut all: Vec<Mistake> =
        ["2", "2.5", "2.7", "2.9", "2.95", "3.05", "3.1", "3.3", "3.5", "4", "6"]
            .into_iter()
            .map(|v| value("square_mm", v, size))
            .collect();
    all.push(value("square_mm", "30", size));
    all.extend(["300", "0.3", "0.003"].map(|v| value("square_mm", v, Refused(&["square_mm"]))));
    let labels = Refused(&["columns", "board"]);
    // Frames that could show more than one part of it are left out; the others are right.
    let some = Warned(&["check that", "correct the size of the board"]);
    all.extend([
        board("5 x 8", "columns = 5\nrows = 8\n", Right),
        board("9 x 6, its squares", "columns = 9\nrows = 6\n", some),
        board("9 x 5", "columns = 9\nrows = 5\n", some),
        board("8 x 6", "columns = 8\nrows = 6\n", some),
        board("7 x 5", "columns = 7\nrows = 5\n", some),
        board("8 x 4", "columns = 8\nrows = 4\n", labels),
        board("7 x 4", "columns = 7\nrows = 4\n", labels),
        board("4 x 3", "columns = 4\nrows = 3\n", labels),
        board("1 x 5", "columns = 1\nrows = 5\n", Refused(&["inner corners"])),
        board("0 x 0", "columns = 0\nrows = 0\n", Refused(&["inner corners"])),
        board("80 x 50", "columns = 80\nrows = 50\n", labels),
    ]);
    all
}

fn f_numbers() -> Vec<Mistake> {
    const STOPS: [&str; 5] = ["4", "5.656854249492381", "8", "11.313708498984761", "16"];
    let white = |set: Set, i: usize, to: &str| {
        let names = ["4.00", "5.66", "8.00", "11.31", "16.00"];
        let image = format!("whites/white-{i}-n-{}.png\"\nf_number = ", names[i]);
        set.text(&format!("{image}{}\n", STOPS[i]), &format!("{image}{to}\n"))
    };
    let named = Warned(&["f-number", "f_number"]);
    let mut all = Vec::new();
    // All f-numbers by one factor: m and q' change together; only the camera can tell.
    for (name, factor) in [
        ("1.02", 1.02),
        ("0.98", 0.98),
        ("1.05", 1.05),
        ("0.95", 0.95),
        ("1.19", 1.19),
        ("1.41", std::f64::consts::SQRT_2),
    ] {
        all.push(mistake(
            format!("all f-numbers x {name}"),
            if (factor - 1.0_f64).abs() < 0.03 { Right } else { named },
            move || {
                let scaled =
                    |i: usize| (STOPS[i].parse::<f64>().expect("a number") * factor).to_string();
                let set = (0..5).fold(Set::mini(), |set, i| white(set, i, &scaled(i)));
                set.value("f_number", &(4.0 * factor).to_string())
            },
        ));
    }
    all.extend(
        ["2", "2.8", "3.5", "3.7", "3.8", "4.2", "4.3", "4.5", "5.6"]
            .map(|v| value("f_number", v, named)),
    );
    all.push(value("f_number", "8", Refused(&["f-number"])));
    all.push(value("f_number", "0", Refused(&["f-number"])));
    all.push(value("f_number", "-4", Refused(&["f-number"])));
    for (i, stop) in STOPS.iter().enumerate() {
        for (name, factor) in [
            ("a stop larger", std::f64::consts::SQRT_2),
            ("a stop smaller", std::f64::consts::FRAC_1_SQRT_2),
            ("10 % larger", 1.1),
        ] {
            all.push(mistake(format!("white {i}: f-number {name}"), named, move || {
                let n = stop.parse::<f64>().expect("a number") * factor;
                white(Set::mini(), i, &n.to_string())
            }));
        }
    }
    for (i, j) in [(0, 1), (1, 2), (2, 3), (3, 4), (0, 4), (1, 3)] {
        let swapped = Refused(&["are swapped"]);
        all.push(mistake(format!("whites {i} and {j}: f-numbers swapped"), swapped, move || {
            white(white(Set::mini(), i, STOPS[j]), j, STOPS[i])
        }));
    }
    all.push(mistake("whites: f-numbers in reverse", Refused(&["are swapped"]), move || {
        (0..5).fold(Set::mini(), |set, i| white(set, i, STOPS[4 - i]))
    }));
    all.push(mistake("whites: f-numbers as engraved, 5.6 and 11", Right, move || {
        white(white(Set::mini(), 1, "5.6"), 3, "11")
    }));
    for (i, j) in [(3, 4), (0, 1), (1, 4)] {
        all.push(mistake(format!("whites {i} and {j}: one f-number for both"), named, move || {
            white(Set::mini(), j, STOPS[i])
        }));
    }
    all.push(mistake("whites: all at f/8", Refused(&["f-number", "f_number"]), move || {
        (0..5).fold(Set::mini(), |set, i| white(set, i, "8"))
    }));
    all
}

fn steps() -> Vec<Mistake> {
    let named = Warned(&["step"]);
    let mut all: Vec<Mistake> = ["2.5", "4", "4.8", "5.2", "6", "10", "-5", "-10", "50", "0.5"]
        .into_iter()
        .map(|v| value("step_mm", v, named))
        .collect();
    all.push(value("step_mm", "0", Refused(&["step_mm"])));
    all.push(value("step_mm", "nan", Refused(&["step_mm", "nan"])));
    all
}

fn options() -> Vec<Mistake> {
    let option = |name: &'static str, lines: &'static str, expected| {
        mistake(format!("option {name}"), expected, move || Set::mini().more(lines))
    };
    vec![
        option(
            "exit pupil at -10 mm",
            "[calibration]\nexit_pupil = -10",
            Warned(&["exit pupil", "F is", "F,"]),
        ),
        option(
            "exit pupil at +10 mm",
            "[calibration]\nexit_pupil = 10",
            Warned(&["exit pupil", "F is", "F,"]),
        ),
        option(
            "loss scale 1e-9",
            "[calibration]\nloss = \"cauchy\"\nloss_scale = 1e-9",
            Refused(&["loss scale"]),
        ),
        option("a misspelt key", "[calibration]\nexitpupil = 1", Refused(&["exitpupil"])),
        option(
            "all frames left out",
            "[calibration]\nexclude_frames = [0,1,2,3,4,5,6,7,8,9]",
            Refused(&["frames", "exclude"]),
        ),
        mistake("F with a prior of 20 mm", Warned(&["F is"]), || {
            Set::mini().more("[calibration]\npriors = { F = [20, 0.01] }")
        }),
    ]
}
