//! Rules of the house that hold for all sources.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

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
fn both_languages_are_of_one_version() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let header = fs::read_to_string(root.join("cpp/include/plenocal/version.hpp")).unwrap();
    let version = env!("CARGO_PKG_VERSION");
    assert!(header.contains(&format!("PLENOCAL_VERSION \"{version}\"")), "{version}");
    for (name, part) in ["MAJOR", "MINOR", "PATCH"].iter().zip(version.split('.')) {
        assert!(header.contains(&format!("PLENOCAL_VERSION_{name} {part}\n")), "{name} {part}");
    }
}

/// Files of a room do not import each other in a circle.
#[test]
fn no_import_circle_lies_inside_a_room() {
    let sources = sources(&["src"], &["rs"]);
    let mut rooms: BTreeMap<&str, Vec<(&str, &str)>> = BTreeMap::new();
    for (path, text) in &sources {
        let inside = path.strip_prefix("src/").unwrap();
        if let Some((room, file)) = inside.split_once('/') {
            // The files below `a/` belong to the module `a`.
            let module = file.split(['/', '.']).next().unwrap();
            rooms.entry(room).or_default().push((module, text));
        }
    }
    let circles: Vec<String> = rooms
        .iter()
        .filter_map(|(room, files)| Some(format!("{room}: {}", circle(room, files)?.join(" -> "))))
        .collect();
    assert!(circles.is_empty(), "import circles:\n{}", circles.join("\n"));
}

/// A circle of imports among the modules of a room, if there is one.
fn circle(room: &str, files: &[(&str, &str)]) -> Option<Vec<String>> {
    let modules: BTreeSet<&str> = files.iter().map(|(module, _)| *module).collect();
    // Names that the face of the room hands on, each with the module that defines it.
    let mut handed_on: BTreeMap<String, &str> = BTreeMap::new();
    for (_, face) in files.iter().filter(|(module, _)| *module == "mod") {
        for path in imports(face) {
            let module = modules.iter().find(|module| **module == path[0]);
            if let Some(module) = module.filter(|_| path.len() > 1) {
                handed_on.insert(path[path.len() - 1].clone(), module);
            }
        }
    }
    let mut arrows: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
    for (module, text) in files.iter().filter(|(module, _)| *module != "mod") {
        // Tests may look wherever they like.
        let code = text.split("#[cfg(test)]").next().unwrap();
        for path in imports(code) {
            let path: Vec<&str> = path.iter().map(String::as_str).collect();
            let inside = match path.as_slice() {
                ["super", rest @ ..] => rest,
                ["crate", first, rest @ ..] if first == &room => rest,
                _ => continue,
            };
            let Some(first) = inside.first() else { continue };
            let target = modules.iter().find(|module| *module == first);
            let target = target.or_else(|| handed_on.get(*first)).copied();
            if let Some(target) = target.filter(|target| target != module) {
                arrows.entry(module).or_default().insert(target);
            }
        }
    }
    modules.iter().find_map(|start| way_back(start, start, &arrows, &mut BTreeSet::new()))
}

/// The way from a module along arrows to `goal`, both ends included.
fn way_back<'a>(
    from: &'a str,
    goal: &str,
    arrows: &BTreeMap<&'a str, BTreeSet<&'a str>>,
    seen: &mut BTreeSet<&'a str>,
) -> Option<Vec<String>> {
    for next in arrows.get(from)? {
        let rest = if *next == goal {
            Some(vec![goal.to_owned()])
        } else if seen.insert(next) {
            way_back(next, goal, arrows, seen)
        } else {
            None
        };
        if let Some(mut rest) = rest {
            rest.insert(0, from.to_owned());
            return Some(rest);
        }
    }
    None
}

/// The paths that `use` declarations import, segment by segment.
fn imports(text: &str) -> Vec<Vec<String>> {
    let mut paths = Vec::new();
    let code: String =
        text.lines().filter(|l| !l.trim_start().starts_with("//")).collect::<Vec<_>>().join(" ");
    for declaration in code.split(';') {
        let words: Vec<&str> = declaration.split_whitespace().collect();
        if let Some(at) = words.iter().position(|word| *word == "use") {
            expand(&words[at + 1..].concat(), &mut Vec::new(), &mut paths);
        }
    }
    paths
}

/// Expands `a::{b, c::{d, e}}` into paths.
fn expand(tree: &str, prefix: &mut Vec<String>, paths: &mut Vec<Vec<String>>) {
    let depth = prefix.len();
    if let Some(open) = tree.find('{') {
        prefix.extend(tree[..open].split("::").filter(|s| !s.is_empty()).map(str::to_owned));
        let list = tree[open + 1..].strip_suffix('}').unwrap_or(&tree[open + 1..]);
        let (mut level, mut begin) = (0, 0);
        for (at, c) in list.char_indices().chain([(list.len(), ',')]) {
            match c {
                '{' => level += 1,
                '}' => level -= 1,
                ',' if level == 0 => {
                    if begin < at {
                        expand(&list[begin..at], prefix, paths);
                    }
                    begin = at + 1;
                }
                _ => {}
            }
        }
    } else {
        prefix.extend(tree.split("::").map(str::to_owned));
        paths.push(prefix.clone());
    }
    prefix.truncate(depth);
}

#[test]
fn circles_are_found_through_lists_and_the_face_of_a_room() {
    let face = ("mod", "mod a; mod b; mod c; pub use b::{One, Two};");
    let a = ("a", "use super::{One, c::Three};");
    let b = ("b", "use crate::room::c::{Four,\n    Five};");
    let found = |c: &'static str| circle("room", &[face, a, b, ("c", c)]);
    assert_eq!(found("use crate::other::Six;\n// use super::a::Seven;"), None);
    assert_eq!(found("use super::b::Two;").unwrap().concat(), "bcb");
    assert_eq!(found("use super::a::Seven;").unwrap().concat(), "abca");
    assert_eq!(found("#[cfg(test)] mod tests { use super::a::Seven; }"), None);
}
