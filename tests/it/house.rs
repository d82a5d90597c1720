//! Rules of the house that hold for all sources.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use plenocal::model::Parameter;

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
    let circles = circles(&sources(&["src"], &["rs"]));
    let shown: Vec<String> = circles.iter().map(|circle| circle.join(", ")).collect();
    assert!(circles.is_empty(), "files that import each other:\n{}", shown.join("\n"));
}

/// The place of a module in the crate, segment by segment.
type Place = Vec<String>;

/// The files of each room that import each other in circles: those that can be reached from each other.
fn circles(sources: &[(String, String)]) -> Vec<Vec<String>> {
    let modules: BTreeMap<Place, String> = sources
        .iter()
        .filter(|(path, _)| !path.ends_with("tests.rs"))
        .map(|(path, text)| (place(path), code(text)))
        .collect();
    let paths: BTreeMap<&Place, &str> = sources
        .iter()
        .filter_map(|(path, _)| Some((modules.get_key_value(&place(path))?.0, path.as_str())))
        .collect();
    // Names that a module hands on, each with what it stands for.
    let handed_on: BTreeMap<Place, Place> = modules
        .iter()
        .flat_map(|(module, code)| {
            let exported = used(code).into_iter().filter(|(public, _)| *public);
            exported.filter_map(|(_, path)| {
                let name = path.last()?.clone();
                let own = module.iter().cloned().chain([name]).collect();
                Some((own, absolute(module, &path)))
            })
        })
        .collect();
    let arrows: BTreeMap<&Place, BTreeSet<&Place>> = modules
        .iter()
        .map(|(module, code)| {
            let imported =
                used(code).into_iter().filter(|(public, _)| !public).map(|(_, path)| path);
            let named = imported.chain(inline_paths(code)).map(|path| absolute(module, &path));
            let files = named.filter_map(|path| file_of(&path, &modules, &handed_on));
            (module, files.filter(|file| *file != module && file[0] == module[0]).collect())
        })
        .collect();
    let reached: BTreeMap<&Place, BTreeSet<&Place>> =
        modules.keys().map(|module| (module, reach(module, &arrows))).collect();
    let circle = |module: &Place| -> BTreeSet<&Place> {
        let back = |other: &&Place| reached[*other].contains(module);
        reached[module].iter().copied().filter(back).collect()
    };
    let found: BTreeSet<BTreeSet<&Place>> = modules.keys().map(circle).collect();
    let named = |circle: BTreeSet<&Place>| circle.iter().map(|m| paths[*m].to_owned()).collect();
    found.into_iter().filter(|circle| !circle.is_empty()).map(named).collect()
}

/// The module that a file of the crate is.
fn place(path: &str) -> Place {
    let inside = path.strip_prefix("src/").unwrap_or(path).trim_end_matches(".rs");
    inside.trim_end_matches("/mod").split('/').map(str::to_owned).collect()
}

/// All modules that arrows lead to from one, in one step or more.
fn reach<'a>(
    from: &'a Place,
    arrows: &BTreeMap<&'a Place, BTreeSet<&'a Place>>,
) -> BTreeSet<&'a Place> {
    let (mut reached, mut open) = (BTreeSet::new(), vec![from]);
    while let Some(module) = open.pop() {
        open.extend(arrows[module].iter().copied().filter(|next| reached.insert(*next)));
    }
    reached
}

/// A path from the root of the crate.
fn absolute(module: &Place, path: &[String]) -> Place {
    let mut base = module.clone();
    let mut rest = path;
    while let Some((first, after)) = rest.split_first() {
        match first.as_str() {
            "crate" => base.clear(),
            "super" => {
                base.pop();
            }
            "self" => {}
            _ => break,
        }
        rest = after;
    }
    base.into_iter().chain(rest.iter().cloned()).collect()
}

/// The file in which what a path names is defined, through the faces that hand it on.
fn file_of<'a>(
    path: &[String],
    modules: &'a BTreeMap<Place, String>,
    handed_on: &BTreeMap<Place, Place>,
) -> Option<&'a Place> {
    let mut path = path.to_vec();
    // Faces that hand on each other's names would lead round and round.
    for _ in 0..10 {
        let through = (1..=path.len()).find_map(|n| Some((n, handed_on.get(&path[..n])?)));
        let Some((n, target)) = through else { break };
        path = target.iter().chain(&path[n..]).cloned().collect();
    }
    let longest_first = (1..=path.len()).rev();
    longest_first.filter_map(|n| modules.get_key_value(&path[..n])).map(|(module, _)| module).next()
}

/// What `use` declarations import from the crate, and whether they hand it on.
fn used(code: &str) -> Vec<(bool, Vec<String>)> {
    let mut found = Vec::new();
    for declaration in code.split(';') {
        let words: Vec<&str> = declaration.split_whitespace().collect();
        let Some(at) = words.iter().rposition(|word| *word == "use") else { continue };
        let public = at > 0 && (words[at - 1].starts_with("pub") || words[at - 1].ends_with(')'));
        let tree = words[at + 1..].join(" ");
        let mut paths = Vec::new();
        expand(&tree, "", &mut paths);
        found.extend(paths.into_iter().map(|path| (public, segments(&path))));
    }
    found
}

