//! Reports as one self-contained HTML file: no script, no network.

use std::collections::HashSet;
use std::fmt::Write as _;

use roxmltree::{Document, Node, NodeType};
use serde::{Deserialize, Serialize};

use super::drawing::{ON_DARK, hex};

/// A report.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct HtmlReport {
    /// Title of the page, and its heading.
    pub title: String,
    /// Line below the title; empty for none.
    pub subtitle: String,
    /// In order.
    pub sections: Vec<Section>,
}

/// A part of the report that is listed in its table of contents.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Section {
    /// Its heading.
    pub title: String,
    /// In order.
    pub parts: Vec<Part>,
    /// What was said as warnings when it was made, to be said again.
    #[serde(default)]
    pub warnings: Vec<String>,
}

/// A part of a section.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Part {
    /// Plain text; empty lines divide paragraphs, line breaks stay.
    Text(String),
    /// A table.
    Table(HtmlTable),
    /// A picture.
    Figure(Figure),
    /// Parts that are shown on demand, and always in print.
    Details {
        /// What the parts are.
        summary: String,
        /// In order.
        parts: Vec<Part>,
    },
}

/// A table of text.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct HtmlTable {
    /// What it shows.
    pub caption: String,
    /// Names of the columns.
    pub header: Vec<String>,
    /// Cells, row by row.
    pub rows: Vec<Vec<String>>,
    /// Indices of the columns with text; the others hold numbers, aligned right. The first column, if
    /// it is text, names the rows.
    pub text_columns: Vec<usize>,
}

/// A picture with its file name and caption.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Figure {
    /// File name, such as `correlations.svg`.
    pub name: String,
    /// What it shows, in a sentence or two.
    pub caption: String,
    /// The picture, an SVG document. A figure written as JSON leaves it to a separate file.
    #[serde(skip)]
    pub svg: String,
}

/// Text with all markup escaped, also within double quotes.
pub(super) fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            // Neither XML nor HTML allows other control characters.
            c if c.is_control() && !matches!(c, '\n' | '\t') => out.push('\u{fffd}'),
            c => out.push(c),
        }
    }
    out
}

const STYLE: &str = include_str!("html.css");

impl HtmlReport {
    /// The report as the text of an HTML file.
    #[must_use]
    pub fn to_html(&self) -> String {
        let title = escaped(&self.title);
        let mut writer = Writer::default();
        for (i, section) in self.sections.iter().enumerate() {
            let (number, heading) = (i + 1, escaped(&section.title));
            writer.line(&format!(
                "<section id=\"section-{number}\" aria-labelledby=\"heading-{number}\">\n\
                 <h2 id=\"heading-{number}\">{heading}</h2>"
            ));
            writer.parts(&section.parts);
            writer.line("</section>");
        }
        let mut contents = String::new();
        for (i, section) in self.sections.iter().enumerate() {
            let heading = escaped(&section.title);
            let _ = writeln!(contents, "<li><a href=\"#section-{}\">{heading}</a></li>", i + 1);
        }
        let subtitle = match self.subtitle.as_str() {
            "" => String::new(),
            subtitle => format!("\n<p class=\"subtitle\">{}</p>", escaped(subtitle)),
        };
        format!(
            "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
             <meta name=\"color-scheme\" content=\"light dark\">\n<title>{title}</title>\n\
             <style>\n{STYLE}{}</style>\n</head>\n<body>\n\
             <a class=\"skip\" href=\"#main\">Skip to the report</a>\n\
             <nav aria-label=\"Contents\">\n<ul>\n{contents}</ul>\n</nav>\n\
             <main id=\"main\" tabindex=\"-1\">\n\
             <header>\n<h1>{title}</h1>{subtitle}\n</header>\n{}</main>\n</body>\n</html>\n",
            dark_figures(),
            writer.html
        )
    }
}

/// Style rules that replace the colours of pictures, made for white paper, on a dark screen.
fn dark_figures() -> String {
    let mut css = String::from("@media screen and (prefers-color-scheme: dark) {\n");
    for (light, dark) in ON_DARK {
        let (light, dark) = (hex(light), hex(dark));
        for property in ["fill", "stroke"] {
            let _ =
                writeln!(css, "  figure svg [{property}=\"{light}\"] {{ {property}: {dark}; }}");
        }
    }
    css.push_str("}\n");
    css
}

#[derive(Default)]
struct Writer {
    html: String,
    figures: usize,
}

impl Writer {
    fn line(&mut self, line: &str) {
        self.html.push_str(line);
        self.html.push('\n');
    }

