//! `mien-studio animate`: the weights of a recorded run become an animation of a head's morph targets.
//!
//! A target is driven by the CSV column `w_<unit>` of the unit that baking wrote beside it, by `w_<name>` of its own
//! name, or, in files from elsewhere, by the unit that the shipped recipe gives to its name. Of several units
//! (`AU34L|AU34R`) the largest weight counts; the corrective of two targets has the product of their weights. Rows
//! without weights (absent, lost) are neutral. The head turns with the pose ([`head_turn`]) and keeps its last one
//! without. Times count from the first row of the chosen user.

mod head_turn;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use head_turn::Turned;
use mien_baking::bake::command::output_name;
use mien_baking::bake::files::{read, read_bytes, write};
use mien_baking::bake::glb::{Glb, list, push};
use mien_baking::bake::recipe::{Recipe, SHIPPED};
use mien_baking::bake::shape::pair;
use mien_workbench::csv;
use mien_workbench::fault::Fault;

/// Whose performance moves what.
#[derive(clap::Args)]
pub struct Args {
    /// Head with named morph targets, as bake writes it
    #[arg(long)]
    pub mesh: PathBuf,
    /// CSV written by mien run --csv
    #[arg(long)]
    pub csv: PathBuf,
    /// Animated head to write, .glb or .vrm
    #[arg(long, value_parser = output_name)]
    pub out: PathBuf,
    /// Slot of the person to animate [default: the first that appears]
    #[arg(long)]
    pub user: Option<String>,
}

/// A rotation of the head: x, y, z, w.
type Turn = [f32; 4];

/// The two targets whose corrective this one is.
type Pair = Option<[usize; 2]>;

/// Times in seconds, weights and rotations of the head, one row per frame.
#[derive(Default)]
struct Track {
    times: Vec<[f32; 1]>,
    /// Frame by frame, the weights of all targets.
    weights: Vec<[f32; 1]>,
    /// As from the sensor, each in the hemisphere of the one before; empty if the table has none.
    poses: Vec<Turn>,
}

/// The slots in a table, for messages.
fn slots(table: &csv::Table, slot: usize) -> String {
    let all = table.rows().filter_map(|row| row.cells.get(slot).copied());
    let all: BTreeSet<&str> = all.filter(|cell| !cell.is_empty()).collect();
    let first: Vec<&str> = all.into_iter().take(16).collect();
    match first[..] {
        [] => "nobody".into(),
        [one] => format!("user {one} only"),
        _ => format!("users {}", first.join(", ")),
    }
}

/// Columns of a table that drive a head.
struct Columns {
    time: usize,
    slot: usize,
    /// Per target, columns of which the largest counts; empty if nothing drives it.
    weights: Vec<Vec<usize>>,
    pose: Option<[usize; 4]>,
}

/// A finite number in a cell.
fn finite(cell: &str) -> Option<f32> {
    cell.parse().ok().filter(|v: &f32| v.is_finite())
}

impl Columns {
    /// Finds the columns; `targets` lists the units that may drive each target. `None` without time and user.
    fn find(table: &csv::Table, targets: &[Vec<String>]) -> Option<Self> {
        let columns = |units: &String| -> Vec<usize> {
            let column = |unit| table.find(&format!("w_{unit}"));
            units.split('|').filter_map(column).collect()
        };
        let of = |names: &Vec<String>| {
            let mut found = names.iter().map(columns);
            found.find(|found| !found.is_empty()).unwrap_or_default()
        };
        let pose = table.find_all(["qx", "qy", "qz", "qw"]);
        Some(Self {
            time: table.find("time_us")?,
            slot: table.find("user")?,
            weights: targets.iter().map(of).collect(),
            pose: pose.and_then(|pose| pose.try_into().ok()),
        })
    }

    /// Weights of a row's targets, 0 for empty cells, for correctives the product of their `pairs`; the error is the
    /// first cell that is no number.
    fn weights<'a>(&self, cells: &[&'a str], pairs: &[Pair]) -> Result<Vec<[f32; 1]>, &'a str> {
        let cell = |at: &usize| match cells[*at] {
            "" => Ok(0.0),
            cell => finite(cell).ok_or(cell),
        };
        let weight = |columns: &Vec<usize>| {
            let largest = |most: f32, at| Ok(most.max(cell(at)?));
            Ok([columns.iter().try_fold(0.0, largest)?])
        };
        let weights = self.weights.iter().map(weight);
        let mut weights = weights.collect::<Result<Vec<_>, _>>()?;
        for (k, pair) in pairs.iter().enumerate() {
            if let Some([a, b]) = *pair {
                weights[k] = [weights[a][0] * weights[b][0]];
            }
        }
        Ok(weights)
    }

    /// The rotation in a row, or that of the row before; the error is the first cell that is no number.
    fn pose<'a>(&self, cells: &[&'a str], before: Option<&Turn>) -> Result<Option<Turn>, &'a str> {
        let Some(columns) = self.pose else {
            return Ok(None);
        };
        let before = before.copied().unwrap_or([0.0, 0.0, 0.0, 1.0]);
        let words = columns.map(|at| cells[at]);
        if words.iter().all(|word| word.is_empty()) {
            return Ok(Some(before));
        }
        let mut now = [0.0; 4];
        for (slot, word) in now.iter_mut().zip(words) {
            *slot = finite(word).ok_or(word)?;
        }
        // A rotation has two quaternions; interpolation between neighbours must take the shorter way.
        let same = before.iter().zip(now).map(|(a, b)| a * b).sum::<f32>() >= 0.0;
        Ok(Some(if same { now } else { now.map(|v| -v) }))
    }
}

