//! Cameras that are not those of the images, or damaged, in every command that uses one.

use serde_json::{Value, json};

use crate::base::{arguments, evaluate, extrinsics, own_camera, own_features, poses_only};
use crate::{Case, Expected, case};
use Expected::{Refused, Right, Told};

type Change = fn(&mut Value);

fn scale(value: &mut Value, factor: f64) {
    *value = json!(value.as_f64().expect("a number") * factor);
}

fn add(value: &mut Value, more: f64) {
    *value = json!(value.as_f64().expect("a number") + more);
}

/// What is wrong with a camera, how it is made, and what has to come of boards in images, and of features without images.
#[allow(clippy::too_many_lines)] // a table
fn changes() -> Vec<(&'static str, Change, Expected, Expected)> {
    const ARRAY: &str = "micro_lens_array";
    let told = Told(&[
        "[slope-contradicted]",
        "[blur-contradicted]",
        "[squares-contradicted]",
        "[scatter]",
        "[bad-fit]",
    ]);
    let types = Told(&["[lens-types-contradicted]", "[blur-contradicted]"]);
    let blur = Told(&["[blur-contradicted]"]);
    let other = Refused(&["belong to different cameras"]);
    let indices = Refused(&["do not belong together"]);
    let moved = Told(&["[centers-contradicted]", "[bad-fit]", "[scatter]"]);
    let verdict = Told(&["[camera-not-to-be-used]"]);
    vec![
        ("F 2 % longer", |c| scale(&mut c["main_lens"]["focal_length_mm"], 1.02), told, told),
        ("F 2 % shorter", |c| scale(&mut c["main_lens"]["focal_length_mm"], 0.98), told, told),
        ("d 2 % longer", |c| scale(&mut c[ARRAY]["mla_to_sensor_mm"], 1.02), told, told),
        ("d 3 % shorter", |c| scale(&mut c[ARRAY]["mla_to_sensor_mm"], 0.97), told, told),
        ("D 1 % longer", |c| scale(&mut c[ARRAY]["lens_to_mla_mm"], 1.01), told, told),
        (
            "focus farther, D 0.3 mm less",
            |c| add(&mut c[ARRAY]["lens_to_mla_mm"], -0.3),
            told,
            told,
        ),
        ("pitch 1 % wider", |c| scale(&mut c[ARRAY]["pitch_mm"], 1.01), moved, moved),
        ("array 2 px to the right", |c| add(&mut c[ARRAY]["offset_mm"][0], -0.011), moved, Right),
        ("array half a pitch down", |c| add(&mut c[ARRAY]["offset_mm"][1], 0.06), moved, Right),
        ("array turned by 5 mrad", |c| add(&mut c[ARRAY]["rotation_rad"][2], 5e-3), moved, moved),
        ("array tilted by 10 mrad", |c| add(&mut c[ARRAY]["rotation_rad"][0], 1e-2), told, told),
        (
            "f of types 1 and 3 exchanged",
            |c| c[ARRAY]["focal_lengths_mm"].as_array_mut().expect("a list").swap(0, 2),
            types,
            blur,
        ),
        (
            "f of types 1 and 2 exchanged",
            |c| c[ARRAY]["focal_lengths_mm"].as_array_mut().expect("a list").swap(0, 1),
            types,
            blur,
        ),
        (
            "f of types 2 and 3 exchanged",
            |c| c[ARRAY]["focal_lengths_mm"].as_array_mut().expect("a list").swap(1, 2),
            types,
            blur,
        ),
        (
            "types in a circle",
            |c| c[ARRAY]["focal_lengths_mm"].as_array_mut().expect("a list").rotate_left(1),
            types,
            blur,
        ),
        (
            "f of type 2 5 % longer",
            |c| scale(&mut c[ARRAY]["focal_lengths_mm"][1], 1.05),
            types,
            blur,
        ),
        (
            "one lens type",
            |c| c[ARRAY]["focal_lengths_mm"].as_array_mut().expect("a list").truncate(1),
            other,
            blur,
        ),
        (
            "odd rows shifted",
            |c| c[ARRAY]["shifted"] = json!("odd"),
            other,
            Told(&["[bad-fit]", "[scatter]"]),
        ),
        (
            "an orthogonal array",
            |c| {
                c[ARRAY]["lattice"] = json!("orthogonal");
                c[ARRAY].as_object_mut().expect("a table").remove("shifted");
            },
            Refused(&["belong to different cameras", "lens types"]),
            Refused(&["lens types", "do not belong together"]),
        ),
        (
            "two columns less",
            |c| c[ARRAY]["columns"] = json!(41),
            other,
            Refused(&["41", "do not belong together"]),
        ),
        ("a row more", |c| c[ARRAY]["rows"] = json!(38), other, Told(&["[bad-fit]", "[scatter]"])),
        (
            "pixels of 6 micrometres",
            |c| c["sensor"]["pixel_size_mm"] = json!(0.006),
            other,
            indices,
        ),
        ("a sensor of 1200 px", |c| c["sensor"]["width_px"] = json!(1200), other, Right),
        (
            "principal point 15 px off",
            |c| add(&mut c["principal_point_px"][0], 15.0),
            Expected::ToldOrRefused(&["do not belong together"]),
            indices,
        ),
        (
            "no distortion",
            |c| {
                for q in ["q1_per_mm2", "q2_per_mm4", "q3_per_mm6"] {
                    c["main_lens"][q] = json!(0.0);
                }
            },
            Told(&["[scatter]", "[squares-contradicted]"]),
            Told(&["[scatter]", "[squares-contradicted]"]),
        ),
        (
            "an exit pupil 8 mm before the lens",
            |c| c["main_lens"]["exit_pupil_mm"][2] = json!(-8.0),
            Told(&["[centers-contradicted]", "[slope-contradicted]", "[bad-fit]"]),
            Right,
        ),
        (
            "another f-number",
            |c| c["main_lens"]["f_number"] = json!(8.0),
            Told(&["[other-f-number]"]),
            Right,
        ),
        (
            "not converged",
            |c| c["converged"] = json!(false),
            Told(&["[camera-not-converged]"]),
            Told(&["[camera-not-converged]"]),
        ),
        (
            "verdict do not use",
            |c| c["verdict"] = json!({"verdict": "do not use", "reasons": ["bad-fit"]}),
            verdict,
            verdict,
        ),
        (
            "sigma of F null",
            |c| c["uncertainty"]["standard_deviations"]["F"]["value"] = Value::Null,
            Told(&["[camera-undetermined]"]),
            Told(&["[camera-undetermined]"]),
        ),
    ]
}

