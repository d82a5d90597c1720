//! Pictures as SVG: lines, areas, arrows, text, and the axes of charts.

use std::fmt::Write as _;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use nalgebra::{Point3, Vector2};

use super::tree::Figure;

/// A colour: red, green, blue.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Color(pub u8, pub u8, pub u8);

/// Colours of the lens types, as in the paper: red, green, blue. They are readable on white, and their lightness differs for
/// the colour-blind.
pub(super) const TYPE_COLORS: [Color; 3] =
    [Color(200, 30, 30), Color(40, 140, 60), Color(30, 70, 200)];
pub(super) const WHITE: Color = Color(255, 255, 255);
/// Colour of text and lines.
pub(super) const INK: Color = Color(60, 60, 60);
/// Colour of lines at the ticks of an axis.
const GRID: Color = Color(222, 222, 222);
/// Colour of lines of a model through measurements.
pub(super) const FITTED: Color = Color(190, 0, 190);
/// Two colours that everybody can tell apart, for two quantities side by side and for the two signs.
pub(super) const BLUE: Color = Color(0, 100, 170);
pub(super) const ORANGE: Color = Color(200, 80, 0);
/// Colour of marks on a photograph.
pub(super) const YELLOW: Color = Color(255, 210, 0);

impl Color {
    /// Returns a bright colour of a hue in degrees.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // 0 to 255
    pub fn of_hue(degrees: f64) -> Self {
        // The colour in HSL has a saturation of 0.9 and a lightness of 0.6.
        let [red, green, blue] = [0.0, 8.0, 4.0].map(|offset: f64| {
            let k = (offset + degrees / 30.0) % 12.0;
            let part = 0.6 - 0.36 * (k - 3.0).min(9.0 - k).clamp(-1.0, 1.0);
            (255.0 * part).round() as u8
        });
        Self(red, green, blue)
    }

    pub fn hex(self) -> String {
        let Self(red, green, blue) = self;
        format!("#{red:02x}{green:02x}{blue:02x}")
    }
}

/// Escapes all markup of a text, also within double quotes.
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

/// Returns points in space as text: their coordinates with commas, separated by spaces.
pub(super) fn in_space(points: &[Point3<f64>]) -> String {
    let point = |p: &Point3<f64>| format!("{:.2},{:.2},{:.2}", p.x, p.y, p.z);
    points.iter().map(point).collect::<Vec<_>>().join(" ")
}

/// Alignment of text to its position.
#[derive(Debug, Clone, Copy)]
pub(super) enum Anchor {
    Start,
    Middle,
    End,
}

/// A rectangular part of a picture, px.
#[derive(Debug, Clone, Copy)]
pub(super) struct Area {
    pub corner: Vector2<f64>,
    pub size: Vector2<f64>,
}

/// Margins of a chart for title, ticks and names of the axes: left, top, right, below, px.
pub(super) const ROOM: [f64; 4] = [70.0, 40.0, 18.0, 50.0];

impl Area {
    pub fn new(x: f64, y: f64, width: f64, height: f64) -> Self {
        Self { corner: Vector2::new(x, y), size: Vector2::new(width, height) }
    }

    /// Returns equal parts, row by row.
    pub fn split(&self, rows: usize, columns: usize) -> impl Iterator<Item = Self> + use<> {
        let Self { corner, size } = *self;
        let size = size.component_div(&Vector2::new(columns as f64, rows as f64));
        let part = move |i: usize| {
            let index = Vector2::new((i % columns) as f64, (i / columns) as f64);
            Self { corner: corner + size.component_mul(&index), size }
        };
        (0..rows * columns).map(part)
    }

    /// Returns a part on the left, and the rest.
    pub fn split_at(&self, left: f64) -> [Self; 2] {
        let Self { corner, size } = *self;
        [
            Self::new(corner.x, corner.y, left, size.y),
            Self::new(corner.x + left, corner.y, size.x - left, size.y),
        ]
    }

    /// Returns the part within the margins for title and axes.
    pub fn within_axes(&self) -> Self {
        let [left, top, right, below] = ROOM;
        Self {
            corner: self.corner + Vector2::new(left, top),
            size: self.size - Vector2::new(left + right, top + below),
        }
    }
}

