//! Training pictures: dressed heads with random shape, expression, pose, light and camera, cropped around the face, with
//! everything known about them.
//!
//! What varies: identity (shape between and beyond two people's, noise of half a sigma per mode, 3.5 % of scale per axis, a
//! smooth quadratic warp; skin mixed from both photographs, evenly or from place to place, also beyond one of them, which
//! makes new people of a hundred), expression (several at once, unequal sides, a fifth neutral), pose (yaw ±40°, pitch ±25°, roll ±20°), distance (0.5 to 1.5 m, so that a
//! face is 50 to 200 colour pixels wide), light, exposure, gamma, blur, noise, backdrop, mouth interior, near-infrared greys,
//! beards, glasses, hair, headwear, hands and other things in front.
//! Half of the pictures are of the mirrored head, through the same camera, so that pose and pixels stay exactly consistent.
//! Sample `i` of a seed is the same whatever is drawn beside it and on however many threads. Points are of the drawn head:
//! fixed places of the mesh, hidden ones included, with a flag. Limitation: hair and headwear are painted flat (`hair_and_headwear`).
//! One file: all steps of a picture draw from one stream of random numbers, in this order.

use std::ops::Range;
use std::path::Path;

use fastrand::Rng;
use nalgebra::{Translation3, Vector3};
use rayon::prelude::*;

use super::beards_glasses_hands::{beard, glasses, hand};
use super::grey_picture::Picture;
use super::hair_and_headwear::{headwear, mane};
use super::random::{either, normal};
use crate::base::capacity::LANDMARKS;
use crate::base::geometry::{Point, Rigid, Vector, rotation_from_yaw_pitch_roll};
use crate::face_model::scheme::MIRROR;
use crate::sensor::camera::Camera;
use crate::sensor::kinect::colour::luma_of;
use crate::simulator::virtual_head::body::Shape;
use crate::simulator::virtual_head::draw::{Canvas, HeadPainter, ShapePainter, shoulders_below};
use crate::simulator::virtual_head::{HeadAsset, Light, Part};
use crate::studio::heads::expressions::complete;
use crate::studio::heads::ict::IctHead;
use crate::studio::heads::reduce::Reduction;
use crate::studio::heads::{HeadsError, PersonHead, plain_head, textured_heads};
use crate::studio::progress::Progress;

/// One picture with its truth.
#[derive(Clone, Debug)]
pub struct TrainingSample {
    /// Columns of the crop.
    pub width: usize,
    /// Rows of the crop.
    pub height: usize,
    /// Luma, row by row.
    pub luma: Vec<u8>,
    /// Colour pixel of the crop's first pixel: crop pixel + origin = `Camera::colour_pixel` of the point.
    pub origin: [f32; 2],
    /// The 68 points, crop pixels.
    pub points: [[f32; 2]; LANDMARKS],
    /// The 68 points in the head frame, metres, expression included.
    pub head: [Point; LANDMARKS],
    /// The 68 points of the same head without expression.
    pub neutral: [Point; LANDMARKS],
    /// Whether nothing stands before the point.
    pub visible: [bool; LANDMARKS],
    /// Pose of the head.
    pub sensor_from_head: Rigid,
    /// Weight of each expression, in the order of [`Renderer::expression_names`].
    pub weights: Vec<f32>,
    /// Whose photograph it is: number of the person in the collection.
    pub person: usize,
}

/// Draws training pictures of a set of people.
pub struct Renderer {
    heads: Vec<PersonHead>,
    identities: Vec<Vec<Vector>>,
    /// Position of the opposite side's expression.
    opposite: Vec<usize>,
    camera: Camera,
}

/// Puts something before a face.
type Cover = fn(&mut Rng, &[[f32; 2]; LANDMARKS], usize, usize, &mut [f32], &mut [bool; LANDMARKS]);

/// Share of the pictures whose person is mixed of two.
const MIXED: f32 = 0.75;

