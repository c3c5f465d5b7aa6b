//! Joints of neck and head for a mesh without a skeleton, so that the shoulders stay when the head turns.
//!
//! Every vertex has a share of the head's rotation: 1 above a slanted border at the chin, 0 a neck's length below, a
//! smooth step between. Lengths in inner-eye-corner distances, in the face's axes, measured on the built-in head.

use mien_stages::base::geometry::smoothstep;
use serde_json::json;

use super::glb::{Glb, VERTICES};
use super::head::Head;
use super::mesh::Vec3;

/// Slope of the border: rise towards the front per depth.
const LEAN: f64 = 0.35;
/// Depth behind the eyes at which the border's height counts.
const BEHIND: f64 = 2.3;
/// Height of the upper border over the chin.
const UPPER_BORDER: f64 = 0.28;
/// Height of the lower border over the chin.
const LOWER_BORDER: f64 = -1.73;
/// Height of the head's joint as share of the chin's, and its depth behind the eyes.
const JOINT: [f64; 2] = [0.51, 2.66];
/// Height of the neck's lower end as share of the chin's, and its depth behind the eyes.
const BASE: [f64; 2] = [1.53, 3.04];

/// Names of the joints; `animate` turns the last one.
pub(crate) const JOINTS: [&str; 2] = ["neck", "head"];
const U8: u32 = 5121;

/// The joints of a head, and the share of its rotation for each vertex.
pub struct Neck {
    /// Lower end of the neck and joint of the head, mesh units.
    pub places: [Vec3; 2],
    /// Share of the head's turns, 0 to 1, by vertex.
    pub shares: Vec<f32>,
}

impl Neck {
    /// The neck for vertices at `positions`; `None` for a mesh that ends above it.
    pub fn from_head(head: &Head, positions: &[Vec3]) -> Option<Self> {
        let (middle, w) = ((head.point(39) + head.point(42)) / 2.0, head.eye_distance);
        let seen = |p: Vec3| head.axes.transpose() * (p - middle) / w;
        let chin = seen(head.point(8)).y;
        let share = |q: Vec3| {
            smoothstep(
                chin + LOWER_BORDER,
                chin + UPPER_BORDER,
                q.y + LEAN * (q.z + BEHIND),
            ) as f32
        };
        let shares: Vec<f32> = positions.iter().map(|&p| share(seen(p))).collect();
        let place = |[height, behind]: [f64; 2]| {
            middle + head.axes * Vec3::new(0.0, height * chin, -behind) * w
        };
        let has_neck = shares.iter().any(|&share| share < 0.5);
        has_neck.then(|| Self {
            places: [BASE, JOINT].map(place),
            shares,
        })
    }
}

/// Vertex attributes for these shares: accessors of `JOINTS_0` and `WEIGHTS_0`.
pub(crate) fn weighed(glb: &mut Glb, shares: impl ExactSizeIterator<Item = f32>) -> [usize; 2] {
    let view = glb.push_view(&[0_u8, 1, 0, 0].repeat(shares.len()), VERTICES);
    let joints = glb.push_accessor(
        json!({"bufferView": view, "componentType": U8, "count": shares.len(), "type": "VEC4"}),
    );
    let rows: Vec<[f32; 4]> = shares.map(|head| [1.0 - head, head, 0.0, 0.0]).collect();
    [joints, glb.push_rows(&rows, VERTICES)]
}

/// Adds the joints at `places`, metres, to the scene and skins every node that has a mesh.
pub(crate) fn joined(glb: &mut Glb, places: &[Vec3; 2]) {
    let [base, joint] = places;
    // Inverse bind matrices, column by column.
    let back = places.map(|to| {
        let [x, y, z] = (-to).cast::<f32>().into();
        let mut m = [0.0_f32; 16];
        [m[0], m[5], m[10], m[15]] = [1.0; 4];
        [m[12], m[13], m[14]] = [x, y, z];
        m
    });
    let inverse = glb.push_rows(&back, 0);
    let nodes = glb.json["nodes"].as_array_mut().expect("written here");
    let neck = nodes.len();
    for node in nodes.iter_mut().filter(|node| !node["mesh"].is_null()) {
        node["skin"] = 0.into();
    }
    let [lower, upper] = JOINTS;
    nodes.push(json!({"name": lower, "translation": base.cast::<f32>().as_slice(), "children": [neck + 1]}));
    nodes.push(json!({"name": upper, "translation": (joint - base).cast::<f32>().as_slice()}));
    let roots = glb.json["scenes"][0]["nodes"].as_array_mut();
    roots.expect("written here").push(neck.into());
    glb.json["skins"] =
        json!([{"joints": [neck, neck + 1], "inverseBindMatrices": inverse, "skeleton": neck}]);
}
