//! Relative normal angles: the angle between the normals at two pixels must be that of the pseudo-normals (SC-DepthV3;
//! JiawangBian/sc_depth_pl, `losses/normal_ranking_loss.py`).
//!
//! **Formula**: `L = mean over pairs (a, b) of all images | |n*_a . n*_b| - |n_a . n_b| |` with the pairs of [`super::edge_pairs`].
//!
//! **Gradient**: to the depth through both normals of a pair; none to the pseudo-depth nor to the choice of pairs. 0 at the kinks,
//! that is at right angles and where the angles agree.

use dimode_autodiff::{Scalar, Shape, Tensor, Var};
use dimode_geometry::Intrinsics;

use super::edge_pairs::{Pairs, edge_maps, random_pairs};
use super::local_structure::normals;

/// The loss of depth `[n, 1, h, w]` against pseudo-depth of that shape over given pairs, one list a sample; 0 without pairs.
///
/// # Panics
/// When shapes differ, there is not one list of pairs and one camera a sample, or a pair lies outside of the map.
#[track_caller]
pub fn relative_normal<'t, T: Scalar>(
    depth: Var<'t, T>,
    pseudo: &Tensor<T>,
    cameras: &[Intrinsics],
    pairs: &[Pairs],
) -> Var<'t, T> {
    let (shape, tape) = (depth.shape(), depth.tape());
    assert!(pseudo.shape() == shape, "relative_normal: depth {shape}, pseudo-depth {}", pseudo.shape());
    assert!(pairs.len() == shape.n(), "relative_normal: {} lists of pairs for depth {shape}", pairs.len());
    let predicted = normals(depth, cameras);
    let wanted = normals(tape.constant(pseudo.clone()), cameras);
    let differences = pairs.iter().enumerate().filter(|(_, pairs)| !pairs.a.is_empty()).map(|(n, pairs)| {
        let [found, wanted] = [predicted, wanted].map(|all| cosines(all.slice(0, n, 1), pairs));
        wanted.abs().sub(found.abs()).abs()
    });
    let differences: Vec<_> = differences.collect();
    if differences.is_empty() {
        return depth.scale(0.0).sum();
    }
    Var::concat(&differences, 3).mean()
}

/// [`relative_normal`] over pairs that are laid across edges of images `[n, c, h, w]` and pseudo-normals, drawn from a seed.
///
/// # Panics
/// When sizes differ.
#[track_caller]
pub fn edge_guided_relative_normal<'t, T: Scalar>(
    depth: Var<'t, T>,
    pseudo: &Tensor<T>,
    images: &Tensor<T>,
    cameras: &[Intrinsics],
    seed: u64,
) -> Var<'t, T> {
    let tape = dimode_autodiff::Tape::new();
    let pseudo_normals = normals(tape.constant(pseudo.clone()), cameras).value();
    let pairs = random_pairs(&edge_maps(images, &pseudo_normals, pseudo), seed);
    relative_normal(depth, pseudo, cameras, &pairs)
}

