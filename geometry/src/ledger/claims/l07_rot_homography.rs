//! L07: the homography of a pure rotation.

use nalgebra::{Vector2, Vector3};

use crate::homography::{rotation_homography, transfer};
use crate::ledger::{Case, Claim, Findings, Trial, Verdict, forward, taped};
use crate::{scenes, so3};

pub(super) static CLAIM: Claim = Claim {
    id: "L07",
    slug: "rot-homography",
    place: "eqs. rotational_correspondence, _h",
    statement: "A pure rotation moves pixels by the homography H = K R K^-1, the same for all depths.",
    verdict: Verdict::Exact,
    condition: Some("h_3 . p~ > 0"),
    formula: "p~_s = (z_t / z_s) H p~_t,  z_s = z_t h_3 . p~_t,  p_s = (h_1 . p~ / h_3 . p~, h_2 . p~ / h_3 . p~)",
    derivation: "z_s p~_s = K R (z_t K^-1 p~_t) = z_t H p~_t. The third row of p~_s is 1, so z_s / z_t = h_3 . p~_t, and the \
                 depth cancels in the quotients.",
    counter_example: None,
    correction: None,
    functions: &["homography::rotation_homography", "homography::transfer"],
    taped: &["taped::rigid_flow", "taped::so3_exp"],
    missing_way: None,
    check,
};

fn check(trial: &mut Trial) {
    trial.cases(at);
    let h = rotation_homography(&scenes::kitti640(), &so3::exp(&Vector3::new(0.03, -0.05, 0.02)));
    for (k, expected) in [0.000135420916922, 7.99727699733e-05, 0.947288458933].into_iter().enumerate() {
        trial.findings.documented("third row of H, documented", h[(2, k)], expected, 1e-11);
    }
    let ratio = transfer(&h, &Vector2::new(451.0, 63.0)).map_or(f64::NAN, |(_, ratio)| ratio);
    trial.findings.documented("z_s / z_t at (451, 63), documented", ratio, 1.01340157697, 1e-11);
}

fn at(case: &Case, f: &mut Findings) {
    let (camera, rotation, p) = (&case.camera, &case.motion.rotation, case.pixel);
    let h = rotation_homography(camera, rotation);
    let Some((image, ratio)) = transfer(&h, &p) else {
        return f.residual("point in front of the source camera", f64::NAN, 1.0);
    };
    let omega = so3::log(rotation);
    for depth in [case.depth, case.extra(0, 0.5, 80.0)] {
        let turned = Vector3::from(forward::rotated::<f64>(omega.into(), (camera.ray(p.x, p.y) * depth).into()));
        let seen = Vector2::from(forward::projected::<f64>(camera, turned.into()));
        f.residual("homography - projection of the turned point, two depths, px", (image - seen).norm(), 1e-10);
        f.equal("z_t h_3 . p~ - depth of the turned point, relative", depth * ratio, turned.z, depth, 1e-13);
        let (taped, _) = taped::rigid_flow(camera, &omega, &Vector3::zeros(), &p, depth);
        f.residual("homography - p - flow on the tape, px", (image - p - Vector2::new(taped[0], taped[1])).norm(), 1e-10);
        f.equal("z_t h_3 . p~ - depth on the tape, relative", depth * ratio, taped[2], depth, 1e-13);
    }
    let homogeneous = camera.matrix() * rotation * camera.inverse_matrix() * Vector3::new(p.x, p.y, 1.0);
    f.residual("K R K^-1 p~ - (h_3 . p~) p~_s, px", (homogeneous.xy() - image * ratio).norm(), 1e-10);
    let (back, _) =
        transfer(&rotation_homography(camera, &rotation.transpose()), &image).unwrap_or((Vector2::repeat(f64::NAN), 0.0));
    f.residual("homography of R^T at p_s - p_t, px", (back - p).norm(), 1e-9);
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

    #[test]
    fn a_pixel_that_turns_out_of_view_has_no_image() {
        let h = rotation_homography(&scenes::kitti640(), &so3::exp(&Vector3::new(0.0, 3.0, 0.0)));
        assert!(transfer(&h, &Vector2::new(320.0, 96.0)).is_none());
    }
}
