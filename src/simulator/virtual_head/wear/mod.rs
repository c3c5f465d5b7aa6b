//! What a person wears and what stands around them, in depth and in colour: hair, clothes, things, a room.
//!
//! An [`Outfit`] is one mesh with procedural texture, made from a head once. Its vertices are points of the head frame, or
//! stand off a vertex of the face and move with it (a beard); each stays with the shoulders by its own share (the ends of
//! long hair, a scarf). Strands are cut out of surfaces pixel by pixel, by value noise over texture coordinates, so that
//! edges are ragged in both cameras alike. One file: the words for looks, the mesh, and how it is drawn. Units and frames: metres, head frame; texture coordinates in cells of noise.

mod hair;
mod room;
mod skull;
#[cfg(feature = "studio")]
mod things;
mod torso;

pub(crate) use room::room;

use super::draw::{Canvas, Light};
use super::noise::{hash, uniform};
use super::raster::{Corner, DepthBuffer, Window, project};
use crate::base::geometry::{Point, Rigid, Vector};

/// A point of the head frame, not tied to a vertex of the face.
const FREE: u32 = u32::MAX;

/// What a surface is made of, as far as the sensor tells: how it answers infrared light.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub(crate) enum Stuff {
    /// Walls, furniture, paper: answers well.
    #[default]
    Matt = 0,
    Skin = 1,
    Cloth = 2,
    /// Black cloth, plastic.
    Dark = 3,
    /// Hair, fair and dark: thin strands that scatter and swallow the pattern.
    Hair = 4,
    DarkHair = 5,
    /// Glass in front of something: what is behind is seen badly.
    Glass = 6,
    /// Sends the pattern elsewhere: a polished desk, a screen.
    #[cfg(feature = "studio")]
    Gloss = 7,
}

impl Stuff {
    /// Contrast of the grain in colour.
    const fn contrast(self) -> f32 {
        match self {
            Self::Hair | Self::DarkHair => 0.36,
            Self::Cloth | Self::Dark => 0.12,
            Self::Matt => 0.04,
            Self::Skin | Self::Glass => 0.03,
            #[cfg(feature = "studio")]
            Self::Gloss => 0.03,
        }
    }

    /// Strength of the light along the strands.
    const fn sheen(self) -> f32 {
        match self {
            Self::Hair | Self::DarkHair => 0.9,
            #[cfg(feature = "studio")]
            Self::Gloss => 0.7,
            _ => 0.0,
        }
    }
}

/// Value noise in −1…1 over the plane, one value per cell, bilinear.
pub(crate) fn grain(u: f32, v: f32) -> f32 {
    let (col, row) = (u.floor(), v.floor());
    let (fu, fv) = (u - col, v - row);
    let at = |du: i64, dv: i64| {
        let cell = ((row as i64 + dv) << 24) ^ (col as i64 + du);
        uniform(0x77ea, cell.cast_unsigned())
    };
    let upper = at(0, 0) * (1.0 - fu) + at(1, 0) * fu;
    let lower = at(0, 1) * (1.0 - fu) + at(1, 1) * fu;
    upper * (1.0 - fv) + lower * fv
}

/// A number in 0…1 for each seed and index.
pub(crate) fn share(seed: u64, index: u64) -> f32 {
    uniform(seed, index) * 0.5 + 0.5
}

/// 0 below `from`, 1 above `to`, straight between; `from` may be above `to`.
fn slope(x: f32, from: f32, to: f32) -> f32 {
    ((x - from) / (to - from)).clamp(0.0, 1.0)
}

/// Hair styles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum HairStyle {
    /// None.
    Bald,
    /// Some millimetres.
    Cropped,
    /// Some centimetres, combed.
    #[default]
    Short,
    /// Stands off by three to five centimetres all round.
    Bushy,
    /// Falls beside the face and over the ears onto the shoulders.
    Long,
    /// Short, and over the brow.
    Fringe,
    /// Long, and over the brow.
    LongFringe,
    /// Falls in curls.
    Curly,
    /// Tied up.
    Bun,
}

/// Hair on the face.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Beard {
    /// None.
    #[default]
    None,
    /// Colour only.
    Stubble,
    /// Stands off the cheeks and the chin.
    Full,
}

