//! Fits one face in a still image, with a box in place of the depth pose.
//!
//! The mean face fills the box, upright, at five combinations of yaw and pitch; each runs the cold and the warm
//! stages. The most confident fit is repeated in a window cut at its result, and the better of the two is kept.

use std::path::Path;

use crate::dataset::load_grey;
use crate::fault::Fault;
use mien_stages::base::capacity::LANDMARKS;
use mien_stages::base::geometry::{Point, Rotation, Vector, rotation_from_yaw_pitch_roll};
use mien_stages::face_model::{FaceModel, MAX_MODES};
use mien_stages::landmarks::cascade::{FaceFit, Solver, logistic};
use mien_stages::landmarks::features::OrientationMaps;
use mien_stages::landmarks::view::View;
use mien_stages::landmarks::window::{LumaImage, Placement, Region, WINDOW};

/// Inverse distance of a studio camera, 1/m: portraits are taken from about a metre and a half.
pub const STUDIO_INVERSE_DISTANCE: f32 = 0.7;

/// Largest width of a face in a shrunk picture, pixels: the window is 100.
const MAX_FACE_PX: f32 = 150.0;
/// Initial yaw and pitch, degrees.
const GUESSES_DEG: [[i8; 2]; 5] = [[0, 0], [22, 0], [-22, 0], [0, 14], [0, -14]];

/// A box about the 68 points: left, top, width, height, pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FaceBox {
    /// Left edge.
    pub x: f32,
    /// Upper edge.
    pub y: f32,
    /// Width.
    pub width: f32,
    /// Height.
    pub height: f32,
}

impl FaceBox {
    /// A box by its left and upper edge, width and height.
    pub const fn new(x: f32, y: f32, width: f32, height: f32) -> Self {
        Self {
            x,
            y,
            width,
            height,
        }
    }

    /// The bounding box of points.
    pub fn around(points: &[[f32; 2]; LANDMARKS]) -> Self {
        let [[left, top], [right, bottom]] = ends(*points);
        Self::new(left, top, right - left, bottom - top)
    }
}

/// Smallest and largest coordinates of points.
fn ends(points: impl IntoIterator<Item = [f32; 2]>) -> [[f32; 2]; 2] {
    let all = [[f32::MAX; 2], [f32::MIN; 2]];
    points.into_iter().fold(all, |[low, high], p| {
        [
            [low[0].min(p[0]), low[1].min(p[1])],
            [high[0].max(p[0]), high[1].max(p[1])],
        ]
    })
}

/// Bounding box of points, disturbed by ±10 % of the width in position and ±7 % in size, and a roll within ±8°,
/// radians.
pub fn disturbed_box(points: &[[f32; 2]; LANDMARKS], seed: u64) -> (FaceBox, f32) {
    let mut random = fastrand::Rng::with_seed(seed);
    let mut about = |size: f32| size * (2.0 * random.f32() - 1.0);
    let [low, high] = ends(*points);
    let (w, h) = (high[0] - low[0], high[1] - low[1]);
    let (dx, dy, grow) = (about(0.10) * w, about(0.10) * w, 1.0 + about(0.07));
    let x = low[0] + dx - 0.5 * w * (grow - 1.0);
    let y = low[1] + dy - 0.5 * h * (grow - 1.0);
    let face_box = FaceBox::new(x, y, w * grow, h * grow);
    (face_box, about(8f32.to_radians()))
}

/// One fitted face.
pub struct FittedFace {
    /// The 68 points, picture pixels.
    pub points: [[f32; 2]; LANDMARKS],
    /// The 68 points in the head frame at the model's size, metres.
    pub head: [Point; LANDMARKS],
    /// Confidence, 0…1.
    pub confidence: f32,
    /// View in pixels of the fitted picture.
    pub view: View,
}

/// Fits still pictures with one model.
pub struct StillFitter<'a> {
    model: &'a FaceModel,
    window: Vec<f32>,
    maps: OrientationMaps,
    solver: Solver,
}

impl<'a> StillFitter<'a> {
    /// A fitter for one model.
    pub fn new(model: &'a FaceModel) -> Self {
        Self {
            model,
            window: vec![0.0; WINDOW * WINDOW],
            maps: OrientationMaps::default(),
            solver: Solver::default(),
        }
    }

    /// The view in which the mean face fills a box, rotated by yaw, pitch and roll (radians).
    fn view_in_box(&self, face_box: &FaceBox, yaw: f32, pitch: f32, roll: f32) -> View {
        let mut view = View {
            log_scale: 0.0,
            rotation: rotation_from_yaw_pitch_roll(yaw, pitch, 0.0),
            shift: [0.0, 0.0],
            inverse_distance: STUDIO_INVERSE_DISTANCE,
        };
        let [low, high] = ends(self.model.shape.mean.iter().map(|p| view.project(p)));
        let scale =
            (face_box.width * face_box.height / ((high[0] - low[0]) * (high[1] - low[1]))).sqrt();
        view.log_scale = scale.ln();
        let off = [0, 1].map(|axis| 0.5 * (low[axis] + high[axis]) * scale);
        let (sin, cos) = roll.sin_cos();
        view.shift = [
            face_box.x + 0.5 * face_box.width - (off[0] * cos - off[1] * sin),
            face_box.y + 0.5 * face_box.height - (off[0] * sin + off[1] * cos),
        ];
        view.rotation = Rotation::from_axis_angle(&Vector::z_axis(), roll) * view.rotation;
        view
    }

