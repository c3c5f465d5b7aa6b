//! `mien-studio animate`: the weights of a recorded run become an animation of a head's morph targets.
//!
//! A target is driven by the CSV column `w_<unit>` of the unit that baking wrote beside it, by `w_<name>` of its own name, or,
//! in files from elsewhere, by the unit the shipped recipe gives to its name. The corrective of two targets has the product of
//! their weights. Rows without weights (nobody there, lost)
//! are neutral. The head turns as the pose says ([`head_turn`]) and stays as it was while there is none. Times count
//! from the first row of the chosen user.

mod head_turn;

use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use crate::base::bounded_read;
use crate::studio::bake::error::BakeError;
use crate::studio::bake::files::write;
use crate::studio::bake::glb::{Glb, GlbError};
use crate::studio::bake::recipe::{Recipe, SHIPPED};
use crate::studio::bake::shape::pair;
use crate::studio::csv;
use crate::studio::text_files::{self, decoded};
use head_turn::Turned;

/// Why there is no animation.
#[derive(Debug, thiserror::Error)]
pub enum AnimateError {
    /// A file cannot be read.
    #[error("cannot read {path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The mesh file is not right.
    #[error("{path}: {source}")]
    Mesh {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        source: GlbError,
    },
    /// The table is not right.
    #[error("{path}: line {line}: expected {expected}, found {found:?}")]
    Table {
        /// The file.
        path: PathBuf,
        /// Counted from 1.
        line: usize,
        /// What should be there.
        expected: &'static str,
        /// What is there.
        found: String,
    },
    /// Nobody to follow.
    #[error(
        "{path}: expected rows of {wanted}, found {found}; give --user a slot from the column user"
    )]
    Nobody {
        /// The file.
        path: PathBuf,
        /// Whom.
        wanted: String,
        /// Who is there.
        found: String,
    },
    /// Nothing in common.
    #[error(
        "{path}: no column belongs to any of the {targets} morph targets of the mesh; bake the mesh with mien-studio bake, or give its targets ARKit's names"
    )]
    Nothing {
        /// The table.
        path: PathBuf,
        /// How many targets the mesh has.
        targets: usize,
    },
    /// The result cannot be written.
    #[error(transparent)]
    Write(#[from] BakeError),
}

/// Times in seconds, weights and rotations of the head (x, y, z, w), one row per frame.
#[derive(Default)]
struct Track {
    times: Vec<f32>,
    weights: Vec<Vec<f32>>,
    /// As the sensor gives them, each on the side of the one before; empty if the table has none.
    poses: Vec<[f32; 4]>,
}

/// The pose in a row's cells, if there is one.
fn pose(cells: &[&str], columns: &[usize; 4]) -> Result<Option<[f32; 4]>, String> {
    let words = columns.map(|at| cells[at]);
    if words.iter().all(|word| word.is_empty()) {
        return Ok(None);
    }
    let mut out = [0.0; 4];
    for (slot, word) in out.iter_mut().zip(words) {
        let number = word.parse().ok().filter(|v: &f32| v.is_finite());
        *slot = number.ok_or_else(|| word.to_owned())?;
    }
    Ok(Some(out))
}

/// The slots that a table has, for people to read.
fn slots(table: &csv::Table, slot: usize) -> String {
    let mut all: Vec<&str> = table
        .rows()
        .filter_map(|row| row.cells.get(slot).copied())
        .filter(|cell| !cell.is_empty())
        .collect();
    all.sort_unstable();
    all.dedup();
    all.truncate(16);
    match all[..] {
        [] => "nobody".into(),
        [one] => format!("user {one} only"),
        _ => format!("users {}", all.join(", ")),
    }
}

