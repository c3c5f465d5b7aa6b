//! Wavefront OBJ in and out. Faces keep their size (quads stay quads), vertices their order and number.
//!
//! Output repeats the input line by line and replaces only the numbers of `v` lines, so that groups, materials,
//! texture coordinates and faces stay as written. Normals (`vn`) are kept for the neutral and dropped from shapes,
//! where they would be wrong: programs recompute them.
//!
//! Limits: polygonal faces only; curves and surfaces are kept but not deformed.

use std::borrow::Cow;
use std::fmt::Write as _;

use super::mesh::{Corner, Mesh, Vec3};
use mien_workbench::fault::Fault;
use mien_workbench::srgb::{coded, linear};

/// Most corners of a face.
const MAX_CORNERS: usize = 1024;
/// Most materials: each becomes a primitive with all shapes in glTF.
const MAX_MATERIALS: usize = 1024;

/// Numbers that single precision can represent, as output uses it.
fn numbers<const N: usize>(words: &mut std::str::SplitAsciiWhitespace<'_>) -> Option<[f64; N]> {
    let mut out = [0.0; N];
    for value in &mut out {
        let number: f64 = words.next()?.parse().ok()?;
        *value = Some(number).filter(|v| (*v as f32).is_finite())?;
    }
    Some(out)
}

/// Resolves an OBJ index: from 1, or negative and counted from the end.
fn index(word: &str, len: usize) -> Option<u32> {
    let k: i64 = word.parse().ok()?;
    let k = if k < 0 { len as i64 + k } else { k - 1 };
    (0..len as i64).contains(&k).then_some(k as u32)
}

fn corner(word: &str, mesh: &Mesh) -> Option<Corner> {
    let mut parts = word.split('/');
    let vertex = index(parts.next()?, mesh.positions.len())?;
    let mut optional = |len: usize| match parts.next() {
        None | Some("") => Some(None),
        Some(word) => index(word, len).map(Some),
    };
    Some(Corner {
        vertex,
        uv: optional(mesh.uv.len())?,
        normal: optional(mesh.normals.len())?,
    })
}

/// Logical lines, joined where one ends in a backslash, with the number of their first physical line.
fn lines(text: &str) -> impl Iterator<Item = (Cow<'_, str>, usize)> {
    // Without byte order marks, even two: one left over would hide the first line from some readers.
    let mut lines = text.trim_start_matches('\u{feff}').lines().zip(1..);
    std::iter::from_fn(move || {
        let (first, number) = lines.next()?;
        let mut whole = Cow::Borrowed(first);
        while let Some(begun) = whole.trim_end().strip_suffix('\\') {
            let next = lines.next().map_or("", |(next, _)| next);
            whole = Cow::Owned(format!("{begun} {next}"));
        }
        Some((whole, number))
    })
}

/// The words of a line up to a comment.
fn words(line: &str) -> std::str::SplitAsciiWhitespace<'_> {
    let said = line.split_once('#').map_or(line, |(said, _)| said);
    said.split_ascii_whitespace()
}

/// Reads the text of an OBJ file.
///
/// # Errors
/// If a vertex or face line is malformed or names something that is not there, with its line number.
pub fn parse(text: &str) -> Result<Mesh, Fault> {
    let (mut mesh, mut material) = (Mesh::default(), 0);
    for (text, line) in lines(text) {
        add_line(&mut mesh, &mut material, &text).map_err(|expected| {
            let found: String = text.chars().take(80).collect();
            Fault::new(format!("line {line}: expected {expected}, found {found:?}"))
        })?;
    }
    let (vertices, faces) = (mesh.positions.len(), mesh.faces());
    if vertices == 0 || faces == 0 {
        return Err(Fault::new(format!(
            "expected a mesh with v and f lines, found {vertices} vertices and {faces} faces"
        )));
    }
    if mesh.tints.len() != vertices {
        mesh.tints.clear();
    }
    Ok(mesh)
}

