//! One picture: a white sheet of a fixed size, to which shapes and text are added.

use std::fmt::Write;

use crate::report::colour::Rgb;
use crate::report::svg::escape;

/// Style of everything on a sheet. Classes are those of [`crate::report::svg`], plus `title`, `note` and `small` for text.
const STYLE: &str = "\
.sheet{background:#fff;font-family:'DejaVu Sans','Liberation Sans',Arial,sans-serif}\
.sheet text{fill:#333c4a;font-size:11.5px}\
.sheet .heading{font-size:17px;font-weight:600;fill:#111722}\
.sheet .title{font-size:13px;font-weight:600;fill:#111722}\
.sheet .note{font-size:12px}.sheet .small,.sheet .tick{font-size:11px}.sheet .stage{font-size:11px}\
.sheet .mid{text-anchor:middle}.sheet .end{text-anchor:end}\
.sheet .axis{stroke:#5b6575;stroke-width:1;fill:none}.sheet .grid{stroke:#e3e7ee;stroke-width:1}\
.sheet .band{fill:#f1f4f8}.sheet .mark{stroke:#5b6575;stroke-width:1;stroke-dasharray:3 3;fill:none}\
.sheet .line{fill:none;stroke-linejoin:round;stroke-linecap:round}\
.sheet .strong{stroke-width:2}.sheet .dashed{stroke-width:1.6;stroke-dasharray:6 3}\
.sheet .broad{stroke-width:6;opacity:.32}.sheet .faint{stroke-width:.9;opacity:.4}\
.sheet .c0{stroke:#1f5fd0}.sheet .c1{stroke:#d9730d}.sheet .c2{stroke:#0c8a5b}.sheet .c3{stroke:#c2255c}\
.sheet .c4{stroke:#7447c9}.sheet .c5{stroke:#0b7f9e}.sheet .c6{stroke:#8a6d00}.sheet .c7{stroke:#3a4252}\
.sheet .dot{fill:#fff;stroke:#111722;stroke-width:1.6}\
.sheet .halo{stroke:#fff;stroke-width:4.4;fill:none}.sheet .sign{stroke:#111722;stroke-width:1.8;fill:none}\
.sheet rect{shape-rendering:crispEdges}\
.sheet .level{stroke:#fff;stroke-opacity:.45;stroke-width:.7;fill:none}";

/// A picture in the making.
#[derive(Clone, Debug)]
pub struct Sheet {
    title: String,
    size: (f64, f64),
    body: String,
}

/// Where text begins, or what it is centred on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Anchor {
    /// The text begins here.
    Start,
    /// The text is centred here.
    Middle,
    /// The text ends here.
    End,
}

impl Anchor {
    fn class(self) -> &'static str {
        match self {
            Self::Start => "",
            Self::Middle => " mid",
            Self::End => " end",
        }
    }
}

/// `#rrggbb`.
pub fn hex([r, g, b]: Rgb) -> String {
    format!("#{r:02x}{g:02x}{b:02x}")
}

impl Sheet {
    /// An empty sheet; `title` is its heading, and read aloud.
    pub fn new(title: &str, width: f64, height: f64) -> Self {
        let mut sheet = Self { title: title.to_owned(), size: (width, height), body: String::new() };
        sheet.text((14.0, 26.0), "heading", Anchor::Start, title);
        sheet
    }

    /// Adds markup as it is.
    pub fn raw(&mut self, markup: &str) {
        self.body.push_str(markup);
    }

    /// Text of a class at its base line.
    pub fn text(&mut self, (x, y): (f64, f64), class: &str, anchor: Anchor, text: &str) {
        let anchor = anchor.class();
        let _ = write!(self.body, "<text class=\"{class}{anchor}\" x=\"{x:.1}\" y=\"{y:.1}\">{}</text>", escape(text));
    }

    /// Text from below to above, centred.
    pub fn upright_text(&mut self, (x, y): (f64, f64), class: &str, text: &str) {
        let place = format!("translate({x:.1} {y:.1}) rotate(-90)");
        let _ = write!(self.body, "<text class=\"{class} mid\" transform=\"{place}\">{}</text>", escape(text));
    }

    /// A path of a class.
    pub fn path(&mut self, class: &str, d: &str) {
        let _ = write!(self.body, "<path class=\"{class}\" d=\"{d}\"/>");
    }

    /// A filled rectangle without border.
    pub fn rectangle(&mut self, (x, y): (f64, f64), (width, height): (f64, f64), fill: Rgb) {
        let fill = hex(fill);
        let _ =
            write!(self.body, "<rect x=\"{x:.2}\" y=\"{y:.2}\" width=\"{width:.2}\" height=\"{height:.2}\" fill=\"{fill}\"/>");
    }

    /// A filled path without border.
    pub fn area(&mut self, fill: Rgb, d: &str) {
        let _ = write!(self.body, "<path fill=\"{}\" d=\"{d}\"/>", hex(fill));
    }

    /// A cross (here is the truth, here is p0), readable on any ground.
    pub fn cross(&mut self, (x, y): (f64, f64), size: f64) {
        let (left, top) = (x - size, y - size);
        let d = format!("M{left:.1} {top:.1}l{0:.1} {0:.1}m0 -{0:.1}l-{0:.1} {0:.1}", 2.0 * size);
        self.path("halo", &d);
        self.path("sign", &d);
    }

    /// A ring (here is the minimum, here is the focus), readable on any ground.
    pub fn ring(&mut self, (x, y): (f64, f64), radius: f64) {
        for class in ["halo", "sign"] {
            let _ = write!(self.body, "<circle class=\"{class}\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{radius:.1}\"/>");
        }
    }

    /// What `draw` adds, cut off at the edges of a rectangle. Coordinates stay those of the sheet.
    pub fn cut_to(&mut self, (x, y): (f64, f64), (width, height): (f64, f64), draw: impl FnOnce(&mut Self)) {
        let _ = write!(
            self.body,
            "<svg x=\"{x:.1}\" y=\"{y:.1}\" width=\"{width:.1}\" height=\"{height:.1}\" viewBox=\"{x:.1} {y:.1} {width:.1} {height:.1}\">"
        );
        draw(self);
        self.body.push_str("</svg>");
    }

    /// The picture as one SVG element.
    pub fn to_svg(&self) -> String {
        let (w, h) = self.size;
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {w} {h}\" width=\"{w}\" height=\"{h}\" role=\"img\" class=\"sheet\"><title>{}</title><style>{STYLE}</style><rect width=\"{w}\" height=\"{h}\" fill=\"#ffffff\"/>{}</svg>\n",
            escape(&self.title),
            self.body
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::svg::tests::assert_well_formed;

    #[test]
    fn everything_on_a_sheet_is_well_formed() {
        let mut sheet = Sheet::new("a < b & c", 100.0, 50.0);
        sheet.text((1.0, 2.0), "note", Anchor::End, "x > y");
        sheet.upright_text((1.0, 2.0), "label", "z");
        sheet.rectangle((0.0, 0.0), (2.0, 3.0), [255, 0, 16]);
        sheet.cut_to((1.0, 1.0), (5.0, 5.0), |sheet| {
            sheet.cross((3.0, 3.0), 2.0);
            sheet.ring((3.0, 3.0), 2.0);
        });
        let svg = sheet.to_svg();
        assert_well_formed(svg.trim_end());
        assert!(svg.contains("a &lt; b &amp; c") && svg.contains("fill=\"#ff0010\""));
        assert!(!svg.contains(" id=\"") && !svg.contains("href"));
    }
}
