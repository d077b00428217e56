//! Image sizes that a network can take.

use thiserror::Error;

/// An image size that a network cannot take.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{network} needs sides that are multiples of {multiple}, at least {least}; images of {width}x{height} do not fit")]
pub struct UnfitSize {
    /// Name of the network.
    pub network: String,
    /// What width and height are multiples of.
    pub multiple: usize,
    /// The shortest side that is allowed.
    pub least: usize,
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
}

/// Refuses a size (height, width) unless both sides are multiples of `multiple` and not below `least`.
pub(crate) fn fits(network: &str, (multiple, least): (usize, usize), (height, width): (usize, usize)) -> Result<(), UnfitSize> {
    let whole = |side: usize| side >= least && side.is_multiple_of(multiple);
    if whole(height) && whole(width) {
        return Ok(());
    }
    Err(UnfitSize { network: network.to_owned(), multiple, least, width, height })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_sides_are_multiples_and_long_enough() {
        assert_eq!(fits("net", (16, 32), (32, 48)), Ok(()));
        for size in [(16, 48), (48, 16), (40, 48), (48, 40), (0, 48)] {
            let text = fits("net", (16, 32), size).unwrap_err().to_string();
            assert!(text.contains(&format!("{}x{}", size.1, size.0)) && text.contains("multiples of 16, at least 32"), "{text}");
        }
    }
}
