//! A glTF outside its meshes: transforms by nodes, and data in files beside it or in data URIs.
//!
//! Units: the file's. Limits: of several nodes with a mesh the first counts, for a skinned mesh its first joint;
//! external files must be below the glTF's folder.

use std::path::{Component, Path};

use base64::{Engine as _, engine::general_purpose::STANDARD};
use nalgebra::{Matrix4, Quaternion, Translation3, UnitQuaternion, Vector3, Vector4};
use serde_json::{Value, json};

use super::glb::{Glb, list, parse_json, unexpected};
use mien_stages::base::bounded_read::read_below;
use mien_workbench::fault::Fault;
use mien_workbench::text_files;

/// Longest chain of nodes; a longer one is a cycle.
const DEEPEST: usize = 256;
/// Largest difference of a matrix from the identity that is ignored, relative to the head's unit.
const IDENTITY_TOLERANCE: f64 = 1e-6;

/// The numbers of a JSON array; `None` if there are not exactly `N`.
pub fn numbers<const N: usize>(value: &Value) -> Option<[f64; N]> {
    let numbers: Option<Vec<f64>> = value.as_array()?.iter().map(Value::as_f64).collect();
    numbers?.try_into().ok()
}

/// The local transform of a node.
fn local(node: &Value) -> Matrix4<f64> {
    if let Some(columns) = numbers::<16>(&node["matrix"]) {
        return Matrix4::from_column_slice(&columns);
    }
    let vector = |name: &str, or| Vector3::from(numbers::<3>(&node[name]).unwrap_or([or; 3]));
    let turned = numbers::<4>(&node["rotation"]).unwrap_or([0.0, 0.0, 0.0, 1.0]);
    let turned = Quaternion::from_vector(Vector4::from(turned));
    Translation3::from(vector("translation", 0.0)).to_homogeneous()
        * UnitQuaternion::from_quaternion(turned).to_homogeneous()
        * Matrix4::new_nonuniform_scaling(&vector("scale", 1.0))
}

/// Parent of each node.
pub struct Parents(Vec<Option<usize>>);

impl Parents {
    /// Parents of a glTF's nodes.
    pub fn new(nodes: &[Value]) -> Self {
        let mut parents = vec![None; nodes.len()];
        for (k, node) in nodes.iter().enumerate() {
            for child in list(&node["children"]).iter().filter_map(Value::as_u64) {
                if let Some(parent) = parents.get_mut(child as usize) {
                    *parent = Some(k);
                }
            }
        }
        Self(parents)
    }

    /// A node and its ancestors, upwards.
    pub fn chain(&self, node: usize) -> impl Iterator<Item = usize> {
        std::iter::successors(Some(node), |&k| self.0[k]).take(DEEPEST)
    }
}

/// Transform from each mesh to the scene; `None` if it is the identity or not invertible.
pub(super) fn placed(glb: &Glb) -> Vec<Option<Matrix4<f64>>> {
    let nodes = list(&glb.json["nodes"]);
    let parents = Parents::new(nodes);
    let world = |node: usize| {
        let chain = parents.chain(node);
        chain.fold(Matrix4::identity(), |below, k| local(&nodes[k]) * below)
    };
    let mut placed = vec![None; list(&glb.json["meshes"]).len()];
    let mut met = vec![false; placed.len()];
    for (k, node) in nodes.iter().enumerate() {
        let mesh = node["mesh"].as_u64().map_or(usize::MAX, |m| m as usize);
        if met.get(mesh) != Some(&false) {
            continue;
        }
        met[mesh] = true;
        let held = node["skin"].as_u64().and_then(|skin| {
            let skin = &glb.json["skins"][skin as usize];
            let joint = skin["joints"][0].as_u64().map(|j| j as usize);
            let bind = skin["inverseBindMatrices"].as_u64()? as usize;
            let bind = glb.floats(bind, 16).ok()?;
            let bind = bind.get(..16)?.iter().map(|&x| f64::from(x));
            Some(world(joint.filter(|&j| j < nodes.len())?) * Matrix4::from_iterator(bind))
        });
        let held = match node["skin"].is_null() {
            true => world(k),
            false => held.unwrap_or_else(Matrix4::identity),
        };
        let can_be_undone = held.iter().all(|x| x.is_finite()) && held.try_inverse().is_some();
        let moves = (held - Matrix4::identity()).amax() > IDENTITY_TOLERANCE;
        placed[mesh] = Some(held).filter(|_| moves && can_be_undone);
    }
    placed
}

