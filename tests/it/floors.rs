//! The layout of ARCHITECTURE.md: rooms lie on floors, and imports point down.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use crate::house;

/// The rooms of `src`, the lowest first; a room may import those before it.
const ROOMS: [&str; 18] = [
    "error",
    "quantity",
    "table",
    "finding",
    "model",
    "numerics",
    "image",
    "optics",
    "solver",
    "simulation",
    "checks",
    "precalibration",
    "detection",
    "calibration",
    "assessment",
    "io",
    "report",
    "cli",
];
/// The only files beside the rooms.
const LOOSE: [&str; 6] = ["lib.rs", "main.rs", "error.rs", "quantity.rs", "table.rs", "finding.rs"];

/// The sources by their path in `src`.
fn sources() -> Vec<(PathBuf, String)> {
    let in_src = |(name, text): (String, String)| {
        (Path::new(&name).strip_prefix("src").unwrap().to_owned(), text)
    };
    house::sources(&["src"], &["rs"]).into_iter().map(in_src).collect()
}

fn floor(room: &str) -> usize {
    ROOMS.iter().position(|r| *r == room).unwrap_or_else(|| panic!("{room} has no floor"))
}

/// The room of a file: the first part of its path.
fn room(path: &Path) -> String {
    let first = path.components().next().unwrap().as_os_str().to_string_lossy();
    first.trim_end_matches(".rs").to_owned()
}

fn code(text: &str) -> impl Iterator<Item = &str> {
    text.lines().filter(|line| !line.trim_start().starts_with("//"))
}

/// Rooms that a file refers to by an absolute path, in `use` or elsewhere.
fn imports(text: &str) -> BTreeSet<String> {
    let code: Vec<&str> = code(text).collect();
    let code = code.join("\n");
    let of_root = |root: &str| {
        code.match_indices(root)
            .flat_map(|(at, _)| {
                let rest = &code[at + root.len()..];
                match rest.strip_prefix('{') {
                    // use crate::{a::B, c::D};
                    Some(list) => list[..list.find(';').unwrap_or(list.len())]
                        .split(',')
                        .map(first_word)
                        .collect::<Vec<_>>(),
                    None => vec![first_word(rest)],
                }
            })
            .filter(|name| ROOMS.contains(&name.as_str()))
            .collect::<Vec<_>>()
    };
    ["crate::", "plenocal::"].into_iter().flat_map(of_root).collect()
}

fn first_word(text: &str) -> String {
    text.trim().chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect()
}

#[test]
fn imports_point_down() {
    let mut upward = Vec::new();
    for (path, text) in sources() {
        if path == Path::new("lib.rs") || path == Path::new("main.rs") {
            continue;
        }
        let own = room(&path);
        for imported in imports(&text) {
            if imported != own && floor(&imported) > floor(&own) {
                upward.push(format!("{} imports {imported}", path.display()));
            }
        }
    }
    assert!(upward.is_empty(), "upward imports:\n{}", upward.join("\n"));
}

#[test]
fn no_file_lies_outside_the_rooms() {
    let loose: Vec<String> = sources()
        .into_iter()
        .filter(|(path, _)| path.components().count() == 1)
        .map(|(path, _)| path.display().to_string())
        .filter(|name| !LOOSE.contains(&name.as_str()))
        .collect();
    assert!(loose.is_empty(), "{loose:?}");
}

/// The tracer is an independent check of the projection model.
#[test]
fn the_simulation_never_calls_the_core() {
    for (path, text) in sources().iter().filter(|(path, _)| path.starts_with("simulation")) {
        assert!(!imports(text).contains("solver"), "{}", path.display());
    }
}

/// Words that only some files may use, by the beginning of their path.
#[test]
fn restricted_words_are_used_only_where_allowed() {
    let rules: [(&[&str], &[&str]); 7] = [
        // Only the command line prints and ends the process.
        (&["println!", "print!", "eprintln!", "stdout()", "stderr()", "process::exit"], &["cli"]),
        // Only io and cli touch files.
        (&["std::fs", "File::open", "File::create"], &["io", "cli"]),
        (&["allow(unsafe_code)", "cxx::bridge"], &["solver/bridge.rs"]),
        (&["opencv::"], &["calibration/poses.rs"]),
        // Of the command line, the library knows that options are flags too.
        (&["indicatif"], &["cli"]),
        (&["clap"], &["cli", "options.rs", "board.rs", "color.rs", "observation.rs", "radii.rs"]),
        (&["(--", " --", "\"--", "`--"], &["cli", "report/html.rs"]),
    ];
    for (path, text) in sources() {
        for (words, places) in rules {
            let allowed = |place: &&str| path.starts_with(place) || path.ends_with(place);
            if places.iter().any(allowed) || path.ends_with("tests.rs") {
                continue;
            }
            let tests = text.find("#[cfg(test)]").unwrap_or(text.len());
            for word in words {
                let found = code(&text[..tests]).find(|line| line.contains(word));
                assert!(found.is_none(), "{}: {word} in {found:?}", path.display());
            }
        }
    }
}
