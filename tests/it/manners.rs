//! What all commands share: log, completions, manual pages, folders that cannot be written.

use std::fs;
use std::path::{Path, PathBuf};
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
fn the_log_goes_to_stderr_and_json_stays_pure() {
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
    assert!(!few.contains('\x1b'), "colours on a terminal only");
    // The option works before the command too.
    let mut before = plenocal();
    before.args(["-v", "simulate", "--print"]).assert().success();
}

#[test]
fn the_help_lists_commands_in_the_order_of_use() {
    let help = plenocal().arg("--help").output().unwrap();
    let help = String::from_utf8(help.stdout).unwrap();
    let at = |word: &str| help.find(&format!("\n  {word} ")).unwrap_or_else(|| panic!("{word}"));
    let order =
        ["init", "run", "precalibrate", "detect", "calibrate", "evaluate", "completions"].map(at);
    assert!(order.is_sorted(), "{help}");
    for word in ["From images to a report", "Exit status", "130  interrupted", "--verbose"] {
        assert!(help.contains(word), "{word}");
    }
}

fn completions(shell: &str) -> Vec<u8> {
    let output = plenocal().args(["completions", shell]).output().unwrap();
    assert!(output.status.success(), "{shell}");
    output.stdout
}

#[test]
fn completions_of_every_shell_name_the_commands() {
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let script = String::from_utf8(completions(shell)).unwrap();
        assert!(script.contains("precalibrate"), "{shell}");
    }
    plenocal().args(["completions", "cmd"]).assert().code(2);
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_an_error() {
    let full = fs::File::create("/dev/full").unwrap();
    let mut command = Command::new(assert_cmd::cargo::cargo_bin("plenocal"));
    let output = command.args(["completions", "bash"]).stdout(full).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stderr).contains("cannot write standard output"));
}

/// Writes the manual pages into a folder.
fn manual_pages(out: &Path) -> Vec<PathBuf> {
    plenocal().args(["man", "--out"]).arg(out).assert().success();
    let mut pages: Vec<_> = fs::read_dir(out).unwrap().map(|entry| entry.unwrap().path()).collect();
    pages.sort();
    pages
}

#[test]
fn every_command_has_a_manual_page() {
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("man1");
    let written = manual_pages(&out);
    let help = plenocal().arg("--help").output().unwrap();
    let help = String::from_utf8(help.stdout).unwrap();
    let (_, commands) = help.split_once("Commands:\n").unwrap();
    let (commands, _) = commands.split_once("\n\n").unwrap();
    // Lines that are indented further continue a description.
    let names = commands.lines().filter(|line| !line.starts_with("   "));
    let names = names.filter_map(|line| line.split_whitespace().next()).filter(|n| *n != "help");
    let mut pages = vec![out.join("plenocal.1")];
    pages.extend(names.map(|name| out.join(format!("plenocal-{name}.1"))));
    assert!(pages.len() > 6, "{pages:?}");
    pages.sort();
    assert_eq!(written, pages);
    for page in pages {
        let text = fs::read_to_string(&page).unwrap();
        assert!(text.contains(".SH SYNOPSIS"), "{}", page.display());
    }
}

#[test]
fn a_folder_below_a_file_is_an_error() {
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

/// Permissions do not bind root, who therefore runs the program as the user `nobody`.
#[cfg(target_os = "linux")]
#[test]
fn a_folder_without_permission_is_an_error() {
    use std::os::unix::fs::PermissionsExt;
    const NOBODY: &str = "65534";
    let folder = TempDir::new().unwrap();
    let mode =
        |path: &Path, mode| fs::set_permissions(path, fs::Permissions::from_mode(mode)).unwrap();
    // The other user may read neither the source tree nor a new temporary folder.
    mode(folder.path(), 0o755);
    for file in ["project.toml", "centers.csv", "features.csv"] {
        fs::copy(synthetic_folder().join(file), folder.path().join(file)).unwrap();
        mode(&folder.path().join(file), 0o644);
    }
    let program = folder.path().join("plenocal");
    fs::copy(assert_cmd::cargo::cargo_bin("plenocal"), &program).unwrap();
    mode(&program, 0o755);
    let closed = folder.path().join("closed");
    fs::create_dir(&closed).unwrap();
    mode(&closed, 0o555);
    let is_root = fs::write(closed.join("try"), "").is_ok();
    let mut command = if is_root {
        let mut command = Command::new("setpriv");
        command.args(["--reuid", NOBODY, "--regid", NOBODY, "--clear-groups"]).arg(program);
        command
    } else {
        Command::new(program)
    };
    let out = closed.join("new");
    command.arg("calibrate").arg(folder.path().join("project.toml")).arg("--out").arg(&out);
    assert_cmd::Command::from_std(command)
        .assert()
        .code(1)
        .stderr(predicate::str::contains("cannot write"))
        .stderr(predicate::str::contains(out.to_str().unwrap()));
    assert!(!out.exists());
}