/// What is on the head.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Headgear {
    /// Nothing.
    #[default]
    None,
    /// With a peak over the brow.
    Cap,
    /// Of a sweater, up.
    Hood,
    /// A band over the crown, cups over the ears.
    Headphones,
}

/// What is around the neck.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Neck {
    /// Nothing.
    #[default]
    None,
    /// Up to the chin.
    Scarf,
    /// Turned up.
    Collar,
}

/// What a hand holds, now and then.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Held {
    /// The hands are out of the picture.
    #[default]
    None,
    /// The chin.
    Chin,
    /// A sheet, beside the face or below it.
    Paper,
    /// Led to the mouth.
    Cup,
    /// At the ear.
    Phone,
    /// Nothing: it is laid over the mouth.
    Mouth,
}

/// A person's looks, apart from the head itself.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Look {
    /// Of all that is left to chance.
    pub seed: u64,
    /// Hair.
    pub hair: HairStyle,
    /// Its colour, RGB 0…255.
    pub hair_colour: [f32; 3],
    /// Beard.
    pub beard: Beard,
    /// Thickness of the rims of glasses, metres; 0: none.
    pub rims_m: f32,
    /// Headgear.
    pub headgear: Headgear,
    /// Neck.
    pub neck: Neck,
    /// Hand.
    pub held: Held,
    /// A chair whose headrest is behind the head.
    pub chair: bool,
    /// Somebody stands behind.
    pub bystander: bool,
    /// Clothes, RGB 0…255.
    pub clothes: [f32; 3],
}

/// Colours of hair: black, dark brown, brown, blond, red, grey.
pub(super) const HAIR_COLOURS: [[f32; 3]; 6] = [
    [30.0, 27.0, 28.0],
    [55.0, 40.0, 32.0],
    [95.0, 68.0, 48.0],
    [176.0, 142.0, 96.0],
    [140.0, 74.0, 42.0],
    [150.0, 148.0, 146.0],
];

impl Look {
    /// What the person of the demonstration wears.
    #[must_use]
    pub fn demonstration() -> Self {
        Self {
            seed: 4,
            hair: HairStyle::Short,
            hair_colour: HAIR_COLOURS[1],
            clothes: [62.0, 84.0, 118.0],
            ..Self::default()
        }
    }

    /// One of many: all hair styles in turn, and with them, at steps of their own, all things. `number` and seed give the
    /// same look always.
    #[cfg(feature = "studio")]
    #[must_use]
    pub fn numbered(number: usize, seed: u64) -> Self {
        let seed = hash(seed, number as u64);
        let pick = |k: u64, count: usize| (share(seed, k) * count as f32) as usize % count;
        let hair = [
            HairStyle::Short,
            HairStyle::Long,
            HairStyle::Bushy,
            HairStyle::Fringe,
            HairStyle::LongFringe,
            HairStyle::Cropped,
            HairStyle::Curly,
            HairStyle::Bun,
            HairStyle::Bald,
        ][number % 9];
        Self {
            seed,
            hair,
            hair_colour: HAIR_COLOURS[pick(1, HAIR_COLOURS.len())],
            beard: [
                Beard::Stubble,
                Beard::None,
                Beard::None,
                Beard::Full,
                Beard::None,
            ][number % 5],
            rims_m: [0.0, 0.0012, 0.0, 0.0026][number % 4],
            headgear: match number % 11 {
                3 => Headgear::Headphones,
                5 => Headgear::Cap,
                7 => Headgear::Headphones,
                8 => Headgear::Hood,
                10 => Headgear::Cap,
                _ => Headgear::None,
            },
            neck: match number % 7 {
                1 => Neck::Scarf,
                4 => Neck::Collar,
                _ => Neck::None,
            },
            held: match number % 10 {
                0 => Held::Paper,
                2 => Held::Cup,
                6 => Held::Chin,
                9 => Held::Phone,
                _ => Held::None,
            },
            chair: number % 3 == 2,
            bystander: number % 6 == 4,
            clothes: [2, 3, 4].map(|k| {
                let bright = 30.0 + 150.0 * share(seed, 10);
                bright * (0.7 + 0.6 * share(seed, k + 10))
            }),
        }
    }

    /// Stuff of the hair: dark swallows more light.
    pub(super) fn hair_stuff(&self) -> Stuff {
        if self.hair_colour.iter().sum::<f32>() < 140.0 {
            Stuff::DarkHair
        } else {
            Stuff::Hair
        }
    }
}

