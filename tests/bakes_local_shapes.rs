//! Baked shapes against sculpted ones.
#![cfg(feature = "studio")]

use std::path::PathBuf;

use mien::studio::bake::benchmark::{Truth, compare};
use mien::studio::bake::solve::Settings;

fn data() -> Option<PathBuf> {
    let folder = std::env::var_os("MIEN_DATA")
        .map_or_else(
            || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/data")),
            PathBuf::from,
        )
        .join("ict_facekit");
    if folder.is_dir() {
        return Some(folder);
    }
    println!("skipped: no ICT head at {}", folder.display());
    None
}

#[test]
fn comes_closer_to_sculpted_shapes_than_plain_laplacian() {
    let Some(folder) = data() else { return };
    let truth = Truth::read(&folder).unwrap();
    let table = compare(&truth, &Settings::default()).unwrap();
    for row in &table {
        println!("{:45} {:.4}", row.name, row.mean());
    }
    let last = table.last().unwrap();
    for (s, (name, _)) in truth.shapes.iter().enumerate() {
        println!(
            "{name:20} {}",
            table
                .iter()
                .map(|r| format!("{:.3}", r.errors[s]))
                .collect::<Vec<_>>()
                .join(" ")
        );
    }
    assert!(last.mean() < 0.325);
}

#[test]
fn look() {
    use mien::studio::bake::{
        head::Head,
        obj,
        recipe::{Recipe, SHIPPED},
        render::{self, View},
        rig,
    };
    let Some(folder) = data() else { return };
    let out = std::path::PathBuf::from(std::env::var_os("LOOK").unwrap_or("/tmp/bake".into()));
    for (name, file) in [
        ("ict_facekit", "generic_neutral_mesh.obj"),
        ("canonical_face", "canonical_face_model.obj"),
    ] {
        let t = std::time::Instant::now();
        let dir = folder.parent().unwrap().join(name);
        let mesh = obj::parse(&std::fs::read_to_string(dir.join(file)).unwrap()).unwrap();
        let landmarks: Vec<u64> = std::fs::read_to_string(dir.join("landmarks68.txt"))
            .unwrap()
            .split_whitespace()
            .map(|w| w.parse().unwrap())
            .collect();
        println!("read {:?}", t.elapsed());
        let head = Head::new(mesh, &landmarks).unwrap();
        println!("head {:?}", t.elapsed());
        let targets = Recipe::read(SHIPPED).unwrap().targets(&head).unwrap();
        let shapes = rig::bake(
            &head,
            &targets,
            &Settings::default(),
            rig::Method::Aoi,
            &|_| (),
        )
        .unwrap();
        println!(
            "bake {:?} sum {:.0} ms",
            t.elapsed(),
            shapes.iter().map(|s| s.milliseconds).sum::<f64>()
        );
        let mut slow: Vec<_> = shapes
            .iter()
            .map(|s| (s.milliseconds as u32, s.name.clone(), s.unknowns))
            .collect();
        slow.sort();
        slow.reverse();
        println!("{:?}", &slow[..12]);
        let view = View::face(&head);
        for (page, part) in shapes.chunks(12).enumerate() {
            let pictures: Vec<_> = part
                .iter()
                .map(|s| {
                    let mut d = s.displacement.clone();
                    if let Some(upon) = &s.upon {
                        let base = shapes.iter().find(|b| b.name == *upon).unwrap();
                        for (d, b) in d.iter_mut().zip(&base.displacement) {
                            *d += b;
                        }
                    }
                    render::draw(&head, &d, &View { yaw: 0.35, ..view }, 380)
                })
                .collect();
            println!(
                "page {page}: {:?}",
                part.iter().map(|s| s.name.as_str()).collect::<Vec<_>>()
            );
            render::sheet(&pictures, 4)
                .save(out.join(format!("{name}_{page}.png")))
                .unwrap();
        }
    }
}
