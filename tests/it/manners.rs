//! What surrounds the commands: records, completions, manual pages, places that cannot be written.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use predicates::prelude::*;
use serde_json::Value;
use tempfile::TempDir;

use crate::support::{plenocal, synthetic_folder};

fn calibrate(out: &Path) -> assert_cmd::Command {
    let mut command = plenocal();
    command.arg("calibrate").arg(synthetic_folder().join("project.toml")).arg("--out").arg(out);
    command
}

#[test]
fn records_go_to_stderr_and_json_stays_pure() {
    let folder = TempDir::new().unwrap();
    let lines = |level: &[&str]| {
        let Output { status, stdout, stderr } =
            calibrate(folder.path()).arg("--json").args(level).output().unwrap();
        assert!(status.success());
        let result: Value = serde_json::from_slice(&stdout).unwrap();
        assert_eq!(result["converged"], true);
        String::from_utf8(stderr).unwrap()
    };
    assert!(lines(&[]).is_empty());
    let (few, more) = (lines(&["-v"]), lines(&["-vv"]));
    for word in ["features.csv", "calibration: new", "calibration: close", "cost", "written"] {
        assert!(few.contains(word), "{word}: {few}");
    }
    assert!(!few.contains("iteration 1:") && more.contains("iteration 1:"), "{more}");
    assert!(!few.contains('\x1b'), "no colours but on a terminal");
    // Before the command it is the same.
    let mut before = plenocal();
    before.args(["-v", "simulate", "--print"]).assert().success();
}

#[test]
fn the_help_tells_the_order_of_things() {
    let help = plenocal().arg("--help").output().unwrap();
    let help = String::from_utf8(help.stdout).unwrap();
    let at = |word: &str| help.find(&format!("\n  {word} ")).unwrap_or_else(|| panic!("{word}"));
    let order =
        ["init", "run", "precalibrate", "detect", "calibrate", "evaluate", "completions"].map(at);
    assert!(order.is_sorted(), "{help}");
    for word in ["From images to a report", "130  interrupted", "--verbose"] {
        assert!(help.contains(word), "{word}");
    }
}

#[test]
fn completions_of_every_shell() {
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        plenocal()
            .args(["completions", shell])
            .assert()
            .success()
            .stdout(predicate::str::contains("precalibrate"));
    }
    if let (true, Ok(full)) = (cfg!(target_os = "linux"), fs::File::create("/dev/full")) {
        let mut command = Command::new(assert_cmd::cargo::cargo_bin("plenocal"));
        let output = command.args(["completions", "bash"]).stdout(full).output().unwrap();
        assert_eq!(output.status.code(), Some(1));
        assert!(String::from_utf8_lossy(&output.stderr).contains("cannot write standard output"));
    }
    plenocal().args(["completions", "cmd"]).assert().code(2);
    let folder = TempDir::new().unwrap();
    let script = folder.path().join("plenocal.bash");
    let output = plenocal().args(["completions", "bash"]).output().unwrap();
    fs::write(&script, output.stdout).unwrap();
    let Ok(checked) = Command::new("bash").arg("-n").arg(&script).output() else {
        eprintln!("skipped: bash is not installed");
        return;
    };
    assert!(checked.status.success(), "{}", String::from_utf8_lossy(&checked.stderr));
}

#[test]
fn a_manual_page_for_every_command() {
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("man1");
    plenocal().args(["man", "--out"]).arg(&out).assert().success();
    let help = plenocal().arg("--help").output().unwrap();
    let help = String::from_utf8(help.stdout).unwrap();
    let (_, commands) = help.split_once("Commands:\n").unwrap();
    let (commands, _) = commands.split_once("\n\n").unwrap();
    // Lines that are indented further go on with a description.
    let names = commands.lines().filter(|line| !line.starts_with("   "));
    let names = names.filter_map(|line| line.split_whitespace().next()).filter(|n| *n != "help");
    let mut pages = vec!["plenocal.1".to_owned()];
    pages.extend(names.map(|name| format!("plenocal-{name}.1")));
    assert!(pages.len() > 6, "{pages:?}");
    assert_eq!(fs::read_dir(&out).unwrap().count(), pages.len());
    for page in pages {
        let text = fs::read_to_string(out.join(&page)).unwrap();
        assert!(text.contains(".SH SYNOPSIS"), "{page}");
        let mut groff = Command::new("groff");
        groff.args(["-man", "-Tutf8", "-ww"]).arg(out.join(&page));
        let Ok(Output { status, stderr, .. }) = groff.output() else {
            eprintln!("skipped: groff is not installed");
            continue;
        };
        assert!(status.success() && stderr.is_empty(), "{}", String::from_utf8_lossy(&stderr));
    }
}

#[test]
fn places_that_cannot_be_written() {
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("file");
    fs::write(&file, "").unwrap();
    for command in [&["simulate", "--out"][..], &["man", "--out"]] {
        let out = file.join("below");
        plenocal()
            .args(command)
            .arg(&out)
            .assert()
            .code(1)
            .stdout(predicate::str::is_empty())
            .stderr(predicate::str::contains(out.to_str().unwrap()))
            .stderr(predicate::str::contains("is a file"));
    }
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}

/// Permissions are no obstacle to root.
#[cfg(unix)]
#[test]
fn a_folder_without_permission() {
    use std::os::unix::fs::PermissionsExt;
    let folder = TempDir::new().unwrap();
    fs::set_permissions(folder.path(), fs::Permissions::from_mode(0o500)).unwrap();
    if fs::write(folder.path().join("try"), "").is_ok() {
        eprintln!("skipped: this user may write everywhere");
        return;
    }
    let out = folder.path().join("new");
    calibrate(&out)
        .assert()
        .code(1)
        .stderr(predicate::str::contains("cannot write"))
        .stderr(predicate::str::contains(out.to_str().unwrap()));
}
