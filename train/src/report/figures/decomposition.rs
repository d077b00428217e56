//! A flow taken apart: rotation and one translation removed, as printed and in the target's frame.

use dimode_geometry::alignment::{self, Aligned, Convention, Match};
use dimode_geometry::flow::{rotational::rotational_flow, tangential::focal_scaled, translational::focus_of_expansion};
use dimode_geometry::loss_forms::{axial, planar};
use dimode_geometry::motion::tangential_part;
use dimode_geometry::scenes::{self, Reference};
use dimode_geometry::{Intrinsics, so3};
use nalgebra::{Matrix3, Vector2, Vector3};

use super::Figure;
use crate::report::colour::{Rgb, Scale};
use crate::report::drawing::arrows::{
    Arrow, colour_of_direction, draw_direction_key, draw_field, draw_length_key, magnification,
};
use crate::report::drawing::frame::Frame;
use crate::report::drawing::sheet::{Anchor, Sheet};

const EXACT: &str = "\
Hand-held motion in a room (3.5 deg, 11 cm), exact flow, exact depth, exact motion. Without rotation a pure translation is left. \
Aligned in the target's frame (t' = R^T t) the planar flow is parallel and the axial flow lies on the radii through p0 (L29). The printed \
alignment subtracts parts of t where parts of t' are due (L28): its planar flow stays almost parallel with another length and \
direction, its axial flow is radial about a focus (ring) beside p0 (cross), by about the angle of the rotation times the focal length.";

const ERRORS: &str = "\
The same flow, aligned with an estimate that is wrong by 0.25 deg of yaw and 10 % of t_z. Both conventions now leave directions \
that vary over the image: this is what L_pla and L_axi measure (L24, L34). With the printed alignment the error of the \
estimate and the error of the equation mix.";

/// Deviations from the expected direction that get the last colour, degrees.
const FULL: f64 = 20.0;

/// Distance between neighbouring arrows, pixels.
const SPACING: f64 = 2.0 * scenes::STEP as f64;

/// What is known or assumed about the motion, for one convention.
struct Estimate {
    rotation: Matrix3<f64>,
    /// The translation whose parts are removed.
    translation: Vector3<f64>,
}

/// The true motion, changed by a yaw (radians, applied in the target) and by a share of `t_z`.
fn estimate(reference: &Reference, convention: Convention, yaw: f64, share: f64) -> Estimate {
    let rotation = reference.motion.rotation * so3::exp(&Vector3::new(0.0, yaw, 0.0));
    let mut translation = convention.translation(&reference.motion);
    translation.z *= 1.0 + share;
    Estimate { rotation, translation }
}

type Align = fn(&Intrinsics, &Matrix3<f64>, &Vector3<f64>, &Match) -> Option<Aligned>;

/// Exact matches of every second pixel of the grid, both ways.
fn matches(reference: &Reference) -> Vec<Match> {
    let columns = reference.scene.grid[0];
    let all = reference.scene.matches(&reference.motion).into_iter().enumerate();
    let chosen = |i: usize| (i / columns).is_multiple_of(2) && (i % columns).is_multiple_of(2);
    all.filter(|(i, _)| chosen(*i)).map(|(_, m)| m).collect()
}

/// Aligned flows.
fn aligned(reference: &Reference, matches: &[Match], estimate: &Estimate, align: Align) -> Vec<Arrow> {
    let camera = &reference.scene.camera;
    let arrow = |m: &Match| Some(Arrow { at: m.target, flow: align(camera, &estimate.rotation, &estimate.translation, m)?.flow });
    matches.iter().filter_map(arrow).collect()
}

/// What is left of the flow behind the rotated pixel `p_R`, drawn there.
fn without_rotation(reference: &Reference, rotation: &Matrix3<f64>) -> Vec<Arrow> {
    let arrow = |m: &Match| {
        let at = m.target + rotational_flow(&reference.scene.camera, rotation, &m.target)?;
        Some(Arrow { at, flow: m.source - at })
    };
    matches(reference).iter().filter_map(arrow).collect()
}

fn whole(reference: &Reference) -> Vec<Arrow> {
    matches(reference).iter().map(|m| Arrow { at: m.target, flow: m.source - m.target }).collect()
}

/// Angle between two directions, degrees.
fn deviation(a: &Vector2<f64>, b: &Vector2<f64>) -> f64 {
    a.perp(b).abs().atan2(a.dot(b)).to_degrees()
}

fn colour_of_deviation(degrees: f64) -> Rgb {
    Scale::Ember.at(0.1 + 0.68 * (degrees / FULL).min(1.0))
}

/// Focus of the printed axial flow with exact inputs: that of the translation `t' - tan(t)`, which the alignment leaves.
fn printed_focus(reference: &Reference) -> Option<Vector2<f64>> {
    let left = reference.motion.translation_in_from_frame() - tangential_part(&reference.motion.translation);
    focus_of_expansion(&reference.scene.camera, &left)
}

