//! Colours of a head from the material files (MTL) of an OBJ or the materials of a glTF, for output as glTF materials
//! and for rendering.
//!
//! Of MTL, `newmtl`, `Kd`, `d`, `Tr` and `map_Kd` with a PNG or JPEG are read; images are copied unchanged, and
//! paths are relative to the file that names them. Colours are sRGB there and linear in glTF. Missing or damaged
//! entries leave the material as it would be without.

use std::collections::HashMap;
use std::path::Path;

use image::RgbaImage;
use serde_json::{Value, json};

use super::glb::{Glb, list, push};
use super::mesh::{Corner, Mesh};
use mien_stages::base::bounded_read;
use mien_workbench::srgb::linear;
use mien_workbench::text_files;

/// A material.
#[derive(Clone, Debug, Default, PartialEq)]
struct Look {
    /// Linear red, green and blue.
    colour: Option<[f64; 3]>,
    opacity: Option<f64>,
    /// Bytes of an image in a format that glTF allows.
    picture: Option<Vec<u8>>,
    /// Whether transparent pixels are holes in the surface.
    cut: bool,
}

/// Materials by name.
#[derive(Debug, Default, PartialEq)]
pub struct Looks(HashMap<String, Look>);

/// Three numbers from 0 to 1.
fn colour(words: &str) -> Option<[f64; 3]> {
    let numbers = words.split_ascii_whitespace().map(share);
    let numbers: Vec<f64> = numbers.collect::<Option<_>>()?;
    Some(<[f64; 3]>::try_from(numbers).ok()?.map(linear))
}

/// A number from 0 to 1.
fn share(word: &str) -> Option<f64> {
    word.parse()
        .ok()
        .filter(|value| (0.0..=1.0).contains(value))
}

/// The rest of a line that starts with a word.
fn after<'a>(line: &'a str, word: &str) -> Option<&'a str> {
    let rest = line.trim().strip_prefix(word)?;
    rest.starts_with([' ', '\t']).then(|| rest.trim())
}

/// The image name after the options of a map: words that begin with a minus, each followed by numbers, `on` or `off`.
fn without_options(words: &str) -> &str {
    let mut rest = words;
    while rest.starts_with('-') {
        let option = |word: &str| word.parse::<f64>().is_ok() || word == "on" || word == "off";
        let next = |rest: &str| rest.find([' ', '\t']).unwrap_or(rest.len());
        // A channel is a single letter.
        let letter = rest.starts_with("-imfchan");
        rest = rest[next(rest)..].trim_start();
        while !rest.is_empty() && (option(&rest[..next(rest)]) || letter && next(rest) == 1) {
            rest = rest[next(rest)..].trim_start();
        }
    }
    rest
}

impl Looks {
    /// Reads the materials of an OBJ file from its text.
    pub(super) fn from_obj(path: &Path, obj: &str) -> Self {
        let mut looks = Self::default();
        let folder = path.parent().unwrap_or(Path::new(""));
        for name in obj.lines().filter_map(|line| after(line, "mtllib")) {
            let name = name.replace('\\', "/");
            if let Ok(bytes) = bounded_read::read_below(folder, &name, text_files::MAX_BYTES) {
                // Images are named relative to the library, in the folder of the mesh or below.
                let beside = folder.join(name);
                let beside = beside.parent().unwrap_or(folder);
                looks.add(&text_files::decoded(&bytes), beside);
            }
        }
        looks
    }

    /// Adds the materials of an MTL in this folder.
    pub fn add(&mut self, mtl: &str, folder: &Path) {
        let mut name = None;
        for line in mtl.lines() {
            if let Some(new) = after(line, "newmtl") {
                name = Some(new);
                continue;
            }
            let Some(name) = name else { continue };
            let look = self.0.entry(name.to_owned()).or_default();
            if let Some(words) = after(line, "Kd") {
                look.colour = colour(words);
            } else if let Some(opacity) = after(line, "d").and_then(share) {
                look.opacity = Some(opacity);
            } else if let Some(clear) = after(line, "Tr").and_then(share) {
                look.opacity = Some(1.0 - clear);
            } else if let Some(picture) = after(line, "map_Kd") {
                let picture = without_options(picture).replace('\\', "/");
                // Falls back to the bare name: the path may be of another machine.
                let mut names = [&*picture, picture.rsplit('/').next().unwrap_or("")].into_iter();
                let read =
                    |name| bounded_read::read_below(folder, name, text_files::MAX_BYTES).ok();
                let bytes = names.find_map(read);
                look.picture = bytes.filter(|bytes| kind(bytes).is_some());
            }
        }
    }

