//! A report as data: sections of text, tables and figures, made from results.
//!
//! The same tree is shown on a terminal ([`Section::to_text`]), as a page ([`Report::to_html`]), and as JSON (serde).

use std::fmt::Write as _;

use serde::Serialize;
use serde_json::Value;

use crate::assessment::Verdict;
use crate::quantity::{fixed, fixed_signed, signed, significant, two_digits, with_std_dev};

/// A report.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Report {
    /// Title of the page, and its heading.
    pub title: String,
    /// Line below the title; empty for none.
    pub subtitle: String,
    /// Sections in order.
    pub sections: Vec<Section>,
}

/// A part of the report that is listed in its table of contents.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Section {
    /// Heading of the section.
    pub title: String,
    /// Question that it answers. A page shows consecutive sections with the same question together.
    pub question: Option<Question>,
    /// Parts in order.
    pub parts: Vec<Part>,
    /// Warnings of the stage. A page shows them first in the section; a terminal shows them apart from results.
    pub warnings: Vec<String>,
}

/// A question that a report answers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Question {
    /// Use of the camera: verdict and evaluation.
    Trust,
    /// Accuracy over the image and in space.
    Where,
    /// White images and images of boards.
    Images,
    /// Estimated parameters.
    Parameters,
}

impl Question {
    /// All questions, in the order of a report.
    pub const ALL: [Self; 4] = [Self::Trust, Self::Where, Self::Images, Self::Parameters];

    /// Returns the question in words.
    #[must_use]
    pub fn words(self) -> &'static str {
        match self {
            Self::Trust => "Can I trust it?",
            Self::Where => "Where is it good?",
            Self::Images => "What is wrong in the images?",
            Self::Parameters => "What are the parameters?",
        }
    }
}

/// A part of a section.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Part {
    /// The verdict in a line. A page shows it as a badge.
    Verdict {
        /// Verdict, which determines the colour.
        verdict: Verdict,
        /// Text of the line.
        text: String,
    },
    /// Plain text; empty lines divide paragraphs, line breaks stay.
    Text(String),
    /// A table.
    Table(Table),
    /// A picture.
    Figure(Figure),
    /// Images of the camera to look into, as data of a page. A terminal does not show them.
    Pictures(Value),
    /// Parts that are shown on demand, and always in print.
    Details {
        /// Summary of the parts.
        summary: String,
        /// Parts in order.
        parts: Vec<Part>,
    },
}

/// A table.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Table {
    /// Caption.
    pub caption: String,
    /// Columns. A first column of text names the rows.
    pub columns: Vec<Column>,
    /// Cells, row by row.
    pub rows: Vec<Vec<Cell>>,
}

/// A column of a table.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Column {
    /// Name of the quantity.
    pub name: String,
    /// Unit of the numbers; empty for text, for counts, and if each row has its own unit.
    pub unit: String,
    /// True if the cells are numbers, which are aligned right.
    pub is_number: bool,
}

/// A cell of a table.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Cell {
    /// A number.
    Number {
        /// Finite number, in the unit of its column or row.
        value: f64,
        /// Number with as many digits as are worth showing.
        text: String,
    },
    /// Text, also instead of a number (`fixed`); empty if a row has nothing to show.
    Text(String),
    /// A number that is not known.
    Missing,
}

/// A picture with its file name and caption.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
pub struct Figure {
    /// File name, such as `correlations.svg`.
    pub name: String,
    /// Caption, in a sentence or two.
    pub caption: String,
    /// Picture: one `<svg>` element without ids. A figure written as JSON leaves it to a separate file.
    #[serde(skip)]
    pub svg: String,
}

impl Section {
    /// Creates a section.
    #[must_use]
    pub fn new(title: &str, parts: Vec<Part>) -> Self {
        Self { title: title.to_owned(), parts, ..Self::default() }
    }

    /// Returns the address of the section on a page: its title in lower case, words joined by `-`.
    #[must_use]
    pub fn id(&self) -> String {
        let lower = self.title.to_lowercase();
        let words = lower.split(|c: char| !c.is_alphanumeric()).filter(|word| !word.is_empty());
        words.collect::<Vec<_>>().join("-")
    }

