//! What frames or covers a face in a training picture: hair beside it and over the brow, caps, hoods, headphones, scarves,
//! masks; drawn over the grey picture.
//!
//! Drawn from the projected landmarks, so all of it turns and grows with the face; seeded by the caller. Pixels, grey levels.
//! Points under it are marked hidden. Limitation: flat, without parallax or shadow, as all that is worn.

use fastrand::Rng;

use super::grey_picture::{Picture, Points, inside, middle};
use super::random::either;

/// Axes of a face in the picture: origin between the brows, `right` towards point 16, `down` towards the chin; `size` is
/// the height from there to the chin, which yaw leaves alone.
struct Frame {
    origin: [f32; 2],
    right: [f32; 2],
    down: [f32; 2],
    size: f32,
}

impl Frame {
    fn of(points: &Points) -> Self {
        let origin = middle(&points[17..27]);
        let [x, y] = [points[8][0] - origin[0], points[8][1] - origin[1]];
        let size = x.hypot(y).max(8.0);
        let down = [x / size, y / size];
        Self {
            origin,
            right: [down[1], -down[0]],
            down,
            size,
        }
    }

    /// A picture's place in sizes of the face.
    fn local(&self, x: f32, y: f32) -> [f32; 2] {
        let (x, y) = (x - self.origin[0], y - self.origin[1]);
        [
            (x * self.right[0] + y * self.right[1]) / self.size,
            (x * self.down[0] + y * self.down[1]) / self.size,
        ]
    }

    /// The points in sizes of the face.
    fn locals(&self, points: &Points) -> Points {
        points.map(|[x, y]| self.local(x, y))
    }
}

/// Height of a head's outline above a place, `half` sizes wide on either side, `top` at the crown.
fn crown(u: f32, middle: f32, half: f32, top: f32) -> f32 {
    let t = ((u - middle) / half).clamp(-1.0, 1.0);
    top * (1.0 - t * t).sqrt()
}

/// Strands of hair: light and dark stripes along a slightly waving direction.
struct Strands {
    base: f32,
    contrast: f32,
    lean: f32,
    wave: [f32; 3],
    per_size: f32,
    stripes: [f32; 61],
}

impl Strands {
    fn new(rng: &mut Rng) -> Self {
        Self {
            base: 8.0 + 190.0 * rng.f32() * rng.f32(),
            contrast: 0.1 + 0.6 * rng.f32(),
            lean: 0.3 * either(rng),
            wave: [0.05 * rng.f32(), 4.0 + 10.0 * rng.f32(), 6.3 * rng.f32()],
            per_size: 15.0 + 60.0 * rng.f32(),
            stripes: std::array::from_fn(|_| either(rng)),
        }
    }

    /// Grey of a local place; `across` shifts the strands.
    fn grey(&self, [u, v]: [f32; 2]) -> f32 {
        let at = (u + self.lean * v + self.wave[0] * (self.wave[1] * v + self.wave[2]).sin())
            * self.per_size
            + 300.0;
        (self.base * (1.0 + self.contrast * self.stripe(at, 1))).clamp(0.0, 255.0)
    }

    /// −1…1 that changes from strand to strand.
    fn ragged(&self, u: f32) -> f32 {
        self.stripe(u * self.per_size * 0.5 + 100.0, 7)
    }

    /// Between the stripes on either side of a place; of so many only one is taken.
    fn stripe(&self, at: f32, one_of: usize) -> f32 {
        let (k, part) = (at.max(0.0) as usize, at.max(0.0).fract());
        let [a, b] = [k, k + 1].map(|k| self.stripes[(one_of * k) % self.stripes.len()]);
        a + part * (b - a)
    }
}

/// Hair on the head and beside the face, over the ears and some of the cheeks; mostly with a fringe too.
pub(super) fn mane(rng: &mut Rng, points: &Points, picture: &mut Picture) {
    let strands = Strands::new(rng);
    if rng.f32() < 0.85 {
        curtain(rng, &strands, points, picture);
    }
    if rng.f32() < 0.5 {
        fringe(rng, &strands, points, picture);
    }
}