/// Reads the rows of one user; `columns` are the CSV names wanted per target, `pairs` the two targets that one is
/// the corrective of.
/// Long because it is one loop over the table that fills weights and pose together.
fn track(
    text: &str,
    path: &Path,
    user: Option<&str>,
    columns: &[Vec<String>],
    pairs: &[Option<[usize; 2]>],
) -> Result<(Track, usize), AnimateError> {
    let refuse = |line, expected, found: &str| AnimateError::Table {
        path: path.into(),
        line,
        expected,
        found: found.chars().take(60).collect(),
    };
    let table = csv::Table::new(text);
    let find = |name: &str| table.find(name);
    let (Some(time), Some(slot)) = (find("time_us"), find("user")) else {
        return Err(refuse(
            1,
            "a header with time_us, user and w_<unit> columns",
            &table.columns().join(","),
        ));
    };
    let source: Vec<Option<usize>> = columns
        .iter()
        .map(|names| names.iter().find_map(|name| find(name)))
        .collect();
    let driven = source.iter().flatten().count();
    let mut chosen = user.map(str::to_owned);
    let turned = ["qx", "qy", "qz", "qw"].map(find);
    let turned = turned
        .iter()
        .all(Option::is_some)
        .then(|| turned.map(|at| at.unwrap_or(0)));
    let mut out = Track::default();
    let mut first = None;
    let mut met = false;
    for csv::Row { line, text, cells } in table.rows() {
        if cells.len() != table.columns().len() {
            return Err(refuse(line, "as many cells as in the header", text));
        }
        if chosen.is_none() && !cells[slot].is_empty() {
            chosen = Some(cells[slot].to_owned());
        }
        if chosen.is_none() || (!cells[slot].is_empty() && Some(cells[slot]) != chosen.as_deref()) {
            continue;
        }
        met |= !cells[slot].is_empty();
        let now: u64 = cells[time]
            .parse()
            .map_err(|_| refuse(line, "a time in microseconds", text))?;
        let start = *first.get_or_insert(now);
        let seconds = now.saturating_sub(start) as f64 * 1e-6;
        if out.times.last().is_some_and(|&last| seconds as f32 <= last) {
            continue;
        }
        let mut weights = Vec::with_capacity(source.len());
        for at in &source {
            let cell = at.map_or("", |at| cells[at]);
            let weight: f32 = if cell.is_empty() {
                0.0
            } else {
                cell.parse()
                    .ok()
                    .filter(|w: &f32| w.is_finite())
                    .ok_or_else(|| refuse(line, "a finite weight", cell))?
            };
            weights.push(weight);
        }
        for (k, pair) in pairs.iter().enumerate() {
            if let Some([a, b]) = *pair {
                weights[k] = weights[a] * weights[b];
            }
        }
        if let Some(columns) = &turned {
            let before = out.poses.last().copied().unwrap_or([0.0, 0.0, 0.0, 1.0]);
            let now = pose(&cells, columns)
                .map_err(|found| refuse(line, "a finite number of the pose", &found))?
                .unwrap_or(before);
            // The same rotation has two quaternions; between neighbours the shorter way is meant.
            let same = before.iter().zip(now).map(|(a, b)| a * b).sum::<f32>() >= 0.0;
            out.poses.push(if same { now } else { now.map(|v| -v) });
        }
        out.times.push(seconds as f32);
        out.weights.push(weights);
    }
    if !met {
        return Err(AnimateError::Nobody {
            path: path.into(),
            wanted: user.map_or_else(|| "somebody".into(), |user| format!("user {user}")),
            found: slots(&table, slot),
        });
    }
    Ok((out, driven))
}

