//! Each loss by itself, forward and backward, on random depths and flows at 640 x 192.

use std::sync::Arc;

use criterion::{Criterion, criterion_group, criterion_main};
use dimode::losses::census::{CensusForm, census};
use dimode::losses::cross_task::cross_task;
use dimode::losses::depth_ranking::{depth_ranking, random_global_pairs};
use dimode::losses::local_structure::normal_matching;
use dimode::losses::photometric::photometric;
use dimode::losses::smoothness::smoothness;
use dimode_autodiff::{Pool, Shape, Tape, Tensor, Var};
use dimode_benches::Inputs;
use dimode_benches::camera::camera;
use dimode_geometry::Intrinsics;
use dimode_geometry::losses::{AlignedPair, LossOptions, LossTerm, PairInputs, axial, planar, radial, tangential};

const H: usize = 192;
const W: usize = 640;

/// A tensor of the drawn scene.
fn drawn(name: &str, c: usize) -> Tensor<f32> {
    Inputs::Drawn.tensor(name, Shape::new(1, c, H, W)).expect("drawn inputs are always there")
}

fn cameras() -> [Intrinsics; 1] {
    [camera(&Inputs::Drawn, H, W).expect("a drawn camera makes sense")]
}

/// Forward and backward of a loss of some leaves.
fn bench(c: &mut Criterion, name: &str, leaves: &[Tensor<f32>], loss: impl for<'t> Fn(&[Var<'t, f32>]) -> Var<'t, f32>) {
    let pool: Arc<Pool<f32>> = Pool::new();
    c.bench_function(name, |b| {
        b.iter(|| {
            let tape = Tape::with_pool(pool.clone());
            let leaves: Vec<_> = leaves.iter().map(|value| tape.leaf(value.clone())).collect();
            tape.backward_and_free(loss(&leaves))
        });
    });
}

type Geometric = for<'t> fn(&AlignedPair<'t, f32>, &LossOptions) -> LossTerm<'t, f32>;

fn geometric(c: &mut Criterion) {
    let losses: [(&str, Geometric); 4] = [("planar", planar), ("axial", axial), ("tangential", tangential), ("radial", radial)];
    let one = |name, shape| Inputs::Drawn.tensor(name, shape).expect("drawn inputs are always there");
    let leaves = [
        drawn("depth_t", 1),
        drawn("depth_s", 1),
        one("rotation", Shape::new(1, 1, 3, 3)),
        one("translation", Shape::new(1, 3, 1, 1)),
    ];
    let (flow, mask, cameras) = (drawn("flow", 2), drawn("mask", 1), cameras());
    for (form, options) in [("as printed", LossOptions::literal()), ("in pixels", LossOptions::default())] {
        for (name, loss) in losses {
            bench(c, &format!("{name}, {form}"), &leaves, |v| {
                let inputs = PairInputs {
                    target_depth: v[0],
                    source_depth: v[1],
                    flow: v[0].tape().constant(flow.clone()),
                    rotation: v[2],
                    translation: v[3],
                    intrinsics: &cameras,
                    mask: &mask,
                };
                loss(&AlignedPair::new(&inputs, &options), &options).mean
            });
        }
    }
}

fn images(c: &mut Criterion) {
    let (target, next, mask) = (drawn("target", 3), drawn("next", 3), drawn("mask", 1));
    bench(c, "photometric", std::slice::from_ref(&next), |v| photometric(v[0], v[0].tape().constant(target.clone())).mean());
    bench(c, "smoothness", &[drawn("depth_t", 1)], |v| smoothness(v[0].recip(), &target));
    bench(c, "census", &[next], |v| census(v[0], v[0].tape().constant(target.clone()), &mask, CensusForm::ArFlow));
}

fn depth_and_flow(c: &mut Criterion) {
    let (depth, pseudo, mask, cameras) = (drawn("depth_t", 1), drawn("depth_s", 1), drawn("mask", 1), cameras());
    bench(c, "normal matching", std::slice::from_ref(&depth), |v| normal_matching(v[0], &pseudo, &cameras));
    let pairs = random_global_pairs(H * W, 1);
    bench(c, "depth ranking", &[depth], |v| depth_ranking(v[0], &pseudo, &pairs, &[Vec::new()]));
    bench(c, "cross task", &[drawn("flow", 2), drawn("other flow", 2)], |v| cross_task(v[0], v[1], &mask));
}

criterion_group!(benches, geometric, images, depth_and_flow);
criterion_main!(benches);
