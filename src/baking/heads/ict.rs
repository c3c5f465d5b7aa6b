//! Reads the ICT FaceKit head: neutral mesh, expression and identity differences, landmark vertices; turns its eyes.
//!
//! Source axes are y up, z out of the face, x to the person's left, in centimetres. Everything here is turned into the
//! head frame of [`mien_stages::base::geometry`]: metres, y down, z into the head, origin midway between the neutral's inner eye corners.

use std::fmt::Display;
use std::fs;
use std::ops::Range;
use std::path::Path;

use nalgebra::{Point3, Rotation3, Vector3};

use crate::bake::obj;
use mien_simulator::virtual_head::Part;
use mien_stages::base::capacity::LANDMARKS;
use mien_workbench::fault::Fault;
use mien_workbench::text_files::{self, listed};

/// Vertex ranges of the mesh by part (half-open).
pub mod part {
    use std::ops::Range;
    /// The face proper, ears included.
    pub const FACE: Range<usize> = 0..9409;
    /// Face without ears and neck front.
    pub const NARROW_FACE: Range<usize> = 0..6706;
    /// Back of the head and neck.
    pub const HEAD_AND_NECK: Range<usize> = 9409..11248;
    /// Inside of the mouth.
    pub const MOUTH_SOCKET: Range<usize> = 11248..13294;
    /// Behind the lids.
    pub const EYE_SOCKETS: Range<usize> = 13294..14062;
    /// Gums and tongue.
    pub const GUMS_AND_TONGUE: Range<usize> = 14062..17039;
    /// Teeth.
    pub const TEETH: Range<usize> = 17039..21451;
    /// Eyeballs.
    pub const EYEBALLS: Range<usize> = 21451..24591;
    /// Number of all vertices, with lashes and helpers.
    pub const VERTICES: usize = 26719;
}

/// A field of displacements from the neutral, one vector per vertex, metres in the head frame.
pub struct Delta {
    /// Name in the source, for example `jawOpen`, `identity003`.
    pub name: String,
    /// One per vertex.
    pub offsets: Vec<Vector3<f32>>,
}

/// The whole set, in the head frame.
pub struct IctHead {
    /// Neutral vertices.
    pub neutral: Vec<Point3<f32>>,
    /// Triangles (quads split along their first diagonal), as vertex indices, outward normals counter-clockwise in the source.
    pub triangles: Vec<[u32; 3]>,
    /// Texture coordinates of each triangle's corners.
    pub triangle_uv: Vec<[[f32; 2]; 3]>,
    /// Vertex of each of the 68 landmarks.
    pub landmarks: [usize; LANDMARKS],
    /// Expression differences, sorted by name.
    pub expressions: Vec<Delta>,
    /// Identity modes, `identity000` first; coefficients are about N(0, 1).
    pub identities: Vec<Delta>,
}

fn unreadable(path: &Path) -> impl Fn(std::io::Error) -> Fault {
    let expected = "; expected the ICT FaceKit folder with generic_neutral_mesh.obj, expr/ and id/";
    Fault::cannot("read", path, expected)
}

fn malformed(path: &Path, expected: &str, found: impl Display) -> Fault {
    Fault::within(path)(format!("expected {expected}, found {found}"))
}

fn read_text(path: &Path) -> Result<String, Fault> {
    text_files::read(path).map_err(unreadable(path))
}

/// From the source's axes (centimetres, y up, z out of the face) to the head frame's, metres.
pub(super) fn head_axes(v: Vector3<f32>) -> Vector3<f32> {
    Vector3::new(v.x, -v.y, -v.z) * 0.01
}

