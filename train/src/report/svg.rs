//! Charts as SVG text. Colours come from the page: class `c0` to `c7` for lines, `axis`, `grid`, `band` and `mark` for the
//! rest.

use std::fmt::Write;

use super::scale::Axis;

/// How a line is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stroke {
    /// Thick.
    Strong,
    /// Thin and pale, for raw values behind a smoothed line.
    Faint,
    /// Dashed, for lines of comparison.
    Dashed,
    /// Broad and pale, for a reference that another line may cover.
    Broad,
}

impl Stroke {
    /// Class in the page's style sheet.
    pub fn class(self) -> &'static str {
        match self {
            Self::Strong => "strong",
            Self::Faint => "faint",
            Self::Dashed => "dashed",
            Self::Broad => "broad",
        }
    }
}

/// One line of a chart.
#[derive(Clone, Debug, PartialEq)]
pub struct Series {
    /// Name in the legend.
    pub name: String,
    /// Number of the colour; colours repeat after eight.
    pub colour: usize,
    /// How it is drawn.
    pub stroke: Stroke,
    /// Points (x, y); the line is broken where a value cannot be shown.
    pub points: Vec<(f64, f64)>,
}

/// A vertical line with a name; the area from one to the next is shaded in turn.
#[derive(Clone, Debug, PartialEq)]
pub struct Mark {
    /// Where.
    pub x: f64,
    /// Name of what begins there.
    pub label: String,
}

/// A chart of lines over two axes.
#[derive(Clone, Debug, PartialEq)]
pub struct Chart {
    /// Short description, read aloud and shown on hover.
    pub title: String,
    /// What the horizontal axis is.
    pub x_label: String,
    /// What the vertical axis is.
    pub y_label: String,
    /// Logarithmic vertical axis.
    pub log_y: bool,
    /// Fixed horizontal range; else from the first to the last value.
    pub x_range: Option<(f64, f64)>,
    /// Fixed vertical range; else around the values.
    pub y_range: Option<(f64, f64)>,
    /// One unit has the same length on both axes (for paths).
    pub equal_units: bool,
    /// Lines, drawn in order.
    pub series: Vec<Series>,
    /// Where something begins (stages, sequences).
    pub marks: Vec<Mark>,
    /// Dots with a name, for instance the start of a path.
    pub dots: Vec<(f64, f64, String)>,
    /// Width and height in user units.
    pub size: (f64, f64),
}

impl Chart {
    /// An empty chart of the usual size.
    pub fn new(title: &str, x_label: &str, y_label: &str) -> Self {
        Self {
            title: title.to_owned(),
            x_label: x_label.to_owned(),
            y_label: y_label.to_owned(),
            log_y: false,
            x_range: None,
            y_range: None,
            equal_units: false,
            series: Vec::new(),
            marks: Vec::new(),
            dots: Vec::new(),
            size: (440.0, 230.0),
        }
    }

    /// SVG text, one element, without any reference to something outside.
    pub fn to_svg(&self) -> String {
        let (w, h) = self.size;
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {w} {h}\" role=\"img\" class=\"chart\"><title>{}</title>{}</svg>",
            escape(&self.title),
            self.content()
        )
    }

    /// What [`Chart::to_svg`] draws, for a place within a larger picture.
    pub fn content(&self) -> String {
        let frame = Frame::of(self);
        let mut out = String::new();
        self.draw_marks(&frame, &mut out);
        self.draw_axes(&frame, &mut out);
        for series in &self.series {
            draw_line(series, &frame, &mut out);
        }
        for (x, y, name) in &self.dots {
            let (Some(px), Some(py)) = (frame.x_at(*x), frame.y_at(*y)) else {
                continue;
            };
            let _ = write!(
                out,
                "<circle class=\"dot\" cx=\"{px:.1}\" cy=\"{py:.1}\" r=\"3.5\"/><text class=\"tick\" x=\"{:.1}\" y=\"{:.1}\">{}</text>",
                px + 6.0,
                py - 5.0,
                escape(name)
            );
        }
        out
    }

    fn draw_marks(&self, frame: &Frame, out: &mut String) {
        for (i, mark) in self.marks.iter().enumerate() {
            let end = self.marks.get(i + 1).map_or(frame.x.high, |next| next.x);
            let clamp = |x: f64| frame.x_at(x.clamp(frame.x.low, frame.x.high)).unwrap_or(frame.left);
            let (from, to) = (clamp(mark.x), clamp(end));
            if to - from < 0.5 {
                continue;
            }
            let (top, height) = (frame.top, frame.bottom - frame.top);
            if i % 2 == 1 {
                let _ = write!(
                    out,
                    "<rect class=\"band\" x=\"{from:.1}\" y=\"{top:.1}\" width=\"{:.1}\" height=\"{height:.1}\"/>",
                    to - from
                );
            }
            if from > frame.left + 0.5 {
                let _ = write!(out, "<path class=\"mark\" d=\"M{from:.1} {top:.1}V{:.1}\"/>", frame.bottom);
            }
            let room = 5.6 * mark.label.chars().count() as f64 + 6.0;
            if to - from > room {
                let _ = write!(
                    out,
                    "<text class=\"stage\" x=\"{:.1}\" y=\"{:.1}\">{}</text>",
                    from + 4.0,
                    top - 4.0,
                    escape(&mark.label)
                );
            }
        }
    }

    fn draw_axes(&self, frame: &Frame, out: &mut String) {
        let (left, right, top, bottom) = (frame.left, frame.right, frame.top, frame.bottom);
        let rows = ((bottom - top) / 34.0).clamp(3.0, 9.0) as usize;
        for (value, text) in frame.y.ticks(rows) {
            let Some(y) = frame.y_at(value) else { continue };
            let _ = write!(
                out,
                "<path class=\"grid\" d=\"M{left:.1} {y:.1}H{right:.1}\"/><text class=\"tick end\" x=\"{:.1}\" y=\"{:.1}\">{text}</text>",
                left - 5.0,
                y + 3.5
            );
        }
        let columns = ((right - left) / 62.0).clamp(3.0, 12.0) as usize;
        for (value, text) in frame.x.ticks(columns) {
            let Some(x) = frame.x_at(value) else { continue };
            let _ = write!(
                out,
                "<path class=\"axis\" d=\"M{x:.1} {bottom:.1}v4\"/><text class=\"tick mid\" x=\"{x:.1}\" y=\"{:.1}\">{text}</text>",
                bottom + 15.0
            );
        }
        let (middle_x, middle_y) = (0.5 * (left + right), 0.5 * (top + bottom));
        let _ = write!(
            out,
            "<path class=\"axis\" d=\"M{left:.1} {top:.1}V{bottom:.1}H{right:.1}\"/><text class=\"label mid\" x=\"{middle_x:.1}\" y=\"{:.1}\">{}</text><text class=\"label mid\" transform=\"translate(11 {middle_y:.1}) rotate(-90)\">{}</text>",
            bottom + 31.0,
            escape(&self.x_label),
            escape(&self.y_label)
        );
    }
}