struct Scratch {
    painter: HeadPainter,
    bust: ShapePainter,
    canvas: Canvas,
    /// The same head with the other person's photograph.
    other: Canvas,
    neutral: Vec<Point>,
    grey: Vec<f32>,
    spare: Vec<f32>,
}

/// A face in its head frame.
struct Face {
    /// Landmarks at rest.
    neutral: [Point; LANDMARKS],
    /// Landmarks with the expression.
    points: [Point; LANDMARKS],
    /// Of the expressions.
    weights: Vec<f32>,
}

impl Renderer {
    /// Dresses the heads of all persons that `keep` accepts; `data` is the folder of the data sets.
    ///
    /// # Errors
    /// If mesh or portraits cannot be read.
    pub fn new(data: &Path, keep: impl Fn(usize) -> bool) -> Result<Self, HeadsError> {
        let mut heads = textured_heads(data, keep)?;
        let mut ict = IctHead::read(&data.join("ict_facekit"))?;
        complete(&mut ict);
        let plain = plain_head(&ict);
        let reduction = Reduction::of(&plain);
        let first = reduction.apply(&plain);
        for head in &mut heads {
            head.asset = reduction.apply_like(&head.asset, &first);
        }
        let identities = ict
            .identities
            .iter()
            .map(|mode| reduction.pick(&mode.offsets))
            .collect();
        let names: Vec<String> = heads
            .first()
            .map(|head| {
                head.asset
                    .expressions
                    .iter()
                    .map(|e| e.name.clone())
                    .collect()
            })
            .unwrap_or_default();
        let opposite = names
            .iter()
            .enumerate()
            .map(|(k, name)| {
                let other = match name.strip_suffix("_L") {
                    Some(stem) => format!("{stem}_R"),
                    None => match name.strip_suffix("_R") {
                        Some(stem) => format!("{stem}_L"),
                        None if name == "jawLeft" => "jawRight".into(),
                        None if name == "jawRight" => "jawLeft".into(),
                        None if name == "mouthLeft" => "mouthRight".into(),
                        None if name == "mouthRight" => "mouthLeft".into(),
                        None => name.clone(),
                    },
                };
                names.iter().position(|n| *n == other).unwrap_or(k)
            })
            .collect();
        Ok(Self {
            heads,
            identities,
            opposite,
            camera: crate::sensor::kinect::geometry::nominal(),
        })
    }

    /// The people.
    #[must_use]
    pub fn heads(&self) -> &[PersonHead] {
        &self.heads
    }

    /// Names of the expressions, in the order of the weights.
    #[must_use]
    pub fn expression_names(&self) -> Vec<&str> {
        self.heads
            .first()
            .map(|head| {
                head.asset
                    .expressions
                    .iter()
                    .map(|e| e.name.as_str())
                    .collect()
            })
            .unwrap_or_default()
    }

    /// Draws the samples with these numbers, on all threads. None if there are no heads.
    #[must_use]
    pub fn samples(&self, numbers: Range<u64>, seed: u64) -> Vec<TrainingSample> {
        let Some(first) = self.heads.first() else {
            return Vec::new();
        };
        let progress = Progress::new("train: faces", numbers.clone().count());
        numbers
            .into_par_iter()
            .map_init(
                || Scratch::new(&first.asset),
                |scratch, number| {
                    let sample = self.sample(number, seed, scratch);
                    progress.step();
                    sample
                },
            )
            .collect()
    }