    /// Reads the materials of a glTF.
    pub(super) fn from_glb(glb: &Glb) -> Self {
        let look = |material: &Value| {
            let surface = &material["pbrMetallicRoughness"];
            let factor: Option<[f64; 4]> =
                serde_json::from_value(surface["baseColorFactor"].clone()).ok();
            let texture = glb.list_entry("textures", &surface["baseColorTexture"]["index"]);
            let image = glb.list_entry("images", &texture["source"]);
            let view = glb.list_entry("bufferViews", &image["bufferView"]);
            let length = view["byteLength"].as_u64().unwrap_or(0) as usize;
            let picture = glb.data(&image["bufferView"], &Value::Null, length);
            let mode = material["alphaMode"].as_str();
            let cut = mode.is_some_and(|mode| mode != "OPAQUE");
            let picture = picture.filter(|bytes| kind(bytes).is_some());
            Look {
                colour: factor.map(|[r, g, b, _]| [r, g, b]),
                opacity: factor.filter(|_| cut).map(|factor| factor[3]),
                picture: picture.map(<[u8]>::to_vec),
                cut,
            }
        };
        let looks = list(&glb.json["materials"]).iter().map(look);
        Self(material_names(&glb.json).into_iter().zip(looks).collect())
    }

    /// Whether no colour is known.
    pub fn is_empty(&self) -> bool {
        let known = |look: &Look| look.colour.is_some() || look.picture.is_some();
        !self.0.values().any(known)
    }

    /// Sets colours and images of the materials with these names in a file.
    pub fn paint(&self, glb: &mut Glb) {
        let Some(mut materials) = glb.json.get_mut("materials").map(Value::take) else {
            return;
        };
        for material in materials.as_array_mut().into_iter().flatten() {
            let name = material["name"].as_str().unwrap_or("").to_owned();
            let Some(look) = self.0.get(&name) else {
                continue;
            };
            let opacity = look.opacity.unwrap_or(1.0);
            if opacity < 1.0 || look.cut {
                material["alphaMode"] = json!("BLEND");
            }
            let surface = &mut material["pbrMetallicRoughness"];
            if let Some([r, g, b]) = look.colour {
                surface["baseColorFactor"] = json!([r, g, b, opacity]);
            }
            let Some(bytes) = &look.picture else {
                continue;
            };
            let view = glb.push_view(bytes, 0);
            let image = json!({"bufferView": view, "mimeType": kind(bytes), "name": name});
            let image = push(&mut glb.json["images"], image);
            let texture = push(&mut glb.json["textures"], json!({"source": image}));
            surface["baseColorTexture"] = json!({"index": texture});
            if look.colour.is_none() {
                surface["baseColorFactor"] = json!([1.0, 1.0, 1.0, opacity]);
            }
        }
        glb.json["materials"] = materials;
    }
}

/// Names of a glTF's materials, without repetition.
pub(super) fn material_names(json: &Value) -> Vec<String> {
    let mut names: Vec<String> = Vec::new();
    for (k, material) in list(&json["materials"]).iter().enumerate() {
        let name = material["name"].as_str().unwrap_or("material").to_owned();
        let again = names.contains(&name);
        names.push(if again { format!("{name}_{k}") } else { name });
    }
    names
}

/// A material for rendering.
struct Surface {
    /// Linear.
    colour: [f64; 3],
    opacity: f64,
    picture: Option<RgbaImage>,
}

/// The surface of a mesh for rendering.
pub struct Surfaces<'a> {
    mesh: &'a Mesh,
    /// Per material; `None` if nothing is known of it.
    of: Vec<Option<Surface>>,
}

