//! Depth and odometry metrics equal those of other programs.

mod depth;
mod odometry;
