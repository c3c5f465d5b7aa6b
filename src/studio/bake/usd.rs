//! A head with its shapes as USD in text (`.usda`), blend shapes by the UsdSkel schemas.
//!
//! Specification: OpenUSD's file format "usda" 1.0, and the schemas UsdGeom (Mesh, `GeomSubset`), UsdSkel (`SkelRoot`, Skeleton,
//! `BlendShape`, `SkelAnimation`) and UsdShade (`UsdPreviewSurface`), <https://openusd.org/release/api/>.
//!
//! ```text
//! /head            SkelRoot
//!   skeleton       one joint, "head", in the middle of the mesh, that carries all of it
//!   weights        SkelAnimation: every shape by its name, at 0
//!   face           Mesh; beneath it a BlendShape per shape, and a GeomSubset per material where there are several
//!   materials      UsdPreviewSurface
//! ```
//!
//! Positions are the head's own, in its unit and y up; `metersPerUnit` says what that is. Faces keep their polygons. Offsets are
//! in single precision, of the points that move only, unless `dense` is asked for. Names are those of the glTF targets; a
//! prim's name must be an identifier, so other characters become `_` there, a digit in front gets `_` before it, and a name
//! already taken a number behind it, while `skel:blendShapes` keeps the name as it is.
//!
//! Normals and texture coordinates are written if the mesh has them. Normals turn with the shapes where a vertex has one;
//! with several (hard edges) they stay as they are, for UsdSkel has no such offsets.
//!
//! Materials have the head's colours and pictures, the pictures as files beside this one; colours of vertices, times the
//! material's, are `displayColor` of the corners, and shown where there is no picture. Limits: skeletons and animations stay
//! behind.

use std::collections::{HashMap, HashSet};
use std::fmt::{Display, Write as _};

use rayon::prelude::*;

use super::glb::extent;
use super::looks::{Beside, Look, Looks, plain};
use super::mesh::{Mesh, Vec3, extent_of};
use super::morphs::{COLOUR, ROUGHNESS, single, turned};
use super::shape::Shape;

/// A number as USD reads it: the shortest that gives the same value again.
fn number(value: &f32) -> String {
    match *value == 0.0 {
        true => "0".into(),
        // Debug has exponents, so that what is nearly nothing is not a hundred digits.
        false => format!("{value:?}"),
    }
}

/// An array.
fn array<T>(values: impl IntoIterator<Item = T>, one: impl Fn(T) -> String) -> String {
    let values: Vec<String> = values.into_iter().map(one).collect();
    format!("[{}]", values.join(", "))
}

/// An array of tuples.
fn tuples<const N: usize>(rows: impl IntoIterator<Item = [f32; N]>) -> String {
    array(rows, |row| {
        format!("({})", row.each_ref().map(number).join(", "))
    })
}

/// An array of whole numbers.
fn whole(values: impl IntoIterator<Item = usize>) -> String {
    array(values, |value| value.to_string())
}

/// A string in quotes.
fn quoted(text: &str) -> String {
    let text = text.replace('\\', "\\\\").replace('"', "\\\"");
    format!("\"{}\"", text.replace(char::is_control, " "))
}

/// The name of the prim for `name`: the same if it is an identifier that none of its `siblings` has yet.
fn prim(siblings: &mut HashSet<String>, name: &str) -> String {
    let mut valid: String = name.chars().map(plain).collect();
    if !valid.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_') {
        valid.insert(0, '_');
    }
    let mut free = valid.clone();
    let mut k = 2;
    while !siblings.insert(free.clone()) {
        free = format!("{valid}_{k}");
        k += 1;
    }
    free
}

/// A matrix that moves by `v`, in USD's order of rows.
fn moved_by(v: &Vec3) -> String {
    let [x, y, z] = [v.x, v.y, v.z];
    format!("( (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), ({x:?}, {y:?}, {z:?}, 1) )")
}

/// One for every vertex.
const PER_VERTEX: &str = "vertex";