    fn sample(&self, number: u64, seed: u64, scratch: &mut Scratch) -> TrainingSample {
        let mut rng = Rng::with_seed(seed ^ (number + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15));
        let head = &self.heads[rng.usize(..self.heads.len())];
        let asset = &head.asset;
        let other = &self.heads[rng.usize(..self.heads.len())].asset;
        let mixed = rng.f32() < MIXED;
        let Face {
            neutral,
            points: points_head,
            weights,
        } = self.face(asset, mixed.then_some(other), &mut rng, scratch);
        let painter = &mut scratch.painter;
        let sensor_from_head = pose(&mut rng);
        painter.place_deformed(&sensor_from_head);
        let light = light(&mut rng);
        painter.light(asset, &light);

        let seen = points_head.map(|p| self.camera.colour_pixel(&(sensor_from_head * p)));
        let (origin, width, height) = crop(&seen, &mut rng);
        let pixel = |p: &Point| {
            let [x, y] = self.camera.colour_pixel(p);
            [x - origin[0], y - origin[1]]
        };
        let canvas = &mut scratch.canvas;
        canvas.resize(width, height);
        painter.draw_colour(asset, &light, pixel, canvas);
        if mixed {
            scratch.other.resize(width, height);
            painter.draw_colour(other, &light, pixel, &mut scratch.other);
            let face = seen.map(|[x, y]| [x - origin[0], y - origin[1]]);
            mix_skins(&mut rng, &face, canvas, &scratch.other);
        }
        if rng.f32() < 0.75 {
            let bust = &mut scratch.bust;
            bust.place(&shoulders_below(&sensor_from_head));
            let mut clothes = light;
            let dye = rng.f32() * 2.2;
            clothes.tint = light.tint.map(|t| t * dye * (0.7 + 0.6 * rng.f32()));
            bust.draw_colour(&clothes, pixel, canvas);
        }
        let points = seen.map(|[x, y]| [x - origin[0], y - origin[1]]);
        let mut visible = std::array::from_fn(|k| {
            let z = (sensor_from_head * points_head[k]).z;
            let (col, row) = (points[k][0].round() as usize, points[k][1].round() as usize);
            let nearest = canvas.depth.inverse[row.min(height - 1) * width + col.min(width - 1)];
            nearest <= 1.0 / (z - 0.006)
        });

        backdrop(&mut rng, width, height, &mut scratch.grey);
        grey_of(&mut rng, canvas, &mut scratch.grey);
        wear(&mut rng, &points, [width, height], scratch, &mut visible);
        let luma = develop(
            &mut rng,
            width,
            height,
            &mut scratch.grey,
            &mut scratch.spare,
        );
        TrainingSample {
            width,
            height,
            luma,
            origin,
            points,
            head: points_head,
            neutral,
            visible,
            sensor_from_head,
            weights,
            person: head.person,
        }
    }

    /// A face of its own, with an expression, sometimes mirrored, in `scratch`; somewhere between two people if there is
    /// another one.
    fn face(
        &self,
        asset: &HeadAsset,
        other: Option<&HeadAsset>,
        rng: &mut Rng,
        scratch: &mut Scratch,
    ) -> Face {
        let mut weights = self.expression(asset, rng);
        // Between two people, and somewhat beyond either.
        let (share, other) = match other {
            Some(other) => (1.4 * rng.f32() - 0.2, other),
            None => (0.0, asset),
        };
        for ((p, a), b) in scratch
            .neutral
            .iter_mut()
            .zip(&asset.neutral)
            .zip(&other.neutral)
        {
            *p = a + (b - a) * share;
        }
        self.shape(asset, rng, &mut scratch.neutral);
        let mut neutral_points = asset.landmarks_on(&scratch.neutral);
        let painter = &mut scratch.painter;
        painter.deformed.copy_from_slice(&scratch.neutral);
        for (expression, &weight) in asset.expressions.iter().zip(&weights) {
            if weight != 0.0 {
                for (&v, offset) in expression.vertices.iter().zip(&expression.offsets) {
                    painter.deformed[v as usize] += offset * weight;
                }
            }
        }
        let mut points_head = asset.landmarks_on(&painter.deformed);
        painter.mirrored = rng.bool();
        if painter.mirrored {
            for p in &mut painter.deformed {
                p.x = -p.x;
            }
            let flipped = |points: &[Point; LANDMARKS]| {
                std::array::from_fn(|k| {
                    let p = points[MIRROR[k]];
                    Point::new(-p.x, p.y, p.z)
                })
            };
            points_head = flipped(&points_head);
            neutral_points = flipped(&neutral_points);
            weights = self.opposite.iter().map(|&k| weights[k]).collect();
        }
        Face {
            neutral: neutral_points,
            points: points_head,
            weights,
        }
    }

