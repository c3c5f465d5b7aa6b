//! A hand with its forearm that appears now and then: at the chin, over the mouth, with a cup, a phone or a sheet of paper.

use super::material::{Material, part_seed, share};
use super::options::{Appearance, Held};
use super::outfit::{Outfit, Surface, path};
use mien_stages::base::geometry::{Point, Vector, smoothstep};

/// Colour of the hand, RGB 0…255.
const SKIN: [f32; 3] = [198.0, 152.0, 128.0];

impl Outfit {
    /// The hand with its object and forearm. Origin: its target, which is the chin, the mouth, the ear, or for a sheet the middle of
    /// the face.
    pub(crate) fn held(appearance: &Appearance) -> Self {
        let mut outfit = Self::default();
        let seed = part_seed(appearance.seed, 9);
        let side = if share(seed, 1) < 0.5 { -1.0 } else { 1.0f32 };
        let mut fist = |x: f32, y: f32, z: f32| outfit.fist([x, y, z], side, appearance);
        match appearance.held {
            Held::None => {}
            Held::Chin => fist(side * 0.012, 0.020, 0.0),
            Held::Cup => {
                fist(side * 0.035, 0.045, -0.045);
                outfit.cup();
            }
            Held::Mouth => {
                fist(side * 0.045, 0.012, -0.012);
                outfit.palm(side);
            }
            Held::Phone => {
                fist(side * 0.100, 0.045, 0.045);
                outfit.phone(side);
            }
            Held::Paper => {
                fist(side * 0.17 + side * 0.02, 0.20, -0.07);
                outfit.paper(side, seed);
            }
        }
        outfit
    }

    /// Adds a fist at a position, and its forearm.
    fn fist(&mut self, [x, y, z]: [f32; 3], side: f32, appearance: &Appearance) {
        let skin = Surface::new(Material::Skin, SKIN, 0.0);
        self.ball([x, y, z], [0.040, 0.034, 0.030], &skin);
        for k in 0..4 {
            let up = y - 0.024 + 0.016 * k as f32;
            let knuckle = [x - side * 0.016, up, z - 0.022];
            self.ball(knuckle, [0.026, 0.0085, 0.010], &skin);
        }
        // The forearm goes down and outwards to an elbow on a table.
        let sleeve = Surface::new(Material::Cloth, appearance.clothes, 0.0);
        let path = path(8, |t| {
            let out = x + side * 0.13 * t;
            Point::new(out, y + 0.02 + 0.34 * t, z + 0.01 + 0.05 * t)
        });
        let section = |i| (-Vector::z(), [0.026 + 0.003 * i as f32; 2]);
        self.tube(&path, 14, Material::Cloth, section, |i, p, turn| {
            let surface = if i < 2 { &skin } else { &sleeve };
            surface.vertex(p, [turn * 0.3, 0.05 * i as f32], 1.0)
        });
    }

    fn cup(&mut self) {
        let china = Surface::new(Material::Matt, [222.0, 220.0, 214.0], 0.0);
        let path = [
            Point::new(0.0, 0.005, -0.045),
            Point::new(0.0, 0.045, -0.055),
            Point::new(0.0, 0.088, -0.058),
            Point::new(0.0, 0.089, -0.058),
        ];
        let section = |i: usize| (-Vector::z(), [[0.041, 0.040, 0.034, 0.001][i]; 2]);
        self.tube(&path, 18, Material::Matt, section, |i, p, turn| {
            china.vertex(p, [turn, i as f32], 1.0)
        });
    }

    fn palm(&mut self, side: f32) {
        // The palm across the mouth, the fingers over the other cheek.
        let skin = Surface::new(Material::Skin, SKIN, 0.0);
        let palm = [side * 0.012, 0.008, -0.014];
        self.ball(palm, [0.046, 0.036, 0.016], &skin);
        for k in 0..4 {
            let up = -0.018 + 0.017 * k as f32;
            self.ball([-side * 0.046, up, -0.004], [0.034, 0.009, 0.010], &skin);
        }
    }

    fn phone(&mut self, side: f32) {
        let case = Surface::new(Material::Gloss, [24.0, 24.0, 28.0], 0.0);
        self.sheet([4, 4], &case, |u, v| {
            let aside = side * (0.088 + 0.004 * u);
            Point::new(aside, 0.05 - 0.13 * v, 0.005 + 0.07 * u)
        });
    }

    fn paper(&mut self, side: f32, seed: u64) {
        let x = side * 0.17;
        let paper = Surface::new(Material::Matt, [228.0, 228.0, 224.0], 0.0);
        let tilt = 0.3 * (share(seed, 2) - 0.5);
        self.sheet([9, 7], &paper, |u, v| {
            let (a, b) = (0.21 * (u - 0.5), 0.297 * (v - 0.85));
            Point::new(
                x + a * tilt.cos() - b * tilt.sin(),
                0.19 + a * tilt.sin() + b * tilt.cos(),
                -0.08 + 0.015 * (3.0 * u).sin() + 0.05 * v,
            )
        });
    }
}

impl Held {
    /// Position of the hand's origin at `t` seconds, head frame, metres; `None` while it is out of the picture.
    pub fn position_at(self, t: f32) -> Option<Point> {
        let place = match self {
            Self::None => return None,
            Self::Chin => Point::new(0.0, 0.112, -0.030),
            Self::Cup | Self::Mouth => Point::new(0.0, 0.066, -0.030),
            Self::Phone => Point::new(0.0, 0.0, 0.030),
            Self::Paper => Point::new(0.0, 0.0, 0.0),
        };
        // Seconds: period, start, duration of the movement, duration of the stay.
        let (every, comes, takes, stays) = match self {
            Self::Cup => (9.0, 3.0, 0.7, 1.2),
            Self::Mouth => (4.3, 2.6, 0.3, 1.0),
            _ => (9.0, 3.0, 0.7, 3.5),
        };
        let (phase, goes) = (t % every, comes + takes + stays);
        let up = smoothstep(comes, comes + takes, phase) - smoothstep(goes, goes + takes, phase);
        (up > 0.0).then(|| Point::new(place.x, place.y + 0.55 * (1.0 - up), place.z))
    }
}
