//! A world: faces, materials, light, camera path, and the moving object if there is one.

use dimode_geometry::Se3;
use nalgebra::Vector3;

use super::config::{Preset, SyntheticConfig};
use super::face::{Face, Mesh};
use super::material::colour;
use super::random::Draw;
use super::road::Road;
use super::texture::{Material, NoiseTable};
use super::{handheld, lateral, street};

/// What covers the ground face.
pub enum Surface {
    /// A plain material in surface coordinates.
    Plain(Material),
    /// The road, in world (x, z).
    Road(Box<Road>),
}

/// Sun, ambient light and the colours of the sky.
pub struct Light {
    /// Unit vector towards the sun, world frame (y down).
    pub sun: Vector3<f64>,
    /// Light that reaches every face.
    pub ambient: f64,
    /// Light of the sun on a face that looks at it.
    pub direct: f64,
    /// Sky colour at the horizon and at the zenith.
    pub sky: [[f32; 3]; 2],
    /// Metres of air after which 1/e of a colour is left, the rest being that of the horizon; infinite without haze.
    pub clear: f32,
}

impl Light {
    fn new(draw: &mut Draw, haze: bool) -> Self {
        let (azimuth, height) = (draw.range(0.0, std::f64::consts::TAU), draw.range(0.5, 1.2));
        let horizon = colour(draw, 0.7, 0.9, 0.08);
        let light = draw.range(0.5, 0.7);
        Self {
            sun: Vector3::new(azimuth.sin() * height.cos(), -height.sin(), azimuth.cos() * height.cos()),
            ambient: draw.range(0.55, 0.72),
            direct: draw.range(0.35, 0.5),
            sky: [horizon, [0.62 * light, 0.8 * light, 1.15 * light].map(|c| c as f32)],
            clear: if haze { draw.log_range(50.0, 150.0) as f32 } else { f32::INFINITY },
        }
    }

    /// Light on a face with the given unit normal: Lambert's law with a little light from above.
    pub fn on(&self, normal: &Vector3<f64>) -> f32 {
        let above = 0.06 * -normal.y;
        (self.ambient + above + self.direct * normal.dot(&self.sun).max(0.0)) as f32
    }
}

/// One static scene with the camera path through it.
pub struct World {
    /// Faces; those of the moving object are in its own frame.
    pub faces: Vec<Face>,
    /// Light on every face.
    pub light_on: Vec<f32>,
    /// Surfaces by the number that faces carry.
    pub surfaces: Vec<Surface>,
    /// The lattice of all noise.
    pub table: NoiseTable,
    /// Sun and sky.
    pub light: Light,
    /// World from camera, one a frame.
    pub poses: Vec<Se3>,
    /// World from moving object, one a frame; empty without one.
    pub object_poses: Vec<Se3>,
}

/// What a preset's builder makes.
pub struct Scene {
    /// All faces.
    pub mesh: Mesh,
    /// All surfaces.
    pub surfaces: Vec<Surface>,
    /// World from camera, one a frame.
    pub poses: Vec<Se3>,
    /// World from moving object, one a frame.
    pub object_poses: Vec<Se3>,
}

impl Scene {
    /// Adds a material and returns its number.
    pub fn material(&mut self, material: Material) -> usize {
        self.surfaces.push(Surface::Plain(material));
        self.surfaces.len() - 1
    }

    /// An empty scene along a camera path.
    pub fn new(poses: Vec<Se3>) -> Self {
        Self { mesh: Mesh::default(), surfaces: Vec::new(), poses, object_poses: Vec::new() }
    }
}

impl World {
    /// The world of one sequence.
    pub fn new(config: &SyntheticConfig, sequence: usize) -> Self {
        let seed = config.world_seed(sequence);
        let scene = match config.preset {
            Preset::Street => street::build(seed, config.frames, config.moving_object),
            Preset::Handheld => handheld::build(seed, config.frames, config.moving_object),
            Preset::Lateral => lateral::build(seed, config.frames, config.moving_object),
        };
        let light = Light::new(&mut Draw::new(seed, 90), config.preset == Preset::Street);
        let light_on = scene.mesh.faces.iter().map(|face| light.on(&face.normal)).collect();
        Self {
            light_on,
            faces: scene.mesh.faces,
            surfaces: scene.surfaces,
            table: NoiseTable::new(&mut Draw::new(seed, 91)),
            light,
            poses: scene.poses,
            object_poses: scene.object_poses,
        }
    }

    /// Camera from geometry of static faces and of faces of the moving object at a frame.
    pub fn camera_from(&self, frame: usize) -> [Se3; 2] {
        let camera_from_world = self.poses[frame].inverse();
        let object = self.object_poses.get(frame).copied().unwrap_or_else(Se3::identity);
        [camera_from_world, camera_from_world * object]
    }

    /// Maps points in the target camera to the source camera, for the static scene and for the moving object.
    pub fn source_from_target(&self, target: usize, source: usize) -> [Se3; 2] {
        let (to, from) = (self.camera_from(source), self.camera_from(target));
        [to[0] * from[0].inverse(), to[1] * from[1].inverse()]
    }
}
