//! The flow that each part of a motion draws on the image of the street scene.

use dimode_geometry::flow::{radial::radial_flow, rigid::rigid_flow, rotational::rotational_flow, tangential::tangential_flow};
use dimode_geometry::scenes::{self, Scene};
use dimode_geometry::{Se3, so3};
use nalgebra::{Vector2, Vector3};

use super::Figure;
use crate::report::drawing::arrows::{
    Arrow, colour_of_direction, draw_direction_key, draw_field, draw_length_key, magnification,
};
use crate::report::drawing::frame::Frame;
use crate::report::drawing::sheet::{Anchor, Sheet};
use crate::report::picture::depth_colour;
use crate::report::scale::Axis;

const CAPTION: &str = "\
Road scene, camera of 640x192 pixels, f = 371.2 and 368.6 px, cross at the principal point p0. Rotations draw flows that do not \
depend on depth: those of yaw and pitch are bent, that of roll turns (L08, L10, L11). A translation parallel to the image draws \
parallel arrows, longer where the scene is near (L14). A translation along the axis draws arrows on the radii through p0, away from it \
when the source camera stands ahead (t_z < 0), toward it when it stands behind (L15). All at once have no common law, which is \
why the parts are treated apart.";

/// Distance between neighbouring arrows, pixels.
const SPACING: f64 = 2.0 * scenes::STEP as f64;
/// Lengths in distances between arrows: of rotations, whose arrows are almost equally long, and of the others, whose near ones are
/// much longer than the far ones.
const LENGTHS: [f64; 2] = [0.95, 1.5];

/// One field with what it shows.
pub(super) struct Field {
    /// What moves.
    pub title: &'static str,
    /// The motion in numbers.
    pub motion: &'static str,
    /// Whether it is a rotation alone.
    rotation: bool,
    /// Flow at a part of the scene's pixels.
    pub arrows: Vec<Arrow>,
}

/// Every second pixel of the grid, both ways.
fn chosen(scene: &Scene) -> impl Iterator<Item = (Vector2<f64>, f64)> + '_ {
    let columns = scene.grid[0];
    let of_grid = move |i: usize| (i / columns).is_multiple_of(2) && (i % columns).is_multiple_of(2);
    (0..scene.pixels.len()).filter(move |&i| of_grid(i)).map(|i| (scene.pixels[i], scene.depths[i]))
}

fn field(
    title: &'static str,
    motion: &'static str,
    scene: &Scene,
    flow: impl Fn(&Vector2<f64>, f64) -> Option<Vector2<f64>>,
) -> Field {
    let arrow = |(at, z): (Vector2<f64>, f64)| Some(Arrow { at, flow: flow(&at, z)? });
    let rotation = motion.starts_with("rotation");
    Field { title, motion, rotation, arrows: chosen(scene).filter_map(arrow).collect() }
}

/// The seven fields, in the order of the figure.
pub(super) fn fields(scene: &Scene) -> [Field; 7] {
    let camera = &scene.camera;
    let degrees = |x: f64, y: f64, z: f64| Vector3::new(x, y, z).map(f64::to_radians);
    let rotation = |w: Vector3<f64>| {
        let rotation = so3::exp(&w);
        move |p: &Vector2<f64>, _: f64| rotational_flow(camera, &rotation, p)
    };
    let mixture = Se3::from_rotation_vector(&degrees(0.3, -0.6, 1.0), Vector3::new(0.25, -0.1, -0.8));
    [
        field("Yaw", "rotation about y by 1 deg: bent, free of depth", scene, rotation(degrees(0.0, 1.0, 0.0))),
        field("Pitch", "rotation about x by 1 deg: bent, free of depth", scene, rotation(degrees(1.0, 0.0, 0.0))),
        field("Roll", "rotation about z by 4 deg: turns, free of depth", scene, rotation(degrees(0.0, 0.0, 4.0))),
        field("Tangential", "t = (0.4, -0.15, 0) m: parallel, longer where near", scene, |_, z| {
            Some(tangential_flow(camera, &Vector3::new(0.4, -0.15, 0.0), z))
        }),
        field("Radial, source ahead", "t_z = -0.8 m: away from p0", scene, |p, z| radial_flow(camera, -0.8, p, z)),
        field("Radial, source behind", "t_z = 0.8 m: toward p0", scene, |p, z| radial_flow(camera, 0.8, p, z)),
        field("All at once", "w = (0.3, -0.6, 1.0) deg, t = (0.25, -0.1, -0.8) m: no common law", scene, |p, z| {
            Some(rigid_flow(camera, &mixture, p, z)?.0)
        }),
    ]
}

pub(super) fn figure() -> Figure {
    let scene = scenes::road();
    let mut sheet = Sheet::new("What each part of a motion draws on the image", 960.0, 880.0);
    sheet.cross((24.0, 46.0), 4.0);
    sheet.text(
        (36.0, 50.0),
        "note",
        Anchor::Start,
        "principal point p0. Flow from target to source, the colour is its direction:",
    );
    draw_direction_key(&mut sheet, (506.0, 42.0), 22.0);
    let place = |k: usize| (68.0 + 474.0 * (k % 2) as f64, 112.0 + 198.0 * (k / 2) as f64);
    let frame = |k: usize| Frame::of_image(place(k), 404.0, (scene.camera.width, scene.camera.height));
    for (k, field) in fields(&scene).iter().enumerate() {
        draw_panel(&mut sheet, &frame(k), field, scene.camera.principal_point());
    }
    draw_depth(&mut sheet, &frame(7), &scene);
    let title = "Flow fields of the parts of a motion";
    Figure { name: "flow-fields", title, caption: CAPTION, svg: sheet.to_svg() }
}

