//! The camera of the synthetic scenes.

use anyhow::Result;
use dimode_autodiff::Shape;
use dimode_geometry::Intrinsics;

use crate::inputs::Inputs;

/// The camera of images of the given size; a drawn one has the principal point in the middle.
///
/// # Errors
/// When its file cannot be read or makes no sense.
pub fn camera(inputs: &Inputs, height: usize, width: usize) -> Result<Intrinsics> {
    let (h, w) = (height as f64, width as f64);
    let [fu, fv, u0, v0] = match inputs {
        Inputs::Drawn => [0.58 * w, 1.92 * h, 0.5 * w - 0.5, 0.5 * h - 0.5],
        Inputs::Folder(_) => {
            let k = inputs.tensor("camera", Shape::new(1, 1, 3, 3))?;
            [(0, 0), (1, 1), (0, 2), (1, 2)].map(|(i, j)| f64::from(k.at(0, 0, i, j)))
        }
    };
    Ok(Intrinsics::new(fu, fv, u0, v0, width, height)?)
}
