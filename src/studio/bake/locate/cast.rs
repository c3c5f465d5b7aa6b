//! Points of a picture as vertices of the head that is drawn there.
//!
//! What lines an opening (lids, inner lips) goes to the nearest vertex of a rim: visible, with a neighbour that is not. A face that
//! mirrors itself gets points that do.

use std::collections::HashSet;

use super::super::mesh::{Mesh, Rings, Vec3};
use super::search::{DEEP, FRAME};
use super::seen::{PIXELS, Seen, apart};
use crate::base::capacity::LANDMARKS;
use crate::face_model::scheme::MIRROR;

/// A rim vertex further than this from a fitted point is another opening's, in widths of the head.
const RIM: f64 = 0.03;

/// The vertex under each fitted point, and whether the head mirrors itself.
pub(super) fn cast(
    mesh: &Mesh,
    rings: &Rings,
    skin: &[bool],
    points: &[[f32; 2]; LANDMARKS],
    depths: &[f64; LANDMARKS],
    seen: &mut Seen,
) -> (Vec<u32>, bool) {
    let n = mesh.positions.len();
    let width_px = f64::from(PIXELS) / FRAME;
    let screen: Vec<Vec3> = mesh.positions.iter().map(|p| seen.screen(p)).collect();
    let normals = mesh.vertex_normals(&mesh.positions);
    let towards = seen.to_view.transpose() * Vec3::z();
    let faces = |v: usize| normals[v].dot(&towards) > 0.0 && seen.canvas.shows(&screen[v]);
    let visible: Vec<bool> = (0..n).map(|v| skin[v] && faces(v)).collect();
    let border = mesh.border();
    let ends = |v: usize| border[v] || rings.of(v).iter().any(|&o| !visible[o as usize]);
    let rim: Vec<bool> = (0..n).map(|v| visible[v] && ends(v)).collect();
    // Mirrored points in a mirrored head: the mean of both sides.
    let (middle, symmetric) = plane(&screen, skin, points, width_px);
    seen.plane = seen.middle.x + (middle - f64::from(PIXELS) / 2.0) / seen.scale;
    let aim = |k: usize| {
        let [p, q] = [k, MIRROR[k]].map(|k| points[k].map(f64::from));
        let both = [0.5 * (p[0] + 2.0 * middle - q[0]), 0.5 * (p[1] + q[1])];
        if symmetric { both } else { p }
    };
    let up = |v: usize| (seen.to_view * normals[v]).y;
    let deep = DEEP * f64::from(apart(points[39], points[42]));
    let mut taken: Vec<u32> = Vec::with_capacity(LANDMARKS);
    for k in 0..LANDMARKS {
        let [x, y] = aim(k);
        let far = |v: usize| (screen[v].x - x).hypot(screen[v].y - y);
        let nearest = |fits: &dyn Fn(usize) -> bool| {
            let free = |v: &usize| visible[*v] && fits(*v) && !taken.contains(&(*v as u32));
            (0..n)
                .filter(free)
                .min_by(|&a, &b| far(a).total_cmp(&far(b)))
        };
        // An upper edge looks down, a lower one up; corners look anywhere.
        let lines = |v: usize| match k {
            37 | 38 | 43 | 44 | 61..=63 => rim[v] && up(v) < 0.1,
            40 | 41 | 46 | 47 | 65..=67 => rim[v] && up(v) > -0.1,
            _ => rim[v],
        };
        // What is seen through an opening lies too deep.
        let level = |v: usize| (screen[v].z - depths[k]).abs() < deep;
        let mut vertex = None;
        if matches!(k, 36..=47 | 60..=67) {
            vertex = nearest(&|v| lines(v) && level(v)).filter(|&v| far(v) < RIM * width_px);
        }
        let vertex = vertex
            .or_else(|| nearest(&level))
            .or_else(|| nearest(&|_| true));
        taken.push(vertex.unwrap_or(0) as u32);
    }
    (taken, symmetric)
}

/// Where the plane is that mirrors the face, in pixels from the left, and whether nearly all of the face has a partner there.
fn plane(
    screen: &[Vec3],
    skin: &[bool],
    points: &[[f32; 2]; LANDMARKS],
    width_px: f64,
) -> (f64, bool) {
    let mean = points.iter().map(|p| f64::from(p[0])).sum::<f64>() / LANDMARKS as f64;
    let [top, chin] = [27, 8].map(|k| f64::from(points[k][1]));
    // Shoulders and hair need not mirror.
    let tall = (chin - top).abs();
    let near = |p: &&Vec3| p.y > top - 0.5 * tall && p.y < chin && (p.x - mean).abs() < width_px;
    let of_skin = screen.iter().zip(skin).filter(|s| *s.1).map(|s| s.0);
    let all: Vec<&Vec3> = of_skin.filter(near).collect();
    let across = || all.iter().map(|p| p.x);
    let low = across().reduce(f64::min).unwrap_or(mean);
    let high = across().reduce(f64::max).unwrap_or(mean);
    let tip = all
        .iter()
        .max_by(|a, b| a.z.total_cmp(&b.z))
        .map_or(mean, |p| p.x);
    let middles = [tip, 0.5 * (low + high), mean];
    let alone = middles
        .map(|at| (alone(&all, at, 0.02 * width_px), at))
        .into_iter();
    let least = alone.min_by(|a, b| a.0.total_cmp(&b.0));
    let (alone, at) = least.unwrap_or((1.0, mean));
    let symmetric = alone < 0.05;
    (if symmetric { at } else { mean }, symmetric)
}

/// Share of places that have no partner on the other side.
fn alone(all: &[&Vec3], middle: f64, cell: f64) -> f64 {
    let key = |x: f64, p: &Vec3| [x, p.y, p.z].map(|c| (c / cell).round() as i64);
    let there: HashSet<[i64; 3]> = all.iter().map(|p| key(p.x - middle, p)).collect();
    let alone = all.iter().filter(|p| {
        let [x, y, z] = key(middle - p.x, p);
        !(-1..=1).any(|d| there.contains(&[x + d, y, z]))
    });
    alone.count() as f64 / all.len().max(1) as f64
}
