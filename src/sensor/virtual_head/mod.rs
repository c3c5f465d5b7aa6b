//! The simulated sensor: people with known pose, expression and landmarks, drawn as the raw frames of a Kinect v1.
//!
//! Heads ([`HeadAsset`]) on shoulders, a hand and a room are drawn twice, as the depth camera and as the colour camera see
//! them, both through [`Camera`]; then the errors of the sensor are added (`noise`). The truth is handed out with the picture,
//! so that whatever is measured on a frame can be compared with it. A frame is a pure function of heads, scene, seed and
//! time: no state is carried over, and the same four give the same bytes.
//!
//! Memory: the heads, their work space and 8 MB of buffers, all made at construction. Limitations: no hair that stands off
//! the head, no cast shadows of the room's light, eyes that do not turn, shoulders that stay upright, one hand.

mod asset;
pub(crate) mod body;
pub(crate) mod draw;
mod file;
mod noise;
mod raster;
mod script;

pub use asset::{Expression, HeadAsset, Part, Site, Texture};
pub use draw::Light;
pub use file::HeadFileError;
pub use script::Scene;

use crate::capacity::{HEIGHT, LANDMARKS, USERS, WIDTH};
use crate::geometry::{Point, Rigid};
use crate::sensor::camera::Camera;
use crate::sensor::{Frame, colour};
use crate::time::Timestamp;
use body::Shape;
use draw::{Canvas, HeadPainter, ShapePainter};
use noise::{DepthReading, Tiles};
use raster::{DepthBuffer, Window};

/// Expressions a head may have.
pub const EXPRESSIONS: usize = 64;
/// Distance of the wall, metres.
const WALL_M: f32 = 2.2;
/// Grey levels of the colour sensor's noise, one standard deviation.
const COLOUR_SIGMA: f32 = 2.0;

/// What was drawn.
#[derive(Clone, Debug)]
pub struct Truth {
    /// Pose of the head.
    pub sensor_from_head: Rigid,
    /// The 68 points in the head frame, metres, expression included.
    pub landmarks_head: [Point; LANDMARKS],
    /// The 68 points in colour pixels, hidden ones included.
    pub landmarks_px: [[f32; 2]; LANDMARKS],
    /// Weight of each expression of the asset, in its order.
    pub activations: heapless::Vec<f32, EXPRESSIONS>,
}

/// Raw depth as a function of 1/z, which it is linear in: the simulator needs no more of the camera's tables.
fn depth_reading(camera: &Camera) -> DepthReading {
    let (near, far) = (0.5, 4.0);
    let (a, b) = (camera.raw_from_m(near), camera.raw_from_m(far));
    let raw_per_inverse = (a - b) / (1.0 / near - 1.0 / far);
    DepthReading {
        raw_far: b - raw_per_inverse / far,
        raw_per_inverse,
    }
}

/// Draws frames of one scene.
///
/// ```no_run
/// use mien::sensor::{Frame, virtual_head::{HeadAsset, Scene, Simulator}};
/// use mien::time::Timestamp;
/// let mut simulator = Simulator::new(HeadAsset::default(), Scene::Acted, 1);
/// let mut frame = Frame::default();
/// if let Some(truth) = simulator.draw(Timestamp::from_us(33_333), &mut frame) {
///     println!("{:?}", truth.sensor_from_head);
/// }
/// ```
pub struct Simulator {
    scene: Scene,
    seed: u64,
    light: Light,
    exposure: f32,
    camera: Camera,
    reading: DepthReading,
    tiles: Tiles,
    people: Vec<Person>,
    hand: (Shape, ShapePainter),
    /// The room as both cameras see it, drawn once.
    room_depth: Vec<f32>,
    room_rgb: Vec<[u8; 3]>,
    depth: DepthBuffer,
    canvas: Canvas,
    blurred: Vec<[u8; 3]>,
    drawn: u64,
}

/// One who can be drawn, and what was drawn of them last.
struct Person {
    asset: HeadAsset,
    head: HeadPainter,
    bust: (Shape, ShapePainter),
    weights: heapless::Vec<f32, EXPRESSIONS>,
    truth: Option<Truth>,
}

impl Person {
    fn new(asset: HeadAsset, clothes: [f32; 3]) -> Self {
        let bust = Shape::bust(clothes);
        let painter = ShapePainter::new(&bust);
        let expressions = asset.expressions.len().min(EXPRESSIONS);
        Self {
            head: HeadPainter::new(&asset),
            bust: (bust, painter),
            weights: std::iter::repeat_n(0.0, expressions).collect(),
            truth: None,
            asset,
        }
    }
}

