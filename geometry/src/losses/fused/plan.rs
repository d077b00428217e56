//! The four losses of one sample, behind one interface each for both passes.

use dimode_autodiff::Scalar;
use dimode_autodiff::simd::Simd;

use super::axial::Axial;
use super::planar::Planar;
use super::radial::Radial;
use super::rows::{COUNT, Rows, Sample, Sums};
use super::tangential::Tangential;
use crate::losses::LossOptions;

/// The losses that are wanted of one sample.
pub(super) struct Plan<T> {
    planar: Option<Planar<T>>,
    axial: Option<Axial<T>>,
    tangential: Option<Tangential<T>>,
    radial: Option<Radial<T>>,
}

/// Upstream gradients of the four losses of one sample, and the sums of the first pass.
#[derive(Clone, Copy)]
pub(super) struct Upstream {
    pub g: [f64; 4],
    pub sums: [Sums; 4],
}

/// Sums of the second pass over pixels.
#[derive(Clone, Copy, Default)]
pub(super) struct Gathered {
    /// Gradient of the rotation (9) and of `a` (3) by the flows.
    pub motion: [f64; 12],
    /// Gradient of `a` by the losses themselves.
    pub to_a: [f64; 3],
    /// Gradient of the predicted direction of planar flows.
    pub to_direction: [f64; 2],
}

impl<T: Scalar> Plan<T> {
    /// `None` when one of the wanted forms has no kernel.
    pub(super) fn new(options: &LossOptions, wanted: [bool; 4], sample: &Sample<T>) -> Option<Self> {
        let [planar, axial, tangential, radial] = wanted;
        Some(Self {
            planar: if planar { Some(Planar::new(options, sample)?) } else { None },
            axial: if axial { Some(Axial::new(options)?) } else { None },
            tangential: if tangential { Some(Tangential::new(options)?) } else { None },
            radial: if radial { Some(Radial::new(options)?) } else { None },
        })
    }

    /// Adds the sums of a row.
    #[inline(always)]
    pub(super) fn sum<S: Simd>(&self, simd: S, sample: &Sample<T>, rows: &Rows<'_, T>, sums: &mut [Sums; 4]) {
        let [planar, axial, tangential, radial] = sums;
        if let Some(loss) = &self.planar {
            loss.sum(simd, sample, rows, planar);
        }
        if let Some(loss) = &self.axial {
            loss.sum(simd, sample, rows, axial);
        }
        if let Some(loss) = &self.tangential {
            loss.sum(simd, sample, rows, tangential);
        }
        if let Some(loss) = &self.radial {
            loss.sum(simd, sample, rows, radial);
        }
    }

    /// The four losses; 0 for those that are not wanted.
    pub(super) fn values(&self, sample: &Sample<T>, [planar, axial, tangential, radial]: &[Sums; 4]) -> [f64; 4] {
        [
            self.planar.as_ref().map_or(0.0, |loss| loss.value(planar)),
            self.axial.as_ref().map_or(0.0, |loss| loss.value(axial)),
            self.tangential.as_ref().map_or(0.0, |loss| loss.value(sample, tangential)),
            self.radial.as_ref().map_or(0.0, |loss| loss.value(sample, radial)),
        ]
    }

    /// Adds the gradients of a row.
    #[inline(always)]
    pub(super) fn spread<S: Simd>(
        &self,
        simd: S,
        sample: &Sample<T>,
        Upstream { g, sums }: &Upstream,
        rows: &mut Rows<'_, T>,
        gathered: &mut Gathered,
    ) {
        if let Some(loss) = &self.planar {
            loss.spread(simd, sample, (g[0], &sums[0]), rows, &mut gathered.to_direction);
        }
        if let Some(loss) = &self.axial {
            loss.spread(simd, sample, (g[1], &sums[1]), rows);
        }
        if let Some(loss) = &self.tangential {
            loss.spread(simd, sample, (g[2], &sums[2]), rows, &mut gathered.to_a);
        }
        if let Some(loss) = &self.radial {
            loss.spread(simd, sample, (g[3], &sums[3]), rows, &mut gathered.to_a[2]);
        }
    }

    /// Gradient of the rotation (9) and of `a` (3), all in.
    pub(super) fn to_motion(&self, sample: &Sample<T>, Upstream { g, sums }: &Upstream, gathered: &Gathered) -> [f64; 12] {
        let planar = self.planar.as_ref().map(|loss| loss.to_translation(sample, gathered.to_direction));
        let tangential = self.tangential.as_ref().map(|loss| loss.to_translation(sample, g[2], &sums[2]));
        let radial = self.radial.as_ref().map(|loss| loss.to_translation(sample, g[3], &sums[3]));
        let mut out = gathered.motion;
        for part in [Some(gathered.to_a), planar, tangential, radial].into_iter().flatten() {
            for (out, part) in out[9..].iter_mut().zip(part) {
                *out += part;
            }
        }
        out
    }
}

/// Pixels behind every loss.
pub(super) fn counts(sums: &[Sums; 4]) -> [usize; 4] {
    sums.map(|sums| sums[COUNT] as usize)
}
