//! Frames and where they come from: plain types, readers and writers, datasets, augmentation.
//!
//! Everything here is plain data: no tape, no network. Pixel centres lie at integer coordinates, `u` runs to the right and
//! `v` down; the camera looks along +z with x right and y down. Ground truth (depth, poses, flow) is carried for evaluation.

mod atomic;
mod augment;
mod cache;
mod calib;
mod decode;
mod error;
mod file_dataset;
mod flow_io;
mod folder;
mod frame;
mod image;
mod image_io;
mod intrinsics_file;
mod kitti_odometry;
mod kitti_writer;
mod npy;
mod open;
mod options;
mod poses;
mod resample;
pub(crate) mod staging;
pub mod synthetic;
mod text;
mod times;
mod view;

pub use atomic::write_atomic;
pub use augment::{Augmentation, Jitter, flip_frame, flip_snippet};
pub use calib::Calibration;
pub use decode::{MAX_SIDE, image_size, read_image};
pub use error::DataError;
pub use file_dataset::FileDataset;
pub use flow_io::{KnownFlow, encode_flo, encode_flow_png, parse_flo, read_flo, read_flow_png, write_flo, write_flow_png};
pub use folder::open_folder;
pub use frame::{Dataset, Frame, PairTruth, Snippet, snippet};
pub use image::{FlowMap, Image, Map};
pub use image_io::{encode_depth_png, encode_rgb_png, read_depth_png, write_depth_png, write_rgb_png};
pub use intrinsics_file::IntrinsicsFile;
pub use kitti_odometry::open_kitti_odometry;
pub use kitti_writer::{WriteSummary, write_kitti};
pub use npy::{encode_npy, write_npy};
pub use open::open;
pub use options::{KittiCamera, LoadOptions};
pub use poses::{format_poses, parse_poses, read_poses};
pub use resample::{resize_image, resize_map_nearest};
pub use times::read_times;
pub use view::{View, crop_map_to_shape};