/// The bytes of a URI: from its text, or from a file below the folder.
fn named(uri: &str, folder: &Path) -> Result<Vec<u8>, Fault> {
    let refuse = |found: String| unexpected("data in the file or in files below its folder", found);
    let data = uri.strip_prefix("data:");
    if let Some((_, text)) = data.and_then(|data| data.split_once(";base64,")) {
        let decoded = STANDARD.decode(text);
        return decoded.map_err(|e| refuse(format!("base64: {e}")));
    }
    let unknown = || refuse(format!("{uri:.80?}"));
    // Percent-encoded characters.
    let mut parts = uri.split('%');
    let mut name = parts.next().unwrap_or_default().as_bytes().to_vec();
    for part in parts {
        let digits = part.get(..2).ok_or_else(unknown)?;
        name.push(u8::from_str_radix(digits, 16).map_err(|_| unknown())?);
        name.extend(&part.as_bytes()[2..]);
    }
    let name = String::from_utf8_lossy(&name).into_owned();
    let below = |c: Component<'_>| matches!(c, Component::Normal(_) | Component::CurDir);
    if name.contains([':', '\\']) || !Path::new(&name).components().all(below) {
        return Err(unknown());
    }
    read_below(folder, &name, text_files::MAX_BYTES).map_err(|e| refuse(format!("{name}: {e}")))
}

impl Glb {
    /// Reads a GLB or glTF text in `folder`: all buffers become one, and external images are embedded if they can be
    /// read.
    ///
    /// # Errors
    /// If it is neither, or a buffer is missing.
    pub fn read(bytes: &[u8], folder: &Path) -> Result<Self, Fault> {
        let mut glb = match bytes.starts_with(b"glTF") {
            true => Self::parse(bytes)?,
            false => Self {
                json: parse_json(bytes)?,
                bin: Vec::new(),
            },
        };
        let buffers = list(&glb.json["buffers"]).to_vec();
        if buffers.len() != 1 || !buffers[0]["uri"].is_null() {
            glb.join(&buffers, folder)?;
        }
        for k in 0..list(&glb.json["images"]).len() {
            let uri = glb.json["images"][k]["uri"].as_str();
            let picture = uri.and_then(|uri| named(uri, folder).ok());
            let kind = picture.as_deref().and_then(super::looks::kind);
            if let (Some(picture), Some(kind)) = (picture, kind) {
                let view = glb.push_view(&picture, 0);
                let image = &mut glb.json["images"][k];
                image["bufferView"] = view.into();
                image["mimeType"] = kind.into();
                image.as_object_mut().map(|image| image.remove("uri"));
            }
        }
        Ok(glb)
    }

