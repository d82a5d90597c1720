//! What figures share: colours, fonts, and the lines, arrows and text drawn over a chart.

use std::fmt::Write as _;

use nalgebra::Vector2;
use plotters::prelude::*;

use super::html::escaped;
use crate::error::{Error, Result};

/// Colours of the lens types, as in the paper: red, green, blue; readable on white, and told apart
/// by the colour-blind by their lightness.
pub(super) const TYPE_COLORS: [RGBColor; 3] =
    [RGBColor(200, 30, 30), RGBColor(40, 140, 60), RGBColor(30, 70, 200)];
/// Text and lines.
pub(super) const INK: RGBColor = RGBColor(60, 60, 60);
/// Lines of a model through measurements.
pub(super) const FITTED: RGBColor = RGBColor(190, 0, 190);
/// Two colours that everybody can tell apart, for two quantities side by side and for the two signs.
pub(super) const BLUE: RGBColor = RGBColor(0, 100, 170);
pub(super) const ORANGE: RGBColor = RGBColor(200, 80, 0);
/// Text on one of these two.
pub(super) const ON_COLOR: RGBColor = RGBColor(253, 253, 253);

/// Colours on a white page, and their replacements on a dark one.
pub(super) const ON_DARK: [(RGBColor, RGBColor); 10] = [
    (WHITE, RGBColor(30, 31, 34)),
    (BLACK, RGBColor(255, 255, 255)),
    (INK, RGBColor(222, 222, 222)),
    (TYPE_COLORS[0], RGBColor(255, 122, 112)),
    (TYPE_COLORS[1], RGBColor(96, 200, 120)),
    (TYPE_COLORS[2], RGBColor(130, 165, 255)),
    (FITTED, RGBColor(240, 120, 240)),
    (BLUE, RGBColor(70, 160, 225)),
    (ORANGE, RGBColor(240, 140, 60)),
    (ON_COLOR, RGBColor(18, 18, 18)),
];

/// A colour as an attribute value, spelt like the SVG backend spells it.
pub(super) fn hex(RGBColor(r, g, b): RGBColor) -> String {
    format!("#{r:02X}{g:02X}{b:02X}")
}

/// Text in ink, `size` px high.
pub(super) fn font(size: u32) -> TextStyle<'static> {
    ("sans-serif", size).into_font().color(&INK)
}

#[allow(clippy::needless_pass_by_value)] // as map_err has it
pub(super) fn drawing<E: std::error::Error + Send + Sync>(error: DrawingAreaErrorKind<E>) -> Error {
    Error::invalid(format!("a figure could not be drawn: {error}"))
}

pub(super) type Area<'a> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;

/// Draws a picture of a size in px: charts by the library, and over them what its integer pixel
/// coordinates are too coarse for.
pub(super) fn picture(
    size: (u32, u32),
    draw: impl FnOnce(&Area, &mut Overlay) -> Result<()>,
) -> Result<String> {
    let mut svg = String::new();
    let mut overlay = Overlay::default();
    {
        let root = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        root.fill(&WHITE).map_err(drawing)?;
        draw(&root, &mut overlay)?;
        root.present().map_err(drawing)?;
    }
    let end = svg.rfind("</svg>").unwrap_or(svg.len());
    svg.insert_str(end, &overlay.svg);
    Ok(svg)
}

/// Where text stands with respect to its position.
#[derive(Debug, Clone, Copy)]
pub(super) enum Anchor {
    Start,
    Middle,
    End,
}

/// Marks drawn over a chart, in px of the picture.
#[derive(Debug, Default)]
pub(super) struct Overlay {
    svg: String,
}

// Writing to a String cannot fail.
impl Overlay {
    /// A line through points.
    pub fn line(&mut self, points: &[Vector2<f64>], color: RGBColor, width: f64) {
        self.path(points, "", &format!("fill=\"none\" {}", stroke(color, width)));
    }

