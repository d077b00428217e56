//! Ratio losses and the rest (L51 to L64).

use dimode_geometry::flow::{radial::radial_flow, tangential::tangential_flow};
use dimode_geometry::ledger::estimates::{self, PlainLosses};
use dimode_geometry::ledger::forward;
use dimode_geometry::loss_forms::{radial, ratio_terms, tangential};
use dimode_geometry::losses::{self, AxialForm, LossOptions, PlanarForm};
use dimode_geometry::ratio_bias::{self, PixelError};
use dimode_geometry::scenes::{self, Perturbed};
use dimode_geometry::{Convention, ratio_noise, ratios, recovery, reported, so3};
use nalgebra::{Vector2, Vector3};

use super::Row;
use super::entry::Entry;

pub const ROWS: &[Row] = &[
    ("rho-xy", "generic", tangential_ratio),
    ("rho-z", "tz=0.6", radial_ratio),
    ("rho-z", "tz=-0.8", radial_ratio),
    ("rho-z", "orthogonal-invariance", orthogonal_flow),
    ("recovery", "signed-cancellation", signed_cancellation),
    ("tx-to-zero", "deterministic-noise", vanishing_translation),
    ("scale-invariance", "lambda=1", scaled_estimates),
    ("scale-invariance", "lambda=1.7", scaled_estimates),
    ("scale-invariance", "only-t-times-1.7", scaled_estimates),
    ("scale-invariance", "only-zt-times-1.7", scaled_estimates),
    ("scale-invariance", "only-zs-times-1.7", scaled_estimates),
    ("scale-invariance", "only-zs_t-times-1.7", scaled_estimates),
    ("ratio-bias", "truncated-gaussian", truncated_noise),
    ("ratio-bias", "heavy-tail", heavy_tail),
    ("ratio-bias", "alternatives", pixel_errors),
    ("recovery-bias", "tz", recovery_bias),
    ("pixel-term-gradient", "table", pixel_term_gradient),
    ("rho-z-noise", "radius-table", radial_noise),
    ("rho-xy-noise", "table", tangential_noise),
    ("rotation-leak", "0.1deg", rotation_leak),
    ("loss-gradients", "handheld-perturbed", loss_gradients),
    ("loss-gradients", "generic-perturbed", loss_gradients),
    ("percentages", "ate-reduction", percentages),
];

fn tangential_ratio(e: &Entry) {
    let (camera, z, t) = (e.camera(), e.number("z"), e.vector("t"));
    let flow = tangential_flow(&camera, &t, z);
    let ratio = ratios::tangential_ratios(&camera, &flow);
    e.check("f", flow.as_slice());
    e.check("rho_x", &[ratio.x]);
    e.check("rho_y", &[ratio.y]);
    e.check("z_over_t", &[z / t.x, z / t.y]);
}

fn radial_ratio(e: &Entry) {
    let (camera, p, z, t_z) = (e.camera(), e.pixel(), e.number("z"), e.vector("t").z);
    let (flow, d) = (radial_flow(&camera, t_z, &p, z).unwrap(), p - camera.principal_point());
    e.check("f", flow.as_slice());
    e.check("rho_z", &[ratios::radial_ratio(&flow, &d)]);
    let r = d.norm();
    e.check("via_radial_component", &[ratios::radial_ratio_of_component(d.dot(&flow) / r, r)]);
    e.check("z_over_tz", &[z / t_z]);
}

fn orthogonal_flow(e: &Entry) {
    let (flow, d) = (Vector2::from_column_slice(&e.numbers("f")), e.pixel() - e.camera().principal_point());
    let turned = flow + Vector2::new(-d.y, d.x) * 0.3;
    e.check("rho", &[ratios::radial_ratio(&flow, &d)]);
    e.check("rho_with_orthogonal", &[ratios::radial_ratio(&turned, &d)]);
    e.check("inverse", &[ratios::inverse_radial_ratio(&flow, &d)]);
}

fn signed_cancellation(e: &Entry) {
    let found = Perturbed::exact(&scenes::handheld()).with_target_depths(|p| 1.02 + 0.1 * scenes::target_wave(p));
    let (planar, axial, d) = (found.planar_flows(), found.axial_flows(), found.scene.offsets());
    let (camera, depths, a) = (&found.scene.camera, &found.target_depths, &found.in_target);
    let mean = depths.iter().zip(&found.scene.depths).map(|(a, b)| a / b).sum::<f64>() / depths.len() as f64;
    e.check("mean_ratio_minus_1", &[mean - 1.0]);
    e.check("ltan_parts", &tangential::printed_terms(camera, &planar, depths, a));
    e.check("lrad_parts", &radial::printed_terms(&axial, &d, depths, a));
    e.check("recovered", recovery::translation(camera, [&planar, &axial], &d, depths).as_slice());
}