/// Adds an animation of the morph weights to a head; returns the number of frames and of driven targets.
/// Long because nodes, samplers and channels of the animation refer to each other by number.
fn animated(
    glb: &mut Glb,
    csv: &str,
    path: &Path,
    user: Option<&str>,
) -> Result<(usize, usize), AnimateError> {
    let meshes = glb.json["meshes"].as_array().cloned().unwrap_or_default();
    let named = |mesh: &Value| -> Option<Vec<String>> {
        let names = mesh["extras"]["targetNames"]
            .as_array()
            .or_else(|| mesh["primitives"][0]["extras"]["targetNames"].as_array())?;
        names
            .iter()
            .map(|n| n.as_str().map(str::to_owned))
            .collect()
    };
    let recipe = Recipe::read(SHIPPED).map(|r| r.units()).unwrap_or_default();
    let (mut channels, mut samplers) = (Vec::new(), Vec::new());
    let (mut frames, mut most, mut total) = (0, 0, 0);
    let mut turning: Option<(usize, Vec<[f32; 4]>)> = None;
    let mut driven_meshes = Vec::new();
    for (m, mesh) in meshes.iter().enumerate() {
        let Some(names) = named(mesh) else { continue };
        total += names.len();
        let columns: Vec<Vec<String>> = names
            .iter()
            .enumerate()
            .map(|(k, name)| {
                let written = mesh["extras"]["mien"]["units"][k].as_str();
                let shipped = recipe
                    .iter()
                    .find(|(n, _)| n.eq_ignore_ascii_case(name))
                    .map(|(_, u)| u.as_str());
                [written, Some(name.as_str()), shipped]
                    .into_iter()
                    .flatten()
                    .map(|u| format!("w_{u}"))
                    .collect()
            })
            .collect();
        // A corrective counts as much as both of its shapes.
        let place = |name: &str| names.iter().position(|n| n == name);
        let pairs: Vec<Option<[usize; 2]>> = names
            .iter()
            .map(|name| {
                let [a, b] = pair(name, |name| place(name).is_some())?;
                Some([place(a)?, place(b)?])
            })
            .collect();
        let (track, driven) = track(csv, path, user, &columns, &pairs)?;
        if driven == 0 {
            continue;
        }
        (frames, most) = (track.times.len(), most + driven);
        driven_meshes.push(m);
        let floats = |values: &mut dyn Iterator<Item = f32>| {
            values.flat_map(f32::to_le_bytes).collect::<Vec<u8>>()
        };
        let view = glb.push_view(&floats(&mut track.times.iter().copied()), 0);
        let last = track.times[frames - 1];
        let input = glb.push_accessor(json!({
            "bufferView": view, "componentType": 5126, "count": frames, "type": "SCALAR", "min": [0.0], "max": [last],
        }));
        turning.get_or_insert_with(|| (input, track.poses.clone()));
        let view = glb.push_view(&floats(&mut track.weights.iter().flatten().copied()), 0);
        let output = glb.push_accessor(json!({
            "bufferView": view, "componentType": 5126, "count": frames * names.len(), "type": "SCALAR",
        }));
        samplers.push(json!({"input": input, "output": output, "interpolation": "LINEAR"}));
        let nodes = glb.json["nodes"].as_array().cloned().unwrap_or_default();
        for (node, value) in nodes.iter().enumerate() {
            if value["mesh"] == json!(m) {
                channels.push(json!({"sampler": samplers.len() - 1, "target": {"node": node, "path": "weights"}}));
            }
        }
    }
    if channels.is_empty() {
        return Err(AnimateError::Nothing {
            path: path.into(),
            targets: total,
        });
    }
    if let Some((input, poses)) = turning.filter(|(_, poses)| !poses.is_empty()) {
        turn(
            glb,
            &driven_meshes,
            input,
            &poses,
            &mut samplers,
            &mut channels,
        );
    }
    let animation = json!({"name": "run", "samplers": samplers, "channels": channels});
    match glb.json["animations"].as_array_mut() {
        Some(list) => list.push(animation),
        None => glb.json["animations"] = json!([animation]),
    }
    Ok((frames, most))
}

/// Adds the turns of the head to the channels of an animation whose times are the accessor `input`.
fn turn(
    glb: &mut Glb,
    meshes: &[usize],
    input: usize,
    poses: &[[f32; 4]],
    samplers: &mut Vec<Value>,
    channels: &mut Vec<Value>,
) {
    for turned in Turned::find(glb, meshes) {
        let rows: Vec<_> = poses.iter().map(|&pose| turned.at(pose)).collect();
        let rotations: Vec<u8> = rows
            .iter()
            .flat_map(|row| row.0)
            .flat_map(f32::to_le_bytes)
            .collect();
        let places: Vec<u8> = rows
            .iter()
            .flat_map(|row| row.1)
            .flatten()
            .flat_map(f32::to_le_bytes)
            .collect();
        for (path, kind, data) in [
            ("rotation", "VEC4", rotations),
            ("translation", "VEC3", places),
        ] {
            if data.is_empty() {
                continue;
            }
            let view = glb.push_view(&data, 0);
            let output = glb.push_accessor(json!({
                "bufferView": view, "componentType": 5126, "count": rows.len(), "type": kind,
            }));
            samplers.push(json!({"input": input, "output": output, "interpolation": "LINEAR"}));
            channels.push(json!({"sampler": samplers.len() - 1, "target": {"node": turned.node, "path": path}}));
        }
    }
}

