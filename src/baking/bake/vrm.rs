//! Expressions of VRM avatars: every new shape gets one under its "Perfect Sync" name, the shape's with a capital letter.
//!
//! VRM 0 lists `blendShapeGroups` that bind targets by mesh with weights up to 100, VRM 1 has `expressions` that bind
//! them by node with weights up to 1. Existing expressions stay valid, because shapes are only appended or replaced
//! in place. An expression from elsewhere under the name of a shape is renamed with `.original`, as its target is.
//! Visemes also become the five preset mouth shapes, unless the file has ones that move something.

use serde_json::{Value, json};

use super::glb::{list, push, unexpected};
use super::shape::{ORIGINAL, is_same_name};
use mien_workbench::fault::Fault;

/// A glTF mesh that is moved, and the number there of each shape's target.
pub(super) type Bound = (usize, Vec<usize>);

/// Visemes that are preset mouth shapes, with their names in VRM 0 and 1.
const PRESETS: [[&str; 3]; 5] = [
    ["viseme_aa", "a", "aa"],
    ["viseme_ih", "i", "ih"],
    ["viseme_ou", "u", "ou"],
    ["viseme_E", "e", "ee"],
    ["viseme_oh", "o", "oh"],
];

/// Checks that the containers of expressions are absent or of the right type.
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

/// The beginning of an unexpected value, for messages.
pub(super) fn beginning(value: &Value) -> String {
    value.to_string().chars().take(40).collect()
}

/// An added shape.
pub(super) struct Added<'a> {
    pub(super) name: &'a str,
    /// Whether it gets an expression even if one from elsewhere has its name, which is then renamed.
    pub(super) anew: bool,
}

/// Names of a file's expressions that the standards do not fix.
pub(super) fn expressions(json: &Value) -> Vec<String> {
    let groups = list(&json["extensions"]["VRM"]["blendShapeMaster"]["blendShapeGroups"]).iter();
    let groups = groups.filter(|group| !is_preset(group));
    let groups = groups.filter_map(|group| group["name"].as_str());
    let custom = json["extensions"]["VRMC_vrm"]["expressions"]["custom"].as_object();
    let custom = custom.into_iter().flatten().map(|(name, _)| &**name);
    groups.chain(custom).map(str::to_owned).collect()
}

fn is_preset(group: &Value) -> bool {
    let preset = group["presetName"].as_str().unwrap_or("");
    !matches!(preset, "" | "unknown")
}

/// The new name of an expression that has the name of an added shape.
fn renamed(had: &str, added: &[Added<'_>]) -> Option<String> {
    let anew = added.iter().any(|a| a.anew && is_same_name(had, a.name));
    anew.then(|| had.to_owned() + ORIGINAL)
}

/// The shapes that have no expression of their name among `had`, with their numbers.
fn without<'a>(added: &'a [Added<'_>], had: &[String]) -> impl Iterator<Item = (usize, &'a str)> {
    let all = added.iter().map(|added| added.name).enumerate();
    all.filter(move |(_, name)| !had.iter().any(|h| is_same_name(h, name)))
}

/// The numbers of shapes that are preset mouth shapes, with their names in a version.
fn presets(added: &[Added<'_>], version: usize) -> impl Iterator<Item = (usize, &'static str)> {
    let number = |name| added.iter().position(|added| added.name == name);
    let all = PRESETS.into_iter();
    all.filter_map(move |preset| Some((number(preset[0])?, preset[version])))
}

/// Adds expressions for the targets of shapes; files that are no VRM stay as they are.
pub(super) fn add_expressions(json: &mut Value, added: &[Added<'_>], bound: &[Bound]) {
    let nodes = list(&json["nodes"]).to_vec();
    let is_there = |json: &Value, name| !bound.is_empty() && json["extensions"][name].is_object();
    if is_there(json, "VRM") {
        let groups = &mut json["extensions"]["VRM"]["blendShapeMaster"]["blendShapeGroups"];
        add_groups(groups, added, bound);
    }
    if is_there(json, "VRMC_vrm") {
        let expressions = &mut json["extensions"]["VRMC_vrm"]["expressions"];
        let custom = expressions.get_mut("custom");
        if let Some(custom) = custom.and_then(Value::as_object_mut) {
            let kept = std::mem::take(custom).into_iter();
            let named = kept.map(|(name, one)| (renamed(&name, added).unwrap_or(name), one));
            *custom = named.collect();
        }
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
        for (k, name) in without(added, &had) {
            expressions["custom"][capital(name)] = expression(k);
        }
        for (k, preset) in presets(added, 2) {
            if list(&expressions["preset"][preset]["morphTargetBinds"]).is_empty() {
                expressions["preset"][preset] = expression(k);
            }
        }
    }
}

/// Adds expressions in the form of VRM 0.
fn add_groups(groups: &mut Value, added: &[Added<'_>], bound: &[Bound]) {
    for group in groups.as_array_mut().into_iter().flatten() {
        let name = group["name"].as_str().filter(|_| !is_preset(group));
        if let Some(name) = name.and_then(|name| renamed(name, added)) {
            group["name"] = name.into();
        }
    }
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
    for (k, name) in without(added, &had) {
        push(groups, group(k, name, "unknown"));
    }
    for (k, preset) in presets(added, 1) {
        let own = list(groups).iter().position(|g| g["presetName"] == preset);
        let own = own.unwrap_or_else(|| push(groups, Value::Null));
        if list(&groups[own]["binds"]).is_empty() {
            groups[own] = group(k, preset, preset);
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
