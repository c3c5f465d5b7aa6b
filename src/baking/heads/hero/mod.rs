//! The default head of page, `mien-studio head`, examples and images: a synthetic person with hair, lashes, eyes that
//! meet the viewer's, and a shirt.
//!
//! ```text
//! make      ICT-FaceKit's neutral mesh ─► config/hero.head
//! layer     a mesh with colours; look: indices of its materials
//! skin      colours of skin, brows and lips: one image wrapped around the head
//! eyes      white, iris and pupil: one image
//! lashes    blades along the guide lines of the file
//! ```
//! Hair and shirt (`dress.glb`) and the images of skin and eyes are stored. They fit the mesh of `config/hero.head`
//! only: after a new `--make` they must be remade. Frame: glTF's (x to the head's left, y up, z out of the face),
//! metres, origin between the inner eye corners.

mod eyes;
mod lashes;
mod layer;
mod look;
pub mod make;
mod skin;

use mien_stages::base::geometry::smoothstep;

use crate::bake::glb::Glb;
use crate::bake::mesh::Vec3;
pub use layer::Layer;
use mien_simulator::virtual_head::{HeadAsset, Part};
use mien_workbench::fault::Fault;
use mien_workbench::srgb;

/// Material of a surface.
pub struct Look {
    /// Name of the material.
    pub name: &'static str,
    /// Roughness: 0 mirror, 1 chalk.
    pub rough: f32,
    /// Colour, linear.
    pub colour: [f32; 3],
    /// Image that multiplies the colour, a JPEG.
    pub picture: Option<&'static [u8]>,
    /// Whether it is visible from both sides.
    pub thin: bool,
}

/// The head.
pub struct Hero {
    /// Parts that move with a face: skin, mouth, eyes, lashes.
    pub face: Layer,
    /// Parts that do not: hair, shirt.
    pub dress: Layer,
    /// Vertices of `face` that are the 68 landmarks.
    pub landmarks: Vec<u64>,
    /// Materials of both.
    pub looks: Vec<Look>,
}

/// Middle of the joint between head and neck.
pub const JOINT: Vec3 = Vec3::new(0.0, -0.055, -0.098);
/// Lower end of the neck.
pub const NECK: Vec3 = Vec3::new(0.0, -0.165, -0.112);

/// Share of the head's rotation at a point, from 0 at the lower end of the neck to 1 from the jaw up.
pub fn turns(p: &Vec3) -> f64 {
    // The border slants: it rises towards the front by a third of the depth.
    smoothstep(-0.172, -0.098, p.y + 0.35 * (p.z + 0.085))
}

impl Hero {
    /// The head built into the program.
    pub fn shipped() -> Self {
        Self::from_asset(&HeadAsset::parse(include_bytes!(
            "../../../../config/hero.head"
        )))
    }

    fn from_asset(asset: &HeadAsset) -> Self {
        let upright = |p: &mien_stages::base::geometry::Point| {
            Vec3::new(f64::from(p.x), f64::from(-p.y), f64::from(-p.z))
        };
        let all = (0..asset.neutral.len()).map(|v| upright(&make::exact_place(asset, v)));
        let all: Vec<Vec3> = all.collect();
        let (places, guides) = all.split_at(all.len() - make::GUIDES);
        let landmarks = asset.landmarks.iter();
        let landmarks: Vec<u64> = landmarks.map(|site| site.vertices[0].into()).collect();
        let marks: Vec<Vec3> = landmarks.iter().map(|&v| places[v as usize]).collect();
        let triangles = asset.triangles.iter().map(|&[a, c, b]| [a, b, c]);
        let parts = asset.parts.iter().copied();
        let mut face = Layer::default();
        face.mesh.positions = places.to_vec();
        for (corners, part) in quads(triangles.zip(parts)) {
            face.face(&corners, look_index(&corners, part, places));
        }
        let kind = kinds(asset, places.len());
        let normals = face.mesh.vertex_normals(places);
        let tint = |v: usize| {
            let light = asset.colour[v][0] / 255.0;
            tint(kind[v], light, &places[v], &normals[v], &marks)
        };
        let uv = |v: usize| match kind[v] {
            Part::Eye => eyes::place_in_picture(&places[v]),
            _ => skin::place_in_picture(&places[v]),
        };
        face.tints = (0..places.len()).map(tint).collect();
        face.uv = (0..places.len()).map(uv).collect();
        let mut dress = dress().expect("the file is compiled in");
        lashes::grow(&mut face, guides);
        let looks = looks();
        for layer in [&mut face, &mut dress] {
            layer.mesh.materials = looks.iter().map(|look| look.name.to_owned()).collect();
        }
        Self {
            face,
            dress,
            landmarks,
            looks,
        }
    }
}

/// Hair and shirt of `dress.glb`: accessor 0 has positions, 1 colours, 2 the triangles of the hair, 3 those of the shirt.
fn dress() -> Result<Layer, Fault> {
    let glb = Glb::parse(include_bytes!("dress.glb"))?;
    let [places, tints] = [glb.floats(0, 3)?, glb.floats(1, 3)?];
    let mut dress = Layer::default();
    for (place, tint) in places.as_chunks().0.iter().zip(tints.as_chunks().0) {
        dress.vertex(place.map(f64::from).into(), *tint);
    }
    for (accessor, look) in [(2, look::HAIR), (3, look::SHIRT)] {
        let corners = glb.indices(accessor)?;
        for (corners, look) in quads(corners.as_chunks().0.iter().map(|t| (*t, look))) {
            dress.face(&corners, look);
        }
    }
    Ok(dress)
}

/// sRGB to linear light (IEC 61966-2-1), both 0…1.
fn linear(v: f32) -> f32 {
    srgb::linear(f64::from(v)) as f32
}