/// One field with axes and keys.
fn draw_panel(sheet: &mut Sheet, frame: &Frame, field: &Field, p0: Vector2<f64>) {
    let times = magnification(field.arrows.iter(), LENGTHS[usize::from(!field.rotation)] * SPACING);
    draw_field(sheet, frame, &field.arrows, times, colour_of_direction);
    sheet.cross(frame.at(p0.x, p0.y), 4.0);
    frame.draw_title(sheet, field.title, field.motion);
    frame.draw_axes(sheet, ["u [px]", "v [px]"], [7, 4]);
    draw_length_key(sheet, (frame.corner.0 + frame.size.0, frame.corner.1 - 21.0), frame, times);
}

/// Depth of the scene as coloured cells with a bar below the title.
fn draw_depth(sheet: &mut Sheet, frame: &Frame, scene: &Scene) {
    let (near, far) = (3.5, 60.0);
    let half = 0.5 * scenes::STEP as f64;
    sheet.cut_to(frame.corner, frame.size, |sheet| {
        for (p, &z) in scene.pixels.iter().zip(&scene.depths) {
            let (a, b) = (frame.at(p.x - half, p.y - half), frame.at(p.x + half, p.y + half));
            sheet.rectangle(a, (b.0 - a.0 + 0.3, b.1 - a.1 + 0.3), depth_colour(z, near, far));
        }
    });
    frame.draw_title(sheet, "Depth of the scene", "metres, logarithmic, near is bright");
    frame.draw_axes(sheet, ["u [px]", "v [px]"], [7, 4]);
    draw_depth_key(sheet, (frame.corner.0 + frame.size.0 - 190.0, frame.corner.1 - 30.0), (near, far));
}

fn draw_depth_key(sheet: &mut Sheet, (left, top): (f64, f64), (near, far): (f64, f64)) {
    const STEPS: usize = 38;
    let (width, height) = (190.0, 10.0);
    for k in 0..STEPS {
        let share = (k as f64 + 0.5) / STEPS as f64;
        let step = width / STEPS as f64;
        let colour = depth_colour(near * (far / near).powf(share), near, far);
        sheet.rectangle((left + k as f64 * step, top), (step + 0.3, height), colour);
    }
    let axis = Axis { low: near, high: far, log: true };
    for (value, text) in axis.ticks(5) {
        let x = left + width * axis.position(value).unwrap_or(0.0);
        sheet.path("axis", &format!("M{x:.1} {:.1}v3", top + height));
        sheet.text((x, top + height + 13.0), "tick", Anchor::Middle, &text);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn named<'a>(fields: &'a [Field; 7], start: &str) -> Vec<&'a Field> {
        fields.iter().filter(|f| f.title.starts_with(start)).collect()
    }

    #[test]
    fn radial_arrows_lie_on_the_radii() {
        let scene = scenes::road();
        let (p0, fields) = (scene.camera.principal_point(), fields(&scene));
        for (field, sign) in named(&fields, "Radial").into_iter().zip([1.0, -1.0]) {
            assert_eq!(field.arrows.len(), 120);
            for Arrow { at, flow } in &field.arrows {
                let d = at - p0;
                assert!(flow.perp(&d).abs() < 1e-10 * flow.norm() * d.norm(), "{}", field.title);
                assert!(sign * flow.dot(&d) > 0.0, "{}", field.title);
            }
        }
    }

    #[test]
    fn tangential_arrows_are_parallel_and_rotations_know_no_depth() {
        let scene = scenes::road();
        let near = scene.at_depth(2.0);
        let (here, there) = (fields(&scene), fields(&near));
        let first = here[3].arrows[0].flow;
        let parallel = |a: &Arrow| a.flow.perp(&first).abs() < 1e-12 * a.flow.norm() * first.norm() && a.flow.dot(&first) > 0.0;
        assert!(here[3].arrows.iter().all(parallel));
        for k in 0..3 {
            assert_eq!(here[k].arrows, there[k].arrows);
        }
        assert_ne!(here[3].arrows, there[3].arrows);
    }

    #[test]
    fn the_mixture_has_no_common_direction_and_no_common_centre() {
        let scene = scenes::road();
        let mixture = &fields(&scene)[6];
        let p0 = scene.camera.principal_point();
        let off = mixture.arrows.iter().filter(|a| a.flow.perp(&(a.at - p0)).abs() > 0.3 * a.flow.norm() * (a.at - p0).norm());
        assert!(off.count() > 30);
        let sum: Vector2<f64> = mixture.arrows.iter().map(|a| a.flow.normalize()).sum();
        assert!(sum.norm() < 0.8 * mixture.arrows.len() as f64);
    }
}
