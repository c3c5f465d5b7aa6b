//! Promise: every unit that is sent moves the shipped head, and gaze turns both eyes to where the person looks.
//!
//! `animate` gives the weights, so that what is judged is the whole way from a column of the CSV to vertices.
#![cfg(feature = "studio")]

use std::collections::BTreeSet;
use std::path::Path;

use mien_baking::bake::glb::Glb;
use mien_baking::heads::default_head;
use mien_stages::expression::units::Units;
use mien_studio::animate::{Args, animate};
use serde_json::Value;

/// Units that are sent and that no shape of the head shows, each with its reason in `docs/limits.md`.
const SHOWN_BY_NOTHING: [&str; 0] = [];
/// Least motion of a unit's full weight at the vertex that moves most, metres.
const LEAST_M: f32 = 0.000_8;

fn index(value: &Value) -> usize {
    value.as_u64().expect("an index") as usize
}

/// The face of an animated head.
struct Face {
    /// Names of its targets.
    names: Vec<String>,
    /// Weights of the animation, those of a frame's targets after each other.
    weights: Vec<f32>,
    /// Per primitive: material, rest positions, displacements of each target.
    parts: Vec<(String, Vec<f32>, Vec<Vec<f32>>)>,
    /// Vertices of the eyeballs; the primitives share theirs.
    eyes: Vec<usize>,
}

impl Face {
    fn read(glb: &Glb) -> Self {
        let json = &glb.json;
        let mesh = &json["meshes"][0];
        let names = mesh["extras"]["targetNames"].as_array().unwrap().iter();
        let animation = &json["animations"][0];
        let channels = animation["channels"].as_array().unwrap();
        let channel = channels.iter().find(|c| c["target"]["path"] == "weights");
        let sampler = &animation["samplers"][index(&channel.unwrap()["sampler"])];
        let floats = |accessor: &Value, width| glb.floats(index(accessor), width).unwrap();
        let parts = mesh["primitives"].as_array().unwrap().iter().map(|part| {
            let material = &json["materials"][index(&part["material"])]["name"];
            let targets = part["targets"].as_array().unwrap().iter();
            (
                material.as_str().unwrap().to_owned(),
                floats(&part["attributes"]["POSITION"], 3),
                targets
                    .map(|target| floats(&target["POSITION"], 3))
                    .collect(),
            )
        });
        let primitives = mesh["primitives"].as_array().unwrap();
        let name = |part: &Value| &json["materials"][index(&part["material"])]["name"];
        let eyes = primitives
            .iter()
            .find(|part| *name(part) == "eyes")
            .unwrap();
        let eyes = glb.indices(index(&eyes["indices"])).unwrap();
        let eyes: BTreeSet<usize> = eyes.into_iter().map(|v| v as usize).collect();
        Self {
            eyes: eyes.into_iter().collect(),
            names: names
                .map(|name| name.as_str().unwrap().to_owned())
                .collect(),
            weights: floats(&sampler["output"], 1),
            parts: parts.collect(),
        }
    }

    /// Weights of the targets that move in a frame.
    fn driven(&self, frame: usize) -> Vec<(&str, f32)> {
        let weights = self.weights.chunks(self.names.len()).nth(frame).unwrap();
        let all = self
            .names
            .iter()
            .map(String::as_str)
            .zip(weights.iter().copied());
        all.filter(|(_, weight)| *weight != 0.0).collect()
    }

    /// How a frame moves a vertex of a part.
    fn motion(&self, frame: usize, part: usize, vertex: usize) -> [f32; 3] {
        let weights = self.weights.chunks(self.names.len()).nth(frame).unwrap();
        let mut moved = [0.0; 3];
        for (target, weight) in self.parts[part].2.iter().zip(weights) {
            for (axis, sum) in moved.iter_mut().enumerate() {
                *sum += weight * target[3 * vertex + axis];
            }
        }
        moved
    }

    /// The largest motion of any vertex in a frame.
    fn largest(&self, frame: usize) -> f32 {
        let lengths = self
            .parts
            .iter()
            .enumerate()
            .flat_map(|(part, (_, rest, _))| {
                (0..rest.len() / 3).map(move |v| self.motion(frame, part, v))
            });
        lengths
            .map(|[x, y, z]| x.hypot(y).hypot(z))
            .fold(0.0, f32::max)
    }

