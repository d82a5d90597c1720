//! Tables as they stand on a terminal.

use comfy_table::presets::NOTHING;
use comfy_table::{CellAlignment, Table};

/// A table without lines; numbers are to the right, the columns named here to the left.
pub(super) fn table(header: &[&str], text_columns: &[usize]) -> Table {
    let mut table = Table::new();
    table.load_style(NOTHING);
    table.set_header(header.to_vec());
    for (i, column) in table.column_iter_mut().enumerate() {
        if !text_columns.contains(&i) {
            column.set_cell_alignment(CellAlignment::Right);
        }
    }
    table
}