    /// Varies a shape; origin between the inner eye corners again.
    fn shape(&self, asset: &HeadAsset, rng: &mut Rng, out: &mut [Point]) {
        for mode in &self.identities {
            let weight = 0.5 * normal(rng);
            for (p, offset) in out.iter_mut().zip(mode) {
                *p += offset * weight;
            }
        }
        let scale = Vector::from_fn(|_, _| 1.0 + 0.035 * normal(rng));
        // Quadratic in the place, 1.2 mm of each term at 10 cm; x-odd terms included, for faces are not symmetric.
        let bend: [[f32; 6]; 3] =
            std::array::from_fn(|_| std::array::from_fn(|_| 0.12 * normal(rng)));
        for p in out.iter_mut() {
            let q = p.coords;
            let terms = [
                q.x * q.x,
                q.y * q.y,
                q.z * q.z,
                q.x * q.y,
                q.y * q.z,
                q.z * q.x,
            ];
            for axis in 0..3 {
                let warp: f32 = bend[axis].iter().zip(terms).map(|(b, t)| b * t).sum();
                p[axis] = q[axis] * scale[axis] + warp;
            }
        }
        let corners = [39, 42].map(|k| asset.landmarks[k].on(out));
        let origin = nalgebra::center(&corners[0], &corners[1]).coords;
        for p in out.iter_mut() {
            *p -= origin;
        }
    }

    /// Weights of a random expression.
    fn expression(&self, asset: &HeadAsset, rng: &mut Rng) -> Vec<f32> {
        let mut act = Act {
            asset,
            weights: vec![0.0; asset.expressions.len()],
        };
        if rng.f32() < 0.2 {
            if rng.f32() < 0.3 {
                act.both("jawOpen", 0.06 * rng.f32(), rng);
                act.both("mouthSmile", 0.1 * rng.f32(), rng);
            }
            return act.weights;
        }
        act.brows(rng);
        act.eyes(rng);
        act.jaw(rng);
        for _ in 0..1 + rng.usize(..2) {
            act.mouth(rng);
        }
        act.weights
    }
}

/// An expression in the making.
struct Act<'a> {
    asset: &'a HeadAsset,
    weights: Vec<f32>,
}