/// Cosines `[1, 1, 1, k]` between the normals `[1, 3, h, w]` of `k` pairs.
#[track_caller]
fn cosines<'t, T: Scalar>(normals: Var<'t, T>, pairs: &Pairs) -> Var<'t, T> {
    let flat = normals.reshape(Shape::new(1, 3, 1, normals.shape().plane()));
    let at = |pixels: &[usize]| {
        let index = Tensor::from_fn(Shape::new(1, 3, 1, pixels.len()), |_, _, _, k| T::from_usize(pixels[k]));
        flat.gather(3, &index)
    };
    let product = at(&pairs.a).mul(at(&pairs.b));
    product.sum_to(product.shape().with_c(1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::gradcheck::random;
    use dimode_autodiff::{GradCheck, Tape, gradcheck};

    fn cameras(n: usize) -> Vec<Intrinsics> {
        vec![Intrinsics::new(20.0, 21.0, 3.0, 2.6, 7, 6).unwrap(); n]
    }

    fn some_pairs() -> Vec<Pairs> {
        vec![Pairs { a: vec![8, 9, 30, 8], b: vec![17, 22, 11, 33] }, Pairs { a: vec![10, 25], b: vec![29, 9] }]
    }

    #[test]
    fn a_fold_has_the_cosine_of_its_angle() {
        // Two planes facing the camera and turned by the angle of (0.6, 0, 0.8): cosines 1 wanted, 0.8 found.
        let camera = cameras(1);
        let tilted = |u: f64, v: f64| 2.0 / (0.6 * camera[0].ray(u, v).x + 0.8);
        let depth = Tensor::from_fn(Shape::new(1, 1, 6, 7), |_, _, v, u| if u < 4 { 2.0 } else { tilted(u as f64, v as f64) });
        let flat = Tensor::full(depth.shape(), 5.0);
        let tape = Tape::new();
        // (1, 2) and (5, 2): one pair across the fold; the second pair within the flat part agrees.
        let pairs = [Pairs { a: vec![15, 15], b: vec![19, 22] }];
        let loss = relative_normal(tape.constant(depth), &flat, &camera, &pairs).value().item();
        assert!((loss - 0.1).abs() < 1e-9, "{loss}");
    }

    #[test]
    fn gradient_matches_finite_differences() {
        let depth = random(1, Shape::new(2, 1, 6, 7), 2.0, 2.5);
        let pseudo = random::<f64>(2, Shape::new(2, 1, 6, 7), 1.0, 1.5);
        let check = GradCheck { step: 1e-6, rtol: 1e-6, atol: 1e-8, ..GradCheck::default() };
        gradcheck(&[depth], |_, v| relative_normal(v[0], &pseudo, &cameras(2), &some_pairs()), check).assert_ok();
    }

    #[test]
    fn samples_may_lack_pairs_and_scales_do_not_matter() {
        let depth = random::<f64>(1, Shape::new(2, 1, 6, 7), 2.0, 2.5);
        let pseudo = random::<f64>(2, Shape::new(2, 1, 6, 7), 1.0, 1.5);
        let tape = Tape::new();
        let leaf = tape.leaf(depth.clone());
        let nothing = relative_normal(leaf, &pseudo, &cameras(2), &[Pairs::default(), Pairs::default()]);
        assert_eq!(nothing.value().item(), 0.0);
        assert!(tape.backward(nothing).wrt(leaf).data().iter().all(|&g| g == 0.0));
        let pairs = [some_pairs()[0].clone(), Pairs::default()];
        let loss = relative_normal(leaf, &pseudo, &cameras(2), &pairs);
        let grad = tape.backward(loss).wrt(leaf);
        assert!(grad.data()[42..].iter().all(|&g| g == 0.0) && grad.data()[..42].iter().any(|&g| g != 0.0));
        let scaled = relative_normal(leaf.scale(3.0), &pseudo, &cameras(2), &pairs).value().item();
        assert!((scaled - loss.value().item()).abs() < 1e-12);
    }

    #[test]
    fn a_depth_equal_to_the_pseudo_depth_costs_nothing_whatever_the_seed() {
        let depth = random::<f64>(1, Shape::new(2, 1, 6, 7), 2.0, 2.5);
        let image = random::<f64>(3, Shape::new(2, 3, 6, 7), 0.0, 1.0);
        let tape = Tape::new();
        let value = |pseudo: &Tensor<f64>, seed| {
            edge_guided_relative_normal(tape.constant(depth.clone()), pseudo, &image, &cameras(2), seed).value().item()
        };
        assert_eq!(value(&depth, 1), 0.0);
        let other = random::<f64>(2, Shape::new(2, 1, 6, 7), 1.0, 1.5);
        assert!(value(&other, 1) > 0.0 && value(&other, 1) == value(&other, 1) && value(&other, 1) != value(&other, 2));
    }
}
