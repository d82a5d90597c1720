//! Reports on a terminal.

use std::fmt;

use comfy_table::CellAlignment;
use comfy_table::presets::NOTHING;

use super::tree::{Cell, Column, Part, Section, Table};

impl Section {
    /// Returns the content of the section as text: paragraphs and tables, without figures.
    #[must_use]
    pub fn to_text(&self) -> String {
        text_of(&self.parts, true)
    }

    /// Returns this text without the parts that are shown on demand.
    #[must_use]
    pub fn to_brief_text(&self) -> String {
        text_of(&self.parts, false)
    }
}

fn text_of(parts: &[Part], details: bool) -> String {
    let mut text = String::new();
    let mut after_text = false;
    for part in parts {
        let words = match part {
            Part::Verdict { text, .. } | Part::Text(text) => text.trim().to_owned(),
            Part::Table(table) => table.to_string(),
            Part::Figure(_) | Part::Pictures(_) => continue,
            Part::Details { .. } if !details => continue,
            Part::Details { summary, parts } => match text_of(parts, details) {
                inner if inner.is_empty() => continue,
                inner => format!("{summary}\n{inner}"),
            },
        };
        // Sentences follow each other; tables are set apart.
        let is_text = matches!(part, Part::Verdict { .. } | Part::Text(_));
        if !text.is_empty() {
            text.push_str(if is_text && after_text { "\n" } else { "\n\n" });
        }
        text.push_str(&words);
        after_text = is_text;
    }
    text
}

impl fmt::Display for Table {
    /// Formats the table for a terminal: numbers are aligned right, without lines.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut table = comfy_table::Table::new();
        table.load_style(NOTHING);
        table.set_header(self.columns.iter().map(Column::heading));
        for (of_terminal, column) in table.column_iter_mut().zip(&self.columns) {
            if column.is_number {
                of_terminal.set_cell_alignment(CellAlignment::Right);
            }
        }
        for row in &self.rows {
            table.add_row(row.iter().map(Cell::as_text));
        }
        writeln!(f, "{}", self.caption)?;
        table.fmt(f)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::Figure;

    #[test]
    fn text_has_sentences_and_tables_and_no_figures() {
        let mut table = Table::new("Values", [Column::text("Name"), Column::of("Length", "mm")]);
        table.push(["F".into(), Cell::fixed(16.25, 1)]);
        table.push(["D".into(), Cell::Missing]);
        let details = |parts| Part::Details { summary: "More".into(), parts };
        let parts = vec![
            Part::Text("One.".into()),
            Part::Text("Two.".into()),
            Part::Table(table),
            Part::Figure(Figure::default()),
            details(vec![Part::Figure(Figure::default())]),
            details(vec![Part::Text("Three.".into())]),
        ];
        let section = Section::new("T", parts);
        assert!(section.to_brief_text().trim_end().ends_with('-'), "without details");
        let text = section.to_text();
        let lines: Vec<&str> = text.lines().map(str::trim_end).collect();
        assert_eq!(
            lines,
            [
                "One.",
                "Two.",
                "",
                "Values",
                " Name  Length, mm",
                " F           16.2",
                " D              -",
                "",
                "More",
                "Three."
            ]
        );
    }
}