impl<'a> Surfaces<'a> {
    pub(crate) fn new(mesh: &'a Mesh, looks: &Looks) -> Self {
        let of = |name: &String| {
            let look = looks.0.get(name)?;
            let picture = look.picture.as_ref();
            let picture = picture.and_then(|bytes| image::load_from_memory(bytes).ok());
            let picture = picture.map(|picture| match look.cut {
                true => picture.into_rgba8(),
                false => image::DynamicImage::from(picture.into_rgb8()).into_rgba8(),
            });
            let picture = picture.filter(|picture| !picture.is_empty());
            let known = picture.is_some() || look.colour.is_some();
            known.then(|| Surface {
                colour: look.colour.unwrap_or([1.0; 3]),
                opacity: look.opacity.unwrap_or(1.0),
                picture,
            })
        };
        Self {
            mesh,
            of: mesh.materials.iter().map(of).collect(),
        }
    }

    /// Whether any colour is known.
    pub(super) fn any(&self) -> bool {
        (0..self.of.len() as u32).any(|material| self.know(material))
    }

    /// Whether the colour of a material is known.
    pub(super) fn know(&self, material: u32) -> bool {
        self.of[material as usize].is_some() || !self.mesh.tints.is_empty()
    }

    /// The colour, 0 to 255, at a point of a triangle; `None` at a hole.
    pub(super) fn at(
        &self,
        material: u32,
        corners: [Corner; 3],
        shares: [f64; 3],
    ) -> Option<[f64; 3]> {
        let mesh = self.mesh;
        let mean = |of: &dyn Fn(Corner) -> f32| {
            let all = corners.iter().zip(shares);
            all.map(|(&corner, share)| f64::from(of(corner)) * share)
                .sum::<f64>()
        };
        let surface = self.of[material as usize].as_ref();
        let mut light = surface.map_or([1.0; 3], |surface| surface.colour);
        if !mesh.tints.is_empty() {
            for (c, light) in light.iter_mut().enumerate() {
                *light *= mean(&|k| mesh.tints[k.vertex as usize][c]);
            }
        }
        let mut colour = light.map(|c| 255.0 * c.clamp(0.0, 1.0).powf(1.0 / 2.2));
        let mut opacity = surface.map_or(1.0, |surface| surface.opacity);
        if let Some(picture) = surface.and_then(|surface| surface.picture.as_ref()) {
            let uv = |axis| mean(&|k| k.uv.map_or(0.0, |k| mesh.uv[k as usize][axis]));
            let texel = |share: f64, size: u32| {
                ((share - share.floor()) * f64::from(size)).min(f64::from(size - 1)) as u32
            };
            let (width, height) = picture.dimensions();
            let texel = picture.get_pixel(texel(uv(0), width), texel(1.0 - uv(1), height));
            let [r, g, b, a] = texel.0.map(|x| f64::from(x) / 255.0);
            colour = [colour[0] * r, colour[1] * g, colour[2] * b];
            opacity *= a;
        }
        (opacity > 0.5).then_some(colour)
    }
}

