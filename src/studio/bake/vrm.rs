//! Expressions of VRM avatars: every new shape gets one under its "Perfect Sync" name, the shape's with a capital letter.
//!
//! VRM 0 lists `blendShapeGroups` that bind targets by mesh with weights up to 100, VRM 1 has `expressions` that bind them
//! by node with weights up to 1. Expressions that are there stay as they are, also one that has the name of a shape
//! already: their targets keep their numbers, because shapes are only appended or replaced in place. Visemes also become the five
//! preset mouth shapes, unless the file has ones of its own that move something.

use serde_json::{Value, json};

use super::glb::{list, push, unexpected};
use crate::studio::fault::Fault;

/// A glTF mesh that is moved, and the number there of each shape's target.
pub(super) type Bound = (usize, Vec<usize>);

/// Visemes that are preset mouth shapes, with their names there in VRM 0 and 1.
const PRESETS: [[&str; 3]; 5] = [
    ["viseme_aa", "a", "aa"],
    ["viseme_ih", "i", "ih"],
    ["viseme_ou", "u", "ou"],
    ["viseme_E", "e", "ee"],
    ["viseme_oh", "o", "oh"],
];

/// Whether expressions can be added: where they belong is what it should be, or not there yet.
pub(super) fn add_expressions_to(json: &Value) -> Result<(), Fault> {
    let old = &json["extensions"]["VRM"]["blendShapeMaster"];
    let new = &json["extensions"]["VRMC_vrm"]["expressions"];
    let (groups, custom, preset) = (&old["blendShapeGroups"], &new["custom"], &new["preset"]);
    let object = (Value::is_object as fn(&Value) -> bool, "an object");
    let list = (Value::is_array as fn(&Value) -> bool, "a list");
    for (name, value, (fits, kind)) in [
        ("blendShapeMaster of VRM", old, object),
        ("blendShapeGroups of VRM", groups, list),
        ("expressions of VRMC_vrm", new, object),
        ("custom expressions of VRMC_vrm", custom, object),
        ("preset expressions of VRMC_vrm", preset, object),
    ] {
        if !fits(value) && !value.is_null() {
            return Err(unexpected(&format!("{name} as {kind}"), beginning(value)));
        }
    }
    Ok(())
}

/// The beginning of what is there instead.
pub(super) fn beginning(value: &Value) -> String {
    value.to_string().chars().take(40).collect()
}

/// The shapes that have no expression of their name among `had`, with their numbers.
fn added<'a>(names: &'a [&str], had: &[String]) -> impl Iterator<Item = (usize, &'a str)> {
    let all = names.iter().copied().enumerate();
    all.filter(move |(_, name)| !had.iter().any(|h| h.eq_ignore_ascii_case(name)))
}

/// The numbers of shapes that are preset mouth shapes, with their names there in a version.
fn presets(names: &[&str], version: usize) -> impl Iterator<Item = (usize, &'static str)> {
    let number = |name| names.iter().position(|n| *n == name);
    PRESETS
        .into_iter()
        .filter_map(move |preset| Some((number(preset[0])?, preset[version])))
}

/// Adds expressions for the targets of shapes of these names; files that are no VRM stay as they are.
pub(super) fn add_expressions(json: &mut Value, names: &[&str], bound: &[Bound]) {
    let nodes = list(&json["nodes"]).to_vec();
    let is_there = |json: &Value, name| !bound.is_empty() && json["extensions"][name].is_object();
    if is_there(json, "VRM") {
        let groups = &mut json["extensions"]["VRM"]["blendShapeMaster"]["blendShapeGroups"];
        add_groups(groups, names, bound);
    }
    if is_there(json, "VRMC_vrm") {
        let expressions = &mut json["extensions"]["VRMC_vrm"]["expressions"];
        let expression = |k: usize| {
            let binds = bound.iter().flat_map(|(mesh, at)| {
                let nodes = nodes.iter().enumerate();
                let shown = nodes.filter(move |(_, node)| node["mesh"] == json!(mesh));
                shown.map(move |(node, _)| json!({"node": node, "index": at[k], "weight": 1.0}))
            });
            json!({
                "isBinary": false, "morphTargetBinds": binds.collect::<Vec<_>>(),
                "overrideBlink": "none", "overrideLookAt": "none", "overrideMouth": "none",
            })
        };
        let kinds = ["preset", "custom"].into_iter();
        let had = kinds.flat_map(|kind| expressions[kind].as_object().into_iter().flatten());
        let had: Vec<String> = had.map(|(name, _)| name.clone()).collect();
        for (k, name) in added(names, &had) {
            expressions["custom"][capital(name)] = expression(k);
        }
        for (k, preset) in presets(names, 2) {
            if list(&expressions["preset"][preset]["morphTargetBinds"]).is_empty() {
                expressions["preset"][preset] = expression(k);
            }
        }
    }
}

/// Adds expressions as VRM 0 has them.
fn add_groups(groups: &mut Value, names: &[&str], bound: &[Bound]) {
    let had = list(groups).iter().map(|group| group["name"].as_str());
    let had: Vec<String> = had.flatten().map(str::to_owned).collect();
    let group = |k: usize, name: &str, preset: &str| {
        let binds = bound.iter();
        let binds = binds.map(|(mesh, at)| json!({"mesh": mesh, "index": at[k], "weight": 100.0}));
        json!({
            "name": capital(name), "presetName": preset, "isBinary": false,
            "binds": binds.collect::<Vec<_>>(), "materialValues": [],
        })
    };
    for (k, name) in added(names, &had) {
        push(groups, group(k, name, "unknown"));
    }
    for (k, preset) in presets(names, 1) {
        let own = list(groups).iter().position(|g| g["presetName"] == preset);
        match own {
            None => drop(push(groups, group(k, preset, preset))),
            Some(own) if list(&groups[own]["binds"]).is_empty() => {
                groups[own] = group(k, preset, preset);
            }
            Some(_) => {}
        }
    }
}

/// The name with a capital first letter.
fn capital(name: &str) -> String {
    let mut name = name.to_owned();
    if let Some(first) = name.get_mut(..1) {
        first.make_ascii_uppercase();
    }
    name
}