/// Labels at the ticks of an axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Ticks {
    /// Round numbers.
    Numbers,
    /// Whole numbers.
    Whole,
    /// Powers of ten. Values on the axis are their exponents.
    Decades,
    /// Empty labels.
    None,
}

/// An axis of a chart.
#[derive(Debug, Clone, Copy)]
pub(super) struct Axis<'a> {
    /// Name of the quantity, with its unit.
    pub name: &'a str,
    /// Values at the left or lower end, and at the other end.
    pub ends: [f64; 2],
    pub ticks: Ticks,
    /// True if lines cross the chart at the ticks.
    pub grid: bool,
}

impl<'a> Axis<'a> {
    /// Creates an axis with numbers.
    pub fn new(name: &'a str, ends: [f64; 2]) -> Self {
        Self { name, ends, ticks: Ticks::Numbers, grid: false }
    }

    pub fn with_grid(self) -> Self {
        Self { grid: true, ..self }
    }

    pub fn with_ticks(self, ticks: Ticks) -> Self {
        Self { ticks, ..self }
    }

    /// Returns the values at the ticks, with their labels; `apart` is the smallest distance between two.
    fn labels(&self, apart: f64) -> Vec<(f64, String)> {
        let [from, to] = self.ends;
        let (low, high) = (from.min(to), from.max(to));
        match self.ticks {
            Ticks::Numbers => ticks(low, high, apart),
            Ticks::Whole => ticks(low, high, apart.max(ONE)),
            Ticks::Decades => {
                let powers = ticks(low, high, apart.max(ONE)).into_iter();
                powers.map(|(exponent, label)| (exponent, format!("1e{label}"))).collect()
            }
            Ticks::None => Vec::new(),
        }
    }
}

/// Distance between ticks for which [`ticks`] chooses a step of 1.
const ONE: f64 = 0.4;

/// Returns round numbers from `low` to `high`, at least `apart` from each other, with their labels.
pub(super) fn ticks(low: f64, high: f64, apart: f64) -> Vec<(f64, String)> {
    // Consecutive round numbers differ by a factor of at most 2.5.
    let step = round_below(2.5 * apart);
    let first = (low / step).ceil();
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // as many as fit on a page
    let count = ((high / step * (1.0 + f64::EPSILON) - first).floor() + 1.0).max(0.0) as u32;
    let number = |i: u32| (first + f64::from(i)) * step;
    (0..count).map(|i| (number(i), axis_number(number(i)))).collect()
}

/// Two linear axes: a map from values to px of the picture.
#[derive(Debug, Clone, Copy)]
pub(super) struct Plane {
    /// Value at `origin_px`.
    pub origin: Vector2<f64>,
    /// Position of the origin, px.
    pub origin_px: Vector2<f64>,
    /// Scale: px of the picture per unit.
    pub scale: Vector2<f64>,
}

impl Plane {
    fn new(area: &Area, x: &Axis, y: &Axis) -> Self {
        let along = |axis: &Axis, px: f64| px / (axis.ends[1] - axis.ends[0]);
        Self {
            origin: Vector2::new(x.ends[0], y.ends[0]),
            origin_px: area.corner + Vector2::new(0.0, area.size.y),
            scale: Vector2::new(along(x, area.size.x), along(y, -area.size.y)),
        }
    }

    pub fn place(&self, x: f64, y: f64) -> Vector2<f64> {
        self.origin_px + (Vector2::new(x, y) - self.origin).component_mul(&self.scale)
    }
}

/// XML namespace for the root of an SVG file. An SVG element of a page does not need it.
pub(super) const NAMESPACE: &str = " xmlns=\"http://www.w3.org/2000/svg\"";

/// A picture, drawn mark by mark. Lengths are in px, x to the right, y down.
#[derive(Debug)]
pub(super) struct Drawing {
    /// Width and height on the page, and the view: left, top, width, height.
    size: Vector2<f64>,
    view: [f64; 4],
    /// Number of decimals of positions.
    decimals: usize,
    /// Attributes of the picture, and of its next mark.
    attributes: String,
    of_next: String,
    marks: String,
}

