//! The simulated sensor: people with known pose, expression and landmarks, drawn as the raw frames of a Kinect v1.
//!
//! Heads ([`HeadAsset`]) on shoulders, a hand and a room are drawn twice, as the depth camera and as the colour camera see
//! them, both through [`Camera`]; then the errors of the sensor are added (`noise`). The truth is handed out with the picture,
//! so that whatever is measured on a frame can be compared with it. A frame is a pure function of heads, scene, seed and
//! time: no state is carried over, and the same four give the same bytes.
//!
//! Two worlds: the plain one of the beginning (bald heads, a wall, a sensor with few faults), whose bytes tests rely on, and a
//! dressed one ([`Simulator::dressed`]: `appearance`) before a sensor with a real one's faults ([`Simulator::seen_by`]), which is
//! where `mien-studio evaluate --wild` measures.
//!
//! Memory: the heads, their work space and 12 MB of buffers, all made at construction. Limitations: no cast shadows of the
//! room's light, hair that does not swing, eyes that do not turn, shoulders that stay upright, one hand.
//! One file: what is drawn of a scene, in which order.

mod appearance;
mod asset;
pub(crate) mod body;
pub(crate) mod draw;
mod file;
mod noise;
mod random;
mod range;
pub(crate) mod raster;
mod script;

pub use appearance::{Beard, HairStyle, Headgear, Held, Look, Neck};
pub use asset::{Expression, HeadAsset, Part, Site, Texture};
pub use draw::Light;
pub use file::HeadFileError;
pub use script::Scene;

use crate::base::capacity::{HEIGHT, LANDMARKS, PIXELS, USERS, WIDTH};
use crate::base::geometry::{Point, Rigid, Rotation, Vector};
use crate::base::time::Timestamp;
use crate::sensor::Frame;
use crate::sensor::camera::Camera;
use crate::sensor::kinect::colour;
use crate::sensor::kinect::frame::{Developed, Original};
use appearance::{Outfit, OutfitPainter, Stuff};
use body::Shape;
use draw::{Canvas, HeadPainter, ShapePainter};
use noise::{DepthReading, RealReading, Tiles};
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

/// How far the cameras are from perfect ones; [`Sensor::default`] is what all scenes had from the beginning.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensor {
    /// Faults of the depth reading: 0 as from the beginning, 1 as a real Kinect's.
    pub faults: f32,
    /// The colour picture is taken so much later than the depth picture, seconds.
    pub colour_late_s: f32,
    /// Error of the registration: the colour picture lies so far off, pixels.
    pub colour_shift_px: [f32; 2],
    /// Radial distortion of the colour lens, of the square and the fourth power of the distance from its axis.
    pub distortion: [f32; 2],
    /// White balance: gain of red, green and blue.
    pub balance: [f32; 3],
    /// Noise of the colour sensor, grey levels.
    pub colour_sigma: f32,
    /// Pitch of the sensor about the person, radians: above 0 it stands higher and looks down.
    pub above: f32,
}

impl Default for Sensor {
    fn default() -> Self {
        Self {
            faults: 0.0,
            colour_late_s: 0.0,
            colour_shift_px: [0.0; 2],
            distortion: [0.0; 2],
            balance: [1.0; 3],
            colour_sigma: COLOUR_SIGMA,
            above: 0.0,
        }
    }
}

impl Sensor {
    /// Where the lens and the registration put what a perfect colour camera sees at a pixel.
    fn seen_at(&self, [x, y]: [f32; 2]) -> [f32; 2] {
        if *self == Self::default() {
            return [x, y];
        }
        let (dx, dy) = (x - 0.5 * WIDTH as f32, y - 0.5 * HEIGHT as f32);
        // Beyond the picture's corners the polynomial has no meaning.
        let r2 = ((dx * dx + dy * dy) / (COLOUR_FOCAL_PX * COLOUR_FOCAL_PX)).min(0.7);
        let [k1, k2] = self.distortion;
        let bend = r2 * (k1 + r2 * k2);
        let [sx, sy] = self.colour_shift_px;
        [x + dx * bend + sx, y + dy * bend + sy]
    }

    /// The world as this sensor sees it, from as a level one does: turned about where people sit.
    fn viewpoint(&self) -> Rigid {
        let turn = Rotation::from_axis_angle(&Vector::x_axis(), self.above);
        let seat = Vector::new(0.0, -0.02, 0.8);
        Rigid::from_parts((seat - turn * seat).into(), turn)
    }
}

