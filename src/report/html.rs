//! Reports as one self-contained HTML file, which needs no network, and scripts only to zoom and to turn.

use std::fmt::Write as _;

use super::drawing::{NAMESPACE, escaped};
use super::tree::{Column, Figure, Part, Question, Report, Section, Table};
use crate::quantity::counted;

const STYLE: &str = include_str!("html.css");
/// Script that shows pictures to look into.
const PICTURES: &str = include_str!("pictures.js");
/// Script that turns the scene.
const SCENE: &str = include_str!("scene.js");

impl Report {
    /// Returns the report as the text of an HTML file.
    #[must_use]
    pub fn to_html(&self) -> String {
        let title = escaped(&self.title);
        let mut writer = Writer::default();
        let mut contents = String::new();
        let sections: Vec<(&Section, String)> = self.sections.iter().zip(self.ids()).collect();
        for of_question in sections.chunk_by(|(a, _), (b, _)| a.question == b.question) {
            writer.sections(of_question, &mut contents);
        }
        let pictures = writer.has_pictures.then_some(PICTURES);
        let scene = writer.html.contains("data-scene").then_some(SCENE);
        for script in pictures.into_iter().chain(scene) {
            writer.line(&format!("<script>\n{script}</script>"));
        }
        let subtitle = match self.subtitle.as_str() {
            "" => String::new(),
            subtitle => format!("\n<p class=\"subtitle\">{}</p>", escaped(subtitle)),
        };
        format!(
            "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
             <meta name=\"color-scheme\" content=\"light dark\">\n<title>{title}</title>\n\
             <style>\n{STYLE}</style>\n</head>\n<body>\n\
             <a class=\"skip\" href=\"#main\">Skip to the report</a>\n\
             <nav aria-label=\"Contents\">\n<ul>\n{contents}</ul>\n</nav>\n\
             <main id=\"main\" tabindex=\"-1\">\n\
             <header>\n<h1>{title}</h1>{subtitle}\n</header>\n{}</main>\n</body>\n</html>\n",
            writer.html
        )
    }

    /// Returns the addresses of the sections on the page. Sections with the same title are numbered.
    fn ids(&self) -> Vec<String> {
        let mut ids: Vec<String> = Vec::new();
        for section in &self.sections {
            let id = format!("section-{}", section.id());
            let same = |other: &&String| {
                other
                    .strip_prefix(&*id)
                    .is_some_and(|rest| rest.is_empty() || rest.starts_with("--"))
            };
            let earlier = ids.iter().filter(same).count();
            ids.push(if earlier == 0 { id } else { format!("{id}--{}", earlier + 1) });
        }
        ids
    }
}

#[derive(Default)]
struct Writer {
    html: String,
    has_pictures: bool,
}

/// Returns the address of the sections of a question on the page.
fn question_id(question: Question) -> &'static str {
    match question {
        Question::Trust => "question-trust",
        Question::Where => "question-where",
        Question::Images => "question-images",
        Question::Parameters => "question-parameters",
    }
}

impl Writer {
    fn line(&mut self, line: &str) {
        self.html.push_str(line);
        self.html.push('\n');
    }

    /// Writes sections with one question, or without any, and their lines of the contents.
    fn sections(&mut self, sections: &[(&Section, String)], contents: &mut String) {
        let question = sections.first().and_then(|(section, _)| section.question);
        // Writing to a String cannot fail.
        if let Some(question) = question {
            let (id, words) = (question_id(question), escaped(question.words()));
            let _ = write!(contents, "<li><a href=\"#{id}\">{words}</a>\n<ul>\n");
            self.line(&format!(
                "<section id=\"{id}\" aria-labelledby=\"{id}-heading\">\n\
                 <h2 id=\"{id}-heading\">{words}</h2>"
            ));
        }
        let level = if question.is_some() { 3 } else { 2 };
        for (section, id) in sections {
            let heading = escaped(&section.title);
            let _ = writeln!(contents, "<li><a href=\"#{id}\">{heading}</a></li>");
            self.line(&format!(
                "<section id=\"{id}\" aria-labelledby=\"{id}-heading\">\n\
                 <h{level} id=\"{id}-heading\">{heading}</h{level}>"
            ));
            self.warnings(&section.warnings);
            self.parts(&section.parts);
            self.line("</section>");
        }
        if question.is_some() {
            contents.push_str("</ul></li>\n");
            self.line("</section>");
        }
    }