    /// Cold and warm stages in a window cut at `view`; log odds, fit in the window, placement of the window.
    fn run(&mut self, picture: &LumaImage, view: &View) -> (f32, FaceFit, Placement) {
        let placement = Placement::from_view(view);
        placement.resample(picture, &Region::WHOLE, &mut self.window);
        self.maps.compute(&self.window, &Region::WHOLE);
        let shape = &self.model.shape;
        let (solver, maps) = (&mut self.solver, &self.maps);
        let start = FaceFit {
            view: placement.start,
            shape: [0.0; MAX_MODES],
        };
        let cold = solver.run(&self.model.cold, shape, maps, &start, &start.view);
        let fit = solver.run(&self.model.warm, shape, maps, &cold, &start.view);
        let belief = solver.confidence(&self.model.confidence, shape, maps, &fit);
        (belief.log_odds, fit, placement)
    }

    fn face(&self, log_odds: f32, fit: &FaceFit, placement: &Placement) -> FittedFace {
        let mut head = [Point::origin(); LANDMARKS];
        self.model.shape.shape(&fit.shape, &mut head);
        FittedFace {
            points: head.map(|p| placement.image_pixel(fit.view.project(&p))),
            head,
            confidence: logistic(log_odds),
            view: placement.image_view(&fit.view),
        }
    }

    /// Fits the next picture of a video from the last one's [`FittedFace::view`].
    pub fn follow(&mut self, picture: &LumaImage, last: &View) -> FittedFace {
        let (log_odds, fit, placement) = self.run(picture, last);
        self.face(log_odds, &fit, &placement)
    }

    /// Fits the face in a box once, from a frontal and upright start, in a sixth of the time of [`Self::fit`].
    pub fn fit_frontal(&mut self, picture: &LumaImage, face_box: &FaceBox) -> FittedFace {
        self.follow(picture, &self.view_in_box(face_box, 0.0, 0.0, 0.0))
    }

    /// Fits the face in a box; `roll` in radians, clockwise in the picture.
    pub fn fit(&mut self, picture: &LumaImage, face_box: &FaceBox, roll: f32) -> FittedFace {
        let mut best: Option<(f32, FaceFit, Placement)> = None;
        for guess in GUESSES_DEG {
            let [yaw, pitch] = guess.map(|degrees| f32::from(degrees).to_radians());
            let view = self.view_in_box(face_box, yaw, pitch, roll);
            let end = self.run(picture, &view);
            if best.as_ref().is_none_or(|b| end.0 > b.0) {
                best = Some(end);
            }
        }
        let (mut log_odds, mut fit, mut placement) = best.expect("there are guesses");
        // Repeated at the result: the second window is centred and upright.
        let again = placement.image_view(&fit.view);
        let second = self.run(picture, &again);
        if second.0 > log_odds {
            (log_odds, fit, placement) = second;
        }
        self.face(log_odds, &fit, &placement)
    }

    /// Loads a picture of a data set and fits it; pixels are those of the file.
    ///
    /// # Errors
    /// If the picture does not decode.
    pub fn fit_file(
        &mut self,
        path: &Path,
        face_box: &FaceBox,
        roll: f32,
    ) -> Result<FittedFace, Fault> {
        let scale = (MAX_FACE_PX / face_box.width.max(face_box.height * 0.9)).min(1.0);
        let grey = load_grey(path, scale)?;
        let [x, y] = [face_box.x, face_box.y].map(|at| (at + 0.5) * scale - 0.5);
        let [width, height] = [face_box.width, face_box.height].map(|side| side * scale);
        let small = FaceBox::new(x, y, width, height);
        let mut face = self.fit(&crate::dataset::picture(&grey), &small, roll);
        for p in face.points.iter_mut().flatten() {
            *p = (*p + 0.5) / scale - 0.5;
        }
        Ok(face)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mean_face_fills_its_box() {
        let model = FaceModel::shipped();
        let fitter = StillFitter::new(&model);
        let face_box = FaceBox {
            x: 100.0,
            y: 50.0,
            width: 120.0,
            height: 130.0,
        };
        let view = fitter.view_in_box(&face_box, 0.0, 0.0, 0.0);
        let points: Vec<[f32; 2]> = model.shape.mean.iter().map(|p| view.project(p)).collect();
        let middle = |axis: usize| {
            let low = points.iter().map(|p| p[axis]).fold(f32::MAX, f32::min);
            let high = points.iter().map(|p| p[axis]).fold(f32::MIN, f32::max);
            0.5 * (low + high)
        };
        assert!((middle(0) - 160.0).abs() < 0.1 && (middle(1) - 115.0).abs() < 0.1);
    }
}
