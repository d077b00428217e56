//! Trivial answers, options, sizes, errors.

use super::{dataset, mean, warp_error};
use crate::data::synthetic::{Preset, Split, SyntheticConfig};
use crate::data::{Dataset, Frame, Map};

/// Absolute relative error of a predicted depth after scaling by the ratio of medians, over known pixels up to 80 m.
fn scaled_error(prediction: &[f64], truth: &Map) -> f64 {
    let pairs: Vec<(f64, f64)> =
        prediction.iter().zip(&truth.data).map(|(p, t)| (*p, f64::from(*t))).filter(|(_, t)| *t > 0.0 && *t <= 80.0).collect();
    let median = |mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    let scale = median(pairs.iter().map(|x| x.1).collect()) / median(pairs.iter().map(|x| x.0).collect());
    mean(&pairs.iter().map(|(p, t)| (scale * p - t).abs() / t).collect::<Vec<_>>())
}

#[test]
fn trivial_depth_is_a_bad_answer_for_street() {
    let train = dataset(Preset::Street, |_| ());
    let held_out = dataset(Preset::Street, |c| c.split = Split::HeldOut);
    let plane = train.intrinsics().width * train.intrinsics().height;
    let (mut disparity, mut count) = (vec![0.0; plane], vec![0.0; plane]);
    for sequence in 0..40 {
        for frame in [4, 24] {
            let depth = train.frame(sequence, frame).unwrap().depth.clone().unwrap();
            for (i, z) in depth.data.iter().enumerate().filter(|(_, z)| **z > 0.0) {
                disparity[i] += 1.0 / f64::from(*z);
                count[i] += 1.0;
            }
        }
    }
    let mean_map: Vec<f64> = disparity.iter().zip(&count).map(|(d, n)| f64::max(*n, 1.0) / d.max(0.0125)).collect();
    let errors = |prediction: &[f64]| {
        mean(
            &(0..20)
                .map(|s| scaled_error(prediction, held_out.frame(s, 15).unwrap().depth.as_ref().unwrap()))
                .collect::<Vec<_>>(),
        )
    };
    let (constant, map) = (errors(&vec![1.0; plane]), errors(&mean_map));
    println!("street, held out: AbsRel of constant depth {constant:.3}, of the mean disparity map {map:.3}");
    assert!(constant > 0.3, "{constant}");
    assert!(map > 0.2, "{map}");
}

#[test]
fn moving_object_is_seen_flows_on_its_own_and_is_never_visible() {
    for preset in Preset::ALL {
        let data = dataset(preset, |c| c.moving_object = true);
        let (mut seen, mut own) = (0, 0);
        for sequence in 0..6 {
            for frame in [3, 10, 17, 24] {
                let mask = data.moving_mask(sequence, frame).unwrap();
                let truth = data.pair_truth(sequence, frame, frame + 1).unwrap().unwrap();
                let target = data.frame(sequence, frame).unwrap();
                for i in (0..mask.len()).filter(|&i| mask[i]) {
                    assert!(!truth.visible[i]);
                    let (u, v) = ((i % mask_width(&target)) as f64, (i / mask_width(&target)) as f64);
                    let z = f64::from(target.depth.as_ref().unwrap().data[i]);
                    let point = truth.source_from_target.transform(&(target.intrinsics.ray(u, v) * z));
                    let rigid = target.intrinsics.project(&point).unwrap();
                    let gap = (rigid.x - u - f64::from(truth.flow.u[i])).hypot(rigid.y - v - f64::from(truth.flow.v[i]));
                    seen += 1;
                    own += usize::from(gap > 0.3);
                }
            }
        }
        assert!(seen > 500, "{preset}: {seen} pixels");
        assert!(own * 3 > seen, "{preset}: {own} of {seen}");
        assert!(!dataset(preset, |_| ()).moving_mask(0, 0).unwrap().contains(&true));
    }
}

fn mask_width(frame: &Frame) -> usize {
    frame.intrinsics.width
}

#[test]
fn options_change_the_image_but_not_the_geometry() {
    let plain = dataset(Preset::Street, |_| ()).frame(0, 6).unwrap();
    let brightness = |frame: &Frame| mean(&frame.image.data.iter().map(|x| f64::from(*x)).collect::<Vec<_>>());
    let changes: [fn(&mut SyntheticConfig); 3] = [|c| c.noise = 0.03, |c| c.exposure = 0.2, |c| c.night = true];
    for change in changes {
        let other = dataset(Preset::Street, change).frame(0, 6).unwrap();
        assert_ne!(plain.image, other.image);
        assert_eq!(plain.depth, other.depth);
        assert_eq!(plain.world_from_camera, other.world_from_camera);
        assert!(other.image.data.iter().all(|x| (0.0..=1.0).contains(x)));
    }
    let night = dataset(Preset::Street, |c| c.night = true).frame(0, 6).unwrap();
    assert!(brightness(&night) < 0.6 * brightness(&plain));
}

#[test]
fn other_sizes_render_exactly() {
    let data = dataset(Preset::Handheld, |c| (c.width, c.height) = (75, 41));
    let (target, source) = (data.frame(2, 4).unwrap(), data.frame(2, 5).unwrap());
    assert_eq!((target.image.width, target.image.height), (75, 41));
    assert_eq!((target.intrinsics.u0, target.intrinsics.v0), (37.0, 20.0));
    let error = warp_error(&target, &source, &data.pair_truth(2, 4, 5).unwrap().unwrap());
    assert!(error < 0.02, "{error}");
}

#[test]
fn numbers_out_of_range_are_named() {
    let data = dataset(Preset::Lateral, |c| (c.sequences, c.frames) = (2, 5));
    assert!(data.frame(2, 0).unwrap_err().to_string().contains("sequence 2"));
    assert!(data.pair_truth(0, 0, 5).unwrap_err().to_string().contains("frame 5"));
    assert_eq!((data.sequence_count(), data.sequence_len(1)), (2, 5));
}