/// The normals that the file gave: one a vertex, which turn with the shapes, or one a corner.
fn normals(mesh: &Mesh, smooth: &[Vec3]) -> Option<(Vec<[f32; 3]>, &'static str)> {
    if mesh.normals.is_empty() {
        return None;
    }
    let normal = |c| single(&mesh.normal(c, smooth));
    let corners: Vec<[f32; 3]> = mesh.corners.iter().map(normal).collect();
    let mut vertices: Vec<[f32; 3]> = smooth.iter().map(single).collect();
    let mut first: HashMap<u32, [f32; 3]> = HashMap::new();
    for (corner, &n) in mesh.corners.iter().zip(&corners) {
        if *first.entry(corner.vertex).or_insert(n) != n {
            return Some((corners, "faceVarying"));
        }
        vertices[corner.vertex as usize] = n;
    }
    Some((vertices, PER_VERTEX))
}

/// A property of the mesh.
fn set(out: &mut String, name: &str, value: impl Display) {
    let _ = writeln!(out, "        {name} = {value}");
}

/// One with its interpolation.
fn attribute(out: &mut String, name: &str, value: &str, interpolation: &str) {
    let about = format!("(\n            interpolation = \"{interpolation}\"\n        )");
    set(out, name, format_args!("{value} {about}"));
}

/// The prim of one shape; with `smooth`, the neutral normals, also how they turn.
fn blend(mesh: &Mesh, shape: &Shape, prim: &str, smooth: Option<&[Vec3]>, dense: bool) -> String {
    let offsets: Vec<[f32; 3]> = shape.displacement.iter().map(single).collect();
    let bends = smooth.map(|smooth| turned(mesh, smooth, shape));
    let bent = |v: usize| bends.as_ref().is_some_and(|bends| bends[v] != [0.0; 3]);
    let listed = |&v: &usize| dense || offsets[v] != [0.0; 3] || bent(v);
    let rows: Vec<usize> = (0..offsets.len()).filter(listed).collect();
    let mut out = format!("\n        def BlendShape \"{prim}\"");
    let line = |(key, value): (&str, &Option<String>)| {
        let value = quoted(value.as_ref()?);
        Some(format!("                    string {key} = {value}\n"))
    };
    let known = [("unit", &shape.unit), ("upon", &shape.upon)];
    let known: String = known.into_iter().filter_map(line).collect();
    if !known.is_empty() {
        let _ = write!(
            out,
            r" (
            customData = {{
                dictionary mien = {{
{known}                }}
            }}
        )"
        );
    }
    out += "\n        {\n";
    let moved = tuples(rows.iter().map(|&v| offsets[v]));
    set(&mut out, "    uniform vector3f[] offsets", moved);
    if let Some(bends) = &bends {
        let bends = tuples(rows.iter().map(|&v| bends[v]));
        set(&mut out, "    uniform vector3f[] normalOffsets", bends);
    }
    if !dense {
        set(&mut out, "    uniform int[] pointIndices", whole(rows));
    }
    out + "        }\n"
}

/// A material that some faces have.
struct Used {
    prim: String,
    /// Linear red, green and blue.
    colour: [f64; 3],
    opacity: f64,
    /// File beside this one.
    picture: Option<String>,
    faces: Vec<usize>,
}

fn used(mesh: &Mesh, looks: &Looks, pictures: &Beside<'_>) -> Vec<Used> {
    let mut names = HashSet::new();
    let mut faces: Vec<Vec<usize>> = vec![Vec::new(); mesh.materials.len()];
    for (f, &material) in mesh.face_material.iter().enumerate() {
        faces[material as usize].push(f);
    }
    let of = mesh.materials.iter().zip(faces);
    of.filter(|(_, faces)| !faces.is_empty())
        .map(|(name, faces)| {
            let picture = pictures.get(name).map(|(file, _)| file.clone());
            let (colour, opacity) = looks.0.get(name).map_or((None, 1.0), Look::surface);
            let [r, g, b, _] = COLOUR;
            let plain = picture.as_ref().map_or([r, g, b], |_| [1.0; 3]);
            Used {
                prim: prim(&mut names, name),
                colour: colour.unwrap_or(plain),
                opacity,
                picture,
                faces,
            }
        })
        .collect()
}

