//! Training pictures with their truth, and starts of fits.
//!
//! A start is a disturbed depth pose; the head window is cut there as in the appliance, then varied in light,
//! sharpness and noise. Window pixels, radians, standard deviations of shape. Seeded.

use image::GrayImage;
use image::imageops::flip_horizontal;
use rayon::prelude::*;

use mien_stages::base::capacity::LANDMARKS;
use mien_stages::base::defaults;
use mien_stages::base::geometry::{Point, Rotation, Vector, rotation_from_yaw_pitch_roll};
use mien_stages::camera::Camera;
use mien_stages::face_model::{MAX_MODES, ShapeModel, scheme};
use mien_stages::landmarks::cascade::FaceFit;
use mien_stages::landmarks::features::OrientationMaps;
use mien_stages::landmarks::view::View;
use mien_stages::landmarks::window::{ORIGIN, PIXELS_PER_METRE, Placement, Region, WINDOW};
use mien_workbench::fault::Fault;

use super::points::fit_points;
use super::render::TrainingSample;
use super::shape::{Face, mirrored};
use mien_workbench::dataset::{self, Entry, load_grey};
use mien_workbench::similarity::Similarity;
use mien_workbench::still::STUDIO_INVERSE_DISTANCE;

/// Scale of portraits, picture pixels per metre: a little finer than the head window.
const PORTRAIT_SCALE: f32 = 900.0;

/// A picture of one face with its truth.
#[derive(Clone)]
pub struct TruePicture {
    /// The picture.
    pub grey: GrayImage,
    /// True view in picture pixels, and shape.
    pub truth: FaceFit,
    /// The 68 points, picture pixels.
    pub points: [[f32; 2]; LANDMARKS],
    /// Whether each point is unoccluded.
    pub visible: [bool; LANDMARKS],
    /// Whether it is rendered, not a photograph.
    pub drawn: bool,
}

impl TruePicture {
    /// An annotated portrait, scaled to a common size; `None` if it has no points.
    ///
    /// # Errors
    /// If the picture does not decode.
    pub fn portrait(entry: &Entry, shape: &ShapeModel) -> Result<Option<Self>, Fault> {
        let Some(points) = entry.points else {
            return Ok(None);
        };
        let rough = fit_points(shape, &points, STUDIO_INVERSE_DISTANCE);
        let scale = (PORTRAIT_SCALE / rough.view.log_scale.exp()).min(1.0);
        let grey = load_grey(&entry.path, scale)?;
        // Pixel centres are integers, so scaling is about the corner at -0.5.
        let points = points.map(|p| p.map(|v| (v + 0.5) * scale - 0.5));
        Ok(Some(Self {
            truth: fit_points(shape, &points, STUDIO_INVERSE_DISTANCE),
            grey,
            points,
            visible: [true; LANDMARKS],
            drawn: false,
        }))
    }

    /// A rendered face, cut out upright, with the truth in the cut.
    pub fn drawn(drawn: &TrainingSample, camera: &Camera, shape: &ShapeModel) -> Option<Self> {
        const MARGIN: u32 = 60;
        const SIDE: u32 = WINDOW as u32 + 2 * MARGIN;
        let placement = Placement::from_pose(camera, &drawn.sensor_from_head)?;
        let picture = dataset::picture(&drawn.grey);
        let margin = MARGIN as f32;
        let grey = GrayImage::from_fn(SIDE, SIDE, |x, y| {
            let [x, y] = placement.image_pixel([x, y].map(|at| at as f32 - margin));
            let level = picture.bilinear(x - drawn.origin[0], y - drawn.origin[1]);
            image::Luma([level.round() as u8])
        });
        let points = drawn.points.map(|[x, y]| {
            let [x, y] = placement.window_pixel([x + drawn.origin[0], y + drawn.origin[1]]);
            [x + margin, y + margin]
        });
        let mean: Face = std::array::from_fn(|i| shape.mean[i]);
        let mut coefficients = [0.0; MAX_MODES];
        let upright = Similarity::between(&drawn.head, &mean);
        let face = drawn.head.map(|p| upright.applied(&p));
        shape.coefficients(&face, &mut coefficients[..shape.modes.len()]);
        // The similarity from the model's shape to the head's.
        let back = Similarity::between(&face, &drawn.head);
        let start = placement.start;
        let moved = start.rotation * back.translation * PIXELS_PER_METRE;
        Some(Self {
            grey,
            truth: FaceFit {
                view: View {
                    log_scale: start.log_scale + back.scale.ln(),
                    rotation: start.rotation * Rotation::from_rotation_matrix(&back.rotation),
                    shift: [ORIGIN[0] + margin + moved.x, ORIGIN[1] + margin + moved.y],
                    inverse_distance: start.inverse_distance,
                },
                shape: coefficients,
            },
            points,
            visible: drawn.visible,
            drawn: true,
        })
    }

