//! The ways to the derivatives of the flow, which several claims compare.

use nalgebra::Vector2;

use crate::flow::gradients::{TranslationalGradients, rigid_gradients, translational_gradients};
use crate::ledger::{Case, Findings, forward, taped};
use crate::so3;

/// What the flow is differentiated by; the number is the place in [`Ways`].
#[derive(Clone, Copy, Debug)]
pub(crate) enum Input {
    TangentialX = 0,
    TangentialY = 1,
    Radial = 2,
    Depth = 3,
}

/// Derivatives of the flow by `t_x, t_y, t_z, z`, by the ways that share no code with the closed forms.
pub(crate) struct Ways {
    pub forward: [Vector2<f64>; 4],
    pub tape: [Vector2<f64>; 4],
    pub central: [Vector2<f64>; 4],
    /// `max(f_u, f_v) / z_s`: how far a point's pixel moves for a unit of translation.
    pub scale: f64,
}

/// The flow's derivatives at a case.
pub(crate) fn ways(case: &Case) -> Ways {
    let (camera, p, z) = (&case.camera, case.pixel, case.depth);
    let (w, t) = (so3::log(&case.motion.rotation), case.motion.translation);
    let x = [t.x, t.y, t.z, z];
    let dual = forward::jacobian(x, |[x, y, z, depth]| {
        forward::rigid_flow(camera, forward::fixed(w.into()), [x, y, z], forward::fixed(p.into()), depth).0
    });
    let central = forward::central(x, [1e-6 * z; 4], |[x, y, z, depth]| {
        forward::rigid_flow::<f64>(camera, w.into(), [x, y, z], p.into(), depth).0
    });
    let (values, rows) = taped::rigid_flow(camera, &w, &t, &p, z);
    let columns = |m: &[f64]| std::array::from_fn(|k| Vector2::new(m[k], m[4 + k]));
    Ways {
        forward: columns(&dual),
        tape: std::array::from_fn(|k| Vector2::new(rows[0][3 + k], rows[1][3 + k])),
        central: columns(&central),
        scale: camera.fu.max(camera.fv) / values[2],
    }
}

/// An input, and its derivative among the closed forms.
pub(crate) type Part = (Input, fn(&TranslationalGradients) -> Vector2<f64>);

/// Compares some of the closed forms with all other ways, without the case's rotation and with it.
pub(crate) fn compare(case: &Case, f: &mut Findings, what: &str, parts: &[Part]) {
    let straight = case.without_rotation();
    let (camera, p, z) = (&case.camera, &case.pixel, case.depth);
    let without = translational_gradients(camera, &straight.motion.translation, p, z);
    let with = rigid_gradients(camera, &case.motion, p, z);
    for (name, case, closed) in [(what.to_owned(), &straight, without), (format!("{what} with rotation"), case, with)] {
        let Some(closed) = closed else {
            return f.residual("point in front of the camera", f64::NAN, 1.0);
        };
        let ways = ways(case);
        for &(input, part) in parts {
            let k = input as usize;
            let [forward, tape, central] = [&ways.forward, &ways.tape, &ways.central].map(|way| Some(way[k].as_slice()));
            f.derivative(&name, part(&closed).as_slice(), forward, tape, central, ways.scale);
        }
    }
}
