//! Tables for the terminal and for a report.

use std::fmt;

use comfy_table::CellAlignment;
use comfy_table::presets::NOTHING;

use super::html::HtmlTable;

/// A table without lines; numbers are aligned right, the columns in `text_columns` left.
#[derive(Debug, Clone)]
pub(super) struct Table {
    header: Vec<String>,
    rows: Vec<Vec<String>>,
    text_columns: Vec<usize>,
}

/// An empty table.
pub(super) fn table(header: &[&str], text_columns: &[usize]) -> Table {
    Table {
        header: header.iter().map(ToString::to_string).collect(),
        rows: Vec::new(),
        text_columns: text_columns.to_vec(),
    }
}

impl Table {
    pub fn add_row(&mut self, row: impl IntoIterator<Item = String>) {
        self.rows.push(row.into_iter().collect());
    }

    pub fn captioned(self, caption: &str) -> HtmlTable {
        let Self { header, rows, text_columns } = self;
        HtmlTable { caption: caption.to_owned(), header, rows, text_columns }
    }
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        text(&self.header, &self.rows, &self.text_columns).fmt(f)
    }
}

impl fmt::Display for HtmlTable {
    /// Formats the table for a terminal.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}", self.caption)?;
        text(&self.header, &self.rows, &self.text_columns).fmt(f)
    }
}

fn text(header: &[String], rows: &[Vec<String>], text_columns: &[usize]) -> comfy_table::Table {
    let mut table = comfy_table::Table::new();
    table.load_style(NOTHING);
    table.set_header(header.to_vec());
    for (i, column) in table.column_iter_mut().enumerate() {
        if !text_columns.contains(&i) {
            column.set_cell_alignment(CellAlignment::Right);
        }
    }
    table.add_rows(rows.to_vec());
    table
}
