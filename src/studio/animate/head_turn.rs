//! The nodes of a glTF file that turn with the head, and their rotations for a recorded run.
//!
//! A head bone (of a VRM, or a joint whose name ends in "head") is rotated in place, so that a neck stays. Without
//! one, the nodes of the animated meshes rotate about the middle of their mesh. Nodes with a matrix cannot be
//! animated and stay.
//!
//! Frames: the sensor's head frame (y down, z in) becomes glTF's (y up, z out); VRM 0 faces the other way.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use serde_json::Value;

use mien_baking::bake::glb::{Glb, list};
use mien_baking::bake::patch::position;
use mien_baking::bake::scene::{self, Parents};

/// An animated node.
pub(super) struct Turned {
    /// Index of the node.
    pub(super) node: usize,
    /// Rotation of its parent in the scene.
    parent: UnitQuaternion<f32>,
    /// Its own rotation at rest.
    rest: UnitQuaternion<f32>,
    /// For a node that rotates about a point other than its origin: that point in the parent's frame, and the origin
    /// relative to it.
    about: Option<[Vector3<f32>; 2]>,
    /// Whether the model faces −z.
    backwards: bool,
}

fn numbers<const N: usize>(value: &Value, otherwise: [f32; N]) -> [f32; N] {
    scene::numbers(value).map_or(otherwise, |numbers| numbers.map(|x| x as f32))
}

fn rotation(node: &Value) -> UnitQuaternion<f32> {
    let [x, y, z, w] = numbers(&node["rotation"], [0.0, 0.0, 0.0, 1.0]);
    let q = Quaternion::new(w, x, y, z);
    UnitQuaternion::try_new(q, 1e-6).unwrap_or_default()
}

/// Combined rotation of a node's ancestors.
fn above(json: &Value, node: usize) -> UnitQuaternion<f32> {
    let nodes = list(&json["nodes"]);
    let parents = Parents::new(nodes);
    let above = parents.chain(node).skip(1);
    above.fold(UnitQuaternion::identity(), |below, up| {
        rotation(&nodes[up]) * below
    })
}

/// The head's bone.
fn bone(json: &Value) -> Option<usize> {
    let extensions = &json["extensions"];
    let first = extensions["VRMC_vrm"]["humanoid"]["humanBones"]["head"]["node"].as_u64();
    let mut listed = list(&extensions["VRM"]["humanoid"]["humanBones"]).iter();
    let listed = listed.find(|bone| bone["bone"] == "head");
    let listed = listed.and_then(|bone| bone["node"].as_u64());
    let named = |&joint: &u64| {
        let name = json["nodes"][joint as usize]["name"].as_str();
        name.is_some_and(|name| name.to_lowercase().ends_with("head"))
    };
    let joints = list(&json["skins"]).iter();
    let joints = joints.flat_map(|skin| list(&skin["joints"]));
    let joint = joints.filter_map(Value::as_u64).find(named);
    first.or(listed).or(joint).map(|node| node as usize)
}

impl Turned {
    /// The nodes of a file that turn with the head; `meshes` are the animated ones.
    pub(super) fn find(glb: &Glb, meshes: &[usize]) -> Vec<Self> {
        let json = &glb.json;
        let nodes = list(&json["nodes"]);
        let movable = |node: usize| nodes.get(node).is_some_and(|n| n["matrix"].is_null());
        let turned = |node: usize, about| Self {
            node,
            parent: above(json, node),
            rest: rotation(&nodes[node]),
            about,
            backwards: !json["extensions"]["VRM"].is_null(),
        };
        if let Some(node) = bone(json) {
            let bone = movable(node).then(|| turned(node, None));
            return Vec::from_iter(bone);
        }
        let carried = |k: usize| {
            let node = &nodes[k];
            let mesh = node["mesh"].as_u64().map(|m| m as usize);
            // A skinned mesh is placed by its skeleton, not its node.
            mesh.filter(|m| meshes.contains(m) && node["skin"].is_null() && movable(k))
        };
        let own = (0..nodes.len()).filter_map(|k| Some((k, carried(k)?)));
        own.map(|(k, mesh)| {
            let node = &nodes[k];
            let scale = Vector3::from(numbers(&node["scale"], [1.0; 3]));
            let origin = Vector3::from(numbers(&node["translation"], [0.0; 3]));
            let arm = rotation(node) * middle(json, mesh).component_mul(&scale);
            turned(k, Some([origin + arm, -arm]))
        })
        .collect()
    }