    fn warnings(&mut self, warnings: &[String]) {
        if warnings.is_empty() {
            return;
        }
        let parts: Vec<Part> = warnings.iter().cloned().map(Part::Text).collect();
        self.parts(&[Part::Details { summary: counted(warnings.len(), "warning"), parts }]);
    }

    fn parts(&mut self, parts: &[Part]) {
        for part in parts {
            match part {
                Part::Verdict { verdict, text } => {
                    let class = verdict.to_string().replace(' ', "-");
                    self.line(&format!("<p class=\"verdict {class}\">{}</p>", escaped(text)));
                }
                Part::Text(text) => {
                    for paragraph in text.split("\n\n").filter(|p| !p.trim().is_empty()) {
                        self.line(&format!("<p>{}</p>", escaped(paragraph.trim())));
                    }
                }
                Part::Table(table) => self.table(table),
                Part::Figure(figure) => self.figure(figure),
                Part::Pictures(data) => self.pictures(data),
                Part::Details { summary, parts } => {
                    self.line(&format!("<details>\n<summary>{}</summary>", escaped(summary)));
                    self.parts(parts);
                    self.line("</details>");
                }
            }
        }
    }

    fn table(&mut self, table: &Table) {
        let caption = escaped(&table.caption);
        // A table wider than the page scrolls; the keyboard can scroll only an element with the focus.
        self.line(&format!(
            "<div class=\"table\" role=\"region\" aria-label=\"{caption}\" tabindex=\"0\">\n<table>\n\
             <caption>{caption}</caption>\n<thead>\n<tr>"
        ));
        for column in &table.columns {
            self.cell("th scope=\"col\"", column, &column.heading());
        }
        self.line("</tr>\n</thead>\n<tbody>");
        for row in &table.rows {
            self.html.push_str("<tr>");
            for (i, (column, cell)) in table.columns.iter().zip(row).enumerate() {
                // A first column of text names the rows.
                let tag = if i == 0 && !column.is_number { "th scope=\"row\"" } else { "td" };
                self.cell(tag, column, cell.as_text());
            }
            self.line("</tr>");
        }
        self.line("</tbody>\n</table>\n</div>");
    }

    fn cell(&mut self, tag: &str, column: &Column, text: &str) {
        let class = if column.is_number { " class=\"number\"" } else { "" };
        let end = &tag[..2];
        let _ = write!(self.html, "<{tag}{class}>{}</{end}>", escaped(text));
    }

    /// Writes the data of pictures, from which the script makes the rest.
    fn pictures(&mut self, data: &serde_json::Value) {
        self.has_pictures = true;
        // Nothing in the data can end the element.
        let data = data.to_string().replace('<', "\\u003c");
        self.line(&format!(
            "<div class=\"pictures\">\n<noscript><p>The pictures need JavaScript.</p></noscript>\n\
             <script type=\"application/json\">{data}</script>\n</div>"
        ));
    }

