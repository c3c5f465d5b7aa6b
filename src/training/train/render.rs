//! Rendered training pictures: heads with random shape, expression, pose, light and camera, cropped around the face,
//! with their full truth.
//!
//! Varied are identity (shape between and beyond two people's, noise of half a sigma per mode, 3.5 % of scale per
//! axis, a smooth quadratic warp; skin mixed from both photographs, evenly or locally, also extrapolated, which
//! multiplies a hundred people), expression (several at once, unequal sides, a fifth neutral), pose (yaw ±40°, pitch
//! ±25°, roll ±20°), distance (0.5 to 1.5 m, so that a face is 50 to 200 colour pixels wide), light, exposure, gamma,
//! blur, noise, backdrop, mouth interior, near-infrared greys, beards, glasses, hair, headwear, hands and other
//! occluders. Half of the pictures are of the mirrored head, through the same camera, so that pose and pixels stay
//! exactly consistent. Sample `i` of a seed does not depend on the other samples or the number of threads. Points are
//! of the rendered head: fixed positions on the mesh, hidden ones included, with a flag. Limitation: hair and
//! headwear are painted flat (`hair_and_headwear`). All steps of a picture draw from one stream of random numbers, in
//! this order.

use std::ops::Range;
use std::path::Path;

use fastrand::Rng;
use image::GrayImage;
use nalgebra::{Translation3, Vector3};
use rayon::prelude::*;

use super::acting::expression;
use super::grey_picture::Picture;
use super::photograph::{backdrop, mix_skins, photographed, to_grey};
use super::random::{either, normal};
use super::shape::{mirrored, quadratic};
use super::worn::wear;
use mien_baking::heads::ict::{Delta, IctHead};
use mien_baking::heads::reduce::Reduction;
use mien_baking::heads::reshape::reshape;
use mien_baking::heads::{PersonHead, eyes, plain_head, textured_heads};
use mien_simulator::virtual_head::body::Shape;
use mien_simulator::virtual_head::draw::{Canvas, HeadPainter, ShapePainter, shoulders_below};
use mien_simulator::virtual_head::{HeadAsset, Light, Part, Points};
use mien_stages::base::capacity::LANDMARKS;
use mien_stages::base::geometry::{Point, Rigid, Rotation, Vector, rotation_from_yaw_pitch_roll};
use mien_stages::camera::Camera;
use mien_workbench::fault::Fault;
use mien_workbench::progress::Progress;

/// A picture with its truth.
pub struct TrainingSample {
    /// The crop.
    pub grey: GrayImage,
    /// Colour pixel of the crop's first pixel: crop pixel + origin = `Camera::colour_pixel` of the point.
    pub origin: [f32; 2],
    /// The 68 points, crop pixels.
    pub points: Points,
    /// The 68 points in the head frame, metres, expression included.
    pub head: [Point; LANDMARKS],
    /// The 68 points of the same head without expression.
    pub neutral: [Point; LANDMARKS],
    /// Whether each point is unoccluded.
    pub visible: [bool; LANDMARKS],
    /// Pose of the head.
    pub sensor_from_head: Rigid,
}

/// Draws training pictures of a set of people.
pub struct Renderer {
    /// The people.
    pub heads: Vec<PersonHead>,
    identities: Vec<Vec<Vector>>,
    camera: Camera,
}

/// One in this many heads is duplicated with synthetic eyes.
const EYES_PAINTED: usize = 5;
/// One in this many heads is duplicated with the shape of another age.
const RESHAPED: usize = 3;
/// Share of the pictures whose person is mixed of two.
const MIXED: f32 = 0.75;

struct Scratch {
    painter: HeadPainter,
    bust: ShapePainter,
    canvas: Canvas,
    /// The same head with another person's photograph.
    other: Canvas,
    neutral: Vec<Point>,
    grey: Vec<f32>,
    spare: Vec<f32>,
}

