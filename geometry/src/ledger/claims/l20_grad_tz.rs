//! L20: derivative of the flow with respect to the radial translation.

use nalgebra::{Vector2, Vector3};

use crate::flow::gradients::translational_gradients;
use crate::ledger::{Case, Claim, Findings, Trial, Verdict, forward, taped};
use crate::scenes;

pub(super) static CLAIM: Claim = Claim {
    id: "L20",
    slug: "grad-tz",
    place: "eq. grad_tz",
    statement: "df/dt_z = -[d z + f o t] / (z + t_z)^2.",
    verdict: Verdict::Exact,
    condition: Some("R = I; with a rotation the same with the rotated pixel and depth"),
    formula: "df/dt_z = -[d z + f o t] / (z + t_z)^2,  d = p - p0, f o t = (f_u t_x, f_v t_y)",
    derivation: "Quotient rule on f = [f o t - d t_z] / (z + t_z): [-d (z + t_z) - f o t + d t_z] / (z + t_z)^2.",
    counter_example: None,
    correction: None,
    functions: &["flow::gradients::translational_gradients"],
    check,
};

fn check(trial: &mut Trial) {
    trial.cases(at);
    let (camera, t) = (scenes::kitti640(), Vector3::new(0.3, -0.1, 0.6));
    let gradient = translational_gradients(&camera, &t, &Vector2::new(451.0, 63.0), 12.5).map(|g| g.t_z);
    for (k, expected) in [-10.1908979663, 2.61851873434].into_iter().enumerate() {
        trial.findings.documented("gradient at (451, 63), documented", gradient.map_or(f64::NAN, |g| g[k]), expected, 1e-10);
    }
}

fn at(case: &Case, f: &mut Findings) {
    let case = case.without_rotation();
    let (camera, t, p, z) = (&case.camera, case.motion.translation, case.pixel, case.depth);
    let Some(closed) = translational_gradients(camera, &t, &p, z) else {
        return f.residual("point in front of the camera", f64::NAN, 1.0);
    };
    let still = [0.0; 3];
    let dual = forward::jacobian([t.z], |[t_z]| {
        let t = [forward::fixed::<_, 2>([t.x, t.y])[0], forward::fixed::<_, 2>([t.x, t.y])[1], t_z];
        let [z] = forward::fixed([z]);
        forward::rigid_flow(camera, forward::fixed(still), t, forward::fixed(p.into()), z).0
    });
    let central = forward::central([t.z], [1e-6 * z], |[t_z]| {
        forward::rigid_flow::<f64>(camera, still, [t.x, t.y, t_z], p.into(), z).0
    });
    let one_pixel = [taped::pixel_camera(camera, &p)];
    let (_, rows) = taped::jacobian(&[taped::column(t.as_slice())], |v| {
        let tape = v[0].tape();
        let rotation = crate::taped::so3_exp(tape.constant(taped::column(&still)));
        crate::taped::rigid_flow(tape.constant(taped::column(&[z])), rotation, v[0], &one_pixel).slice(1, 0, 2)
    });
    let tape = [rows[0][2], rows[1][2]];
    let scale = (camera.fu.max(camera.fv) + p.norm()) / (z + t.z);
    f.derivative("df/dt_z", closed.t_z.as_slice(), Some(&dual), Some(&tape), Some(&central), scale);
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::ledger::testing::{case, holds, limit};

    proptest! {
        #[test]
        fn holds_everywhere(case in case()) {
            holds(|f| at(&case, f))?;
        }

        #[test]
        fn holds_at_the_limits(case in limit()) {
            holds(|f| at(&case, f))?;
        }
    }
}