// Writing to a String cannot fail.
impl Drawing {
    /// Creates a white page.
    pub fn new(width: f64, height: f64) -> Self {
        let size = Vector2::new(width, height);
        let view = [0.0, 0.0, width, height];
        let mut drawing = Self::empty(size, view, 1);
        drawing.rectangle(Vector2::zeros(), size, WHITE, 1.0);
        drawing
    }

    /// Creates a photograph (left, top, width, height) to draw on. `size` is its size on the page; `jpeg_or_png` is the format
    /// of the bytes.
    pub fn on_photograph(
        size: Vector2<f64>,
        view: [f64; 4],
        jpeg_or_png: &str,
        bytes: &[u8],
    ) -> Self {
        let [left, top, width, height] = view;
        let encoded = STANDARD.encode(bytes);
        // Enlarged pixels must remain visible.
        let rendering = if size.x > width { "pixelated" } else { "auto" };
        let mut drawing = Self::empty(size, view, 2);
        drawing.marks = format!(
            "<image x=\"{left}\" y=\"{top}\" width=\"{width}\" height=\"{height}\" \
             preserveAspectRatio=\"none\" style=\"image-rendering:{rendering}\" \
             href=\"data:image/{jpeg_or_png};base64,{encoded}\"/>\n"
        );
        drawing
    }

    fn empty(size: Vector2<f64>, view: [f64; 4], decimals: usize) -> Self {
        let [attributes, of_next, marks] = [const { String::new() }; 3];
        Self { size, view, decimals, attributes, of_next, marks }
    }

    /// Gives the picture an attribute for a script.
    pub fn set_data(&mut self, name: &str, value: &str) {
        let _ = write!(self.attributes, " data-{name}=\"{}\"", escaped(value));
    }

    /// Gives the next mark its points in space, by which a script places it anew.
    pub fn next_in_space(&mut self, points: &[Point3<f64>]) {
        self.of_next = format!(" data-at=\"{}\"", in_space(points));
    }

    /// Marks the next mark as a line from a number in the row of numbers.
    pub fn next_from_number(&mut self) {
        self.of_next.push_str(" data-number=\"\"");
    }

    /// Returns the picture as an SVG element with a description. It has no ids, so that several may be on one page.
    pub fn finish(self, description: &str) -> String {
        let [left, top, width, height] = self.view;
        format!(
            "<svg{NAMESPACE} width=\"{}\" height=\"{}\" \
             viewBox=\"{left} {top} {width} {height}\" role=\"img\" aria-label=\"{}\"{}>\n{}</svg>\n",
            self.size.x,
            self.size.y,
            escaped(description),
            self.attributes,
            self.marks
        )
    }

    /// Returns the picture as a figure with its caption; `name` is without the extension.
    pub fn figure(self, name: &str, caption: String) -> Figure {
        let svg = self.finish(&caption);
        Figure { name: format!("{name}.svg"), caption, svg }
    }

    /// Draws a line through points.
    pub fn line(&mut self, points: &[Vector2<f64>], color: Color, width: f64) {
        self.path(points, "", &format!("fill=\"none\" {}", stroke(color, width)));
    }

    /// Draws a dashed line through points.
    pub fn dashed(&mut self, points: &[Vector2<f64>], color: Color, width: f64) {
        let style = format!("fill=\"none\" {} stroke-dasharray=\"5 4\"", stroke(color, width));
        self.path(points, "", &style);
    }

    /// Draws a filled area without an outline.
    pub fn area(&mut self, points: &[Vector2<f64>], color: Color, opacity: f64) {
        let fill = color.hex();
        self.path(points, "z", &format!("fill=\"{fill}\" fill-opacity=\"{opacity:.3}\""));
    }