fn vanishing_translation(e: &Entry) {
    let scene = scenes::road();
    let noise = |p: &Vector2<f64>| 0.3 * (12.9898 * p.x + 78.233 * p.y).sin();
    for (i, t_x) in [0.5, 0.1, 0.02, 0.005, 0.001].into_iter().enumerate() {
        let t = Vector3::new(t_x, 0.0, 0.0);
        let flow = |(p, &z): (&Vector2<f64>, &f64)| tangential_flow(&scene.camera, &t, z) + Vector2::new(noise(p), 0.0);
        let flows: Vec<_> = scene.pixels.iter().zip(&scene.depths).map(flow).collect();
        let terms = tangential::printed_terms(&scene.camera, &flows, &scene.depths, &t);
        let recovered = recovery::translation(&scene.camera, [&flows, &flows], &scene.offsets(), &scene.depths);
        let bounded = tangential::flow_pixels_by_axis(&scene.camera, &flows, &scene.depths, &t);
        e.check(&format!("rows/{i}"), &[t_x, terms[0], terms[1], recovered.x, bounded.x]);
    }
}

/// The perturbed scene of the inputs.
fn perturbed(e: &Entry) -> Perturbed {
    let found =
        [scenes::perturbed_handheld(), scenes::perturbed_generic()].into_iter().find(|s| s.in_target == e.vector("tp_hat"));
    let found = found.expect("a scene with this estimate of t'");
    assert_eq!(found.omega, e.vector("omega_hat"));
    found
}

fn scaled_estimates(e: &Entry) {
    let [target, source, translation] = match e.name().1 {
        "lambda=1" => [1.0; 3],
        "lambda=1.7" => [1.7; 3],
        "only-t-times-1.7" => [1.0, 1.0, 1.7],
        "only-zt-times-1.7" => [1.7, 1.0, 1.0],
        "only-zs-times-1.7" => [1.0, 1.7, 1.0],
        "only-zs_t-times-1.7" => [1.0, 1.7, 1.7],
        other => panic!("no scaling '{other}'"),
    };
    check_losses(e, "", &perturbed(e).scaled(target, source, translation));
}

const LOSSES: [&str; 7] = ["lpla_circ", "lpla_printed", "lpla_weighted", "laxi_signed", "laxi_printed", "ltan", "lrad"];

fn check_losses(e: &Entry, place: &str, estimate: &Perturbed) {
    for (name, value) in LOSSES.iter().zip(PlainLosses::new(estimate).to_array()) {
        e.check(&format!("{place}{name}"), &[value]);
    }
}

const DIFFERENTIATED: [&str; 5] = ["lpla_circ", "lpla_weighted", "laxi_signed", "ltan", "lrad"];
const PIXEL: usize = 100;

/// By forward mode, and by the tape over the image of the grid's pixels.
fn loss_gradients(e: &Entry) {
    let estimate = perturbed(e);
    check_losses(e, "value/", &estimate);
    let still = [0.0; forward::pipeline::CHANGES];
    let rows = forward::jacobian(still, |x| forward::pipeline::losses(&estimate, PIXEL, x));
    let forward: Vec<&[f64]> = rows.chunks(still.len()).collect();
    let taped = taped_losses(&estimate);
    for rows in [forward, taped.iter().map(|row| row.as_slice()).collect()] {
        for (name, row) in DIFFERENTIATED.iter().zip(&rows) {
            e.check(&format!("pose/{name}"), &row[..6]);
        }
        for (k, name) in ["zt_all", "zt_100", "zs_all", "zs_100"].into_iter().enumerate() {
            let column: Vec<f64> = rows.iter().map(|row| row[6 + k]).collect();
            e.check(&format!("log_depth/{name}"), &column);
        }
    }
}

fn taped_losses(estimate: &Perturbed) -> [[f64; forward::pipeline::CHANGES]; 5] {
    let literal = LossOptions { convention: Convention::Consistent, ..LossOptions::literal() };
    let (circular, weighted, signed) = (
        LossOptions { planar: PlanarForm::Circular, tau_flow: 0.0, ..literal },
        LossOptions { planar: PlanarForm::Weighted, ..literal },
        LossOptions { axial: AxialForm::PoseSign, tau_flow: 0.0, q_min: 0.0, ..literal },
    );
    let forms: [(LossOptions, estimates::Form); 5] = [
        (circular, losses::planar),
        (weighted, losses::planar),
        (signed, losses::axial),
        (literal, losses::tangential),
        (literal, losses::radial),
    ];
    forms.map(|(options, form)| estimates::taped_loss(estimate, &options, form).changes(PIXEL))
}

fn truncated_noise(e: &Entry) {
    for (i, case) in e.rows("cases").into_iter().enumerate() {
        let (f, sigma) = (case[0], case[1]);
        let mean = [ratio_bias::mean_ratio(f, sigma), ratio_bias::mean_ratio_second_order(f, sigma)];
        e.check(&format!("rows/{i}"), &[f, sigma, mean[0], mean[1], PixelError::OverPrediction.minimiser(f, sigma)]);
    }
}