/// One point of an outfit.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Knot {
    /// Vertex of the face that it stands off, or [`FREE`].
    pub(crate) base: u32,
    /// From there, or from the origin of the head frame.
    pub(crate) offset: Vector,
    /// How far it stays with the shoulders, 0…1.
    pub(crate) stays: f32,
    /// RGB 0…255.
    pub(crate) colour: [f32; 3],
    /// Texture coordinates.
    pub(crate) weave: [f32; 2],
    /// Share of the surface that is there, 0…1.
    pub(crate) cover: f32,
}

/// How a surface looks.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cloth {
    pub(crate) stuff: Stuff,
    pub(crate) colour: [f32; 3],
    /// How far it stays with the shoulders.
    pub(crate) stays: f32,
    /// Cells of noise over the texture's unit in both directions.
    pub(crate) cells: [f32; 2],
}

impl Cloth {
    pub(crate) const fn new(stuff: Stuff, colour: [f32; 3], stays: f32) -> Self {
        Self {
            stuff,
            colour,
            stays,
            cells: [60.0, 60.0],
        }
    }

    pub(crate) fn knot(&self, p: Point, [u, v]: [f32; 2], cover: f32) -> Knot {
        Knot {
            base: FREE,
            offset: p.coords,
            stays: self.stays,
            colour: self.colour,
            weave: [u * self.cells[0], v * self.cells[1]],
            cover,
        }
    }
}

/// A mesh that is worn, or stands somewhere; corners clockwise seen from outside.
#[derive(Clone, Debug, Default)]
pub(crate) struct Outfit {
    pub(crate) knots: Vec<Knot>,
    pub(crate) triangles: Vec<([u32; 3], Stuff)>,
}

impl Outfit {
    /// Adds a grid of rows and columns; `at(row, column)`: the knot there, `None` if there is nothing. Seen from outside,
    /// columns go right where rows go down.
    pub(crate) fn grid(
        &mut self,
        [rows, columns]: [usize; 2],
        around: bool,
        stuff: Stuff,
        mut at: impl FnMut(usize, usize) -> Knot,
    ) {
        let start = self.knots.len() as u32;
        for row in 0..rows {
            for column in 0..columns {
                self.knots.push(at(row, column));
            }
        }
        let place = |row: usize, column: usize| start + (row * columns + column % columns) as u32;
        for row in 0..rows - 1 {
            for column in 0..columns - usize::from(!around) {
                let (a, b) = (place(row, column), place(row, column + 1));
                let (c, d) = (place(row + 1, column), place(row + 1, column + 1));
                for triangle in [[a, b, c], [b, d, c]] {
                    let drawn = |&k: &u32| self.knots[k as usize].cover > 0.0;
                    if triangle.iter().any(drawn) {
                        self.triangles.push((triangle, stuff));
                    }
                }
            }
        }
    }

    /// Adds an ellipsoid, made of `radii` along the axes.
    pub(crate) fn ball(&mut self, centre: [f32; 3], radii: [f32; 3], cloth: &Cloth) {
        const ROWS: usize = 11;
        const COLUMNS: usize = 18;
        self.grid([ROWS, COLUMNS], true, cloth.stuff, |row, column| {
            let theta = std::f32::consts::PI * row as f32 / (ROWS - 1) as f32;
            let phi = std::f32::consts::TAU * column as f32 / COLUMNS as f32;
            let d = skull::direction(theta, phi);
            let p = Point::new(
                centre[0] + radii[0] * d.x,
                centre[1] + radii[1] * d.y,
                centre[2] + radii[2] * d.z,
            );
            cloth.knot(p, [phi * radii[0] * 10.0, row as f32 * radii[1] * 3.0], 1.0)
        });
    }

    /// Adds a tube along a path; `outward(i)`: its thick side; `radii(i)`: half width across and along that.
    pub(crate) fn tube(
        &mut self,
        path: &[Point],
        outward: impl Fn(usize) -> Vector,
        radii: impl Fn(usize) -> [f32; 2],
        sides: usize,
        stuff: Stuff,
        mut knot: impl FnMut(usize, Point, f32) -> Knot,
    ) {
        self.grid([path.len(), sides], true, stuff, |i, j| {
            let (before, after) = (i.saturating_sub(1), (i + 1).min(path.len() - 1));
            let tangent = path[after] - path[before];
            let out = outward(i);
            let across = tangent.cross(&out);
            let across = across / across.norm().max(1e-9);
            let turn = j as f32 / sides as f32;
            let (sin, cos) = (std::f32::consts::TAU * turn).sin_cos();
            let [wide, thick] = radii(i);
            knot(
                i,
                path[i] + across * (wide * cos) + out * (thick * sin),
                turn,
            )
        });
    }