    /// The mirror image.
    pub fn mirrored(&self, shape: &ShapeModel) -> Self {
        let flip = |x: f32| (self.grey.width() - 1) as f32 - x;
        let mut head = [Point::origin(); LANDMARKS];
        shape.shape(&self.truth.shape, &mut head);
        let face = mirrored(&head);
        let mut coefficients = [0.0; MAX_MODES];
        shape.coefficients(&face, &mut coefficients[..shape.modes.len()]);
        let axis = self.truth.view.rotation.scaled_axis();
        Self {
            grey: flip_horizontal(&self.grey),
            truth: FaceFit {
                view: View {
                    rotation: Rotation::from_scaled_axis(Vector::new(axis.x, -axis.y, -axis.z)),
                    shift: [flip(self.truth.view.shift[0]), self.truth.view.shift[1]],
                    ..self.truth.view
                },
                shape: coefficients,
            },
            points: std::array::from_fn(|i| {
                let p = self.points[scheme::MIRROR[i]];
                [flip(p[0]), p[1]]
            }),
            visible: std::array::from_fn(|i| self.visible[scheme::MIRROR[i]]),
            drawn: self.drawn,
        }
    }
}

/// Half widths of the uniform disturbance of a start: position as a share of the face's width, then yaw, pitch and
/// roll in radians, then the logarithm of the scale.
pub struct Disturbance(pub [f32; 3]);

/// Usual errors of a depth pose.
pub const NEAR: Disturbance = Disturbance([0.06, 0.09, 0.055]);

/// Largest errors of a depth pose, and of a face box in a still picture.
pub const COLD: Disturbance = Disturbance([0.10, 0.14, 0.08]);

/// Width of a face, metres, the unit of a [`Disturbance`]'s position.
const FACE_WIDTH_M: f32 = 0.145;

impl Disturbance {
    /// A view near the true one.
    pub fn disturbed(&self, view: &View, random: &mut fastrand::Rng) -> View {
        let mut about = |size: f32| size * (2.0 * random.f32() - 1.0);
        let Self([position, angle, scale]) = *self;
        let turn = rotation_from_yaw_pitch_roll(about(angle), about(angle), about(angle));
        let reach = position * FACE_WIDTH_M * view.log_scale.exp();
        View {
            log_scale: view.log_scale + about(scale),
            rotation: turn * view.rotation,
            shift: [view.shift[0] + about(reach), view.shift[1] + about(reach)],
            inverse_distance: view.inverse_distance,
        }
    }
}

/// One start: a window and the truth in it.
pub struct Sample {
    /// The window; its maps are sixteen times as large, and computed on demand.
    window: Vec<u8>,
    /// View by the disturbed depth pose.
    pub depth: View,
    /// Truth in the window.
    pub truth: FaceFit,
    /// The points in the window.
    pub points: [[f32; 2]; LANDMARKS],
    /// Whether each point is unoccluded.
    pub visible: [bool; LANDMARKS],
}

defaults! {
    /// Reusable buffer for the maps of samples.
    pub struct MapBuffer {
        window: Vec<f32> = vec![0.0; WINDOW * WINDOW],
        /// Maps of the last sample.
        pub maps: OrientationMaps = OrientationMaps::default(),
    }
}

impl MapBuffer {
    /// Computes the maps of a sample.
    pub fn compute_maps(&mut self, sample: &Sample) -> &OrientationMaps {
        for (value, grey) in self.window.iter_mut().zip(&sample.window) {
            *value = f32::from(*grey);
        }
        self.maps.compute(&self.window, &Region::WHOLE);
        &self.maps
    }
}