fn heavy_tail(e: &Entry) {
    let cases = [(2.0, 1e-2), (2.0, 1e-4), (0.5, 1e-2), (0.5, 1e-4), (0.5, 1e-6)];
    for (i, (f, cut_off)) in cases.into_iter().enumerate() {
        e.check(&format!("rows/{i}"), &[f, 0.5, cut_off, ratio_bias::mean_error_beyond(f, 0.5, cut_off)]);
    }
}

fn pixel_errors(e: &Entry) {
    for (i, f) in [2.0, 4.0].into_iter().enumerate() {
        let minimisers =
            [PixelError::OverPrediction, PixelError::OverRatio, PixelError::InverseDepth].map(|x| x.minimiser(f, 0.5));
        e.check(&format!("rows/{i}"), &[&[f, 0.5], &minimisers[..]].concat());
    }
}

fn recovery_bias(e: &Entry) {
    let (sigma, z) = (e.number("sigma_px"), e.number("z"));
    let variance = ratio_bias::truncated_variance(sigma);
    let cases = [-0.8, 0.8].into_iter().flat_map(|t_z| [2.0, 5.0, 20.0, 100.0].map(|r| (t_z, r)));
    for (i, (t_z, r)) in cases.enumerate() {
        let bias = ratio_bias::radial_recovery_bias(sigma, z, t_z, r);
        let second_order = ratio_bias::radial_recovery_bias_second_order(variance, z, t_z, r);
        e.check(&format!("rows/{i}"), &[t_z, r, bias, second_order]);
    }
}

fn pixel_term_gradient(e: &Entry) {
    let cases =
        e.numbers("geometric_depth").into_iter().flat_map(|depth| e.numbers("ratio").into_iter().map(move |q| (depth, q)));
    for (i, (depth, quotient)) in cases.enumerate() {
        let z = depth * quotient;
        let slopes = [ratio_terms::pixel_term_slope(depth, z), ratio_terms::pixel_term_log_slope(depth, z)];
        e.check(&format!("rows/{i}"), &[depth, z, ratio_terms::pixel_term_at(depth, z), slopes[0], slopes[1]]);
    }
}

fn radial_noise(e: &Entry) {
    let (sigma, z) = (e.number("sigma_px"), e.number("z"));
    let cases = e.numbers("tz").into_iter().flat_map(|t_z| e.numbers("r").into_iter().map(move |r| (t_z, r)));
    for (i, (t_z, r)) in cases.enumerate() {
        let f_r = ratios::radial_flow_component(z, t_z, r);
        let [below, above] = [-sigma, sigma].map(|n| ratios::radial_ratio_of_component(f_r + n, r));
        let noise = [ratios::radial_ratio_noise(sigma, z, t_z, r), ratio_noise::radial_depth_noise(sigma, z, t_z, r)];
        let flip = ratio_noise::sign_flip_probability(f_r, sigma);
        e.check(&format!("rows/{i}"), &[t_z, r, f_r, noise[0], noise[1], flip, below, above]);
        e.check_relative(&format!("rows/{i}/5"), flip);
    }
}

fn tangential_noise(e: &Entry) {
    let (camera, sigma) = (e.camera(), e.number("sigma_px"));
    let cases = e.numbers("tx").into_iter().flat_map(|t_x| e.numbers("z").into_iter().map(move |z| (t_x, z)));
    for (i, (t_x, z)) in cases.enumerate() {
        let flow = tangential_flow(&camera, &Vector3::new(t_x, 0.0, 0.0), z);
        e.check(&format!("rows/{i}"), &[t_x, z, flow.x, ratio_noise::tangential_depth_noise(&camera, sigma, z, t_x)]);
    }
}

fn rotation_leak(e: &Entry) {
    let angle = e.number("angle");
    for reference in [scenes::drive_next(), scenes::handheld()] {
        let truth = Perturbed::exact(&reference);
        let (scene, depths) = (&truth.scene, &truth.target_depths);
        let leak = recovery::rotation_leak(&scene.camera, &scene.pixels, depths) * angle;
        for k in 0..3 {
            let turned = truth.rotation() * so3::exp(&Vector3::ith(k, angle));
            let off = Perturbed { omega: so3::log(&turned), ..truth.clone() };
            let flows = [off.planar_flows(), off.axial_flows()];
            let found = recovery::translation(&scene.camera, [&flows[0], &flows[1]], &scene.offsets(), depths);
            e.check(&format!("{}/recovered_error/{k}", reference.name), (found - truth.in_target).as_slice());
            e.check(&format!("{}/first_order_xy/{k}", reference.name), &[leak[(0, k)], leak[(1, k)]]);
        }
    }
}

fn percentages(e: &Entry) {
    let found: Vec<f64> = e.rows("pairs").iter().map(|pair| reported::reduction_percent(pair[0], pair[1])).collect();
    e.check("percent", &found);
}
