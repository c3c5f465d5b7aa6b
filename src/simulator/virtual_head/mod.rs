//! The simulated sensor: people with known pose, expression and landmarks, drawn as raw frames of a Kinect v1.
//!
//! Heads ([`HeadAsset`]) on shoulders, a hand and a room are drawn twice, for the depth and the colour camera, both by [`Camera`];
//! then the sensor's errors are added (`noise`). Each frame has its ground truth. A frame is a pure function of heads, scene, seed
//! and time, without state.
//!
//! There are two worlds: a plain one (bald heads, a wall, few sensor errors), on whose bytes tests rely, and a dressed one
//! ([`Simulator::dressed`]) with a real sensor's errors ([`Simulator::with_sensor`]), for `mien-studio evaluate --wild`.
//!
//! Memory: the heads, their work space and 12 MB of buffers, allocated at construction. Limitations: no cast shadows, stiff hair, a
//! built-in head whose eyes do not turn, upright shoulders, one hand.

mod appearance;
mod asset;
pub mod body;
pub mod draw;
mod file;
mod noise;
mod person;
pub(crate) mod random;
mod range;
pub mod raster;
mod real_noise;
mod script;
mod sensor;

pub use appearance::{Appearance, Beard, HairStyle, Headgear, Held, Neck};
pub use asset::{Expression, HeadAsset, Part, Site, Texture};
pub use draw::Light;
pub use person::{EXPRESSIONS, Points, Truth};
pub use script::Scene;
pub use sensor::Sensor;

use appearance::{Material, OutfitPainter};
use body::Shape;
use draw::{Canvas, ShapePainter};
use mien_sensors::Frame;
use mien_sensors::kinect::colour;
use mien_sensors::kinect::frame::{FrameSink, Original};
use mien_stages::base::capacity::{HEIGHT, PIXELS, WIDTH};
use mien_stages::base::geometry::{Point, Rigid};
use mien_stages::base::time::Timestamp;
use mien_stages::camera::Camera;
use noise::{DepthReading, Tiles};
use person::{CLOTHES, OTHERS, Person};
use raster::{DepthBuffer, Window};
use real_noise::RealReading;

/// Distance of the wall, metres.
const WALL_M: f32 = 2.2;

/// Draws frames of one scene.
///
/// ```no_run
/// use mien_sensors::Frame;
/// use mien_simulator::virtual_head::{HeadAsset, Scene, Simulator};
/// use mien_stages::base::time::Timestamp;
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
    /// People behind, without truth.
    bystanders: Vec<Person>,
    hand: ShapePainter,
    sensor: Sensor,
    real: Option<RealReading>,
    /// Whether the room is furnished and people wear clothes and hair.
    dressed: bool,
    /// Material of each depth pixel.
    material: Vec<Material>,
    room_material: Vec<Material>,
    /// The room, drawn once for both cameras: 1/z, colour.
    room_depth: Vec<f32>,
    room_rgb: Vec<[u8; 3]>,
    depth: DepthBuffer,
    canvas: Canvas,
    blurred: Vec<[u8; 3]>,
    bayer: Box<[u8; PIXELS]>,
    drawn: u64,
}