    /// Everything a person of this look wears, for this head.
    pub(crate) fn worn(asset: &super::HeadAsset, look: &Look) -> Self {
        let mut outfit = Self::default();
        let skull = skull::Skull::of(asset);
        outfit.torso(look);
        outfit.hair(&skull, look);
        #[cfg(feature = "studio")]
        outfit.things(asset, &skull, look);
        outfit.round();
        outfit
    }

    /// Whole tenths of a millimetre, so that the last digit of a sine cannot show in a picture.
    fn round(&mut self) {
        for knot in &mut self.knots {
            knot.offset = knot.offset.map(|c| (c * 1e4).round() * 1e-4);
            knot.weave = knot.weave.map(|c| (c * 64.0).round() / 64.0);
        }
    }
}

/// Work space for one outfit.
pub(crate) struct OutfitPainter {
    placed: Vec<Point>,
    normals: Vec<Vector>,
    lit: Vec<[f32; 3]>,
    corners: Vec<Corner>,
}

impl OutfitPainter {
    pub(crate) fn new(outfit: &Outfit) -> Self {
        let n = outfit.knots.len();
        Self {
            placed: outfit.knots.iter().map(|k| Point::from(k.offset)).collect(),
            normals: vec![Vector::zeros(); n],
            lit: vec![[0.0; 3]; n],
            corners: vec![Corner::default(); n],
        }
    }

    /// Puts it on; `face`: the deformed vertices of the head, head frame.
    pub(crate) fn place(
        &mut self,
        outfit: &Outfit,
        face: &[Point],
        sensor_from_head: &Rigid,
        sensor_from_torso: &Rigid,
    ) {
        for (placed, knot) in self.placed.iter_mut().zip(&outfit.knots) {
            let p = match face.get(knot.base as usize) {
                Some(vertex) => vertex + knot.offset,
                None => Point::from(knot.offset),
            };
            let moved = sensor_from_head * p;
            *placed = moved + (sensor_from_torso * p - moved) * knot.stays;
        }
    }

    /// Draws depth, and what is there into `stuff`, one per pixel.
    pub(crate) fn draw_depth(
        &mut self,
        outfit: &Outfit,
        pixel: impl Fn(&Point) -> [f32; 2],
        buffer: &mut DepthBuffer,
        stuff: &mut [Stuff],
    ) {
        project(&self.placed, pixel, &mut self.corners);
        for &(triangle, made) in &outfit.triangles {
            let [a, b, c] = triangle.map(|k| k as usize);
            let corners = [self.corners[a], self.corners[b], self.corners[c]];
            let [p, q, r] = [a, b, c].map(|k| &outfit.knots[k]);
            buffer.triangle_where(corners, |index, u, v| {
                let kept = made != Stuff::Glass && cut(p, q, r, u, v);
                // Glass lets what is behind be measured, badly.
                if kept || made == Stuff::Glass {
                    stuff[index] = made;
                }
                kept
            });
        }
    }