    /// Returns the tables that are shown at once.
    pub fn tables(&self) -> impl Iterator<Item = &Table> {
        self.parts.iter().filter_map(|part| match part {
            Part::Table(table) => Some(table),
            Part::Verdict { .. }
            | Part::Text(_)
            | Part::Figure(_)
            | Part::Pictures(_)
            | Part::Details { .. } => None,
        })
    }

    /// Returns the section as the answer to a question: figures first, then tables on demand.
    #[must_use]
    pub fn answering(self, question: Question) -> Self {
        let (mut parts, rest): (Vec<Part>, Vec<Part>) =
            self.parts.into_iter().partition(|part| matches!(part, Part::Figure(_)));
        parts.extend(rest.into_iter().map(|part| match part {
            Part::Table(table) => Part::details(&table.caption.clone(), vec![Part::Table(table)]),
            part => part,
        }));
        Self { parts, question: Some(question), ..self }
    }

    /// Returns all figures of the section.
    pub fn figures_mut(&mut self) -> Vec<&mut Figure> {
        fn collect<'a>(parts: &'a mut [Part], figures: &mut Vec<&'a mut Figure>) {
            for part in parts {
                match part {
                    Part::Figure(figure) => figures.push(figure),
                    Part::Details { parts, .. } => collect(parts, figures),
                    Part::Verdict { .. } | Part::Text(_) | Part::Table(_) | Part::Pictures(_) => {}
                }
            }
        }
        let mut figures = Vec::new();
        collect(&mut self.parts, &mut figures);
        figures
    }
}

/// Returns a text as a sentence: with a full stop, unless it ends as a sentence already.
#[must_use]
pub fn sentence(text: &str) -> String {
    if text.ends_with(['.', '?', '!']) { text.to_owned() } else { format!("{text}.") }
}

impl Part {
    /// Creates parts that are shown on demand.
    pub(super) fn details(summary: &str, parts: Vec<Self>) -> Self {
        Self::Details { summary: summary.to_owned(), parts }
    }

    /// Returns lines as paragraphs.
    pub(super) fn paragraphs(text: &str) -> impl Iterator<Item = Self> {
        let lines = text.lines().map(str::trim).filter(|line| !line.is_empty());
        lines.map(|line| Self::Text(line.to_owned()))
    }
}

impl Table {
    /// Creates a table without rows.
    #[must_use]
    pub fn new(caption: &str, columns: impl IntoIterator<Item = Column>) -> Self {
        let columns = columns.into_iter().collect();
        Self { caption: caption.to_owned(), columns, rows: Vec::new() }
    }

    /// Adds a row.
    pub fn push(&mut self, row: impl IntoIterator<Item = Cell>) {
        self.rows.push(row.into_iter().collect());
    }
}

impl Column {
    /// Creates a column of text.
    #[must_use]
    pub fn text(name: &str) -> Self {
        Self { name: name.to_owned(), unit: String::new(), is_number: false }
    }

    /// Creates a column of counts, or of numbers whose unit is in each row.
    #[must_use]
    pub fn number(name: &str) -> Self {
        Self { name: name.to_owned(), unit: String::new(), is_number: true }
    }

    /// Creates a column of numbers with a unit.
    #[must_use]
    pub fn of(name: &str, unit: &str) -> Self {
        Self { name: name.to_owned(), unit: unit.to_owned(), is_number: true }
    }

    /// Returns name and unit.
    #[must_use]
    pub fn heading(&self) -> String {
        let mut heading = self.name.clone();
        if !self.unit.is_empty() {
            let _ = write!(heading, ", {}", self.unit);
        }
        heading
    }
}

impl Cell {
    /// Creates an empty cell.
    #[must_use]
    pub fn empty() -> Self {
        Self::Text(String::new())
    }

    /// Creates a number with its own format; missing if it is not finite.
    fn shown(value: f64, text: impl FnOnce(f64) -> String) -> Self {
        if value.is_finite() { Self::Number { value, text: text(value) } } else { Self::Missing }
    }

    /// Creates a number with this number of decimals.
    #[must_use]
    pub fn fixed(value: f64, decimals: usize) -> Self {
        Self::shown(value, |x| fixed(x, decimals))
    }