/// Media type of an image; `None` for formats that glTF lacks.
pub(super) fn kind(bytes: &[u8]) -> Option<&'static str> {
    match bytes {
        [0x89, b'P', b'N', b'G', ..] => Some("image/png"),
        [0xff, 0xd8, 0xff, ..] => Some("image/jpeg"),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_material_s_colour_and_picture_reach_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let mtl = "# eyes\nnewmtl my skin\n Kd 1 0.5 0\nd 0.25\nmap_Kd -s 1 2 -clamp on -imfchan r C:\\heads\\my skin.png\nnewmtl eye\nKd 2 0 0\nmap_Kd gone.png\nKs 1 1 1\n";
        std::fs::write(folder.path().join("head.mtl"), mtl).unwrap();
        let png = [&[0x89, b'P', b'N', b'G'][..], b"pixels"].concat();
        std::fs::write(folder.path().join("my skin.png"), &png).unwrap();
        let looks = Looks::from_obj(
            &folder.path().join("head.obj"),
            "mtllib head.mtl\nv 0 0 0\n",
        );
        let plain = json!({"baseColorFactor": [0.8, 0.7, 0.6, 1.0]});
        let mut glb = Glb {
            json: json!({"materials": [
                {"name": "my skin", "pbrMetallicRoughness": plain},
                {"name": "eye", "pbrMetallicRoughness": plain},
                {"name": "teeth", "pbrMetallicRoughness": plain},
            ]}),
            bin: Vec::new(),
        };
        looks.paint(&mut glb);
        let skin = &glb.json["materials"][0];
        let [r, g, b, a] = [0, 1, 2, 3].map(|k| {
            skin["pbrMetallicRoughness"]["baseColorFactor"][k]
                .as_f64()
                .unwrap()
        });
        assert_eq!((r, b, a), (1.0, 0.0, 0.25));
        // Half of sRGB is about a fifth of the light.
        assert!((g - 0.2140).abs() < 1e-4, "{g}");
        assert_eq!(skin["alphaMode"], "BLEND");
        assert_eq!(skin["pbrMetallicRoughness"]["baseColorTexture"]["index"], 0);
        assert_eq!(glb.json["images"][0]["mimeType"], "image/png");
        assert!(glb.bin.starts_with(&png));
        // Neither a colour beyond 1 nor a picture that is not there changes anything.
        assert_eq!(glb.json["materials"][1]["pbrMetallicRoughness"], plain);
        assert_eq!(glb.json["materials"][2]["pbrMetallicRoughness"], plain);
        let gone = Looks::from_obj(&folder.path().join("head.obj"), "mtllib gone.mtl\n");
        assert_eq!(gone, Looks::default());
    }

    #[test]
    fn a_point_has_its_texel_s_colour_and_none_at_a_hole() {
        let mut mesh = super::super::mesh::tests::sheet(2, 1.0);
        mesh.uv = vec![[0.25, 0.75], [0.75, 0.75]];
        // Above: a colour, and a hole to the right of it.
        let mut picture = RgbaImage::new(2, 2);
        picture.put_pixel(0, 0, image::Rgba([255, 102, 51, 255]));
        let of = vec![Some(Surface {
            colour: [1.0, 1.0, 0.0],
            opacity: 1.0,
            picture: Some(picture),
        })];
        let surfaces = Surfaces { mesh: &mesh, of };
        let at = |uv: u32| {
            let corner = Corner {
                uv: Some(uv),
                ..Corner::bare(0)
            };
            surfaces.at(0, [corner; 3], [0.5, 0.25, 0.25])
        };
        let colour = at(0).expect("a colour");
        let expected = [255.0, 102.0, 0.0];
        assert!(
            colour
                .iter()
                .zip(expected)
                .all(|(a, b)| (a - b).abs() < 1e-6)
        );
        assert!(at(1).is_none());
    }

    #[test]
    fn nothing_is_read_through_pipes_devices_or_out_of_the_folder() {
        let root = tempfile::tempdir().unwrap();
        let folder = root.path().join("head");
        std::fs::create_dir(&folder).unwrap();
        let png = [&[0x89, b'P', b'N', b'G'][..], b"pixels"].concat();
        std::fs::write(root.path().join("secret.png"), &png).unwrap();
        std::fs::write(folder.join("skin.png"), &png).unwrap();
        std::fs::write(root.path().join("secret.mtl"), "newmtl skin\nKd 1 1 1\n").unwrap();
        for kind in ["png", "mtl"] {
            let link = folder.join(format!("link.{kind}"));
            std::os::unix::fs::symlink(format!("../secret.{kind}"), link).unwrap();
            let pipe = folder.join(format!("pipe.{kind}"));
            let made = std::process::Command::new("mkfifo").arg(pipe).status();
            assert!(made.unwrap().success());
        }
        let looks = |library: &str| {
            Looks::from_obj(&folder.join("head.obj"), &format!("mtllib {library}\n"))
        };
        for library in ["link.mtl", "pipe.mtl", "../secret.mtl", "/dev/zero", "."] {
            assert!(looks(library).is_empty(), "{library}");
        }
        let here = ("skin.png", true);
        let others = ["link.png", "pipe.png", "../secret.png", "/dev/zero", "."];
        for (picture, read) in others.map(|name| (name, false)).into_iter().chain([here]) {
            let mtl = format!("newmtl skin\nmap_Kd {picture}\n");
            std::fs::write(folder.join("head.mtl"), mtl).unwrap();
            assert_eq!(!looks("head.mtl").is_empty(), read, "{picture}");
        }
    }
}