/// Focal length of the colour camera, pixels: only for its distortion.
pub(crate) const COLOUR_FOCAL_PX: f32 = 525.0;

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
/// use mien::sensor::Frame;
/// use mien::simulator::virtual_head::{HeadAsset, Scene, Simulator};
/// use mien::base::time::Timestamp;
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
    /// Stand behind, and are nobody's truth.
    bystanders: Vec<Person>,
    hand: (Shape, ShapePainter),
    sensor: Sensor,
    real: Option<RealReading>,
    /// The room is furnished and people wear clothes and hair.
    dressed: bool,
    /// What each depth pixel shows.
    stuff: Vec<Stuff>,
    room_stuff: Vec<Stuff>,
    /// The room as both cameras see it, drawn once.
    room_depth: Vec<f32>,
    room_rgb: Vec<[u8; 3]>,
    depth: DepthBuffer,
    canvas: Canvas,
    blurred: Vec<[u8; 3]>,
    bayer: Box<[u8; PIXELS]>,
    drawn: u64,
}

/// One who can be drawn, and what was drawn of them last.
struct Person {
    asset: HeadAsset,
    head: HeadPainter,
    bust: (Shape, ShapePainter),
    /// Instead of the bust.
    worn: Option<(Outfit, OutfitPainter)>,
    /// What a hand holds, and whether it is there now.
    #[cfg(feature = "studio")]
    held: Option<(Held, Outfit, OutfitPainter, bool)>,
    weights: heapless::Vec<f32, EXPRESSIONS>,
    pose: Rigid,
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
            worn: None,
            #[cfg(feature = "studio")]
            held: None,
            weights: std::iter::repeat_n(0.0, expressions).collect(),
            pose: Rigid::identity(),
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
        let camera = crate::sensor::kinect::geometry::nominal();
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
            bystanders: Vec::new(),
            scene,
            seed,
            light,
            exposure: 1.0,
            reading: depth_reading(&camera),
            tiles: Tiles::new(seed),
            hand: (hand, hand_painter),
            sensor: Sensor::default(),
            real: None,
            dressed: false,
            stuff: vec![Stuff::Matt; PIXELS],
            room_stuff: vec![Stuff::Matt; PIXELS],
            room_depth: depth.inverse.clone(),
            room_rgb: canvas.rgb.clone(),
            depth,
            blurred: canvas.rgb.clone(),
            bayer: Original::default().bayer,
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

    /// Dresses the people, as far as there are looks, and furnishes the room.
    #[must_use]
    pub fn dressed(mut self, looks: impl IntoIterator<Item = Look>) -> Self {
        for (person, look) in self.people.iter_mut().zip(looks) {
            person.wear(&look);
            if look.bystander {
                let mut other = Person::new(person.asset.stretched(OTHERS[1]), CLOTHES[1]);
                other.wear(&Look {
                    seed: look.seed + 1,
                    hair: HairStyle::Short,
                    hair_colour: look.hair_colour,
                    clothes: CLOTHES[2],
                    ..Look::default()
                });
                self.bystanders.push(other);
            }
        }
        self.dressed = true;
        self.furnish();
        self
    }

    /// Sees all this through another sensor.
    #[must_use]
    pub fn seen_by(mut self, sensor: Sensor) -> Self {
        self.sensor = sensor;
        if sensor.faults > 0.0 {
            self.real = Some(RealReading::new(&self.tiles, self.seed));
        }
        if self.dressed {
            self.furnish();
        }
        self
    }

