//! Baked shapes: close to sculpted ones, still outside their area, no triangle turned over, lids on the eyeball.
//! Needs the heads of the shared data (`MIEN_DATA`); without them it says so and passes.
#![cfg(feature = "studio")]

use std::path::PathBuf;

use mien::studio::bake::benchmark::{Truth, compare};
use mien::studio::bake::head::Head;
use mien::studio::bake::measure::Judge;
use mien::studio::bake::obj;
use mien::studio::bake::recipe::{Recipe, SHIPPED};
use mien::studio::bake::rig::{self, Method, Shape};
use mien::studio::bake::solve::Settings;

fn data(name: &str) -> Option<PathBuf> {
    let beside = concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/data");
    let folder = std::env::var_os("MIEN_DATA")
        .map_or_else(|| PathBuf::from(beside), PathBuf::from)
        .join(name);
    if folder.is_dir() {
        return Some(folder);
    }
    println!("skipped: no {}", folder.display());
    None
}

fn baked(folder: &str, mesh: &str) -> Option<(Head, Vec<Shape>)> {
    let folder = data(folder)?;
    let text = std::fs::read_to_string(folder.join(mesh)).unwrap();
    let landmarks: Vec<u64> = std::fs::read_to_string(folder.join("landmarks68.txt"))
        .unwrap()
        .split_whitespace()
        .map(|w| w.parse().unwrap())
        .collect();
    let head = Head::new(obj::parse(&text).unwrap(), &landmarks).unwrap();
    let targets = Recipe::read(SHIPPED).unwrap().targets(&head).unwrap();
    let shapes = rig::bake(&head, &targets, &Settings::default(), Method::Aoi, &|_| ()).unwrap();
    Some((head, shapes))
}

/// Prints what is wrong with each shape and returns how many inverted triangles there are.
fn judged(head: &Head, shapes: &[Shape]) -> usize {
    let judge = Judge::new(head);
    let (mut inverted, mut widest) = (0, 0.0_f64);
    for k in 0..shapes.len() {
        let f = judge.judge(shapes, k);
        let (name, gap) = (&shapes[k].name, f.lid_gap.unwrap_or(0.0));
        if f.inverted > 0 || gap > 0.0 {
            println!("{name}: {} inverted, lids {gap:.4} apart", f.inverted);
        }
        inverted += f.inverted;
        assert!(f.outside == 0.0, "{} leaks", shapes[k].name);
        assert!(f.eye_depth < 1e-3, "{}: {}", shapes[k].name, f.eye_depth);
        widest = widest.max(gap);
    }
    assert!(widest < 0.03, "lids {widest} apart");
    inverted
}

#[test]
fn comes_closer_to_sculpted_shapes_than_plain_laplacian() {
    let Some(folder) = data("ict_facekit") else {
        return;
    };
    let truth = Truth::read(&folder).unwrap();
    let table = compare(&truth, &Settings::default()).unwrap();
    for row in &table {
        println!("{:45} {:.4}", row.name, row.mean());
    }
    let (free, held, ours) = (&table[0], &table[1], &table[table.len() - 1]);
    for (s, (name, _)) in truth.shapes.iter().enumerate() {
        let errors: Vec<String> = table
            .iter()
            .map(|r| format!("{:.3}", r.errors[s]))
            .collect();
        println!("{name:20} {}", errors.join(" "));
        assert!(ours.errors[s] < 1.10 * free.errors[s], "{name}");
    }
    assert!(ours.mean() < 0.325);
    assert!(ours.mean() < 0.62 * free.mean());
    assert!(ours.mean() < 0.92 * held.mean());
}

#[test]
fn the_recipe_fits_a_head_with_eyes_and_teeth() {
    let Some((head, shapes)) = baked("ict_facekit", "generic_neutral_mesh.obj") else {
        return;
    };
    assert_eq!(shapes.len(), 67);
    assert_eq!(judged(&head, &shapes), 0);
    // Lower teeth follow the jaw rigidly, upper teeth stay.
    let jaw = shapes.iter().find(|s| s.name == "jawOpen").unwrap();
    let moved = |v: usize| jaw.displacement[v].norm() / head.eye_distance;
    assert!(moved(20_300) > 0.8 && moved(18_100) == 0.0);
    // So does the tongue with its tip (16757) and its top (16726), which lies above the bite; the palate stays.
    assert!(moved(16_757) > 0.8 && moved(16_726) > 0.5);
    let palate = (14_062..17_039)
        .filter(|&v| head.mesh.positions[v].y > -1.5)
        .map(moved);
    assert_eq!(palate.fold(0.0, f64::max), 0.0);
    // The tongue comes out, the gums beside the lower teeth stay with them.
    let tongue = shapes.iter().find(|s| s.name == "tongueOut").unwrap();
    let moved = |v: usize| tongue.displacement[v].norm() / head.eye_distance;
    assert!(moved(16_757) > 1.0 && moved(14_850) == 0.0);
}

#[test]
fn the_recipe_fits_a_coarse_mask_of_triangles() {
    let Some((head, shapes)) = baked("canonical_face", "canonical_face_model.obj") else {
        return;
    };
    assert_eq!(shapes.len(), 67);
    assert_eq!(judged(&head, &shapes), 0);
}
