//! Ways to damage a file. The same numbers give the same damage.

use rand::RngExt;
use rand::rngs::StdRng;
use serde_json::Value;

/// What takes the place of a number or of another value.
const VALUES: [&str; 34] = [
    "0",
    "-0",
    "-1",
    "1",
    "2",
    "3.5",
    "-2",
    "500",
    "99999",
    "1e308",
    "-1e308",
    "1e-308",
    "5e-324",
    "1e400",
    "nan",
    "NaN",
    "inf",
    "-inf",
    "Infinity",
    "2147483647",
    "-2147483648",
    "2147483648",
    "4294967295",
    "18446744073709551615",
    "99999999999999999999999999",
    "0x10",
    "1_0",
    "",
    "null",
    "true",
    "[]",
    "{}",
    "\"\"",
    "\"x\"",
];
/// What is put between bytes.
const PIECES: [&str; 18] = [
    "\0", "\n", "\r\n", ",", ",,", "\"", "'", "[", "]", "{", "}", "=", "#", "\u{feff}", "<", "&a;",
    "é", "\u{202e}",
];
/// Brackets that are nested.
const NESTS: [(&str, &str); 5] =
    [("[", "]"), ("{\"a\":", "}"), ("[[", "]]"), ("<x>", "</x>"), ("{ a = ", " }")];
/// Levels of nesting, and length of long strings.
const LEVELS: [usize; 4] = [3, 100, 1_000, 20_000];

/// A copy with one to four damages, mostly one.
pub fn damaged(seed: &[u8], random: &mut StdRng) -> Vec<u8> {
    let mut bytes = seed.to_vec();
    let damages = if random.random_bool(0.6) { 1 } else { random.random_range(2..=4) };
    for _ in 0..damages {
        let text = std::str::from_utf8(&bytes).ok().filter(|text| !text.is_empty());
        bytes = match text {
            Some(text) if random.random_bool(0.75) => damaged_text(text, random).into_bytes(),
            _ => damaged_bytes(bytes, random),
        };
    }
    bytes
}

fn pick<'a, T>(items: &'a [T], random: &mut StdRng) -> Option<&'a T> {
    if items.is_empty() { None } else { items.get(random.random_range(0..items.len())) }
}

fn piece(random: &mut StdRng) -> &'static str {
    pick(&PIECES, random).copied().unwrap_or_default()
}

fn value(random: &mut StdRng) -> String {
    if random.random_bool(0.02) {
        return "x".repeat(pick(&LEVELS, random).copied().unwrap_or(1));
    }
    pick(&VALUES, random).copied().unwrap_or_default().to_owned()
}

/// A range within `length`, short ones more often.
fn range(length: usize, random: &mut StdRng) -> std::ops::Range<usize> {
    let begin = random.random_range(0..=length);
    let longest = if random.random_bool(0.7) { 8 } else { length };
    let end = (begin + random.random_range(0..=longest)).min(length);
    begin..end
}

fn damaged_bytes(mut bytes: Vec<u8>, random: &mut StdRng) -> Vec<u8> {
    let place = range(bytes.len(), random);
    match random.random_range(0..7) {
        0 | 1 => {
            if let Some(byte) = bytes.get_mut(place.start) {
                *byte ^= 1 << random.random_range(0..8);
            }
        }
        2 => {
            if let Some(byte) = bytes.get_mut(place.start) {
                *byte = *pick(&[0, 1, 0x7f, 0x80, 0xff], random).unwrap_or(&0);
            }
        }
        // Sizes and counts of binary files.
        3 => {
            let size = random.random_range(1..=8);
            let fill = *pick(&[0_u8, 0x7f, 0xff], random).unwrap_or(&0);
            bytes.iter_mut().skip(place.start).take(size).for_each(|byte| *byte = fill);
        }
        4 => bytes.truncate(place.start),
        5 => drop(bytes.drain(place)),
        _ => {
            let copy = bytes[place.clone()].to_vec();
            bytes.splice(place.start..place.start, copy);
        }
    }
    bytes
}

fn damaged_text(text: &str, random: &mut StdRng) -> String {
    match random.random_range(0..12) {
        0..=3 => replaced(text, &numbers(text), random),
        4 => replaced(text, &words(text), random),
        5 => edited_lines(text, random),
        6 => nested(text, random),
        7 => {
            let at = boundary(text, random);
            let (before, after) = text.split_at(at);
            [before, piece(random), after].concat()
        }
        8 => swapped_words(text, random),
        _ => match serde_json::from_str(text) {
            Ok(document) => edited_json(document, random),
            Err(_) => edited_lines(text, random),
        },
    }
}