/// The plot area in user units and its axes.
struct Frame {
    left: f64,
    right: f64,
    top: f64,
    bottom: f64,
    x: Axis,
    y: Axis,
}

impl Frame {
    fn of(chart: &Chart) -> Self {
        let (w, h) = chart.size;
        let points = || chart.series.iter().flat_map(|s| s.points.iter());
        let shown = || points().filter(|p| p.1.is_finite());
        let mut x = Axis::around(shown().map(|p| p.0), false);
        if !chart.equal_units {
            let ends = shown().map(|p| p.0).fold((f64::MAX, f64::MIN), |a, x| (a.0.min(x), a.1.max(x)));
            let ends = chart.x_range.unwrap_or(ends);
            if ends.1 > ends.0 {
                (x.low, x.high) = ends;
            }
        }
        let mut y = Axis::around(shown().map(|p| p.1), chart.log_y);
        if let Some((low, high)) = chart.y_range {
            y = Axis { low, high, log: chart.log_y };
        }
        let mut frame = Self { left: 54.0, right: w - 12.0, top: 16.0, bottom: h - 38.0, x, y };
        if chart.equal_units {
            frame.equalise();
        }
        frame
    }

    /// Widens one axis so that a unit is equally long on both.
    fn equalise(&mut self) {
        let per_unit = |pixels: f64, axis: &Axis| pixels / (axis.high - axis.low);
        let scale = per_unit(self.right - self.left, &self.x).min(per_unit(self.bottom - self.top, &self.y));
        let widen = |axis: &mut Axis, pixels: f64| {
            let (middle, half) = (0.5 * (axis.low + axis.high), 0.5 * pixels / scale);
            (axis.low, axis.high) = (middle - half, middle + half);
        };
        widen(&mut self.x, self.right - self.left);
        widen(&mut self.y, self.bottom - self.top);
    }

    fn x_at(&self, value: f64) -> Option<f64> {
        Some(self.left + self.x.position(value)? * (self.right - self.left))
    }

    fn y_at(&self, value: f64) -> Option<f64> {
        let position = self.y.position(value)?.clamp(-0.02, 1.02);
        Some(self.bottom - position * (self.bottom - self.top))
    }
}

fn draw_line(series: &Series, frame: &Frame, out: &mut String) {
    let mut path = String::new();
    let mut pen_down = false;
    for &(x, y) in &series.points {
        let (Some(px), Some(py)) = (frame.x_at(x), frame.y_at(y)) else {
            pen_down = false;
            continue;
        };
        let _ = write!(path, "{}{px:.1} {py:.1}", if pen_down { 'L' } else { 'M' });
        pen_down = true;
    }
    if !path.is_empty() {
        let (colour, stroke) = (series.colour % 8, series.stroke.class());
        let _ =
            write!(out, "<path class=\"line c{colour} {stroke}\" d=\"{path}\"><title>{}</title></path>", escape(&series.name));
    }
}

/// Text that is safe inside SVG and HTML elements and quoted attributes; characters that XML forbids become a space.
pub fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            c if c.is_control() => out.push(' '),
            c => out.push(c),
        }
    }
    out
}

#[cfg(test)]
#[path = "svg_tests.rs"]
pub(crate) mod tests;
