//! A framed plot area: from numbers to places on a sheet, ticks, and names of the axes.

use super::sheet::{Anchor, Sheet};
use crate::report::scale::Axis;

/// Which way the vertical axis grows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Upward {
    /// Larger values are higher, as in charts.
    Grows,
    /// Larger values are lower, as rows of an image.
    Shrinks,
}

/// A plot area on a sheet and its axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// Left upper corner.
    pub corner: (f64, f64),
    /// Width and height.
    pub size: (f64, f64),
    /// Horizontal axis.
    pub x: Axis,
    /// Vertical axis.
    pub y: Axis,
    /// Direction of the vertical axis.
    pub upward: Upward,
}

impl Frame {
    /// The frame of an image of `width` times `height` pixels, as wide as given; pixels are square.
    pub fn of_image(corner: (f64, f64), plot_width: f64, (width, height): (usize, usize)) -> Self {
        let axis = |n: usize| Axis { low: -0.5, high: n as f64 - 0.5, log: false };
        let size = (plot_width, plot_width * height as f64 / width as f64);
        Self { corner, size, x: axis(width), y: axis(height), upward: Upward::Shrinks }
    }

    /// Place of a point of the plot; what lies outside of the axes lies outside of the frame.
    pub fn at(&self, x: f64, y: f64) -> (f64, f64) {
        let along = |axis: &Axis, value: f64| axis.position(value).unwrap_or(0.0);
        let down = match self.upward {
            Upward::Grows => 1.0 - along(&self.y, y),
            Upward::Shrinks => along(&self.y, y),
        };
        (self.corner.0 + along(&self.x, x) * self.size.0, self.corner.1 + down * self.size.1)
    }

    /// Length on the sheet of one unit of the horizontal axis.
    pub fn unit(&self) -> f64 {
        self.size.0 / (self.x.high - self.x.low)
    }

    /// Title above, and a remark in the line below the title.
    pub fn draw_title(&self, sheet: &mut Sheet, title: &str, remark: &str) {
        let (left, top) = self.corner;
        sheet.text((left, top - 21.0), "title", Anchor::Start, title);
        sheet.text((left, top - 6.0), "small", Anchor::Start, remark);
    }

    /// Border, ticks and names of both axes, with about so many ticks on each.
    pub fn draw_axes(&self, sheet: &mut Sheet, [x_name, y_name]: [&str; 2], [columns, rows]: [usize; 2]) {
        let ((left, top), (width, height)) = (self.corner, self.size);
        let bottom = top + height;
        for (value, text) in self.x.ticks(columns) {
            let x = self.at(value, self.y.low).0;
            sheet.path("axis", &format!("M{x:.1} {bottom:.1}v4"));
            sheet.text((x, bottom + 15.0), "tick", Anchor::Middle, &text);
        }
        for (value, text) in self.y.ticks(rows) {
            let y = self.at(self.x.low, value).1;
            sheet.path("axis", &format!("M{left:.1} {y:.1}h-4"));
            sheet.text((left - 6.0, y + 4.0), "tick", Anchor::End, &text);
        }
        sheet.path("axis", &format!("M{left:.1} {top:.1}h{width:.1}v{height:.1}h-{width:.1}z"));
        sheet.text((left + 0.5 * width, bottom + 29.0), "label", Anchor::Middle, x_name);
        sheet.upright_text((left - 44.0, top + 0.5 * height), "label", y_name);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_keep_their_shape_and_rows_go_down() {
        let frame = Frame::of_image((10.0, 20.0), 320.0, (640, 192));
        assert_eq!(frame.size, (320.0, 96.0));
        assert_eq!((frame.at(-0.5, -0.5), frame.at(639.5, 191.5)), ((10.0, 20.0), (330.0, 116.0)));
        assert_eq!(frame.unit(), 0.5);
    }

    #[test]
    fn charts_grow_upward() {
        let axis = Axis { low: 0.0, high: 1.0, log: false };
        let frame = Frame { corner: (0.0, 0.0), size: (10.0, 20.0), x: axis, y: axis, upward: Upward::Grows };
        assert_eq!((frame.at(0.0, 0.0), frame.at(1.0, 1.0)), ((0.0, 20.0), (10.0, 0.0)));
    }
}