/// Reads all displacement fields of a folder by name, in the source's axes or transformed, except those of pupils,
/// which no measure uses.
pub(crate) fn read_deltas<T>(
    folder: &Path,
    vertices: usize,
    axes: impl Fn(Vector3<f32>) -> T,
) -> Result<Vec<(String, Vec<T>)>, Fault> {
    let mut deltas = Vec::new();
    for path in listed(folder).map_err(unreadable(folder))? {
        let name = path.file_stem().unwrap_or_default().to_string_lossy();
        let is_delta = path.extension().is_some_and(|ending| ending == "f32");
        if !is_delta || name.starts_with("PupilDilate") {
            continue;
        }
        let bytes = fs::read(&path).map_err(unreadable(&path))?;
        if bytes.len() != vertices * 12 {
            let expected = "three 32-bit floats per vertex of the neutral mesh";
            let found = format!("{} bytes for {vertices} vertices", bytes.len());
            return Err(malformed(&path, expected, found));
        }
        let numbers = bytes.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b));
        let numbers: Vec<f32> = numbers.collect();
        let offsets = numbers.as_chunks::<3>().0.iter();
        let offsets = offsets.map(|&v| axes(Vector3::from(v)));
        deltas.push((name.into_owned(), offsets.collect()));
    }
    Ok(deltas)
}

/// Rotation of eyeballs in a full gaze expression, radians.
const FULL_LOOK: f32 = 0.52;

/// Both eyeballs and their centres.
pub(super) fn eyeballs(neutral: &[Point3<f32>]) -> [(Range<usize>, Point3<f32>); 2] {
    let middle = part::EYEBALLS.start + part::EYEBALLS.len() / 2;
    [part::EYEBALLS.start..middle, middle..part::EYEBALLS.end].map(|ball| {
        let sum: Vector3<f32> = neutral[ball.clone()].iter().map(|p| p.coords).sum();
        let centre = Point3::from(sum / ball.len() as f32);
        (ball, centre)
    })
}

/// Rotates the eyeballs of a neutral head in its gaze expressions, where the source moves only the lids.
pub(super) fn turn_eyes(neutral: &[Point3<f32>], expressions: &mut [Delta]) {
    for expression in expressions {
        let look = expression.name.strip_prefix("eyeLook");
        let Some((to, side)) = look.and_then(|look| look.split_once('_')) else {
            continue;
        };
        // The subject's left is where x grows; the face looks against z.
        let left = if side == "L" { 1.0 } else { -1.0 };
        let axis = match to {
            "Out" => Vector3::y() * -left,
            "In" => Vector3::y() * left,
            "Up" => -Vector3::x(),
            _ => Vector3::x(),
        };
        let rotation = Rotation3::new(axis * FULL_LOOK);
        for (ball, centre) in eyeballs(neutral) {
            if centre.x * left > 0.0 {
                for v in ball {
                    let out = neutral[v] - centre;
                    expression.offsets[v] = rotation * out - out;
                }
            }
        }
    }
}

impl IctHead {
    /// Reads the folder.
    ///
    /// # Errors
    /// If a file is missing or does not fit the mesh.
    pub fn read(folder: &Path) -> Result<Self, Fault> {
        let path = folder.join("generic_neutral_mesh.obj");
        let text = read_text(&path)?;
        const OBJ: &str = "OBJ lines v, vt and f with v/vt corners";
        let mesh = obj::parse(&text).map_err(|error| malformed(&path, OBJ, error))?;
        let raw: Vec<_> = mesh.positions.iter().map(|p| p.map(|v| v as f32)).collect();
        let (mut triangles, mut triangle_uv) = (Vec::new(), Vec::new());
        for fan in mesh.fans() {
            let [Some(a), Some(b), Some(c)] = fan.map(|corner| corner.uv) else {
                return Err(malformed(&path, OBJ, "a corner without vt"));
            };
            triangles.push(fan.map(|corner| corner.vertex));
            triangle_uv.push([a, b, c].map(|uv| mesh.uv[uv as usize]));
        }
        let path = folder.join("landmarks68.txt");
        let landmarks: Vec<usize> = read_text(&path)?
            .split_ascii_whitespace()
            .filter_map(|w| w.parse().ok())
            .collect();
        let count = landmarks.len();
        let on_mesh = landmarks.iter().all(|&v| v < raw.len());
        let landmarks = landmarks.try_into().ok().filter(|_| on_mesh);
        let landmarks: [usize; LANDMARKS] = landmarks.ok_or_else(|| {
            let found = format!("{count} numbers, or one beyond {}", raw.len());
            malformed(&path, "68 indices of the mesh's vertices", found)
        })?;
        let origin = (raw[landmarks[39]] + raw[landmarks[42]]) * 0.5;
        let neutral = raw.iter().map(|v| Point3::from(head_axes(v - origin)));
        let neutral: Vec<_> = neutral.collect();
        let deltas = |kind: &str| {
            let read = read_deltas(&folder.join(kind), neutral.len(), head_axes)?.into_iter();
            let deltas = read.map(|(name, offsets)| Delta { name, offsets });
            Ok::<Vec<_>, Fault>(deltas.collect())
        };
        let (mut expressions, identities) = (deltas("expr")?, deltas("id")?);
        turn_eyes(&neutral, &mut expressions);
        Ok(Self {
            neutral,
            triangles,
            triangle_uv,
            landmarks,
            expressions,
            identities,
        })
    }

