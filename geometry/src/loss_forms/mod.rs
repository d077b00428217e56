//! The four geometric losses as plain sums over lists of pixels.
//!
//! These are the definitions; the differentiable versions in [`crate::losses`] are tested against
//! them. No masks and no guards: callers pass usable pixels only. `d` is `p - p0`.

pub mod axial;
pub mod planar;
pub mod radial;
pub mod ratio_terms;
pub mod tangential;

/// Mean of an iterator of known length; 0 for an empty one.
pub(crate) fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len().max(1);
    values.sum::<f64>() / count as f64
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;

    use super::*;
    use crate::Se3;
    use crate::alignment::{self, Convention, Match};
    use crate::flow::rigid::rigid_flow;
    use crate::testing::{self, Scene};

    /// Circular planar, signed axial, printed tangential and printed radial loss with perfect inputs.
    fn losses(scene: &Scene, motion: &Se3, convention: Convention) -> [f64; 4] {
        let (camera, rotation) = (&scene.camera, &motion.rotation);
        let a = convention.translation(motion);
        let (mut planar_flows, mut axial_flows, mut d): (Vec<_>, Vec<_>, Vec<Vector2<f64>>) = Default::default();
        for (p, &z) in scene.pixels.iter().zip(&scene.depths) {
            let (flow, source_depth) = rigid_flow(camera, motion, p, z).unwrap();
            let m = Match { target: *p, source: p + flow, source_depth };
            planar_flows.push(alignment::planar(camera, rotation, &a, &m).unwrap().flow);
            axial_flows.push(alignment::axial(camera, rotation, &a, &m).unwrap().flow);
            d.push(p - camera.principal_point());
        }
        [
            planar::circular(&planar_flows),
            axial::pose_sign(&axial_flows, &d, a.z),
            tangential::printed(camera, &planar_flows, &scene.depths, &a),
            radial::printed(&axial_flows, &d, &scene.depths, &a),
        ]
    }

    #[test]
    fn printed_alignment_of_perfect_inputs_costs_the_reference_values() {
        let cases = [
            (testing::room(), testing::handheld(), [0.000258946369196, 0.136647301837, 0.265076311818, 0.197590443889]),
            (testing::road(), testing::drive_next(), [9.2625343928e-07, 0.00691432229325, 0.516002449805, 0.00976264105671]),
            (testing::road(), testing::drive_prev(), [1.58712888793e-06, 0.00691517220908, 0.48618265315, 0.0112467369974]),
        ];
        for (scene, motion, expected) in cases {
            let found = losses(&scene, &motion, Convention::AsPrinted);
            for (found, expected) in found.into_iter().zip(expected) {
                assert!((found - expected).abs() < 1e-8 * expected + 1e-13, "{found} {expected}");
            }
            let consistent = losses(&scene, &motion, Convention::Consistent);
            assert!(consistent.iter().all(|x| x.abs() < 1e-9), "{consistent:?}");
        }
    }
}
