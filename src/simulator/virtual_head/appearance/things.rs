//! Beards, glasses, hats, headphones, scarves, collars, and a chair.

use super::material::{Material, along, grain, part_seed, share, slope};
use super::options::{Appearance, Beard, HairStyle, Headgear, Neck};
use super::outfit::{Outfit, Surface, Vertex, path};
use super::skull::{HANGS, Skull};
use crate::virtual_head::asset::{HeadAsset, Part};
use crate::virtual_head::raster::sum_normals;
use mien_stages::base::geometry::{Point, Vector};

/// Upper edge of a beard: distance from the middle of the face, height (y), metres.
const BEARD_LINE: [[f32; 2]; 5] = [
    [0.0, 0.047],
    [0.03, 0.050],
    [0.045, 0.046],
    [0.060, 0.022],
    [0.072, -0.006],
];

impl Outfit {
    pub(super) fn things(&mut self, asset: &HeadAsset, skull: &Skull, appearance: &Appearance) {
        match appearance.beard {
            Beard::None => {}
            Beard::Stubble => self.beard(asset, appearance, 0.0006),
            Beard::Full => {
                let lift = 0.008 + 0.012 * share(appearance.seed, 31);
                self.beard(asset, appearance, lift);
            }
        }
        if appearance.rims_m > 0.0 {
            self.glasses(asset, appearance);
        }
        match appearance.headgear {
            Headgear::None => {}
            Headgear::Cap => self.cap(skull, appearance),
            Headgear::Hood => self.hood(skull, appearance),
            Headgear::Headphones => self.headphones(skull, appearance),
        }
        match appearance.neck {
            Neck::None => {}
            Neck::Scarf => self.scarf(appearance),
            Neck::Collar => self.collar(appearance),
        }
        if appearance.chair {
            self.chair(appearance);
        }
    }

    /// Adds a beard, attached to the skin; `lift`: thickness, metres.
    fn beard(&mut self, asset: &HeadAsset, appearance: &Appearance, lift: f32) {
        let n = asset.neutral.len();
        let mut normals = vec![Vector::zeros(); n];
        let triangles = asset.triangles.iter().map(|t| t.map(|k| k as usize));
        sum_normals(triangles, &asset.neutral, &mut normals);
        let face = Face::from_asset(asset);
        let stubble = lift < 0.002;
        let seed = part_seed(appearance.seed, 3);
        let hair = |v: u32| {
            let p = asset.neutral[v as usize];
            let there = face.beard(&p);
            let out = normals[v as usize] / normals[v as usize].norm().max(1e-12);
            let tuft = grain(p.x * 190.0 + 77.0, p.y * 190.0 + p.z * 130.0);
            // Fullest at the chin, combed down.
            let full = 0.45 + 0.75 * slope(p.y, face.mouth.y, face.chin);
            let high = lift * there * full * (1.0 + 0.3 * tuft) + 0.0005;
            let down = Vector::new(0.0, if stubble { 0.0 } else { 0.35 * high }, 0.0);
            Vertex {
                base: v,
                offset: out * high + down,
                torso_share: 0.0,
                colour: appearance
                    .hair_colour
                    .map(|c| c * (0.85 + 0.15 * tuft) + 8.0),
                uv: [p.x * 900.0 + share(seed, 1), p.y * 300.0 + p.z * 200.0],
                coverage: (there * if stubble { 0.42 } else { 2.2 }).min(1.0),
            }
        };
        let material = if stubble {
            Material::Skin
        } else {
            appearance.hair_material()
        };
        let mut own = vec![u32::MAX; n];
        for (triangle, &made) in asset.triangles.iter().zip(asset.parts.iter()) {
            let inside = |v: &u32| face.beard(&asset.neutral[*v as usize]) > 0.0;
            if made != Part::Skin || !triangle.iter().any(inside) {
                continue;
            }
            let corners = triangle.map(|v| {
                let slot = &mut own[v as usize];
                if *slot == u32::MAX {
                    *slot = self.vertices.len() as u32;
                    self.vertices.push(hair(v));
                }
                *slot
            });
            self.triangles.push((corners, material));
        }
    }

