//! Blocks of the documents that the evidence is written into.

use std::fs;
use std::ops::Range;
use std::path::{Path, PathBuf};

use plenocal::io::read_text;
use plenocal::{Error, Result};

/// End of a block.
const END: &str = "<!-- end -->";

/// Returns the page of a block, its text, and the place of the block in it.
pub fn find(name: &str) -> Result<(PathBuf, String, Range<usize>)> {
    let page = name.split('/').next().unwrap_or(name);
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs").join(page).with_extension("md");
    let text = read_text(&path)?;
    let begin = format!("<!-- evidence: {name} -->\n");
    let missing = || Error::invalid(format!("there is no block '{name}'")).in_file(&path);
    let start = text.find(&begin).ok_or_else(missing)? + begin.len();
    let unended = || Error::invalid(format!("the block '{name}' has no {END}")).in_file(&path);
    let length = text[start..].find(END).ok_or_else(unended)?;
    if text[start..start + length].contains("<!-- evidence: ") {
        return Err(unended());
    }
    Ok((path, text, start..start + length))
}

/// Replaces the text of a block. The page is renamed into its place, so that it is never half written.
pub fn replace(name: &str, block: &str) -> Result<()> {
    let (path, mut text, place) = find(name)?;
    text.replace_range(place, block);
    let beside = path.with_extension("md.new");
    let written = fs::write(&beside, text).and_then(|()| fs::rename(&beside, &path));
    written.map_err(|error| Error::invalid(error.to_string()).in_file(&path))
}
