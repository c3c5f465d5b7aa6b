//! Adds shapes as morph targets to a glTF that may have some.
//!
//! Every mesh that a shape moves gets a sparse target, with normals where the mesh has some. Targets keep their
//! numbers, as expressions and animations use them; a target from elsewhere under the name of a shape is renamed with
//! `.original`, an earlier baked one is replaced.
//!
//! Units: the file's, as each mesh stores them. Limits: no tangents; animations of weights that are not floats stay
//! too short.

use std::collections::{BTreeMap, BTreeSet};

use rayon::prelude::*;
use serde_json::{Value, json};

use super::glb::{Glb, list};
use super::mesh::{Mesh, Vec3};
use super::morphs::{baked, bent, push_moves, single};
use super::patch::{ImportedGltf, Rows, position};
use super::shape::{ORIGINAL, Shape, is_same_name};
use super::vrm::{Added, Bound, add_expressions, expressions};

impl ImportedGltf {
    /// Whether a target or an expression from elsewhere has the name of a shape, in any spelling.
    pub fn has(&self, name: &str) -> bool {
        let json = &self.glb.json;
        let mut named = false;
        for mesh in list(&json["meshes"]) {
            for (k, had) in names(mesh).iter().enumerate() {
                if had == name && is_ours(mesh, k) {
                    return false;
                }
                named |= is_same_name(had, name);
            }
        }
        named || expressions(json).iter().any(|had| is_same_name(had, name))
    }

    /// The file with the shapes of this mesh added to every mesh that they move.
    pub fn patched(mut self, whole: &Mesh, shapes: &[Shape], dense: bool) -> Glb {
        let added = shapes.iter().map(|shape| Added {
            name: &shape.name,
            anew: self.has(&shape.name),
        });
        let added: Vec<Added> = added.collect();
        let meshes = list(&self.glb.json["meshes"]);
        let moved = (0..meshes.len()).filter(|&m| self.is_moved(&meshes[m], shapes));
        let moved: Vec<usize> = moved.collect();
        let written = self.push(&moved, whole, shapes, dense);
        let mut bound: Vec<Bound> = Vec::new();
        for m in moved {
            let mut mesh = self.glb.json["meshes"][m].take();
            let mut names = names(&mesh);
            let had = names.len();
            let places = places(&mesh, &mut names, shapes);
            for primitive in mesh["primitives"].as_array_mut().into_iter().flatten() {
                let mut targets = list(&primitive["targets"]).to_vec();
                targets.resize(names.len(), Value::Null);
                for (target, &at) in written[&drawn_from(primitive)].iter().zip(&places) {
                    targets[at] = target.clone();
                }
                primitive["targets"] = json!(targets);
                set_extra(&mut primitive["extras"], "targetNames", json!(names));
            }
            describe(&mut mesh, &names, shapes);
            self.glb.json["meshes"][m] = mesh;
            lengthen(&mut self.glb, m, [had, names.len()]);
            bound.push((m, places));
        }
        add_expressions(&mut self.glb.json, &added, &bound);
        self.glb
    }

    fn is_moved(&self, mesh: &Value, shapes: &[Shape]) -> bool {
        let positions = list(&mesh["primitives"]).iter().filter_map(position);
        let mut sources = positions.filter_map(|accessor| self.position_rows(accessor));
        sources.any(|source| {
            let moved = |v: usize| shapes.iter().any(|s| s.displacement[v] != Vec3::zeros());
            source.vertices.iter().any(|&v| moved(v as usize))
        })
    }