impl Act<'_> {
    /// The larger weight counts.
    fn set(&mut self, name: &str, weight: f32) {
        if let Some(k) = self.asset.expression(name) {
            self.weights[k] = f32::max(self.weights[k], weight.clamp(0.0, 1.15));
        }
    }

    /// Both sides, never quite alike, and now and then only one.
    fn both(&mut self, stem: &str, weight: f32, rng: &mut Rng) {
        let uneven = 0.12 * normal(rng);
        let (mut left, mut right) = (weight * (1.0 + uneven), weight * (1.0 - uneven));
        // A lid closes alone more often than anything else does: who winks shuts one eye and hardly moves the other.
        match rng.u8(..if stem == "eyeBlink" { 5 } else { 20 }) {
            0 => left = 0.0,
            1 => right = 0.0,
            _ => {}
        }
        self.set(&format!("{stem}_L"), left);
        self.set(&format!("{stem}_R"), right);
        // Those without sides.
        self.set(stem, weight);
    }

    fn brows(&mut self, rng: &mut Rng) {
        match rng.u8(..10) {
            0 | 1 => {
                self.both("browInnerUp", rng.f32(), rng);
                self.both("browOuterUp", 1.2 * rng.f32(), rng);
            }
            2 => self.both("browInnerUp", 0.5 + 0.6 * rng.f32(), rng),
            3 => self.both("browOuterUp", 0.5 + 0.6 * rng.f32(), rng),
            4 => self.both("browDown", 0.6 + 0.5 * rng.f32(), rng),
            5 => self.both("browDown", rng.f32(), rng),
            _ => {}
        }
    }

    fn eyes(&mut self, rng: &mut Rng) {
        match rng.u8(..20) {
            0..=3 => self.both("eyeBlink", 0.95 + 0.05 * rng.f32(), rng),
            4..=5 => self.both("eyeBlink", rng.f32(), rng),
            6..=9 => self.both("eyeWide", rng.f32() * 1.1, rng),
            10..=12 => self.both("eyeSquint", rng.f32(), rng),
            13 => self.both("eyeLookDown", rng.f32(), rng),
            14 => self.both("eyeLookUp", rng.f32(), rng),
            _ => {}
        }
        // To a side, both eyes together.
        if rng.f32() < 0.3 {
            let aside = rng.f32();
            let to_left = rng.bool();
            let [left, right] = if to_left {
                ["Out", "In"]
            } else {
                ["In", "Out"]
            };
            self.both(&format!("eyeLook{left}_L"), aside, rng);
            self.both(&format!("eyeLook{right}_R"), aside, rng);
        }
    }

    fn jaw(&mut self, rng: &mut Rng) {
        let jaw = match rng.u8(..10) {
            0 | 1 => 0.6 + 0.5 * rng.f32(),
            2..=4 => 0.6 * rng.f32(),
            5 | 6 => 0.25 * rng.f32(),
            _ => 0.0,
        };
        self.both("jawOpen", jaw, rng);
        if jaw > 0.1 && rng.f32() < 0.15 {
            self.both("mouthClose", jaw * rng.f32(), rng);
        }
    }

    /// One of what mouth, cheeks, nose and jaw do.
    fn mouth(&mut self, rng: &mut Rng) {
        let weight = rng.f32().sqrt();
        match rng.u8(..24) {
            0..=2 => {
                self.both("mouthSmile", weight, rng);
                self.both("cheekRaiser", 0.6 * weight * rng.f32(), rng);
            }
            3 => self.both("mouthFunnel", weight, rng),
            4 => self.both("mouthPucker", weight, rng),
            5 | 6 => self.both("mouthStretch", weight, rng),
            7 => self.both("mouthUpperUp", weight, rng),
            8 => self.both("mouthLowerDown", weight, rng),
            9 => {
                self.both("mouthShrugLower", weight, rng);
                self.both("mouthShrugUpper", rng.f32() * weight, rng);
            }
            10 => self.both("cheekPuff", weight, rng),
            11 => self.both("noseSneer", weight, rng),
            12 => self.both(if rng.bool() { "jawLeft" } else { "jawRight" }, weight, rng),
            13 => self.both("jawForward", weight, rng),
            14 | 15 => {
                self.both("mouthFrown", weight, rng);
                self.both("mouthShrugLower", rng.f32() * weight, rng);
            }
            16 => self.both("mouthDimple", weight, rng),
            17 => self.both("mouthPress", weight, rng),
            18 => {
                self.both("mouthRollLower", weight, rng);
                self.both("mouthRollUpper", weight, rng);
            }
            19 => self.both(
                if rng.bool() {
                    "mouthRollLower"
                } else {
                    "mouthRollUpper"
                },
                weight,
                rng,
            ),
            20 => self.both(
                if rng.bool() {
                    "mouthLeft"
                } else {
                    "mouthRight"
                },
                weight,
                rng,
            ),
            21 => self.both("cheekSquint", weight, rng),
            _ => {}
        }
    }
}

impl Scratch {
    fn new(asset: &HeadAsset) -> Self {
        let shape = Shape::bust([110.0, 115.0, 120.0]);
        Self {
            painter: HeadPainter::new(asset),
            bust: ShapePainter::new(shape),
            canvas: Canvas::new(1, 1),
            other: Canvas::new(1, 1),
            neutral: asset.neutral.clone(),
            grey: Vec::new(),
            spare: Vec::new(),
        }
    }
}

