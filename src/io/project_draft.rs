//! Draft of a project file: known values of a camera and its images, and comments for the rest.

use std::fmt::Write as _;
use std::fs;
use std::path::{Component, Path, PathBuf};

use serde::Serialize;

use super::data_set_folder::name_of;
use super::image_folder::{CommonFormat, NamedFNumber, SortedImages};
use crate::error::{Error, Result};
use crate::image::Color;
use crate::model::{Board, Datasheet};

/// Values from which a project file is drafted. A `None` is not known, and becomes a comment.
#[derive(Debug, Clone, Copy)]
pub struct ProjectDraft<'a> {
    /// Sorted images.
    pub images: &'a SortedImages,
    /// Format shared by the images.
    pub format: Option<CommonFormat>,
    /// Meaning of the samples.
    pub color: Option<Color>,
    /// Name and values of a camera of this kind.
    pub preset: Option<(&'a str, &'a Datasheet)>,
    /// F as engraved, mm; takes precedence over the preset, as do the next two.
    pub focal_length_mm: Option<f64>,
    /// F-number N of the images of the boards.
    pub f_number: Option<f64>,
    /// Focus distance h, mm.
    pub focus_distance_mm: Option<f64>,
    /// Board.
    pub board: Option<Board>,
    /// Motion between the images of a translation, mm.
    pub step_mm: Option<f64>,
}

/// Draft of a project file.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct DraftText {
    /// Text of the file.
    pub text: String,
    /// Values to fill in, one item per line.
    pub missing: Vec<String>,
}

/// Mark of a missing value.
pub(super) const FILL_IN: &str = "FILL IN";
/// Column of the comments.
const COMMENT: usize = 30;

impl DraftText {
    fn line(&mut self, text: &str) {
        self.text.push_str(text);
        self.text.push('\n');
    }

    fn table(&mut self, name: &str, comment: &str) {
        self.line("");
        self.commented(&format!("[{name}]"), comment);
    }

    fn commented(&mut self, text: &str, comment: &str) {
        if comment.is_empty() {
            self.line(text);
        } else {
            self.line(&format!("{text:<COMMENT$}# {comment}"));
        }
    }

    /// Writes `key = value`, or instead a comment that describes the value with `what`.
    fn value(&mut self, table: &str, key: &str, value: Option<String>, what: &str) {
        if let Some(value) = value {
            self.commented(&format!("{key} = {value}"), what);
        } else {
            self.commented(&format!("# {key} = ?"), &format!("{FILL_IN}: {what}"));
            self.missing.push(format!("[{table}] {key}: {what}"));
        }
    }

    fn list(&mut self, key: &str, names: &[String]) {
        self.line(&format!("{key} = ["));
        for name in names {
            self.line(&format!("  {name},"));
        }
        self.line("]");
    }
}

