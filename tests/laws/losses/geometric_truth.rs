//! The four losses cost nothing at the truth of a static scene, and something beside it.

use dimode_autodiff::Tensor;
use dimode_geometry::losses::{AxialForm, LossOptions, PlanarForm, RadialForm, TangentialForm};
use dimode_geometry::{Convention, Intrinsics, Se3};
use nalgebra::Vector3;

use crate::geometric::{Geometric, forms, pixels, robust};
use crate::scenes::{cameras, facing_the_source, mask, motion, motions, plane, seen, vectors};
use crate::support::{Scene, value};

const NAMES: [&str; 4] = ["L_pla", "L_axi", "L_tan", "L_rad"];

fn scene(depth: Tensor<f64>, source: Tensor<f64>, motions: &[Se3], cameras: &[Intrinsics]) -> Scene {
    let [flow, _] = seen(&depth, motions, cameras);
    let [w, t] = vectors(motions);
    let everywhere = Tensor::full(depth.shape(), 1.0);
    Scene { leaves: vec![depth, source, flow, w, t], data: vec![everywhere], cameras: cameras.to_vec() }
}

/// Planes that face the source: reading their depth between pixels is exact.
fn facing(motions: &[Se3]) -> Scene {
    let depth = facing_the_source(6.0, motions, &cameras());
    let source = Tensor::full(depth.shape(), 6.0);
    scene(depth, source, motions, &cameras())
}

/// Planes `normal . X = distance` rendered in both views, by cameras of `zoom` times the pixels.
fn rendered(normal: Vector3<f64>, distance: f64, motions: &[Se3], zoom: usize) -> Scene {
    let z = zoom as f64;
    let cameras: Vec<_> = cameras()
        .iter()
        .map(|k| Intrinsics::new(z * k.fu, z * k.fv, z * k.u0, z * k.v0, zoom * k.width, zoom * k.height).unwrap())
        .collect();
    // n . R^T (X_s - t) = d
    let turned: Vec<_> = motions.iter().map(|m| m.rotation * normal).collect();
    let distances: Vec<_> = motions.iter().zip(&turned).map(|(m, n)| distance + n.dot(&m.translation)).collect();
    let depth = plane(&vec![normal; motions.len()], &vec![distance; motions.len()], &cameras);
    let source = plane(&turned, &distances, &cameras);
    scene(depth, source, motions, &cameras)
}

#[test]
fn exact_scenes_cost_nothing_whichever_way_the_camera_moves() {
    for sign in [-1.0, 1.0] {
        let scene = facing(&motions(sign));
        for options in forms() {
            for (term, name) in NAMES.iter().enumerate() {
                let found = value(&Geometric { term, options }, &scene);
                let signed = matches!(options.axial, AxialForm::Literal | AxialForm::Signed);
                let expected = if term == 1 && signed && sign > 0.0 { std::f64::consts::PI } else { 0.0 };
                // An arccos near cosine 1 keeps half of the digits.
                let half =
                    (term == 1 && options.axial == AxialForm::Literal) || (term == 0 && options.planar == PlanarForm::Literal);
                let tolerance = if half { 2e-7 } else { 1e-10 };
                assert!((found - expected).abs() < tolerance, "{name} of {options:?}, sign {sign}: {found}");
            }
        }
    }
}

#[test]
fn each_wrong_input_costs_each_loss_that_reads_it() {
    let truth = facing(&motions(-1.0));
    // Leaf, factor, and the losses (by number) that must rise with all forms in pixels.
    let wrong: [(usize, &[usize]); 5] = [(0, &[2, 3]), (1, &[1]), (2, &[1, 2, 3]), (3, &[1, 2]), (4, &[2, 3])];
    for (leaf, losses) in wrong {
        for &term in losses {
            let found = value(&Geometric { term, options: pixels() }, &truth.scaled(&[leaf], 1.1));
            assert!(found > 1e-3, "{} does not see leaf {leaf}: {found}", NAMES[term]);
        }
    }
}