/// Varies light, sharpness and noise of a window.
fn spoil(window: &mut [f32], random: &mut fastrand::Rng) {
    if random.f32() < 0.4 {
        // A box blur of width three, once or twice.
        for _ in 0..=random.usize(..2) {
            let before = window.to_vec();
            for row in 1..WINDOW - 1 {
                for column in 1..WINDOW - 1 {
                    let at = row * WINDOW + column;
                    let mut sum = 0.0;
                    for line in [at - WINDOW, at, at + WINDOW] {
                        sum += before[line - 1] + before[line] + before[line + 1];
                    }
                    window[at] = sum / 9.0;
                }
            }
        }
    }
    let gain = 0.4 + 0.9 * random.f32();
    let gamma = 0.75 + 0.55 * random.f32();
    let slope = 0.5 * (random.f32() - 0.5);
    let across = random.f32() * std::f32::consts::TAU;
    let (sin, cos) = across.sin_cos();
    let noise = 4.0 * random.f32() * random.f32();
    for (k, value) in window.iter_mut().enumerate() {
        let [x, y] = [k % WINDOW, k / WINDOW].map(|at| at as f32 / 92.0 - 1.0);
        let lit = gain * (1.0 + slope * (x * cos + y * sin));
        let v = 255.0 * (value.max(0.0) / 255.0).powf(gamma) * lit;
        // The sum of two uniforms approximates a Gaussian.
        *value = (v + noise * 1.2 * (random.f32() + random.f32() - 1.0) * 2.0).clamp(0.0, 255.0);
    }
}

/// A disturbed start at a picture; the window of a photograph is varied if `spoiled` (a rendered one already is).
pub fn sample(
    picture: &TruePicture,
    disturbance: &Disturbance,
    spoiled: bool,
    seed: u64,
    window: &mut [f32],
) -> Sample {
    let mut random = fastrand::Rng::with_seed(seed);
    let view = disturbance.disturbed(&picture.truth.view, &mut random);
    let placement = Placement::from_view(&view);
    placement.resample(&dataset::picture(&picture.grey), &Region::WHOLE, window);
    if spoiled && !picture.drawn {
        spoil(window, &mut random);
    }
    Sample {
        window: window.iter().map(|v| (v + 0.5) as u8).collect(),
        depth: placement.start,
        truth: FaceFit {
            view: placement.window_view(&picture.truth.view),
            ..picture.truth
        },
        points: picture.points.map(|p| placement.window_pixel(p)),
        visible: picture.visible,
    }
}

/// `starts` disturbed starts at each picture, by the disturbances in turn.
pub fn disturbed(
    pictures: &[TruePicture],
    starts: usize,
    disturbances: &[Disturbance],
    spoiled: bool,
    seed: u64,
) -> Vec<Sample> {
    let start = |window: &mut Vec<f32>, k: usize| {
        let seed = seed.wrapping_mul(1_000_003).wrapping_add(k as u64);
        let disturbance = &disturbances[k % disturbances.len()];
        sample(&pictures[k / starts], disturbance, spoiled, seed, window)
    };
    let all = (0..pictures.len() * starts).into_par_iter();
    all.map_init(|| vec![0.0; WINDOW * WINDOW], start).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use mien_stages::face_model::FaceModel;

    #[test]
    fn the_truth_lies_on_the_points_in_every_window() {
        let shape = FaceModel::shipped().shape;
        let mut truth = FaceFit {
            view: View {
                log_scale: 900f32.ln(),
                rotation: rotation_from_yaw_pitch_roll(0.2, -0.1, 0.3),
                shift: [250.0, 240.0],
                inverse_distance: 0.7,
            },
            shape: [0.0; MAX_MODES],
        };
        truth.shape[0] = 1.0;
        let mut head = [Point::origin(); LANDMARKS];
        shape.shape(&truth.shape, &mut head);
        let picture = TruePicture {
            grey: GrayImage::from_pixel(500, 500, image::Luma([100])),
            points: head.map(|p| truth.view.project(&p)),
            truth,
            visible: [true; LANDMARKS],
            drawn: false,
        };
        let mut window = vec![0.0; WINDOW * WINDOW];
        for picture in [picture.clone(), picture.mirrored(&shape)] {
            let sample = sample(&picture, &COLD, false, 5, &mut window);
            shape.shape(&sample.truth.shape, &mut head);
            for (p, q) in head.iter().zip(&sample.points) {
                let p = sample.truth.view.project(p);
                assert!((p[0] - q[0]).hypot(p[1] - q[1]) < 0.3, "{p:?} {q:?}");
            }
        }
    }
}