impl Simulator {
    /// Prepares a scene with the nominal camera. Expressions of the asset beyond [`EXPRESSIONS`] stay at 0. In scenes with several
    /// people, the others have the same head, stretched; see [`Simulator::with_others`].
    pub fn new(asset: HeadAsset, scene: Scene, seed: u64) -> Self {
        let camera = mien_sensors::kinect::geometry::nominal();
        let light = Light::default();
        let [chair, furniture] = [Scene::Empty, Scene::Furnished].map(|with| scene == with);
        let mut painter = ShapePainter::new(Shape::room(WALL_M, chair, furniture, seed));
        let mut depth = DepthBuffer::new(WIDTH, HEIGHT);
        let mut canvas = Canvas::new(WIDTH, HEIGHT);
        painter.draw_depth(|p| camera.depth_pixel(p), &mut depth);
        painter.draw_colour(&light, |p| camera.colour_pixel(p), &mut canvas);
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
            reading: DepthReading::from_camera(&camera),
            tiles: Tiles::new(seed),
            hand: ShapePainter::new(Shape::hand([205.0, 160.0, 135.0])),
            sensor: Sensor::default(),
            real: None,
            dressed: false,
            material: vec![Material::Matt; PIXELS],
            room_material: vec![Material::Matt; PIXELS],
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

    /// Gives the second and later people of the scene these heads.
    #[must_use]
    pub fn with_others(mut self, others: impl IntoIterator<Item = HeadAsset>) -> Self {
        for (k, (person, asset)) in self.people.iter_mut().skip(1).zip(others).enumerate() {
            *person = Person::new(asset, CLOTHES[k + 1]);
        }
        self
    }

    /// Dresses the people and furnishes the room.
    #[must_use]
    pub fn dressed(mut self, appearances: impl IntoIterator<Item = Appearance>) -> Self {
        for (person, appearance) in self.people.iter_mut().zip(appearances) {
            person.wear(&appearance);
            if appearance.bystander {
                let mut other = Person::new(person.asset.stretched(OTHERS[1]), CLOTHES[1]);
                other.wear(&Appearance {
                    seed: appearance.seed + 1,
                    hair: HairStyle::Short,
                    hair_colour: appearance.hair_colour,
                    clothes: CLOTHES[2],
                    ..Appearance::default()
                });
                self.bystanders.push(other);
            }
        }
        self.dressed = true;
        self.furnish();
        self
    }

    /// Draws frames with this sensor's imperfections.
    #[must_use]
    pub fn with_sensor(mut self, sensor: Sensor) -> Self {
        self.sensor = sensor;
        if sensor.faults > 0.0 {
            let mut real = RealReading::new(&self.tiles, self.seed);
            real.stereo = sensor.stereo;
            self.real = Some(real);
        }
        if self.dressed {
            self.furnish();
        }
        self
    }

    /// Draws the furnished room.
    fn furnish(&mut self) {
        let (camera, sensor) = (&self.camera, self.sensor);
        let mut painter = OutfitPainter::new(appearance::room(self.seed));
        let view = sensor.viewpoint();
        painter.place(&[], &view, &view);
        self.depth.inverse.fill(0.0);
        self.material.fill(Material::Matt);
        let depth_pixel = |p: &Point| camera.depth_pixel(p);
        painter.draw_depth(depth_pixel, &mut self.depth, &mut self.material);
        self.canvas.depth.inverse.fill(0.0);
        self.canvas.rgb.fill([0; 3]);
        let seen = |p: &Point| sensor.distort(camera.colour_pixel(p));
        painter.draw_colour(&self.light, seen, &mut self.canvas);
        self.room_depth.copy_from_slice(&self.depth.inverse);
        self.room_material.copy_from_slice(&self.material);
        self.room_rgb.copy_from_slice(&self.canvas.rgb);
    }

    /// Sets light and exposure (gain; 1 = as photographed).
    #[must_use]
    pub fn with_light(mut self, light: Light, exposure: f32) -> Self {
        self.set_light(light, exposure);
        self
    }

    /// As [`Simulator::with_light`], in the middle of a scene.
    pub fn set_light(&mut self, light: Light, exposure: f32) {
        self.light = light;
        self.exposure = exposure;
    }

    /// Imperfections of the sensor.
    pub fn sensor(&self) -> &Sensor {
        &self.sensor
    }

    /// The camera that the frames are drawn with.
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// The head of the first person.
    pub fn asset(&self) -> &HeadAsset {
        &self.people[0].asset
    }

    /// Truth of the last frame for each person; `None` if absent.
    pub fn truths(&self) -> impl ExactSizeIterator<Item = Option<&Truth>> {
        self.people.iter().map(|person| person.truth.as_ref())
    }

    /// Draws the scene at a time and sets the whole frame; its index counts the frames drawn. Returns the truth of the first person
    /// present, `None` if nobody is; [`Simulator::truths`] has that of all.
    pub fn draw(&mut self, at: Timestamp, into: &mut impl FrameSink) -> Option<Truth> {
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

    /// Poses everybody by the script at `t` seconds. With `truth` records the truth; without, moves only people that have one.
    fn play(&mut self, t: f32, truth: bool) {
        let (scene, seed) = (self.scene, self.seed);
        let view = self.sensor.viewpoint();
        for (number, person) in self.people.iter_mut().enumerate() {
            person.weights.fill(0.0);
            let (asset, weights) = (&person.asset, &mut person.weights);
            let pose = scene.play_person(number, seed, t, |name, weight| {
                if let Some(slot) = asset.expression(name).and_then(|k| weights.get_mut(k)) {
                    *slot = slot.max(weight);
                }
            });
            if let Some(pose) = pose {
                let pose = view * pose;
                if truth {
                    person.place(&pose, &view.rotation);
                } else if person.truth.is_some() {
                    person.pose(&pose, &view.rotation);
                }
                #[cfg(feature = "studio")]
                person.move_hand(t, &view.rotation);
            }
        }
        for (k, other) in self.bystanders.iter_mut().enumerate() {
            let pose = view * script::bystander(seed ^ k as u64, t);
            other.place(&pose, &view.rotation);
        }
    }

    /// Draws only the first person, with this pose and expression (`weights` in the order of the asset's expressions) instead of the
    /// script's.
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

    /// Clears the truths: nobody is present.
    fn begin(&mut self) {
        for person in &mut self.people {
            person.truth = None;
        }
    }

    /// Draws the depth picture of present people, hand and room, with the sensor's errors.
    fn draw_depth(&mut self, hand: Option<Point>, at: Timestamp, frame: &mut Frame) {
        let camera = &self.camera;
        self.depth.inverse.copy_from_slice(&self.room_depth);
        self.material.copy_from_slice(&self.room_material);
        let depth_pixel = |p: &Point| camera.depth_pixel(p);
        let all = self.people.iter_mut().chain(&mut self.bystanders);
        for person in all.filter(|one| one.truth.is_some()) {
            person.draw_depth(depth_pixel, &mut self.depth, &mut self.material);
        }
        if let Some(hand) = hand {
            (self.hand).place(&Rigid::translation(hand.x, hand.y, hand.z));
            self.hand.draw_depth(depth_pixel, &mut self.depth);
        }
        let seed = random::hash(self.seed, at.as_us());
        let (reading, seen, depth) = (&self.reading, &self.depth.inverse, &mut frame.depth);
        let (faults, material, tiles) = (self.sensor.faults, &self.material, &self.tiles);
        match &mut self.real {
            Some(real) if faults > 0.0 => {
                real.read(reading, faults, seen, material, tiles, seed, depth);
            }
            _ => reading.read(seen, tiles, seed, depth),
        }
    }

    /// Draws the colour picture, likewise.
    fn draw_colour(&mut self, hand: Option<Point>, at: Timestamp, frame: &mut Frame) {
        let (camera, sensor) = (&self.camera, self.sensor);
        self.canvas.rgb.copy_from_slice(&self.room_rgb);
        // The depth buffer starts empty: everything else is in front of the room.
        self.canvas.depth.inverse.fill(0.0);
        let mut window = Window::NOTHING;
        let colour_pixel = |p: &Point| sensor.distort(camera.colour_pixel(p));
        for person in self.people.iter_mut().chain(&mut self.bystanders) {
            window.include(person.draw_colour(&self.light, colour_pixel, &mut self.canvas));
        }
        if hand.is_some() {
            window.include((self.hand).draw_colour(&self.light, colour_pixel, &mut self.canvas));
        }
        if self.dressed {
            window = Window::ALL;
        }
        blur(&mut self.canvas.rgb, window, &mut self.blurred);
        let seed = random::hash(self.seed, at.as_us());
        let exposure = sensor.balance.map(|gain| gain * self.exposure);
        let (rgb, sigma, bayer) = (&self.canvas.rgb, sensor.colour_sigma, &mut self.bayer);
        noise::expose(rgb, exposure, sigma, &self.tiles, seed, bayer);
        colour::luma_from_bayer(&self.bayer, &mut frame.luma);
        frame.index = self.drawn;
        frame.at = at;
        self.drawn += 1;
    }
}

/// Blurs the window like the lens: 3 × 3 binomial, with `scratch` as work space.
fn blur(rgb: &mut [[u8; 3]], window: Window, scratch: &mut [[u8; 3]]) {
    let Window(first, [right, bottom]) = window;
    let [left, top] = first.map(|at| at.max(1));
    let (right, bottom) = (right.min(WIDTH - 1), bottom.min(HEIGHT - 1));
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
            *out = [0, 1, 2].map(|ch| sum(near[0][ch], near[1][ch], near[2][ch], 0));
        }
    }
    for row in top..bottom {
        let at = row * WIDTH + left;
        let [above, here, below] =
            [at - WIDTH, at, at + WIDTH].map(|from| &scratch[from..from + count]);
        for (k, out) in rgb[at..at + count].iter_mut().enumerate() {
            *out = [0, 1, 2].map(|ch| sum(above[k][ch], here[k][ch], below[k][ch], 2));
        }
    }
}

#[cfg(test)]
mod tests;