pub(super) fn exact() -> Figure {
    let svg = draw("A flow taken apart, all inputs exact", [0.0, 0.0]);
    Figure { name: "decomposition-exact", title: "Decomposition with exact inputs", caption: EXACT, svg }
}

pub(super) fn with_errors() -> Figure {
    let svg = draw("A flow taken apart, yaw wrong by 0.25 deg and t_z by 10 %", [0.25f64.to_radians(), 0.1]);
    Figure { name: "decomposition-with-errors", title: "Decomposition with a wrong motion", caption: ERRORS, svg }
}

/// Three rows of two fields.
fn draw(title: &str, [yaw, share]: [f64; 2]) -> String {
    let reference = scenes::handheld();
    let mut sheet = Sheet::new(title, 960.0, 1050.0);
    let place = |row: usize, column: usize| (68.0 + 474.0 * column as f64, 112.0 + 310.0 * row as f64);
    let size = (reference.scene.camera.width, reference.scene.camera.height);
    let frame = |row, column| Frame::of_image(place(row, column), 404.0, size);
    let exact = yaw == 0.0 && share == 0.0;
    draw_keys(&mut sheet, exact);
    let consistent = estimate(&reference, Convention::Consistent, yaw, share);
    let turned = without_rotation(&reference, &consistent.rotation);
    for (column, arrows) in [whole(&reference), turned].iter().enumerate() {
        let (title, remark) = [
            ("Full flow", "p_s - p: rotation, tangential and radial translation"),
            (
                "Rotation removed",
                if exact { "p_s - p_R at p_R: a translation is left" } else { "p_s - p_R at p_R, with the estimate" },
            ),
        ][column];
        let times = magnification(arrows.iter(), SPACING);
        let field = Panel { title, remark, arrows, times, focus: None };
        field.draw(&mut sheet, &frame(0, column), &reference, &colour_of_direction);
    }
    for (column, convention) in [Convention::Consistent, Convention::AsPrinted].into_iter().enumerate() {
        let estimate = estimate(&reference, convention, yaw, share);
        draw_planar(&mut sheet, &frame(1, column), &reference, &estimate, convention);
        draw_axial(&mut sheet, &frame(2, column), &reference, &estimate, convention, exact);
    }
    sheet.to_svg()
}

/// Above the first row: directions; for the other rows: deviations.
fn draw_keys(sheet: &mut Sheet, focus: bool) {
    sheet.cross((24.0, 46.0), 4.0);
    sheet.text((36.0, 50.0), "note", Anchor::Start, "p0");
    if focus {
        sheet.ring((78.0, 46.0), 6.0);
        sheet.text((90.0, 50.0), "note", Anchor::Start, "focus");
    }
    sheet.text((150.0, 50.0), "note", Anchor::Start, "first row: direction");
    draw_direction_key(sheet, (304.0, 50.0), 17.0);
    let (left, width, steps) = (744.0, 160.0, 32);
    sheet.text((left - 10.0, 50.0), "note", Anchor::End, "other rows: angle to the expected direction [deg]");
    for k in 0..steps {
        let step = width / f64::from(steps);
        let colour = colour_of_deviation(FULL * (f64::from(k) + 0.5) / f64::from(steps));
        sheet.rectangle((left + f64::from(k) * step, 42.0), (step + 0.3, 11.0), colour);
    }
    for value in [0, 5, 10, 15, 20] {
        let x = left + width * f64::from(value) / FULL;
        let text = if value == 20 { "20+".to_owned() } else { value.to_string() };
        sheet.text((x, 66.0), "tick", Anchor::Middle, &text);
    }
}

/// One field of the figure.
struct Panel<'a> {
    title: &'a str,
    remark: &'a str,
    arrows: &'a [Arrow],
    times: f64,
    focus: Option<Vector2<f64>>,
}

impl Panel<'_> {
    fn draw(&self, sheet: &mut Sheet, frame: &Frame, reference: &Reference, colour: &dyn Fn(&Arrow) -> Rgb) {
        draw_field(sheet, frame, self.arrows, self.times, colour);
        let p0 = reference.scene.camera.principal_point();
        if let Some(focus) = self.focus {
            sheet.ring(frame.at(focus.x, focus.y), 6.0);
        }
        sheet.cross(frame.at(p0.x, p0.y), 4.0);
        frame.draw_title(sheet, self.title, self.remark);
        frame.draw_axes(sheet, ["u [px]", "v [px]"], [7, 6]);
        draw_length_key(sheet, (frame.corner.0 + frame.size.0, frame.corner.1 - 21.0), frame, self.times);
    }
}

fn named(convention: Convention) -> &'static str {
    match convention {
        Convention::AsPrinted => "as printed (t)",
        Convention::Consistent => "target's frame (t')",
    }
}