/// Expands `a::{b, c::{d, e}}` into paths.
fn expand(tree: &str, before: &str, paths: &mut Vec<String>) {
    let Some((prefix, rest)) = tree.split_once('{') else {
        paths.push(format!("{before}{tree}"));
        return;
    };
    let before = format!("{before}{prefix}");
    let list = rest.rsplit_once('}').map_or(rest, |(list, _)| list);
    let (mut depth, mut begin) = (0, 0);
    for (at, c) in list.char_indices().chain([(list.len(), ',')]) {
        match c {
            '{' => depth += 1,
            '}' => depth -= 1,
            ',' if depth == 0 => {
                if !list[begin..at].trim().is_empty() {
                    expand(&list[begin..at], &before, paths);
                }
                begin = at + 1;
            }
            _ => {}
        }
    }
}

fn segments(path: &str) -> Vec<String> {
    let name = path.split(" as ").next().unwrap_or(path);
    name.split("::").map(|segment| segment.trim().to_owned()).collect()
}

/// Paths into the crate outside `use` declarations, as of `super::a::f(x)`.
fn inline_paths(code: &str) -> Vec<Vec<String>> {
    let is_part = |c: char| c.is_alphanumeric() || c == '_' || c == ':';
    let words = code.split(|c: char| !is_part(c));
    words.filter(|w| w.starts_with("crate::") || w.starts_with("super::")).map(segments).collect()
}

/// The source without comments, texts and what is for tests or documents only.
fn code(text: &str) -> String {
    let mut bare = String::new();
    let mut rest = text;
    while let Some(c) = rest.chars().next() {
        let skipped = match c {
            '/' if rest.starts_with("//") => rest.find('\n').unwrap_or(rest.len()),
            'r' if rest.starts_with("r#\"") => rest[3..].find("\"#").map_or(rest.len(), |i| i + 5),
            '"' => end_of_text(rest),
            '\'' if rest[1..].starts_with('\\') => {
                rest[3..].find('\'').map_or(rest.len(), |i| i + 4)
            }
            '\'' if rest.chars().nth(2) == Some('\'') => {
                rest.chars().take(3).map(char::len_utf8).sum()
            }
            _ => {
                bare.push(c);
                rest = &rest[c.len_utf8()..];
                continue;
            }
        };
        rest = &rest[skipped..];
    }
    for attribute in ["#[cfg(test)]", "#[cfg(doc)]"] {
        while let Some(at) = bare.find(attribute) {
            let item = at + attribute.len();
            bare.replace_range(at..item + end_of_item(&bare[item..]), "");
        }
    }
    bare
}

/// Length of a text in quotation marks.
fn end_of_text(source: &str) -> usize {
    let mut escaped = false;
    let end = source.char_indices().skip(1).find(|(_, c)| {
        let ends = *c == '"' && !escaped;
        escaped = *c == '\\' && !escaped;
        ends
    });
    end.map_or(source.len(), |(at, _)| at + 1)
}

/// Length of the item that a source begins with.
fn end_of_item(source: &str) -> usize {
    let mut depth = 0;
    let is_import = source.split_whitespace().take(2).any(|word| word == "use");
    for (at, c) in source.char_indices() {
        match c {
            '{' | '(' | '[' => depth += 1,
            '}' | ')' | ']' => depth -= 1,
            _ => {}
        }
        if depth < 0 {
            return at;
        }
        if depth == 0 && (c == ';' || (c == '}' && !is_import)) {
            return at + 1;
        }
    }
    source.len()
}

#[test]
fn circles_are_found_wherever_they_hide() {
    let found = |files: &[(&str, &str)]| -> Vec<Vec<String>> {
        let sources: Vec<(String, String)> = files
            .iter()
            .map(|(file, text)| (format!("src/room/{file}.rs"), (*text).to_owned()))
            .collect();
        let short = |path: &String| path["src/room/".len()..].trim_end_matches(".rs").to_owned();
        circles(&sources).iter().map(|circle| circle.iter().map(short).collect()).collect()
    };
    let face = ("mod", "mod a; mod b; mod c;\npub use a::A;\npub(crate) use b::{One, Two};");
    let a = ("a", "#[cfg(test)]\nuse super::c::Zero;\nuse super::{One, c::Three};");
    let b = ("b", "use crate::room::c::{Four,\n    Five};");
    let of = |c: &'static str| found(&[face, a, b, ("c", c)]);
    assert!(of("use crate::other::Six;\n// use super::a::Seven;").is_empty());
    assert!(of("#[cfg(test)]\nmod tests { use super::super::a::Seven; }").is_empty());
    assert!(of("const NAME: &str = \"super::a::Seven\"; const QUOTE: char = '\"';").is_empty());
    // By name, through the face, by a path in the code, and after what is for tests only.
    assert_eq!(of("use super::b::Two;"), [["b", "c"]]);
    assert_eq!(of("use crate::room::Two;"), [["b", "c"]]);
    assert_eq!(of("fn f() -> u8 { super::b::two(1) }"), [["b", "c"]]);
    assert_eq!(of("#[cfg(test)]\nuse super::a::Eight;\nuse super::b::Two;"), [["b", "c"]]);
    assert_eq!(of("use super::A;"), [["a", "b", "c"]]);
    // A file and one of its folder, and two circles of one room.
    let nested = [("a", "use self::d::D;"), ("a/d", "use super::E;")];
    assert_eq!(found(&nested), [["a", "a/d"]]);
    let two = [nested[0], nested[1], ("e", "use super::f::F;"), ("f", "use super::e::E;")];
    assert_eq!(found(&two), [["a", "a/d"], ["e", "f"]]);
}