    /// Adds glasses: rims, bridge, temples, lenses.
    fn glasses(&mut self, asset: &HeadAsset, appearance: &Appearance) {
        let glasses = Glasses::from_asset(asset, appearance);
        let [right, left] = [36..42, 42..48].map(|eye| {
            let outline = eye.map(|k: usize| asset.landmarks[k].position(&asset.neutral).coords);
            outline.sum::<Vector>() / 6.0
        });
        for eye in [right, left] {
            let path: Vec<Point> = (0..=24).map(|k| glasses.rim_point(&eye, k, 1.0)).collect();
            self.rod(&glasses, &path, -Vector::z());
            let glass = Surface::new(Material::Glass, [235.0, 240.0, 245.0], 0.0);
            self.grid([5, 25], false, Material::Glass, |row, column| {
                // Columns run against the angle, so that the front faces the sensor.
                let p = glasses.rim_point(&eye, 24 - column, 0.02 + 0.24 * row as f32);
                // Only the highlight is visible.
                let mut vertex = glass.vertex(p, [0.0; 2], 0.10);
                vertex.uv = [p.x * 60.0 + 9.0, p.y * 90.0];
                vertex
            });
        }
        for (side, eye) in [(-1.0, right), (1.0, left)] {
            let [inner, outer] = [-1.0, 1.0].map(|out| eye.x + out * side * glasses.wide);
            let nose = [
                Point::new(inner, eye.y, glasses.bent(inner)),
                Point::new(0.0, eye.y - 0.003, glasses.front - 0.001),
            ];
            self.rod(&glasses, &nose, -Vector::z());
            let temple = [
                Point::new(outer, eye.y - 0.005, glasses.bent(outer)),
                Point::new(side * 0.074, eye.y - 0.006, 0.045),
                Point::new(side * 0.079, eye.y - 0.004, 0.09),
            ];
            self.rod(&glasses, &temple, Vector::x() * side);
        }
    }

    /// Adds a part of the frame.
    fn rod(&mut self, glasses: &Glasses, path: &[Point], out: Vector) {
        let section = |_| (out, [glasses.rim; 2]);
        self.tube(path, 6, Material::Dark, section, |i, p, turn| {
            glasses.frame.vertex(p, [i as f32, turn], 1.0)
        });
    }

    fn thing_colour(appearance: &Appearance, k: u64) -> [f32; 3] {
        let bright = 35.0 + 150.0 * share(appearance.seed, k);
        [1, 2, 3].map(|c| (bright * (0.75 + 0.5 * share(appearance.seed, k + c))).min(225.0))
    }

    fn cap(&mut self, skull: &Skull, appearance: &Appearance) {
        let colour = Self::thing_colour(appearance, 50);
        let mut surface = Surface::new(Material::Cloth, colour, 0.0);
        surface.cells = [40.0, 60.0];
        let lift = match appearance.hair {
            HairStyle::Bushy | HairStyle::Curly => 0.027,
            _ => 0.017,
        };
        let edge = |phi: f32| -0.052 + 0.014 * (1.0 - phi.cos());
        let rim = |phi: f32| {
            // Angle at which the skull reaches the height of the edge.
            let mut theta = 0.5;
            while theta < 2.0 && skull.point(theta, phi, lift).y < edge(phi) {
                theta += 0.01;
            }
            theta
        };
        const COLUMNS: usize = 48;
        let rims: Vec<f32> = (0..COLUMNS)
            .map(|c| rim(std::f32::consts::TAU * c as f32 / COLUMNS as f32))
            .collect();
        self.grid([16, COLUMNS], true, Material::Cloth, |row, column| {
            let phi = std::f32::consts::TAU * column as f32 / COLUMNS as f32;
            let theta = rims[column] * row as f32 / 15.0;
            // Raised at the front.
            let stand = 0.008 * slope(phi.cos(), 0.2, 1.0) * slope(theta, 0.2, 0.6);
            let mut vertex =
                surface.vertex(skull.point(theta, phi, lift + stand), [phi, theta], 1.0);
            if column % 8 == 0 {
                vertex.colour = vertex.colour.map(|c| 0.8 * c);
            }
            vertex
        });
        let long = 0.062 + 0.015 * share(appearance.seed, 55);
        self.sheet([7, 15], &surface, |u, v| {
            let phi = (2.0 * u - 1.0) * 1.0;
            let foot = skull.point(rim(phi), phi, lift);
            let reach = long * v * (1.0 - 0.35 * (2.0 * u - 1.0).powi(2));
            let bent = 0.012 * (2.0 * u - 1.0).powi(2) * v;
            Point::new(foot.x, foot.y + 0.10 * reach + bent, foot.z - reach)
        });
    }

