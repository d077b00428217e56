//! The two losses of direction around the truth, as printed and corrected.

use dimode_geometry::alignment::{self, Convention, Match};
use dimode_geometry::loss_forms::{axial, planar};
use dimode_geometry::scenes::{self, Reference};
use dimode_geometry::so3;
use nalgebra::{Vector2, Vector3};

use super::Figure;
use crate::report::drawing::frame::{Frame, Upward};
use crate::report::drawing::heat::{Heat, Steps, draw_key};
use crate::report::drawing::sheet::{Anchor, Sheet};
use crate::report::scale::Axis;

const AXIAL: &str = "\
L_axi with exact flow and depth, over an error of yaw and an error of t_x. Left as printed (angle to the radius, parts of t removed), \
right corrected (sign of t_z, parts of t' = R^T t removed). For the source ahead both have a valley, but the printed one lies beside \
the truth (L28). For a source behind, as in the second and in the last row (t'_z > 0), the printed loss is largest there, near pi rad: \
descent leads away from the truth (L41, L43). The valley is long because yaw and t_x are hard to tell apart (L48).";

const PLANAR: &str = "\
Root of L_pla with exact flow and depth, over an error of yaw and a relative error of t_z. Left as printed (variance of the folded angle, parts \
of t removed), right corrected (circular variance, parts of t' = R^T t removed). In the hand-held and the lateral motion the printed \
minimum lies beside the truth (L28); in driving, where the tangential flow is short, a tenth of a degree spends all of the loss, \
and folding the angle makes it weaker where flow is horizontal (L37).";

/// Which loss.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Loss {
    /// L_pla over yaw and the share of `t_z` by which it is wrong.
    Planar,
    /// L_axi over yaw and the error of `t_x` in metres.
    Axial,
}

/// Loss and alignment together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Form {
    /// Eqs. `lp`, `la` and `pplanar` as they are printed.
    Printed,
    /// Circular or with the sign of `t_z`, and parts of `t'`.
    Corrected,
}

/// A loss of one motion as a function of the errors of the estimate.
pub(super) struct Landscape {
    pub loss: Loss,
    pub form: Form,
    reference: Reference,
    matches: Vec<Match>,
    offsets: Vec<Vector2<f64>>,
}

impl Landscape {
    pub fn new(loss: Loss, form: Form, reference: Reference) -> Self {
        let (matches, offsets) = (reference.scene.matches(&reference.motion), reference.scene.offsets());
        Self { loss, form, reference, matches, offsets }
    }

    /// The loss where yaw is wrong by so many degrees and the translation by so much (see [`Loss`]); NaN where a point comes
    /// behind the camera.
    pub fn at(&self, yaw_deg: f64, error: f64) -> f64 {
        let convention = match self.form {
            Form::Printed => Convention::AsPrinted,
            Form::Corrected => Convention::Consistent,
        };
        let rotation = self.reference.motion.rotation * so3::exp(&Vector3::new(0.0, yaw_deg.to_radians(), 0.0));
        let mut a = convention.translation(&self.reference.motion);
        match self.loss {
            Loss::Planar => a.z *= 1.0 + error,
            Loss::Axial => a.x += error,
        }
        let align = match self.loss {
            Loss::Planar => alignment::planar,
            Loss::Axial => alignment::axial,
        };
        let flow = |m: &Match| Some(align(&self.reference.scene.camera, &rotation, &a, m)?.flow);
        let flows: Option<Vec<_>> = self.matches.iter().map(flow).collect();
        flows.map_or(f64::NAN, |flows| self.value(&flows, a.z))
    }

    fn value(&self, flows: &[Vector2<f64>], a_z: f64) -> f64 {
        match (self.loss, self.form) {
            (Loss::Planar, Form::Printed) => planar::printed(flows),
            (Loss::Planar, Form::Corrected) => planar::circular(flows),
            (Loss::Axial, Form::Printed) => axial::printed(flows, &self.offsets),
            (Loss::Axial, Form::Corrected) => axial::pose_sign(flows, &self.offsets, a_z),
        }
    }

