//! The index of operations: one file each, with formula, forward kernel, vector-Jacobian product and tests.

mod abs;
mod acos;
mod add;
mod add_scalar;
mod atan2;
mod avg_pool2d;
mod axis;
pub mod batch_norm;
mod batch_norm_activated;
pub mod bilinear_sample;
mod binary;
mod blocks;
mod box_mean;
mod broadcast_to;
mod clamp;
mod concat;
pub(crate) mod conv;
pub mod conv2d;
mod conv2d_activated;
mod convex_upsample;
mod correlation;
mod correlation_lookup;
mod cos;
mod div;
pub mod drop_path;
mod elu;
mod exp;
pub mod extremum;
mod gather;
mod gelu;
mod instance_norm;
pub mod kernel;
mod l2_normalise;
mod layer_norm;
mod linear;
mod ln;
mod log1p_exp;
mod lookup_window;
mod masked_mean;
pub mod matmul;
mod max_axis;
mod max_pool2d;
mod maximum;
mod mean;
mod mean_channels;
mod mean_hw;
mod mean_to;
mod min_axis;
mod min_max;
mod minimum;
mod mul;
mod neg;
mod norm;
pub mod pad;
mod pad_reflect;
mod pad_replicate;
mod pad_zero;
mod permute;
mod planes;
mod powf;
mod recip;
mod reduce;
mod relu;
mod reshape;
mod resize_bilinear;
mod resize_nearest;
mod sample_axis;
mod scale;
mod select;
mod sigmoid;
mod sin;
mod slice;
mod softmax;
mod sqrt;
mod sqrt_guarded;
mod square;
mod sub;
mod sum;
mod sum_chw;
mod sum_to;
mod tanh;
#[cfg(test)]
mod testing;
mod unary;
mod upsample_nearest;
mod weighted_l1;
mod window_correlation;

use crate::proof::Proof;

/// The proof of every operation.
pub(crate) fn proofs() -> Vec<Proof> {
    vec![
        abs::proof(),
        acos::proof(),
        add::proof(),
        add_scalar::proof(),
        atan2::proof(),
        avg_pool2d::proof(),
        batch_norm::proof(),
        batch_norm::eval_proof(),
        batch_norm_activated::proof(),
        batch_norm_activated::eval_proof(),
        bilinear_sample::proof(),
        box_mean::proof(),
        broadcast_to::proof(),
        clamp::proof(),
        concat::proof(),
        conv2d::proof(),
        conv2d_activated::proof(),
        convex_upsample::proof(),
        correlation::proof(),
        correlation_lookup::proof(),
        cos::proof(),
        div::proof(),
        div::guarded_proof(),
        drop_path::proof(),
        elu::proof(),
        exp::proof(),
        gather::proof(),
        gelu::proof(),
        instance_norm::proof(),
        l2_normalise::proof(),
        layer_norm::proof(),
        linear::proof(),
        ln::proof(),
        log1p_exp::proof(),
        masked_mean::proof(),
        matmul::proof(),
        matmul::attributes_proof(),
        matmul::transpose_proof(),
        max_axis::proof(),
        max_pool2d::proof(),
        maximum::proof(),
        mean::proof(),
        mean_channels::proof(),
        mean_hw::proof(),
        mean_to::proof(),
        min_axis::proof(),
        min_max::proof(),
        minimum::proof(),
        mul::proof(),
        neg::proof(),
        pad_reflect::proof(),
        pad_replicate::proof(),
        pad_zero::proof(),
        permute::proof(),
        powf::proof(),
        recip::proof(),
        relu::proof(),
        reshape::proof(),
        resize_bilinear::proof(),
        resize_nearest::proof(),
        scale::proof(),
        select::proof(),
        sigmoid::proof(),
        sin::proof(),
        slice::proof(),
        softmax::proof(),
        sqrt::proof(),
        sqrt_guarded::proof(),
        square::proof(),
        sub::proof(),
        sum::proof(),
        sum_chw::proof(),
        sum_to::proof(),
        tanh::proof(),
        upsample_nearest::proof(),
        weighted_l1::proof(),
        window_correlation::proof(),
    ]
}
