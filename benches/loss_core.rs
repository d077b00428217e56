//! Warp, photometric error and minimum over sources, forward and backward, at 640 x 192 and at nano size.

use criterion::{Criterion, criterion_group, criterion_main};
use dimode::losses::flow_photometric::pixel_grid;
use dimode::losses::min_reprojection::min_reprojection;
use dimode::losses::photometric::photometric;
use dimode_autodiff::gradcheck::random;
use dimode_autodiff::ops::bilinear_sample::SamplePadding;
use dimode_autodiff::{Pool, Shape, Tape};
use dimode_benches::random_images;
use dimode_geometry::{Intrinsics, taped};

fn photometric_core(c: &mut Criterion) {
    for (n, h, w) in [(1, 192, 640), (4, 192, 640), (8, 64, 128)] {
        let shape = Shape::new(n, 3, h, w);
        let images = random_images(shape);
        let depth = random::<f32>(4, shape.with_c(1), 2.0, 40.0);
        let rotation = random::<f32>(5, Shape::new(n, 3, 1, 1), -0.01, 0.01);
        let translation = random::<f32>(6, Shape::new(n, 3, 1, 1), -0.5, 0.5);
        let focal = 0.6 * w as f64;
        let camera = Intrinsics::new(focal, focal, w as f64 / 2.0, h as f64 / 2.0, w, h).expect("a sane camera");
        let cameras = vec![camera; n];
        let pool = Pool::new();
        c.bench_function(&format!("warp + photometric + minimum/{w}x{h} b{n}"), |b| {
            b.iter(|| {
                let tape = Tape::with_pool(pool.clone());
                let (depth, w, t) = (tape.leaf(depth.clone()), tape.leaf(rotation.clone()), tape.leaf(translation.clone()));
                let target = tape.constant(images.target.clone());
                let grid = tape.constant(pixel_grid(depth.shape()));
                let error = |source: &dimode_autodiff::Tensor<f32>, invert| {
                    let pose = taped::source_from_target(w, t, invert, taped::RotationForm::Exponential);
                    let rigid = taped::rigid_flow(depth, pose.rotation, pose.translation, &cameras);
                    let coords = rigid.slice(1, 0, 2).add(grid);
                    photometric(tape.constant(source.clone()).bilinear_sample(coords, SamplePadding::Border), target)
                };
                let errors = [error(&images.previous, true), error(&images.next, false)];
                tape.backward(min_reprojection(&errors, &[]).error.mean())
            });
        });
    }
}

criterion_group!(benches, photometric_core);
criterion_main!(benches);