impl ProjectDraft<'_> {
    /// Returns the text of a project file in `folder`; paths are relative to it.
    pub fn text(&self, folder: &Path) -> Result<DraftText> {
        let mut draft = DraftText::default();
        draft.line("# plenocal project: a camera, a board, and their images.");
        if let Some((name, _)) = self.preset {
            let _ = writeln!(
                draft.text,
                "# Values marked (preset) are taken from the preset {name}: compare them with your \
                 camera."
            );
        }
        self.camera(&mut draft);
        self.board(&mut draft);
        self.image_lists(&mut draft, &canonical(folder)?)?;
        Ok(draft)
    }

    fn sheet(&self) -> Option<&Datasheet> {
        self.preset.map(|(_, sheet)| sheet)
    }

    /// Returns the preset if its sensor has the size of the images: otherwise its pixel size and numbers of micro-lenses do not
    /// apply to the images.
    fn sheet_of_size(&self) -> Option<&Datasheet> {
        let size = self.format.map(|format| (format.width_px, format.height_px));
        self.sheet().filter(|s| size.is_none_or(|at| at == (s.sensor.width_px, s.sensor.height_px)))
    }

    fn camera(&self, draft: &mut DraftText) {
        let of_preset = |given: bool, what: &str| {
            if given { format!("{what} (preset)") } else { what.to_owned() }
        };
        let number = |value: f64| value.to_string();
        let (sheet, of_size) = (self.sheet(), self.sheet_of_size());
        let known = self.format;

        draft.table("sensor", "");
        let width = known.map(|format| format.width_px.to_string());
        draft.value("sensor", "width_px", width, "as in the images");
        let height = known.map(|format| format.height_px.to_string());
        draft.value("sensor", "height_px", height, "as in the images");
        let what = of_preset(of_size.is_some(), "edge of a pixel");
        let pixel = of_size.map(|s| number(s.sensor.pixel_size_mm));
        draft.value("sensor", "pixel_size_mm", pixel, &what);

        draft.table("main_lens", "");
        for (key, own, preset, what) in [
            (
                "focal_length_mm",
                self.focal_length_mm,
                sheet.map(|s| s.focal_length_mm),
                "as engraved on the lens",
            ),
            (
                "f_number",
                self.f_number,
                sheet.map(|s| s.f_number),
                "of the board images, the true value: 5.657 if 5.6 is engraved",
            ),
            (
                "focus_distance_mm",
                self.focus_distance_mm,
                sheet.map(|s| s.focus_distance_mm),
                "from the sensor; inf for infinity",
            ),
        ] {
            let what = of_preset(own.is_none() && preset.is_some(), what);
            draft.value("main_lens", key, own.or(preset).map(number), &what);
        }

        draft.table("micro_lens_array", "");
        let named = |key: &str, what: &str, value: Option<String>, draft: &mut DraftText| {
            let what = of_preset(value.is_some(), what);
            draft.value("micro_lens_array", key, value, &what);
        };
        let configuration = sheet.map(|s| name_of(&s.configuration));
        let what = "\"galilean\", \"keplerian\" or \"unfocused\"";
        named("configuration", what, configuration, draft);
        let lattice = sheet.map(|s| format!("\"{}\"", s.lattice_kind.name()));
        let what = "\"hexagonal-rows\", \"hexagonal-columns\" or \"orthogonal\"";
        named("lattice", what, lattice, draft);
        if let Some((columns, rows)) = of_size.and_then(|s| s.array_size) {
            named("columns", "micro-lenses along a row", Some(columns.to_string()), draft);
            named("rows", "micro-lenses along a column", Some(rows.to_string()), draft);
        }
        let types = sheet.map(|s| s.lens_types.to_string());
        named("lens_types", "number of lens types, 0 for pinholes", types, draft);
    }

    fn board(&self, draft: &mut DraftText) {
        draft.table("board", "");
        draft.line("# Measure the edge of a square over as many as there are, along rows and along columns.");
        draft.line("# Lay a straight edge along rows, columns and diagonals: the gap under it should be below");
        draft.line("# 1/2000 of the diagonal, and has to be below 1/200.");
        let board = self.board;
        let columns = board.map(|b| b.columns.to_string());
        draft.value("board", "columns", columns, "inner corners along a row");
        let rows = board.map(|b| b.rows.to_string());
        draft.value("board", "rows", rows, "inner corners along a column");
        draft.value(
            "board",
            "square_mm",
            board.map(|b| b.square_mm.to_string()),
            "edge of a square, the mean of rows and columns",
        );
    }

    fn image_lists(&self, draft: &mut DraftText, folder: &Path) -> Result<()> {
        let images = self.images;
        let name = |path: &Path| relative(path, folder);
        let names =
            |paths: &[PathBuf]| paths.iter().map(|p| name(p)).collect::<Result<Vec<String>>>();
        draft.table("images", "paths are relative to this file");
        let color = self.color.map(|color| format!("\"{}\"", color.name()));
        let what = "\"grey\", \"rgb\", or the mosaic: \"bayer-rggb\", \"bayer-grbg\", ...";
        draft.value("images", "color", color, what);
        if images.dark.is_empty() {
            let what = "grey levels without light; measured on the white images if left out";
            draft.commented("# black_level = ...", what);
        }
        one_of(
            draft,
            ("devignetting", &names(&images.devignetting)?),
            "a white image in the light and at the f-number of the boards",
        );
        one_of(
            draft,
            ("dark", &names(&images.dark)?),
            "an image with the lens covered, at the exposure time and gain of the others",
        );
        draft.list("calibration", &names(&images.calibration)?);
        if !images.evaluation.is_empty() {
            draft.list("evaluation", &names(&images.evaluation)?);
        }
        let unsorted = names(&images.unsorted)?;
        if !unsorted.is_empty() {
            draft.line(&format!(
                "# {FILL_IN}: the content of these images is not clear from their names; move them \
                 to the lists."
            ));
            draft.missing.push(format!(
                "[images]: move the {} images with unclear names to the lists",
                unsorted.len()
            ));
        }
        for name in &unsorted {
            draft.line(&format!("#   {name},"));
        }
        if images.has_raw() {
            draft.table("images.raw", "layout of the .raw files, which have no header");
            let what = "\"Mono12p\", \"Mono12Packed\", \"raw12\", \"Mono16\", ...";
            draft.value("images.raw", "packing", None, what);
            draft.commented("# header_bytes = ...", "bytes before the first row, if there are any");
            draft.commented("# row_bytes = ...", "bytes from row to row, if rows are padded");
        }
        for (path, f_number) in &images.whites {
            let image = name(path)?;
            draft.line("\n[[images.whites]]");
            draft.line(&format!("image = {image}"));
            match f_number {
                Some(NamedFNumber::Stop(stop)) => draft.line(&format!("stop = {stop}")),
                Some(NamedFNumber::FNumber(number)) => draft.line(&format!("f_number = {number}")),
                None => {
                    let what = "as engraved on the lens; or f_number, the true one";
                    draft.commented("# stop = ?", &format!("{FILL_IN}: {what}"));
                    draft.missing.push(format!("[[images.whites]] stop: of {image}, {what}"));
                }
            }
        }
        self.translation(draft, &names(&images.translation)?);
        Ok(())
    }

    /// Writes a translation. Without its step it is useless, so the whole table becomes a comment.
    fn translation(&self, draft: &mut DraftText, names: &[String]) {
        if names.is_empty() {
            return;
        }
        let begin = draft.text.len();
        draft.table("images.translation", "a board moved along the optical axis");
        let what = "motion from image to image, mm; negative towards the camera";
        let table = "images.translation";
        draft.value(table, "step_mm", self.step_mm.map(|s| s.to_string()), what);
        draft.list("images", names);
        if self.step_mm.is_none() {
            let table = draft.text.split_off(begin);
            draft.line(&format!(
                "\n# {FILL_IN} the step of this table, then remove the # from the start of its \
                 lines."
            ));
            for line in table.lines().filter(|line| !line.is_empty()) {
                draft.line(&format!("# {}", line.strip_prefix("# ").unwrap_or(line)));
            }
        }
    }
}

