//! Pairs of pixels across edges of the image and of the pseudo-normals, for the relative normal loss (JiawangBian/sc_depth_pl,
//! `losses/normal_ranking_loss.py`).
//!
//! **Formula**. Edges of a map: correlation with `[[-1,0,1],[-2,0,2],[-1,0,1]]` along u and `[[1,2,1],[0,0,0],[-1,-2,-1]]` along v,
//! strength `e = |(g_u, g_v)|`, angle `atan2(g_v, g_u)`, both 0 in the outermost pixels. For normals the absolute values of the
//! three components' responses are averaged first, and strengths within five pixels of the border are dropped. Edges of the
//! pseudo-depth (at least a tenth of the strongest of the batch, grown by one pixel) are taken out of both: there normals say
//! nothing. Anchors are drawn with replacement from the pixels of at least a tenth of the strongest strength of their image, as
//! many as there are; along the gradient four pixels `a, b, c, d` are taken at -delta_1, -delta_2, delta_3, delta_4 (3 to 19
//! pixels), and `(a,b), (b,c), (c,d)` are the pairs.
//!
//! **Reading**: the offsets are `delta |cos|, delta |sin|`, so that every line runs in the direction (+, +): the sign of the angle
//! is lost in the public code, and its numbers were made that way.
//!
//! Nothing here carries a gradient. All of it is computed in `f64`.

use dimode_autodiff::{Scalar, Shape, Tensor, rng};

/// Share of the strongest edge from which on a pixel counts as edge.
const SHARE: f64 = 0.1;
/// Width of the frame without edges of normals.
const FRAME: usize = 5;
/// Offsets are drawn from this number on,
const NEAREST: usize = 3;
/// and there are this many of them.
const OFFSETS: usize = 17;

/// Strength and angle of the edges of `n` maps of one size, sample by sample.
#[derive(Clone, Debug, PartialEq)]
pub struct Edges {
    /// Strengths, `[n, 1, h, w]`.
    pub strength: Tensor<f64>,
    /// Angles of the gradients, radians, v upwards, `[n, 1, h, w]`.
    pub angle: Tensor<f64>,
}

/// The edges of a batch that pairs are laid across.
#[derive(Clone, Debug, PartialEq)]
pub struct EdgeMaps {
    /// Of the images.
    pub image: Edges,
    /// Of the pseudo-normals.
    pub normal: Edges,
    /// 1 at the grown edges of the pseudo-depth, where the others are dropped, `[n, 1, h, w]`.
    pub depth: Tensor<f64>,
}

/// Random numbers of one sample and one edge map.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Draws {
    /// For each anchor its place in the list of edge pixels in reading order.
    pub ranks: Vec<usize>,
    /// For each of the four pixels the offsets of all anchors, unsigned.
    pub offsets: [Vec<usize>; 4],
}

impl Draws {
    /// `count` anchors from a seed.
    #[must_use]
    pub fn random(count: usize, seed: u64) -> Self {
        let numbers = rng::uniform::<f64>(seed, Shape::new(1, 1, 5, count.max(1)), 0.0, 1.0);
        let whole = |row: usize, below: usize| -> Vec<usize> {
            (0..count).map(|k| ((numbers.at(0, 0, row, k) * below as f64) as usize).min(below - 1)).collect()
        };
        let offsets = std::array::from_fn(|row| whole(row + 1, OFFSETS).into_iter().map(|x| x + NEAREST).collect());
        Self { ranks: whole(0, count), offsets }
    }
}

/// Pairs of flat pixel indices of one sample.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Pairs {
    /// First pixels.
    pub a: Vec<usize>,
    /// Second pixels.
    pub b: Vec<usize>,
}

