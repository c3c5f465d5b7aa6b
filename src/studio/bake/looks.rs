//! Colours of an OBJ: what its material files (MTL) say of each material, and their pictures, as glTF materials
//! or, for USD, as files beside it.
//!
//! Read are `newmtl`, `Kd`, `d`, `Tr` and `map_Kd` with a PNG or JPEG, which is carried over as it is; paths are relative to
//! the file that names them. Colours are sRGB there and linear in glTF. What is missing or damaged leaves the material as it
//! would be without: a head without its colours is still a head.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use serde_json::json;

use super::error::BakeError;
use super::files::{read, read_bytes, write};
use super::glb::{Glb, push};
use crate::studio::srgb::linear;

/// A material.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Look {
    /// Linear red, green and blue.
    colour: Option<[f64; 3]>,
    opacity: Option<f64>,
    picture: Option<PathBuf>,
}

impl Look {
    /// Its picture, if that can be read and glTF and USD have the like, and what glTF calls it.
    fn picture(&self) -> Option<(&'static str, Vec<u8>)> {
        let bytes = read_bytes(self.picture.as_ref()?).ok()?;
        Some((kind(&bytes)?, bytes))
    }

    /// Linear red, green, blue and opacity; `None` for the colour if the file says nothing of it.
    pub(super) fn surface(&self) -> (Option<[f64; 3]>, f64) {
        (self.colour, self.opacity.unwrap_or(1.0))
    }
}

/// Materials by name.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Looks(HashMap<String, Look>);

/// Names of pictures beside a file, by material.
pub(super) type Beside = HashMap<String, String>;

/// What any system lets a file be called.
fn plain(c: char) -> char {
    if c.is_ascii_alphanumeric() { c } else { '_' }
}

/// Three numbers from 0 to 1.
fn colour(words: &str) -> Option<[f64; 3]> {
    let numbers = words.split_ascii_whitespace().map(|word| word.parse().ok());
    let numbers: Vec<f64> = numbers.collect::<Option<_>>()?;
    let three: [f64; 3] = numbers.try_into().ok()?;
    three
        .iter()
        .all(|value| (0.0..=1.0).contains(value))
        .then(|| three.map(linear))
}

/// What follows a word at the start of a line.
fn after<'a>(line: &'a str, word: &str) -> Option<&'a str> {
    let rest = line.trim().strip_prefix(word)?;
    rest.starts_with([' ', '\t']).then(|| rest.trim())
}

impl Looks {
    /// Of an OBJ file and its text.
    pub(super) fn of(path: &Path, obj: &str) -> Self {
        let mut looks = Self::default();
        let folder = path.parent().unwrap_or(Path::new(""));
        for name in obj.lines().filter_map(|line| after(line, "mtllib")) {
            let file = folder.join(name);
            if let Ok(text) = read(&file) {
                looks.add(&text, file.parent().unwrap_or(Path::new("")));
            }
        }
        looks
    }

    /// The materials of an MTL in this folder.
    fn add(&mut self, mtl: &str, folder: &Path) {
        let mut name = None;
        for line in mtl.lines() {
            if let Some(new) = after(line, "newmtl") {
                name = new.split_ascii_whitespace().next();
                continue;
            }
            let Some(name) = name else { continue };
            let look = self.0.entry(name.to_owned()).or_default();
            let share = |words: &str| {
                let value = words.parse().ok();
                value.filter(|value: &f64| (0.0..=1.0).contains(value))
            };
            if let Some(words) = after(line, "Kd") {
                look.colour = colour(words);
            } else if let Some(opacity) = after(line, "d").and_then(share) {
                look.opacity = Some(opacity);
            } else if let Some(clear) = after(line, "Tr").and_then(share) {
                look.opacity = Some(1.0 - clear);
            } else if let Some(picture) = after(line, "map_Kd") {
                look.picture = Some(folder.join(picture));
            }
        }
    }

    /// The look of a material.
    pub(super) fn get(&self, name: &str) -> Option<&Look> {
        self.0.get(name)
    }

    /// Puts the pictures of these materials beside a file; their names there, by material.
    ///
    /// # Errors
    /// If one cannot be written.
    pub(super) fn beside(&self, out: &Path, names: &[String]) -> Result<Beside, BakeError> {
        let stem = out.file_stem().unwrap_or_default().to_string_lossy();
        let stem: String = stem.chars().map(plain).collect();
        let mut beside = Beside::new();
        for (k, name) in names.iter().enumerate() {
            let Some((kind, bytes)) = self.get(name).and_then(Look::picture) else {
                continue;
            };
            let ending = kind.strip_prefix("image/").unwrap_or_default();
            // By number: the names of two materials may differ in what no file can be called only.
            let file = format!(
                "{stem}_{}_{k}.{ending}",
                name.chars().map(plain).collect::<String>()
            );
            write(&out.with_file_name(&file), &bytes)?;
            beside.insert(name.clone(), file);
        }
        Ok(beside)
    }

    /// Gives the materials of a file that have these names their colours and pictures.
    pub(super) fn paint(&self, glb: &mut Glb) {
        let count = glb.json["materials"].as_array().map_or(0, Vec::len);
        for k in 0..count {
            let name = glb.json["materials"][k]["name"].as_str().unwrap_or("");
            let Some(look) = self.0.get(name) else {
                continue;
            };
            let name = name.to_owned();
            let opacity = look.opacity.unwrap_or(1.0);
            if let Some([r, g, b]) = look.colour {
                glb.json["materials"][k]["pbrMetallicRoughness"]["baseColorFactor"] =
                    json!([r, g, b, opacity]);
            }
            if opacity < 1.0 {
                glb.json["materials"][k]["alphaMode"] = json!("BLEND");
            }
            let Some((kind, bytes)) = look.picture() else {
                continue;
            };
            let view = glb.push_view(&bytes, 0);
            let image = push(
                &mut glb.json["images"],
                json!({"bufferView": view, "mimeType": kind, "name": name}),
            );
            let texture = push(&mut glb.json["textures"], json!({"source": image}));
            let surface = &mut glb.json["materials"][k]["pbrMetallicRoughness"];
            surface["baseColorTexture"] = json!({"index": texture});
            if look.colour.is_none() {
                surface["baseColorFactor"] = json!([1.0, 1.0, 1.0, opacity]);
            }
        }
    }
}

/// What glTF calls a picture; `None` for what it has none of.
fn kind(bytes: &[u8]) -> Option<&'static str> {
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
        let mtl = "# eyes\nnewmtl skin\n Kd 1 0.5 0\nd 0.25\nmap_Kd my skin.png\nnewmtl eye\nKd 2 0 0\nmap_Kd gone.png\nKs 1 1 1\n";
        std::fs::write(folder.path().join("head.mtl"), mtl).unwrap();
        let png = [&[0x89, b'P', b'N', b'G'][..], b"pixels"].concat();
        std::fs::write(folder.path().join("my skin.png"), &png).unwrap();
        let looks = Looks::of(
            &folder.path().join("head.obj"),
            "mtllib head.mtl\nv 0 0 0\n",
        );
        let plain = json!({"baseColorFactor": [0.8, 0.7, 0.6, 1.0]});
        let mut glb = Glb {
            json: json!({"materials": [
                {"name": "skin", "pbrMetallicRoughness": plain},
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
        let gone = Looks::of(&folder.path().join("head.obj"), "mtllib gone.mtl\n");
        assert_eq!(gone, Looks::default());
    }
}
