//! Sizes of Lite-Mono.

/// Sizes of a [`crate::LiteMono`].
#[derive(Clone, Debug, PartialEq)]
pub struct LiteMonoConfig {
    /// Channels of the three stages, each a multiple of `heads` and even.
    pub dims: [usize; 3],
    /// Dilation of every convolution block of the three stages; one attention block ends each stage.
    pub dilations: [Vec<usize>; 3],
    /// Heads of the attention across channels.
    pub heads: usize,
    /// Width of the hidden layer in a block, in multiples of its channels.
    pub expansion: usize,
    /// Probability to drop the last block in training; it grows evenly from zero at the first block.
    pub drop_path: f64,
    /// Levels with a disparity output, from 0 (full size) to 2.
    pub scales: Vec<usize>,
}

/// Dilations of the first two stages.
const ONE_TWO_THREE: [usize; 3] = [1, 2, 3];

impl LiteMonoConfig {
    /// The reference network with the given channels and dilations of the last stage.
    fn reference(dims: [usize; 3], last: &[usize]) -> Self {
        Self {
            dims,
            dilations: [ONE_TWO_THREE.to_vec(), ONE_TWO_THREE.to_vec(), last.to_vec()],
            heads: 8,
            expansion: 6,
            drop_path: 0.2,
            scales: vec![0, 1, 2],
        }
    }

    /// 112 715 parameters: for tests and small machines.
    pub fn nano() -> Self {
        Self {
            dims: [16, 24, 32],
            dilations: [vec![1, 2], vec![1, 2], vec![1, 2, 3]],
            heads: 4,
            expansion: 4,
            drop_path: 0.2,
            scales: vec![0, 1, 2],
        }
    }

    /// `lite-mono`, 3.1 million parameters.
    pub fn lite_mono() -> Self {
        Self::reference([48, 80, 128], &[1, 2, 3, 1, 2, 3, 2, 4, 6])
    }

    /// `lite-mono-small`, 2.5 million parameters.
    pub fn small() -> Self {
        Self::reference([48, 80, 128], &[1, 2, 3, 2, 4, 6])
    }

    /// `lite-mono-tiny`, 2.1 million parameters.
    pub fn tiny() -> Self {
        Self::reference([32, 64, 128], &[1, 2, 3, 2, 4, 6])
    }

    /// `lite-mono-8m`, 8.8 million parameters: the one whose published figures the paper quotes.
    pub fn eight_million() -> Self {
        Self::reference([64, 128, 224], &[1, 2, 3, 1, 2, 3, 2, 4, 6])
    }

    /// With the dilations that the reference takes for images of 1024x320, in all sizes but `lite-mono-8m`: 5 in place of 3
    /// and 10 in place of 6. The tensors stay the same, but weights belong to the dilations they were trained with.
    #[must_use]
    pub fn with_wide_dilations(mut self) -> Self {
        for dilation in self.dilations.iter_mut().flatten() {
            *dilation = match *dilation {
                3 => 5,
                6 => 10,
                other => other,
            };
        }
        self
    }

    /// Probability to drop block `index`, counted through all stages.
    pub(super) fn drop_rate(&self, index: usize) -> f64 {
        let blocks = self.dilations.iter().map(|stage| stage.len() + 1).sum::<usize>();
        self.drop_path * index as f64 / (blocks - 1).max(1) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wide_dilations_are_those_of_the_reference() {
        let wide = LiteMonoConfig::lite_mono().with_wide_dilations().dilations;
        assert_eq!(wide, [vec![1, 2, 5], vec![1, 2, 5], vec![1, 2, 5, 1, 2, 5, 2, 4, 10]]);
        let wide = LiteMonoConfig::tiny().with_wide_dilations().dilations;
        assert_eq!(wide[2], [1, 2, 5, 2, 4, 10]);
    }

    #[test]
    fn the_rate_of_dropping_grows_from_zero_to_its_end() {
        for (config, blocks) in [(LiteMonoConfig::lite_mono(), 18), (LiteMonoConfig::small(), 15), (LiteMonoConfig::nano(), 10)] {
            assert_eq!(config.drop_rate(0), 0.0);
            assert!((config.drop_rate(blocks - 1) - 0.2).abs() < 1e-15);
            assert!((config.drop_rate(3) - 0.6 / (blocks - 1) as f64).abs() < 1e-15);
        }
    }
}