/// Parses a line into the mesh, or returns what the line should hold. `material` is the current one.
fn add_line(mesh: &mut Mesh, material: &mut u32, line: &str) -> Result<(), &'static str> {
    let mut words = words(line);
    match words.next() {
        Some("v") => {
            let v = numbers::<3>(&mut words).ok_or("v and three numbers")?;
            mesh.positions.push(Vec3::from(v));
            // Many programs append an sRGB colour to the position.
            let tint = numbers::<3>(&mut words);
            if let Some(tint) = tint.filter(|t| t.iter().all(|c| (0.0..=1.0).contains(c))) {
                mesh.tints.push(tint.map(|c| linear(c) as f32));
            }
        }
        Some("vt") => {
            let v = numbers::<2>(&mut words).ok_or("vt and two numbers")?;
            mesh.uv.push(v.map(|x| x as f32));
        }
        Some("vn") => {
            let v = numbers::<3>(&mut words).ok_or("vn and three numbers")?;
            mesh.normals.push(v.map(|x| x as f32));
        }
        Some("usemtl") => {
            // Names may contain blanks and #.
            let name = line.trim().strip_prefix("usemtl").unwrap_or("").trim();
            let name = if name.is_empty() { "default" } else { name };
            let known = mesh.materials.iter().position(|m| m == name);
            *material = known.unwrap_or(mesh.materials.len()) as u32;
            if known.is_none() {
                mesh.materials.push(name.into());
            }
            if mesh.materials.len() > MAX_MATERIALS {
                return Err("at most 1024 materials");
            }
        }
        Some("f") => {
            const CORNER: &str =
                "f and at least three corners v, v/vt or v/vt/vn that exist above this line";
            let corners = words.take(MAX_CORNERS + 1).map(|word| corner(word, mesh));
            let face: Vec<Corner> = corners.collect::<Option<_>>().ok_or(CORNER)?;
            match face.len() {
                0..3 => return Err(CORNER),
                3..=MAX_CORNERS => {}
                _ => return Err("at most 1024 corners"),
            }
            if mesh.materials.is_empty() {
                mesh.materials.push("default".into());
            }
            mesh.push_face(&face, *material);
        }
        _ => {}
    }
    Ok(())
}

/// The source text with other positions, in the source's unit, and without normals.
pub fn with_positions(source: &str, positions: &[Vec3]) -> String {
    let mut out = String::with_capacity(source.len() + positions.len() * 8);
    let mut next = positions.iter();
    for (line, _) in lines(source) {
        let mut words = words(&line);
        match words.next() {
            Some("v") => {
                let Some(p) = next.next() else { continue };
                let _ = write!(out, "v {} {} {}", p.x as f32, p.y as f32, p.z as f32);
                // Weights or colours after the position are kept.
                for word in words.skip(3) {
                    let _ = write!(out, " {word}");
                }
            }
            Some("vn") => continue,
            Some("f") => {
                out.push('f');
                for word in words {
                    let mut parts = word.split('/');
                    let _ = write!(out, " {}", parts.next().unwrap_or_default());
                    if let Some(uv) = parts.next().filter(|uv| !uv.is_empty()) {
                        let _ = write!(out, "/{uv}");
                    }
                }
            }
            _ => out.push_str(&line),
        }
        out.push('\n');
    }
    out
}

/// A mesh from another format as OBJ text: positions, texture coordinates, faces, materials.
pub fn emit(mesh: &Mesh) -> String {
    let mut out = String::new();
    for p in &mesh.positions {
        let _ = writeln!(out, "v {} {} {}", p.x as f32, p.y as f32, p.z as f32);
    }
    for t in &mesh.uv {
        let _ = writeln!(out, "vt {} {}", t[0], t[1]);
    }
    faces(&mut out, mesh, 0, number);
    out
}