    /// A dashed line through points.
    pub fn dashed(&mut self, points: &[Vector2<f64>], color: RGBColor, width: f64) {
        let style = format!("fill=\"none\" {} stroke-dasharray=\"5 4\"", stroke(color, width));
        self.path(points, "", &style);
    }

    /// A filled area without an outline.
    pub fn area(&mut self, points: &[Vector2<f64>], color: RGBColor, opacity: f64) {
        let fill = hex(color);
        self.path(points, "z", &format!("fill=\"{fill}\" fill-opacity=\"{opacity:.3}\""));
    }

    /// Filled rectangles without outlines, each by its upper left corner and its size; no gap shows
    /// between those that touch.
    pub fn rectangles(
        &mut self,
        rectangles: &[(Vector2<f64>, Vector2<f64>)],
        color: RGBColor,
        opacity: f64,
    ) {
        self.svg.push_str("<path d=\"");
        for (corner, size) in rectangles {
            // Edges as positions, not as lengths: neighbours share them to the last digit.
            let (left, top, end) = (corner.x, corner.y, corner + size);
            let _ = write!(self.svg, "M{left:.1} {top:.1}H{:.1}V{:.1}H{left:.1}z", end.x, end.y);
        }
        let _ = writeln!(
            self.svg,
            "\" fill=\"{}\" fill-opacity=\"{opacity:.3}\" shape-rendering=\"crispEdges\"/>",
            hex(color)
        );
    }

    /// One filled rectangle.
    pub fn rectangle(
        &mut self,
        corner: Vector2<f64>,
        size: Vector2<f64>,
        color: RGBColor,
        opacity: f64,
    ) {
        self.rectangles(&[(corner, size)], color, opacity);
    }

    /// Filled discs.
    pub fn discs(&mut self, middles: &[Vector2<f64>], radius: f64, color: RGBColor) {
        for middle in middles {
            let _ = writeln!(
                self.svg,
                "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"{radius}\" fill=\"{}\"/>",
                middle.x,
                middle.y,
                hex(color)
            );
        }
    }

    /// Arrows from a point along a vector, as one path; one too short for a head is a line or a dot.
    pub fn arrows(&mut self, arrows: &[(Vector2<f64>, Vector2<f64>)], color: RGBColor, width: f64) {
        if arrows.is_empty() {
            return;
        }
        self.svg.push_str("<path d=\"");
        for (from, along) in arrows {
            let (x, y) = (from.x, from.y);
            let _ = write!(self.svg, "M{x:.1} {y:.1}l{:.1} {:.1}", along.x, along.y);
            let length = along.norm();
            if length >= SHORTEST_WITH_HEAD {
                let back = along * (-(HEAD_PART * length).clamp(HEAD.0, HEAD.1) / length);
                let side = Vector2::new(-back.y, back.x) * HEAD_WIDTH;
                let (left, right) = (back + side, back - side);
                let (across, tip) = (right - left, -right);
                let _ = write!(
                    self.svg,
                    "l{:.1} {:.1}m{:.1} {:.1}l{:.1} {:.1}",
                    left.x, left.y, across.x, across.y, tip.x, tip.y
                );
            }
        }
        let style = stroke(color, width);
        let _ = writeln!(self.svg, "\" fill=\"none\" {style} stroke-linecap=\"round\"/>");
    }

    /// Text, vertically centred on a point.
    pub fn text(&mut self, at: Vector2<f64>, anchor: Anchor, size: f64, words: &str) {
        self.colored_text(at, anchor, size, INK, words);
    }

    /// Text in another colour.
    pub fn colored_text(
        &mut self,
        at: Vector2<f64>,
        anchor: Anchor,
        size: f64,
        color: RGBColor,
        words: &str,
    ) {
        self.words(at, anchor, size, color, words, "");
    }