/// Colours of the clothes, by person.
const CLOTHES: [[f32; 3]; USERS] = [
    [70.0, 85.0, 120.0],
    [130.0, 80.0, 70.0],
    [80.0, 110.0, 75.0],
    [105.0, 95.0, 60.0],
];
/// How the shipped head is stretched to be somebody else: width, height, depth.
const OTHERS: [[f32; 3]; USERS] = [
    [1.0; 3],
    [0.94, 1.05, 0.98],
    [1.06, 0.97, 1.04],
    [0.96, 0.95, 1.02],
];

impl Simulator {
    /// Prepares a scene with the nominal camera. Expressions of the asset beyond [`EXPRESSIONS`] stay at 0. Where a scene has
    /// several people, the others have the same head, stretched; see [`Simulator::joined_by`].
    #[must_use]
    pub fn new(asset: HeadAsset, scene: Scene, seed: u64) -> Self {
        let camera = Camera::nominal();
        let light = Light::default();
        let room = Shape::room(
            WALL_M,
            scene == Scene::Empty,
            scene == Scene::Furnished,
            seed,
        );
        let mut painter = ShapePainter::new(&room);
        let mut depth = DepthBuffer::new(WIDTH, HEIGHT);
        let mut canvas = Canvas::new(WIDTH, HEIGHT);
        painter.draw_depth(&room, |p| camera.depth_pixel(p), &mut depth);
        painter.draw_colour(&room, &light, |p| camera.colour_pixel(p), &mut canvas);
        let hand = Shape::hand([205.0, 160.0, 135.0]);
        let hand_painter = ShapePainter::new(&hand);
        let people = (0..scene.people())
            .map(|k| match k {
                0 => Person::new(asset.clone(), CLOTHES[0]),
                _ => Person::new(asset.stretched(OTHERS[k]), CLOTHES[k]),
            })
            .collect();
        Self {
            people,
            scene,
            seed,
            light,
            exposure: 1.0,
            reading: depth_reading(&camera),
            tiles: Tiles::new(seed),
            hand: (hand, hand_painter),
            room_depth: depth.inverse.clone(),
            room_rgb: canvas.rgb.clone(),
            depth,
            blurred: canvas.rgb.clone(),
            canvas,
            camera,
            drawn: 0,
        }
    }

    /// Gives the second and later people of the scene heads of their own, as far as there are both.
    #[must_use]
    pub fn joined_by(mut self, others: impl IntoIterator<Item = HeadAsset>) -> Self {
        for (k, (person, asset)) in self.people.iter_mut().skip(1).zip(others).enumerate() {
            *person = Person::new(asset, CLOTHES[k + 1]);
        }
        self
    }

    /// Changes the light and the exposure (1 = as photographed).
    #[must_use]
    pub fn lit(mut self, light: Light, exposure: f32) -> Self {
        self.set_light(light, exposure);
        self
    }

    /// As [`Simulator::lit`], in the middle of a scene.
    pub fn set_light(&mut self, light: Light, exposure: f32) {
        self.light = light;
        self.exposure = exposure;
    }

    /// The camera that the frames are drawn with.
    #[must_use]
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// The head of the first person.
    #[must_use]
    pub fn asset(&self) -> &HeadAsset {
        &self.people[0].asset
    }

    /// What the last frame shows of each person; `None` for those who are not there.
    pub fn truths(&self) -> impl ExactSizeIterator<Item = Option<&Truth>> {
        self.people.iter().map(|person| person.truth.as_ref())
    }

    /// Draws the scene at a time. The truth is that of the first person who is there, `None` when nobody is; the others'
    /// are in [`Simulator::truths`]. Sets all of the frame; its index counts the frames drawn.
    pub fn draw(&mut self, at: Timestamp, frame: &mut Frame) -> Option<Truth> {
        let t = (at.as_us() as f64 * 1e-6) as f32;
        self.begin();
        let (scene, seed) = (self.scene, self.seed);
        for (number, person) in self.people.iter_mut().enumerate() {
            person.weights.fill(0.0);
            let (asset, weights) = (&person.asset, &mut person.weights);
            let instant = scene.play_person(number, seed, t, |name, weight| {
                if let Some(slot) = asset.expression(name).and_then(|k| weights.get_mut(k)) {
                    *slot = slot.max(weight);
                }
            });
            if let Some(instant) = instant {
                person.place(&instant.sensor_from_head);
            }
        }
        let hand = scene.hand(t);
        self.finish(hand, at, frame);
        self.people.iter().find_map(|person| person.truth.clone())
    }

    /// Draws the first person with any pose and expression (`weights` in the order of the asset's expressions), and nobody
    /// else, instead of the script's.
    pub fn draw_pose(
        &mut self,
        sensor_from_head: &Rigid,
        weights: &[f32],
        at: Timestamp,
        frame: &mut Frame,
    ) -> Truth {
        self.begin();
        let person = &mut self.people[0];
        person.weights.fill(0.0);
        for (slot, &weight) in person.weights.iter_mut().zip(weights) {
            *slot = weight;
        }
        person.place(sensor_from_head);
        self.finish(None, at, frame);
        let truth = self.people[0].truth.clone();
        truth.expect("somebody is drawn when a pose is given")
    }

