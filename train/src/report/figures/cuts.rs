//! The losses of direction along one error each, printed and corrected form in one chart.

use dimode_geometry::scenes::{self, Reference};

use super::Figure;
use super::landscapes::{Form, Landscape, Loss};
use crate::report::drawing::sheet::{Anchor, Sheet};
use crate::report::svg::{Chart, Mark, Series, Stroke};

const CAPTION: &str = "\
The losses along one error, everything else exact. Left: L_axi over an error of t_x. For the source behind the printed loss has its \
maximum at the truth and falls with any error (L41, L43); the corrected one has the same valley for both sources. Right: L_pla \
over a relative error of t_z. Where the printed curve does not touch zero at zero error, the printed alignment is to blame (L28).";

/// Points of a line.
const POINTS: i32 = 200;

/// A motion with half the ranges of its charts.
struct Row {
    name: &'static str,
    reference: fn() -> Reference,
    /// Metres of `t_x`; share of `t_z`.
    ranges: [f64; 2],
}

const ROWS: [Row; 4] = [
    Row { name: "Driving, source ahead", reference: scenes::drive_next, ranges: [0.5, 0.2] },
    Row { name: "Driving, source behind", reference: scenes::drive_prev, ranges: [0.5, 0.2] },
    Row { name: "Hand-held", reference: scenes::handheld, ranges: [0.03, 0.3] },
    Row { name: "Lateral", reference: scenes::lateral, ranges: [0.004, 0.5] },
];

fn line(landscape: &Landscape, range: f64) -> Vec<(f64, f64)> {
    let at = |i: i32| range * f64::from(i) / f64::from(POINTS);
    (-POINTS..=POINTS).map(|i| (at(i), landscape.at(0.0, at(i)))).collect()
}

fn chart(name: &str, reference: &Reference, loss: Loss, range: f64) -> Chart {
    let [x, y] = match loss {
        Loss::Axial => ["error of t_x [m]", "L_axi [rad]"],
        Loss::Planar => ["relative error of t_z", "L_pla [rad^2]"],
    };
    let mut chart = Chart::new(name, x, y);
    for (form, name, colour, stroke) in
        [(Form::Corrected, "corrected", 0, Stroke::Strong), (Form::Printed, "as printed", 1, Stroke::Dashed)]
    {
        let points = line(&Landscape::new(loss, form, reference.clone()), range);
        chart.series.push(Series { name: name.to_owned(), colour, stroke, points });
    }
    chart.marks.push(Mark { x: 0.0, label: "truth".to_owned() });
    chart.size = (460.0, 230.0);
    chart
}

pub(super) fn figure() -> Figure {
    let mut sheet = Sheet::new("L_axi and L_pla along one error", 960.0, 1150.0);
    for (x, class, name) in [(14.0, "line c0 strong", "corrected"), (140.0, "line c1 dashed", "as printed")] {
        sheet.path(class, &format!("M{x} 46h30"));
        sheet.text((x + 38.0, 50.0), "note", Anchor::Start, name);
    }
    for (i, Row { name, reference, ranges }) in ROWS.iter().enumerate() {
        for (j, loss) in [Loss::Axial, Loss::Planar].into_iter().enumerate() {
            let (left, top) = (10.0 + 475.0 * j as f64, 90.0 + 265.0 * i as f64);
            sheet.text((left + 54.0, top), "title", Anchor::Start, name);
            let content = chart(name, &reference(), loss, ranges[j]).content();
            sheet.raw(&format!("<g transform=\"translate({left} {})\">{content}</g>", top + 8.0));
        }
    }
    let title = "Cuts through the landscapes";
    Figure { name: "loss-cuts", title, caption: CAPTION, svg: sheet.to_svg() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_printed_axial_loss_of_a_source_behind_falls_away_from_the_truth() {
        let of = |form, reference: fn() -> Reference| line(&Landscape::new(Loss::Axial, form, reference()), 0.5);
        let middle = POINTS as usize;
        let printed = of(Form::Printed, scenes::drive_prev);
        assert!(printed[middle].1 > 3.1 && printed[0].1 < 2.5 && printed[2 * middle].1 < 2.5);
        let corrected = of(Form::Corrected, scenes::drive_prev);
        assert!(corrected[middle].1 < 1e-9 && corrected[0].1 > 0.5 && corrected[2 * middle].1 > 0.5);
    }
}
