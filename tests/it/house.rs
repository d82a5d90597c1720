//! Limits of length: files and functions that a person reads in one sitting.

use std::fs;
use std::path::{Path, PathBuf};

/// Most lines of a file. A longer one gives its reason in a comment near its beginning.
const FILE_LINES: usize = 400;
const REASON: &str = "Long because ";
/// Number of lines at the beginning that may contain the reason.
const HEADER_LINES: usize = 30;
/// Most lines of a function, from its name to its closing brace.
const FUNCTION_LINES: usize = 80;

/// The sources in the folders, by their path in the repository.
pub fn sources(folders: &[&str], extensions: &[&str]) -> Vec<(String, String)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut open: Vec<PathBuf> = folders.iter().map(|folder| root.join(folder)).collect();
    let mut sources = Vec::new();
    while let Some(folder) = open.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                open.push(path);
            } else if path.extension().is_some_and(|e| extensions.iter().any(|x| e == *x)) {
                let name = path.strip_prefix(root).unwrap().display().to_string();
                sources.push((name, fs::read_to_string(&path).unwrap()));
            }
        }
    }
    assert!(sources.len() > 10, "sources were found");
    sources
}

#[test]
fn files_are_short_or_give_a_reason() {
    let is_long = |(_, text): &(String, String)| {
        let mut header = text.lines().take(HEADER_LINES);
        text.lines().count() > FILE_LINES
            && !header.any(|line| line.trim_start_matches(['/', '!', ' ']).starts_with(REASON))
    };
    let sources = sources(&["src", "cpp", "tests"], &["rs", "hpp", "cpp"]);
    let long: Vec<String> = sources.into_iter().filter(is_long).map(|(name, _)| name).collect();
    assert!(long.is_empty(), "above {FILE_LINES} lines: {long:#?}");
}

#[test]
fn both_languages_are_of_one_version() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let header = fs::read_to_string(root.join("cpp/include/plenocal/version.hpp")).unwrap();
    let version = env!("CARGO_PKG_VERSION");
    assert!(header.contains(&format!("PLENOCAL_VERSION \"{version}\"")), "{version}");
    for (name, part) in ["MAJOR", "MINOR", "PATCH"].iter().zip(version.split('.')) {
        assert!(header.contains(&format!("PLENOCAL_VERSION_{name} {part}\n")), "{name} {part}");
    }
}

#[test]
fn functions_are_short() {
    let sources = sources(&["src", "tests", "benches", "examples"], &["rs"]);
    let long = sources.iter().flat_map(|(path, text)| {
        let long = functions(text).into_iter().filter(|(_, lines)| *lines > FUNCTION_LINES);
        long.map(move |(name, _)| format!("{path}: {name}"))
    });
    let long: Vec<String> = long.collect();
    assert!(long.is_empty(), "above {FUNCTION_LINES} lines: {long:#?}");
}

/// The functions of source code as rustfmt writes it, each with its name and its lines.
fn functions(text: &str) -> Vec<(String, usize)> {
    let lines: Vec<&str> = text.lines().collect();
    let mut found = Vec::new();
    for (first, line) in lines.iter().enumerate() {
        let code = line.trim_start();
        let Some(name) = function_name(code) else { continue };
        let indentation = &line[..line.len() - code.len()];
        // The closing brace at the same indentation, or the semicolon of a declaration.
        let ends = |line: &str| {
            line.strip_prefix(indentation).is_some_and(|rest| {
                rest.starts_with('}') || (!rest.starts_with(' ') && rest.ends_with([';', '}']))
            })
        };
        let last = lines[first..].iter().position(|line| ends(line));
        let last = last.unwrap_or_else(|| panic!("{name} has no end"));
        found.push((name.to_owned(), last + 1));
    }
    found
}

/// The name of a function if a line begins one.
fn function_name(code: &str) -> Option<&str> {
    let (before, after) = code.split_once("fn ")?;
    let is_qualifier = |word: &str| {
        word.starts_with("pub") || ["const", "async", "unsafe", "extern", "\"C\""].contains(&word)
    };
    let visibility = before.replace("pub(in ", "pub(");
    let name = after.split(|c: char| !c.is_alphanumeric() && c != '_').next()?;
    (visibility.split_whitespace().all(is_qualifier) && !name.is_empty()).then_some(name)
}

#[test]
fn functions_are_counted_to_their_closing_brace() {
    let text = "pub(crate) const fn one() -> u8 { 1 }\n\
                fn two(\n    a: u8,\n) -> u8 {\n    let call = |x| {\n        x\n    };\n    call(a)\n}\n\
                trait T {\n    fn declared(&self);\n    fn method(&self) {\n        // fn no() {\n    }\n}\n\
                let fn_pointer: fn (u8) = two;\n";
    let expected = [("one", 1), ("two", 8), ("declared", 1), ("method", 3)];
    let found = functions(text);
    let found: Vec<(&str, usize)> = found.iter().map(|(name, n)| (name.as_str(), *n)).collect();
    assert_eq!(found, expected);
}
