//! Detection of misspelt names, and messages of the readers of TOML, JSON and CSV in words of users.

/// Returns the known name that a name resembles.
pub(super) fn meant<'a>(found: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    known.into_iter().find(|name| looks_like(&found.to_lowercase(), name))
}

/// Returns true if a word differs from a name by one letter too many, too few or wrong, or by two exchanged letters. A long
/// name may differ by any two of these.
pub(super) fn looks_like(found: &str, name: &str) -> bool {
    const SHORTEST: usize = 3;
    const LONG: usize = 6;
    let most = if name.len() < LONG { 1 } else { 2 };
    if name.len() < SHORTEST {
        // In a name of one or two letters, only the case may differ.
        return found == name;
    }
    if found.len().abs_diff(name.len()) > most {
        return false;
    }
    let (a, b): (Vec<char>, Vec<char>) = (found.chars().collect(), name.chars().collect());
    let mut steps = vec![vec![0; b.len() + 1]; a.len() + 1];
    for i in 0..=a.len() {
        for j in 0..=b.len() {
            steps[i][j] = if i == 0 || j == 0 {
                i + j
            } else {
                let changed = steps[i - 1][j - 1] + usize::from(a[i - 1] != b[j - 1]);
                let exchanged = if i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1] {
                    steps[i - 2][j - 2] + 1
                } else {
                    usize::MAX
                };
                changed.min(exchanged).min(steps[i - 1][j] + 1).min(steps[i][j - 1] + 1)
            };
        }
    }
    steps[a.len()][b.len()] <= most
}

/// Types expected by readers, and their names for users.
const TYPES: [(&str, &str); 13] = [
    ("i32", "a whole number from -2147483648 to 2147483647"),
    ("u32", "a whole number from 0 to 4294967295"),
    ("i64", "a whole number"),
    ("u64", "a whole number that is not negative"),
    ("usize", "a whole number that is not negative"),
    ("f64", "a number"),
    ("f32", "a number"),
    ("a string", "a text"),
    ("a borrowed string", "a text"),
    ("path string", "the name of a file"),
    ("a boolean", "true or false"),
    ("a sequence", "a list"),
    ("a map", "a table"),
];

/// Returns a message of a reader without names of types; after an unknown key, it suggests the similar one.
pub(super) fn plain(message: &str) -> String {
    let message = message.replace(" as i128", "").replace(" as u128", "");
    let lines: Vec<String> = message.split('\n').map(plain_line).collect();
    lines.join("\n")
}

fn plain_line(line: &str) -> String {
    if let Some(suggested) = with_suggestion(line) {
        return suggested;
    }
    let Some((before, expected)) = line.split_once("expected ") else { return line.to_owned() };
    let names = |name: &str| {
        expected.strip_prefix(name).filter(|rest| !rest.starts_with(|c: char| c.is_alphanumeric()))
    };
    let of_type = TYPES.iter().find_map(|(name, word)| Some(format!("{word}{}", names(name)?)));
    let count = |word: &str| -> Option<&str> {
        expected.strip_prefix(word)?.split(|c: char| !c.is_ascii_digit()).next()
    };
    let of_list = ["a tuple of size ", "an array of length ", "fewer elements in array"];
    let list = of_list.iter().find_map(|word| count(word)).filter(|count| !count.is_empty());
    let table = expected.starts_with("struct ") || expected.starts_with("internally tagged enum");
    let word = if let Some(word) = of_type {
        word
    } else if let Some(count) = list {
        let rest = expected.split_once(count).map_or("", |(_, rest)| rest);
        format!("a list of {count} values{rest}")
    } else if table {
        "a table with keys and values".to_owned()
    } else {
        return line.to_owned();
    };
    format!("{before}expected {word}")
}

/// Rewrites "unknown field `a`, expected one of `b`, `c`" with only the similar name.
fn with_suggestion(line: &str) -> Option<String> {
    let (before, rest) = line.split_once("unknown field `")?;
    let (found, rest) = rest.split_once('`')?;
    let known = rest.split('`').skip(1).step_by(2);
    let meant = meant(found, known)?;
    Some(format!("{before}unknown field `{found}`: did you mean `{meant}`?"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_have_words_of_users() {
        for (message, words) in [
            (
                "a: invalid type: string \"x\", expected i32",
                "expected a whole number from -2147483648",
            ),
            (
                "invalid value: integer `9999` as i128, expected u32",
                "integer `9999`, expected a whole",
            ),
            (
                "invalid type: null, expected struct CameraFile with 6 elements",
                "expected a table with",
            ),
            ("invalid length 2, expected an array of length 3", "expected a list of 3 values"),
            (
                "invalid length 2, expected a tuple of size 3 at line 4",
                "a list of 3 values at line 4",
            ),
            ("x\ninvalid type: map, expected f64\ny", "x\ninvalid type: map, expected a number\ny"),
            (
                "unknown field `colour`, expected one of `color`, `whites`",
                "`colour`: did you mean `color`?",
            ),
            ("unknown field `x`, expected one of `color`, `whites`", "one of `color`, `whites`"),
            ("expected `,` or `}` at line 3", "expected `,` or `}` at line 3"),
        ] {
            let told = plain(message);
            assert!(told.contains(words), "{told}");
        }
    }
}
