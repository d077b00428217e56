//! Numbers that a case computes with: files that a peer reads too, or drawn ones where no peer is asked.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use dimode_autodiff::rng::uniform;
use dimode_autodiff::{Shape, Tensor};
use dimode_nets::ParamSet;

use crate::scene;

/// Where inputs come from.
#[derive(Clone, Debug)]
pub enum Inputs {
    /// Raw little-endian f32 files `NAME.bin` of a folder.
    Folder(PathBuf),
    /// The scene of [`mod@crate::scene`] and random numbers of realistic size, by the name of the input.
    Drawn,
}

impl Inputs {
    /// The input `name`.
    ///
    /// # Errors
    /// When its file cannot be read or has another length.
    pub fn tensor(&self, name: &str, shape: Shape) -> Result<Tensor<f32>> {
        match self {
            Self::Folder(folder) => Ok(Tensor::from_vec(shape, read(&folder.join(format!("{name}.bin")), shape.len())?)),
            Self::Drawn => Ok(drawn(name, shape)),
        }
    }

    /// Replaces the parameters of networks by those of the folder, files `FILE:NAME.bin`; drawn ones stay as they are.
    ///
    /// # Errors
    /// When a file cannot be read or has another length.
    pub fn parameters(&self, set: &mut ParamSet<f32>) -> Result<()> {
        if let Self::Folder(_) = self {
            let paths: Vec<_> = set.trainable().map(|(path, entry)| (path, entry.tensor().shape())).collect();
            for (path, shape) in paths {
                set.set(&path, self.tensor(&path, shape)?);
            }
        }
        Ok(())
    }
}

/// The numbers of a raw f32 file.
///
/// # Errors
/// When it cannot be read or does not hold `len` numbers.
pub fn read(path: &Path, len: usize) -> Result<Vec<f32>> {
    let bytes = fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
    ensure!(bytes.len() == 4 * len, "{}: {} bytes where {} numbers of 4 bytes belong", path.display(), bytes.len(), len);
    Ok(bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect())
}

/// Parts of the scene, else random numbers as a network in training has them.
fn drawn(name: &str, shape: Shape) -> Tensor<f32> {
    if let Some(part) = scene::part(name, shape) {
        return part;
    }
    let seed = name.bytes().fold(17, |seed: u64, byte| seed.wrapping_mul(31).wrapping_add(u64::from(byte)));
    match name {
        "camera" => panic!("a drawn camera belongs to an image size"),
        "weight" => {
            let fan_in = (shape.c() * shape.h() * shape.w()) as f64;
            uniform(seed, shape, -(3.0 / fan_in).sqrt(), (3.0 / fan_in).sqrt())
        }
        // Variance 1.
        _ => uniform(seed, shape, -3.0_f64.sqrt(), 3.0_f64.sqrt()),
    }
}
