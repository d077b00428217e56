//! Sizes of D-HRNet.

/// Sizes of a [`crate::DHrNet`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DHrNetConfig {
    /// Channels of the two first convolutions.
    pub stem: usize,
    /// Inner channels of a bottleneck; it returns four times as many.
    pub bottleneck: usize,
    /// Bottlenecks of the first layer, at least one.
    pub bottlenecks: usize,
    /// Channels at a quarter of the size; each further branch, at half the size of the one before, has twice as many.
    pub width: usize,
    /// Residual blocks of a branch in one module, at least one.
    pub blocks: usize,
    /// Modules of the stages with two, three and four branches, each at least one.
    pub modules: [usize; 3],
    /// Channels of the last two decoder layers, at half and at full size.
    pub tail: [usize; 2],
}

impl DHrNetConfig {
    /// 300 401 parameters: for tests and small machines.
    pub fn nano() -> Self {
        Self { stem: 16, bottleneck: 8, bottlenecks: 1, width: 8, blocks: 1, modules: [1, 1, 1], tail: [16, 8] }
    }

    /// The size of the reference: HRNet-18, 10 million parameters.
    pub fn d_hrnet() -> Self {
        Self { stem: 64, bottleneck: 64, bottlenecks: 4, width: 18, blocks: 4, modules: [1, 4, 3], tail: [32, 16] }
    }

    /// Channels of the four branches, fine to coarse.
    pub fn branches(&self) -> [usize; 4] {
        [1, 2, 4, 8].map(|factor| factor * self.width)
    }
}
