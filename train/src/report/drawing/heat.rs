//! Heat maps: values on a grid as steps of colour with lines between them, and their key.

use std::fmt::Write;

use super::frame::Frame;
use super::sheet::{Anchor, Sheet};
use crate::report::colour::{Rgb, Scale, UNKNOWN};
use crate::report::scale::Axis;

/// Values on a grid of points.
#[derive(Clone, Debug, PartialEq)]
pub struct Heat {
    /// Horizontal places of the columns, rising in equal steps.
    pub x: Vec<f64>,
    /// Vertical places of the rows, rising in equal steps.
    pub y: Vec<f64>,
    /// Values, row by row.
    pub values: Vec<f64>,
}

/// Steps of colour between round values.
#[derive(Clone, Debug, PartialEq)]
pub struct Steps {
    /// Round values where the colour changes, rising.
    levels: Vec<(f64, String)>,
}

impl Steps {
    /// About `count` steps over the finite values.
    pub fn over(values: &[f64], count: usize) -> Self {
        let finite = || values.iter().copied().filter(|v| v.is_finite());
        let (low, high) = finite().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
        let range = high - low;
        let levels = if range > 0.0 { Axis { low, high, log: false }.ticks(count) } else { Vec::new() };
        // A level at the very end would make a step that no value has.
        let inside = |(v, _): &(f64, String)| *v > low + 1e-9 * range && *v < high;
        Self { levels: levels.into_iter().filter(inside).collect() }
    }

    fn colour(&self, step: usize) -> Rgb {
        Scale::Ember.at((step as f64 + 0.5) / (self.levels.len() + 1) as f64)
    }
}

impl Heat {
    /// Evaluates a function of x and y at all points of the grid, rows at the same time where threads are free.
    pub fn evaluate(x: Vec<f64>, y: Vec<f64>, f: impl Fn(f64, f64) -> f64 + Sync) -> Self {
        let row = |j: usize| x.iter().map(|&x| f(x, y[j])).collect::<Vec<f64>>();
        let values = dimode_autodiff::par::map_indices(y.len(), row).concat();
        Self { x, y, values }
    }

    /// Place of the smallest value.
    pub fn minimum(&self) -> (f64, f64) {
        let first = |best: usize, i: usize| if self.values[i] < self.values[best] { i } else { best };
        let at = (1..self.values.len()).fold(0, first);
        (self.x[at % self.x.len()], self.y[at / self.x.len()])
    }

    /// Steps of colour, thin lines where they meet, and grey cells where a corner has no value.
    pub fn draw(&self, sheet: &mut Sheet, frame: &Frame, steps: &Steps) {
        sheet.cut_to(frame.corner, frame.size, |sheet| {
            sheet.rectangle(frame.corner, frame.size, steps.colour(0));
            for (k, (level, _)) in steps.levels.iter().enumerate() {
                sheet.area(steps.colour(k + 1), &self.region(frame, |v| v - level));
            }
            for (level, _) in &steps.levels {
                sheet.path("level", &self.isoline(frame, *level));
            }
            // Infinite where a value is missing, below zero elsewhere.
            sheet.area(UNKNOWN, &self.region(frame, |v| if v.is_finite() { f64::NEG_INFINITY } else { 1.0 }));
        });
    }

    /// The four corners (x, y, value) of the cells of a row, each once around.
    fn cells(&self, row: usize) -> impl Iterator<Item = [Corner; 4]> + '_ {
        let columns = self.x.len();
        let corner = move |i: usize, j: usize| (self.x[i], self.y[j], self.values[j * columns + i]);
        let cell = move |i: usize, j: usize| [corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)];
        (0..columns.saturating_sub(1)).map(move |i| cell(i, row))
    }

    fn rows(&self) -> std::ops::Range<usize> {
        0..self.y.len().saturating_sub(1)
    }

    /// Where a function of the value is not below zero: whole cells side by side are one rectangle, others are cut by linear
    /// interpolation along their edges. All of it is one path, so that no seams show.
    fn region(&self, frame: &Frame, above: impl Fn(f64) -> f64) -> String {
        let mut path = String::new();
        for row in self.rows() {
            let mut run: Option<[(f64, f64); 4]> = None;
            for cell in self.cells(row) {
                let cell = cell.map(|(x, y, value)| (x, y, above(value)));
                if cell.iter().all(|corner| corner.2 >= 0.0) {
                    let [a, b, c, d] = cell.map(|(x, y, _)| (x, y));
                    run = Some(run.map_or([a, b, c, d], |[first, _, _, last]| [first, b, c, last]));
                } else {
                    add_polygon(&mut path, frame, run.take().into_iter().flatten());
                    add_polygon(&mut path, frame, cut(&cell).into_iter());
                }
            }
            add_polygon(&mut path, frame, run.into_iter().flatten());
        }
        path
    }

    /// Where the value crosses a level: one piece a cell.
    fn isoline(&self, frame: &Frame, level: f64) -> String {
        let mut path = String::new();
        for cell in self.rows().flat_map(|row| self.cells(row)) {
            let crossings: Vec<(f64, f64)> = (0..4).filter_map(|k| crossing(cell[k], cell[(k + 1) % 4], level)).collect();
            for pair in crossings.chunks_exact(2) {
                let (a, b) = (frame.at(pair[0].0, pair[0].1), frame.at(pair[1].0, pair[1].1));
                let _ = write!(path, "M{:.1} {:.1}L{:.1} {:.1}", a.0, a.1, b.0, b.1);
            }
        }
        path
    }
}