/// Edges of images `[n, c, h, w]` (channel 0), pseudo-normals `[n, 3, h, w]` and pseudo-depth `[n, 1, h, w]`.
///
/// # Panics
/// When sizes differ or a side is shorter than three pixels.
#[must_use]
#[track_caller]
pub fn edge_maps<T: Scalar>(images: &Tensor<T>, pseudo_normals: &Tensor<T>, pseudo_depth: &Tensor<T>) -> EdgeMaps {
    let (s, i, z) = (pseudo_normals.shape(), images.shape(), pseudo_depth.shape());
    assert!(s.c() == 3 && s.with_c(1) == z && s.with_c(i.c()) == i, "edge_maps: images {i}, normals {s}, depth {z}");
    let depth = grown(&strongest_of_batch(&edges(z, |n, v, u| responses(pseudo_depth, n, 0, v, u)).strength));
    let mut image = edges(z, |n, v, u| responses(images, n, 0, v, u));
    let mut normal = edges(z, |n, v, u| mean_of_three(|c| responses(pseudo_normals, n, c, v, u).map(f64::abs)));
    let framed = |v: usize, u: usize| v < FRAME || u < FRAME || v + FRAME >= s.h() || u + FRAME >= s.w();
    drop_where(&mut image, |n, v, u| depth.at(n, 0, v, u) != 0.0);
    drop_where(&mut normal, |n, v, u| framed(v, u) || depth.at(n, 0, v, u) != 0.0);
    EdgeMaps { image, normal, depth }
}

/// The pixels from which anchors are drawn, in reading order: strength at least a tenth of the largest of the sample.
///
/// A sample without any edge gives all pixels.
#[must_use]
pub fn candidates(edges: &Edges, sample: usize) -> Vec<usize> {
    let strength = edges.strength.plane(sample, 0);
    let largest = strength.iter().copied().fold(0.0, f64::max);
    (0..strength.len()).filter(|&i| strength[i] >= SHARE * largest).collect()
}

/// The pairs that the anchors of `draws` give: three for each, first those between the first two pixels of every anchor.
///
/// # Panics
/// When a rank lies beyond the candidates.
#[must_use]
#[track_caller]
pub fn pairs(edges: &Edges, sample: usize, draws: &Draws) -> Pairs {
    let s = edges.strength.shape();
    let candidates = candidates(edges, sample);
    let angle = edges.angle.plane(sample, 0);
    let along = |at: usize, offset: f64, size: usize| (at as f64 + offset).clamp(0.0, (size - 1) as f64) as usize;
    let line: [Vec<usize>; 4] = std::array::from_fn(|k| {
        let sign = if k < 2 { -1.0 } else { 1.0 };
        let moved = draws.ranks.iter().zip(&draws.offsets[k]).map(|(&rank, &offset)| {
            let (at, offset) = (candidates[rank], sign * offset as f64);
            let u = along(at % s.w(), (offset * angle[at].cos().abs()).round_ties_even(), s.w());
            let v = along(at / s.w(), (offset * angle[at].sin().abs()).round_ties_even(), s.h());
            v * s.w() + u
        });
        moved.collect()
    });
    Pairs { a: line[..3].concat(), b: line[1..].concat() }
}

/// Pairs of every sample with draws from a seed: across image edges, then across edges of the normals.
#[must_use]
pub fn random_pairs(edges: &EdgeMaps, seed: u64) -> Vec<Pairs> {
    let samples = edges.depth.shape().n();
    let sample = |n: usize| {
        let [image, normal] = [&edges.image, &edges.normal].map(|map| candidates(map, n).len());
        let own = |k: usize| rng::splitmix64(seed, (2 * n + k) as u64);
        let mut all = pairs(&edges.image, n, &Draws::random(image, own(0)));
        let more = pairs(&edges.normal, n, &Draws::random(normal, own(1)));
        all.a.extend(more.a);
        all.b.extend(more.b);
        all
    };
    (0..samples).map(sample).collect()
}

