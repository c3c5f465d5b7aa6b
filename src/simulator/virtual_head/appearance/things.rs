//! What else a person wears or holds: beards, glasses, hats, headphones, scarves, collars, hands, a chair.
//! One file: things, one function each.

use super::look::{Beard, HairStyle, Headgear, Held, Look, Neck};
use super::outfit::{Cloth, Knot, Outfit};
use super::skull::{HANGS, Skull};
use super::stuff::{Stuff, grain, part, share, slope};
use crate::base::geometry::{Point, Vector};
use crate::simulator::virtual_head::asset::{HeadAsset, Part};

/// Upper edge of a beard (y, metres) by distance from the middle of the face.
const BEARD_LINE: [[f32; 2]; 5] = [
    [0.0, 0.047],
    [0.03, 0.050],
    [0.045, 0.046],
    [0.060, 0.022],
    [0.072, -0.006],
];
const SKIN: [f32; 3] = [198.0, 152.0, 128.0];

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

    /// Adds a flat or bent sheet, seen from both sides: `at` of two numbers in 0…1.
    fn sheet(&mut self, cells: [usize; 2], cloth: &Cloth, at: impl Fn(f32, f32) -> Point) {
        let [rows, columns] = cells;
        for back in [false, true] {
            self.grid(cells, false, cloth.stuff, |row, column| {
                let v = row as f32 / (rows - 1) as f32;
                let u = column as f32 / (columns - 1) as f32;
                let u = if back { 1.0 - u } else { u };
                cloth.knot(at(u, v), [u, v], 1.0)
            });
        }
    }

    /// Hair on the skin of the lower face, which moves with it.
    fn beard(&mut self, asset: &HeadAsset, look: &Look, lift: f32) {
        let n = asset.neutral.len();
        let mut normals = vec![Vector::zeros(); n];
        for t in asset.triangles.iter() {
            let [a, b, c] = t.map(|k| k as usize);
            let p = asset.neutral[a];
            let normal = (asset.neutral[c] - p).cross(&(asset.neutral[b] - p));
            for v in [a, b, c] {
                normals[v] += normal;
            }
        }
        let at = |k: usize| asset.landmarks[k].on(&asset.neutral);
        let (left, right) = (at(48), at(54));
        let (upper, lower) = (at(51), at(57));
        let nose = at(33);
        let lips = nalgebra::center(&left, &right);
        let (wide, high) = (0.56 * (right.x - left.x), 0.62 * (lower.y - upper.y));
        let middle = 0.5 * (upper.y + lower.y);
        let chin = at(8).y;
        let stubble = lift < 0.002;
        let seed = part(look.seed, 3);
        let mask = |p: &Point| {
            let aside = p.x.abs();
            let k = BEARD_LINE.iter().position(|k| k[0] > aside);
            let top = match k {
                Some(k) => {
                    let ([x, y], [q, r]) = (BEARD_LINE[k - 1], BEARD_LINE[k]);
                    y + (r - y) * (aside - x) / (q - x)
                }
                None => -0.006,
            };
            // The line is drawn for a nose that ends 44 mm below the eyes.
            let top = top + (nose.y - 0.044);
            let mouth = ((p.x - lips.x) / wide).hypot((p.y - middle) / high);
            let below = slope(p.y, top - 0.003, top + 0.006);
            let above = slope(p.y, chin + 0.028, chin + 0.012);
            let front = slope(p.z, 0.078, 0.066);
            below.min(above).min(front) * slope(mouth, 0.95, 1.2)
        };
        let mut own = vec![u32::MAX; n];
        for (triangle, &made) in asset.triangles.iter().zip(asset.parts.iter()) {
            let inside = |v: &u32| mask(&asset.neutral[*v as usize]) > 0.0;
            if made != Part::Skin || !triangle.iter().any(inside) {
                continue;
            }
            let corners = triangle.map(|v| {
                let slot = &mut own[v as usize];
                if *slot == u32::MAX {
                    *slot = self.knots.len() as u32;
                    let p = asset.neutral[v as usize];
                    let there = mask(&p);
                    let out = normals[v as usize] / normals[v as usize].norm().max(1e-12);
                    let tuft = grain(p.x * 190.0 + 77.0, p.y * 190.0 + p.z * 130.0);
                    // Fullest at the chin, combed down.
                    let full = 0.45 + 0.75 * slope(p.y, middle, chin);
                    let high = lift * there * full * (1.0 + 0.3 * tuft) + 0.0005;
                    let down = Vector::new(0.0, if stubble { 0.0 } else { 0.35 * high }, 0.0);
                    self.knots.push(Knot {
                        base: v,
                        offset: out * high + down,
                        // As the neck below it does.
                        stays: 0.0,
                        colour: look.hair_colour.map(|c| c * (0.85 + 0.15 * tuft) + 8.0),
                        weave: [p.x * 900.0 + share(seed, 1), p.y * 300.0 + p.z * 200.0],
                        cover: (there * if stubble { 0.42 } else { 2.2 }).min(1.0),
                    });
                }
                *slot
            });
            let stuff = if stubble {
                Stuff::Skin
            } else {
                look.hair_stuff()
            };
            self.triangles.push((corners, stuff));
        }
    }

    /// Rims around both eyes, a bridge, temples to the ears, glass.
    fn glasses(&mut self, asset: &HeadAsset, look: &Look) {
        let dark = share(look.seed, 40) < 0.6;
        let colour = if dark {
            [32.0, 28.0, 27.0]
        } else {
            [120.0, 96.0, 70.0]
        };
        let frame = Cloth::new(Stuff::Dark, colour, 0.0);
        let rim = look.rims_m;
        let (right, left) = (eye_middle(asset, 36), eye_middle(asset, 42));
        let bridge = asset.landmarks[27].on(&asset.neutral);
        let (wide, high) = (
            0.024 + 0.003 * share(look.seed, 41),
            0.017 + 0.005 * share(look.seed, 42),
        );
        let front = bridge.z - 0.004;
        // Bent around the face.
        let around = |x: f32| front + 6.0 * x * x;
        let knot = |p: Point, u: f32, v: f32| frame.knot(p, [u, v], 1.0);
        for eye in [right, left] {
            let round = |k: usize, share: f32| {
                let (sin, cos) = (std::f32::consts::TAU * k as f32 / 24.0).sin_cos();
                // Between an ellipse and a box.
                let power = |c: f32| c.abs().sqrt().copysign(c) * 0.5 + c * 0.5;
                let x = eye.x + share * wide * power(cos);
                Point::new(x, eye.y + 0.003 + share * high * power(sin), around(x))
            };
            let path: Vec<Point> = (0..=24).map(|k| round(k, 1.0)).collect();
            self.tube(
                &path,
                |_| -Vector::z(),
                |_| [rim, rim],
                6,
                Stuff::Dark,
                |i, p, turn| knot(p, i as f32, turn),
            );
            let mut glass = Cloth::new(Stuff::Glass, [235.0, 240.0, 245.0], 0.0);
            glass.cells = [3.0, 2.0];
            self.grid([5, 25], false, Stuff::Glass, |row, column| {
                // Columns run the other way than the angle, so that the glass is seen from before.
                let p = round(24 - column, 0.02 + 0.24 * row as f32);
                // Only its glint is seen.
                let mut knot = glass.knot(p, [row as f32, column as f32 * 0.2], 0.10);
                knot.weave = [p.x * 60.0 + 9.0, p.y * 90.0];
                knot
            });
        }
        for side in [-1.0, 1.0f32] {
            let eye = if side < 0.0 { right } else { left };
            let inner = eye.x - side * wide;
            let outer = eye.x + side * wide;
            let nose = [
                Point::new(inner, eye.y, around(inner)),
                Point::new(0.0, eye.y - 0.003, front - 0.001),
            ];
            let temple = [
                Point::new(outer, eye.y - 0.005, around(outer)),
                Point::new(side * 0.074, eye.y - 0.006, 0.045),
                Point::new(side * 0.079, eye.y - 0.004, 0.09),
            ];
            for path in [&nose[..], &temple[..]] {
                let out = if path.len() == 2 {
                    -Vector::z()
                } else {
                    Vector::x() * side
                };
                self.tube(
                    path,
                    |_| out,
                    |_| [rim, rim],
                    6,
                    Stuff::Dark,
                    |i, p, turn| knot(p, i as f32, turn),
                );
            }
        }
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
            Point::new(
                foot.x,
                foot.y + 0.10 * reach + 0.012 * (2.0 * u - 1.0).powi(2) * v,
                foot.z - reach,
            )
        });
    }

    fn hood(&mut self, skull: &Skull, look: &Look) {
        let mut cloth = Cloth::new(Stuff::Cloth, look.clothes, 0.0);
        if look.clothes.iter().sum::<f32>() < 150.0 {
            cloth.stuff = Stuff::Dark;
        }
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
        // The hem around the opening, from one side over the brow to the other.
        let hem: Vec<Point> = (0..49)
            .map(|k| {
                let side = if k < 24 { -1.0 } else { 1.0f32 };
                let from_top = (k as f32 / 24.0 - 1.0).abs();
                let across = slope(from_top, 0.0, 0.3);
                let down = slope(from_top, 0.3, 1.0);
                let (along, below) = (
                    0.88 + (HANGS - 0.88) * slope(down, 0.0, 0.5),
                    0.12 * slope(down, 0.5, 1.0),
                );
                skull.drape(along, below, side * 0.98 * across, lift + 0.008)
            })
            .collect();
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
        let path: Vec<Point> = (0..25)
            .map(|k| {
                let turn = (k as f32 / 12.0 - 1.0) * 1.5;
                let p = skull.point(turn.abs(), quarter.copysign(turn), above);
                Point::new(p.x, p.y, 0.082)
            })
            .collect();
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
        for (turn, (y, wide, thick)) in [(0.142, 0.088, 0.030), (0.172, 0.104, 0.030)]
            .into_iter()
            .enumerate()
        {
            let path: Vec<Point> = (0..=32)
                .map(|k| {
                    let phi = std::f32::consts::TAU * k as f32 / 32.0;
                    let fold = 0.007 * grain(5.0 * phi.sin() + 9.0 * turn as f32, 5.0 * phi.cos());
                    Point::new(
                        (wide + fold) * phi.sin(),
                        y + 0.012 * (phi * 1.0 + turn as f32).sin() + fold,
                        0.098 - (wide + fold) * phi.cos(),
                    )
                })
                .collect();
            self.tube(
                &path,
                |i| {
                    let d = path[i].coords - Vector::new(0.0, path[i].y, 0.098);
                    -d.normalize()
                },
                |i| {
                    [
                        thick * (0.9 + 0.2 * grain(i as f32 * 0.7, 3.0)),
                        thick * 0.8,
                    ]
                },
                12,
                Stuff::Cloth,
                |i, p, round| cloth.knot(p, [0.2 * i as f32, round], 1.0),
            );
        }
        // One end hangs down the chest.
        self.sheet([10, 6], &cloth, |u, v| {
            Point::new(
                0.03 + 0.07 * u,
                0.17 + 0.28 * v,
                -0.018 - 0.012 * (u * 3.0).sin() - 0.01 * v,
            )
        });
    }

    fn collar(&mut self, look: &Look) {
        let cloth = Cloth::new(
            if look.clothes.iter().sum::<f32>() < 150.0 {
                Stuff::Dark
            } else {
                Stuff::Cloth
            },
            look.clothes.map(|c| 0.85 * c),
            1.0,
        );
        self.sheet([7, 41], &cloth, |u, v| {
            let phi = 0.42 + (std::f32::consts::TAU - 0.84) * u;
            let open = slope(phi.cos(), 0.3, 0.95);
            let wide = 0.098 - 0.012 * v + 0.02 * open;
            Point::new(
                wide * phi.sin(),
                0.215 - (0.125 - 0.03 * open) * v,
                0.100 - wide * phi.cos(),
            )
        });
    }

    /// A chair's back up to the shoulders, and a headrest.
    fn chair(&mut self, look: &Look) {
        let cloth = Cloth::new(
            Stuff::Dark,
            Self::thing_colour(look, 80).map(|c| 0.6 * c),
            1.0,
        );
        let back = 0.275 + 0.03 * share(look.seed, 85);
        self.ball([0.0, 0.52, back], [0.25, 0.34, 0.05], &cloth);
        self.ball([0.0, -0.01, back], [0.15, 0.085, 0.04], &cloth);
        self.ball([0.0, 0.15, back + 0.01], [0.03, 0.14, 0.02], &cloth);
    }

    /// A hand with what it holds and its forearm; its origin is what it comes to: the chin, the mouth, the ear, or the
    /// middle of the face for a sheet.
    pub(crate) fn held(look: &Look) -> Self {
        let mut outfit = Self::default();
        let seed = part(look.seed, 9);
        let side = if share(seed, 1) < 0.5 { -1.0 } else { 1.0f32 };
        let mut fist = |x: f32, y: f32, z: f32| outfit.fist([x, y, z], side, look);
        match look.held {
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

    /// A fist at a place and its forearm.
    fn fist(&mut self, [x, y, z]: [f32; 3], side: f32, look: &Look) {
        let skin = Cloth::new(Stuff::Skin, SKIN, 0.0);
        self.ball([x, y, z], [0.040, 0.034, 0.030], &skin);
        for k in 0..4 {
            let up = y - 0.024 + 0.016 * k as f32;
            self.ball(
                [x - side * 0.016, up, z - 0.022],
                [0.026, 0.0085, 0.010],
                &skin,
            );
        }
        // The forearm goes down and outwards, to an elbow on the table.
        let sleeve = Cloth::new(Stuff::Cloth, look.clothes, 0.0);
        let path: Vec<Point> = (0..8)
            .map(|i| {
                let t = i as f32 / 7.0;
                Point::new(
                    x + side * 0.13 * t,
                    y + 0.02 + 0.34 * t,
                    z + 0.01 + 0.05 * t,
                )
            })
            .collect();
        self.tube(
            &path,
            |_| -Vector::z(),
            |i| {
                let r = 0.026 + 0.003 * i as f32;
                [r, r]
            },
            14,
            Stuff::Cloth,
            |i, p, turn| {
                let cloth = if i < 2 { &skin } else { &sleeve };
                cloth.knot(p, [turn * 0.3, 0.05 * i as f32], 1.0)
            },
        );
    }

    fn cup(&mut self) {
        let china = Cloth::new(Stuff::Matt, [222.0, 220.0, 214.0], 0.0);
        let path = [
            Point::new(0.0, 0.005, -0.045),
            Point::new(0.0, 0.045, -0.055),
            Point::new(0.0, 0.088, -0.058),
            Point::new(0.0, 0.089, -0.058),
        ];
        self.tube(
            &path,
            |_| -Vector::z(),
            |i| {
                [
                    [0.041, 0.041],
                    [0.040, 0.040],
                    [0.034, 0.034],
                    [0.001, 0.001],
                ][i]
            },
            18,
            Stuff::Matt,
            |i, p, turn| china.knot(p, [turn, i as f32], 1.0),
        );
    }

    fn palm(&mut self, side: f32) {
        // The palm across the mouth, the fingers over the other cheek.
        let knuckle = Cloth::new(Stuff::Skin, SKIN, 0.0);
        self.ball(
            [side * 0.012, 0.008, -0.014],
            [0.046, 0.036, 0.016],
            &knuckle,
        );
        for k in 0..4 {
            let up = -0.018 + 0.017 * k as f32;
            self.ball([-side * 0.046, up, -0.004], [0.034, 0.009, 0.010], &knuckle);
        }
    }

    fn phone(&mut self, side: f32) {
        let case = Cloth::new(Stuff::Gloss, [24.0, 24.0, 28.0], 0.0);
        self.sheet([4, 4], &case, |u, v| {
            Point::new(
                side * (0.088 + 0.004 * u),
                0.05 - 0.13 * v,
                0.005 + 0.07 * u,
            )
        });
    }

    fn paper(&mut self, side: f32, seed: u64) {
        let x = side * 0.17;
        let paper = Cloth::new(Stuff::Matt, [228.0, 228.0, 224.0], 0.0);
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

/// The middle of an eye whose outline begins with this landmark.
fn eye_middle(asset: &HeadAsset, from: usize) -> Vector {
    let sum = (from..from + 6).fold(Vector::zeros(), |sum, k| {
        sum + asset.landmarks[k].on(&asset.neutral).coords
    });
    sum / 6.0
}

impl Held {
    /// Where the hand is at `t` seconds: its place in the head frame, and how far up it is; `None`: out of the picture.
    pub(crate) fn at(self, t: f32) -> Option<Point> {
        let place = match self {
            Self::None => return None,
            Self::Chin => Point::new(0.0, 0.112, -0.030),
            Self::Cup | Self::Mouth => Point::new(0.0, 0.066, -0.030),
            Self::Phone => Point::new(0.0, 0.0, 0.030),
            Self::Paper => Point::new(0.0, 0.0, 0.0),
        };
        // Comes every nine seconds; a cup stays for as long as a sip takes, a hand over the mouth for a second and soon again.
        let (every, comes, takes, stays) = match self {
            Self::Cup => (9.0, 3.0, 0.7, 1.2),
            Self::Mouth => (4.3, 2.6, 0.3, 1.0),
            _ => (9.0, 3.0, 0.7, 3.5),
        };
        let (phase, goes) = (t % every, comes + takes + stays);
        let smooth = |f: f32| f * f * (3.0 - 2.0 * f);
        let up =
            smooth(slope(phase, comes, comes + takes)) - smooth(slope(phase, goes, goes + takes));
        (up > 0.0).then(|| Point::new(place.x, place.y + 0.55 * (1.0 - up), place.z))
    }
}