/// A place and the value there.
type Corner = (f64, f64, f64);

/// The part of a cell that is not below zero, corner by corner.
fn cut(cell: &[Corner; 4]) -> Vec<(f64, f64)> {
    let edge = |k: usize| {
        let (a, b) = (cell[k], cell[(k + 1) % 4]);
        (a.2 >= 0.0).then_some((a.0, a.1)).into_iter().chain(crossing(a, b, 0.0))
    };
    (0..4).flat_map(edge).collect()
}

/// Adds a closed polygon; nothing for one without corners.
fn add_polygon(path: &mut String, frame: &Frame, corners: impl Iterator<Item = (f64, f64)>) {
    let before = path.len();
    for (x, y) in corners {
        let mark = if path.len() == before { 'M' } else { 'L' };
        let place = frame.at(x, y);
        let _ = write!(path, "{mark}{:.1} {:.1}", place.0, place.1);
    }
    if path.len() > before {
        path.push('z');
    }
}

/// Where a straight line between two corners passes a level.
fn crossing(a: Corner, b: Corner, level: f64) -> Option<(f64, f64)> {
    let share = (level - a.2) / (b.2 - a.2);
    ((a.2 < level) != (b.2 < level) && share.is_finite()).then_some((a.0 + share * (b.0 - a.0), a.1 + share * (b.1 - a.1)))
}

/// An upright bar of the colours to the right of a frame, the levels beside it.
pub fn draw_key(sheet: &mut Sheet, frame: &Frame, steps: &Steps, name: &str) {
    let (left, top) = (frame.corner.0 + frame.size.0 + 10.0, frame.corner.1);
    let count = steps.levels.len() + 1;
    let height = frame.size.1 / count as f64;
    for k in 0..count {
        let y = top + (count - 1 - k) as f64 * height;
        sheet.rectangle((left, y), (13.0, height + 0.3), steps.colour(k));
    }
    for (k, (_, text)) in steps.levels.iter().enumerate() {
        let y = top + (count - 1 - k) as f64 * height;
        sheet.path("axis", &format!("M{:.1} {y:.1}h4", left + 13.0));
        sheet.text((left + 19.0, y + 4.0), "tick", Anchor::Start, text);
    }
    sheet.text((left, top - 6.0), "small", Anchor::Start, name);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::drawing::frame::Upward;

    fn bowl() -> Heat {
        let places: Vec<f64> = (-10..=10).map(f64::from).collect();
        Heat::evaluate(places.clone(), places, |x, y| (x - 3.0).powi(2) + (y + 2.0).powi(2))
    }

    #[test]
    fn the_minimum_is_found_where_it_is() {
        assert_eq!(bowl().minimum(), (3.0, -2.0));
    }

    #[test]
    fn steps_are_round_and_their_colours_get_lighter() {
        let steps = Steps::over(&bowl().values, 8);
        assert!(steps.levels.len() >= 5, "{steps:?}");
        let light = |step: usize| steps.colour(step).iter().map(|&c| u32::from(c)).sum::<u32>();
        assert!((1..=steps.levels.len()).all(|k| light(k - 1) < light(k)), "{steps:?}");
        let flat = Steps::over(&[1.0, 1.0], 8);
        assert_eq!(flat.levels, []);
    }

    #[test]
    fn regions_are_the_cells_above_a_level() {
        let axis = Axis { low: 0.0, high: 2.0, log: false };
        let frame = Frame { corner: (0.0, 0.0), size: (2.0, 2.0), x: axis, y: axis, upward: Upward::Shrinks };
        let places = vec![0.0, 1.0, 2.0];
        let slope = Heat::evaluate(places.clone(), places, |x, _| x);
        assert_eq!(slope.region(&frame, |v| v - 1.5), "M1.5 0.0L2.0 0.0L2.0 1.0L1.5 1.0zM1.5 1.0L2.0 1.0L2.0 2.0L1.5 2.0z");
        assert_eq!(slope.region(&frame, |v| v), "M0.0 0.0L2.0 0.0L2.0 1.0L0.0 1.0zM0.0 1.0L2.0 1.0L2.0 2.0L0.0 2.0z");
        assert_eq!(slope.region(&frame, |v| v - 9.0), "");
    }

    #[test]
    fn isolines_run_where_the_value_is() {
        let axis = Axis { low: -10.0, high: 10.0, log: false };
        let frame = Frame { corner: (0.0, 0.0), size: (20.0, 20.0), x: axis, y: axis, upward: Upward::Grows };
        let path = bowl().isoline(&frame, 16.0);
        let mut points = 0;
        for piece in path.split(['M', 'L']).filter(|p| !p.is_empty()) {
            let (x, y) = piece.split_once(' ').unwrap();
            let (x, y): (f64, f64) = (x.parse().unwrap(), y.parse().unwrap());
            let radius = (x - 13.0).hypot(y - 12.0);
            assert!((radius - 4.0).abs() < 0.2, "{radius}");
            points += 1;
        }
        assert!(points > 20);
    }
}