/// Responses along u and v (upwards) at an inner pixel.
fn responses<T: Scalar>(map: &Tensor<T>, n: usize, c: usize, v: usize, u: usize) -> [f64; 2] {
    let x = |dv: usize, du: usize| map.at(n, c, v + dv - 1, u + du - 1).to_f64();
    let along_u = x(0, 2) - x(0, 0) + 2.0 * (x(1, 2) - x(1, 0)) + x(2, 2) - x(2, 0);
    let along_v = x(0, 0) - x(2, 0) + 2.0 * (x(0, 1) - x(2, 1)) + x(0, 2) - x(2, 2);
    [along_u, along_v]
}

fn mean_of_three(response: impl Fn(usize) -> [f64; 2]) -> [f64; 2] {
    let [a, b, c] = [0, 1, 2].map(response);
    [0, 1].map(|k| (a[k] + b[k] + c[k]) / 3.0)
}

/// Strength and angle of the responses at inner pixels, 0 in the outermost ones.
#[track_caller]
fn edges(map: Shape, responses: impl Fn(usize, usize, usize) -> [f64; 2]) -> Edges {
    assert!(map.h() >= 3 && map.w() >= 3, "edges: a map of {map} has no inner pixels");
    let inner = |v: usize, u: usize| v > 0 && u > 0 && v + 1 < map.h() && u + 1 < map.w();
    let at = |n, v, u| if inner(v, u) { responses(n, v, u) } else { [0.0; 2] };
    let with = |f: fn([f64; 2]) -> f64| Tensor::from_fn(map, |n, _, v, u| f(at(n, v, u)));
    Edges { strength: with(|[x, y]| (x * x + y * y).sqrt()), angle: with(|[x, y]| y.atan2(x)) }
}

/// 1 where a strength is at least a tenth of the largest of all.
fn strongest_of_batch(strength: &Tensor<f64>) -> Tensor<f64> {
    let largest = strength.data().iter().copied().fold(0.0, f64::max);
    let mark = |&e: &f64| if e >= SHARE * largest { 1.0 } else { 0.0 };
    Tensor::from_vec(strength.shape(), strength.data().iter().map(mark).collect())
}

/// A mask grown by one pixel on all sides and corners.
fn grown(mask: &Tensor<f64>) -> Tensor<f64> {
    let s = mask.shape();
    Tensor::from_fn(s, |n, _, v, u| {
        let rows = v.saturating_sub(1)..=(v + 1).min(s.h() - 1);
        let near = rows.flat_map(|v| (u.saturating_sub(1)..=(u + 1).min(s.w() - 1)).map(move |u| (v, u)));
        near.map(|(v, u)| mask.at(n, 0, v, u)).fold(0.0, f64::max)
    })
}

fn drop_where(edges: &mut Edges, dropped: impl Fn(usize, usize, usize) -> bool) {
    let old = edges.strength.clone();
    edges.strength = Tensor::from_fn(old.shape(), |n, _, v, u| if dropped(n, v, u) { 0.0 } else { old.at(n, 0, v, u) });
}

#[cfg(test)]
mod tests {
    use super::*;

    const SHAPE: Shape = Shape([1, 1, 14, 16]);

    fn step() -> Tensor<f64> {
        Tensor::from_fn(SHAPE, |_, _, _, u| if u < 8 { 0.0 } else { 1.0 })
    }

    #[test]
    fn a_vertical_step_has_strength_four_and_no_angle() {
        let map = step();
        let found = edges(SHAPE, |n, v, u| responses(&map, n, 0, v, u));
        for u in [7, 8] {
            assert_eq!((found.strength.at(0, 0, 5, u), found.angle.at(0, 0, 5, u)), (4.0, 0.0));
            assert_eq!(found.strength.at(0, 0, 0, u), 0.0);
        }
        assert_eq!(found.strength.at(0, 0, 5, 6), 0.0);
        assert_eq!(candidates(&found, 0).len(), 24);
        // Brighter towards the top: upwards is positive.
        let map = Tensor::from_fn(SHAPE, |_, _, v, _| -(v as f64));
        let found = edges(SHAPE, |n, v, u| responses(&map, n, 0, v, u));
        assert_eq!(found.angle.at(0, 0, 5, 5), std::f64::consts::FRAC_PI_2);
        assert_eq!(found.strength.at(0, 0, 5, 5), 8.0);
    }