/// Reads the rows of one user, with the number of driven targets.
fn track(
    text: &str,
    path: &Path,
    user: Option<&str>,
    targets: &Targets,
) -> Result<(Track, usize), Fault> {
    let refuse = |line, expected, found: &str| Fault::at_line(path, line, expected, found);
    let table = csv::Table::new(text);
    let columns = Columns::find(&table, &targets.units).ok_or_else(|| {
        let expected = "a header with time_us, user and w_<unit> columns";
        refuse(1, expected, &table.columns.join(","))
    })?;
    let mut chosen = user.map(str::to_owned);
    let mut out = Track::default();
    let (mut first, mut met) = (None, false);
    for csv::Row { line, text, cells } in table.rows() {
        if cells.len() != table.columns.len() {
            return Err(refuse(line, "as many cells as in the header", text));
        }
        let slot = Some(cells[columns.slot]).filter(|slot| !slot.is_empty());
        if chosen.is_none() {
            chosen = slot.map(str::to_owned);
        }
        if chosen.is_none() || slot.is_some_and(|slot| Some(slot) != chosen.as_deref()) {
            continue;
        }
        met |= slot.is_some();
        let now = cells[columns.time].parse::<u64>();
        let now = now.map_err(|_| refuse(line, "a time in microseconds", text))?;
        let seconds = now.saturating_sub(*first.get_or_insert(now)) as f64 * 1e-6;
        let time = [seconds as f32];
        if out.times.last().is_some_and(|&last| time <= last) {
            continue;
        }
        let weights = columns.weights(&cells, &targets.pairs);
        let weights = weights.map_err(|found| refuse(line, "a finite weight", found))?;
        let pose = columns.pose(&cells, out.poses.last());
        let pose = pose.map_err(|found| refuse(line, "a finite number of the pose", found))?;
        out.poses.extend(pose);
        out.times.push(time);
        out.weights.extend(weights);
    }
    if !met {
        let wanted = user.map_or_else(|| "somebody".into(), |user| format!("user {user}"));
        let found = slots(&table, columns.slot);
        return Err(Fault::within(path)(format!(
            "expected rows of {wanted}, found {found}; give --user a slot from the column user"
        )));
    }
    let driven = columns.weights.iter().filter(|columns| !columns.is_empty());
    Ok((out, driven.count()))
}

/// The morph targets of a mesh.
struct Targets {
    /// Units that may drive each target, the best first.
    units: Vec<Vec<String>>,
    /// The two targets whose corrective this one is, driven by the product of both weights.
    pairs: Vec<Pair>,
}

impl Targets {
    /// Targets of a mesh; `recipe` maps names of shapes to units. `None` if its targets have no names.
    fn read(mesh: &Value, recipe: &[(String, String)]) -> Option<Self> {
        let own = mesh["extras"]["targetNames"].as_array();
        let first = &mesh["primitives"][0]["extras"]["targetNames"];
        let names = own.or(first.as_array())?;
        let names: Vec<&str> = names.iter().map(Value::as_str).collect::<Option<_>>()?;
        let units = names.iter().enumerate().map(|(k, name)| {
            let output_name = mesh["extras"]["mien"]["units"][k].as_str();
            let mut shipped = recipe.iter().filter(|(n, _)| n.eq_ignore_ascii_case(name));
            let shipped = shipped.next().map(|(_, unit)| unit.as_str());
            let units = [output_name, Some(*name), shipped].into_iter().flatten();
            units.map(str::to_owned).collect()
        });
        let place = |name: &str| names.iter().position(|n| *n == name);
        let pairs = names.iter().map(|name| {
            let [a, b] = pair(name, |name| place(name).is_some())?;
            Some([place(a)?, place(b)?])
        });
        Some(Self {
            units: units.collect(),
            pairs: pairs.collect(),
        })
    }
}

