//! Mistakes in the lists of files, and files that are damaged.

use std::fs;

use crate::Expected::{Refused, Right, Warned};
use crate::set::{Set, simulated};
use crate::{Mistake, mistake};

/// Images of the boards of the calibration.
const FRAME: fn(usize) -> String = |i| format!("calibration/calibration-{i:02}.png");
const WHITES: [&str; 5] =
    ["white-0-n-4.00", "white-1-n-5.66", "white-2-n-8.00", "white-3-n-11.31", "white-4-n-16.00"];

fn white(i: usize) -> String {
    format!("whites/{}.png", WHITES[i])
}

pub fn mistakes() -> Vec<Mistake> {
    [roles(), twice(), damaged(), few(), other()].into_iter().flatten().collect()
}

/// A file of the set in the place of others.
fn instead(name: &str, expected: crate::Expected, of: Vec<String>, by: String) -> Mistake {
    mistake(name, expected, move || {
        let set = Set::mini();
        for name in &of {
            let source = set.path().join(&by);
            set.replace(name, &source);
        }
        set
    })
}

fn roles() -> Vec<Mistake> {
    let devignetting = || "devignetting.png".to_owned();
    vec![
        instead("a board among the whites", Refused(&["white"]), vec![white(2)], FRAME(0)),
        instead("a board as the widest white", Refused(&["white"]), vec![white(0)], FRAME(0)),
        instead(
            "a board as devignetting image",
            Refused(&["devignetting"]),
            vec![devignetting()],
            FRAME(0),
        ),
        instead(
            "a white at f/8 as devignetting image",
            Refused(&["devignetting"]),
            vec![devignetting()],
            white(2),
        ),
        instead(
            "a white at f/5.7 as devignetting image",
            Warned(&["devignetting"]),
            vec![devignetting()],
            white(1),
        ),
        instead(
            "the devignetting image as white at f/8",
            Warned(&["f-number", "f_number"]),
            vec![white(2)],
            devignetting(),
        ),
        instead("a white among the boards", Warned(&["calibration-03"]), vec![FRAME(3)], white(0)),
        instead(
            "the devignetting image among the boards",
            Warned(&["calibration-03"]),
            vec![FRAME(3)],
            devignetting(),
        ),
        instead(
            "whites instead of all boards",
            Refused(&["corners", "board"]),
            (0..10).map(FRAME).collect(),
            white(0),
        ),
        instead(
            "boards instead of all whites",
            Refused(&["white"]),
            (0..5).map(white).collect(),
            FRAME(1),
        ),
        mistake("no devignetting image", Right, || {
            Set::mini().text("devignetting = \"devignetting.png\"\n", "")
        }),
        mistake("no devignetting image, and boards at f/2.8", Refused(&["devignetting"]), || {
            Set::mini().text("devignetting = \"devignetting.png\"\n", "").value("f_number", "2.8")
        }),
    ]
}

fn twice() -> Vec<Mistake> {
    let same = Warned(&["same image", "the same"]);
    let mut all = vec![
        instead("a board twice", same, vec![FRAME(3)], FRAME(4)),
        instead("a board six times", same, (3..8).map(FRAME).collect(), FRAME(2)),
        instead("one board ten times", same, (1..10).map(FRAME).collect(), FRAME(0)),
        instead(
            "an image in calibration and evaluation",
            same,
            vec!["evaluation/evaluation-00.png".into()],
            FRAME(4),
        ),
        instead(
            "all evaluation images from the calibration",
            same,
            (0..3).map(|i| format!("evaluation/evaluation-{i:02}.png")).collect(),
            FRAME(4),
        ),
        instead("a white twice", Refused(&["same image"]), vec![white(3)], white(2)),
        instead(
            "a step of the translation twice",
            same,
            vec!["translation/translation-02.png".into()],
            "translation/translation-01.png".into(),
        ),
    ];
    all.push(mistake("a board listed twice", same, || {
        Set::mini().text("\"calibration/calibration-03.png\"", "\"calibration/calibration-04.png\"")
    }));
    all.push(mistake("the translation in reverse", Warned(&["step"]), || {
        let set = Set::mini();
        let names = set.images("translation");
        let files: Vec<Vec<u8>> =
            names.iter().map(|n| fs::read(set.path().join(n)).expect("it is there")).collect();
        names.iter().rev().zip(files).for_each(|(name, content)| set.write(name, content));
        set
    }));
    all.push(mistake("two steps of the translation swapped", Warned(&["step"]), || {
        let set = Set::mini();
        let [a, b] = ["translation/translation-01.png", "translation/translation-02.png"];
        let [of_a, of_b] = [a, b].map(|n| fs::read(set.path().join(n)).expect("it is there"));
        set.write(a, of_b);
        set.write(b, of_a);
        set
    }));
    all.push(mistake("a step of the translation missing", Warned(&["step"]), || {
        Set::mini().text("  \"translation/translation-02.png\",\n", "")
    }));
    all
}

