//! What else a person wears: beards, glasses, hats, headphones, scarves, collars; and a chair.

use super::look::{Beard, HairStyle, Headgear, Look, Neck};
use super::outfit::{Cloth, Knot, Outfit, path};
use super::skull::{HANGS, Skull};
use super::stuff::{Stuff, along, grain, part, share, slope};
use crate::virtual_head::asset::{HeadAsset, Part};
use crate::virtual_head::raster::sum_normals;
use mien_stages::base::geometry::{Point, Vector};

/// Upper edge of a beard (y, metres) by distance from the middle of the face.
const BEARD_LINE: [[f32; 2]; 5] = [
    [0.0, 0.047],
    [0.03, 0.050],
    [0.045, 0.046],
    [0.060, 0.022],
    [0.072, -0.006],
];

impl Outfit {
    pub(super) fn things(&mut self, asset: &HeadAsset, skull: &Skull, look: &Look) {
        match look.beard {
            Beard::None => {}
            Beard::Stubble => self.beard(asset, look, 0.0006),
            Beard::Full => self.beard(asset, look, 0.008 + 0.012 * share(look.seed, 31)),
        }
        if look.rims_m > 0.0 {
            self.glasses(asset, look);
        }
        match look.headgear {
            Headgear::None => {}
            Headgear::Cap => self.cap(skull, look),
            Headgear::Hood => self.hood(skull, look),
            Headgear::Headphones => self.headphones(skull, look),
        }
        match look.neck {
            Neck::None => {}
            Neck::Scarf => self.scarf(look),
            Neck::Collar => self.collar(look),
        }
        if look.chair {
            self.chair(look);
        }
    }