    /// Draws colour.
    pub(crate) fn draw_colour(
        &mut self,
        outfit: &Outfit,
        light: &Light,
        pixel: impl Fn(&Point) -> [f32; 2],
        canvas: &mut Canvas,
    ) -> Window {
        project(&self.placed, pixel, &mut self.corners);
        self.light(outfit, light);
        let mut window = Window::NOTHING;
        let Canvas { depth, rgb } = canvas;
        for &(triangle, made) in &outfit.triangles {
            let [a, b, c] = triangle.map(|k| k as usize);
            let corners = [self.corners[a], self.corners[b], self.corners[c]];
            let [p, q, r] = [a, b, c].map(|k| &outfit.knots[k]);
            let (la, lb, lc) = (self.lit[a], self.lit[b], self.lit[c]);
            let contrast = made.contrast();
            // Stubble on the skin, the glint on glass: one looks through.
            let thin = matches!(made, Stuff::Skin | Stuff::Glass);
            window.include(depth.triangle_where(corners, |index, u, v| {
                let mix = |a: f32, b: f32, c: f32| a + u * (b - a) + v * (c - a);
                let cover = mix(p.cover, q.cover, r.cover);
                let kept = cover >= 0.99 || (!thin && cut(p, q, r, u, v));
                if kept || thin {
                    let fine = grain(
                        mix(p.weave[0], q.weave[0], r.weave[0]),
                        mix(p.weave[1], q.weave[1], r.weave[1]),
                    );
                    let gain = 1.0 + contrast * fine;
                    let share = if kept {
                        1.0
                    } else {
                        cover * (1.0 + 0.4 * fine)
                    };
                    for (k, level) in rgb[index].iter_mut().enumerate() {
                        let behind = f32::from(*level);
                        let own = mix(la[k], lb[k], lc[k]) * gain;
                        *level = (behind + share * (own - behind) + 0.5) as u8;
                    }
                }
                kept
            }));
        }
        window
    }

    /// Light at each knot.
    fn light(&mut self, outfit: &Outfit, light: &Light) {
        self.normals.fill(Vector::zeros());
        for &(triangle, _) in &outfit.triangles {
            let [a, b, c] = triangle.map(|k| k as usize);
            let p = self.placed[a];
            let normal = (self.placed[c] - p).cross(&(self.placed[b] - p));
            for k in [a, b, c] {
                self.normals[k] += normal;
            }
        }
        for &(triangle, made) in &outfit.triangles {
            for k in triangle.map(|k| k as usize) {
                let normal = self.normals[k] / self.normals[k].norm().max(1e-12);
                let shine = normal.dot(&light.towards).max(0.0).powi(6) * made.sheen();
                let bright = light.on(&normal) + shine;
                let colour = outfit.knots[k].colour;
                self.lit[k] = [0, 1, 2].map(|ch| colour[ch] * bright * light.tint[ch]);
            }
        }
    }
}

/// Whether the surface is there at these shares of its second and third corner.
fn cut(a: &Knot, b: &Knot, c: &Knot, u: f32, v: f32) -> bool {
    let mix = |a: f32, b: f32, c: f32| a + u * (b - a) + v * (c - a);
    let cover = mix(a.cover, b.cover, c.cover);
    cover >= 0.99
        || cover
            > 0.5
                + 0.5
                    * grain(
                        mix(a.weave[0], b.weave[0], c.weave[0]) + 0.37,
                        mix(a.weave[1], b.weave[1], c.weave[1]),
                    )
}

/// A seed for one part of a look.
fn part(seed: u64, part: u64) -> u64 {
    hash(seed, 0x5ea7 + part)
}

#[cfg(feature = "studio")]
impl std::fmt::Display for Look {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let shade = match self.hair_stuff() {
            Stuff::DarkHair => "dark ",
            _ => "",
        };
        match self.hair {
            HairStyle::Bald => write!(f, "bald")?,
            HairStyle::Fringe => write!(f, "{shade}fringe")?,
            HairStyle::LongFringe => write!(f, "{shade}long hair and fringe")?,
            HairStyle::Bun => write!(f, "{shade}bun")?,
            style => write!(f, "{shade}{} hair", format!("{style:?}").to_lowercase())?,
        }
        let things: [(bool, &str); 14] = [
            (self.beard == Beard::Stubble, "stubble"),
            (self.beard == Beard::Full, "full beard"),
            (self.rims_m > 0.0, "glasses"),
            (self.headgear == Headgear::Cap, "cap"),
            (self.headgear == Headgear::Hood, "hood"),
            (self.headgear == Headgear::Headphones, "headphones"),
            (self.neck == Neck::Scarf, "scarf"),
            (self.neck == Neck::Collar, "collar"),
            (self.held == Held::Chin, "hand at the chin"),
            (self.held == Held::Paper, "sheet of paper"),
            (self.held == Held::Cup, "cup"),
            (self.held == Held::Phone, "phone"),
            (self.held == Held::Mouth, "hand over the mouth"),
            (self.chair, "chair"),
        ];
        for (_, thing) in things.iter().filter(|(worn, _)| *worn) {
            write!(f, ", {thing}")?;
        }
        if self.bystander {
            write!(f, ", somebody behind")?;
        }
        Ok(())
    }
}