    /// Nobody is there.
    fn begin(&mut self) {
        for person in &mut self.people {
            person.truth = None;
        }
    }

    /// Draws those who are there, the hand, and the room around them.
    fn finish(&mut self, hand: Option<Point>, at: Timestamp, frame: &mut Frame) {
        let camera = &self.camera;
        self.depth.inverse.copy_from_slice(&self.room_depth);
        self.canvas.rgb.copy_from_slice(&self.room_rgb);
        // Everything in front of the room: its own depth buffer starts empty.
        self.canvas.depth.inverse.fill(0.0);
        let mut window = Window::NOTHING;
        let depth_pixel = |p: &Point| camera.depth_pixel(p);
        let colour_pixel = |p: &Point| camera.colour_pixel(p);
        for person in &mut self.people {
            let (asset, head) = (&person.asset, &mut person.head);
            let Some(truth) = &mut person.truth else {
                continue;
            };
            let (shape, painter) = &mut person.bust;
            painter.place(shape, &draw::shoulders_below(&truth.sensor_from_head));
            head.draw_depth(asset, depth_pixel, &mut self.depth);
            painter.draw_depth(shape, depth_pixel, &mut self.depth);
            head.light(asset, &self.light);
            window.include(head.draw_colour(asset, &self.light, colour_pixel, &mut self.canvas));
            window.include(painter.draw_colour(shape, &self.light, colour_pixel, &mut self.canvas));
            truth.landmarks_px = truth
                .landmarks_head
                .map(|p| camera.colour_pixel(&(truth.sensor_from_head * p)));
        }
        if let Some(hand) = hand {
            let (shape, painter) = &mut self.hand;
            painter.place(shape, &Rigid::translation(hand.x, hand.y, hand.z));
            painter.draw_depth(shape, depth_pixel, &mut self.depth);
            window.include(painter.draw_colour(shape, &self.light, colour_pixel, &mut self.canvas));
        }
        blur(&mut self.canvas.rgb, window, &mut self.blurred);
        let seed = noise::hash(self.seed, at.as_us());
        self.reading
            .read(&self.depth.inverse, &self.tiles, seed, &mut frame.depth);
        noise::expose(
            &self.canvas.rgb,
            self.exposure,
            COLOUR_SIGMA,
            &self.tiles,
            seed,
            &mut frame.bayer,
        );
        colour::luma_from_bayer(&frame.bayer, &mut frame.luma);
        frame.index = self.drawn;
        frame.at = at;
        self.drawn += 1;
    }
}

impl Person {
    /// Sets the pose; the expression is in `weights`.
    fn place(&mut self, sensor_from_head: &Rigid) {
        self.head
            .place(&self.asset, &self.weights, sensor_from_head);
        self.truth = Some(Truth {
            sensor_from_head: *sensor_from_head,
            landmarks_head: self.asset.landmarks_on(&self.head.deformed),
            landmarks_px: [[0.0; 2]; LANDMARKS],
            activations: self.weights.clone(),
        });
    }
}

/// The lens's softness: a 3 × 3 binomial over the window, through `scratch`.
fn blur(rgb: &mut [[u8; 3]], window: Window, scratch: &mut [[u8; 3]]) {
    let (left, right) = (window.left.max(1), window.right.min(WIDTH - 1));
    let (top, bottom) = (window.top.max(1), window.bottom.min(HEIGHT - 1));
    if left >= right || top >= bottom {
        return;
    }
    let sum = |a: u8, b: u8, c: u8, half: u16| {
        ((u16::from(a) + 2 * u16::from(b) + u16::from(c) + half) / 4) as u8
    };
    let count = right - left;
    for row in top - 1..=bottom {
        let at = row * WIDTH + left;
        let line = &rgb[at - 1..at + count + 1];
        for (out, near) in scratch[at..at + count].iter_mut().zip(line.windows(3)) {
            let (a, b, c) = (near[0], near[1], near[2]);
            *out = [
                sum(a[0], b[0], c[0], 0),
                sum(a[1], b[1], c[1], 0),
                sum(a[2], b[2], c[2], 0),
            ];
        }
    }
    for row in top..bottom {
        let at = row * WIDTH + left;
        let (above, here, below) = (
            &scratch[at - WIDTH..][..count],
            &scratch[at..][..count],
            &scratch[at + WIDTH..][..count],
        );
        for (k, out) in rgb[at..at + count].iter_mut().enumerate() {
            let (a, b, c) = (above[k], here[k], below[k]);
            *out = [
                sum(a[0], b[0], c[0], 2),
                sum(a[1], b[1], c[1], 2),
                sum(a[2], b[2], c[2], 2),
            ];
        }
    }
}

#[cfg(test)]
mod tests;
