//! Every network learns one pair of images by heart.

mod adam;
mod depth;
mod motion;
