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
