//! Tests that need data or programs from outside the repository.
//!
//! Each decides when it runs whether it can, and is reported as ignored, with what is missing, if it
//! cannot. With the variable `CI` set, or with `--include-ignored`, it fails instead.

use std::process::ExitCode;

use libtest_mimic::{Arguments, Trial};

use needs::{BROWSER, EXAMPLES, GROFF, Need, R12A, SHELLS, WHITES};

mod needs;
mod plain_ceres;
mod programs;
mod r12a;
#[allow(dead_code, reason = "shared with the tests of `it`, which use the rest")]
#[path = "../it/support.rs"]
mod support;
mod viewers;
mod whites;

/// Makes a test of a function without arguments.
macro_rules! test {
    ($module:ident::$name:ident needs $($need:ident)+) => {
        test(concat!(stringify!($module), "::", stringify!($name)), $module::$name, &[$($need),+])
    };
}

fn test(name: &str, run: fn(), needs: &[Need]) -> Trial {
    let missing: Vec<String> =
        needs.iter().filter(|need| !need.is_there()).map(|need| need.name()).collect();
    let test = Trial::test(name, move || {
        run();
        Ok(())
    });
    if missing.is_empty() || std::env::var_os("CI").is_some() {
        return test;
    }
    test.with_kind(format!("needs {}", missing.join(" "))).with_ignored_flag(true)
}

fn main() -> ExitCode {
    let tests = vec![
        test!(r12a::the_csv_files_give_the_known_minimum needs R12A),
        test!(r12a::the_binary_file_gives_the_same_camera needs R12A),
        test!(r12a::the_initial_values_are_those_of_table_1 needs R12A),
        test!(r12a::a_disturbed_start_ends_at_the_same_minimum needs R12A),
        test!(r12a::the_published_camera_reprojects_centres_and_corners needs R12A),
        test!(r12a::corners_only_gives_a_camera_near_the_full_one needs R12A),
        test!(r12a::left_out_frames_agree_with_sixteen_calibrations needs R12A),
        test!(r12a::the_default_priors_bring_the_camera_to_its_datasheet needs R12A),
        test!(plain_ceres::the_minimum_on_the_shipped_features_is_the_same needs EXAMPLES),
        test!(plain_ceres::the_minimum_of_the_default_cost_is_the_same needs EXAMPLES),
        test!(plain_ceres::the_minimum_on_the_real_features_is_the_same needs EXAMPLES R12A),
        test!(programs::a_stack_turns_virtual_depths_into_metric_points needs EXAMPLES),
        test!(programs::own_ceres_finds_poses_of_an_exported_problem needs EXAMPLES),
        test!(programs::the_documentation_speaks_cpp needs EXAMPLES),
        test!(programs::a_rig_of_two_cameras_is_refined_from_two_exported_problems needs EXAMPLES),
        test!(whites::real_square_arrays_are_found needs WHITES),
        test!(whites::a_real_array_agrees_with_its_maker needs WHITES),
        test!(whites::a_real_calibration_of_a_maker_needs_the_size_of_its_images needs WHITES),
        test!(viewers::shells_accept_their_completions needs SHELLS),
        test!(viewers::groff_formats_the_manual_pages_without_a_warning needs GROFF),
        test!(viewers::a_browser_shows_all_figures needs BROWSER),
        test!(viewers::a_browser_looks_into_the_pictures_of_a_run needs BROWSER),
    ];
    libtest_mimic::run(&Arguments::from_args(), tests).exit_code()
}
