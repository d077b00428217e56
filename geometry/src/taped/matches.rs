//! Which matches of an optical flow DF-VO keeps: the best of every cell of a grid, so that they are spread over the image.
//!
//! **Rule** (Huangying-Zhan/DF-VO, `libs/matching/kp_selection.py`, `local_bestN`; numbers of
//! `options/examples/default_configuration.yml`). The image is cut into 10 x 10 cells, cell `(i, j)` from row `floor(h i / 10)` and
//! column `floor(w j / 10)`. Of each cell the pixels with a score below 0.1 px are candidates, and the 2000 / 100 = 20 with the
//! smallest scores are kept, or all when there are fewer; what a cell does not fill is not given to others. The frame is unusable
//! when fewer than a tenth of 2000 pixels of the image are below 0.1 px, or fewer than a tenth of the cells keep any.
//!
//! **Reading**: the public code never looks at the last row and column of a cell; [`Matching::gap`] is 1 for that and 0 for whole
//! cells. Of equal scores the first in reading order are kept, where the public code leaves the choice to its library.

use dimode_autodiff::{Scalar, Tensor};

/// Limits of the selection.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Matching {
    /// Score below which a pixel is a candidate, pixels.
    pub score: f64,
    /// Most pixels to keep of an image, shared equally among cells (rounded down).
    pub best: usize,
    /// Cells along the rows and along the columns of the image.
    pub cells: [usize; 2],
    /// Last rows and columns of every cell that are left out.
    pub gap: usize,
    /// Share of `best` and of the cells below which an image has too few.
    pub enough: f64,
}

impl Default for Matching {
    /// Those of DF-VO.
    fn default() -> Self {
        Self { score: 0.1, best: 2000, cells: [10, 10], gap: 1, enough: 0.1 }
    }
}

/// The matches that are kept of one image.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Matches {
    /// Flat pixel indices, cell after cell in reading order, the best of a cell first.
    pub pixels: Vec<usize>,
    /// Whether there are enough for a motion; DF-VO goes on with the last motion otherwise.
    pub enough: bool,
}

/// The matches to keep of every image.
///
/// **Shapes**: `score` (N,1,H,W), pixels, from [`consistency_score`](super::visibility::consistency_score); NaN is never kept.
///
/// **Panics** when the map has not one channel, or there is no cell.
#[must_use]
#[track_caller]
pub fn best_matches<T: Scalar>(score: &Tensor<T>, limits: Matching) -> Vec<Matches> {
    let (s, cells) = (score.shape(), limits.cells);
    assert!(s.c() == 1 && cells[0] > 0 && cells[1] > 0, "best_matches: score {s}, {} x {} cells", cells[0], cells[1]);
    (0..s.n()).map(|n| of_image(score.plane(n, 0), [s.h(), s.w()], limits)).collect()
}

/// The same as a mask (N,1,H,W).
///
/// **Panics** as [`best_matches`].
#[must_use]
#[track_caller]
pub fn best_matches_mask<T: Scalar>(score: &Tensor<T>, limits: Matching) -> Tensor<T> {
    let s = score.shape();
    let mut mask = vec![T::ZERO; s.len()];
    for (n, matches) in best_matches(score, limits).into_iter().enumerate() {
        matches.pixels.into_iter().for_each(|i| mask[n * s.plane() + i] = T::ONE);
    }
    Tensor::from_vec(s, mask)
}

fn of_image<T: Scalar>(score: &[T], [h, w]: [usize; 2], limits: Matching) -> Matches {
    let good = |i: usize| score[i].to_f64() < limits.score;
    let [rows, columns] = limits.cells;
    let count = rows * columns;
    let quota = limits.best / count;
    let (mut pixels, mut filled) = (Vec::new(), 0);
    for cell in 0..count {
        let along_v = span(h, rows, cell / columns, limits.gap);
        let inside = along_v.flat_map(|v| span(w, columns, cell % columns, limits.gap).map(move |u| v * w + u));
        let mut candidates: Vec<usize> = inside.filter(|&i| good(i)).collect();
        candidates.sort_by(|&a, &b| score[a].to_f64().total_cmp(&score[b].to_f64()));
        candidates.truncate(quota);
        filled += usize::from(!candidates.is_empty());
        pixels.extend(candidates);
    }
    let share = |part: usize, whole: usize| part as f64 >= limits.enough * whole as f64;
    let below = (0..score.len()).filter(|&i| good(i)).count();
    Matches { pixels, enough: share(below, limits.best) && share(filled, count) }
}