    fn hood(&mut self, skull: &Skull, appearance: &Appearance) {
        let surface = Surface::new(appearance.clothes_material(), appearance.clothes, 0.0);
        let lift = match appearance.hair {
            HairStyle::Bushy | HairStyle::Curly => 0.050,
            _ => 0.030,
        };
        // Outside and inside. Rows: from the crown down to the neck; columns: from one side of the opening around the back to the
        // other.
        for inside in [false, true] {
            let lift = if inside { lift - 0.004 } else { lift };
            let turned = |column: usize, last: usize| {
                let column = if inside { last - column } else { column };
                column as f32 / last as f32
            };
            self.grid([34, 49], false, surface.material, |row, column| {
                let t = row as f32 / 33.0;
                let open = 0.98 - 0.45 * slope(t, 0.75, 1.0);
                let phi = open + (std::f32::consts::TAU - 2.0 * open) * turned(column, 48);
                let (along, below) = (HANGS * slope(t, 0.0, 0.55), 0.19 * slope(t, 0.55, 1.0));
                let fold = 0.006 * grain(phi * 3.0 + 11.0, t * 7.0);
                let mut p = skull.drape(along.max(0.02), below, phi, lift + fold);
                p.x *= 1.0 - 0.12 * slope(t, 0.6, 0.9);
                let mut vertex = surface.vertex(p, [phi, t], 1.0);
                vertex.torso_share = slope(p.y, 0.04, 0.16);
                if inside {
                    vertex.colour = vertex.colour.map(|c| 0.5 * c);
                }
                vertex
            });
            // The part above the opening.
            self.grid([12, 25], false, surface.material, |row, column| {
                let t = row as f32 / 11.0;
                let phi = 0.98 * (2.0 * turned(column, 24) - 1.0);
                let p = skull.point(0.02 + 0.86 * t, phi, lift + 0.010 * t);
                surface.vertex(p, [phi, t], 1.0)
            });
        }
        self.hem(skull, &surface, lift);
    }

    /// Adds the hem around the opening of a hood.
    fn hem(&mut self, skull: &Skull, surface: &Surface, lift: f32) {
        let hem = path(49, |t| {
            let side = if t < 0.5 { -1.0 } else { 1.0f32 };
            let from_top = (2.0 * t - 1.0).abs();
            let across = slope(from_top, 0.0, 0.3);
            let down = slope(from_top, 0.3, 1.0);
            let along = 0.88 + (HANGS - 0.88) * slope(down, 0.0, 0.5);
            let below = 0.12 * slope(down, 0.5, 1.0);
            skull.drape(along, below, side * 0.98 * across, lift + 0.008)
        });
        let middle = Vector::new(0.0, 0.0, 0.09);
        let section = |i: usize| ((hem[i].coords - middle).normalize(), [0.007, 0.006]);
        self.tube(&hem, 8, surface.material, section, |i, p, turn| {
            let mut vertex = surface.vertex(p, [turn, 0.1 * i as f32], 1.0);
            vertex.torso_share = slope(p.y, 0.04, 0.16);
            vertex
        });
    }

    fn headphones(&mut self, skull: &Skull, appearance: &Appearance) {
        let colour = [
            [28.0, 28.0, 30.0],
            [205.0, 205.0, 200.0],
            [60.0, 62.0, 70.0],
        ][(share(appearance.seed, 60) * 3.0) as usize % 3];
        let surface = Surface::new(Material::Dark, colour, 0.0);
        let above = match appearance.hair {
            HairStyle::Bushy => 0.040,
            HairStyle::Curly => 0.024,
            HairStyle::Bald | HairStyle::Cropped => 0.008,
            _ => 0.018,
        };
        let quarter = std::f32::consts::FRAC_PI_2;
        let path = path(25, |t| {
            let turn = (2.0 * t - 1.0) * 1.5;
            let p = skull.point(turn.abs(), quarter.copysign(turn), above);
            Point::new(p.x, p.y, 0.082)
        });
        let middle = Vector::new(0.0, -0.01, 0.082);
        let section = |i: usize| ((path[i].coords - middle).normalize(), [0.013, 0.006]);
        self.tube(&path, 8, Material::Dark, section, |i, p, turn| {
            surface.vertex(p, [turn, 0.1 * i as f32], 1.0)
        });
        for side in [-1.0, 1.0f32] {
            let out = 0.086 + 0.4 * above;
            self.ball([side * out, 0.012, 0.082], [0.019, 0.043, 0.036], &surface);
        }
    }

    fn scarf(&mut self, appearance: &Appearance) {
        let mut surface = Surface::new(Material::Cloth, Self::thing_colour(appearance, 70), 1.0);
        surface.cells = [6.0, 30.0];
        let turns = [(0.142, 0.088, 0.030), (0.172, 0.104, 0.030)];
        for (turn, (y, wide, thick)) in turns.into_iter().enumerate() {
            let path = path(33, |t| {
                let phi = std::f32::consts::TAU * t;
                let fold = 0.007 * grain(5.0 * phi.sin() + 9.0 * turn as f32, 5.0 * phi.cos());
                let wave = y + 0.012 * (phi + turn as f32).sin() + fold;
                let (across, ahead) = ((wide + fold) * phi.sin(), (wide + fold) * phi.cos());
                Point::new(across, wave, 0.098 - ahead)
            });
            let section = |i: usize| {
                let inward = Vector::new(0.0, path[i].y, 0.098) - path[i].coords;
                let round = thick * (0.9 + 0.2 * grain(i as f32 * 0.7, 3.0));
                (inward.normalize(), [round, thick * 0.8])
            };
            self.tube(&path, 12, Material::Cloth, section, |i, p, round| {
                surface.vertex(p, [0.2 * i as f32, round], 1.0)
            });
        }
        // One end hangs down the chest.
        self.sheet([10, 6], &surface, |u, v| {
            let z = -0.018 - 0.012 * (u * 3.0).sin() - 0.01 * v;
            Point::new(0.03 + 0.07 * u, 0.17 + 0.28 * v, z)
        });
    }