    /// Text that runs upwards.
    pub fn upward_text(&mut self, at: Vector2<f64>, anchor: Anchor, size: f64, words: &str) {
        let turn = format!(" transform=\"rotate(-90 {:.1} {:.1})\"", at.x, at.y);
        self.words(at, anchor, size, INK, words, &turn);
    }

    fn words(
        &mut self,
        at: Vector2<f64>,
        anchor: Anchor,
        size: f64,
        color: RGBColor,
        words: &str,
        turn: &str,
    ) {
        let anchor = match anchor {
            Anchor::Start => "start",
            Anchor::Middle => "middle",
            Anchor::End => "end",
        };
        let _ = writeln!(
            self.svg,
            "<text x=\"{:.1}\" y=\"{:.1}\" dy=\"0.35em\" text-anchor=\"{anchor}\" \
             font-family=\"sans-serif\" font-size=\"{size}\" fill=\"{}\"{turn}>{}</text>",
            at.x,
            at.y,
            hex(color),
            escaped(words)
        );
    }

    fn path(&mut self, points: &[Vector2<f64>], end: &str, style: &str) {
        let mut steps = points.iter();
        let Some(first) = steps.next() else { return };
        let _ = write!(self.svg, "<path d=\"M{:.1} {:.1}", first.x, first.y);
        for p in steps {
            let _ = write!(self.svg, "L{:.1} {:.1}", p.x, p.y);
        }
        let _ = writeln!(self.svg, "{end}\" {style}/>");
    }
}

/// Shortest arrow that has a head, px.
const SHORTEST_WITH_HEAD: f64 = 3.0;
/// Length of the head as a fraction of the arrow's, its limits in px, and half its width over its
/// length.
const HEAD_PART: f64 = 0.35;
const HEAD: (f64, f64) = (2.0, 7.0);
const HEAD_WIDTH: f64 = 0.45;

fn stroke(color: RGBColor, width: f64) -> String {
    format!("stroke=\"{}\" stroke-width=\"{width}\"", hex(color))
}

/// Rounding error of a tick at 0.
const NOTHING: f64 = 1e-12;

/// A number on an axis: short, whatever its magnitude.
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

/// The largest of 1, 2 and 5 times a power of ten that is not above a value.
pub(super) fn round_below(value: f64) -> f64 {
    let decade = 10_f64.powf(value.log10().floor());
    // A value that is such a number may be off in its last digit.
    let part = value / decade * (1.0 + 1e-9);
    decade * [10.0, 5.0, 2.0].into_iter().find(|&step| part >= step).unwrap_or(1.0)
}

/// The value below which a fraction (0 to 1) of the values lies; `None` without values. Sorts them.
pub(super) fn quantile(values: &mut [f64], part: f64) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a position
    let i = (part * (values.len() as f64 - 1.0)).round() as usize;
    values.get(i).copied()
}

/// Two linear axes: from values to px of the picture.
#[derive(Debug, Clone, Copy)]
pub(super) struct Plane {
    /// Value at `origin_px`.
    pub origin: Vector2<f64>,
    /// Its position.
    pub origin_px: Vector2<f64>,
    /// Px of the picture for one unit.
    pub scale: Vector2<f64>,
}

impl Plane {
    /// The axes of a chart that spans values from `from` at the lower left to `to`.
    pub fn of_chart(
        (across, down): (std::ops::Range<i32>, std::ops::Range<i32>),
        from: Vector2<f64>,
        to: Vector2<f64>,
    ) -> Self {
        let size =
            Vector2::new(f64::from(across.end - across.start), f64::from(down.start - down.end));
        Self {
            origin: from,
            origin_px: Vector2::new(f64::from(across.start), f64::from(down.end)),
            scale: size.component_div(&(to - from)),
        }
    }

    pub fn place(&self, x: f64, y: f64) -> Vector2<f64> {
        self.origin_px + (Vector2::new(x, y) - self.origin).component_mul(&self.scale)
    }
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
}
