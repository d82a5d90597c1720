//! Mistakes in the shoot, which only a simulation can make: another aperture, a moved focus, boards that bend.

use crate::Expected::{Refused, Right, Told, Warned};
use crate::set::{Set, simulated};
use crate::{Expected, Mistake, mistake};

/// A set of `mini` with other settings, which its project knows nothing of.
fn simulation(name: &str, expected: Expected, settings: &'static [&'static str]) -> Mistake {
    mistake(name, expected, move || {
        let arguments: Vec<&str> = settings.iter().flat_map(|s| ["--set", *s]).collect();
        Set::of(&arguments)
    })
}

/// A set whose images of these roles are those of another camera or shoot.
fn mixed(
    name: &str,
    expected: Expected,
    settings: &'static [&'static str],
    of: fn(&str) -> bool,
) -> Mistake {
    mistake(name, expected, move || {
        let arguments: Vec<&str> = settings.iter().flat_map(|s| ["--set", *s]).collect();
        let (set, source) = (Set::mini(), simulated(&arguments));
        let roles =
            ["whites", "calibration", "evaluation", "translation"].map(|role| set.images(role));
        for name in roles.concat().iter().chain([&"devignetting.png".to_owned()]).filter(|n| of(n))
        {
            set.replace(name, &source.join(name));
        }
        set
    })
}

fn boards(name: &str) -> bool {
    ["calibration", "evaluation", "translation"].iter().any(|role| name.starts_with(role))
}

fn every_other_board(name: &str) -> bool {
    name.starts_with("calibration") && name.as_bytes()[name.len() - 5].is_multiple_of(2)
}

pub fn mistakes() -> Vec<Mistake> {
    [apertures(), optics(), targets(), poses(), light()].into_iter().flatten().collect()
}

fn apertures() -> Vec<Mistake> {
    let named = Told(&["f-number", "f_number"]);
    vec![
        mixed("boards at f/3.7", named, &["camera.main_lens.f_number=3.7"], boards),
        mixed("boards at f/4.3", named, &["camera.main_lens.f_number=4.3"], boards),
        mixed("boards at f/4.76", named, &["camera.main_lens.f_number=4.757"], boards),
        mixed("boards at f/5.66", named, &["camera.main_lens.f_number=5.657"], boards),
        mixed(
            "every other board at f/5",
            named,
            &["camera.main_lens.f_number=5"],
            every_other_board,
        ),
    ]
}

fn optics() -> Vec<Mistake> {
    let focus = Warned(&["focus", "frame", "m of", "|m|"]);
    vec![
        mixed(
            "every other board at a focus moved by 0.05 mm",
            focus,
            &["camera.micro_lens_array.lens_to_mla_mm=18.55"],
            every_other_board,
        ),
        mixed(
            "every other board at a focus moved by 0.2 mm",
            focus,
            &["camera.micro_lens_array.lens_to_mla_mm=18.7"],
            every_other_board,
        ),
        mixed(
            "boards at a focus moved by 0.05 mm",
            Right,
            &["camera.micro_lens_array.lens_to_mla_mm=18.55"],
            boards,
        ),
        mixed(
            "boards at a focus moved by 0.5 mm",
            focus,
            &["camera.micro_lens_array.lens_to_mla_mm=19"],
            boards,
        ),
        mixed(
            "another lens, F 17, for half the boards",
            focus,
            &["camera.main_lens.focal_length_mm=17"],
            every_other_board,
        ),
        mixed(
            "another lens, F 17, for the boards",
            focus,
            &["camera.main_lens.focal_length_mm=17"],
            boards,
        ),
        simulation("exit pupil at -10 mm", Right, &["camera.main_lens.exit_pupil_mm=[0,0,-5]"]),
        simulation("exit pupil at +10 mm", Right, &["camera.main_lens.exit_pupil_mm=[0,0,5]"]),
        simulation("exit pupil off the axis", Right, &["camera.main_lens.exit_pupil_mm=[1,0,0]"]),
        simulation("aperture ratio 0.85", Right, &["imperfections.aperture_ratio=0.85"]),
        simulation("aperture ratio 0.7", Right, &["imperfections.aperture_ratio=0.7"]),
        simulation("point spread of 1 px", Right, &["imperfections.point_spread_px=1"]),
        simulation(
            "point spread of 2 px",
            Told(&["point spread"]),
            &["imperfections.point_spread_px=2"],
        ),
        simulation(
            "a second stop",
            Warned(&["pupil", "round", "oblong"]),
            &["imperfections.second_stop.z_mm=8", "imperfections.second_stop.diameter_mm=7"],
        ),
        mistake("a double Gauss lens", Right, || Set::of(&["--preset", "mini-double-gauss"])),
        mistake("a telephoto lens", Right, || Set::of(&["--preset", "mini-telephoto"])),
        mistake("an unfocused camera", Refused(&["unfocused", "focused"]), || {
            Set::of(&["--preset", "lytro-like"])
        }),
    ]
}