    #[test]
    fn edges_of_depth_take_the_others_out_and_normals_keep_clear_of_the_border() {
        let flat = Tensor::full(SHAPE, 2.0);
        let normals = Tensor::from_fn(SHAPE.with_c(3), |_, c, _, u| if c == 0 && u >= 8 { 3.0 } else { 0.0 });
        let sloped = Tensor::from_fn(SHAPE, |_, _, v, u| if v == 3 && u == 3 { 9.0 } else { 2.0 });
        let found = edge_maps(&step(), &normals, &sloped);
        assert_eq!(found.normal.strength.at(0, 0, 6, 7), 4.0);
        assert_eq!(found.normal.strength.at(0, 0, 4, 7), 0.0);
        assert_eq!(found.image.strength.at(0, 0, 4, 7), 4.0);
        // The response reaches one pixel around (3, 3), grown two.
        assert_eq!((found.depth.at(0, 0, 5, 5), found.depth.at(0, 0, 5, 6)), (1.0, 0.0));
        // A map without edges is edge everywhere (0 is at least a tenth of 0), so nothing is left.
        let found = edge_maps(&step(), &normals, &flat);
        assert!(found.depth.data().iter().all(|&d| d == 1.0));
        assert_eq!(candidates(&found.image, 0).len(), SHAPE.plane());
    }

    #[test]
    fn pairs_follow_the_gradient_and_stay_in_the_image() {
        let map = step();
        let found = edges(SHAPE, |n, v, u| responses(&map, n, 0, v, u));
        // Rank 5 is the second edge column of the third inner row: pixel (8, 3).
        let draws = Draws { ranks: vec![5], offsets: [vec![4], vec![3], vec![5], vec![19]] };
        let got = pairs(&found, 0, &draws);
        let row = 3 * 16;
        assert_eq!(got, Pairs { a: vec![row + 4, row + 5, row + 13], b: vec![row + 5, row + 13, row + 15] });
    }

    #[test]
    fn a_seed_gives_the_same_pairs_and_samples_differ() {
        let shape = Shape::new(2, 1, 24, 26);
        let image = rng::uniform::<f64>(1, shape, 0.0, 1.0);
        let normals = rng::uniform::<f64>(2, shape.with_c(3), -1.0, 1.0);
        let depth = Tensor::from_fn(shape, |n, _, v, u| if (n, v, u) == (0, 1, 14) { 5.0 } else { 1.0 });
        let maps = edge_maps(&image, &normals, &depth);
        let found = random_pairs(&maps, 7);
        assert_eq!(found, random_pairs(&maps, 7));
        assert_ne!(found, random_pairs(&maps, 8));
        assert_ne!(found[0], found[1]);
        for (n, sample) in found.iter().enumerate() {
            let anchors = candidates(&maps.image, n).len() + candidates(&maps.normal, n).len();
            assert_eq!((sample.a.len(), sample.b.len()), (3 * anchors, 3 * anchors));
            assert!(sample.a.iter().chain(&sample.b).all(|&i| i < shape.plane()));
        }
    }

    #[test]
    fn draws_fill_their_ranges() {
        let draws = Draws::random(2000, 3);
        assert!(draws.ranks.iter().all(|&r| r < 2000));
        for row in &draws.offsets {
            let (lo, hi) = (row.iter().min().unwrap(), row.iter().max().unwrap());
            assert_eq!((*lo, *hi, row.len()), (3, 19, 2000));
        }
        assert_eq!(Draws::random(0, 3).ranks, Vec::<usize>::new());
    }
}