/// The text of a corner in an `f` line.
fn number(corner: &Corner) -> String {
    match corner.uv {
        Some(uv) => format!("{}/{}", corner.vertex + 1, uv + 1),
        None => (corner.vertex + 1).to_string(),
    }
}

/// The text of a cut mesh: `source`, the text of `before`, without faces that are not `kept`, then the new vertices,
/// texture coordinates and faces of `mesh`.
pub(super) fn cut(source: &str, before: &Mesh, mesh: &Mesh, kept: &[bool]) -> String {
    let mut out = String::with_capacity(source.len());
    let mut stays = kept.iter();
    for (line, _) in lines(source) {
        if words(&line).next() != Some("f") || stays.next() == Some(&true) {
            let _ = writeln!(out, "{line}");
        }
    }
    for (v, p) in mesh
        .positions
        .iter()
        .enumerate()
        .skip(before.positions.len())
    {
        let _ = write!(out, "v {} {} {}", p.x as f32, p.y as f32, p.z as f32);
        for c in mesh.tints.get(v).into_iter().flatten() {
            let _ = write!(out, " {:.4}", coded(f64::from(*c)));
        }
        out.push('\n');
    }
    for t in mesh.uv.iter().skip(before.uv.len()) {
        let _ = writeln!(out, "vt {} {}", t[0], t[1]);
    }
    let kept = kept.iter().filter(|stays| **stays).count();
    faces(&mut out, mesh, kept, number);
    out
}