#[test]
fn the_printed_alignment_leaves_a_residual_that_grows_with_the_rotation() {
    let of = |angle: f64, convention| {
        let motions: Vec<_> = motions(-1.0).iter().map(|m| motion([0.0, angle, 0.0], m.translation.into())).collect();
        let scene = facing(&motions);
        [0, 1, 2, 3].map(|term| value(&Geometric { term, options: LossOptions { convention, ..robust() } }, &scene))
    };
    let degrees = |d: f64| of(d.to_radians(), Convention::AsPrinted);
    let (still, small, large) = (degrees(0.0), degrees(0.3), degrees(2.0));
    println!("as printed at the truth, yaw 0: {still:?}\nyaw 0.3: {small:?}\nyaw 2: {large:?}");
    for term in 0..4 {
        assert!(still[term] < 1e-10, "{}", NAMES[term]);
        assert!(large[term] > 3.0 * small[term] && small[term] > 1e-9, "{}: {small:?} {large:?}", NAMES[term]);
        assert!(of(2.0_f64.to_radians(), Convention::Consistent)[term] < 1e-10);
    }
}

#[test]
fn a_component_of_exactly_nothing_is_left_out_of_the_printed_sums() {
    let printed = LossOptions { convention: Convention::Consistent, ..LossOptions::literal() };
    let of = |t: [f64; 3], term| value(&Geometric { term, options: printed }, &facing(&vec![motion([0.0; 3], t); 3]));
    for t in [[0.5, 0.0, 0.0], [0.0, -0.5, 0.0]] {
        let found = of(t, 2);
        assert!(found < 1e-12, "{t:?}: {found}");
        // Where rounding leaves a flow, its ratio times no translation is off by all of the depth: A is 1 at most.
        assert!(of(t, 3) < 1.0 + 1e-12);
    }
}

#[test]
fn a_slanted_plane_costs_what_reading_its_depth_between_pixels_costs() {
    let unitless =
        LossOptions { tangential: TangentialForm::InverseRatio, radial: RadialForm::InverseRatio, q_min: 2.0, ..robust() };
    for sign in [-1.0, 1.0] {
        let of = |zoom: usize| {
            let scene = rendered(Vector3::new(0.1, 0.5, 1.0).normalize(), 6.0, &motions(sign), zoom);
            [1, 2, 3].map(|term| value(&Geometric { term, options: unitless }, &scene))
        };
        let [coarse, fine] = [of(2), of(8)];
        println!("slanted plane, 2x: {coarse:?}, 8x: {fine:?}");
        for (coarse, fine) in coarse.iter().zip(&fine) {
            // Second order in the size of a pixel: 1/16, but for pixels that come and go at the border.
            assert!(*fine < 0.12 * coarse && *coarse > 1e-9, "{coarse} {fine}");
        }
    }
}

#[test]
fn only_pixels_in_view_are_asked_for_their_source_depth() {
    // Half of the view leaves the image on the right, where reading repeats a border whose depth is wrong: nothing is charged. Of
    // the pixels in view, those that read the border too are left out.
    let scene = facing(&vec![motion([0.0, 0.25, 0.0], [0.35, -0.2, -0.4]); 3]);
    let scene = scene.with_leaf(1, |d, _, _, _, w| if w == 7 { 0.5 * d } else { d });
    let flow = &scene.leaves[2];
    let end = |n: usize, v: usize, u: usize| u as f64 + flow.at(n, 0, v, u);
    let reads_inside = mask(3, |n, v, u| end(n, v, u) < 6.0 || end(n, v, u) > 7.0);
    let left = mask(3, |n, v, u| end(n, v, u) > 7.0).data().iter().sum::<f64>();
    assert!(left > 36.0, "{left} pixels leave the view");
    let (inside, all) = (scene.clone().with_data(0, reads_inside), scene);
    for (term, name) in NAMES.iter().enumerate() {
        let loss = Geometric { term, options: pixels() };
        assert!(value(&loss, &inside) < 1e-10, "{name}: {}", value(&loss, &inside));
        assert!(value(&loss, &all) > 1e-3, "{name}: {}", value(&loss, &all));
    }
}
