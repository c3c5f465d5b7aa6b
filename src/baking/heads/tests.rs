//! Heads with photographs, compared with their portraits. Skipped without the data sets.

use super::*;
use image::RgbImage;

use crate::data::{Set, only};
use crate::golden::{coloured, compare_with_golden, equals_golden};

/// Places in half millimetres, colours and places in the picture in hundredths.
#[test]
fn the_default_head_equals_the_golden_one() {
    let hero = hero::Hero::shipped();
    let mut lines = Vec::new();
    for layer in [&hero.face, &hero.dress] {
        let places = &layer.mesh.positions;
        lines.push(format!("vertices {}", places.len()));
        for v in (0..places.len()).step_by(places.len() / 150) {
            let place = places[v].iter().map(|x| (x * 2e3).round());
            let look = layer.tints[v].iter().chain(&layer.uv[v]);
            let look = look.map(|x| f64::from((x * 1e2).round()));
            lines.push(
                place
                    .chain(look)
                    .map(|x| format!("{x:.0}"))
                    .collect::<Vec<_>>()
                    .join(" "),
            );
        }
    }
    compare_with_golden("heads/hero", &lines);
}

fn data() -> Option<tempfile::TempDir> {
    only([Set::IctFacekit, Set::FacesFrl189])
}

#[test]
fn landmarks_lie_under_their_annotations_and_survive_reduction() {
    let Some(data) = data() else { return };
    let heads = textured_heads(data.path(), |person| person == 32, 1).expect("data are readable");
    let portraits = portraits(data.path()).expect("data are readable");
    let mut portraits = portraits.into_iter();
    let (.., points) = portraits.find(|p| p.0 == 32).expect("an annotated person");
    let asset = &heads[0].asset;
    let places: Vec<[f32; 2]> = asset
        .landmarks
        .iter()
        .map(|site| asset.photo[site.vertices[0] as usize])
        .collect();
    // The photograph is cropped: places agree up to one shift.
    let shift = [0, 1].map(|c| points[30][c] - places[30][c]);
    let eyes = (points[45][0] - points[36][0]).abs();
    for (k, (place, point)) in places.iter().zip(&points).enumerate() {
        let off = (place[0] + shift[0] - point[0]).hypot(place[1] + shift[1] - point[1]);
        // Inner lip points of a closed mouth share one place.
        let allowed = if k >= 60 { 0.03 } else { 0.012 };
        assert!(off < allowed * eyes, "landmark {k}: {off} px of {eyes}");
    }
    let corner = (asset.landmarks[39].position(&asset.neutral).coords
        + asset.landmarks[42].position(&asset.neutral).coords)
        * 0.5;
    assert!(corner.norm() < 1e-5);

    let small = reduce::Reduction::new(asset).apply(asset);
    assert!(small.neutral.len() * 3 < asset.neutral.len());
    for (a, b) in asset.landmarks.iter().zip(small.landmarks.iter()) {
        assert!((a.position(&asset.neutral) - b.position(&small.neutral)).norm() < 1e-6);
    }
}

/// Colours, and places in half millimetres.
#[test]
fn the_average_of_two_people_equals_the_golden_one() {
    let Some(data) = data() else { return };
    let two = textured_heads(data.path(), |person| (30..32).contains(&person), 2).unwrap();
    let head = average::average(&two).expect("two heads");
    let Texture { width, height, .. } = *head.texture.first().expect("a texture");
    let rgb = head.texture[0].rgb.clone();
    let mut lines =
        coloured::<16, 16>(&RgbImage::from_raw(width as u32, height as u32, rgb).unwrap());
    for v in (0..head.neutral.len()).step_by(150) {
        let [x, y, z] = (head.neutral[v].coords * 2e3).into();
        let [r, g, b] = head.colour[v];
        let share = 100.0 * head.photo_share[v];
        let numbers = [x, y, z, r, g, b, share].map(|n| format!("{n:.0}"));
        lines.push(numbers.join(" "));
    }
    equals_golden("heads/average", &lines);
}
