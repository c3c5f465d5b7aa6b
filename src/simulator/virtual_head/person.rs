//! People of a scene: pose, expression and drawing.

#[cfg(feature = "studio")]
use super::appearance::Held;
use super::appearance::{Appearance, Material, Outfit, OutfitPainter};
use super::asset::HeadAsset;
use super::body::Shape;
use super::draw::{Canvas, HeadPainter, Light, ShapePainter, shoulders_below};
use super::raster::{DepthBuffer, Window};
use mien_stages::base::capacity::{LANDMARKS, USERS};
#[cfg(feature = "studio")]
use mien_stages::base::geometry::Vector;
use mien_stages::base::geometry::{Point, Rigid, Rotation};

/// Most expressions of a head.
pub const EXPRESSIONS: usize = 64;
/// Colours of the clothes, by person.
pub(super) const CLOTHES: [[f32; 3]; USERS] = [
    [70.0, 85.0, 120.0],
    [130.0, 80.0, 70.0],
    [80.0, 110.0, 75.0],
    [105.0, 95.0, 60.0],
];
/// Factors by which the head is stretched for other people: width, height, depth.
pub(super) const OTHERS: [[f32; 3]; USERS] = [
    [1.0; 3],
    [0.94, 1.05, 0.98],
    [1.06, 0.97, 1.04],
    [0.96, 0.95, 1.02],
];

/// The 68 points in a picture, pixels.
pub type Points = [[f32; 2]; LANDMARKS];

/// Ground truth of a drawn person.
#[derive(Clone, Debug)]
pub struct Truth {
    /// Pose of the head, metres.
    pub sensor_from_head: Rigid,
    /// The 68 points in the head frame, metres, expression included.
    pub landmarks_head: [Point; LANDMARKS],
    /// The 68 points in colour pixels, hidden ones included.
    pub landmarks_px: Points,
    /// Weight of each expression of the asset, in its order.
    pub activations: heapless::Vec<f32, EXPRESSIONS>,
}

/// A person, with the work space and the truth of the last drawing.
pub(super) struct Person {
    pub(super) asset: HeadAsset,
    head: HeadPainter,
    bust: ShapePainter,
    /// Clothes and hair, drawn instead of the bust.
    worn: Option<OutfitPainter>,
    /// The hand, and whether it is visible now.
    #[cfg(feature = "studio")]
    held: Option<(Held, OutfitPainter, bool)>,
    pub(super) weights: heapless::Vec<f32, EXPRESSIONS>,
    pose: Rigid,
    pub(super) truth: Option<Truth>,
}

impl Person {
    pub(super) fn new(asset: HeadAsset, clothes: [f32; 3]) -> Self {
        let expressions = asset.expressions.len().min(EXPRESSIONS);
        Self {
            head: HeadPainter::new(&asset),
            bust: ShapePainter::new(Shape::bust(clothes)),
            worn: None,
            #[cfg(feature = "studio")]
            held: None,
            weights: std::iter::repeat_n(0.0, expressions).collect(),
            pose: Rigid::identity(),
            truth: None,
            asset,
        }
    }

    /// Puts on clothes, hair and things.
    pub(super) fn wear(&mut self, appearance: &Appearance) {
        self.worn = Some(OutfitPainter::new(Outfit::worn(&self.asset, appearance)));
        #[cfg(feature = "studio")]
        if appearance.held != Held::None {
            let painter = OutfitPainter::new(Outfit::held(appearance));
            self.held = Some((appearance.held, painter, false));
        }
    }

    /// Moves the hand to its position at `t` seconds.
    #[cfg(feature = "studio")]
    pub(super) fn move_hand(&mut self, t: f32, tilt: &Rotation) {
        if let Some((held, painter, there)) = &mut self.held {
            let place = held.position_at(t);
            *there = place.is_some();
            if let Some(place) = place {
                let turn = self.pose.rotation;
                // The target turns with the face, but the hand comes from below.
                let up = Vector::new(place.x, place.y.min(0.15), place.z);
                let rest = Vector::new(0.0, place.y - up.y, 0.0);
                let at = self.pose.translation.vector + turn * up + tilt * rest;
                let pose = Rigid::from_parts(at.into(), *tilt);
                painter.place(&[], &pose, &pose);
            }
        }
    }

    /// Sets the pose and records it as the truth, with the expression in `weights`.
    pub(super) fn place(&mut self, sensor_from_head: &Rigid, tilt: &Rotation) {
        self.pose(sensor_from_head, tilt);
        self.truth = Some(Truth {
            sensor_from_head: *sensor_from_head,
            landmarks_head: self.asset.landmarks_on(&self.head.deformed),
            landmarks_px: [[0.0; 2]; LANDMARKS],
            activations: self.weights.clone(),
        });
    }

    pub(super) fn pose(&mut self, sensor_from_head: &Rigid, tilt: &Rotation) {
        self.pose = *sensor_from_head;
        let torso = shoulders_below(sensor_from_head, tilt);
        let deformed = &mut self.head.deformed;
        deformed.copy_from_slice(&self.asset.neutral);
        self.asset.express(&self.weights, deformed);
        self.head.place_above(sensor_from_head, &torso);
        match &mut self.worn {
            Some(worn) => worn.place(&self.head.deformed, sensor_from_head, &torso),
            None => self.bust.place(&torso),
        }
    }

    /// Draws depth, and the material of each pixel into `material`.
    pub(super) fn draw_depth(
        &mut self,
        pixel: impl Fn(&Point) -> [f32; 2] + Copy,
        depth: &mut DepthBuffer,
        material: &mut [Material],
    ) {
        let skin = |pixel| material[pixel] = Material::Skin;
        self.head.draw_depth(&self.asset, pixel, depth, skin);
        match &mut self.worn {
            Some(worn) => worn.draw_depth(pixel, depth, material),
            None => self.bust.draw_depth(pixel, depth),
        }
        #[cfg(feature = "studio")]
        if let Some((_, held, true)) = &mut self.held {
            held.draw_depth(pixel, depth, material);
        }
    }

    /// Draws colour if the person is present, and records the landmarks' pixels in the truth; returns the window drawn to.
    pub(super) fn draw_colour(
        &mut self,
        light: &Light,
        pixel: impl Fn(&Point) -> [f32; 2] + Copy,
        canvas: &mut Canvas,
    ) -> Window {
        let (asset, head) = (&self.asset, &mut self.head);
        let Some(truth) = &mut self.truth else {
            return Window::NOTHING;
        };
        head.light(asset, light);
        let mut window = head.draw_colour(asset, light, pixel, canvas);
        window.include(match &mut self.worn {
            Some(worn) => worn.draw_colour(light, pixel, canvas),
            None => self.bust.draw_colour(light, pixel, canvas),
        });
        #[cfg(feature = "studio")]
        if let Some((_, held, true)) = &mut self.held {
            window.include(held.draw_colour(light, pixel, canvas));
        }
        let landmarks = asset.landmarks_on(&head.deformed);
        truth.landmarks_px = landmarks.map(|p| pixel(&(self.pose * p)));
        window
    }
}