    /// Writes displacements and changes of normals for the rows drawn by these meshes: the target of each shape.
    fn push(
        &mut self,
        meshes: &[usize],
        whole: &Mesh,
        shapes: &[Shape],
        dense: bool,
    ) -> BTreeMap<Drawn, Vec<Value>> {
        let json = &self.glb.json;
        let of_mesh = |&m: &usize| list(&json["meshes"][m]["primitives"]).iter();
        let all = meshes.iter().flat_map(of_mesh).map(drawn_from);
        let mut written: BTreeMap<Drawn, Vec<Value>> = all.map(|d| (d, Vec::new())).collect();
        let smooth = whole.vertex_normals(&whole.positions);
        let rows = written.keys().map(|drawn| (*drawn, self.normals(*drawn)));
        let rows: Vec<(Drawn, Vec<Vec3>)> = rows.collect();
        let moves = shapes.par_iter().map(|shape| {
            let now = whole.vertex_normals(&shape.moved(&whole.positions));
            let normals = [&smooth[..], &now];
            let moves = |(drawn, own): &(Drawn, Vec<Vec3>)| self.moves(*drawn, own, shape, normals);
            rows.iter().map(moves).collect()
        });
        let moves: Vec<Vec<[Vec<[f32; 3]>; 2]>> = moves.collect();
        for moves in moves {
            for (targets, moves) in written.values_mut().zip(moves) {
                targets.push(push_moves(&mut self.glb, &moves, dense));
            }
        }
        written
    }

    /// Normals of drawn rows; empty unless all have one.
    fn normals(&self, drawn: Drawn) -> Vec<Vec3> {
        let [rows, normals] = drawn.map(|accessor| accessor.unwrap_or(usize::MAX));
        let rows = self.position_rows(rows);
        let count = rows.map_or(0, |rows| rows.vertices.len());
        let read = self.glb.floats(normals, 3).unwrap_or_default();
        let double = |n: &[f32; 3]| Vec3::from(n.map(f64::from));
        let read: Vec<Vec3> = read.as_chunks().0.iter().map(double).collect();
        Some(read)
            .filter(|read| read.len() == count)
            .unwrap_or_default()
    }

    /// Displacements of rows by a shape, and changes of their `own` normals with the mesh's.
    fn moves(
        &self,
        [rows, _]: Drawn,
        own: &[Vec3],
        shape: &Shape,
        [smooth, now]: [&[Vec3]; 2],
    ) -> [Vec<[f32; 3]>; 2] {
        let accessor = rows.unwrap_or(usize::MAX);
        let Some(Rows { vertices, back, .. }) = self.position_rows(accessor) else {
            // Targets of lines and points move nothing.
            return [
                vec![[0.0; 3]; self.glb.count(accessor).unwrap_or(1).max(1)],
                Vec::new(),
            ];
        };
        let stored = |&v: &u32| {
            let d = shape.displacement[v as usize];
            single(&back.map_or(d, |back| back * d))
        };
        // Normals transform back by the transpose of the positions' matrix.
        let turn = back.and_then(|back| back.try_inverse());
        let turn = turn.map(|turn| turn.transpose());
        let stored_normal = |n: &Vec3| turn.map_or(*n, |turn| (turn * n).normalize());
        let turned = vertices.iter().zip(own).map(|(&v, own)| {
            let [from, to] = [smooth, now].map(|n| stored_normal(&n[v as usize]));
            bent(own, [&from, &to])
        });
        [vertices.iter().map(stored).collect(), turned.collect()]
    }
}

/// Accessors of a primitive's positions and normals.
type Drawn = [Option<usize>; 2];

fn drawn_from(primitive: &Value) -> Drawn {
    let normals = primitive["attributes"]["NORMAL"].as_u64();
    [
        position(primitive),
        normals.map(|accessor| accessor as usize),
    ]
}

/// Whether a target is from an earlier bake.
fn is_ours(mesh: &Value, target: usize) -> bool {
    mesh["extras"]["mien"]["baked"][target] == true
}