/// Index of the look of a face.
fn look_index(corners: &[u32], part: Part, places: &[Vec3]) -> usize {
    let all = |holds: fn(&Vec3) -> bool| corners.iter().all(|&v| holds(&places[v as usize]));
    match part {
        Part::Skin if all(skin::is_under_shirt) => look::SHIRT,
        Part::Skin if all(skin::reaches) => look::SKIN,
        Part::Skin => look::BEHIND,
        Part::MouthSocket => look::MOUTH,
        Part::Gums => look::GUMS,
        Part::Teeth => look::TEETH,
        Part::Eye => look::EYES,
        Part::EyeSocket => look::SOCKETS,
    }
}

fn looks() -> Vec<Look> {
    let look = |name, rough, rgb: [f32; 3]| Look {
        name,
        rough,
        colour: rgb.map(linear),
        picture: None,
        thin: false,
    };
    let pictured = |name, rough, picture| Look {
        picture: Some(picture),
        ..look(name, rough, [1.0; 3])
    };
    let thin = |look| Look { thin: true, ..look };
    vec![
        pictured("skin", 0.76, skin::PICTURE),
        look("skin_behind", 0.76, skin::COLOUR),
        look("mouth", 0.5, [0.60, 0.29, 0.28]),
        look("gums", 0.4, [0.78, 0.42, 0.41]),
        look("teeth", 0.25, [0.95, 0.93, 0.88]),
        pictured("eyes", 0.12, eyes::PICTURE),
        look("sockets", 0.7, [0.72, 0.45, 0.40]),
        thin(look("lashes", 0.8, [0.10, 0.065, 0.05])),
        thin(look("hair", 0.72, [1.0; 3])),
        thin(look("shirt", 0.9, [0.17, 0.25, 0.32])),
    ]
}

/// Factor of a vertex's colour: ambient light, and redder skin.
fn tint(part: Part, light: f32, p: &Vec3, normal: &Vec3, marks: &[Vec3]) -> [f32; 3] {
    // Little light reaches the back of an open mouth.
    let behind = (1.15 - (marks[62].z - p.z) as f32 / 0.034).clamp(0.10, 1.0);
    match part {
        Part::Skin => {
            // Only hollows are darkened, other shading is left to the renderer's lights.
            let light = f64::from(light);
            let shade = (0.12 + 0.88 * smoothstep(0.0, 0.5, light)) * (0.84 + 0.16 * light);
            let shade = shade as f32 * (1.0 - 0.62 * lid(p, marks));
            // Light scattered in skin is red.
            let [r, g, b] = [0.60, 1.0, 1.08].map(|k: f32| shade.powf(k));
            let ear = smoothstep(0.070, 0.082, p.x.abs()) as f32;
            let ear = ear * smoothstep(-0.075, -0.055, p.y) as f32;
            // The inner lips are as red as the outer; the nape, at the same height, also faces back.
            let front = smoothstep(-0.060, -0.040, p.z);
            let near = front
                * smoothstep(0.012, 0.006, (p.y + 0.0665).abs())
                * smoothstep(0.030, 0.024, p.x.abs());
            let inner = (near * smoothstep(0.15, -0.25, normal.z)) as f32;
            let red = |k: usize| 1.0 - ear * [0.0, 0.16, 0.18][k] - inner * [0.30, 0.55, 0.52][k];
            [r * red(0), g * red(1), b * red(2)]
        }
        Part::Eye => {
            let shade = 0.50 + 0.50 * light.powf(0.7);
            [shade; 3]
        }
        Part::EyeSocket => [0.6; 3],
        _ => [behind; 3],
    }
}

/// Nearness to the roots of the lashes, 0…1: lids are darker there, the upper ones more.
fn lid(p: &Vec3, marks: &[Vec3]) -> f32 {
    const WIDE_M: f64 = 0.0017;
    let mut best: f64 = 0.0;
    for (line, strength) in [
        ([36, 37, 38, 39], 1.0),
        ([42, 43, 44, 45], 1.0),
        ([36, 41, 40, 39], 0.55),
        ([42, 47, 46, 45], 0.55),
    ] {
        let points = line.map(|k| marks[k]);
        if (p - nalgebra::center(&points[0].into(), &points[3].into()).coords).norm() > 0.025 {
            continue;
        }
        for k in 0..=24 {
            let d = (lashes::curve(&points, f64::from(k) / 8.0) - p).norm();
            best = best.max(strength * smoothstep(WIDE_M, 0.0003, d));
        }
    }
    best as f32
}

/// Part of every vertex.
fn kinds(asset: &HeadAsset, count: usize) -> Vec<Part> {
    let mut kind = vec![Part::Skin; count];
    for (t, &part) in asset.triangles.iter().zip(asset.parts.iter()).rev() {
        for &v in t {
            // Vertices shared by parts belong to the skin.
            if kind[v as usize] == Part::Skin {
                kind[v as usize] = part;
            }
        }
    }
    for (t, &part) in asset.triangles.iter().zip(asset.parts.iter()) {
        if part == Part::Skin {
            t.iter().for_each(|&v| kind[v as usize] = Part::Skin);
        }
    }
    kind
}

/// Faces before quads were cut along their first diagonal: both halves are consecutive and of one kind.
fn quads<K: PartialEq>(triangles: impl Iterator<Item = ([u32; 3], K)>) -> Vec<(Vec<u32>, K)> {
    let mut faces: Vec<(Vec<u32>, K)> = Vec::new();
    for ([a, b, c], kind) in triangles {
        match faces.last_mut() {
            Some((face, same))
                if face.len() == 3 && (face[0], face[2]) == (a, b) && *same == kind =>
            {
                face.push(c);
            }
            _ => faces.push((vec![a, b, c], kind)),
        }
    }
    faces
}