fn draw_planar(sheet: &mut Sheet, frame: &Frame, reference: &Reference, estimate: &Estimate, convention: Convention) {
    let arrows = aligned(reference, &matches(reference), estimate, alignment::planar);
    let all = aligned(reference, &reference.scene.matches(&reference.motion), estimate, alignment::planar);
    let flows: Vec<_> = all.iter().map(|a| a.flow).collect();
    let expected = focal_scaled(&reference.scene.camera, &reference.motion.translation_in_from_frame());
    let title = format!("Planar flow, {}", named(convention));
    let remark = format!("expected: one direction. L_pla (circular) = {} rad^2", short(planar::circular(&flows)));
    let times = magnification(arrows.iter(), SPACING);
    let panel = Panel { title: &title, remark: &remark, arrows: &arrows, times, focus: None };
    panel.draw(sheet, frame, reference, &|a| colour_of_deviation(deviation(&a.flow, &expected)));
}

fn draw_axial(sheet: &mut Sheet, frame: &Frame, reference: &Reference, estimate: &Estimate, convention: Convention, exact: bool) {
    let arrows = aligned(reference, &matches(reference), estimate, alignment::axial);
    let all = aligned(reference, &reference.scene.matches(&reference.motion), estimate, alignment::axial);
    let (p0, sign) = (reference.scene.camera.principal_point(), -estimate.translation.z.signum());
    let flows: Vec<_> = all.iter().map(|a| a.flow).collect();
    let d: Vec<_> = all.iter().map(|a| a.at - p0).collect();
    let title = format!("Axial flow, {}", named(convention));
    let angle = axial::pose_sign(&flows, &d, estimate.translation.z).to_degrees();
    let focus = (exact && convention == Convention::AsPrinted).then(|| printed_focus(reference)).flatten();
    let away = focus.map_or_else(String::new, |e| format!(", focus {:.0} px from p0", (e - p0).norm()));
    let remark = format!("expected: away from p0. L_axi = {} deg{away}", short(angle));
    let times = magnification(arrows.iter(), SPACING);
    let panel = Panel { title: &title, remark: &remark, arrows: &arrows, times, focus };
    panel.draw(sheet, frame, reference, &|a| colour_of_deviation(deviation(&a.flow, &((a.at - p0) * sign))));
}

/// Two significant digits; rounding errors are 0.
fn short(value: f64) -> String {
    match value.abs() {
        size if size < 1e-9 => "0".to_owned(),
        size if size < 1e-2 => format!("{value:.1e}"),
        size => format!("{value:.*}", if size < 1.0 { 3 } else { 1 }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(convention: Convention, errors: [f64; 2], align: Align) -> Vec<Arrow> {
        let reference = scenes::handheld();
        let all = reference.scene.matches(&reference.motion);
        aligned(&reference, &all, &estimate(&reference, convention, errors[0], errors[1]), align)
    }

    #[test]
    fn exact_flows_in_the_target_frame_are_parallel_and_radial() {
        let reference = scenes::handheld();
        let (camera, in_target) = (&reference.scene.camera, reference.motion.translation_in_from_frame());
        let along = focal_scaled(camera, &in_target);
        for arrow in of(Convention::Consistent, [0.0; 2], alignment::planar) {
            assert!(deviation(&arrow.flow, &along) < 1e-9);
        }
        for arrow in of(Convention::Consistent, [0.0; 2], alignment::axial) {
            assert!(deviation(&arrow.flow, &(arrow.at - camera.principal_point())) < 1e-9);
        }
    }

    #[test]
    fn the_printed_axial_flow_leaves_a_focus_beside_the_principal_point() {
        let reference = scenes::handheld();
        let focus = printed_focus(&reference).unwrap();
        assert!((focus - reference.scene.camera.principal_point()).norm() > 20.0);
        for arrow in of(Convention::AsPrinted, [0.0; 2], alignment::axial) {
            assert!(deviation(&arrow.flow, &(arrow.at - focus)) < 1e-9);
        }
    }

    #[test]
    fn wrong_estimates_bend_both_flows() {
        let (exact, wrong) = ([0.0; 2], [0.25f64.to_radians(), 0.1]);
        let spread = |errors| {
            let flows: Vec<_> = of(Convention::Consistent, errors, alignment::planar).iter().map(|a| a.flow).collect();
            planar::circular(&flows)
        };
        assert!(spread(exact) < 1e-12 && spread(wrong) > 1e-3);
    }

    #[test]
    fn a_translation_is_left_without_the_rotation() {
        let reference = scenes::handheld();
        let focus = focus_of_expansion(&reference.scene.camera, &reference.motion.translation).unwrap();
        for arrow in without_rotation(&reference, &reference.motion.rotation) {
            assert!(deviation(&arrow.flow, &(arrow.at - focus)) < 1e-9);
        }
    }
}
