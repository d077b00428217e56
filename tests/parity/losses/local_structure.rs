//! Normals, the losses of SC-DepthV3 that use a pseudo-depth, and the pseudo-depth without a teacher.

use dimode::losses::depth_ranking::{Pair, depth_ranking, dynamic_pairs, global_pairs, unreliable};
use dimode::losses::edge_pairs::{Draws, EdgeMaps, Edges, Pairs, candidates, edge_maps, pairs};
use dimode::losses::guided_filter::{filtered_inverse, luminance, self_guided_with};
use dimode::losses::local_structure::{normal_matching, normals};
use dimode::losses::relative_normal::relative_normal;
use dimode_autodiff::{Scalar, Tape, Tensor};

use crate::compared::Compared;

fn normals_in<T: Scalar>() {
    let golden = Compared::<T>::open("normals");
    let tape = Tape::new();
    let depth = tape.leaf(golden.map("in.depth"));
    let found = normals(depth, &golden.cameras());
    golden.matches("out.normals", &found.value());
    let loss = found.mul(tape.constant(golden.map("in.w"))).sum();
    golden.gradients_match("grad", &tape.backward(loss), &[("depth", depth)]);
    golden.finish();
}

#[test]
fn normals_of_a_depth_map() {
    normals_in::<f64>();
    normals_in::<f32>();
}

fn pseudo_depth_in<T: Scalar>() {
    let golden = Compared::<T>::open("pseudo_guided");
    let (depth, image) = (golden.map("in.depth"), golden.map("in.image"));
    golden.numbers_match("out.guide", &[luminance(&image, 0), luminance(&image, 1)].concat());
    golden.numbers_match("out.filtered", &filtered_inverse(&depth, &image, 4));
    golden.matches("out.pseudo_depth", &self_guided_with(&depth, &image, 4));
    golden.finish();
}

#[test]
fn self_guided_pseudo_depth() {
    pseudo_depth_in::<f64>();
    pseudo_depth_in::<f32>();
}

fn normal_losses<T: Scalar>(golden: &Compared<T>) {
    let (cameras, pseudo) = (golden.cameras(), golden.map("in.pseudo_depth"));
    let tape = Tape::new();
    let depth = tape.leaf(golden.map("in.depth"));
    golden.matches("out.normals", &normals(depth, &cameras).value());
    let pseudo_normals = normals(tape.constant(pseudo.clone()), &cameras).value();
    golden.matches("out.pseudo_normals", &pseudo_normals);
    let matching = normal_matching(depth, &pseudo, &cameras);
    golden.matches("out.normal_matching", &matching.value());
    golden.gradients_match("grad_normal_matching", &tape.backward(matching), &[("depth", depth)]);
    let edges = edge_maps(&golden.map("in.image"), &pseudo_normals, &pseudo);
    compare_edges(golden, &edges);
    let found: Vec<Pairs> = (0..2).map(|n| pairs_of_sample(golden, &edges, n)).collect();
    let relative = relative_normal(depth, &pseudo, &cameras, &found);
    golden.matches("out.relative_normal", &relative.value());
    golden.gradients_match("grad_relative_normal", &tape.backward(relative), &[("depth", depth)]);
}

fn compare_edges<T: Scalar>(golden: &Compared<T>, edges: &EdgeMaps) {
    for (name, map) in [("image", &edges.image), ("normal", &edges.normal)] {
        golden.numbers_match(&format!("out.edge_{name}"), map.strength.data());
        golden.numbers_match(&format!("out.theta_{name}"), map.angle.data());
    }
    golden.labels_match("out.depth_edge_dilated", edges.depth.data().iter().copied());
}

/// Pairs by the stored draws, across image edges and then across edges of the normals.
fn pairs_of_sample<T: Scalar>(golden: &Compared<T>, edges: &EdgeMaps, n: usize) -> Pairs {
    let one = |name: &str, map: &Edges| {
        let draws = stored_draws(golden, name, n);
        assert_eq!(candidates(map, n).len(), draws.ranks.len(), "{name} {n}");
        let found = pairs(map, n, &draws);
        for (side, list) in [("a", &found.a), ("b", &found.b)] {
            golden.labels_match(&format!("out.{name}_pair_{side}_{n}"), list.iter().map(|&i| i as f64));
        }
        found
    };
    let (image, normal) = (one("image", &edges.image), one("normal", &edges.normal));
    Pairs { a: [image.a, normal.a].concat(), b: [image.b, normal.b].concat() }
}

fn stored_draws<T: Scalar>(golden: &Compared<T>, name: &str, n: usize) -> Draws {
    let ranks = indices(golden, &format!("in.{name}_rank_{n}"));
    let offsets = indices(golden, &format!("in.{name}_distance_{n}"));
    let row = |k: usize| offsets[k * ranks.len()..][..ranks.len()].to_vec();
    Draws { offsets: [row(0), row(1), row(2), row(3)], ranks }
}

fn indices<T>(golden: &Compared<T>, name: &str) -> Vec<usize>
where
    T: Scalar,
{
    golden.golden().numbers(name).iter().map(|&x| x as usize).collect()
}

fn ranking<T: Scalar>(golden: &Compared<T>) {
    let mask: Vec<bool> = golden.golden().numbers("in.rank_mask_a").iter().map(|&m| m != 0.0).collect();
    let global = global_pairs(&mask, &indices(golden, "in.rank_perm"));
    let weights: Tensor<T> = golden.map("in.dynamic_weight");
    let dynamic = |n: usize| -> Vec<Pair> {
        let low = unreliable(weights.plane(n, 0));
        golden.labels_match(&format!("out.unreliable_{n}"), low.iter().map(|&l| f64::from(u8::from(l))));
        dynamic_pairs(&low, &indices(golden, &format!("in.rank_pick_{n}")))
    };
    let tape = Tape::new();
    let depth = tape.leaf(golden.map("in.depth"));
    let loss = depth_ranking(depth, &golden.map("in.pseudo_depth"), &global, &[dynamic(0), dynamic(1)]);
    golden.matches("out.depth_ranking", &loss.value());
    golden.gradients_match("grad_depth_ranking", &tape.backward(loss), &[("depth", depth)]);
}

fn refinement_in<T: Scalar>() {
    let golden = Compared::<T>::open("lsr");
    normal_losses(&golden);
    ranking(&golden);
    golden.finish();
}

#[test]
fn normal_matching_relative_normals_and_depth_ranking() {
    refinement_in::<f64>();
    refinement_in::<f32>();
}