/// Hair above the hairline and down one side or both.
fn curtain(rng: &mut Rng, strands: &Strands, points: &Points, picture: &mut Picture) {
    let frame = Frame::of(points);
    let local = frame.locals(points);
    let hairline = -(0.12 + 0.4 * rng.f32());
    let top = hairline - 0.2 - 0.4 * rng.f32();
    // Down to the ears, the chin, or the chest.
    let length = [0.45, 0.9, 1.9][rng.usize(..3)] + 0.2 * either(rng);
    let mut outline = Vec::new();
    let side = |jaw: [usize; 6], sign: f32, rng: &mut Rng| {
        if rng.f32() < 0.12 {
            // Behind the ear.
            return Vec::new();
        }
        let into = -0.04 + 0.16 * rng.f32() * rng.f32();
        let opens = 0.1 * either(rng);
        let wide = 0.06 + 0.4 * rng.f32() * rng.f32();
        let place = |(k, &p): (usize, &usize)| {
            let t = k as f32 / 5.0;
            [local[p][0] - sign * (into + opens * t), local[p][1]]
        };
        let mut inner: Vec<[f32; 2]> = jaw.iter().enumerate().map(place).collect();
        inner.retain(|p| p[1] < length);
        let Some((&first, &last)) = inner.first().zip(inner.last()) else {
            return Vec::new();
        };
        let mut edge = vec![[first[0] - sign * 0.02, hairline]];
        edge.extend(&inner);
        edge.push([last[0] + sign * 0.02, last[1].max(length)]);
        edge.push([local[jaw[0]][0] + sign * wide, last[1].max(length)]);
        edge.push([local[jaw[0]][0] + sign * wide, top]);
        edge.push([local[jaw[0]][0], top]);
        edge
    };
    for (jaw, sign) in [([0, 1, 2, 3, 4, 5], -1.0), ([16, 15, 14, 13, 12, 11], 1.0)] {
        outline.push(side(jaw, sign, rng));
    }
    let (left, right) = (local[0][0] - 0.08, local[16][0] + 0.08);
    let peak = 0.08 * either(rng);
    picture.paint(points, |x, y| {
        let [u, v] = frame.local(x, y);
        let edge = hairline + 0.012 * strands.ragged(u) + peak * (u - left) / (right - left);
        let above = u > left && u < right && v < edge && v > top;
        let beside = outline
            .iter()
            .any(|outline| inside(outline, u + 0.01 * strands.ragged(v), v));
        (above || beside).then(|| strands.grey([u, v]))
    });
}

/// Hair over the forehead down to the brows, sometimes over them and the lids.
fn fringe(rng: &mut Rng, strands: &Strands, points: &Points, picture: &mut Picture) {
    let frame = Frame::of(points);
    let local = frame.locals(points);
    let (left, right) = (local[0][0] - 0.05, local[16][0] + 0.05);
    let end = -0.1 + 0.22 * rng.f32() * rng.f32().sqrt();
    let (slope, bend) = (0.18 * either(rng), 0.3 * either(rng));
    let ragged = 0.01 + 0.05 * rng.f32();
    // Parted: nothing about the parting.
    let parting = (rng.f32() < 0.3).then(|| (0.25 * either(rng), 0.3 + 0.6 * rng.f32()));
    let (from, to) = if rng.f32() < 0.25 {
        // Over one side only.
        if rng.bool() {
            (left, 0.05)
        } else {
            (-0.05, right)
        }
    } else {
        (left, right)
    };
    let thin = 0.35 * rng.f32();
    picture.paint(points, |x, y| {
        let [u, v] = frame.local(x, y);
        let outside = v < crown(u, 0.5 * (left + right), 0.5 * (right - left) + 0.1, -0.75);
        if u < from || u > to || outside {
            return None;
        }
        let mut low = end + slope * u + bend * u * u + ragged * strands.ragged(u);
        if let Some((at, steep)) = parting {
            low = low.min(end - 0.25 + steep * (u - at).abs());
        }
        // Skin shows between strands, more towards their ends.
        let gap = strands.ragged(1.7 * u + 0.2 * v) > 1.0 - thin * (1.0 + (v - low) / 0.2).max(0.0);
        (v < low && !gap).then(|| strands.grey([u, v]))
    });
}

/// Cloth of one grey with a weave.
struct Cloth {
    base: f32,
    /// Depth, and how often it repeats across and down.
    knit: [f32; 3],
}

impl Cloth {
    fn new(rng: &mut Rng) -> Self {
        Self {
            base: 8.0 + 230.0 * rng.f32() * rng.f32().sqrt(),
            knit: [
                0.25 * rng.f32(),
                20.0 + 60.0 * rng.f32(),
                20.0 + 60.0 * rng.f32(),
            ],
        }
    }

    fn grey(&self, [u, v]: [f32; 2]) -> f32 {
        let weave = (u * self.knit[1]).sin() * (v * self.knit[2]).sin();
        (self.base * (1.0 + self.knit[0] * weave)).clamp(0.0, 255.0)
    }
}

/// Whose head something is put on, and what it is made of.
struct Worn {
    frame: Frame,
    /// The landmarks in the frame.
    local: Points,
    cloth: Cloth,
}