    fn parts(&mut self, parts: &[Part]) {
        for part in parts {
            match part {
                Part::Text(text) => {
                    for paragraph in text.split("\n\n").filter(|p| !p.trim().is_empty()) {
                        self.line(&format!("<p>{}</p>", escaped(paragraph.trim())));
                    }
                }
                Part::Table(table) => self.table(table),
                Part::Figure(figure) => self.figure(figure),
                Part::Details { summary, parts } => {
                    self.line(&format!("<details>\n<summary>{}</summary>", escaped(summary)));
                    self.parts(parts);
                    self.line("</details>");
                }
            }
        }
    }

    fn table(&mut self, table: &HtmlTable) {
        let caption = escaped(&table.caption);
        // A table wider than the page scrolls; the keyboard can scroll only what has the focus.
        self.line(&format!(
            "<div class=\"table\" role=\"region\" aria-label=\"{caption}\" tabindex=\"0\">\n<table>\n\
             <caption>{caption}</caption>\n<thead>"
        ));
        self.row(table, &table.header, &|_| Some("col"));
        self.line("</thead>\n<tbody>");
        let named = table.text_columns.contains(&0);
        for row in &table.rows {
            self.row(table, row, &|column| (named && column == 0).then_some("row"));
        }
        self.line("</tbody>\n</table>\n</div>");
    }

    fn row(
        &mut self,
        table: &HtmlTable,
        cells: &[String],
        scope: &dyn Fn(usize) -> Option<&'static str>,
    ) {
        self.html.push_str("<tr>");
        for (column, cell) in cells.iter().enumerate() {
            let class = if table.text_columns.contains(&column) { "" } else { " class=\"number\"" };
            let cell = escaped(cell);
            let _ = match scope(column) {
                Some(scope) => write!(self.html, "<th scope=\"{scope}\"{class}>{cell}</th>"),
                None => write!(self.html, "<td{class}>{cell}</td>"),
            };
        }
        self.line("</tr>");
    }

    fn figure(&mut self, figure: &Figure) {
        self.figures += 1;
        let prefix = format!("figure-{}", self.figures);
        let caption = escaped(&figure.caption);
        let picture = inlined(&figure.svg, &prefix, &figure.caption).unwrap_or_else(|| {
            format!("<p>The picture {} could not be read.</p>", escaped(&figure.name))
        });
        self.line(&format!(
            "<figure id=\"{prefix}\">\n{picture}\n<figcaption>{caption}</figcaption>\n</figure>"
        ));
    }
}

/// An SVG document as an element of a page: without prolog and namespaces, which HTML does not need;
/// its ids with a prefix, since other pictures may use the same ones. `None` if it is not an SVG
/// document.
fn inlined(svg: &str, prefix: &str, name: &str) -> Option<String> {
    let document = Document::parse(svg).ok()?;
    let root = document.root_element();
    if root.tag_name().name() != "svg" {
        return None;
    }
    let ids: HashSet<&str> = root.descendants().filter_map(|node| node.attribute("id")).collect();
    let mut html = String::with_capacity(svg.len());
    element(&mut html, root, &|value| with_prefix(value, &ids, prefix), Some(name));
    Some(html)
}

/// The value of an attribute, with references to ids of the document adapted to the page.
fn with_prefix(value: &str, ids: &HashSet<&str>, prefix: &str) -> String {
    let mut out = String::new();
    let mut rest = value;
    while let Some(at) = rest.find('#') {
        let (before, after) = rest.split_at(at + 1);
        out.push_str(before);
        let end = after.find([')', '"', '\'', ' ']).unwrap_or(after.len());
        if ids.contains(&after[..end]) {
            out.push_str(prefix);
            out.push('-');
        }
        rest = after;
    }
    out.push_str(rest);
    out
}

fn element(
    html: &mut String,
    node: Node,
    referring: &dyn Fn(&str) -> String,
    root_name: Option<&str>,
) {
    let tag = node.tag_name().name();
    let _ = write!(html, "<{tag}");
    for attribute in node.attributes() {
        let (key, value) = (attribute.name(), attribute.value());
        let value = match key {
            "role" | "aria-label" if root_name.is_some() => continue,
            // A reference to x is written "#x".
            "id" => referring(&format!("#{value}"))[1..].to_owned(),
            "aria-labelledby" | "aria-describedby" => {
                let ids = value.split_whitespace();
                let ids: Vec<String> =
                    ids.map(|id| referring(&format!("#{id}"))[1..].to_owned()).collect();
                ids.join(" ")
            }
            _ => referring(value),
        };
        let _ = write!(html, " {key}=\"{}\"", escaped(&value));
    }
    if let Some(name) = root_name {
        let _ = write!(html, " role=\"img\" aria-label=\"{}\"", escaped(name));
    }
    if !node.has_children() {
        html.push_str("/>");
        return;
    }
    html.push('>');
    for child in node.children() {
        match child.node_type() {
            NodeType::Element => element(html, child, referring, None),
            NodeType::Text => html.push_str(&escaped(child.text().unwrap_or_default())),
            NodeType::Root | NodeType::PI | NodeType::Comment => {}
        }
    }
    let _ = write!(html, "</{tag}>");
}