/// Mixes a face with the same one in another photograph: everywhere alike, also somewhat beyond either photograph, or
/// across the face from one to the other.
fn mix_skins(rng: &mut Rng, points: &[[f32; 2]; LANDMARKS], canvas: &mut Canvas, other: &Canvas) {
    let width = canvas.depth.width;
    let [x0, y0] = points[30];
    let size = (points[36][0] - points[45][0])
        .hypot(points[36][1] - points[45][1])
        .max(4.0);
    let even = rng.f32() < 0.5;
    let level = 1.6 * rng.f32() - 0.3;
    let (sin, cos) = (std::f32::consts::TAU * rng.f32()).sin_cos();
    let steep = (0.8 + 2.0 * rng.f32()) / size;
    let middle = 0.5 + 0.4 * either(rng);
    for (k, (own, other)) in canvas.rgb.iter_mut().zip(&other.rgb).enumerate() {
        let share = if even {
            level
        } else {
            let (x, y) = ((k % width) as f32 - x0, (k / width) as f32 - y0);
            (middle + steep * (x * cos + y * sin)).clamp(0.0, 1.0)
        };
        for (a, b) in own.iter_mut().zip(other) {
            let (from, to) = (f32::from(*a), f32::from(*b));
            *a = (from + share * (to - from) + 0.5).clamp(0.0, 255.0) as u8;
        }
    }
}

/// What was drawn in colour in grey, over the backdrop; sometimes as in the near infrared.
fn grey_of(rng: &mut Rng, canvas: &Canvas, out: &mut [f32]) {
    let infrared = (rng.f32() < 0.15).then(|| 0.6 + 0.6 * rng.f32());
    for (grey, (rgb, &inverse)) in out
        .iter_mut()
        .zip(canvas.rgb.iter().zip(&canvas.depth.inverse))
    {
        if inverse > 0.0 {
            *grey = f32::from(luma_of(*rgb));
            if let Some(red) = infrared {
                // In the near infrared skin is light and even, and lips hardly differ from it: as in the red channel.
                *grey += red * (f32::from(rgb[0]) - *grey);
            }
        }
    }
}

/// Beard, glasses, hair, headwear and what is before the face, each now and then.
fn wear(
    rng: &mut Rng,
    points: &[[f32; 2]; LANDMARKS],
    [width, height]: [usize; 2],
    scratch: &mut Scratch,
    visible: &mut [bool; LANDMARKS],
) {
    if rng.f32() < 0.2 {
        beard(
            rng,
            points,
            width,
            height,
            &mut scratch.grey,
            &mut scratch.spare,
        );
    }
    if rng.f32() < 0.15 {
        glasses(rng, points, width, height, &mut scratch.grey);
    }
    let mut picture = Picture {
        width,
        height,
        grey: &mut scratch.grey,
        visible,
    };
    if rng.f32() < 0.35 {
        mane(rng, points, &mut picture);
    }
    if rng.f32() < 0.15 {
        headwear(rng, points, &mut picture);
    }
    if rng.f32() < 0.22 {
        let cover: Cover = if rng.f32() < 0.35 { hand } else { block };
        cover(rng, points, width, height, &mut scratch.grey, visible);
    }
}

fn pose(rng: &mut Rng) -> Rigid {
    // The middle of the range somewhat denser than its ends.
    let mut angle = |range: f32| (range * either(rng) * (0.45 + 0.55 * rng.f32())).to_radians();
    let (yaw, pitch, roll) = (angle(44.0), angle(28.0), angle(22.0));
    let limit = |a: f32, degrees: f32| a.clamp(-degrees.to_radians(), degrees.to_radians());
    let z = 0.5 * 3.0f32.powf(rng.f32() * (0.6 + 0.4 * rng.f32()));
    Rigid::from_parts(
        Translation3::new(0.25 * z * either(rng), 0.18 * z * either(rng), z),
        rotation_from_yaw_pitch_roll(limit(yaw, 40.0), limit(pitch, 25.0), limit(roll, 20.0)),
    )
}