fn boundary(text: &str, random: &mut StdRng) -> usize {
    let at = random.random_range(0..=text.len());
    (0..=at).rev().find(|&i| text.is_char_boundary(i)).unwrap_or(0)
}

type Place = std::ops::Range<usize>;

/// Where runs of such characters are.
fn runs(text: &str, belongs: impl Fn(char) -> bool) -> Vec<Place> {
    let mut found: Vec<Place> = Vec::new();
    for (at, letter) in text.char_indices().filter(|(_, letter)| belongs(*letter)) {
        let end = at + letter.len_utf8();
        match found.last_mut() {
            Some(last) if last.end == at => last.end = end,
            _ => found.push(at..end),
        }
    }
    found
}

fn numbers(text: &str) -> Vec<Place> {
    let mut found = runs(text, |c| c.is_ascii_digit() || ".+-eE".contains(c));
    found.retain(|place| text[place.clone()].contains(|c: char| c.is_ascii_digit()));
    found
}

fn words(text: &str) -> Vec<Place> {
    runs(text, |c| c.is_alphanumeric() || c == '_')
}

fn replaced(text: &str, places: &[Place], random: &mut StdRng) -> String {
    let Some(place) = pick(places, random) else { return text.to_owned() };
    [&text[..place.start], &value(random), &text[place.end..]].concat()
}

/// A word where another one was: a key that is misspelt, repeated or of another table.
fn swapped_words(text: &str, random: &mut StdRng) -> String {
    let places = words(text);
    let (Some(place), Some(other)) = (pick(&places, random), pick(&places, random)) else {
        return text.to_owned();
    };
    [&text[..place.start], &text[other.clone()], &text[place.end..]].concat()
}

/// Lines removed, repeated, or moved.
fn edited_lines(text: &str, random: &mut StdRng) -> String {
    let mut lines: Vec<&str> = text.split_inclusive('\n').collect();
    let from = random.random_range(0..lines.len());
    let to = random.random_range(0..lines.len());
    match random.random_range(0..3) {
        0 => drop(lines.remove(from)),
        1 => lines.insert(to, lines[from]),
        _ => lines.swap(from, to),
    }
    lines.concat()
}

/// Something in many brackets.
fn nested(text: &str, random: &mut StdRng) -> String {
    let (open, close) = pick(&NESTS, random).copied().unwrap_or_default();
    let levels = pick(&LEVELS, random).copied().unwrap_or(1);
    let place = if random.random_bool(0.3) { 0..text.len() } else { number_or_all(text, random) };
    let (before, inside, after) = (&text[..place.start], &text[place.clone()], &text[place.end..]);
    let closed = if random.random_bool(0.5) { close.repeat(levels) } else { String::new() };
    [before, &open.repeat(levels), inside, &closed, after].concat()
}

fn number_or_all(text: &str, random: &mut StdRng) -> Place {
    pick(&numbers(text), random).cloned().unwrap_or(0..text.len())
}

/// A value removed, replaced, put into a list, or given another name.
fn edited_json(mut document: Value, random: &mut StdRng) -> String {
    let steps = random.random_range(0..6);
    let place = descended(&mut document, steps, random);
    edit(place, random);
    document.to_string()
}

/// A value that lies up to so many levels below another.
fn descended<'a>(place: &'a mut Value, steps: usize, random: &mut StdRng) -> &'a mut Value {
    let children = match place {
        Value::Object(fields) => fields.len(),
        Value::Array(items) => items.len(),
        _ => 0,
    };
    if steps == 0 || children == 0 {
        return place;
    }
    let child = random.random_range(0..children);
    let next = match place {
        Value::Object(fields) => fields.values_mut().nth(child),
        Value::Array(items) => items.get_mut(child),
        _ => None,
    };
    descended(next.expect("there are so many"), steps - 1, random)
}

fn edit(place: &mut Value, random: &mut StdRng) {
    match (random.random_range(0..4), &mut *place) {
        (0, Value::Object(fields)) => {
            let names: Vec<String> = fields.keys().cloned().collect();
            if let Some(name) = pick(&names, random) {
                fields.remove(name);
            }
        }
        (1, Value::Object(fields)) => {
            let names: Vec<String> = fields.keys().cloned().collect();
            if let Some(value) = pick(&names, random).and_then(|name| fields.remove(name)) {
                fields.insert("misspelt".to_owned(), value);
            }
        }
        (0, Value::Array(items)) => drop(items.pop()),
        (1, Value::Array(items)) => {
            if let Some(item) = items.last().cloned() {
                items.push(item);
            }
        }
        (2, place) => *place = Value::Array(vec![place.take()]),
        (_, place) => {
            let text = value(random);
            *place = serde_json::from_str(&text).unwrap_or(Value::String(text));
        }
    }
}