/// Colours of the vertices if the mesh has them, else of the faces: what a viewer without materials shows.
fn colours(out: &mut String, mesh: &Mesh, used: &[Used]) {
    const NAME: &str = "color3f[] primvars:displayColor";
    let of = |used: &Used| used.colour.map(|c| c as f32);
    let mut material = vec![0; mesh.faces()];
    for (k, used) in used.iter().enumerate() {
        used.faces.iter().for_each(|&f| material[f] = k);
    }
    if mesh.tints.is_empty() {
        attribute(out, NAME, &tuples(used.iter().map(of)), "uniform");
        set(out, "int[] primvars:displayColor:indices", whole(material));
        return;
    }
    // Vertices where two materials meet have a colour of each.
    let (mut tints, mut corners, mut known) = (Vec::new(), Vec::new(), HashMap::new());
    for (f, &k) in material.iter().enumerate() {
        let colour = of(&used[k]);
        for v in mesh.face(f).iter().map(|c| c.vertex as usize) {
            corners.push(*known.entry((v, k)).or_insert_with(|| {
                tints.push([0, 1, 2].map(|c| mesh.tints[v][c] * colour[c]));
                tints.len() - 1
            }));
        }
    }
    attribute(out, NAME, &tuples(tints), "faceVarying");
    set(out, "int[] primvars:displayColor:indices", whole(corners));
}

/// The geometry of the neutral head.
fn geometry(out: &mut String, mesh: &Mesh, normals: Option<&(Vec<[f32; 3]>, &str)>) {
    let points: Vec<[f32; 3]> = mesh.positions.iter().map(single).collect();
    // An artist's polygons as they are: no surface is fitted through them.
    set(out, "uniform token subdivisionScheme", "\"none\"");
    set(out, "float3[] extent", tuples(extent(&points)));
    let counts = (0..mesh.faces()).map(|f| mesh.face(f).len());
    set(out, "int[] faceVertexCounts", whole(counts));
    let corners = mesh.corners.iter().map(|corner| corner.vertex as usize);
    set(out, "int[] faceVertexIndices", whole(corners));
    set(out, "point3f[] points", tuples(points));
    if let Some((rows, interpolation)) = normals {
        let rows = tuples(rows.iter().copied());
        attribute(out, "normal3f[] normals", &rows, interpolation);
    }
    if !mesh.uv.is_empty() {
        // Corners without one take a point of their own, at the end.
        let none = mesh.uv.len();
        let nowhere = mesh.corners.iter().any(|corner| corner.uv.is_none());
        let rows = tuples(mesh.uv.iter().copied().chain(nowhere.then_some([0.0; 2])));
        attribute(out, "texCoord2f[] primvars:st", &rows, "faceVarying");
        let at = mesh.corners.iter().map(|c| c.uv);
        let at = at.map(|uv| uv.map_or(none, |k| k as usize));
        set(out, "int[] primvars:st:indices", whole(at));
    }
}

/// What binds the mesh to its skeleton and names its shapes; `prims` are their prims.
fn binding(out: &mut String, names: &str, prims: &[String]) {
    const RIGID: &str =
        "(\n            elementSize = 1\n            interpolation = \"constant\"\n        )";
    let (joint, share) = (format!("[0] {RIGID}"), format!("[1] {RIGID}"));
    set(out, "int[] primvars:skel:jointIndices", joint);
    set(out, "float[] primvars:skel:jointWeights", share);
    let at = moved_by(&Vec3::zeros());
    set(out, "matrix4d primvars:skel:geomBindTransform", at);
    set(out, "uniform token[] skel:blendShapes", names);
    let targets = array(prims, |prim| format!("</head/face/{prim}>"));
    set(out, "rel skel:blendShapeTargets", targets);
    set(out, "rel skel:skeleton", "</head/skeleton>");
}

/// Which faces have which material, if there are several.
fn subsets(out: &mut String, used: &[Used], siblings: &mut HashSet<String>) {
    if used.len() < 2 {
        return;
    }
    for used in used {
        let (name, faces) = (
            prim(siblings, &used.prim),
            whole(used.faces.iter().copied()),
        );
        let material = &used.prim;
        let _ = write!(
            out,
            r#"
        def GeomSubset "{name}" (
            prepend apiSchemas = ["MaterialBindingAPI"]
        )
        {{
            uniform token elementType = "face"
            uniform token familyName = "materialBind"
            int[] indices = {faces}
            rel material:binding = </head/materials/{material}>
        }}
"#
        );
    }
}

