//! A mesh as pictures: shaded from the front, at an angle and from the side.
//!
//! Orthographic, flat shading by the angle to the viewer, depth by a z-buffer. The mesh is scaled to the picture and taken
//! as y up, z towards the viewer, as OBJ and glTF heads are.

use std::path::Path;

use image::RgbImage;
use nalgebra::{Rotation3, Vector3};

use super::InspectError;
use super::album::Album;

const SIZE: u32 = 420;

struct Mesh {
    vertices: Vec<Vector3<f32>>,
    triangles: Vec<[usize; 3]>,
}

impl Mesh {
    fn read(path: &Path, text: &str) -> Result<Self, InspectError> {
        let mut mesh = Self {
            vertices: Vec::new(),
            triangles: Vec::new(),
        };
        for (number, line) in text.lines().enumerate() {
            let refuse = || InspectError::Mesh {
                path: path.into(),
                line: number + 1,
                found: line.chars().take(60).collect(),
            };
            let mut words = line.split_ascii_whitespace();
            match words.next() {
                Some("v") => {
                    let mut next = || {
                        words
                            .next()
                            .and_then(|w| w.parse::<f32>().ok())
                            .filter(|v| v.is_finite())
                            .ok_or_else(refuse)
                    };
                    mesh.vertices.push(Vector3::new(next()?, next()?, next()?));
                }
                Some("f") => {
                    let corner = |word: &str| {
                        let index: i64 = word.split('/').next()?.parse().ok()?;
                        let count = mesh.vertices.len() as i64;
                        // Negative indices count from the end.
                        let index = if index < 0 { count + index } else { index - 1 };
                        (0..count).contains(&index).then_some(index as usize)
                    };
                    let corners: Vec<usize> = words
                        .map(|word| corner(word).ok_or_else(refuse))
                        .collect::<Result<_, _>>()?;
                    if corners.len() < 3 {
                        return Err(refuse());
                    }
                    mesh.triangles.extend(
                        (2..corners.len()).map(|k| [corners[0], corners[k - 1], corners[k]]),
                    );
                }
                _ => {}
            }
        }
        if mesh.triangles.is_empty() {
            return Err(InspectError::Mesh {
                path: path.into(),
                line: text.lines().count(),
                found: "no faces".into(),
            });
        }
        Ok(mesh)
    }

    fn draw(&self, yaw: f32) -> RgbImage {
        let low = self
            .vertices
            .iter()
            .copied()
            .reduce(|a, b| a.inf(&b))
            .unwrap_or_default();
        let high = self
            .vertices
            .iter()
            .copied()
            .reduce(|a, b| a.sup(&b))
            .unwrap_or_default();
        let (centre, scale) = (
            (low + high) * 0.5,
            0.94 * SIZE as f32 / (high - low).max().max(f32::MIN_POSITIVE),
        );
        let turn = Rotation3::from_axis_angle(&Vector3::y_axis(), yaw);
        let placed: Vec<Vector3<f32>> = self
            .vertices
            .iter()
            .map(|v| {
                let v = turn * (v - centre) * scale;
                Vector3::new(v.x + SIZE as f32 / 2.0, SIZE as f32 / 2.0 - v.y, v.z)
            })
            .collect();
        let mut picture = RgbImage::from_pixel(SIZE, SIZE, image::Rgb([255; 3]));
        let mut depth = vec![f32::NEG_INFINITY; (SIZE * SIZE) as usize];
        for &[a, b, c] in &self.triangles {
            let (a, b, c) = (placed[a], placed[b], placed[c]);
            let normal = (b - a).cross(&(c - a));
            let area = normal.z;
            if area.abs() < 1e-9 {
                continue;
            }
            let light = (normal.z.abs() / normal.norm()).powf(0.8);
            let grey = (60.0 + 175.0 * light) as u8;
            let bound = |low: f32, high: f32| {
                (
                    low.floor().max(0.0) as u32,
                    (high.ceil().max(0.0) as u32).min(SIZE - 1),
                )
            };
            let (x0, x1) = bound(a.x.min(b.x).min(c.x), a.x.max(b.x).max(c.x));
            let (y0, y1) = bound(a.y.min(b.y).min(c.y), a.y.max(b.y).max(c.y));
            for y in y0..=y1 {
                for x in x0..=x1 {
                    let (px, py) = (x as f32, y as f32);
                    let edge = |p: Vector3<f32>, q: Vector3<f32>| {
                        ((q.x - p.x) * (py - p.y) - (q.y - p.y) * (px - p.x)) / area
                    };
                    let (u, v, w) = (edge(b, c), edge(c, a), edge(a, b));
                    if u < 0.0 || v < 0.0 || w < 0.0 {
                        continue;
                    }
                    let z = u * a.z + v * b.z + w * c.z;
                    let place = (y * SIZE + x) as usize;
                    if z > depth[place] {
                        depth[place] = z;
                        picture.put_pixel(
                            x,
                            y,
                            image::Rgb([grey, grey, (grey as f32 * 0.95) as u8]),
                        );
                    }
                }
            }
        }
        picture
    }
}

/// Reads an OBJ and draws it.
pub(super) fn inspect(path: &Path, text: &str) -> Result<Album, InspectError> {
    let mesh = Mesh::read(path, text)?;
    let mut album = Album {
        title: format!("Mesh {}", super::name_of(path)),
        ..Album::default()
    };
    album.fact("vertices", mesh.vertices.len().to_string());
    album.fact("triangles", mesh.triangles.len().to_string());
    for (name, yaw_deg) in [("front", 0.0f32), ("half", -40.0), ("side", -90.0)] {
        album
            .pictures
            .push((name.into(), mesh.draw(yaw_deg.to_radians())));
    }
    Ok(album)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_square_is_drawn_and_a_broken_face_is_refused() {
        let square = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1/1 2/2 3/3 4/4\n";
        let album = inspect(Path::new("s.obj"), square).unwrap();
        let front = &album.pictures[0].1;
        assert_eq!(front.get_pixel(SIZE / 2 + 3, SIZE / 2 - 5).0[0], 235);
        assert_eq!(front.get_pixel(2, 2).0, [255; 3]);
        for broken in [
            "v 0 0 nan\n",
            "v 0 0 0\nf 1 1 9\n",
            "v 0 0 0\nf 1 1\n",
            "hello\n",
        ] {
            assert!(inspect(Path::new("s.obj"), broken).is_err(), "{broken}");
        }
    }
}
