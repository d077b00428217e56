use dimode_autodiff::gradcheck::random;
use dimode_autodiff::*;
use dimode_geometry::losses::*;
use dimode_geometry::taped::*;
use dimode_geometry::*;
use std::time::Instant;
#[test]
#[ignore]
fn timing() {
    let (n, h, w) = (16, 64, 128);
    let k = Intrinsics::new(100.0, 100.0, 64.0, 32.0, w, h).unwrap();
    let ks = vec![k; n];
    let m = Se3::from_rotation_vector(&nalgebra::Vector3::new(0.01, 0.02, 0.0), nalgebra::Vector3::new(0.1, 0.0, -0.5));
    let (r, t) = pose::pose_tensors::<f32>(&vec![m; n]);
    let z = random::<f32>(1, Shape::new(n, 1, h, w), 2.0, 20.0);
    let pool = Pool::new();
    let best = |name: &str, f: &dyn Fn() -> (f64, f64)| {
        let mut b = (f64::MAX, f64::MAX);
        for _ in 0..15 {
            let x = f();
            b = (b.0.min(x.0), b.1.min(x.1));
        }
        println!("{name}: forward {:.3} ms backward {:.3} ms", b.0 * 1e3, b.1 * 1e3);
    };
    best("rigid_flow", &|| {
        let tape = Tape::<f32>::with_pool(pool.clone());
        let v = [tape.leaf(z.clone()), tape.leaf(r.clone()), tape.leaf(t.clone())];
        let s = Instant::now();
        let y = rigid_flow(v[0], v[1], v[2], &ks);
        let a = s.elapsed().as_secs_f64();
        let l = y.sum();
        let s = Instant::now();
        let _ = tape.backward(l);
        (a, s.elapsed().as_secs_f64())
    });
    let f = { let tape = Tape::<f32>::new(); rigid_flow(tape.constant(z.clone()), tape.constant(r.clone()), tape.constant(t.clone()), &ks).slice(1, 0, 2).value() };
    best("align", &|| {
        let tape = Tape::<f32>::with_pool(pool.clone());
        let v = [tape.leaf(z.clone()), tape.leaf(r.clone()), tape.leaf(t.clone()), tape.constant(f.clone())];
        let s = Instant::now();
        let y = align(v[0], v[1], v[2], v[3], &ks);
        let a = s.elapsed().as_secs_f64();
        let l = y.sum();
        let s = Instant::now();
        let _ = tape.backward(l);
        (a, s.elapsed().as_secs_f64())
    });
    for (name, o) in [("pixels", LossOptions::pixels()), ("robust", LossOptions::robust())] {
        let mask = masks::everywhere(z.shape());
        best(name, &|| {
            let tape = Tape::<f32>::with_pool(pool.clone());
            let v = [tape.leaf(z.clone()), tape.leaf(z.clone()), tape.leaf(r.clone()), tape.leaf(t.clone()), tape.constant(f.clone())];
            let s = Instant::now();
            let p = AlignedPair::new(&PairInputs { target_depth: v[0], source_depth: v[1], rotation: v[2], translation: v[3], flow: v[4], intrinsics: &ks, mask: &mask }, &o);
            let b = s.elapsed().as_secs_f64();
            let l = planar(&p, &o).mean.add(axial(&p, &o).mean).add(tangential(&p, &o).mean).add(radial(&p, &o).mean);
            let a = s.elapsed().as_secs_f64();
            let s = Instant::now();
            let _ = tape.backward(l);
            let _ = b;
            (a, s.elapsed().as_secs_f64())
        });
    }
}