/// Cameras that no command may take.
fn damaged() -> Vec<(&'static str, Change, &'static [&'static str])> {
    const ARRAY: &str = "micro_lens_array";
    vec![
        ("F of 0", |c| c["main_lens"]["focal_length_mm"] = json!(0.0), &["F"]),
        ("F of 1e308", |c| c["main_lens"]["focal_length_mm"] = json!(1e308), &["F"]),
        ("F as text", |c| c["main_lens"]["focal_length_mm"] = json!("16"), &["focal_length_mm"]),
        (
            "no F",
            |c| {
                c["main_lens"].as_object_mut().expect("a table").remove("focal_length_mm");
            },
            &["focal_length_mm"],
        ),
        (
            "a misspelt key",
            |c| c["main_lens"]["focal_lenght_mm"] = json!(16.0),
            &["focal_lenght_mm"],
        ),
        ("d negative", |c| c[ARRAY]["mla_to_sensor_mm"] = json!(-0.3), &["d"]),
        ("no columns", |c| c[ARRAY]["columns"] = json!(0), &["columns", "0 x"]),
        ("a pitch of 0", |c| c[ARRAY]["pitch_mm"] = json!(0.0), &["dC"]),
        (
            "turned by a thousand turns",
            |c| c[ARRAY]["rotation_rad"][2] = json!(6283.0),
            &["rotation_rad", "theta_z"],
        ),
        (
            "a sensor of 60000 x 60000",
            |c| {
                c["sensor"]["width_px"] = json!(60000);
                c["sensor"]["height_px"] = json!(60000);
            },
            &["60000"],
        ),
        (
            "two lens types",
            |c| c[ARRAY]["focal_lengths_mm"].as_array_mut().expect("a list").truncate(2),
            &["lens types"],
        ),
        (
            "near boards beyond far ones",
            |c| {
                c["boards"]["near_mm"] = json!(500.0);
                c["boards"]["far_mm"] = json!(100.0);
            },
            &["near"],
        ),
        (
            "another format",
            |c| c["format"] = json!("plenocal-poses"),
            &["format", "plenocal-poses"],
        ),
        ("version 99", |c| c["version"] = json!(99), &["version"]),
    ]
}

pub fn cases() -> Vec<Case> {
    let mut all = Vec::new();
    for (name, change, in_images, of_features) in changes() {
        all.push(case(format!("extrinsics: {name}"), in_images, move |s| {
            extrinsics(&s.camera(change), &[])
        }));
        all.push(case(format!("evaluate: {name}"), in_images, move |s| {
            evaluate(&s.camera(change), &[])
        }));
        all.push(case(format!("poses-only: {name}"), of_features, move |s| {
            poses_only(&s.camera(change), &own_features("evaluation"), &[])
        }));
    }
    for (name, change, pieces) in damaged() {
        all.push(case(format!("rays: {name}"), Refused(pieces), move |s| {
            arguments(&["rays", &s.camera(change)])
        }));
        all.push(case(format!("compare: {name}"), Refused(pieces), move |s| {
            arguments(&["compare", &own_camera(), &s.camera(change)])
        }));
        all.push(case(format!("extrinsics: {name}"), Refused(pieces), move |s| {
            extrinsics(&s.camera(change), &[])
        }));
    }
    all
}
