//! Tables and numbers of the documents.

use plenocal::Estimate;
use plenocal::quantity::fixed;

/// Table in Markdown.
pub struct Table {
    text: String,
    columns: usize,
}

impl Table {
    /// Creates a table with these headings.
    pub fn new(columns: &[&str]) -> Self {
        let mut table = Self { text: String::new(), columns: columns.len() };
        table.row(columns);
        table.text.push_str(&"|---".repeat(columns.len()));
        table.text.push_str("|\n");
        table
    }

    /// Appends a row.
    pub fn row<S: AsRef<str>>(&mut self, cells: impl IntoIterator<Item = S>) {
        let mut count = 0;
        for cell in cells {
            let cell = with_minus(cell.as_ref());
            self.text.push_str("| ");
            self.text.push_str(&cell);
            self.text.push_str(if cell.is_empty() { "" } else { " " });
            count += 1;
        }
        assert_eq!(count, self.columns, "a row has a cell for each column");
        self.text.push_str("|\n");
    }

    /// Returns the table followed by a paragraph.
    pub fn with(self, paragraph: &str) -> String {
        format!("{}\n{paragraph}\n", self.text)
    }

    /// Returns the table.
    pub fn text(self) -> String {
        self.text
    }
}

/// Writes negative numbers of a text with a minus sign instead of a hyphen; exponents keep theirs.
fn with_minus(text: &str) -> String {
    let mut written = String::new();
    let mut before = ' ';
    let mut rest = text.chars().peekable();
    while let Some(c) = rest.next() {
        let begins = [' ', '(', '*'].contains(&before);
        let is_minus = c == '-' && begins && rest.peek().is_some_and(char::is_ascii_digit);
        written.push(if is_minus { '−' } else { c });
        before = c;
    }
    written
}

/// Formats a value with its sign, unless it rounds to 0.
pub fn signed(value: f64, decimals: usize) -> String {
    let text = fixed(value.abs(), decimals);
    match fixed(value, decimals) {
        rounded if rounded.starts_with('-') => format!("−{text}"),
        _ if text.contains(|c| ('1'..='9').contains(&c)) => format!("+{text}"),
        _ => text,
    }
}

/// Formats a fraction in per cent, with its sign.
pub fn percent(fraction: f64, decimals: usize) -> String {
    format!("{} %", signed(100.0 * fraction, decimals))
}

/// Formats an error with its size over σ in brackets.
pub fn over_sigma(text: &str, error: f64, std_dev: f64) -> String {
    format!("{text} ({})", fixed((error / std_dev).abs(), 1))
}

/// Formats the error of an estimate in per cent of the truth, with its size over σ.
pub fn relative_error(estimate: &Estimate, truth: f64, decimals: usize) -> String {
    let error = estimate.value - truth;
    over_sigma(&percent(error / truth, decimals), error, estimate.std_dev)
}

/// Returns the value with the largest magnitude.
pub fn worst(values: impl IntoIterator<Item = f64>) -> f64 {
    values.into_iter().fold(0.0, |worst, x| if x.abs() > f64::abs(worst) { x } else { worst })
}