/// What a surface's colour is read from, if it is not one number: a picture at the texture coordinates, or the vertices.
fn shaders(used: &Used, path: &str, tinted: bool) -> String {
    let [r, g, b] = used.colour;
    let (kind, reader, name) = match &used.picture {
        Some(_) => ("float2", "place", "st"),
        None if tinted => ("float3", "vertices", "displayColor"),
        None => return String::new(),
    };
    let picture = used.picture.as_ref().map(|file| {
        format!(
            r#"
            def Shader "picture"
            {{
                uniform token info:id = "UsdUVTexture"
                asset inputs:file = @./{file}@
                float4 inputs:scale = ({r}, {g}, {b}, 1)
                token inputs:sourceColorSpace = "sRGB"
                float2 inputs:st.connect = {path}/place.outputs:result>
                token inputs:wrapS = "repeat"
                token inputs:wrapT = "repeat"
                float3 outputs:rgb
            }}
"#
        )
    });
    format!(
        r#"
            def Shader "{reader}"
            {{
                uniform token info:id = "UsdPrimvarReader_{kind}"
                string inputs:varname = "{name}"
                {kind} outputs:result
            }}
{}"#,
        picture.unwrap_or_default()
    )
}

fn material(used: &Used, tinted: bool) -> String {
    let Used { prim, opacity, .. } = used;
    let [r, g, b] = used.colour;
    let path = format!("</head/materials/{prim}");
    let colour = match &used.picture {
        Some(_) => format!(".connect = {path}/picture.outputs:rgb>"),
        None if tinted => format!(".connect = {path}/vertices.outputs:result>"),
        None => format!(" = ({r}, {g}, {b})"),
    };
    format!(
        r#"        def Material "{prim}"
        {{
            token outputs:surface.connect = {path}/surface.outputs:surface>

            def Shader "surface"
            {{
                uniform token info:id = "UsdPreviewSurface"
                color3f inputs:diffuseColor{colour}
                float inputs:metallic = 0
                float inputs:opacity = {opacity}
                float inputs:roughness = {ROUGHNESS}
                token outputs:surface
            }}
{}        }}
"#,
        shaders(used, &path, tinted)
    )
}