fn light(rng: &mut Rng) -> Light {
    let towards = Vector3::new(
        either(rng),
        0.9 * rng.f32() * either(rng) - 0.3,
        -0.25 - rng.f32(),
    )
    .normalize();
    let warm = 0.15 * normal(rng);
    let mut parts = [1.0; Part::COUNT];
    parts[Part::MouthSocket as usize] = 0.15 + 1.2 * rng.f32();
    parts[Part::Gums as usize] = 0.35 + 1.0 * rng.f32();
    parts[Part::Teeth as usize] = 0.4 + 0.75 * rng.f32();
    parts[Part::Eye as usize] = 0.85 + 0.3 * rng.f32();
    parts[Part::EyeSocket as usize] = 0.5 + 0.7 * rng.f32();
    Light {
        towards,
        ambient: 0.35 + 0.65 * rng.f32(),
        tint: [1.0 + warm, 1.0, 1.0 - warm],
        parts,
    }
}

/// Window around the points, wide enough for a start that is off by a third of a face.
fn crop(points: &[[f32; 2]; LANDMARKS], rng: &mut Rng) -> ([f32; 2], usize, usize) {
    let low = [0, 1].map(|k| points.iter().map(|p| p[k]).fold(f32::INFINITY, f32::min));
    let high = [0, 1].map(|k| {
        points
            .iter()
            .map(|p| p[k])
            .fold(f32::NEG_INFINITY, f32::max)
    });
    let size = (high[0] - low[0]).max(high[1] - low[1]);
    let mut margin = || size * (0.42 + 0.08 * rng.f32());
    let origin = [low[0] - margin(), low[1] - margin() - 0.1 * size].map(f32::floor);
    let end = [high[0] + margin(), high[1] + margin()];
    let [width, height] = [0, 1].map(|k| ((end[k] - origin[k]) as usize).clamp(16, 1024));
    (origin, width, height)
}

/// Random noise at several scales, so that nothing can be learned from a backdrop.
fn backdrop(rng: &mut Rng, width: usize, height: usize, grey: &mut Vec<f32>) {
    let base = 20.0 + 215.0 * rng.f32();
    let slope = [either(rng), either(rng)].map(|s| 60.0 * s / width.max(height) as f32);
    grey.clear();
    for row in 0..height {
        for col in 0..width {
            let (x, y) = (
                col as f32 - width as f32 * 0.5,
                row as f32 - height as f32 * 0.5,
            );
            grey.push(base + slope[0] * x + slope[1] * y);
        }
    }
    let loud = rng.f32() * 60.0;
    for cell in [61.0f32, 23.0, 8.0] {
        let amplitude = loud * rng.f32();
        let (columns, rows) = (
            (width as f32 / cell) as usize + 2,
            (height as f32 / cell) as usize + 2,
        );
        let lattice: Vec<f32> = (0..columns * rows)
            .map(|_| amplitude * either(rng))
            .collect();
        // Hard cells now and then: shelves, windows, door frames.
        let hard = rng.f32() < 0.3;
        for row in 0..height {
            let y = row as f32 / cell;
            let fy = if hard { 0.0 } else { y.fract() };
            let at = (y as usize) * columns;
            for col in 0..width {
                let x = col as f32 / cell;
                let fx = if hard { 0.0 } else { x.fract() };
                let k = at + x as usize;
                let upper = lattice[k] + fx * (lattice[k + 1] - lattice[k]);
                let lower =
                    lattice[k + columns] + fx * (lattice[k + columns + 1] - lattice[k + columns]);
                grey[row * width + col] += upper + fy * (lower - upper);
            }
        }
    }
}

