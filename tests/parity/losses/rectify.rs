//! Removal of rotation, and the losses of the network that learns it.

use dimode::losses::rectify::{rotation_consistency, rotation_triplet};
use dimode_autodiff::{Scalar, Shape, Tape};
use dimode_geometry::taped::so3_exp::rotation_matrix;
use dimode_geometry::taped::{RotationForm, derotate, rotated_pixels};

use crate::compared::Compared;

fn rectify_in<T: Scalar>() {
    let golden = Compared::<T>::open("rectify");
    let cameras = golden.cameras();
    let tape = Tape::new();
    let (image, angles) = (tape.leaf(golden.map("in.image")), tape.leaf(golden.vectors("in.rot")));
    let rotation = rotation_matrix(angles, RotationForm::Euler);
    golden.matches("out.pix", &rotated_pixels(rotation, &cameras).value());
    let warped = derotate(image, rotation, &cameras);
    golden.matches("out.warped", &warped.value());
    let grads = tape.backward(warped.mul(tape.constant(golden.map("in.w"))).sum());
    golden.gradients_match("grad", &grads, &[("image", image), ("rot", angles)]);

    let said = |k: usize| golden.golden().tensor(&format!("in.rot{k}"), Shape::new(4, 3, 1, 1));
    let [first, second, third] = [1, 2, 3].map(|k| tape.leaf(said(k)));
    let consistency = rotation_consistency(third, &golden.vectors("in.rot3_gt"));
    let triplet = rotation_triplet(first, second);
    golden.matches("out.rot_consistency", &consistency.value());
    golden.matches("out.rot_triplet", &triplet.value());
    let grads = tape.backward(consistency.add(triplet));
    golden.gradients_match("grad_rot", &grads, &[("rot1", first), ("rot2", second), ("rot3", third)]);
    golden.finish();
}

#[test]
fn rotation_removal_and_its_losses() {
    rectify_in::<f64>();
    rectify_in::<f32>();
}