    /// Draws the room that belongs to dressed people.
    fn furnish(&mut self) {
        let (camera, sensor) = (&self.camera, self.sensor);
        let room = appearance::room(self.seed);
        let mut painter = OutfitPainter::new(&room);
        let view = sensor.viewpoint();
        painter.place(&room, &[], &view, &view);
        self.depth.inverse.fill(0.0);
        self.stuff.fill(Stuff::Matt);
        painter.draw_depth(
            &room,
            |p| camera.depth_pixel(p),
            &mut self.depth,
            &mut self.stuff,
        );
        self.canvas.depth.inverse.fill(0.0);
        self.canvas.rgb.fill([0; 3]);
        let seen = |p: &Point| sensor.seen_at(camera.colour_pixel(p));
        painter.draw_colour(&room, &self.light, seen, &mut self.canvas);
        self.room_depth.copy_from_slice(&self.depth.inverse);
        self.room_stuff.copy_from_slice(&self.stuff);
        self.room_rgb.copy_from_slice(&self.canvas.rgb);
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
    pub fn draw(&mut self, at: Timestamp, into: &mut impl Developed) -> Option<Truth> {
        let (frame, original) = into.parts();
        let t = (at.as_us() as f64 * 1e-6) as f32;
        self.begin();
        self.play(t, true);
        let hand = self.scene.hand(t);
        self.draw_depth(hand, at, frame);
        if self.sensor.colour_late_s > 0.0 {
            self.play(t + self.sensor.colour_late_s, false);
        }
        self.draw_colour(hand, at, frame);
        if let Some(original) = original {
            original.bayer.copy_from_slice(&*self.bayer);
        }
        self.people.iter().find_map(|person| person.truth.clone())
    }

    /// Puts everybody where the script has them; `truth`: notes them as the truth, else only those noted already move.
    fn play(&mut self, t: f32, truth: bool) {
        let (scene, seed) = (self.scene, self.seed);
        let view = self.sensor.viewpoint();
        for (number, person) in self.people.iter_mut().enumerate() {
            person.weights.fill(0.0);
            let (asset, weights) = (&person.asset, &mut person.weights);
            let instant = scene.play_person(number, seed, t, |name, weight| {
                if let Some(slot) = asset.expression(name).and_then(|k| weights.get_mut(k)) {
                    *slot = slot.max(weight);
                }
            });
            if let Some(instant) = instant {
                let pose = if self.sensor.above == 0.0 {
                    instant.sensor_from_head
                } else {
                    view * instant.sensor_from_head
                };
                if truth {
                    person.place(&pose, &view.rotation);
                } else if person.truth.is_some() {
                    person.pose(&pose, &view.rotation);
                }
                #[cfg(feature = "studio")]
                person.reach(t, &view.rotation);
            }
        }
        for (k, other) in self.bystanders.iter_mut().enumerate() {
            let pose = view * script::bystander(seed ^ k as u64, t);
            other.place(&pose, &view.rotation);
        }
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
        person.place(sensor_from_head, &self.sensor.viewpoint().rotation);
        self.draw_depth(None, at, frame);
        self.draw_colour(None, at, frame);
        let truth = self.people[0].truth.clone();
        truth.expect("somebody is drawn when a pose is given")
    }

    /// Nobody is there.
    fn begin(&mut self) {
        for person in &mut self.people {
            person.truth = None;
        }
    }

    /// Draws what the depth camera sees of those who are there, the hand, and the room around them.
    fn draw_depth(&mut self, hand: Option<Point>, at: Timestamp, frame: &mut Frame) {
        let camera = &self.camera;
        self.depth.inverse.copy_from_slice(&self.room_depth);
        self.stuff.copy_from_slice(&self.room_stuff);
        let depth_pixel = |p: &Point| camera.depth_pixel(p);
        let stuff = &mut self.stuff;
        let all = self.people.iter_mut().chain(&mut self.bystanders);
        for person in all.filter(|one| one.truth.is_some()) {
            let skin = |pixel| stuff[pixel] = Stuff::Skin;
            let head = &mut person.head;
            head.draw_depth(&person.asset, depth_pixel, &mut self.depth, skin);
            if let Some((outfit, painter)) = &mut person.worn {
                painter.draw_depth(outfit, depth_pixel, &mut self.depth, stuff);
                #[cfg(feature = "studio")]
                if let Some((_, outfit, painter, true)) = &mut person.held {
                    painter.draw_depth(outfit, depth_pixel, &mut self.depth, stuff);
                }
            } else {
                let (shape, painter) = &mut person.bust;
                painter.draw_depth(shape, depth_pixel, &mut self.depth);
            }
        }
        if let Some(hand) = hand {
            let (shape, painter) = &mut self.hand;
            painter.place(shape, &Rigid::translation(hand.x, hand.y, hand.z));
            painter.draw_depth(shape, depth_pixel, &mut self.depth);
        }
        let seed = random::hash(self.seed, at.as_us());
        let (reading, seen) = (&self.reading, &self.depth.inverse);
        match &mut self.real {
            Some(real) if self.sensor.faults > 0.0 => real.read(
                reading,
                self.sensor.faults,
                seen,
                &self.stuff,
                &self.tiles,
                seed,
                &mut frame.depth,
            ),
            _ => reading.read(seen, &self.tiles, seed, &mut frame.depth),
        }
    }

    /// Likewise the colour camera.
    fn draw_colour(&mut self, hand: Option<Point>, at: Timestamp, frame: &mut Frame) {
        let (camera, sensor) = (&self.camera, self.sensor);
        self.canvas.rgb.copy_from_slice(&self.room_rgb);
        // Everything in front of the room: its own depth buffer starts empty.
        self.canvas.depth.inverse.fill(0.0);
        let mut window = Window::NOTHING;
        let colour_pixel = |p: &Point| sensor.seen_at(camera.colour_pixel(p));
        for person in self.people.iter_mut().chain(&mut self.bystanders) {
            let (asset, head) = (&person.asset, &mut person.head);
            let Some(truth) = &mut person.truth else {
                continue;
            };
            head.light(asset, &self.light);
            window.include(head.draw_colour(asset, &self.light, colour_pixel, &mut self.canvas));
            window.include(if let Some((outfit, painter)) = &mut person.worn {
                painter.draw_colour(outfit, &self.light, colour_pixel, &mut self.canvas)
            } else {
                let (shape, painter) = &mut person.bust;
                painter.draw_colour(shape, &self.light, colour_pixel, &mut self.canvas)
            });
            #[cfg(feature = "studio")]
            if let Some((_, outfit, painter, true)) = &mut person.held {
                let (light, canvas) = (&self.light, &mut self.canvas);
                window.include(painter.draw_colour(outfit, light, colour_pixel, canvas));
            }
            truth.landmarks_px = asset
                .landmarks_on(&head.deformed)
                .map(|p| colour_pixel(&(person.pose * p)));
        }
        if hand.is_some() {
            let (shape, painter) = &mut self.hand;
            window.include(painter.draw_colour(shape, &self.light, colour_pixel, &mut self.canvas));
        }
        if self.dressed {
            window = Window {
                left: 0,
                top: 0,
                right: WIDTH,
                bottom: HEIGHT,
            };
        }
        blur(&mut self.canvas.rgb, window, &mut self.blurred);
        let seed = random::hash(self.seed, at.as_us());
        noise::expose(
            &self.canvas.rgb,
            sensor.balance.map(|gain| gain * self.exposure),
            sensor.colour_sigma,
            &self.tiles,
            seed,
            &mut self.bayer,
        );
        colour::luma_from_bayer(&self.bayer, &mut frame.luma);
        frame.index = self.drawn;
        frame.at = at;
        self.drawn += 1;
    }
}

impl Person {
    /// Puts on clothes, hair and things.
    fn wear(&mut self, look: &Look) {
        let outfit = Outfit::worn(&self.asset, look);
        let painter = OutfitPainter::new(&outfit);
        self.worn = Some((outfit, painter));
        #[cfg(feature = "studio")]
        if look.held != Held::None {
            let held = Outfit::held(look);
            let painter = OutfitPainter::new(&held);
            self.held = Some((look.held, held, painter, false));
        }
    }