impl Renderer {
    /// Prepares the heads of the persons that `keep` accepts, `most` at most; one in [`RESHAPED`] is duplicated with one of the
    /// `shapes`. `data` is the folder of the data sets.
    ///
    /// # Errors
    /// If mesh or portraits cannot be read.
    pub fn new(
        data: &Path,
        keep: impl Fn(usize) -> bool,
        most: usize,
        shapes: &[Delta],
    ) -> Result<Self, Fault> {
        let mut heads = textured_heads(data, keep, most)?;
        // A photograph's irises are half hidden by its lids and hardly visibly rotate, so some people are duplicated
        // with synthetic eyes. If all had them, the lids of real people in infrared would be found worse.
        for one in (0..heads.len()).step_by(EYES_PAINTED) {
            let mut head = heads[one].clone();
            eyes::paint(&mut head.asset, one as u64);
            heads.push(head);
        }
        let mut reshaped: Vec<_> = match shapes {
            [] => Vec::new(),
            _ => heads.iter().step_by(RESHAPED).cloned().collect(),
        };
        reshape(&mut reshaped, shapes, 1, data)?;
        let ict = IctHead::read(&data.join("ict_facekit"))?;
        let plain = plain_head(&ict);
        let reduction = Reduction::new(&plain);
        let first = reduction.apply(&plain);
        for head in &mut heads {
            head.asset = reduction.apply_like(&head.asset, &first);
        }
        for head in &mut reshaped {
            head.asset = reduction.apply(&head.asset);
        }
        heads.append(&mut reshaped);
        let identities = ict.identities.iter();
        let identities = identities.map(|mode| reduction.pick(&mode.offsets));
        Ok(Self {
            heads,
            identities: identities.collect(),
            camera: mien_sensors::kinect::geometry::nominal(),
        })
    }

    /// Renders the samples with these numbers, on all threads; empty without heads.
    pub fn samples(&self, numbers: Range<u64>, seed: u64) -> Vec<TrainingSample> {
        self.each_sample(numbers, seed, |sample| sample)
    }

    /// What `map` makes of each of the samples; see [`Self::samples`].
    pub fn each_sample<T: Send>(
        &self,
        numbers: Range<u64>,
        seed: u64,
        map: impl Fn(TrainingSample) -> T + Sync,
    ) -> Vec<T> {
        let Some(first) = self.heads.first() else {
            return Vec::new();
        };
        let progress = Progress::new("train: faces", numbers.clone().count());
        let draw = |scratch: &mut Scratch, number| {
            let made = map(self.sample(number, seed, scratch));
            progress.step();
            made
        };
        let all = numbers.into_par_iter();
        all.map_init(|| Scratch::new(&first.asset), draw).collect()
    }

    fn sample(&self, number: u64, seed: u64, scratch: &mut Scratch) -> TrainingSample {
        let mut rng = Rng::with_seed(seed ^ (number + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15));
        let asset = &self.heads[rng.usize(..self.heads.len())].asset;
        let other = &self.heads[rng.usize(..self.heads.len())].asset;
        let mixed = rng.f32() < MIXED;
        let [neutral, points_head] = self.face(asset, mixed.then_some(other), &mut rng, scratch);
        let painter = &mut scratch.painter;
        let sensor_from_head = pose(&mut rng);
        painter.place_deformed(&sensor_from_head);
        let light = light(&mut rng);
        painter.light(asset, &light);

        let seen = points_head.map(|p| self.camera.colour_pixel(&(sensor_from_head * p)));
        let (origin, width, height) = crop(&seen, &mut rng);
        let points = seen.map(|[x, y]| [x - origin[0], y - origin[1]]);
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
            mix_skins(&mut rng, &points, canvas, &scratch.other);
        }
        let bust = &mut scratch.bust;
        shoulders(&mut rng, bust, &sensor_from_head, &light, pixel, canvas);
        let depths = points_head.map(|p| (sensor_from_head * p).z);
        let mut visible = visible(&points, &depths, canvas, height);

