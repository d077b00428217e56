//! Preliminaries and motion components (L01 to L27).

use dimode_geometry::flow::radial::{radial_flow, scale_change};
use nalgebra::Vector3;

use super::Row;
use super::entry::Entry;

pub const ROWS: &[Row] = &[("intrinsics", "ray", ray), ("rad-flow", "tz=0.6", radial), ("rad-flow", "tz=-0.8", radial)];

fn ray(e: &Entry) {
    let (camera, p) = (e.camera(), e.pixel());
    let ray = camera.ray(p.x, p.y);
    e.check("ray", ray.as_slice());
    e.check("k_ray", (camera.matrix() * ray).as_slice());
}

fn radial(e: &Entry) {
    let (camera, p, z, t) = (e.camera(), e.pixel(), e.number("z"), e.vector("t"));
    let point = camera.ray(p.x, p.y) * z + Vector3::new(0.0, 0.0, t.z);
    e.check("flow", (camera.project(&point).unwrap() - p).as_slice());
    e.check("formula", radial_flow(&camera, t.z, &p, z).unwrap().as_slice());
    e.check("scale", &[scale_change(z, t.z)]);
}
