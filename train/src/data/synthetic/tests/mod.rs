//! Laws of rendered worlds: warping, contrast, depth, flow, visibility, determinism.

mod motion;
mod options;

use dimode_autodiff::par;

use super::{Preset, Split, SyntheticConfig, SyntheticDataset};
use crate::data::{Dataset, Frame, PairTruth};

fn dataset(preset: Preset, change: impl FnOnce(&mut SyntheticConfig)) -> SyntheticDataset {
    let mut config = SyntheticConfig { preset, sequences: 1000, ..SyntheticConfig::default() };
    change(&mut config);
    SyntheticDataset::new(config).unwrap()
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Bilinear weights of the four pixels around a place inside the image: (pixel, weight).
fn corners(width: usize, height: usize, x: f32, y: f32) -> [(usize, f32); 4] {
    let (x0, y0) = (x as usize, y as usize);
    let (x1, y1) = ((x0 + 1).min(width - 1), (y0 + 1).min(height - 1));
    let (fx, fy) = (x - x0 as f32, y - y0 as f32);
    [
        (y0 * width + x0, (1.0 - fx) * (1.0 - fy)),
        (y0 * width + x1, fx * (1.0 - fy)),
        (y1 * width + x0, (1.0 - fx) * fy),
        (y1 * width + x1, fx * fy),
    ]
}

/// Mean absolute difference over visible pixels between the target and the source warped by true depth and pose.
fn warp_error(target: &Frame, source: &Frame, truth: &PairTruth) -> f64 {
    let (width, height) = (target.image.width, target.image.height);
    let depth = target.depth.as_ref().unwrap();
    let (mut sum, mut count) = (0.0, 0usize);
    for v in 0..height {
        for u in 0..width {
            if !truth.visible[v * width + u] {
                continue;
            }
            let point = target.intrinsics.ray(u as f64, v as f64) * f64::from(depth.at(v, u));
            let seen = truth.source_from_target.transform(&point);
            let place = source.intrinsics.project(&seen).unwrap();
            let x = place.x.clamp(0.0, width as f64 - 1.0) as f32;
            let y = place.y.clamp(0.0, height as f64 - 1.0) as f32;
            for channel in 0..3 {
                let plane = source.image.plane(channel);
                let warped: f32 = corners(width, height, x, y).iter().map(|&(i, w)| w * plane[i]).sum();
                sum += f64::from((warped - target.image.at(channel, v, u)).abs());
                count += 1;
            }
        }
    }
    assert!(count > width * height / 2, "too few visible pixels: {count} values");
    sum / count as f64
}

#[test]
fn true_depth_and_pose_warp_the_source_onto_the_target() {
    for preset in Preset::ALL {
        let mut errors = Vec::new();
        for seed in 0..4 {
            let data = dataset(preset, |c| c.seed = seed);
            for (sequence, frame) in [(0, 3), (1, 12), (2, 21), (3, 29)] {
                for source in [frame - 1, frame + 1] {
                    let truth = data.pair_truth(sequence, frame, source).unwrap().unwrap();
                    let target = data.frame(sequence, frame).unwrap();
                    let source = data.frame(sequence, source).unwrap();
                    errors.push(warp_error(&target, &source, &truth));
                }
            }
        }
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        let worst = errors.iter().copied().fold(0.0, f64::max);
        println!("{preset}: warp error mean {mean:.4}, worst pair {worst:.4}");
        assert!(mean < 0.016, "{preset}: mean {mean}");
        assert!(worst < 0.02, "{preset}: worst {worst}");
    }
}

#[test]
fn images_have_contrast_everywhere_that_matters() {
    for preset in Preset::ALL {
        let data = dataset(preset, |_| ());
        let (mut overall, mut ground) = (0.0, 0.0);
        for sequence in 0..8 {
            let frame = data.frame(sequence, 10).unwrap();
            let (w, h) = (frame.image.width, frame.image.height);
            let grey = |i: usize| (0..3).map(|c| f64::from(frame.image.plane(c)[i])).sum::<f64>() / 3.0;
            let deviation = |rows: std::ops::Range<usize>| {
                let values: Vec<f64> = (rows.start * w..rows.end * w).map(grey).collect();
                let mean = values.iter().sum::<f64>() / values.len() as f64;
                (values.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / values.len() as f64).sqrt()
            };
            overall += deviation(0..h) / 8.0;
            ground += deviation(3 * h / 4..h) / 8.0;
        }
        println!("{preset}: deviation of intensity {overall:.3}, lowest quarter {ground:.3}");
        assert!((0.1..0.3).contains(&overall), "{preset}: {overall}");
        assert!(ground > 0.07, "{preset}: {ground}");
    }
}

#[test]
fn depth_is_known_nearly_everywhere_and_within_range() {
    for (preset, range, known) in
        [(Preset::Street, 1.0..90.0, 0.85), (Preset::Handheld, 0.35..16.0, 0.9), (Preset::Lateral, 1.2..45.0, 0.95)]
    {
        let data = dataset(preset, |_| ());
        let (mut count, mut with_depth) = (0, 0);
        for sequence in 0..20 {
            for value in &data.frame(sequence, 15).unwrap().depth.as_ref().unwrap().data {
                count += 1;
                with_depth += usize::from(*value > 0.0);
                assert!(*value == 0.0 || range.contains(value), "{preset}: depth {value}");
            }
        }
        assert!(with_depth as f64 > known * count as f64, "{preset}: {with_depth} of {count}");
    }
}

#[test]
fn forward_and_backward_flow_cancel_where_visible() {
    for preset in Preset::ALL {
        let data = dataset(preset, |c| c.moving_object = true);
        for sequence in 0..3 {
            let there = data.pair_truth(sequence, 8, 10).unwrap().unwrap();
            let back = data.pair_truth(sequence, 10, 8).unwrap().unwrap();
            let product = there.source_from_target * back.source_from_target;
            assert!((product.rotation - nalgebra::Matrix3::identity()).norm() < 1e-12);
            assert!(product.translation.norm() < 1e-12);
            let (w, h) = (there.flow.width, there.flow.height);
            let mut gaps = Vec::new();
            for i in (0..w * h).filter(|&i| there.visible[i]) {
                let x = (i % w) as f32 + there.flow.u[i];
                let y = (i / w) as f32 + there.flow.v[i];
                let near = corners(w, h, x.clamp(0.0, w as f32 - 1.0), y.clamp(0.0, h as f32 - 1.0));
                if near.iter().all(|&(j, _)| back.visible[j]) {
                    let mean = |flow: &[f32]| near.iter().map(|&(j, k)| k * flow[j]).sum::<f32>();
                    gaps.push((mean(&back.flow.u) + there.flow.u[i]).hypot(mean(&back.flow.v) + there.flow.v[i]));
                }
            }
            gaps.sort_by(f32::total_cmp);
            assert!(gaps.len() > w * h / 3);
            assert!(gaps[gaps.len() / 2] < 0.01, "median {}", gaps[gaps.len() / 2]);
            assert!(gaps[gaps.len() * 9 / 10] < 0.15, "nine of ten {}", gaps[gaps.len() * 9 / 10]);
        }
    }
}

#[test]
fn truth_of_a_frame_with_itself_is_no_motion() {
    let data = dataset(Preset::Handheld, |_| ());
    let truth = data.pair_truth(0, 5, 5).unwrap().unwrap();
    let depth = data.frame(0, 5).unwrap().depth.clone().unwrap();
    assert!(truth.flow.u.iter().chain(&truth.flow.v).all(|x| x.abs() < 1e-9));
    assert!(truth.visible.iter().zip(&depth.data).all(|(&seen, &z)| seen == (z > 0.0)));
}

#[test]
fn ray_casting_and_rendering_see_the_same_depth() {
    for preset in Preset::ALL {
        let data = dataset(preset, |c| c.moving_object = true);
        let world = data.world(4);
        let k = data.intrinsics();
        let view = super::raycast::View::new(&world, 7, &k);
        let frame = data.frame(4, 7).unwrap();
        let depth = frame.depth.as_ref().unwrap();
        for (v, u) in (0..k.height).flat_map(|v| (0..k.width).map(move |u| (v, u))) {
            let cast = view.cast(u as f64, v as f64).map_or(0.0, |hit| hit.depth as f32);
            assert_eq!(cast, depth.at(v, u), "{preset} pixel ({u}, {v})");
        }
    }
}

#[test]
fn same_bits_for_any_number_of_threads_and_any_order() {
    for preset in Preset::ALL {
        let all: Vec<(usize, usize)> = (0..3).flat_map(|s| (0..4).map(move |f| (s, 3 * f))).collect();
        let render = |threads: usize, options: fn(&mut SyntheticConfig)| -> Vec<Vec<u32>> {
            let data = dataset(preset, options);
            let bits = |i: usize| {
                let (s, f) = all[i];
                data.frame(s, f).unwrap().image.data.iter().map(|x| x.to_bits()).collect()
            };
            par::with_threads(threads, || par::map_indices(all.len(), bits))
        };
        let options: fn(&mut SyntheticConfig) = |c| (c.noise, c.exposure, c.moving_object) = (0.02, 0.1, true);
        assert_eq!(render(1, options), render(4, options));
        assert_ne!(render(1, options), render(1, |c| c.seed = 1));
    }
}

#[test]
fn worlds_differ_by_seed_split_and_sequence() {
    for preset in Preset::ALL {
        let first = |change: fn(&mut SyntheticConfig), sequence| {
            let frame = dataset(preset, change).frame(sequence, 0).unwrap();
            (frame.image.data.clone(), frame.depth.clone().unwrap().data)
        };
        let base = first(|_| (), 0);
        for other in [first(|c| c.seed = 1, 0), first(|c| c.split = Split::HeldOut, 0), first(|_| (), 1)] {
            let apart = |a: &[f32], b: &[f32]| a.iter().zip(b).filter(|(x, y)| (*x - *y).abs() > 0.01).count();
            assert!(apart(&base.0, &other.0) > base.0.len() / 2);
            assert!(apart(&base.1, &other.1) > base.1.len() / 4);
        }
    }
}