    fn figure(&mut self, figure: &Figure) {
        let caption = escaped(&figure.caption);
        let svg = figure.svg.replacen(NAMESPACE, "", 1);
        self.line(&format!("<figure>\n{svg}<figcaption>{caption}</figcaption>\n</figure>"));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::Section;
    use crate::report::drawing::Drawing;

    fn figure(caption: &str) -> Part {
        let svg = Drawing::new(20.0, 10.0).finish(caption);
        Part::Figure(Figure { name: "a.svg".into(), caption: caption.into(), svg })
    }

    fn page(parts: Vec<Part>) -> String {
        let sections = vec![Section::new("R & D", parts)];
        Report { title: "<T>".into(), subtitle: String::new(), sections }.to_html()
    }

    #[test]
    fn markup_in_text_is_escaped() {
        let words = "<b onclick=\"x\">&'\u{7}";
        let mut table = Table::new(words, [Column::number(words)]);
        table.push([words.into()]);
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
        assert!(html.contains("<h2 id=\"section-r-d-heading\">R &amp; D</h2>"));
    }

    #[test]
    fn sections_with_one_question_stand_together() {
        let of = |title: &str, question| Section::new(title, Vec::new()).answering(question);
        let sections = vec![
            of("A", Question::Trust),
            of("B", Question::Trust),
            of("C", Question::Where),
            Section::new("D", Vec::new()),
        ];
        let html = Report { sections, ..Report::default() }.to_html();
        assert_eq!(
            html.matches("<h2 id=\"question-trust-heading\">Can I trust it?</h2>").count(),
            1
        );
        assert_eq!(html.matches("<h3 id").count(), 3);
        assert!(html.contains("<h2 id=\"section-d-heading\">"));
        assert_eq!(html.matches("<section").count(), html.matches("</section>").count());
    }

    #[test]
    fn data_of_pictures_cannot_end_their_element() {
        let data = serde_json::json!({ "name": "</script><b>" });
        let html = page(vec![Part::Pictures(data)]);
        assert!(html.contains("{\"name\":\"\\u003c/script>\\u003cb>\"}"));
        assert_eq!(html.matches("<script").count(), 2);
        assert_eq!(html.matches("</script>").count(), 2);
    }

    #[test]
    fn sections_with_one_title_have_addresses_of_their_own() {
        let sections = ["A", "A 2", "A", "A"].map(|title| Section::new(title, Vec::new()));
        let report = Report { sections: sections.to_vec(), ..Report::default() };
        assert_eq!(report.ids(), ["section-a", "section-a-2", "section-a--2", "section-a--3"]);
    }

    #[test]
    fn warnings_stand_first_in_their_section() {
        let parts = vec![Part::Text("text".into())];
        let section = Section { warnings: vec!["a < b".into()], ..Section::new("A", parts) };
        let html = Report { sections: vec![section], ..Report::default() }.to_html();
        let at = |words: &str| html.find(words).unwrap_or_else(|| panic!("{words}: {html}"));
        assert!(at("<summary>1 warning</summary>") < at("<p>a &lt; b</p>"));
        assert!(at("<p>a &lt; b</p>") < at("<p>text</p>"));
    }

    #[test]
    fn a_page_has_landmarks_contents_and_scoped_tables() {
        let mut table = Table::new("Values", [Column::text("Name"), Column::of("Value", "mm")]);
        table.push(["F".into(), "16.2".into()]);
        let html = page(vec![Part::Table(table), Part::Text("one\n\ntwo".into()), figure("f")]);
        for piece in [
            "<html lang=\"en\">",
            "<main id=\"main\"",
            "<a class=\"skip\" href=\"#main\">",
            "<li><a href=\"#section-r-d\">R &amp; D</a></li>",
            "role=\"region\" aria-label=\"Values\" tabindex=\"0\"",
            "<caption>Values</caption>",
            "<th scope=\"col\">Name</th><th scope=\"col\" class=\"number\">Value, mm</th>",
            "<th scope=\"row\">F</th><td class=\"number\">16.2</td>",
            "<p>one</p>\n<p>two</p>",
            "role=\"img\" aria-label=\"f\"",
            "<figcaption>f</figcaption>",
        ] {
            assert!(html.contains(piece), "{piece}");
        }
        assert!(!html.contains("http://"));
        assert_eq!(html.matches("<h1>").count(), 1);
        assert!(!html.contains("<script"));
    }
}
