//! `mien-studio animate`: the weights of a recorded run become an animation of a head's morph targets.
//!
//! A target is driven by the CSV column `w_<unit>` of the unit that baking wrote beside it, by `w_<name>` of its own name, or,
//! in files from elsewhere, by the unit the shipped recipe gives to its name. Rows without weights (nobody there, lost)
//! are neutral. Times count from the first row of the chosen user.

use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::bake::error::BakeError;
use super::bake::files::write;
use super::bake::glb::{Glb, GlbError};
use super::bake::recipe::{Recipe, SHIPPED};
use crate::base::bounded_read;
use crate::studio::csv;
use crate::studio::text_files::{self, decoded};

/// The options of `mien-studio animate`, explained.
pub const OPTIONS: &str =
    "  --mesh  a head with named morph targets, as `mien-studio bake` writes it
  --csv   what `mien run --csv` wrote
  --user  slot to follow; default: the first that appears
";

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
    /// Nothing in common.
    #[error(
        "none of the {targets} morph targets belongs to a column of the table; bake the mesh with mien-studio bake, or name its targets as ARKit does"
    )]
    Nothing {
        /// How many targets the mesh has.
        targets: usize,
    },
    /// The result cannot be written.
    #[error(transparent)]
    Write(#[from] BakeError),
}

/// Times in seconds and weights, one row per frame.
struct Track {
    times: Vec<f32>,
    weights: Vec<Vec<f32>>,
}

/// Reads the rows of one user; `columns` are the CSV names wanted per target.
fn track(
    text: &str,
    path: &Path,
    user: Option<&str>,
    columns: &[Vec<String>],
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
    let mut out = Track {
        times: Vec::new(),
        weights: Vec::new(),
    };
    let mut first = None;
    for csv::Row { line, text, cells } in table.rows() {
        if cells.len() != table.columns().len() {
            return Err(refuse(line, "as many cells as the header has", text));
        }
        if chosen.is_none() && !cells[slot].is_empty() {
            chosen = Some(cells[slot].to_owned());
        }
        if chosen.is_none() || (!cells[slot].is_empty() && Some(cells[slot]) != chosen.as_deref()) {
            continue;
        }
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
        out.times.push(seconds as f32);
        out.weights.push(weights);
    }
    if out.times.is_empty() {
        return Err(refuse(0, "at least one row of a user", "none"));
    }
    Ok((out, driven))
}

/// Adds an animation of the morph weights to a head; returns the number of frames and of driven targets.
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
        let (track, driven) = track(csv, path, user, &columns)?;
        if driven == 0 {
            continue;
        }
        (frames, most) = (track.times.len(), most + driven);
        let floats = |values: &mut dyn Iterator<Item = f32>| {
            values.flat_map(f32::to_le_bytes).collect::<Vec<u8>>()
        };
        let view = glb.push_view(&floats(&mut track.times.iter().copied()), 0);
        let last = track.times[frames - 1];
        let input = glb.push_accessor(json!({
            "bufferView": view, "componentType": 5126, "count": frames, "type": "SCALAR", "min": [0.0], "max": [last],
        }));
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
        return Err(AnimateError::Nothing { targets: total });
    }
    let animation = json!({"name": "run", "samplers": samplers, "channels": channels});
    match glb.json["animations"].as_array_mut() {
        Some(list) => list.push(animation),
        None => glb.json["animations"] = json!([animation]),
    }
    Ok((frames, most))
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
        assert!(wrong("time_us,user,w_AU1\n0,0,1\n").contains("none of the 3"));
    }
}