    /// Hair on the skin of the lower face, which moves with it.
    fn beard(&mut self, asset: &HeadAsset, look: &Look, lift: f32) {
        let n = asset.neutral.len();
        let mut normals = vec![Vector::zeros(); n];
        let triangles = asset.triangles.iter().map(|t| t.map(|k| k as usize));
        sum_normals(triangles, &asset.neutral, &mut normals);
        let face = Face::from_asset(asset);
        let stubble = lift < 0.002;
        let seed = part(look.seed, 3);
        let hair = |v: u32| {
            let p = asset.neutral[v as usize];
            let there = face.beard(&p);
            let out = normals[v as usize] / normals[v as usize].norm().max(1e-12);
            let tuft = grain(p.x * 190.0 + 77.0, p.y * 190.0 + p.z * 130.0);
            // Fullest at the chin, combed down.
            let full = 0.45 + 0.75 * slope(p.y, face.mouth.y, face.chin);
            let high = lift * there * full * (1.0 + 0.3 * tuft) + 0.0005;
            let down = Vector::new(0.0, if stubble { 0.0 } else { 0.35 * high }, 0.0);
            Knot {
                base: v,
                offset: out * high + down,
                // As the neck below it does.
                stays: 0.0,
                colour: look.hair_colour.map(|c| c * (0.85 + 0.15 * tuft) + 8.0),
                weave: [p.x * 900.0 + share(seed, 1), p.y * 300.0 + p.z * 200.0],
                cover: (there * if stubble { 0.42 } else { 2.2 }).min(1.0),
            }
        };
        let stuff = if stubble {
            Stuff::Skin
        } else {
            look.hair_stuff()
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
                    *slot = self.knots.len() as u32;
                    self.knots.push(hair(v));
                }
                *slot
            });
            self.triangles.push((corners, stuff));
        }
    }

    /// Rims around both eyes, a bridge, temples to the ears, glass.
    fn glasses(&mut self, asset: &HeadAsset, look: &Look) {
        let glasses = Glasses::from_asset(asset, look);
        let [right, left] = [36..42, 42..48].map(|eye| {
            let outline = eye.map(|k: usize| asset.landmarks[k].on(&asset.neutral).coords);
            outline.sum::<Vector>() / 6.0
        });
        for eye in [right, left] {
            let path: Vec<Point> = (0..=24).map(|k| glasses.rim_point(&eye, k, 1.0)).collect();
            self.rod(&glasses, &path, -Vector::z());
            let glass = Cloth::new(Stuff::Glass, [235.0, 240.0, 245.0], 0.0);
            self.grid([5, 25], false, Stuff::Glass, |row, column| {
                // Columns run the other way than the angle, so that the glass is seen from before.
                let p = glasses.rim_point(&eye, 24 - column, 0.02 + 0.24 * row as f32);
                // Only its glint is seen.
                let mut knot = glass.knot(p, [0.0; 2], 0.10);
                knot.weave = [p.x * 60.0 + 9.0, p.y * 90.0];
                knot
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

    /// A part of the frame.
    fn rod(&mut self, glasses: &Glasses, path: &[Point], out: Vector) {
        let knot = |i: usize, p, turn| glasses.frame.knot(p, [i as f32, turn], 1.0);
        self.tube(path, |_| out, |_| [glasses.rim; 2], 6, Stuff::Dark, knot);
    }

    fn thing_colour(look: &Look, k: u64) -> [f32; 3] {
        let bright = 35.0 + 150.0 * share(look.seed, k);
        [1, 2, 3].map(|c| (bright * (0.75 + 0.5 * share(look.seed, k + c))).min(225.0))
    }

    fn cap(&mut self, skull: &Skull, look: &Look) {
        let colour = Self::thing_colour(look, 50);
        let mut cloth = Cloth::new(Stuff::Cloth, colour, 0.0);
        cloth.cells = [40.0, 60.0];
        let lift = match look.hair {
            HairStyle::Bushy | HairStyle::Curly => 0.027,
            _ => 0.017,
        };
        let edge = |phi: f32| -0.052 + 0.014 * (1.0 - phi.cos());
        let rim = |phi: f32| {
            // Down the skull until the edge's height.
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
        self.grid([16, COLUMNS], true, Stuff::Cloth, |row, column| {
            let phi = std::f32::consts::TAU * column as f32 / COLUMNS as f32;
            let theta = rims[column] * row as f32 / 15.0;
            // Stands a little above the crown in front.
            let stand = 0.008 * slope(phi.cos(), 0.2, 1.0) * slope(theta, 0.2, 0.6);
            let mut knot = cloth.knot(skull.point(theta, phi, lift + stand), [phi, theta], 1.0);
            if column % 8 == 0 {
                knot.colour = knot.colour.map(|c| 0.8 * c);
            }
            knot
        });
        let long = 0.062 + 0.015 * share(look.seed, 55);
        self.sheet([7, 15], &cloth, |u, v| {
            let phi = (2.0 * u - 1.0) * 1.0;
            let foot = skull.point(rim(phi), phi, lift);
            let reach = long * v * (1.0 - 0.35 * (2.0 * u - 1.0).powi(2));
            let bent = 0.012 * (2.0 * u - 1.0).powi(2) * v;
            Point::new(foot.x, foot.y + 0.10 * reach + bent, foot.z - reach)
        });
    }

    fn hood(&mut self, skull: &Skull, look: &Look) {
        let cloth = Cloth::new(look.clothes_stuff(), look.clothes, 0.0);
        let lift = match look.hair {
            HairStyle::Bushy | HairStyle::Curly => 0.050,
            _ => 0.030,
        };
        // From the edge around the face over the head and down to the neck, outside and inside; columns from one side of the
        // opening around the back to the other.
        for inside in [false, true] {
            let lift = if inside { lift - 0.004 } else { lift };
            let turned = |column: usize, last: usize| {
                let column = if inside { last - column } else { column };
                column as f32 / last as f32
            };
            self.grid([34, 49], false, cloth.stuff, |row, column| {
                let t = row as f32 / 33.0;
                let open = 0.98 - 0.45 * slope(t, 0.75, 1.0);
                let phi = open + (std::f32::consts::TAU - 2.0 * open) * turned(column, 48);
                let (along, below) = (HANGS * slope(t, 0.0, 0.55), 0.19 * slope(t, 0.55, 1.0));
                let fold = 0.006 * grain(phi * 3.0 + 11.0, t * 7.0);
                let mut p = skull.drape(along.max(0.02), below, phi, lift + fold);
                p.x *= 1.0 - 0.12 * slope(t, 0.6, 0.9);
                let mut knot = cloth.knot(p, [phi, t], 1.0);
                knot.stays = slope(p.y, 0.04, 0.16);
                if inside {
                    knot.colour = knot.colour.map(|c| 0.5 * c);
                }
                knot
            });
            // Over the brow: from one side's edge to the other's.
            self.grid([12, 25], false, cloth.stuff, |row, column| {
                let t = row as f32 / 11.0;
                let phi = 0.98 * (2.0 * turned(column, 24) - 1.0);
                let p = skull.point(0.02 + 0.86 * t, phi, lift + 0.010 * t);
                cloth.knot(p, [phi, t], 1.0)
            });
        }
        self.hem(skull, &cloth, lift);
    }

    /// The hem around the opening, from one side over the brow to the other.
    fn hem(&mut self, skull: &Skull, cloth: &Cloth, lift: f32) {
        let hem = path(49, |t| {
            let side = if t < 0.5 { -1.0 } else { 1.0f32 };
            let from_top = (2.0 * t - 1.0).abs();
            let across = slope(from_top, 0.0, 0.3);
            let down = slope(from_top, 0.3, 1.0);
            let along = 0.88 + (HANGS - 0.88) * slope(down, 0.0, 0.5);
            let below = 0.12 * slope(down, 0.5, 1.0);
            skull.drape(along, below, side * 0.98 * across, lift + 0.008)
        });
        self.tube(
            &hem,
            |i| (hem[i].coords - Vector::new(0.0, 0.0, 0.09)).normalize(),
            |_| [0.007, 0.006],
            8,
            cloth.stuff,
            |i, p, turn| {
                let mut knot = cloth.knot(p, [turn, 0.1 * i as f32], 1.0);
                knot.stays = slope(p.y, 0.04, 0.16);
                knot
            },
        );
    }

    fn headphones(&mut self, skull: &Skull, look: &Look) {
        let colour = [
            [28.0, 28.0, 30.0],
            [205.0, 205.0, 200.0],
            [60.0, 62.0, 70.0],
        ][(share(look.seed, 60) * 3.0) as usize % 3];
        let cloth = Cloth::new(Stuff::Dark, colour, 0.0);
        let above = match look.hair {
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
        self.tube(
            &path,
            |i| (path[i].coords - middle).normalize(),
            |_| [0.013, 0.006],
            8,
            Stuff::Dark,
            |i, p, turn| cloth.knot(p, [turn, 0.1 * i as f32], 1.0),
        );
        for side in [-1.0, 1.0f32] {
            let out = 0.086 + 0.4 * above;
            self.ball([side * out, 0.012, 0.082], [0.019, 0.043, 0.036], &cloth);
        }
    }

    fn scarf(&mut self, look: &Look) {
        let mut cloth = Cloth::new(Stuff::Cloth, Self::thing_colour(look, 70), 1.0);
        cloth.cells = [6.0, 30.0];
        let turns = [(0.142, 0.088, 0.030), (0.172, 0.104, 0.030)];
        for (turn, (y, wide, thick)) in turns.into_iter().enumerate() {
            let path = path(33, |t| {
                let phi = std::f32::consts::TAU * t;
                let fold = 0.007 * grain(5.0 * phi.sin() + 9.0 * turn as f32, 5.0 * phi.cos());
                let wave = y + 0.012 * (phi + turn as f32).sin() + fold;
                let (across, ahead) = ((wide + fold) * phi.sin(), (wide + fold) * phi.cos());
                Point::new(across, wave, 0.098 - ahead)
            });
            let round = |i: usize| thick * (0.9 + 0.2 * grain(i as f32 * 0.7, 3.0));
            self.tube(
                &path,
                |i| -(path[i].coords - Vector::new(0.0, path[i].y, 0.098)).normalize(),
                |i| [round(i), thick * 0.8],
                12,
                Stuff::Cloth,
                |i, p, round| cloth.knot(p, [0.2 * i as f32, round], 1.0),
            );
        }
        // One end hangs down the chest.
        self.sheet([10, 6], &cloth, |u, v| {
            let z = -0.018 - 0.012 * (u * 3.0).sin() - 0.01 * v;
            Point::new(0.03 + 0.07 * u, 0.17 + 0.28 * v, z)
        });
    }

    fn collar(&mut self, look: &Look) {
        let colour = look.clothes.map(|c| 0.85 * c);
        let cloth = Cloth::new(look.clothes_stuff(), colour, 1.0);
        self.sheet([7, 41], &cloth, |u, v| {
            let phi = 0.42 + (std::f32::consts::TAU - 0.84) * u;
            let open = slope(phi.cos(), 0.3, 0.95);
            let wide = 0.098 - 0.012 * v + 0.02 * open;
            let y = 0.215 - (0.125 - 0.03 * open) * v;
            Point::new(wide * phi.sin(), y, 0.100 - wide * phi.cos())
        });
    }

    /// A chair's back up to the shoulders, and a headrest.
    fn chair(&mut self, look: &Look) {
        let colour = Self::thing_colour(look, 80).map(|c| 0.6 * c);
        let cloth = Cloth::new(Stuff::Dark, colour, 1.0);
        let back = 0.275 + 0.03 * share(look.seed, 85);
        self.ball([0.0, 0.52, back], [0.25, 0.34, 0.05], &cloth);
        self.ball([0.0, -0.01, back], [0.15, 0.085, 0.04], &cloth);
        self.ball([0.0, 0.15, back + 0.01], [0.03, 0.14, 0.02], &cloth);
    }
}

/// Where a beard grows.
struct Face {
    mouth: Point,
    /// Half width and height of what stays bare around it.
    bare: [f32; 2],
    nose: f32,
    chin: f32,
}

impl Face {
    fn from_asset(asset: &HeadAsset) -> Self {
        let at = |k: usize| asset.landmarks[k].on(&asset.neutral);
        let (left, right, upper, lower) = (at(48), at(54), at(51), at(57));
        let middle = nalgebra::center(&left, &right);
        Self {
            mouth: Point::new(middle.x, 0.5 * (upper.y + lower.y), middle.z),
            bare: [0.56 * (right.x - left.x), 0.62 * (lower.y - upper.y)],
            nose: at(33).y,
            chin: at(8).y,
        }
    }

    /// How far there is a beard, 0…1.
    fn beard(&self, p: &Point) -> f32 {
        // The line is drawn for a nose that ends 44 mm below the eyes.
        let top = along(&BEARD_LINE, p.x.abs()) + (self.nose - 0.044);
        let [wide, high] = self.bare;
        let mouth = ((p.x - self.mouth.x) / wide).hypot((p.y - self.mouth.y) / high);
        let below = slope(p.y, top - 0.003, top + 0.006);
        let above = slope(p.y, self.chin + 0.028, self.chin + 0.012);
        let front = slope(p.z, 0.078, 0.066);
        below.min(above).min(front) * slope(mouth, 0.95, 1.2)
    }
}

/// How glasses are made.
struct Glasses {
    frame: Cloth,
    rim: f32,
    /// Half width and height of a rim.
    wide: f32,
    high: f32,
    /// Distance of the bridge.
    front: f32,
}

impl Glasses {
    fn from_asset(asset: &HeadAsset, look: &Look) -> Self {
        let colour = if share(look.seed, 40) < 0.6 {
            [32.0, 28.0, 27.0]
        } else {
            [120.0, 96.0, 70.0]
        };
        Self {
            frame: Cloth::new(Stuff::Dark, colour, 0.0),
            rim: look.rims_m,
            wide: 0.024 + 0.003 * share(look.seed, 41),
            high: 0.017 + 0.005 * share(look.seed, 42),
            front: asset.landmarks[27].on(&asset.neutral).z - 0.004,
        }
    }

    /// Distance at a place across: bent around the face.
    fn bent(&self, x: f32) -> f32 {
        self.front + 6.0 * x * x
    }

    /// A place on a rim, or on a share of the way to it: between an ellipse and a box.
    fn rim_point(&self, eye: &Vector, k: usize, share: f32) -> Point {
        let (sin, cos) = (std::f32::consts::TAU * k as f32 / 24.0).sin_cos();
        let power = |c: f32| c.abs().sqrt().copysign(c) * 0.5 + c * 0.5;
        let x = eye.x + share * self.wide * power(cos);
        let y = eye.y + 0.003 + share * self.high * power(sin);
        Point::new(x, y, self.bent(x))
    }
}