#[cfg(test)]
mod tests {
    use super::*;

    const PICTURE: &str = "<?xml version=\"1.0\"?>\n<!-- made by hand -->\n\
        <svg xmlns=\"http://www.w3.org/2000/svg\" xmlns:xlink=\"http://www.w3.org/1999/xlink\" \
        width=\"20\" height=\"10\" viewBox=\"0 0 20 10\"><defs><path id=\"a\" d=\"M0 0L1 1\"/></defs>\
        <use xlink:href=\"#a\"/><rect fill=\"url(#a)\" stroke=\"#abc\"/><text>1 &lt; 2</text></svg>";

    fn figure(caption: &str) -> Part {
        let caption = caption.to_owned();
        Part::Figure(Figure { name: "a.svg".into(), caption, svg: PICTURE.into() })
    }

    fn page(parts: Vec<Part>) -> String {
        let sections = vec![Section { title: "R & D".into(), parts, ..Section::default() }];
        HtmlReport { title: "<T>".into(), subtitle: String::new(), sections }.to_html()
    }

    #[test]
    fn markup_in_text_is_escaped() {
        let words = "<b onclick=\"x\">&'\u{7}";
        let table = HtmlTable {
            caption: words.into(),
            header: vec![words.into()],
            rows: vec![vec![words.into()]],
            text_columns: vec![],
        };
        let html = page(vec![
            Part::Text(words.into()),
            Part::Table(table),
            figure(words),
            Part::Details { summary: words.into(), parts: vec![] },
        ]);
        assert!(
            !html.contains("<b") || html.matches("<b").count() == html.matches("<body").count()
        );
        assert!(html.contains("<title>&lt;T&gt;</title>"));
        assert!(html.contains("<p>&lt;b onclick=&quot;x&quot;&gt;&amp;&#39;\u{fffd}</p>"));
        assert!(html.contains("<h2 id=\"heading-1\">R &amp; D</h2>"));
    }

    #[test]
    fn ids_of_a_picture_shown_twice_are_unique() {
        let html = page(vec![
            figure("one"),
            Part::Details { summary: "more".into(), parts: vec![figure("two")] },
        ]);
        for n in [1, 2] {
            assert!(html.contains(&format!("id=\"figure-{n}-a\"")), "{html}");
            assert!(html.contains(&format!("href=\"#figure-{n}-a\"")));
            assert!(html.contains(&format!("fill=\"url(#figure-{n}-a)\"")));
        }
        // A colour is not a reference, and the document's own text and size stay.
        assert!(html.contains("stroke=\"#abc\"") && html.contains("1 &lt; 2"));
        assert!(html.contains("viewBox=\"0 0 20 10\" role=\"img\" aria-label=\"one\""));
        assert!(!html.contains("<?xml") && !html.contains("made by hand"));
        assert!(!html.contains("http://") && !html.contains("https://"));
    }

    #[test]
    fn a_page_has_landmarks_contents_and_scoped_tables() {
        let table = HtmlTable {
            caption: "Values".into(),
            header: vec!["Name".into(), "Value".into()],
            rows: vec![vec!["F".into(), "16.2".into()]],
            text_columns: vec![0],
        };
        let html = page(vec![Part::Table(table), Part::Text("one\n\ntwo".into())]);
        for piece in [
            "<html lang=\"en\">",
            "<main id=\"main\"",
            "<a class=\"skip\" href=\"#main\">",
            "<li><a href=\"#section-1\">R &amp; D</a></li>",
            "<section id=\"section-1\" aria-labelledby=\"heading-1\">",
            "role=\"region\" aria-label=\"Values\" tabindex=\"0\"",
            "<caption>Values</caption>",
            "<th scope=\"col\">Name</th><th scope=\"col\" class=\"number\">Value</th>",
            "<th scope=\"row\">F</th><td class=\"number\">16.2</td>",
            "<p>one</p>\n<p>two</p>",
        ] {
            assert!(html.contains(piece), "{piece}");
        }
        assert_eq!(html.matches("<h1>").count(), 1);
        assert!(!html.contains("<script"));
    }

    #[test]
    fn a_picture_that_cannot_be_read_is_named() {
        let broken = Figure { name: "x.svg".into(), caption: "c".into(), svg: "<svg".into() };
        assert!(page(vec![Part::Figure(broken)]).contains("x.svg could not be read"));
    }
}