/// Appends faces from number `first` on with their materials; `number` formats a corner.
pub(crate) fn faces(
    out: &mut String,
    mesh: &Mesh,
    first: usize,
    number: impl Fn(&Corner) -> String,
) {
    let mut material = u32::MAX;
    for f in first..mesh.faces() {
        if mesh.face_material[f] != material {
            material = mesh.face_material[f];
            let _ = writeln!(out, "usemtl {}", mesh.materials[material as usize]);
        }
        out.push('f');
        for corner in mesh.face(f) {
            let _ = write!(out, " {}", number(corner));
        }
        out.push('\n');
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const QUAD: &str = "# head\no a\nv 0 0 0\nv 1 0 0 0.5 0.5 0.5\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvn 0 0 1\nusemtl skin\n\
                        f 1/1/1 2/2/1 3/2/1 4/1/1\nf -4 -3 -2\n";

    #[test]
    fn quads_texture_and_order_survive() {
        let mesh = parse(QUAD).unwrap();
        assert_eq!(
            (mesh.faces(), mesh.face(0).len(), mesh.face(1).len()),
            (2, 4, 3)
        );
        assert_eq!(mesh.face(1)[0].vertex, 0);
        let same = with_positions(QUAD, &mesh.positions);
        let bare = QUAD.replace("vn 0 0 1\n", "");
        assert_eq!(
            same,
            bare.replace("1/1/1 2/2/1 3/2/1 4/1/1", "1/1 2/2 3/2 4/1")
        );
        let moved: Vec<Vec3> = mesh.positions.iter().map(|p| p + Vec3::x()).collect();
        let text = with_positions(QUAD, &moved);
        assert!(text.contains("v 2 0 0 0.5 0.5 0.5") && text.contains("f 1/1 2/2 3/2 4/1"));
        assert!(!text.contains("vn"));
        assert_eq!(parse(&text).unwrap().positions, moved);
        assert_eq!(parse(&emit(&mesh)).unwrap().positions, mesh.positions);
    }

    #[test]
    fn bad_lines_are_named() {
        let wrong = |text: &str| parse(text).unwrap_err().to_string();
        assert!(wrong("v 0 0\n").starts_with("line 1: expected v and three numbers"));
        assert!(wrong("v 0 0 nan\n").starts_with("line 1"));
        // Could not be written again: 4e38 is beyond single precision.
        assert!(wrong("v 0 0 4e38\n").starts_with("line 1"));
        assert!(wrong("v 0 0 0\nvn 0 -4e38 0\n").starts_with("line 2"));
        assert!(wrong("v 0 0 0\nf 1 2 3\n").starts_with("line 2"));
        assert!(wrong("v 0 0 0\nf 1 1\n").starts_with("line 2"));
        assert!(wrong("v 0 0 0\n").contains("0 faces"));
    }

    #[test]
    fn byte_order_marks_and_carriage_returns_are_ignored() {
        let mesh = parse(QUAD).unwrap();
        let twice = format!("\u{feff}\u{feff}v 9 9 9\n{QUAD}");
        let of_twice = parse(&twice).unwrap().positions;
        assert_eq!((of_twice.len(), of_twice[0]), (5, Vec3::repeat(9.0)));
        let printed = with_positions(&twice, &of_twice);
        assert_eq!(parse(&printed).unwrap().positions, of_twice);
        let marked = format!(
            "\u{feff}{}",
            QUAD.replace('\n', "\r\n")
                .replacen("# head\r\no a\r\n", "", 1)
        );
        let same = parse(&marked).unwrap();
        assert_eq!(same.positions, mesh.positions);
        assert_eq!(same.corners, mesh.corners);
        assert_eq!(same.materials, mesh.materials);
        let moved = with_positions(&marked, &mesh.positions);
        assert_eq!(parse(&moved).unwrap().positions, mesh.positions);
    }

    #[test]
    fn blanks_in_names_comments_and_continued_lines_are_read_as_by_other_programs() {
        let text =
            "v 0 0 0\nv 1 0 0 # corner\nv 1 1 0\nusemtl my skin\nf 1 2 \\\n  3 # face\nf 1/ 2\n";
        let refused = parse(text).unwrap_err().to_string();
        assert!(refused.starts_with("line 7"), "{refused}");
        let text = text.replace("f 1/ 2\n", "");
        let mesh = parse(&text).unwrap();
        assert_eq!((mesh.faces(), &*mesh.materials[0]), (1, "my skin"));
        let moved = with_positions(&text, &mesh.positions);
        assert_eq!(parse(&moved).unwrap().corners, mesh.corners);
    }

    #[test]
    fn colours_after_positions_are_read_if_every_vertex_has_one() {
        let text = "v 0 0 0 1 0 0.5\nv 1 0 0 0 0 0\nv 1 1 0 1 1 1\nf 1 2 3\n";
        let tints = parse(text).unwrap().tints;
        assert_eq!(
            (tints.len(), tints[0][0], tints[1], tints[2]),
            (3, 1.0, [0.0; 3], [1.0; 3])
        );
        assert!((tints[0][2] - 0.2140).abs() < 1e-4, "{:?}", tints[0]);
        for other in ["v 1 1 0", "v 1 1 0 0.5", "v 1 1 0 1 2 1"] {
            let text = text.replace("v 1 1 0 1 1 1", other);
            assert!(parse(&text).unwrap().tints.is_empty(), "{other}");
        }
    }

    #[test]
    fn faces_and_materials_beyond_any_head_are_refused() {
        let corners = "v 0 0 0\nv 1 0 0\nv 1 1 0\nf";
        let face = |n: usize| format!("{corners}{}\n", " 1 2 3".repeat(n / 3));
        assert_eq!(parse(&face(999)).unwrap().faces(), 1);
        let refused = |text: &str| match parse(text) {
            Ok(_) => panic!("read"),
            Err(problem) => problem.to_string(),
        };
        let many = refused(&face(3 * 700_000));
        assert!(
            many.contains("at most 1024 corners") && many.len() < 200,
            "{many}"
        );
        let materials: String = (0..60_000)
            .map(|k| format!("usemtl m{k}\nf 1 2 3\n"))
            .collect();
        let text = format!("v 0 0 0\nv 1 0 0\nv 1 1 0\n{materials}");
        let many = refused(&text);
        assert!(many.contains("at most 1024 materials"), "{many}");
    }
}