        backdrop(&mut rng, width, height, &mut scratch.grey);
        to_grey(&mut rng, canvas, &mut scratch.grey);
        let mut picture = Picture {
            width,
            grey: &mut scratch.grey,
            points: &points,
            visible: &mut visible,
        };
        wear(&mut rng, &mut picture);
        let spare = &mut scratch.spare;
        let luma = photographed(&mut rng, width, height, &mut scratch.grey, spare);
        TrainingSample {
            grey: GrayImage::from_raw(width as u32, height as u32, luma).expect("a byte a pixel"),
            origin,
            points,
            head: points_head,
            neutral,
            visible,
            sensor_from_head,
        }
    }

    /// Composes a face with an expression, sometimes mirrored, in `scratch`, between two people if there is another
    /// one. Returns the landmarks in the head frame, at rest and with the expression.
    fn face(
        &self,
        asset: &HeadAsset,
        other: Option<&HeadAsset>,
        rng: &mut Rng,
        scratch: &mut Scratch,
    ) -> [[Point; LANDMARKS]; 2] {
        let weights = expression(asset, rng);
        // Between two people, or somewhat beyond either.
        let (share, other) = match other {
            Some(other) => (1.4 * rng.f32() - 0.2, other),
            None => (0.0, asset),
        };
        let both = asset.neutral.iter().zip(&other.neutral);
        for (p, (a, b)) in scratch.neutral.iter_mut().zip(both) {
            *p = a + (b - a) * share;
        }
        self.shape(asset, rng, &mut scratch.neutral);
        let mut neutral_points = asset.landmarks_on(&scratch.neutral);
        let painter = &mut scratch.painter;
        painter.deformed.copy_from_slice(&scratch.neutral);
        asset.express(&weights, &mut painter.deformed);
        let mut points_head = asset.landmarks_on(&painter.deformed);
        painter.mirrored = rng.bool();
        if painter.mirrored {
            for p in &mut painter.deformed {
                p.x = -p.x;
            }
            points_head = mirrored(&points_head);
            neutral_points = mirrored(&neutral_points);
        }
        [neutral_points, points_head]
    }

    /// Varies a shape; the origin stays between the inner eye corners.
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
            let terms = quadratic(&q);
            for axis in 0..3 {
                let warp: f32 = bend[axis].iter().zip(terms).map(|(b, t)| b * t).sum();
                p[axis] = q[axis] * scale[axis] + warp;
            }
        }
        let corners = [39, 42].map(|k| asset.landmarks[k].position(out));
        let origin = nalgebra::center(&corners[0], &corners[1]).coords;
        for p in out.iter_mut() {
            *p -= origin;
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

/// Whether each point is unoccluded, by its distance in metres.
fn visible(
    points: &Points,
    depths: &[f32; LANDMARKS],
    canvas: &Canvas,
    height: usize,
) -> [bool; LANDMARKS] {
    let depth = &canvas.depth;
    std::array::from_fn(|k| {
        let [col, row] = points[k].map(|at| at.round() as usize);
        let nearest = depth.inverse[row.min(height - 1) * depth.width + col.min(depth.width - 1)];
        nearest <= 1.0 / (depths[k] - 0.006)
    })
}

/// Occasional shoulders below a head, in clothes of random colour.
fn shoulders(
    rng: &mut Rng,
    bust: &mut ShapePainter,
    sensor_from_head: &Rigid,
    light: &Light,
    pixel: impl Fn(&Point) -> [f32; 2],
    canvas: &mut Canvas,
) {
    if rng.f32() < 0.75 {
        bust.place(&shoulders_below(sensor_from_head, &Rotation::identity()));
        let mut clothes = *light;
        let dye = rng.f32() * 2.2;
        clothes.tint = light.tint.map(|t| t * dye * (0.7 + 0.6 * rng.f32()));
        bust.draw_colour(&clothes, pixel, canvas);
    }
}

fn pose(rng: &mut Rng) -> Rigid {
    // The middle of the range is sampled more densely than its ends.
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
    let (x, y) = (either(rng), 0.9 * rng.f32() * either(rng) - 0.3);
    let towards = Vector3::new(x, y, -0.25 - rng.f32()).normalize();
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
fn crop(points: &Points, rng: &mut Rng) -> ([f32; 2], usize, usize) {
    let all = |k: usize| points.iter().map(move |p| p[k]);
    let low = [0, 1].map(|k| all(k).fold(f32::INFINITY, f32::min));
    let high = [0, 1].map(|k| all(k).fold(f32::NEG_INFINITY, f32::max));
    let size = (high[0] - low[0]).max(high[1] - low[1]);
    let mut margin = || size * (0.42 + 0.08 * rng.f32());
    let origin = [low[0] - margin(), low[1] - margin() - 0.1 * size].map(f32::floor);
    let end = [high[0] + margin(), high[1] + margin()];
    let [width, height] = [0, 1].map(|k| ((end[k] - origin[k]) as usize).clamp(16, 1024));
    (origin, width, height)
}