    /// Brings the hand to where it is at `t` seconds.
    #[cfg(feature = "studio")]
    fn reach(&mut self, t: f32, tilt: &Rotation) {
        if let Some((held, outfit, painter, there)) = &mut self.held {
            let place = held.at(t);
            *there = place.is_some();
            if let Some(place) = place {
                let turn = self.pose.rotation;
                // It meets the face wherever that is turned, but comes from below.
                let up = Vector::new(place.x, place.y.min(0.15), place.z);
                let rest = Vector::new(0.0, place.y - up.y, 0.0);
                let at = self.pose.translation.vector + turn * up + tilt * rest;
                let pose = Rigid::from_parts(at.into(), *tilt);
                painter.place(outfit, &[], &pose, &pose);
            }
        }
    }

    /// Sets the pose, and notes it as the truth; the expression is in `weights`.
    fn place(&mut self, sensor_from_head: &Rigid, tilt: &Rotation) {
        self.pose(sensor_from_head, tilt);
        self.truth = Some(Truth {
            sensor_from_head: *sensor_from_head,
            landmarks_head: self.asset.landmarks_on(&self.head.deformed),
            landmarks_px: [[0.0; 2]; LANDMARKS],
            activations: self.weights.clone(),
        });
    }

    fn pose(&mut self, sensor_from_head: &Rigid, tilt: &Rotation) {
        self.pose = *sensor_from_head;
        let torso = if *tilt == Rotation::identity() {
            draw::shoulders_below(sensor_from_head)
        } else {
            draw::shoulders_tilted(sensor_from_head, tilt)
        };
        self.asset.deform(&self.weights, &mut self.head.deformed);
        self.head.place_above(sensor_from_head, &torso);
        if let Some((outfit, painter)) = &mut self.worn {
            painter.place(outfit, &self.head.deformed, sensor_from_head, &torso);
        } else {
            let (shape, painter) = &mut self.bust;
            painter.place(shape, &torso);
        }
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