fn damaged() -> Vec<Mistake> {
    let frame = "calibration/calibration-03.png";
    let cut = |name: &'static str, part: f64| {
        move || {
            let set = Set::mini();
            let content = fs::read(set.path().join(name)).expect("it is there");
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a length
            set.write(name, &content[..(content.len() as f64 * part) as usize]);
            set
        }
    };
    let wide = "whites/white-0-n-4.00.png";
    let named = Warned(&["calibration-03"]);
    vec![
        mistake("a board cut to 90 %", named, cut(frame, 0.9)),
        mistake("a board cut to 40 %", named, cut(frame, 0.4)),
        mistake("an empty board", named, cut(frame, 0.0)),
        mistake("a white cut to 90 %", Refused(&["white-0"]), cut(wide, 0.9)),
        mistake("an empty white", Refused(&["white-0"]), cut(wide, 0.0)),
        mistake(
            "a cut devignetting image",
            Refused(&["devignetting"]),
            cut("devignetting.png", 0.7),
        ),
        mistake(
            "a cut step of the translation",
            Warned(&["translation-01"]),
            cut("translation/translation-01.png", 0.6),
        ),
        mistake("a missing board", Refused(&["calibration-99"]), || {
            Set::mini().text("calibration-03.png", "calibration-99.png")
        }),
        mistake("a missing white", Refused(&["white-9"]), || {
            Set::mini().text("white-2-n", "white-9-n")
        }),
        mistake("a missing devignetting image", Refused(&["devignette.png"]), || {
            Set::mini().text("devignetting.png", "devignette.png")
        }),
        mistake("a missing step of the translation", Refused(&["translation-77"]), || {
            Set::mini().text("translation-01.png", "translation-77.png")
        }),
        mistake("a board that is a text", named, || {
            let set = Set::mini();
            set.write("calibration/calibration-03.png", "not an image\n");
            set
        }),
        mistake("a board that is a folder", Refused(&["it is a folder"]), || {
            let set = Set::mini();
            let path = set.path().join("calibration/calibration-03.png");
            fs::remove_file(&path)
                .and_then(|()| fs::create_dir(&path))
                .expect("it can be replaced");
            set
        }),
        mistake("a project without boards", Refused(&["calibration"]), || {
            let set = Set::mini();
            let text = set.project_text();
            let (begin, end) = (
                text.find("calibration = [").unwrap_or(0),
                text.find("evaluation = [").unwrap_or(0),
            );
            let text = format!("{}{}", &text[..begin], &text[end..]);
            set.write("project.toml", text);
            set
        }),
    ]
}

fn few() -> Vec<Mistake> {
    let boards = |count: usize| {
        move || {
            (count..10).fold(Set::mini(), |set, i| set.text(&format!("  \"{}\",\n", FRAME(i)), ""))
        }
    };
    let whites = |kept: &'static [usize]| {
        move || {
            let f_number =
                |i: usize| ["4", "5.656854249492381", "8", "11.313708498984761", "16"][i];
            (0..5).filter(|i| !kept.contains(i)).fold(Set::mini(), |set, i| {
                let entry = format!(
                    "[[images.whites]]\nimage = \"{}\"\nf_number = {}\n",
                    white(i),
                    f_number(i)
                );
                set.text(&entry, "")
            })
        }
    };
    vec![
        mistake("one board", Warned(&["frame"]), boards(1)),
        mistake("two boards", Warned(&["frame"]), boards(2)),
        mistake("three boards", Warned(&["frame"]), boards(3)),
        mistake("five boards", Right, boards(5)),
        mistake("one white", Refused(&["white"]), whites(&[0])),
        mistake("two whites", Right, whites(&[0, 4])),
        mistake("two whites a stop apart", Right, whites(&[2, 3])),
        mistake("three whites", Right, whites(&[0, 2, 4])),
        mistake("four whites", Right, whites(&[0, 1, 2, 3])),
    ]
}

/// Images of another camera.
fn other() -> Vec<Mistake> {
    const OTHER: &[&str] =
        &["--set", "seed=77", "--set", "camera.micro_lens_array.mla_to_sensor_mm=0.3"];
    const TURNED: &[&str] = &[
        "--set",
        "seed=78",
        "--set",
        "camera.micro_lens_array.rotation_rad=[0.0008,-0.0006,0.02]",
    ];
    const KEPLERIAN: &[&str] = &["--preset", "keplerian"];
    let from = |arguments: &'static [&'static str], names: Vec<String>| {
        move || {
            let (set, source) = (Set::mini(), simulated(arguments));
            for name in &names {
                set.replace(name, &source.join(name));
            }
            set
        }
    };
    let whites = || (0..5).map(white).chain(["devignetting.png".to_owned()]).collect::<Vec<_>>();
    vec![
        mistake("whites of another camera, d 0.3", Warned(&["m", "white"]), from(OTHER, whites())),
        mistake(
            "one white of another camera, d 0.3",
            Refused(&["of different cameras"]),
            from(OTHER, vec![white(2)]),
        ),
        mistake(
            "three boards of another camera, d 0.3",
            Warned(&["frame"]),
            from(OTHER, (0..3).map(FRAME).collect()),
        ),
        mistake(
            "a board of another camera, d 0.3",
            Warned(&["frame 4"]),
            from(OTHER, vec![FRAME(4)]),
        ),
        mistake(
            "whites of a turned array",
            Refused(&["corners", "centre"]),
            from(TURNED, whites()),
        ),
        mistake("one white of a turned array", Right, from(TURNED, vec![white(2)])),
        mistake(
            "a board of a turned array",
            Warned(&["calibration-04"]),
            from(TURNED, vec![FRAME(4)]),
        ),
        mistake(
            "whites of a Keplerian camera",
            Refused(&["white", "corners", "px"]),
            from(KEPLERIAN, vec!["devignetting.png".into()]),
        ),
    ]
}
