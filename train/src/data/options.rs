//! How frames on disk are turned into frames for training.

use serde::{Deserialize, Serialize};

use super::DataError;
use super::decode::MAX_SIDE;

/// One of the four cameras of a KITTI layout. Depth and poses of the layout are those of the left ones.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum KittiCamera {
    /// `image_0`, left grey, calibration row `P0`.
    LeftGrey,
    /// `image_1`, right grey, calibration row `P1`.
    RightGrey,
    /// `image_2`, left colour, calibration row `P2`.
    LeftColour,
    /// `image_3`, right colour, calibration row `P3`.
    RightColour,
}

impl KittiCamera {
    /// Whether the layout's depth and poses are those of this camera.
    pub fn has_truth(self) -> bool {
        matches!(self, Self::LeftGrey | Self::LeftColour)
    }

    /// The number of the camera, 0 to 3.
    pub fn number(self) -> usize {
        self as usize
    }

    /// The folder of its images inside a sequence.
    pub fn folder(self) -> String {
        format!("image_{}", self.number())
    }

    /// Its row in `calib.txt`.
    pub fn label(self) -> String {
        format!("P{}", self.number())
    }
}

/// Options of [`super::open`] and of the readers behind it.
#[derive(Clone, Debug)]
pub struct LoadOptions {
    /// Sequences to use, each named once; empty for all that are there.
    pub sequences: Vec<String>,
    /// Camera of a KITTI layout; `None` takes left colour where it is there, else left grey.
    pub camera: Option<KittiCamera>,
    /// (width, height) in pixels that every frame is resized to; `None` keeps the stored size.
    pub size: Option<(usize, usize)>,
    /// Cut the centre to the shape of `size` before resizing, so that pixels keep their aspect; without it the whole frame
    /// is squeezed (the intrinsics follow in both cases).
    pub center_crop: bool,
    /// Frames that every sequence must have: 3 to train, 1 to look at depth.
    pub min_frames: usize,
    /// Whether a folder of frames must tell its camera. Where it need not and does not, one of the frames' width as focal length
    /// stands in, for what looks at pictures alone.
    pub needs_camera: bool,
    /// Bytes of decoded frames that are kept in memory.
    pub cache_bytes: usize,
}

impl Default for LoadOptions {
    fn default() -> Self {
        Self {
            sequences: Vec::new(),
            camera: None,
            size: None,
            center_crop: false,
            min_frames: 3,
            needs_camera: true,
            cache_bytes: 256 << 20,
        }
    }
}

impl LoadOptions {
    /// **Errors** [`DataError::Option`] for a size of 0 or above [`MAX_SIDE`] a side.
    pub(crate) fn check(&self) -> Result<(), DataError> {
        let Some((width, height)) = self.size else {
            return Ok(());
        };
        let sides = 1..=MAX_SIDE;
        if sides.contains(&width) && sides.contains(&height) {
            return Ok(());
        }
        let reason = format!("both sides must be 1 to {MAX_SIDE} pixels");
        Err(DataError::Option { option: "size", value: format!("{width}x{height}"), reason })
    }
}