impl Worn {
    /// Across of the jaw's two ends.
    fn sides(&self) -> [f32; 2] {
        [self.local[0][0], self.local[16][0]]
    }
}

/// A cap, a hood, headphones, a scarf or a mask.
pub(super) fn headwear(rng: &mut Rng, points: &Points, picture: &mut Picture) {
    let frame = Frame::of(points);
    let worn = Worn {
        local: frame.locals(points),
        frame,
        cloth: Cloth::new(rng),
    };
    let put_on = match rng.u8(..8) {
        0 | 1 => cap,
        2 => hood,
        3 | 4 => headphones,
        _ => scarf,
    };
    put_on(rng, &worn, points, picture);
}

/// A cap or a band; its brim shades the eyes.
fn cap(rng: &mut Rng, worn: &Worn, points: &Points, picture: &mut Picture) {
    let [left, right] = worn.sides();
    let edge = -0.25 + 0.27 * rng.f32();
    let (arch, dark) = (0.5 * rng.f32(), 0.9 * rng.f32());
    let low = |u: f32| edge + arch * u * u;
    for row in 0..picture.height {
        for column in 0..picture.width {
            let [u, v] = worn.frame.local(column as f32, row as f32);
            let below = v - low(u);
            if (0.0..0.3).contains(&below) {
                picture.grey[row * picture.width + column] *= 1.0 - dark * (1.0 - below / 0.3);
            }
        }
    }
    picture.paint(points, |x, y| {
        let [u, v] = worn.frame.local(x, y);
        let top = crown(u, 0.5 * (left + right), 0.5 * (right - left) + 0.1, -0.8);
        let on = u > left - 0.08 && u < right + 0.08 && v < low(u) && v > top;
        on.then(|| worn.cloth.grey([u, v]))
    });
}

/// A hood: all that is outside an oval.
fn hood(rng: &mut Rng, worn: &Worn, points: &Points, picture: &mut Picture) {
    let [left, right] = worn.sides();
    let middle = 0.5 * (left + right);
    let half = [
        0.5 * (right - left) + 0.12 * rng.f32() - 0.04,
        0.75 + 0.3 * rng.f32(),
    ];
    picture.paint(points, |x, y| {
        let [u, v] = worn.frame.local(x, y);
        let [a, b] = [(u - middle) / half[0], (v - 0.35) / half[1]];
        let within = a.abs().powf(2.5) + b.abs().powf(2.5) < 1.0;
        let cloth =
            (u - middle).abs() < half[0] + 0.35 && v > crown(u, middle, half[0] + 0.35, -0.9);
        (!within && cloth).then(|| worn.cloth.grey([u, v]))
    });
}

/// Headphones: cups over the ears, a band over the head.
fn headphones(rng: &mut Rng, worn: &Worn, points: &Points, picture: &mut Picture) {
    let [left, right] = worn.sides();
    let cup = [0.08 + 0.1 * rng.f32(), 0.16 + 0.14 * rng.f32()];
    let at = [worn.local[0][1] - 0.05, worn.local[16][1] - 0.05];
    let out = 0.1 * rng.f32() - 0.03;
    let band = 0.03 + 0.05 * rng.f32();
    let high = -(0.5 + 0.25 * rng.f32());
    picture.paint(points, |x, y| {
        let [u, v] = worn.frame.local(x, y);
        let over = |centre: f32, y: f32| {
            ((u - centre) / cup[0]).powi(2) + ((v - y) / cup[1]).powi(2) < 1.0
        };
        let t = 2.0 * (u - left) / (right - left) - 1.0;
        let arc = high + (at[0].min(at[1]) - high) * t.powi(4);
        let on = over(left - out, at[0])
            || over(right + out, at[1])
            || (t.abs() < 1.1 && (v - arc).abs() < band);
        on.then(|| worn.cloth.grey([u, v]))
    });
}

/// A scarf or collar up to the chin, or a mask up to the nose.
fn scarf(rng: &mut Rng, worn: &Worn, points: &Points, picture: &mut Picture) {
    let [left, right] = worn.sides();
    let mask = rng.f32() < 0.35;
    let high = if mask {
        worn.local[29][1] + 0.1 * either(rng)
    } else {
        worn.local[8][1] - 0.18 * rng.f32()
    };
    let (tilt, wide) = (0.1 * either(rng), if mask { 0.02 } else { 0.2 * rng.f32() });
    picture.paint(points, |x, y| {
        let [u, v] = worn.frame.local(x, y);
        let end = if mask { worn.local[8][1] + 0.06 } else { 9.0 };
        let on = u > left - wide && u < right + wide && v > high + tilt * u && v < end;
        on.then(|| worn.cloth.grey([u, v]))
    });
}