    /// The mean motion in a frame of the front of an eyeball: of the subject's left eye (x above 0) or of the right one.
    fn pupil(&self, frame: usize, left: bool) -> [f32; 3] {
        let rest = &self.parts[0].1;
        let side = |v: &usize| (rest[3 * v] > 0.0) == left;
        let side: Vec<usize> = self.eyes.iter().copied().filter(side).collect();
        let depths = side.iter().map(|v| rest[3 * v + 2]);
        let front = depths.fold(f32::MIN, f32::max);
        // The cornea, which stands out by 2 mm.
        let pupil = side.into_iter().filter(|v| rest[3 * v + 2] > front - 0.002);
        let pupil: Vec<usize> = pupil.collect();
        let mut mean = [0.0; 3];
        for v in &pupil {
            for (sum, moved) in mean.iter_mut().zip(self.motion(frame, 0, *v)) {
                *sum += moved / pupil.len() as f32;
            }
        }
        mean
    }
}

/// The shipped head with one frame for each unit at 1.
fn animated(units: &[&str]) -> Face {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    default_head::write_to(&at("head.glb"), false).unwrap();
    let columns: Vec<String> = units.iter().map(|unit| format!("w_{unit}")).collect();
    let mut table = format!("time_us,user,{}\n", columns.join(","));
    for k in 0..units.len() {
        let cells = (0..units.len()).map(|i| u8::from(i == k).to_string());
        let cells: Vec<String> = cells.collect();
        table += &format!("{},0,{}\n", 33_000 * k, cells.join(","));
    }
    std::fs::write(at("run.csv"), table).unwrap();
    animate(&Args {
        mesh: at("head.glb"),
        csv: at("run.csv"),
        out: at("run.glb"),
        user: None,
    })
    .unwrap();
    let bytes = std::fs::read(Path::new(&at("run.glb"))).unwrap();
    Face::read(&Glb::parse(&bytes).unwrap())
}

#[test]
fn every_unit_that_is_sent_moves_the_head_and_eyes_look_where_the_person_looks() {
    let sent = Units::shipped().columns(false);
    let units: Vec<&str> = sent.iter().map(|unit| unit.as_str()).collect();
    let face = animated(&units);
    let limits = include_str!("../../docs/limits.md");
    for (frame, unit) in units.iter().enumerate() {
        let largest = face.largest(frame);
        println!("{unit}: {:.1} mm, {:?}", 1e3 * largest, face.driven(frame));
        if SHOWN_BY_NOTHING.contains(unit) {
            assert!(
                largest == 0.0 && limits.contains(unit),
                "{unit}: {largest} m"
            );
        } else {
            assert!(largest > LEAST_M, "{unit} moves the head by {largest} m");
        }
    }

    // glTF: x to the subject's left, y up. Which shapes ARKit means, and where both pupils go.
    for (unit, shapes, axis, sign) in [
        ("AU61", ["eyeLookInRight", "eyeLookOutLeft"], 0, 1.0),
        ("AU62", ["eyeLookInLeft", "eyeLookOutRight"], 0, -1.0),
        ("AU63", ["eyeLookUpLeft", "eyeLookUpRight"], 1, 1.0),
        ("AU64", ["eyeLookDownLeft", "eyeLookDownRight"], 1, -1.0),
    ] {
        let frame = units.iter().position(|sent| *sent == unit).unwrap();
        let mut driven = face.driven(frame);
        driven.sort_by_key(|(name, _)| *name);
        assert_eq!(driven, shapes.map(|name| (name, 1.0)), "{unit}");
        for left in [true, false] {
            let moved = face.pupil(frame, left);
            // 25 to 30 degrees: 7 to 9 mm at the cornea, hardly anything across.
            let (along, across) = (sign * moved[axis], moved[1 - axis].abs());
            println!("{unit}, left {left}: {moved:?}");
            assert!((0.006..0.011).contains(&along), "{unit}: {moved:?}");
            assert!(across < 0.1 * along, "{unit}: {moved:?}");
        }
    }
}