    /// Draws filled rectangles without outlines, each by its upper left corner and its size. No gap is visible
    /// between those that touch.
    pub fn rectangles(
        &mut self,
        rectangles: &[(Vector2<f64>, Vector2<f64>)],
        color: Color,
        opacity: f64,
    ) {
        let d = self.decimals;
        self.marks.push_str("<path d=\"");
        for (corner, size) in rectangles {
            // Edges are positions, not lengths, so that neighbours share them to the last digit.
            let (left, top, end) = (corner.x, corner.y, corner + size);
            let _ =
                write!(self.marks, "M{left:.d$} {top:.d$}H{:.d$}V{:.d$}H{left:.d$}z", end.x, end.y);
        }
        let _ = writeln!(
            self.marks,
            "\" fill=\"{}\" fill-opacity=\"{opacity:.3}\" shape-rendering=\"crispEdges\"/>",
            color.hex()
        );
    }

    /// Draws one filled rectangle.
    pub fn rectangle(
        &mut self,
        corner: Vector2<f64>,
        size: Vector2<f64>,
        color: Color,
        opacity: f64,
    ) {
        self.rectangles(&[(corner, size)], color, opacity);
    }

    /// Draws filled discs.
    pub fn discs(&mut self, middles: &[Vector2<f64>], radius: f64, color: Color) {
        for middle in middles {
            self.circle_with(*middle, radius, &format!("fill=\"{}\"", color.hex()));
        }
    }

    /// Draws a circle.
    pub fn circle(&mut self, middle: Vector2<f64>, radius: f64, color: Color, width: f64) {
        self.circle_with(middle, radius, &format!("fill=\"none\" {}", stroke(color, width)));
    }

    fn circle_with(&mut self, middle: Vector2<f64>, radius: f64, style: &str) {
        let d = self.decimals;
        let _ = writeln!(
            self.marks,
            "<circle cx=\"{:.d$}\" cy=\"{:.d$}\" r=\"{radius:.d$}\" {style}{}/>",
            middle.x,
            middle.y,
            std::mem::take(&mut self.of_next)
        );
    }

    /// Draws arrows from points along vectors, as one path. An arrow too short for a head is a line or a dot.
    pub fn arrows(&mut self, arrows: &[(Vector2<f64>, Vector2<f64>)], color: Color, width: f64) {
        if arrows.is_empty() {
            return;
        }
        self.marks.push_str("<path d=\"");
        for (from, along) in arrows {
            let (x, y) = (from.x, from.y);
            let _ = write!(self.marks, "M{x:.1} {y:.1}l{:.1} {:.1}", along.x, along.y);
            let length = along.norm();
            if length >= SHORTEST_WITH_HEAD {
                let back = along * (-(HEAD_PART * length).clamp(HEAD.0, HEAD.1) / length);
                let side = Vector2::new(-back.y, back.x) * HEAD_WIDTH;
                let (left, right) = (back + side, back - side);
                let (across, tip) = (right - left, -right);
                let _ = write!(
                    self.marks,
                    "l{:.1} {:.1}m{:.1} {:.1}l{:.1} {:.1}",
                    left.x, left.y, across.x, across.y, tip.x, tip.y
                );
            }
        }
        let style = stroke(color, width);
        let _ = writeln!(self.marks, "\" fill=\"none\" {style} stroke-linecap=\"round\"/>");
    }

    /// Draws text, vertically centred on a point.
    pub fn text(&mut self, at: Vector2<f64>, anchor: Anchor, size: f64, words: &str) {
        self.colored_text(at, anchor, size, INK, words);
    }

    /// Draws text in another colour.
    pub fn colored_text(
        &mut self,
        at: Vector2<f64>,
        anchor: Anchor,
        size: f64,
        color: Color,
        words: &str,
    ) {
        self.words(at, anchor, size, color, words, "");
    }

    /// Draws text that runs upwards.
    pub fn upward_text(&mut self, at: Vector2<f64>, anchor: Anchor, size: f64, words: &str) {
        let turn = format!(" transform=\"rotate(-90 {:.1} {:.1})\"", at.x, at.y);
        self.words(at, anchor, size, INK, words, &turn);
    }