fn targets() -> Vec<Mistake> {
    vec![
        simulation("a board bent by 0.2 mm", Right, &["target.sag_mm=[0.2,0.1]"]),
        simulation(
            "a board bent by 1 mm",
            Warned(&["bent", "sag", "board"]),
            &["target.sag_mm=[1,0]"],
        ),
        simulation("a board stretched by 0.5 %", Right, &["target.aspect=0.005"]),
        simulation(
            "a board stretched by 3 %",
            Warned(&["aspect", "square", "board"]),
            &["target.aspect=0.03"],
        ),
        simulation("a twisted board", Right, &["target.twist_mm=0.2"]),
        simulation(
            "a printed board of low contrast",
            Right,
            &["target.white=0.5", "target.black=0.35"],
        ),
        simulation("a board without a margin", Right, &["target.border_mm=0"]),
        simulation("a dark background", Right, &["target.background=0.02"]),
        simulation("moved by 2 px", Right, &["boards.motion_px=2"]),
        simulation("moved by 5 px", Warned(&["moved", "edges", "blur"]), &["boards.motion_px=5"]),
    ]
}

fn poses() -> Vec<Mistake> {
    vec![
        simulation(
            "all boards fronto-parallel",
            Warned(&["fronto-parallel", "tilted"]),
            &["boards.max_tilt_deg=0", "boards.max_turn_deg=0"],
        ),
        simulation("boards tilted by 5 degrees", Right, &["boards.max_tilt_deg=5"]),
        simulation("boards at one distance", Right, &["boards.depth_mm=[80,80.5]"]),
        simulation(
            "boards at one distance, hardly tilted",
            Warned(&["distance", "tilt"]),
            &["boards.depth_mm=[80,80.5]", "boards.max_tilt_deg=8"],
        ),
        simulation(
            "boards far away",
            Refused(&["no frame shows the board"]),
            &["boards.depth_mm=[110,140]"],
        ),
        simulation("boards near", Right, &["boards.depth_mm=[58,66]"]),
        simulation("small boards", Right, &["target.columns=5", "target.rows=4"]),
        simulation(
            "large squares",
            Right,
            &["target.square_mm=4.5", "target.columns=5", "target.rows=4"],
        ),
        simulation("boards half in view", Right, &["boards.min_in_view=0.4"]),
    ]
}

fn light() -> Vec<Mistake> {
    vec![
        simulation(
            "gamma 2.2 of the camera",
            Refused(&["not linear in light", "gamma"]),
            &["imaging.gamma=2.2"],
        ),
        simulation("uneven light", Right, &["target.uneven_light=[0.4,-0.3]"]),
        simulation("a black level of 16, unknown", Right, &["imaging.black_level=0.0627"]),
        simulation("100 hot pixels", Right, &["imaging.hot_pixels=100"]),
        simulation("20 specks of dust", Right, &["imperfections.dust_specks=20"]),
        simulation("over-exposed by 4", Right, &["white_images.gain=4"]),
        simulation("over-exposed by 16", Refused(&["saturated"]), &["white_images.gain=16"]),
        simulation("boards over-exposed by 2", Right, &["imaging.exposure=1.6"]),
        simulation(
            "boards over-exposed by 5",
            Refused(&["no frame shows the board"]),
            &["imaging.exposure=4"],
        ),
        simulation("boards at a tenth of full", Right, &["imaging.exposure=0.1"]),
    ]
}
