//! Whole training steps: of the nano networks at 128 x 64, one in each stage; in the manner of Monodepth2 with networks of a
//! quarter of its width at 192 x 64, and of its full size at 640 x 192; with the paper's networks, all three trained.

use criterion::{Criterion, criterion_group, criterion_main};
use dimode::config::{Config, FirstWeights};
use dimode::model::Model;
use dimode::optim::adamw::State;
use dimode::trainer::Trainer;
use dimode_benches::criteria::bench_case;
use dimode_benches::ours::step::StepCase;
use dimode_benches::rendered_batch;

fn steps(c: &mut Criterion) {
    let mut config = Config::default();
    config.nets.flow_weights = FirstWeights::Random;
    config.nets.pose_weights = FirstWeights::Random;
    let batch = rendered_batch(&config);
    let weights = Model::new(&config.nets).init(1);
    let mut group = c.benchmark_group("training step");
    group.sample_size(10);
    for stage in config.train.stages.clone() {
        let mut trainer = Trainer::new(&config, weights.clone(), State::default());
        group.bench_function(&stage.name, |b| {
            b.iter(|| trainer.step(&batch, None, &stage, 1, 1e-4, false).expect("a finite step"));
        });
    }
    group.finish();
}

fn large(c: &mut Criterion) {
    for case in [StepCase::nano(4), StepCase::monodepth2(1), StepCase::paper()] {
        bench_case(c, &case);
    }
}

criterion_group!(benches, steps, large);
criterion_main!(benches);