/// The rows of a table of parameters in the documentation.
fn parameter_rows() -> String {
    let row = |parameter: Parameter| {
        let tokens = parameter.key()[1..].split('/').enumerate();
        let key: String = tokens
            .map(|(i, token)| match token.parse::<usize>() {
                Ok(index) => format!("[{index}]"),
                Err(_) if i == 0 => token.to_owned(),
                Err(_) => format!(".{token}"),
            })
            .collect();
        let (name, unit, description) =
            (parameter.name(), parameter.unit(), parameter.description().replace('|', "\\|"));
        format!("| `{name}` | `{key}` | {unit} | {description} |\n")
    };
    let head = "| symbol | place | unit | |\n|---|---|---|---|\n".to_owned();
    head + &Parameter::ALL.into_iter().map(row).collect::<String>()
}

/// The reference page has the table of parameters; the message of this test is what belongs there.
#[test]
fn the_reference_lists_all_parameters() {
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/files.md");
    let page = fs::read_to_string(page).unwrap();
    let (_, rest) = page.split_once("<!-- parameters -->\n").unwrap();
    let (found, _) = rest.split_once("<!-- /parameters -->").unwrap();
    let expected = parameter_rows();
    assert!(found == expected, "the table of parameters in docs/files.md has to be\n{expected}");
}

/// The Rust of the README stands, line by line, in an example that is compiled.
#[test]
fn the_readme_speaks_rust() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let readme = fs::read_to_string(root.join("README.md")).unwrap();
    let example = fs::read_to_string(root.join("examples/calibrate.rs")).unwrap();
    let mut compiled = example.lines().map(str::trim);
    let (_, block) = readme.split_once("```rust\n").unwrap();
    let (block, _) = block.split_once("```").unwrap();
    for line in block.lines().map(str::trim) {
        assert!(compiled.any(|other| other == line), "not in examples/calibrate.rs: {line}");
    }
}

/// What an integral over an opening, a pixel or its point spread is made of.
const OF_INTEGRALS: [&str; 6] = ["erf(", "erfc(", "cyl_bessel", "j1(", "quadrature", "overlap("];

/// The measured tables in the documents are made by `examples/evidence`: each block by one part.
#[test]
fn every_block_of_evidence_is_made_by_a_part() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let program = fs::read_to_string(root.join("examples/evidence/main.rs")).unwrap();
    let quoted = |text: &str| -> Vec<String> {
        text.split('"').skip(1).step_by(2).map(str::to_owned).collect()
    };
    let list = program.split("fn parts()").nth(1).unwrap().split("\n}").next().unwrap();
    let mut made = BTreeSet::new();
    for part in list.split("part!(").skip(1) {
        let name = quoted(part).swap_remove(0);
        match part.split("blocks[").nth(1).and_then(|rest| rest.split(']').next()) {
            Some(blocks) => made.extend(quoted(blocks).iter().map(|b| format!("{name}/{b}"))),
            None => drop(made.insert(name)),
        }
    }
    let mut shown = BTreeSet::new();
    for (_, page) in sources(&["docs"], &["md"]) {
        let names = page.split("<!-- evidence: ").skip(1);
        shown.extend(names.filter_map(|rest| Some(rest.split(" -->").next()?.to_owned())));
    }
    assert!(shown.len() > 10, "{shown:?}");
    assert_eq!(made, shown);
}

/// Light is integrated over the opening of a micro-lens in `optics`, and by the ray tracer, which is there to contradict it.
#[test]
fn there_is_one_model_of_light() {
    let others: Vec<String> = sources(&["src"], &["rs"])
        .into_iter()
        .filter(|(path, _)| {
            !["src/optics/", "src/simulation/"].iter().any(|own| path.starts_with(own))
        })
        .filter(|(_, text)| integrates_light(&code(text)))
        .map(|(path, _)| path)
        .collect();
    assert!(others.is_empty(), "light is integrated outside of src/optics:\n{}", others.join("\n"));
    assert!(
        integrates_light("let part = libm::erfc(z);")
            && integrates_light("Quadrature::of_blur(rho)")
    );
    // It is found where it is.
    let own =
        sources(&["src"], &["rs"]).into_iter().filter(|(_, text)| integrates_light(&code(text)));
    assert!(own.count() > 3);
}

fn integrates_light(code: &str) -> bool {
    let code = code.to_lowercase();
    OF_INTEGRALS.iter().any(|word| code.contains(word))
}