    fn words(
        &mut self,
        at: Vector2<f64>,
        anchor: Anchor,
        size: f64,
        color: Color,
        words: &str,
        turn: &str,
    ) {
        let anchor = match anchor {
            Anchor::Start => "start",
            Anchor::Middle => "middle",
            Anchor::End => "end",
        };
        let _ = writeln!(
            self.marks,
            "<text x=\"{:.1}\" y=\"{:.1}\" dy=\"0.35em\" text-anchor=\"{anchor}\" \
             font-family=\"sans-serif\" font-size=\"{size}\" fill=\"{}\"{turn}{}>{}</text>",
            at.x,
            at.y,
            color.hex(),
            std::mem::take(&mut self.of_next),
            escaped(words)
        );
    }

    fn path(&mut self, points: &[Vector2<f64>], end: &str, style: &str) {
        let d = self.decimals;
        let mut steps = points.iter();
        let Some(first) = steps.next() else { return };
        let _ = write!(self.marks, "<path d=\"M{:.d$} {:.d$}", first.x, first.y);
        for p in steps {
            let _ = write!(self.marks, "L{:.d$} {:.d$}", p.x, p.y);
        }
        let _ = writeln!(self.marks, "{end}\" {style}{}/>", std::mem::take(&mut self.of_next));
    }

    /// Draws names with their colours, side by side, the first at a point.
    pub fn legend(&mut self, mut at: Vector2<f64>, apart: f64, names: &[(&str, Color)]) {
        for (name, color) in names {
            self.rectangle(at - Vector2::new(0.0, 6.0), Vector2::new(12.0, 12.0), *color, 1.0);
            self.text(at + Vector2::new(18.0, 0.0), Anchor::Start, 14.0, name);
            at.x += apart;
        }
    }

    /// Draws the legend of the colours of `types` lens types.
    pub fn type_legend(&mut self, at: Vector2<f64>, types: usize) {
        let names = ["type 1", "type 2", "type 3"].into_iter().zip(TYPE_COLORS);
        self.legend(at, 80.0, &names.take(types).collect::<Vec<_>>());
    }

    /// Draws the title of a chart, above its area.
    pub fn title(&mut self, chart: &Area, words: &str) {
        let above = chart.corner - Vector2::new(0.0, ROOM[1] / 2.0);
        self.text(above, Anchor::Start, 15.0, words);
    }

    /// Draws the axes of a chart at the left and the lower edge of its area, with ticks, numbers and names.
    pub fn axes(&mut self, chart: &Area, x: &Axis, y: &Axis) -> Plane {
        let plane = Plane::new(chart, x, y);
        let (low, high) = (chart.corner, chart.corner + chart.size);
        let across = x.labels(TICKS_APART.x / plane.scale.x.abs());
        let up = y.labels(TICKS_APART.y / plane.scale.y.abs());
        let across = across.iter().map(|(value, label)| (plane.place(*value, 0.0).x, label));
        let up = up.iter().map(|(value, label)| (plane.place(0.0, *value).y, label));
        for (at, label) in across {
            if x.grid {
                self.line(&[Vector2::new(at, low.y), Vector2::new(at, high.y)], GRID, 1.0);
            }
            self.line(&[Vector2::new(at, high.y), Vector2::new(at, high.y + TICK)], INK, 1.0);
            self.text(Vector2::new(at, high.y + 14.0), Anchor::Middle, 13.0, label);
        }
        for (at, label) in up {
            if y.grid {
                self.line(&[Vector2::new(low.x, at), Vector2::new(high.x, at)], GRID, 1.0);
            }
            self.line(&[Vector2::new(low.x - TICK, at), Vector2::new(low.x, at)], INK, 1.0);
            self.text(Vector2::new(low.x - 8.0, at), Anchor::End, 13.0, label);
        }
        let corner = Vector2::new(low.x, high.y);
        self.line(&[low, corner, high], INK, 1.0);
        let middle = chart.corner + chart.size / 2.0;
        let below = Vector2::new(middle.x, high.y + ROOM[3] - 14.0);
        self.text(below, Anchor::Middle, 13.0, x.name);
        let beside = Vector2::new(low.x - ROOM[0] + 12.0, middle.y);
        self.upward_text(beside, Anchor::Middle, 13.0, y.name);
        plane
    }
}

/// Smallest distance between ticks along both axes, and length of ticks, px.
const TICKS_APART: Vector2<f64> = Vector2::new(52.0, 30.0);
const TICK: f64 = 5.0;