    /// Position of an expression by name.
    pub fn expression(&self, name: &str) -> Option<usize> {
        self.expressions.iter().position(|delta| delta.name == name)
    }
}

/// Part of a vertex; `None` for lashes and helper surfaces, which are not drawn.
pub fn vertex_part(vertex: usize) -> Option<Part> {
    [
        (part::FACE, Part::Skin),
        (part::HEAD_AND_NECK, Part::Skin),
        (part::MOUTH_SOCKET, Part::MouthSocket),
        (part::EYE_SOCKETS, Part::EyeSocket),
        (part::GUMS_AND_TONGUE, Part::Gums),
        (part::TEETH, Part::Teeth),
        (part::EYEBALLS, Part::Eye),
    ]
    .into_iter()
    .find_map(|(range, part)| range.contains(&vertex).then_some(part))
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Two balls of 12 mm, covered evenly (Fibonacci).
    pub(crate) fn round_eyes() -> Vec<Point3<f32>> {
        let half = part::EYEBALLS.len() / 2;
        let mut neutral = vec![Point3::origin(); part::EYEBALLS.end];
        for v in part::EYEBALLS {
            let k = v - part::EYEBALLS.start;
            let x = if k < half { -0.03 } else { 0.03 };
            let z = 1.0 - 2.0 * ((k % half) as f32 + 0.5) / half as f32;
            let (r, turn) = ((1.0 - z * z).sqrt(), 2.4 * k as f32);
            neutral[v] = Point3::new(
                x + 0.012 * r * turn.cos(),
                0.012 * r * turn.sin(),
                0.012 * z,
            );
        }
        neutral
    }

    #[test]
    fn eyes_look_where_the_expression_says_and_stay_in_their_sockets() {
        let neutral = round_eyes();
        let half = part::EYEBALLS.len() / 2;
        for (name, side, to) in [
            ("eyeLookOut_L", 1, Vector3::x()),
            ("eyeLookIn_L", 1, -Vector3::x()),
            ("eyeLookOut_R", 0, -Vector3::x()),
            ("eyeLookUp_R", 0, -Vector3::y()),
            ("eyeLookDown_L", 1, Vector3::y()),
            ("eyeBlink_L", 1, Vector3::zeros()),
        ] {
            let mut expressions = [Delta {
                name: name.into(),
                offsets: vec![Vector3::zeros(); neutral.len()],
            }];
            turn_eyes(&neutral, &mut expressions);
            let offsets = &expressions[0].offsets;
            let start = part::EYEBALLS.start + side * half;
            let pupil =
                (start..start + half).min_by(|&a, &b| neutral[a].z.total_cmp(&neutral[b].z));
            let moved = offsets[pupil.expect("a ball")];
            // 12 mm by the sine of 30°.
            assert!(
                (moved.dot(&to) - 0.006 * to.norm()).abs() < 3e-4,
                "{name} {moved}"
            );
            let other = part::EYEBALLS.start + (1 - side) * half;
            assert!(
                offsets[other..other + half]
                    .iter()
                    .all(|o| *o == Vector3::zeros())
            );
            let radius = |v: usize| (neutral[v] + offsets[v] - eyeballs(&neutral)[side].1).norm();
            assert!(
                (start..start + half).all(|v| (radius(v) - 0.012).abs() < 1e-4),
                "{name}"
            );
        }
    }
}
