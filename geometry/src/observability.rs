//! Which motions the direction losses can see: information about rotation and translation (L49).
//!
//! The matrices are means over the pixels of products of the responses of [`crate::sensitivity`], in its order of errors.

use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};

use crate::loss_forms::mean;
use crate::sensitivity::Response;

/// Information about the six errors.
pub type Information = Matrix6<f64>;

fn products(responses: &[Response], weights: &[f64]) -> Information {
    assert_eq!(responses.len(), weights.len(), "one weight a pixel");
    let sum: Information = responses
        .iter()
        .zip(weights)
        .map(|(r, w)| {
            let r = Vector6::from(*r);
            r * r.transpose() * (w * w)
        })
        .sum();
    sum / responses.len() as f64
}

/// Information of `L_axi`: `G = E[w^2 J J^T]`.
///
/// `weights` are 1 for angles, or the lengths of the flows: a direction is known the better the longer its flow, and the
/// responses then count pixels.
///
/// **Panics** unless there is one weight for each pixel.
#[must_use]
#[track_caller]
pub fn axial_information(responses: &[Response], weights: &[f64]) -> Information {
    products(responses, weights)
}

/// Information of `L_pla`: `G = E[w^2 J J^T] - E[w^2 J] E[w^2 J]^T / E[w^2]`. The direction common to all flows is free.
///
/// With weights 1 it is the covariance of the responses. **Panics** unless there is one weight for each pixel.
#[must_use]
#[track_caller]
pub fn planar_information(responses: &[Response], weights: &[f64]) -> Information {
    let total = mean(weights.iter().map(|w| w * w));
    let sum: Vector6<f64> = responses.iter().zip(weights).map(|(r, w)| Vector6::from(*r) * (w * w)).sum();
    let common = sum / responses.len() as f64;
    products(responses, weights) - common * common.transpose() / total
}

/// Share of an eigenvalue of the translation block below which a translation counts as not seen at all.
const UNSEEN: f64 = 1e-10;

/// What is left about the rotation when the translation is free as well: `G_ww - G_wa G_aa^+ G_aw`.
#[must_use]
pub fn rotation_information(information: &Information) -> Matrix3<f64> {
    let block = |i, j| information.fixed_view::<3, 3>(i, j).into_owned();
    let eigen = block(3, 3).symmetric_eigen();
    let least = UNSEEN * eigen.eigenvalues.amax();
    let inverse = eigen.eigenvalues.map(|x| if x > least { 1.0 / x } else { 0.0 });
    let inverse = eigen.eigenvectors * Matrix3::from_diagonal(&inverse) * eigen.eigenvectors.transpose();
    block(0, 0) - block(0, 3) * inverse * block(3, 0)
}

/// Roots of the eigenvalues of [`rotation_information`], in rising order: the response, in the unit of `J` times `w` per
/// radian, to rotations about the least visible to the most visible axis. 0 where rounding leaves a negative eigenvalue.
#[must_use]
pub fn rotation_visibility(information: &Information) -> Vector3<f64> {
    let mut roots: [f64; 3] = rotation_information(information).symmetric_eigenvalues().map(|x| x.max(0.0).sqrt()).into();
    roots.sort_by(f64::total_cmp);
    Vector3::from(roots)
}

/// Correlation of the responses to two errors, by position in [`Response`]: 1 or -1 when one error looks like the other.
#[must_use]
pub fn correlation(information: &Information, i: usize, j: usize) -> f64 {
    information[(i, j)] / (information[(i, i)] * information[(j, j)]).sqrt()
}