/// Rows or columns of the cell with number `at` of `count`.
fn span(size: usize, count: usize, at: usize, gap: usize) -> std::ops::Range<usize> {
    size * at / count..(size * (at + 1) / count).saturating_sub(gap)
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::Shape;
    use dimode_autodiff::gradcheck::random;

    /// Limits with `best` pixels in 2 x 2 whole cells.
    fn four(best: usize) -> Matching {
        Matching { best, cells: [2, 2], gap: 0, ..Matching::default() }
    }

    fn map(h: usize, w: usize, score: impl Fn(usize, usize) -> f64) -> Tensor<f64> {
        Tensor::from_fn(Shape::new(1, 1, h, w), |_, _, v, u| score(v, u))
    }

    #[test]
    fn every_cell_keeps_its_best_and_no_cell_takes_the_place_of_another() {
        let scores = [[0.03, 0.01, 0.05, 0.2], [0.04, 0.02, 0.3, 0.4], [0.0, 0.1, 0.09, 0.06], [f64::NAN, 0.7, 0.08, 0.07]];
        let score = map(4, 4, |v, u| scores[v][u]);
        // Quota 3. Four, one, one (0.1 is not below 0.1) and four candidates.
        let found = &best_matches(&score, four(12))[0];
        assert_eq!(found.pixels, [1, 5, 0, 2, 8, 11, 15, 14]);
        let mask = best_matches_mask(&score, four(12));
        let expected = [1.0, 1.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0];
        assert_eq!(mask.to_vec(), expected);
        // 15 / 4 is rounded down, as is 3 / 4.
        assert_eq!(best_matches(&score, four(15))[0].pixels, found.pixels);
        assert!(best_matches(&score, four(3))[0].pixels.is_empty());
    }

    #[test]
    fn equal_scores_are_kept_in_reading_order() {
        let found = best_matches(&map(4, 6, |_, _| 0.05), four(8));
        assert_eq!(found[0].pixels, [0, 1, 3, 4, 12, 13, 15, 16]);
    }

    #[test]
    fn cells_tile_every_size_and_a_gap_leaves_out_their_last_lines() {
        for (h, w) in [(23, 37), (10, 11), (7, 3)] {
            let all = Matching { best: 100_000, gap: 0, ..Matching::default() };
            let mut found = best_matches(&map(h, w, |_, _| 0.0), all)[0].pixels.clone();
            found.sort_unstable();
            assert_eq!(found, (0..h * w).collect::<Vec<_>>());
        }
        // Rows 0 to 10 and 11 to 22, columns 0 to 2 and 3 to 6, less the last of each.
        let gap = Matching { gap: 1, ..four(100_000) };
        let mask = best_matches_mask(&map(23, 7, |_, _| 0.0), gap);
        let kept = map(23, 7, |v, u| if [10, 22].contains(&v) || [2, 6].contains(&u) { 0.0 } else { 1.0 });
        assert_eq!(mask, kept);
    }

    #[test]
    fn defaults_keep_twenty_of_each_of_a_hundred_cells() {
        let score = random::<f64>(1, Shape::new(2, 1, 192, 640), 0.0, 0.5);
        let found = best_matches(&score, Matching::default());
        for (n, matches) in found.iter().enumerate() {
            assert!(matches.enough && matches.pixels.len() == 2000);
            for cell in matches.pixels.chunks(20) {
                let values: Vec<f64> = cell.iter().map(|&i| score.plane(n, 0)[i]).collect();
                assert!(values.is_sorted() && values[19] < 0.1);
            }
            // Rows of cells begin at 0, 19, 38, ..., columns at 0, 64, 128, ...
            let cell = |i: usize| (1..10).filter(|k| 192 * k / 10 <= i / 640).count() * 10 + i % 640 / 64;
            assert!(matches.pixels.iter().enumerate().all(|(k, &i)| cell(i) == k / 20));
        }
        assert_ne!(found[0], found[1]);
    }

    #[test]
    fn images_with_too_few_pixels_or_too_few_cells_are_not_enough() {
        let limits = Matching { gap: 0, best: 1000, ..Matching::default() };
        // 100 of 2500 pixels are needed, in 10 of 100 cells of 5 x 5.
        let until = |count: usize| map(50, 50, move |v, u| if v * 50 + u < count { 0.0 } else { 1.0 });
        let enough = |score: &Tensor<f64>| best_matches(score, limits)[0].enough;
        assert!(enough(&until(100)) && !enough(&until(99)));
        let columns = |last: usize| map(50, 50, move |v, u| if v < 20 && u < last { 0.0 } else { 1.0 });
        // Four rows of cells: eight of them with 200 pixels, then twelve.
        assert!(!enough(&columns(10)) && enough(&columns(11)));
        let nothing = best_matches(&until(0), limits);
        assert_eq!(nothing, [Matches::default()]);
        assert_eq!(best_matches_mask(&until(0), limits), map(50, 50, |_, _| 0.0));
    }
}