/// Adds a sampler of values at the times in accessor `input` to an animation; returns its index.
fn sampler<const N: usize>(
    animation: &mut Value,
    glb: &mut Glb,
    input: usize,
    rows: &[[f32; N]],
) -> usize {
    let output = glb.push_rows(rows, 0);
    let sampler = json!({"input": input, "output": output, "interpolation": "LINEAR"});
    push(&mut animation["samplers"], sampler)
}

/// Adds a channel from a sampler to a node.
fn channel(animation: &mut Value, sampler: usize, node: usize, path: &str) {
    let channel = json!({"sampler": sampler, "target": {"node": node, "path": path}});
    push(&mut animation["channels"], channel);
}

/// Adds an animation of the morph weights to a head; returns the number of frames and of driven targets.
fn animated(
    glb: &mut Glb,
    csv: &str,
    path: &Path,
    user: Option<&str>,
) -> Result<(usize, usize), Fault> {
    let [meshes, nodes] = ["meshes", "nodes"].map(|name| list(&glb.json[name]).to_vec());
    let recipe = Recipe::read(SHIPPED).map(|r| r.units()).unwrap_or_default();
    let mut animation = json!({"name": "run"});
    let (mut frames, mut most, mut total) = (0, 0, 0);
    let mut turning: Option<(usize, Vec<Turn>)> = None;
    let mut driven_meshes = Vec::new();
    for (m, mesh) in meshes.iter().enumerate() {
        let Some(targets) = Targets::read(mesh, &recipe) else {
            continue;
        };
        total += targets.units.len();
        let (track, driven) = track(csv, path, user, &targets)?;
        if driven == 0 {
            continue;
        }
        (frames, most) = (track.times.len(), most + driven);
        driven_meshes.push(m);
        let input = glb.push_rows_with_bounds(&track.times, 0);
        turning.get_or_insert((input, track.poses));
        let sampler = sampler(&mut animation, glb, input, &track.weights);
        for (node, value) in nodes.iter().enumerate() {
            if value["mesh"] == json!(m) {
                channel(&mut animation, sampler, node, "weights");
            }
        }
    }
    if animation["channels"].is_null() {
        return Err(Fault::within(path)(format!(
            "no column drives any of the {total} morph targets of the mesh; bake the mesh with mien-studio bake, or give its targets ARKit's names"
        )));
    }
    if let Some((input, poses)) = turning.filter(|(_, poses)| !poses.is_empty()) {
        for turned in Turned::find(glb, &driven_meshes) {
            let rows = poses.iter().map(|&pose| turned.posed(pose));
            let (rotations, places): (Vec<_>, Vec<_>) = rows.unzip();
            let turns = sampler(&mut animation, glb, input, &rotations);
            channel(&mut animation, turns, turned.node, "rotation");
            let places: Vec<[f32; 3]> = places.into_iter().flatten().collect();
            if !places.is_empty() {
                let moves = sampler(&mut animation, glb, input, &places);
                channel(&mut animation, moves, turned.node, "translation");
            }
        }
    }
    push(&mut glb.json["animations"], animation);
    Ok((frames, most))
}

/// Writes the head with the weights of the table as an animation; prints one line.
///
/// # Errors
/// If the mesh or the table is not as expected, or the result cannot be written.
pub fn animate(args: &Args) -> Result<(), Fault> {
    let mut glb = Glb::parse(&read_bytes(&args.mesh)?).map_err(Fault::within(&args.mesh))?;
    let text = read(&args.csv)?;
    let (frames, driven) = animated(&mut glb, &text, &args.csv, args.user.as_deref())?;
    write(&args.out, &glb.emit())?;
    let out = args.out.display();
    println!("{out}: {frames} frames, {driven} morph targets driven");
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
        let names = "jawOpen_eyeBlinkLeft jawOpen eyeBlinkLeft jawOpen_L".split(' ');
        let names: Vec<&str> = names.collect();
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
    fn an_absent_slot_is_refused_with_the_present_ones() {
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
        let no_number = "run.csv: line 2: expected a finite number of the pose";
        for (csv, expected) in [
            ("a,b\n", "time_us"),
            (
                "time_us,user,w_AU26\n0,0,nan\n",
                "line 2: expected a finite weight",
            ),
            ("time_us,user,w_AU26\n0,0\n", "line 2"),
            ("time_us,user,w_AU1\n0,0,1\n", "any of the 3"),
            (
                "time_us,user,w_AU26,qx,qy,qz,qw\n0,0,0,0,x,0,1\n",
                no_number,
            ),
        ] {
            let found = animated(&mut head(), csv, Path::new("run.csv"), None);
            let said = found.unwrap_err().to_string();
            assert!(said.contains(expected), "{said}");
        }
    }
}