    /// Joins all buffers into one.
    fn join(&mut self, buffers: &[Value], folder: &Path) -> Result<(), Fault> {
        let inside = std::mem::take(&mut self.bin);
        let mut starts = Vec::new();
        for buffer in buffers {
            self.bin.resize(self.bin.len().next_multiple_of(16), 0);
            starts.push(self.bin.len() as u64);
            match buffer["uri"].as_str() {
                Some(uri) => self.bin.extend(named(uri, folder)?),
                None => self.bin.extend(&inside),
            }
        }
        let views = self.json["bufferViews"].as_array_mut();
        for view in views.into_iter().flatten() {
            let start = view["buffer"].as_u64().and_then(|b| starts.get(b as usize));
            let from = view["byteOffset"].as_u64().unwrap_or(0);
            view["byteOffset"] = start.map_or(Value::Null, |s| from.saturating_add(*s).into());
            view["buffer"] = 0.into();
        }
        self.json["buffers"] = json!([{"byteLength": self.bin.len()}]);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::mesh::Vec3;
    use super::super::mesh::tests::sheet;
    use super::super::morphs::build;
    use super::super::patch::ImportedGltf;
    use super::super::shape::Shape;
    use super::*;

    /// A sheet in the text of a glTF, its buffer as it is named, under a node that turns and one that scales.
    fn text(uri: impl Fn(&[u8]) -> String) -> Vec<u8> {
        let mut glb = build(&sheet(4, 1.0), &[], 1.0, false, None);
        let half = 0.5_f64.sqrt();
        glb.json["nodes"] = json!([
            {"scale": [2.0, 2.0, 2.0], "children": [2]},
            {"translation": [9.0, 0.0, 0.0]},
            {"rotation": [-half, 0.0, 0.0, half], "translation": [0.0, 0.0, 1.0], "mesh": 0},
        ]);
        glb.json["buffers"][0]["uri"] = uri(&glb.bin).into();
        glb.json.to_string().into_bytes()
    }

    fn inside(bin: &[u8]) -> String {
        format!(
            "data:application/octet-stream;base64,{}",
            STANDARD.encode(bin)
        )
    }

    #[test]
    fn vertices_are_where_nodes_put_them_and_shapes_go_back_the_same_way() {
        let folder = tempfile::tempdir().unwrap();
        let beside = |bin: &[u8]| {
            std::fs::write(folder.path().join("a head.bin"), bin).unwrap();
            "a%20head.bin".to_owned()
        };
        let stored = ImportedGltf::read(build(&sheet(4, 1.0), &[], 1.0, false, None))
            .unwrap()
            .0;
        for text in [text(inside), text(beside)] {
            let glb = Glb::read(&text, folder.path()).unwrap();
            let (mesh, imported) = ImportedGltf::read(glb).unwrap();
            for (p, q) in mesh.positions.iter().zip(&stored.positions) {
                let there = Vec3::new(q.x, q.z, 1.0 - q.y) * 2.0;
                assert!((p - there).norm() < 1e-5, "{p} {there}");
            }
            let shape = Shape {
                name: "up".into(),
                displacement: vec![Vec3::y(); 16],
                area: vec![true; 16],
                ..Shape::default()
            };
            let glb = Glb::parse(&imported.patched(&mesh, &[shape], true).emit()).unwrap();
            let target = &glb.json["meshes"][0]["primitives"][0]["targets"][0];
            let rows = glb
                .floats(target["POSITION"].as_u64().unwrap() as usize, 3)
                .unwrap();
            assert!(
                (Vec3::new(rows[0].into(), rows[1].into(), rows[2].into()) - Vec3::z() * 0.5)
                    .norm()
                    < 1e-6
            );
        }
    }

    #[test]
    fn references_out_of_the_folder_are_refused_by_name() {
        let root = tempfile::tempdir().unwrap();
        let folder = root.path().join("head");
        std::fs::create_dir(&folder).unwrap();
        std::fs::write(root.path().join("secret.bin"), [0; 999]).unwrap();
        std::os::unix::fs::symlink("../secret.bin", folder.join("link.bin")).unwrap();
        let pipe = folder.join("pipe.bin");
        let made = std::process::Command::new("mkfifo").arg(pipe).status();
        assert!(made.unwrap().success());
        for (uri, word) in [
            ("gone.bin", "gone.bin"),
            ("link.bin", "expected a file inside"),
            ("pipe.bin", "not a regular file"),
            ("/dev/zero", "below its folder"),
            ("../head.bin", "../head.bin"),
            ("/etc/passwd", "below its folder"),
            ("https://example.org/head.bin", "example.org"),
            ("data:x;base64,?", "base64"),
            ("%4", "%4"),
        ] {
            let text = text(|_| uri.to_owned());
            let said = Glb::read(&text, &folder).err().expect(uri).to_string();
            assert!(said.contains(word), "{said}");
        }
        assert!(Glb::read(b"{", &folder).is_err());
        assert!(Glb::read(b"[]", &folder).is_err());
        // Pictures stay where they are named.
        for uri in ["link.bin", "pipe.bin", "/dev/zero"] {
            let mut glb: Value = serde_json::from_slice(&text(inside)).unwrap();
            glb["images"] = json!([{"uri": uri}]);
            let read = Glb::read(glb.to_string().as_bytes(), &folder).unwrap();
            assert_eq!(read.json["images"][0], json!({"uri": uri}));
        }
    }

    #[test]
    fn nodes_in_a_ring_end() {
        let nodes = json!([{"children": [1], "mesh": 0}, {"children": [0]}]);
        let json = json!({"nodes": nodes, "meshes": [{}]});
        let bin = Vec::new();
        assert_eq!(placed(&Glb { json, bin }), [None]);
    }
}