    /// Values on a square grid over `[-1, 1]` times the two ranges, the truth in the middle.
    fn around_truth(&self, [yaw_deg, error]: [f64; 2], steps: i32) -> Heat {
        let places = |range: f64| (-steps..=steps).map(|i| range * f64::from(i) / f64::from(steps)).collect();
        Heat::evaluate(places(yaw_deg), places(error), |yaw, error| self.at(yaw, error))
    }
}

/// A motion with half the ranges of its panels.
struct Row {
    name: &'static str,
    reference: fn() -> Reference,
    /// Degrees of yaw; relative error of `t_z` (L_pla) or metres of `t_x` (L_axi).
    ranges: [f64; 2],
}

const AXIAL_ROWS: [Row; 4] = [
    Row { name: "Driving, source ahead", reference: scenes::drive_next, ranges: [0.1, 0.03] },
    Row { name: "Driving, source behind", reference: scenes::drive_prev, ranges: [0.1, 0.03] },
    Row { name: "Hand-held", reference: scenes::handheld, ranges: [0.25, 0.015] },
    Row { name: "Lateral", reference: scenes::lateral, ranges: [0.05, 0.002] },
];

const PLANAR_ROWS: [Row; 4] = [
    Row { name: "Driving, source ahead", reference: scenes::drive_next, ranges: [0.1, 0.05] },
    Row { name: "Driving, source behind", reference: scenes::drive_prev, ranges: [0.1, 0.05] },
    Row { name: "Hand-held", reference: scenes::handheld, ranges: [0.5, 0.15] },
    Row { name: "Lateral", reference: scenes::lateral, ranges: [0.5, 0.3] },
];

/// Half the number of grid steps of a panel.
const STEPS: i32 = 24;

pub(super) fn axial() -> Figure {
    let svg = draw("L_axi around the truth", Loss::Axial, &AXIAL_ROWS);
    Figure { name: "landscape-axial", title: "Loss landscape of L_axi", caption: AXIAL, svg }
}

pub(super) fn planar() -> Figure {
    let svg = draw("L_pla around the truth", Loss::Planar, &PLANAR_ROWS);
    Figure { name: "landscape-planar", title: "Loss landscape of L_pla", caption: PLANAR, svg }
}

fn draw(title: &str, loss: Loss, rows: &[Row; 4]) -> String {
    let mut sheet = Sheet::new(title, 960.0, 1290.0);
    sheet.cross((24.0, 46.0), 5.0);
    sheet.text((36.0, 50.0), "note", Anchor::Start, "the truth");
    sheet.ring((124.0, 46.0), 7.0);
    let remark = "smallest value of the panel. Lines and colours: equal steps of what the key names, dark is small.";
    sheet.text((138.0, 50.0), "note", Anchor::Start, remark);
    for (i, row) in rows.iter().enumerate() {
        for (j, form) in [Form::Printed, Form::Corrected].into_iter().enumerate() {
            let corner = (70.0 + 470.0 * j as f64, 108.0 + 302.0 * i as f64);
            let axis = |range: f64| Axis { low: -range, high: range, log: false };
            let [x, y] = row.ranges.map(axis);
            let frame = Frame { corner, size: (310.0, 220.0), x, y, upward: Upward::Grows };
            draw_panel(&mut sheet, &frame, row, &Landscape::new(loss, form, (row.reference)()));
        }
    }
    sheet.to_svg()
}