    /// Creates a number with its sign and this number of decimals.
    #[must_use]
    pub fn signed(value: f64, decimals: usize) -> Self {
        Self::shown(value, |x| fixed_signed(x, decimals))
    }

    /// Creates a number with its sign and three significant digits.
    #[must_use]
    pub fn difference(value: f64) -> Self {
        Self::shown(value, signed)
    }

    /// Creates a number with this number of significant digits, and a power of ten if it is very small or large.
    #[must_use]
    pub fn significant(value: f64, digits: usize) -> Self {
        Self::shown(value, |x| significant(x, digits))
    }

    /// Creates a number with two significant digits; missing if it is not positive.
    #[must_use]
    pub fn two_digits(value: f64) -> Self {
        if value > 0.0 { Self::shown(value, two_digits) } else { Self::Missing }
    }

    /// Creates a cell from an optional number; missing if there is none.
    #[must_use]
    pub fn or_missing(value: Option<f64>, cell: impl FnOnce(f64) -> Self) -> Self {
        value.map_or(Self::Missing, cell)
    }

    /// Creates a value with as many digits as its standard deviation makes sensible, or six.
    #[must_use]
    pub fn value(value: f64, std_dev: Option<f64>) -> Self {
        Self::shown(value, |x| with_std_dev(x, std_dev).0)
    }

    /// Creates a standard deviation with two digits; empty if there is none or it is 0.
    #[must_use]
    pub fn std_dev(std_dev: Option<f64>) -> Self {
        match std_dev {
            Some(s) if s > 0.0 => Self::shown(s, |s| with_std_dev(0.0, Some(s)).1),
            _ => Self::empty(),
        }
    }

    /// Creates a value and its standard deviation, both with the digits that the latter makes sensible.
    #[must_use]
    pub fn with_std_dev(value: f64, std_dev: Option<f64>) -> [Self; 2] {
        let of_std_dev = match std_dev {
            Some(s) if s > 0.0 => Self::shown(s, |s| with_std_dev(value, Some(s)).1),
            _ => Self::empty(),
        };
        [Self::value(value, std_dev), of_std_dev]
    }

    /// Returns the cell as text; `-` for a missing number.
    #[must_use]
    pub fn as_text(&self) -> &str {
        match self {
            Self::Number { text, .. } | Self::Text(text) => text,
            Self::Missing => "-",
        }
    }
}

impl From<&str> for Cell {
    fn from(text: &str) -> Self {
        Self::Text(text.to_owned())
    }
}

impl From<String> for Cell {
    fn from(text: String) -> Self {
        Self::Text(text)
    }
}

impl From<usize> for Cell {
    fn from(count: usize) -> Self {
        Self::Number { value: count as f64, text: count.to_string() }
    }
}

impl From<u32> for Cell {
    fn from(number: u32) -> Self {
        Self::Number { value: f64::from(number), text: number.to_string() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_numbers_text_or_null_in_json() {
        let cells = [Cell::fixed(1.0 / 3.0, 2), "fixed".into(), Cell::fixed(f64::NAN, 2)];
        let json = serde_json::to_value(&cells).unwrap();
        assert_eq!(
            json,
            serde_json::json!([{ "value": 1.0 / 3.0, "text": "0.33" }, "fixed", null])
        );
    }

    #[test]
    fn digits_follow_the_standard_deviation() {
        let text = |cells: [Cell; 2]| cells.map(|cell| cell.as_text().to_owned());
        assert_eq!(text(Cell::with_std_dev(54.741, Some(0.108))), ["54.74", "0.11"]);
        assert_eq!(text(Cell::with_std_dev(54.741, None)), ["54.7410", ""]);
        assert_eq!(text(Cell::with_std_dev(f64::NAN, Some(f64::INFINITY))), ["-", "-"]);
        assert_eq!(Cell::std_dev(Some(0.108)).as_text(), "0.11");
        assert_eq!(Cell::two_digits(0.0).as_text(), "-");
    }

    #[test]
    fn sections_are_addressed_by_their_titles() {
        assert_eq!(Section::new("Boards: evaluation (2)", Vec::new()).id(), "boards-evaluation-2");
    }
}
