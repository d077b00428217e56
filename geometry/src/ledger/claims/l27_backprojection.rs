//! L27: source points from the sampled source depth.

use dimode_autodiff::ops::bilinear_sample::SamplePadding;
use dimode_autodiff::{Shape, Tape, Tensor};
use nalgebra::{Vector2, Vector3};

use crate::backprojection::{DepthCell, InverseDepthPlane, source_point};
use crate::flow::rigid::rigid_flow;
use crate::ledger::{Case, Claim, Findings, Trial, Verdict, forward};
use crate::taped::warp::warp;
use crate::{scenes, so3};

pub(super) static CLAIM: Claim = Claim {
    id: "L27",
    slug: "backprojection",
    place: "D_{s->t} and p_s^C",
    statement: "p_s^C = D_{s->t}(p_t) K^-1 p_s is the source point of the target pixel.",
    verdict: Verdict::Conditional,
    condition: Some(
        "p_s is homogeneous; D_{s->t} is the source depth at p_s, in the source frame; read without interpolation error",
    ),
    formula: "p_s^C = D_s(p_s) K^-1 p~_s = R P_t + t;  on a plane 1/z = a u + b v + c is affine in the pixel, z is not",
    derivation: "K^-1 p~_s is the viewing ray with third component 1, so z_s times it is the point. A warp reads D_s between \
         pixels: the bilinear mean of z = 1/q over a cell, with 1/q convex in the affine q, is at least 1 / mean(q) = z. The \
         mean of 1/z is exact. In disflow the first two rows of K(...) / i_3(...) are meant.",
    counter_example: Some(
        "Ground plane 1/z = 0.001 v + 0.004, half a pixel below v = 2: z = 153.846, bilinear depth 154.762 (+0.6 %), by inverse \
         depth 153.846; near v = 100 the bias is 2.3e-5.",
    ),
    correction: Some("Interpolate the inverse depth, or accept a bias that is largest far away."),
    functions: &[
        "backprojection::source_point",
        "backprojection::DepthCell::by_depth",
        "backprojection::DepthCell::by_inverse_depth",
    ],
    taped: &["taped::warp"],
    missing_way: None,
    check,
};

fn check(trial: &mut Trial) {
    trial.cases(at);
    let (plane, f) = (InverseDepthPlane { a: 0.0, b: 0.001, c: 0.004 }, &mut trial.findings);
    for (v, truth, by_depth) in [(2.5, 153.846153846, 154.761904762), (100.5, 9.56937799043, 9.5695970696)] {
        let p = Vector2::new(320.0, v);
        let cell = plane.cell(&p);
        f.documented("depth of the ground plane, documented", plane.depth(&p), truth, 1e-11);
        f.documented("bilinear depth, documented", cell.by_depth(), by_depth, 1e-11);
        f.documented("bilinear inverse depth, documented", cell.by_inverse_depth(), truth, 1e-11);
        f.gap("bias of the bilinear depth, relative", cell.by_depth() / truth - 1.0, 0.0053);
    }
    let (camera, p) = (scenes::kitti640(), Vector2::new(451.0, 63.0));
    let scaled = camera.inverse_matrix() * Vector3::new(p.x, p.y, 1.0) * 1.1 * 12.5;
    let point = source_point(&camera, &p, 12.5);
    f.gap("point from a pixel with third component 1.1 - point, relative", (scaled - point).norm() / point.norm(), 0.09);
}

fn at(case: &Case, f: &mut Findings) {
    point(case, f);
    interpolation(case, f);
}

/// With exact flow and depth the point is the transformed target point.
fn point(case: &Case, f: &mut Findings) {
    let (camera, w, t) = (&case.camera, so3::log(&case.motion.rotation), case.motion.translation);
    let Some((flow, depth)) = rigid_flow(camera, &case.motion, &case.pixel, case.depth) else {
        return f.residual("point in front of the camera", f64::NAN, 1.0);
    };
    let found = source_point(camera, &(case.pixel + flow), depth);
    let moved = Vector3::from(forward::sum(forward::rotated::<f64>(w.into(), case.point().into()), t.into()));
    f.residual("D K^-1 p~_s - (R P_t + t), relative", (found - moved).norm() / moved.norm(), 1e-10);
    // The same with a third homogeneous component c instead of 1: the whole point is off by that factor.
    let c = case.extra(0, 1.05, 1.2);
    let printed = camera.inverse_matrix() * Vector3::new(case.pixel.x + flow.x, case.pixel.y + flow.y, 1.0) * c * depth;
    f.equal(
        "pixel with third component c: miss of the point - (c - 1), relative",
        (printed - moved).norm() / moved.norm(),
        c - 1.0,
        1.0,
        1e-10,
    );
}

/// A plane with inverse depths in [0.005, 0.5], read between four pixels.
fn interpolation(case: &Case, f: &mut Findings) {
    let centre = 0.005 * 100f64.powf(case.extra(1, 0.1, 0.9));
    let reach = 0.5 * (centre - 0.005).min(0.5 - centre);
    let (a, b) = (case.extra(2, -1.0, 1.0) * reach, case.extra(3, -1.0, 1.0) * reach);
    let corner = case.pixel.map(f64::floor);
    let plane = InverseDepthPlane { a, b, c: centre - a * (corner.x + 0.5) - b * (corner.y + 0.5) };
    let p = corner + Vector2::new(case.extra[4], case.extra[5]);
    let (cell, truth) = (plane.cell(&p), plane.depth(&p));
    // The plane is given by its value at pixel (0, 0), so its inverse depth carries the rounding of |a u| + |b v|.
    let rounding = 1.0 + (a * p.x).abs().max((b * p.y).abs()) * truth;
    f.equal("bilinear inverse depth - depth, relative", cell.by_inverse_depth(), truth, truth * rounding, 1e-13);
    let above = (cell.by_depth() - truth) / (truth * rounding);
    f.floor("bilinear depth - truth, relative, but for rounding", above, -1e-13);
    f.equal("taped warp - bilinear depth, relative", warped(&cell), cell.by_depth(), truth, 1e-12);
}

/// What a warp on the tape reads in a cell.
fn warped(cell: &DepthCell) -> f64 {
    let tape = Tape::new();
    let image = tape.constant(Tensor::from_fn(Shape::new(1, 1, 2, 2), |_, _, v, u| cell.depths[v][u]));
    // Only the flow of the first pixel matters.
    let flow = tape.constant(Tensor::from_fn(Shape::new(1, 2, 2, 2), |_, c, _, _| cell.fraction[c]));
    warp(image, flow, SamplePadding::Border).value().at(0, 0, 0, 0)
}

#[cfg(test)]
mod tests {
    crate::ledger::testing::tests_on_cases!(super::at);
}
