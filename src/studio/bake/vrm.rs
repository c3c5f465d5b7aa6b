//! Expressions of VRM avatars: every new shape gets one under its "Perfect Sync" name, the shape's with a capital letter.
//!
//! VRM 0 lists `blendShapeGroups` that bind targets by mesh with weights up to 100, VRM 1 has `expressions` that bind them
//! by node with weights up to 1. Expressions that are there stay as they are, also one that has the name of a shape
//! already: their targets keep their numbers, because shapes are only appended or replaced in place.

use serde_json::{Value, json};

use super::glb::GlbError;

/// Where the targets of one mesh went: the glTF mesh, and name and number of each target that moves something there.
pub(super) struct Bound {
    pub(super) mesh: usize,
    pub(super) targets: Vec<(String, usize)>,
}

/// Whether expressions can be added: where they belong is what it should be, or not there yet.
pub(super) fn add_expressions_to(json: &Value) -> Result<(), GlbError> {
    let of = |value: &Value, list: bool| {
        value.is_null() || value.is_object() && !list || value.is_array() && list
    };
    let old = &json["extensions"]["VRM"]["blendShapeMaster"];
    let new = &json["extensions"]["VRMC_vrm"]["expressions"];
    for (expected, value, list) in [
        ("blendShapeMaster of VRM as an object", old, false),
        (
            "blendShapeGroups of VRM as a list",
            &old["blendShapeGroups"],
            true,
        ),
        ("expressions of VRMC_vrm as an object", new, false),
        (
            "custom expressions of VRMC_vrm as an object",
            &new["custom"],
            false,
        ),
    ] {
        if !of(value, list) {
            let found = value.to_string().chars().take(40).collect();
            return Err(GlbError::Content { expected, found });
        }
    }
    Ok(())
}

/// Adds expressions for the targets; files that are no VRM stay as they are.
pub(super) fn add_expressions(json: &mut Value, bound: &[Bound]) {
    let mut names: Vec<&str> = Vec::new();
    for (name, _) in bound.iter().flat_map(|b| &b.targets) {
        if !names.contains(&name.as_str()) {
            names.push(name);
        }
    }
    let places = |name: &str| -> Vec<(usize, usize)> {
        let of = |b: &Bound| Some((b.mesh, b.targets.iter().find(|t| t.0 == name)?.1));
        bound.iter().filter_map(of).collect()
    };
    let nodes = json["nodes"].as_array().cloned().unwrap_or_default();
    if json["extensions"]["VRM"].is_object() {
        let groups = &mut json["extensions"]["VRM"]["blendShapeMaster"]["blendShapeGroups"];
        let mut list = groups.as_array().cloned().unwrap_or_default();
        let had: Vec<String> = list.iter().map(|g| text(&g["name"])).collect();
        for name in names.iter().filter(|name| !known(&had, name)) {
            let binds: Vec<Value> = places(name)
                .iter()
                .map(|(mesh, index)| json!({"mesh": mesh, "index": index, "weight": 100.0}))
                .collect();
            list.push(json!({
                "name": capital(name), "presetName": "unknown", "isBinary": false,
                "binds": binds, "materialValues": [],
            }));
        }
        *groups = json!(list);
    }
    if json["extensions"]["VRMC_vrm"].is_object() {
        let expressions = &mut json["extensions"]["VRMC_vrm"]["expressions"];
        let keys = |kind: &str| expressions[kind].as_object().into_iter().flatten();
        let had: Vec<String> = keys("preset")
            .chain(keys("custom"))
            .map(|(k, _)| k.clone())
            .collect();
        let mut custom = expressions["custom"]
            .as_object()
            .cloned()
            .unwrap_or_default();
        for name in names.iter().filter(|name| !known(&had, name)) {
            let binds: Vec<Value> = places(name)
                .iter()
                .flat_map(|&(mesh, index)| {
                    let uses = move |(_, n): &(usize, &Value)| n["mesh"] == json!(mesh);
                    let bind =
                        move |(node, _)| json!({"node": node, "index": index, "weight": 1.0});
                    nodes.iter().enumerate().filter(uses).map(bind)
                })
                .collect();
            custom.insert(
                capital(name),
                json!({
                    "isBinary": false, "morphTargetBinds": binds,
                    "overrideBlink": "none", "overrideLookAt": "none", "overrideMouth": "none",
                }),
            );
        }
        expressions["custom"] = Value::Object(custom);
    }
}

fn text(value: &Value) -> String {
    value.as_str().unwrap_or_default().to_owned()
}

fn known(had: &[String], name: &str) -> bool {
    had.iter().any(|h| h.eq_ignore_ascii_case(name))
}

/// The name with a capital first letter.
fn capital(name: &str) -> String {
    let mut letters = name.chars();
    letters.next().map_or_else(String::new, |first| {
        first.to_ascii_uppercase().to_string() + letters.as_str()
    })
}