    fn collar(&mut self, appearance: &Appearance) {
        let colour = appearance.clothes.map(|c| 0.85 * c);
        let surface = Surface::new(appearance.clothes_material(), colour, 1.0);
        self.sheet([7, 41], &surface, |u, v| {
            let phi = 0.42 + (std::f32::consts::TAU - 0.84) * u;
            let open = slope(phi.cos(), 0.3, 0.95);
            let wide = 0.098 - 0.012 * v + 0.02 * open;
            let y = 0.215 - (0.125 - 0.03 * open) * v;
            Point::new(wide * phi.sin(), y, 0.100 - wide * phi.cos())
        });
    }

    /// Adds a chair's back and headrest.
    fn chair(&mut self, appearance: &Appearance) {
        let colour = Self::thing_colour(appearance, 80).map(|c| 0.6 * c);
        let surface = Surface::new(Material::Dark, colour, 1.0);
        let back = 0.275 + 0.03 * share(appearance.seed, 85);
        self.ball([0.0, 0.52, back], [0.25, 0.34, 0.05], &surface);
        self.ball([0.0, -0.01, back], [0.15, 0.085, 0.04], &surface);
        self.ball([0.0, 0.15, back + 0.01], [0.03, 0.14, 0.02], &surface);
    }
}

/// Measures of a face for the extent of a beard.
struct Face {
    mouth: Point,
    /// Half width and half height of the bare area around it, metres.
    bare: [f32; 2],
    nose: f32,
    chin: f32,
}

impl Face {
    fn from_asset(asset: &HeadAsset) -> Self {
        let at = |k: usize| asset.landmarks[k].position(&asset.neutral);
        let (left, right, upper, lower) = (at(48), at(54), at(51), at(57));
        let middle = nalgebra::center(&left, &right);
        Self {
            mouth: Point::new(middle.x, 0.5 * (upper.y + lower.y), middle.z),
            bare: [0.56 * (right.x - left.x), 0.62 * (lower.y - upper.y)],
            nose: at(33).y,
            chin: at(8).y,
        }
    }

    /// Density of the beard at a point, 0…1.
    fn beard(&self, p: &Point) -> f32 {
        // `BEARD_LINE` is for a nose that ends 44 mm below the eyes.
        let top = along(&BEARD_LINE, p.x.abs()) + (self.nose - 0.044);
        let [wide, high] = self.bare;
        let mouth = ((p.x - self.mouth.x) / wide).hypot((p.y - self.mouth.y) / high);
        let below = slope(p.y, top - 0.003, top + 0.006);
        let above = slope(p.y, self.chin + 0.028, self.chin + 0.012);
        let front = slope(p.z, 0.078, 0.066);
        below.min(above).min(front) * slope(mouth, 0.95, 1.2)
    }
}

/// Measures of glasses, metres.
struct Glasses {
    frame: Surface,
    rim: f32,
    /// Half width of a rim.
    wide: f32,
    /// Half height of a rim.
    high: f32,
    /// z of the bridge.
    front: f32,
}

impl Glasses {
    fn from_asset(asset: &HeadAsset, appearance: &Appearance) -> Self {
        let is_dark = share(appearance.seed, 40) < 0.6;
        let colour = [[120.0, 96.0, 70.0], [32.0, 28.0, 27.0]][usize::from(is_dark)];
        Self {
            frame: Surface::new(Material::Dark, colour, 0.0),
            rim: appearance.rims_m,
            wide: 0.024 + 0.003 * share(appearance.seed, 41),
            high: 0.017 + 0.005 * share(appearance.seed, 42),
            front: asset.landmarks[27].position(&asset.neutral).z - 0.004,
        }
    }

    /// z of the frame at x: bent around the face.
    fn bent(&self, x: f32) -> f32 {
        self.front + 6.0 * x * x
    }

    /// Point `k`/24 around a rim, at a share of the way from the eye; the shape is between an ellipse and a box.
    fn rim_point(&self, eye: &Vector, k: usize, share: f32) -> Point {
        let (sin, cos) = (std::f32::consts::TAU * k as f32 / 24.0).sin_cos();
        let power = |c: f32| c.abs().sqrt().copysign(c) * 0.5 + c * 0.5;
        let x = eye.x + share * self.wide * power(cos);
        let y = eye.y + 0.003 + share * self.high * power(sin);
        Point::new(x, y, self.bent(x))
    }
}