/// Length of the shortest arrow with a head, px.
const SHORTEST_WITH_HEAD: f64 = 3.0;
/// Length of the head as a fraction of the arrow's length, its limits in px, and half its width over its
/// length.
const HEAD_PART: f64 = 0.35;
const HEAD: (f64, f64) = (2.0, 7.0);
const HEAD_WIDTH: f64 = 0.45;

fn stroke(color: Color, width: f64) -> String {
    format!("stroke=\"{}\" stroke-width=\"{width}\"", color.hex())
}

/// Rounding error of a tick at 0.
const NOTHING: f64 = 1e-12;

/// Formats a number on an axis: short, for any magnitude.
pub(super) fn axis_number(value: f64) -> String {
    let size = value.abs();
    if size < NOTHING {
        "0".to_owned()
    } else if (1e-3..1e5).contains(&size) {
        // Ticks are multiples with rounding errors.
        let text = format!("{value:.4}");
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        format!("{value:.0e}")
    }
}

/// Returns the largest of 1, 2 and 5 times a power of ten that is not above a value.
pub(super) fn round_below(value: f64) -> f64 {
    let decade = 10_f64.powf(value.log10().floor());
    // Such a number may be off in its last digit.
    let part = value / decade * (1.0 + 1e-9);
    decade * [10.0, 5.0, 2.0].into_iter().find(|&step| part >= step).unwrap_or(1.0)
}

/// Returns the value below which a fraction (0 to 1) of the values lies; `None` without values. Sorts the values.
pub(super) fn quantile(values: &mut [f64], part: f64) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a position
    let i = (part * (values.len() as f64 - 1.0)).round() as usize;
    values.get(i).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn round_numbers_are_not_above_their_value() {
        for (value, round) in [
            (1.0, 1.0),
            (1.9, 1.0),
            (2.0, 2.0),
            (4.99, 2.0),
            (730.0, 500.0),
            (0.02, 0.02),
            (1e-6, 1e-6),
        ] {
            let found = round_below(value);
            assert!((found - round).abs() <= 1e-9 * round, "{value}: {found}");
        }
    }

    #[test]
    fn numbers_on_axes_are_short() {
        let text = |value: f64| axis_number(value);
        assert_eq!(text(-6e-17), "0");
        assert_eq!(text(0.1 + 0.2), "0.3");
        assert_eq!(text(-400.0), "-400");
        assert_eq!(text(2e-7), "2e-7");
    }

    #[test]
    fn ticks_are_round_and_apart() {
        let labels = |low, high, apart| -> Vec<String> {
            ticks(low, high, apart).into_iter().map(|(_, label)| label).collect()
        };
        assert_eq!(labels(-0.3, 0.3, 0.09), ["-0.2", "0", "0.2"]);
        assert_eq!(labels(0.0, 10.0, 2.0), ["0", "5", "10"]);
        assert_eq!(labels(3.1, 3.4, 1.0), [""; 0]);
        let whole = Axis::new("n", [0.0, 3.0]).with_ticks(Ticks::Whole).labels(0.1);
        assert_eq!(whole.iter().map(|(at, _)| *at).collect::<Vec<_>>(), [0.0, 1.0, 2.0, 3.0]);
    }

    /// The axis v runs down the page, as in an image.
    #[test]
    fn values_at_the_ends_of_the_axes_are_at_the_corners_of_the_chart() {
        let chart = Area::new(70.0, 40.0, 200.0, 100.0);
        let (x, y) = (Axis::new("u", [-0.5, 9.5]), Axis::new("v", [4.5, -0.5]));
        let plane = Drawing::new(300.0, 200.0).axes(&chart, &x, &y);
        assert_eq!(plane.place(-0.5, -0.5), chart.corner);
        assert_eq!(plane.place(9.5, 4.5), chart.corner + chart.size);
    }

    #[test]
    fn hues_are_those_of_css() {
        assert_eq!(Color::of_hue(0.0), Color(245, 61, 61));
        assert_eq!(Color::of_hue(120.0), Color(61, 245, 61));
    }
}