fn draw_panel(sheet: &mut Sheet, frame: &Frame, row: &Row, landscape: &Landscape) {
    let mut heat = landscape.around_truth(row.ranges, STEPS);
    let (yaw, error) = heat.minimum();
    if landscape.loss == Loss::Planar {
        // The root has the same minimum, and steps that show it.
        heat.values.iter_mut().for_each(|value| *value = value.max(0.0).sqrt());
    }
    let steps = Steps::over(&heat.values, 12);
    heat.draw(sheet, frame, &steps);
    sheet.ring(frame.at(yaw, error), 7.0);
    sheet.cross(frame.at(0.0, 0.0), 5.0);
    let at_truth = landscape.at(0.0, 0.0);
    let form = match landscape.form {
        Form::Printed => "as printed",
        Form::Corrected => "corrected",
    };
    let (shown, unit, error_name) = match landscape.loss {
        Loss::Axial => ("L_axi [rad]", "rad", "error of t_x [m]"),
        Loss::Planar => ("root L_pla [rad]", "rad^2", "relative error of t_z"),
    };
    let at_border = yaw.abs() >= row.ranges[0] || error.abs() >= row.ranges[1];
    let smallest = format!("smallest {} {unit}{}", short(landscape.at(yaw, error)), if at_border { " (border)" } else { "" });
    let remark = format!("at the truth {} {unit}, {smallest}", short(at_truth));
    frame.draw_title(sheet, &format!("{}, {form}", row.name), &remark);
    frame.draw_axes(sheet, ["error of yaw [deg]", error_name], [6, 6]);
    draw_key(sheet, frame, &steps, shown);
}

/// Three significant digits; rounding errors are 0.
fn short(value: f64) -> String {
    match value.abs() {
        size if size < 1e-9 => "0".to_owned(),
        size if size < 1e-2 => format!("{value:.2e}"),
        _ => format!("{value:.3}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn all_of(loss: Loss, form: Form, rows: &'static [Row; 4]) -> impl Iterator<Item = (&'static Row, Landscape, Heat)> {
        rows.iter().map(move |row| {
            let landscape = Landscape::new(loss, form, (row.reference)());
            let heat = landscape.around_truth(row.ranges, 10);
            (row, landscape, heat)
        })
    }

    #[test]
    fn corrected_losses_are_smallest_at_the_truth() {
        for (loss, rows) in [(Loss::Axial, &AXIAL_ROWS), (Loss::Planar, &PLANAR_ROWS)] {
            for (row, landscape, heat) in all_of(loss, Form::Corrected, rows) {
                assert_eq!(heat.minimum(), (0.0, 0.0), "{} {loss:?}", row.name);
                assert!(landscape.at(0.0, 0.0).abs() < 1e-9, "{} {loss:?}", row.name);
            }
        }
    }

    #[test]
    fn printed_losses_have_the_documented_values_at_the_truth() {
        let printed = |reference| Landscape::new(Loss::Axial, Form::Printed, reference).at(0.0, 0.0);
        let consistent = |reference| Landscape::new(Loss::Axial, Form::Corrected, reference).at(0.0, 0.0);
        assert!((printed(scenes::handheld()) - 0.136647301837).abs() < 1e-10);
        assert!((std::f64::consts::PI - printed(scenes::drive_prev()) - 0.00691517220908).abs() < 1e-10);
        assert!(consistent(scenes::drive_prev()) < 1e-12);
    }

    #[test]
    fn the_printed_axial_loss_of_a_source_behind_is_largest_near_the_truth() {
        let mut rows = all_of(Loss::Axial, Form::Printed, &AXIAL_ROWS);
        let (_, landscape, heat) = rows.nth(1).unwrap();
        let upside_down = Heat { values: heat.values.iter().map(|v| -v).collect(), ..heat.clone() };
        let (yaw, error) = upside_down.minimum();
        assert!(yaw.abs() < 0.05 && error.abs() < 0.01, "{yaw} {error}");
        assert!(landscape.at(yaw, error) > 3.1);
        let (yaw, error) = heat.minimum();
        assert!(yaw.abs() > 0.09 || error.abs() > 0.029, "the smallest value lies at the border: {yaw} {error}");
    }

    #[test]
    fn the_printed_alignment_moves_the_minimum() {
        for (loss, rows, k) in [(Loss::Axial, &AXIAL_ROWS, 0), (Loss::Axial, &AXIAL_ROWS, 2), (Loss::Planar, &PLANAR_ROWS, 2)] {
            let (row, landscape, heat) = all_of(loss, Form::Printed, rows).nth(k).unwrap();
            let (yaw, error) = heat.minimum();
            assert_ne!((yaw, error), (0.0, 0.0), "{} {loss:?}", row.name);
            assert!(landscape.at(yaw, error) < 0.9 * landscape.at(0.0, 0.0), "{} {loss:?}", row.name);
        }
    }
}
