//! What every depth network promises, at nano size.

use dimode_autodiff::{Shape, Tape, Tensor, par};
use dimode_nets::{Binder, DepthNet, DepthNetKind, Mode, Network, ParamSet, fill};

const NANO: [DepthNetKind; 3] = [DepthNetKind::NanoResnet, DepthNetKind::NanoLiteMono, DepthNetKind::NanoDHrNet];
const BATCH: usize = 2;

/// Hashed texture in [0, 1).
fn images() -> Tensor<f32> {
    let shape = Shape::new(BATCH, 3, 64, 96);
    Tensor::from_vec(shape, (0..shape.len()).map(|i| (0.5 + 0.5 * fill::unit("image", i)) as f32).collect())
}

/// The network with the test values of the parity tests, under which every block has its say.
fn filled(kind: DepthNetKind) -> (DepthNet, ParamSet<f32>) {
    let net = DepthNet::new(kind.config());
    let params = net.blueprint().filled(|_| 0.8);
    (net, params)
}

/// Bits of the finest disparity and of all gradients.
fn bits(kind: DepthNetKind, mode: Mode, randomness: Option<(u64, u64)>) -> Vec<u32> {
    let (net, params) = filled(kind);
    let tape = Tape::new();
    let mut binder = Binder::new(&tape, &params, mode);
    if let Some((seed, step)) = randomness {
        binder = binder.random(seed, step);
    }
    let disparity = net.forward(&mut binder, tape.constant(images()))[0];
    let gradients = binder.gradients(&tape.backward(disparity.square().mean()));
    let tensors = std::iter::once(disparity.value()).chain(gradients.into_iter().map(|g| g.gradient));
    tensors.flat_map(|tensor| tensor.data().iter().map(|v| v.to_bits()).collect::<Vec<_>>()).collect()
}

#[test]
fn fresh_depth_is_sane_and_every_scale_has_its_size() {
    for kind in NANO {
        let net = DepthNet::new(kind.config());
        let params = net.init::<f32>(1);
        let tape = Tape::new();
        let mut binder = Binder::new(&tape, &params, Mode::Train).random(1, 1);
        let disparities = net.forward(&mut binder, tape.constant(images()));
        assert_eq!(disparities.len(), net.scales());
        for (scale, disparity) in disparities.iter().enumerate() {
            assert_eq!(disparity.shape(), Shape::new(BATCH, 1, 64 >> scale, 96 >> scale), "{kind}");
            assert!(disparity.value().data().iter().all(|&d| d > 0.0 && d < 1.0), "{kind}");
        }
    }
}

#[test]
fn depth_of_a_batch_is_that_of_its_images() {
    for kind in NANO {
        let (net, params) = filled(kind);
        let both = net.predict(&params, &images());
        for n in 0..BATCH {
            let planes = (0..3).flat_map(|c| images().plane(n, c).to_vec()).collect();
            let alone = net.predict(&params, &Tensor::from_vec(Shape::new(1, 3, 64, 96), planes));
            for (a, b) in both.plane(n, 0).iter().zip(alone.data()) {
                assert!((a - b).abs() <= 1e-6, "{kind}: {a} against {b}");
            }
        }
    }
}

#[test]
fn every_parameter_learns_but_those_that_the_reference_never_uses() {
    for kind in NANO {
        let (net, params) = filled(kind);
        let tape = Tape::new();
        let mut binder = Binder::new(&tape, &params, Mode::Train);
        let disparities = net.forward(&mut binder, tape.constant(images()));
        let losses = disparities.iter().map(|d| d.square().mean());
        let loss = losses.reduce(|a, b| a.add(b)).unwrap();
        for item in binder.gradients(&tape.backward(loss)) {
            let moves = item.gradient.data().iter().any(|&g| g != 0.0);
            // Convolution blocks of Lite-Mono, those with a `bn1`, carry a layer normalisation that is never run.
            let block = item.path.split_once(".norm.").map(|(block, _)| format!("{block}.bn1.weight"));
            let unused = block.is_some_and(|norm| params.get(&norm).is_some());
            assert_eq!(moves, !unused, "{kind}: {}", item.path);
        }
    }
}

#[test]
fn the_number_of_threads_does_not_change_a_bit() {
    for kind in NANO {
        let [one, three] = [1, 3].map(|threads| par::with_threads(threads, || bits(kind, Mode::Train, Some((1, 1)))));
        assert!(one == three, "{kind}: results differ between 1 and 3 threads");
    }
}

#[test]
fn only_lite_mono_drops_paths_and_only_in_training() {
    for kind in NANO {
        let lite = kind == DepthNetKind::NanoLiteMono;
        let still = bits(kind, Mode::Train, None);
        let random = |step| bits(kind, Mode::Train, Some((1, step)));
        assert!(random(3) == random(3), "{kind}");
        // One step may keep everything; not many.
        assert_eq!((0..8).any(|step| random(step) != still), lite, "{kind}");
        assert!(bits(kind, Mode::Eval, Some((1, 3))) == bits(kind, Mode::Eval, None), "{kind}");
    }
}

#[test]
fn unfit_images_are_refused_with_what_fits() {
    for (kind, expected) in NANO.into_iter().zip([
        "the ResNet depth network needs sides that are multiples of 32, at least 64; images of 96x40 do not fit",
        "Lite-Mono needs sides that are multiples of 16, at least 32; images of 96x40 do not fit",
        "D-HRNet needs sides that are multiples of 32, at least 64; images of 96x40 do not fit",
    ]) {
        let (net, params) = filled(kind);
        assert_eq!(net.check_size(40, 96).unwrap_err().to_string(), expected);
        let run = || net.predict(&params, &Tensor::full(Shape::new(1, 3, 40, 96), 0.5));
        let message = std::panic::catch_unwind(std::panic::AssertUnwindSafe(run)).unwrap_err();
        assert_eq!(message.downcast_ref::<String>().unwrap(), expected);
    }
}