/// Something in front of the face: a hand's or a cup's worth of flat or noisy grey.
fn block(
    rng: &mut Rng,
    points: &[[f32; 2]; LANDMARKS],
    width: usize,
    height: usize,
    grey: &mut [f32],
    visible: &mut [bool; LANDMARKS],
) {
    let face = (points[16][0] - points[0][0])
        .abs()
        .max((points[8][1] - points[27][1]).abs())
        .max(8.0);
    let at = points[rng.usize(..LANDMARKS)];
    let half = [0, 1].map(|_| face * (0.08 + 0.22 * rng.f32()));
    let (round, base, rough) = (
        rng.bool(),
        20.0 + 210.0 * rng.f32(),
        40.0 * rng.f32() * rng.f32(),
    );
    let covers = |x: f32, y: f32| {
        let (u, v) = ((x - at[0]) / half[0], (y - at[1]) / half[1]);
        if round {
            u * u + v * v < 1.0
        } else {
            u.abs() < 1.0 && v.abs() < 1.0
        }
    };
    for row in 0..height {
        for col in 0..width {
            if covers(col as f32, row as f32) {
                grey[row * width + col] = base + rough * either(rng);
            }
        }
    }
    for (point, visible) in points.iter().zip(visible) {
        *visible &= !covers(point[0], point[1]);
    }
}

/// Blur, exposure, gamma, noise.
fn develop(
    rng: &mut Rng,
    width: usize,
    height: usize,
    grey: &mut [f32],
    spare: &mut Vec<f32>,
) -> Vec<u8> {
    let sigma = 0.25 + 1.0 * rng.f32() * rng.f32();
    spare.clear();
    spare.resize(grey.len(), 0.0);
    let side = (-0.5 / (sigma * sigma)).exp();
    let far = (-2.0 / (sigma * sigma)).exp();
    let total = 1.0 + 2.0 * (side + far);
    let (middle, side, far) = (1.0 / total, side / total, far / total);
    for row in 0..height {
        let line = &grey[row * width..(row + 1) * width];
        let at = |k: usize| line[k.min(width - 1)];
        for col in 0..width {
            spare[row * width + col] = middle * line[col]
                + side * (at(col.saturating_sub(1)) + at(col + 1))
                + far * (at(col.saturating_sub(2)) + at(col + 2));
        }
    }
    let gain = (0.4f32.ln() + (1.35f32 / 0.4).ln() * rng.f32().sqrt()).exp();
    // A dim room, now and then.
    let gain = if rng.f32() < 0.12 {
        gain * (0.2 + 0.4 * rng.f32())
    } else {
        gain
    };
    let gamma = 0.75 + 0.55 * rng.f32();
    let curve: Vec<f32> = (0..=1023)
        .map(|v| 255.0 * (v as f32 / 1023.0 * 1.6).powf(gamma) * gain)
        .collect();
    let noise = 0.5 + 5.5 * rng.f32() * rng.f32();
    let mut luma = Vec::with_capacity(width * height);
    for row in 0..height {
        let line = |k: usize| k.min(height - 1) * width;
        let (a, b, c) = (
            line(row.saturating_sub(2)),
            line(row.saturating_sub(1)),
            row * width,
        );
        let (d, e) = (line(row + 1), line(row + 2));
        for col in 0..width {
            let value = middle * spare[c + col]
                + side * (spare[b + col] + spare[d + col])
                + far * (spare[a + col] + spare[e + col]);
            let level = (value.max(0.0) * (1023.0 / 255.0 / 1.6)) as usize;
            // Two uniforms: near enough to normal for noise, and cheap.
            let bits = rng.u32(..);
            let n = ((bits & 0xffff) as f32 + (bits >> 16) as f32) / 65536.0 - 1.0;
            luma.push((curve[level.min(1023)] + noise * 2.45 * n + 0.5).clamp(0.0, 255.0) as u8);
        }
    }
    luma
}