/// Writes `out`: the head `mesh` with the weights of the table `csv` as an animation; prints one line.
///
/// # Errors
/// If the mesh or the table is not as expected, or the result cannot be written.
pub fn animate(
    mesh: &Path,
    csv: &Path,
    out: &Path,
    user: Option<&str>,
) -> Result<(), AnimateError> {
    let read = |path: &Path| {
        bounded_read::read(path, text_files::MOST).map_err(|source| AnimateError::Read {
            path: path.into(),
            source,
        })
    };
    let mut glb = Glb::parse(&read(mesh)?).map_err(|source| AnimateError::Mesh {
        path: mesh.into(),
        source,
    })?;
    let text = read(csv)?;
    let (frames, driven) = animated(&mut glb, &decoded(&text), csv, user)?;
    write(out, &glb.emit())?;
    println!(
        "{}: {frames} frames, {driven} morph targets driven",
        out.display()
    );
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn head() -> Glb {
        Glb {
            json: json!({
                "asset": {"version": "2.0"},
                "nodes": [{"mesh": 0}],
                "meshes": [{
                    "primitives": [],
                    "extras": {"targetNames": ["jawOpen", "eyeBlinkLeft", "unknown"], "mien": {"units": ["AU26", null, null]}},
                }],
            }),
            bin: vec![1, 2, 3],
        }
    }

    const CSV: &str = "frame,time_us,user,state,w_AU26,w_AU43L\n0,1000000,,absent,,\n1,1033000,0,tracking,0.5,0.25\n\
                       2,1066000,1,tracking,9,9\n3,1066000,0,tracking,1.5,0\n4,1099000,,absent,,\n";

    #[test]
    fn weights_reach_their_targets_and_a_lost_face_is_neutral() {
        let mut glb = head();
        let done = animated(&mut glb, CSV, Path::new("run.csv"), None).unwrap();
        assert_eq!(done, (3, 2));
        let times = glb.floats(0, 1).unwrap();
        assert!((times[1] - 0.033).abs() < 1e-6 && times[0] == 0.0);
        let weights = glb.floats(1, 1).unwrap();
        assert_eq!(weights, [0.5, 0.25, 0.0, 1.5, 0.0, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!(
            glb.json["animations"][0]["channels"][0]["target"]["path"],
            "weights"
        );
    }

    #[test]
    fn a_corrective_counts_as_much_as_both_of_its_shapes() {
        let mut glb = head();
        let names = [
            "jawOpen_eyeBlinkLeft",
            "jawOpen",
            "eyeBlinkLeft",
            "jawOpen_L",
        ];
        glb.json["meshes"][0]["extras"] = json!({"targetNames": names});
        animated(&mut glb, CSV, Path::new("run.csv"), None).unwrap();
        let weights = glb.floats(1, 1).unwrap();
        assert_eq!(weights[..8], [0.125, 0.5, 0.25, 0.0, 0.0, 1.5, 0.0, 0.0]);
    }

    #[test]
    fn the_head_turns_the_shorter_way_and_stays_while_the_face_is_lost() {
        let csv =
            "time_us,user,w_AU26,qx,qy,qz,qw\n0,0,0,0,0,0,1\n10,0,0,0,0.1,0,-0.995\n20,0,0,,,,\n";
        let mut glb = head();
        animated(&mut glb, csv, Path::new("run.csv"), None).unwrap();
        let channels = glb.json["animations"][0]["channels"].as_array().unwrap();
        let paths: Vec<_> = channels.iter().map(|c| &c["target"]["path"]).collect();
        assert_eq!(paths, ["weights", "rotation", "translation"]);
        let turns = glb.floats(2, 4).unwrap();
        let (first, second, third) = (&turns[..4], &turns[4..8], &turns[8..]);
        assert_eq!(first, [0.0, 0.0, 0.0, 1.0]);
        // About the sensor's y, which points down: the other way about glTF's.
        assert!(
            (second[1] - 0.1).abs() < 1e-3 && second[3] > 0.99,
            "{second:?}"
        );
        assert_eq!(second, third);
    }

    #[test]
    fn somebody_who_is_not_there_is_refused_with_those_who_are() {
        let refused = |csv: &str, user| {
            let done = animated(&mut head(), csv, Path::new("run.csv"), user);
            done.unwrap_err().to_string()
        };
        let nobody = refused(CSV, Some("3"));
        assert!(
            nobody.starts_with("run.csv: expected rows of user 3, found users 0, 1"),
            "{nobody}"
        );
        let empty = refused("time_us,user,w_AU26\n0,,\n", None);
        assert!(empty.contains("found nobody"), "{empty}");
    }

    #[test]
    fn a_bad_table_is_refused_with_its_line() {
        let wrong = |csv: &str| {
            animated(&mut head(), csv, Path::new("run.csv"), None)
                .unwrap_err()
                .to_string()
        };
        assert!(wrong("a,b\n").contains("time_us"));
        assert!(
            wrong("time_us,user,w_AU26\n0,0,nan\n").contains("line 2: expected a finite weight")
        );
        assert!(wrong("time_us,user,w_AU26\n0,0\n").contains("line 2"));
        assert!(wrong("time_us,user,w_AU1\n0,0,1\n").contains("any of the 3"));
        assert!(
            wrong("time_us,user,w_AU26,qx,qy,qz,qw\n0,0,0,0,x,0,1\n")
                .contains("run.csv: line 2: expected a finite number of the pose")
        );
    }
}
