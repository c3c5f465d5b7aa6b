//! The verdict passes what artists sculpted and refuses what is folded; jaws open as artists have it.
//! Needs heads of the data sets; left out without them.
#![cfg(feature = "studio")]

use mien_baking::bake::head::Head;
use mien_baking::bake::locate::guess;
use mien_baking::bake::looks::Looks;
use mien_baking::bake::mesh::Vec3;
use mien_baking::bake::obj;
use mien_baking::bake::order::Ordered;
use mien_baking::bake::shape::Shape;
use mien_baking::bake::verdict::{defects, verdict};
use mien_baking::heads::default_head;
use mien_stages::face_model::FaceModel;

use crate::common::data::{self, Set};

/// A head in the order that it is solved in, and the vertex there of each of its file's.
fn head(set: Set, name: &str) -> Option<(Head, Vec<u32>)> {
    let folder = data::folder(set)?;
    let mesh = obj::parse(&std::fs::read_to_string(folder.join(name)).unwrap()).unwrap();
    let found = guess(&mesh, &Looks::default(), None, &FaceModel::shipped()).unwrap();
    let mut ordered = Ordered::new(&mesh);
    let landmarks = ordered.landmarks(&found.vertices).unwrap();
    let vertex = ordered.vertex().to_vec();
    let head = Head::new(std::mem::take(&mut ordered.mesh), &landmarks).unwrap();
    Some((head, vertex))
}

/// The shapes that an artist sculpted on a head.
fn sculpted(set: Set, head: &Head, vertex: &[u32]) -> Vec<Shape> {
    let folder = data::folder(set).unwrap();
    let index = std::fs::read_to_string(folder.join("index.csv")).unwrap();
    let rows = index.lines().skip(1).filter_map(|row| {
        let mut cells = row.split(',');
        Some((cells.next()?.to_owned(), cells.next()?.to_owned()))
    });
    let shape = |(file, name): (String, String)| {
        let bytes = std::fs::read(folder.join("shapes").join(file)).unwrap();
        let numbers = bytes.chunks_exact(4);
        let numbers = numbers.map(|b| f64::from(f32::from_le_bytes(b.try_into().unwrap())));
        let numbers: Vec<f64> = numbers.collect();
        let mut displacement = vec![Vec3::zeros(); head.mesh.positions.len()];
        for (d, &v) in numbers.chunks_exact(3).zip(vertex) {
            displacement[v as usize] = Vec3::new(d[0], d[1], d[2]);
        }
        Shape {
            upon: (name == "mouthClose").then(|| "jawOpen".into()),
            name,
            displacement,
            ..Shape::default()
        }
    };
    rows.map(shape).collect()
}

#[test]
fn the_verdict_passes_what_an_artist_sculpted_and_no_crumpled_jaw() {
    let Some((head, vertex)) = head(Set::HeadFacecap, "head.obj") else {
        return;
    };
    let mut shapes = sculpted(Set::HeadFacecap, &head, &vertex);
    assert_eq!(shapes.len(), 51);
    let found = defects(&head, &shapes);
    let said = verdict(&shapes, &found);
    assert!(said.starts_with("51 of 51 shapes pass"), "{said}");
    // The chin pushed back further than down folds the throat.
    let jaw = shapes.iter_mut().find(|s| s.name == "jawOpen").unwrap();
    let (up, out) = (head.axes.column(1), head.axes.column(2));
    for (d, p) in jaw.displacement.iter_mut().zip(&head.mesh.positions) {
        let near = (p - head.point(8)).norm() < 0.4 * head.eye_distance;
        if near {
            *d = (-up * 0.3 - out * 1.2) * head.eye_distance;
        }
    }
    let k = shapes.iter().position(|s| s.name == "jawOpen").unwrap();
    let found = &defects(&head, &shapes)[k];
    for measure in ["length of folds", "chin back"] {
        assert!(found.iter().any(|f| f.starts_with(measure)), "{found:?}");
    }
}

#[test]
fn jaws_open_as_artists_have_it() {
    for (set, name) in [
        (Set::HeadVitruvian, "head.obj"),
        (Set::HeadFacecap, "head.obj"),
        (Set::HeadsMakehuman, "caucasian-female-young.obj"),
        (Set::HeadsMakehuman, "body-child.obj"),
        (Set::CanonicalFace, "canonical_face_model.obj"),
    ] {
        let Some((head, _)) = head(set, name) else {
            return;
        };
        let shapes = default_head::shapes(&head).unwrap();
        let found = defects(&head, &shapes);
        println!("{name}: {}", verdict(&shapes, &found));
        let k = shapes.iter().position(|s| s.name == "jawOpen").unwrap();
        assert!(found[k].is_empty(), "{name}: {:?}", found[k]);
    }
}