/// Writes the image of this key, or all that may be meant; without one, a comment that says what it would be.
fn one_of(draft: &mut DraftText, (key, names): (&str, &[String]), what: &str) {
    match names {
        [] => draft.commented(&format!("# {key} = \"...\""), what),
        [one] => draft.line(&format!("{key} = {one}")),
        several => {
            for name in several {
                draft.commented(&format!("# {key} = {name}"), &format!("{FILL_IN}: {what}"));
            }
            draft
                .missing
                .push(format!("[images] {key}: which of the {} images is {what}", several.len()));
        }
    }
}

/// Returns an absolute path without links. A part that does not exist yet is kept.
fn canonical(path: &Path) -> Result<PathBuf> {
    let unreadable = |source| Error::Read { path: path.to_owned(), source };
    let absolute = std::path::absolute(path).map_err(unreadable)?;
    let there = absolute.ancestors().find(|folder| folder.exists()).unwrap_or(&absolute);
    let rest = absolute.strip_prefix(there).unwrap_or(Path::new(""));
    Ok(fs::canonicalize(there).map_err(unreadable)?.components().chain(rest.components()).collect())
}

/// Returns a path relative to a folder, both without links, quoted. The name of the file itself stays, even if it is a link.
fn relative(path: &Path, folder: &Path) -> Result<String> {
    let parent = path.parent().filter(|parent| !parent.as_os_str().is_empty());
    let parent = canonical(parent.unwrap_or(Path::new(".")))?;
    let common = parent.components().zip(folder.components()).take_while(|(a, b)| a == b).count();
    let up = folder.components().skip(common).map(|_| Component::ParentDir);
    let down = parent.components().skip(common);
    let seen: PathBuf = up.chain(down).collect();
    let seen = seen.join(path.file_name().unwrap_or_default());
    let name = seen
        .to_str()
        .ok_or_else(|| Error::content(path, "the name of this file is not UTF-8: rename it"))?;
    Ok(quoted(name))
}

/// Returns a string of TOML on one line: JSON escapes the same characters in the same way as TOML.
fn quoted(text: &(impl Serialize + ?Sized)) -> String {
    serde_json::to_string(text).unwrap_or_default()
}