/// Metadata of the layer, the skeleton, the weights, and the beginning of the mesh.
fn skeleton(mesh: &Mesh, metres: f64, names: &str, shapes: usize) -> String {
    let (low, high) = extent_of(&mesh.positions);
    let middle = moved_by(&((low + high) / 2.0));
    let (version, rest) = (env!("CARGO_PKG_VERSION"), whole(vec![0; shapes]));
    format!(
        r#"#usda 1.0
(
    defaultPrim = "head"
    doc = "mien-studio {version}"
    metersPerUnit = {metres:?}
    upAxis = "Y"
)

def SkelRoot "head" (
    kind = "component"
)
{{
    def Skeleton "skeleton" (
        prepend apiSchemas = ["SkelBindingAPI"]
    )
    {{
        uniform matrix4d[] bindTransforms = [{middle}]
        uniform token[] joints = ["head"]
        uniform matrix4d[] restTransforms = [{middle}]
        rel skel:animationSource = </head/weights>
    }}

    def SkelAnimation "weights"
    {{
        uniform token[] blendShapes = {names}
        float[] blendShapeWeights = {rest}
    }}

    def Mesh "face" (
        prepend apiSchemas = ["SkelBindingAPI", "MaterialBindingAPI"]
    )
    {{
"#
    )
}

/// The text of the file: the neutral mesh, of `metres` per unit, and the shapes as blend shapes.
pub(super) fn emit(
    mesh: &Mesh,
    looks: &Looks,
    pictures: &Beside<'_>,
    shapes: &[Shape],
    metres: f64,
    dense: bool,
) -> String {
    let mut siblings = HashSet::new();
    let prims = shapes.iter().map(|s| prim(&mut siblings, &s.name));
    let prims: Vec<String> = prims.collect();
    let names = array(shapes, |s| quoted(&s.name));
    let smooth = mesh.vertex_normals(&mesh.positions);
    let normals = normals(mesh, &smooth);
    let used = used(mesh, looks, pictures);

    let mut out = skeleton(mesh, metres, &names, shapes.len());
    geometry(&mut out, mesh, normals.as_ref());
    colours(&mut out, mesh, &used);
    // Of the whole mesh here, not of a material.
    if mesh.sheets().contains(&true) {
        set(&mut out, "uniform bool doubleSided", 1);
    }
    // Which material a face has: the mesh's one, or that of the subset it is in.
    if let [one] = &used[..] {
        let material = format!("</head/materials/{}>", one.prim);
        set(&mut out, "rel material:binding", material);
    } else {
        let family = "uniform token subsetFamily:materialBind:familyType";
        set(&mut out, family, "\"partition\"");
    }
    binding(&mut out, &names, &prims);
    let turning = normals.filter(|(_, interpolation)| *interpolation == PER_VERTEX);
    let turning = turning.map(|_| &smooth[..]);
    let each = shapes.par_iter().zip(&prims);
    let written = each.map(|(shape, prim)| blend(mesh, shape, prim, turning, dense));
    // Each is freed once appended: holding all of them twice would be the peak of memory use.
    out.extend(written.collect::<Vec<String>>());
    subsets(&mut out, &used, &mut siblings);
    out.push_str("    }\n");
    out += "\n    def Scope \"materials\"\n    {\n";
    let tinted = !mesh.tints.is_empty();
    out.extend(used.iter().map(|used| material(used, tinted)));
    out + "    }\n}\n"
}

#[cfg(test)]
mod tests {
    use super::super::mesh::tests::sheet;
    use super::*;

    /// What stands between the brackets of an attribute after `from`, split into numbers.
    fn listed(text: &str, from: &str, name: &str) -> Vec<f64> {
        let after = text.split_once(from).expect(from).1;
        let after = after.split_once(&format!("{name} = [")).expect(name).1;
        let inside = after.split_once(']').unwrap().0;
        inside
            .split([',', '(', ')', ' '])
            .filter(|word| !word.is_empty())
            .map(|word| word.parse().expect("a number"))
            .collect()
    }

    fn shape(name: &str, unit: Option<&str>, displacement: Vec<Vec3>) -> Shape {
        Shape {
            name: name.into(),
            unit: unit.map(Into::into),
            upon: None,
            misses: None,
            area: vec![true; displacement.len()],
            displacement,
        }
    }

    fn shapes(n: usize) -> Vec<Shape> {
        let mut some = vec![Vec3::zeros(); n];
        some[3] = Vec3::new(0.1, -2.5e-9, 1.0);
        some[17] = Vec3::new(0.0, 1.0 / 3.0, 0.0);
        vec![
            shape("jawOpen", Some("AU26"), some),
            shape("none", None, vec![Vec3::zeros(); n]),
            shape("all", None, vec![Vec3::y(); n]),
        ]
    }

    #[test]
    fn numbers_come_back_bit_by_bit_and_only_points_that_move_are_listed() {
        let mesh = sheet(6, 0.1);
        let shapes = shapes(36);
        let text = emit(
            &mesh,
            &Looks::default(),
            &Beside::new(),
            &shapes,
            0.01,
            false,
        );
        assert!(text.starts_with("#usda 1.0\n(\n"));
        assert!(text.contains("\n    metersPerUnit = 0.01\n    upAxis = \"Y\"\n"));
        let points = listed(&text, "def Mesh", "points");
        let single = |v: &Vec3| [v.x as f32, v.y as f32, v.z as f32];
        let true_points: Vec<f32> = mesh.positions.iter().flat_map(single).collect();
        let points: Vec<f32> = points.iter().map(|&v| v as f32).collect();
        assert_eq!(points, true_points);
        assert_eq!(listed(&text, "def Mesh", "faceVertexCounts"), [4.0; 25]);
        let corners = listed(&text, "def Mesh", "faceVertexIndices");
        assert!(
            corners
                .iter()
                .zip(&mesh.corners)
                .all(|(v, c)| *v == f64::from(c.vertex))
        );
        assert_eq!((corners.len(), mesh.corners.len()), (100, 100));

        let jaw = |name| listed(&text, "BlendShape \"jawOpen\"", name);
        assert_eq!(jaw("pointIndices"), [3.0, 17.0]);
        let offsets: Vec<f32> = jaw("offsets").iter().map(|&v| v as f32).collect();
        assert_eq!(offsets, [0.1, -2.5e-9, 1.0, 0.0, 1.0 / 3.0, 0.0]);
        assert!(text.contains("string unit = \"AU26\""));
        assert!(listed(&text, "BlendShape \"none\"", "offsets").is_empty());
        assert!(listed(&text, "BlendShape \"none\"", "pointIndices").is_empty());
        assert_eq!(
            listed(&text, "BlendShape \"all\"", "pointIndices").len(),
            36
        );
        assert_eq!(
            listed(&text, "SkelAnimation", "blendShapeWeights"),
            [0.0; 3]
        );
        for at in ["\n        uniform token[] blendShapes", "skel:blendShapes"] {
            let line = format!("{at} = [\"jawOpen\", \"none\", \"all\"]\n");
            assert!(text.contains(&line), "{line}");
        }

        let dense = emit(
            &mesh,
            &Looks::default(),
            &Beside::new(),
            &shapes,
            0.01,
            true,
        );
        assert!(!dense.contains("pointIndices"));
        let full = listed(&dense, "BlendShape \"jawOpen\"", "offsets");
        assert_eq!((full.len(), full[9] as f32, full[12]), (108, 0.1, 0.0));
    }

    #[test]
    fn a_name_that_is_no_identifier_is_changed_for_the_prim_only() {
        let names = ["jaw open", "jaw_open", "2nd", "höher", "say \"a\\\"", ""];
        let all: Vec<Shape> = names
            .iter()
            .map(|n| shape(n, None, vec![Vec3::y(); 16]))
            .collect();
        let text = emit(
            &sheet(4, 0.1),
            &Looks::default(),
            &Beside::new(),
            &all,
            1.0,
            false,
        );
        assert!(text.contains(
            r#"skel:blendShapes = ["jaw open", "jaw_open", "2nd", "höher", "say \"a\\\"", ""]"#
        ));
        let prims: Vec<&str> = text
            .split("def BlendShape \"")
            .skip(1)
            .map(|after| after.split_once('"').unwrap().0)
            .collect();
        assert_eq!(
            prims,
            ["jaw_open", "jaw_open_2", "_2nd", "h_her", "say__a__", "_"]
        );
        assert!(text.contains(
            "skel:blendShapeTargets = [</head/face/jaw_open>, </head/face/jaw_open_2>, "
        ));
    }

    #[test]
    fn normals_turn_where_a_vertex_has_one_and_every_face_has_its_material() {
        let mut mesh = sheet(4, 0.1);
        mesh.normals = vec![[0.0, 0.0, 2.0], [1.0, 0.0, 0.0]];
        for corner in &mut mesh.corners {
            corner.normal = Some(0);
        }
        mesh.uv = vec![[0.25, 0.75]];
        mesh.corners[0].uv = Some(0);
        mesh.materials = vec!["skin".into(), "nobody".into(), "eye white".into()];
        mesh.face_material[8] = 2;
        let mut up = vec![Vec3::zeros(); 16];
        up[5] = Vec3::new(0.0, 0.0, 0.1);
        let shapes = [shape("up", None, up)];
        let text = emit(
            &mesh,
            &Looks::default(),
            &Beside::new(),
            &shapes,
            1.0,
            false,
        );
        assert_eq!(listed(&text, "def Mesh", "normals")[..3], [0.0, 0.0, 1.0]);
        assert!(text.contains("interpolation = \"vertex\""));
        let rows = listed(&text, "BlendShape \"up\"", "pointIndices");
        let bends = listed(&text, "BlendShape \"up\"", "normalOffsets");
        assert!(
            rows.len() > 1 && rows.contains(&5.0),
            "its neighbours turn too: {rows:?}"
        );
        assert_eq!(bends.len(), 3 * rows.len());
        assert!(bends.iter().any(|d| d.abs() > 0.1));

        assert_eq!(
            listed(&text, "def Mesh", "primvars:st"),
            [0.25, 0.75, 0.0, 0.0]
        );
        let at = listed(&text, "def Mesh", "primvars:st:indices");
        assert_eq!((at[0], at.iter().sum::<f64>()), (0.0, 35.0));
        let faces = |name: &str| listed(&text, &format!("GeomSubset \"{name}\""), "indices");
        assert_eq!(faces("eye_white"), [8.0]);
        assert_eq!(faces("skin").len(), 8);
        assert!(text.contains("rel material:binding = </head/materials/eye_white>"));
        assert!(!text.contains("nobody"));

        // Of a vertex that another face has too.
        mesh.corners[1].normal = Some(1);
        let hard = emit(
            &mesh,
            &Looks::default(),
            &Beside::new(),
            &shapes,
            1.0,
            false,
        );
        assert_eq!(listed(&hard, "def Mesh", "normals").len(), 3 * 36);
        assert!(!hard.contains("normalOffsets"));
    }
}