/// The number of each shape's target: that of its earlier bake, or a new one. Targets from elsewhere with that name
/// keep their numbers and are renamed.
fn places(mesh: &Value, names: &mut Vec<String>, shapes: &[Shape]) -> Vec<usize> {
    let had = names.len();
    let place = |Shape { name, .. }: &Shape| {
        let baked = (0..had).find(|&k| names[k] == *name && is_ours(mesh, k));
        baked.unwrap_or_else(|| {
            let namesakes =
                (0..had).filter(|&k| !is_ours(mesh, k) && is_same_name(&names[k], name));
            for k in namesakes.collect::<Vec<_>>() {
                let mut kept = names[k].clone() + ORIGINAL;
                while names.contains(&kept) {
                    kept += ORIGINAL;
                }
                names[k] = kept;
            }
            names.push(name.clone());
            names.len() - 1
        })
    };
    shapes.iter().map(place).collect()
}

/// Writes a mesh's target names and the units that drive them.
fn describe(mesh: &mut Value, names: &[String], shapes: &[Shape]) {
    mesh["weights"] = lengthened(&mesh["weights"], names.len());
    set_extra(&mut mesh["extras"], "targetNames", json!(names));
    let ours = baked(&mesh["extras"]["mien"], names, shapes);
    set_extra(&mut mesh["extras"], "mien", ours);
}

/// Sets a key of `extras`, which may be of any type: a value that is no object is kept under a key of its own.
fn set_extra(extras: &mut Value, key: &str, value: Value) {
    if !extras.is_object() {
        *extras = match extras.take() {
            Value::Null => json!({}),
            other => json!({"extras": other}),
        };
    }
    extras[key] = value;
}

/// Names of a mesh's targets, generated where the file has none.
fn names(mesh: &Value) -> Vec<String> {
    let first = &mesh["primitives"][0];
    let of_mesh = mesh["extras"]["targetNames"].as_array();
    let given = of_mesh.or_else(|| first["extras"]["targetNames"].as_array());
    let name = |k: usize| Some(given?.get(k)?.as_str()?.to_owned());
    let all = 0..list(&first["targets"]).len();
    all.map(|k| name(k).unwrap_or_else(|| format!("target_{k}")))
        .collect()
}

/// Weights padded with zeros to `count`.
fn lengthened(weights: &Value, count: usize) -> Value {
    let mut weights = list(weights).to_vec();
    weights.resize(count, json!(0.0));
    json!(weights)
}

/// Extends the weights of nodes with this mesh, and of their animations, to its number of targets.
fn lengthen(glb: &mut Glb, mesh: usize, [had, now]: [usize; 2]) {
    let shows = |node: &Value| node["mesh"] == json!(mesh);
    for node in glb.json["nodes"].as_array_mut().into_iter().flatten() {
        if shows(node) && node.get("weights").is_some() {
            node["weights"] = lengthened(&node["weights"], now);
        }
    }
    let mut samplers = BTreeSet::new();
    for (a, animation) in list(&glb.json["animations"]).iter().enumerate() {
        for channel in list(&animation["channels"]) {
            let target = &channel["target"];
            if target["path"] == "weights" && shows(glb.list_entry("nodes", &target["node"])) {
                samplers.insert((a, channel["sampler"].as_u64().unwrap_or(u64::MAX) as usize));
            }
        }
    }
    let mut left = glb.budget() / 4;
    for (a, sampler) in samplers {
        let output = glb.json["animations"][a]["samplers"][sampler]["output"].as_u64();
        let moments = output.and_then(|output| glb.floats(output as usize, 1).ok());
        let moments = moments.unwrap_or_default();
        // Several samplers may share data.
        let size = moments.len().checked_div(had).map(|moments| moments * now);
        let Some(rest) = size.and_then(|size| left.checked_sub(size)) else {
            continue;
        };
        left = rest;
        let rows = moments.chunks(had).flat_map(|row| {
            let zeros = std::iter::repeat_n(&0.0, now - had);
            row.iter().chain(zeros).map(|weight| [*weight])
        });
        let output = glb.push_rows(&rows.collect::<Vec<_>>(), 0);
        glb.json["animations"][a]["samplers"][sampler]["output"] = output.into();
    }
}
