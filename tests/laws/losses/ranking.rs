//! Confident depth ranking.

use dimode::losses::depth_ranking::{Pair, depth_ranking};
use dimode_autodiff::gradcheck::random;
use dimode_autodiff::{GradCheck, Scalar, Shape, Tensor, Var};

use crate::scenes::{maps, mask};
use crate::support::{Loss, Scene, assert_finite, assert_gradient, assert_nothing, assert_order_free, assert_silent, map};

const GLOBAL: [Pair; 4] = [[1, 9], [12, 4], [3, 28], [40, 41]];

/// The leaf is the depth; data are the pseudo-depth and the number of each sample, by which it has its own dynamic pairs.
#[derive(Debug)]
struct Ranking;

impl Loss for Ranking {
    fn of<'t, T: Scalar>(&self, v: &[Var<'t, T>], scene: &Scene) -> Var<'t, T> {
        let lists = [vec![[2, 17], [30, 5]], vec![[8, 22]], vec![]];
        let dynamic: Vec<_> = scene.data[1].data().iter().map(|&n| lists[n as usize].clone()).collect();
        depth_ranking(v[0], &scene.data(0), &GLOBAL, &dynamic)
    }
}

fn scene(seed: u64) -> Scene {
    let numbers = Tensor::from_vec(Shape::new(3, 1, 1, 1), vec![0.0, 1.0, 2.0]);
    let pseudo = random::<f64>(seed + 1, maps(3), 1.0, 3.0);
    Scene { leaves: vec![random(seed, maps(3), 1.0, 3.0)], data: vec![pseudo, numbers], cameras: vec![] }
}

#[test]
fn gradients_are_right_and_the_order_does_not_matter() {
    for seed in [10, 20, 30] {
        assert_gradient(&Ranking, &scene(seed), GradCheck::default());
        assert_order_free(&Ranking, &scene(seed));
    }
}

#[test]
fn pixels_without_a_pair_are_silent_whatever_stands_there() {
    let touched = [GLOBAL.to_vec().concat(), vec![2, 17, 30, 5, 8, 22]].concat();
    assert_silent(&Ranking, &scene(40), &[Some(mask(3, |_, h, w| touched.contains(&(8 * h + w))))]);
}

#[test]
fn numbers_are_finite_at_equal_huge_and_missing_depths() {
    assert_finite(&Ranking, &scene(50).scaled(&[0], 0.0));
    assert_finite(&Ranking, &scene(50).scaled(&[0], 1e6));
    assert_finite(&Ranking, &scene(50).scaled(&[0], -1e6));
    let pseudo = scene(50).data[0].clone();
    assert_nothing(&Ranking, &scene(50).with_data(0, map(&pseudo, |_| 2.0)));
    for missing in [f64::NAN, 0.0, f64::INFINITY] {
        let holes = Tensor::from_fn(maps(3), |n, _, h, w| if (h + w) % 3 == 0 { missing } else { pseudo.at(n, 0, h, w) });
        assert_finite(&Ranking, &scene(50).with_data(0, holes));
        assert_nothing(&Ranking, &scene(50).with_data(0, map(&pseudo, |_| missing)));
    }
}

#[test]
fn the_scale_of_the_pseudo_depth_does_not_matter() {
    let scene = scene(60);
    let scaled = scene.clone().with_data(0, map(&scene.data[0], |x| 4.0 * x));
    assert_eq!(crate::support::value(&Ranking, &scene), crate::support::value(&Ranking, &scaled));
}