    /// Rotation of the node for a pose (x, y, z, w in the sensor's head frame), and its translation if that changes
    /// too.
    pub(super) fn posed(&self, pose: [f32; 4]) -> ([f32; 4], Option<[f32; 3]>) {
        let [x, y, z, w] = pose;
        let side = if self.backwards { -1.0 } else { 1.0 };
        let q = Quaternion::new(w, side * x, -y, -side * z);
        let turn = UnitQuaternion::try_new(q, 1e-6).unwrap_or_default();
        // In the parent's frame.
        let turn = self.parent.inverse() * turn * self.parent;
        let now = turn * self.rest;
        let moved = self.about.map(|[point, back]| (point + turn * back).into());
        ([now.i, now.j, now.k, now.w], moved)
    }
}

/// Middle of a mesh, from the bounds in its file.
fn middle(json: &Value, mesh: usize) -> Vector3<f32> {
    let bounds = list(&json["meshes"][mesh]["primitives"]).iter();
    let bounds = bounds.filter_map(|primitive| {
        let accessor = &json["accessors"][position(primitive)?];
        let [low, high] = ["min", "max"].map(|end| scene::numbers(&accessor[end]));
        Some([low?, high?].map(|end: [f64; 3]| Vector3::from(end.map(|x| x as f32))))
    });
    let wider =
        |[low, high]: [Vector3<f32>; 2], [a, b]: [Vector3<f32>; 2]| [low.inf(&a), high.sup(&b)];
    let [low, high] = bounds.reduce(wider).unwrap_or_default();
    (low + high) / 2.0
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    /// A turn of 90° about the head frame's y, which points down.
    const TO_ONE_SIDE: [f32; 4] = [
        0.0,
        std::f32::consts::FRAC_1_SQRT_2,
        0.0,
        std::f32::consts::FRAC_1_SQRT_2,
    ];

    fn close(a: &[f32], b: &[f32]) -> bool {
        a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-5)
    }

    #[test]
    fn a_bone_turns_in_its_parents_axes_and_the_neck_is_left() {
        let half = std::f32::consts::FRAC_1_SQRT_2;
        let json = json!({
            "nodes": [
                {"mesh": 0, "skin": 0},
                // The neck lies on its side.
                {"name": "neck", "rotation": [0.0, 0.0, half, half], "children": [2]},
                {"name": "J_Bip_C_Head"},
            ],
            "skins": [{"joints": [1, 2]}],
        });
        let glb = Glb {
            json,
            bin: Vec::new(),
        };
        let found = Turned::find(&glb, &[0]);
        assert_eq!(found.iter().map(|t| t.node).collect::<Vec<_>>(), [2]);
        let (rotation, moved) = found[0].posed(TO_ONE_SIDE);
        assert!(moved.is_none());
        // In the scene: parent · own = turn about −y · parent.
        let [x, y, z, w] = rotation;
        let own = UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z));
        let parent = UnitQuaternion::new_unchecked(Quaternion::new(half, 0.0, 0.0, half));
        let nose = parent * own * parent.inverse() * Vector3::z();
        assert!(close(nose.as_slice(), &[-1.0, 0.0, 0.0]), "{nose}");
    }

    #[test]
    fn a_mesh_without_bones_turns_about_its_middle() {
        let json = json!({
            "nodes": [{"mesh": 0, "translation": [5.0, 0.0, 0.0], "scale": [2.0, 2.0, 2.0]}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
            "accessors": [{"min": [0.0, 1.0, 0.0], "max": [2.0, 1.0, 4.0]}],
        });
        let glb = Glb {
            json,
            bin: Vec::new(),
        };
        let found = Turned::find(&glb, &[0]);
        let (rotation, moved) = found[0].posed(TO_ONE_SIDE);
        let [x, y, z, w] = rotation;
        let turn = UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z));
        let at = turn * (Vector3::new(1.0, 1.0, 2.0) * 2.0) + Vector3::from(moved.unwrap());
        assert!(close(at.as_slice(), &[7.0, 2.0, 4.0]), "{at}");
    }
}
