//! Hair and headwear painted over the grey training picture: hair beside the face and over the brow, caps, hoods,
//! headphones, scarves, masks.
//!
//! Positioned by the projected landmarks, so that all of it rotates and scales with the face; seeded by the caller.
//! Pixels, grey levels. Covered points are marked hidden. Limitation: flat, without parallax or shadow.

use fastrand::Rng;

use super::grey_picture::{Picture, inside, middle};
use super::random::either;
use mien_simulator::virtual_head::Points;

/// Axes of a face in the image: origin between the brows, `down` towards the chin; `size` is the height from there to
/// the chin, which yaw does not change.
struct Frame {
    origin: [f32; 2],
    down: [f32; 2],
    size: f32,
    /// The landmarks in units of the face's size.
    local: Points,
    /// Middle of the jaw's two ends, and half their distance.
    middle: f32,
    half: f32,
}

impl Frame {
    fn from_points(points: &Points) -> Self {
        let origin = middle(&points[17..27]);
        let [x, y] = [points[8][0] - origin[0], points[8][1] - origin[1]];
        let size = x.hypot(y).max(8.0);
        let mut frame = Self {
            origin,
            down: [x / size, y / size],
            size,
            local: *points,
            middle: 0.0,
            half: 0.0,
        };
        frame.local = points.map(|[x, y]| frame.in_sizes(x, y));
        let [right, left] = [frame.local[0][0], frame.local[16][0]];
        frame.middle = 0.5 * (right + left);
        frame.half = 0.5 * (left - right);
        frame
    }

    /// Local coordinates of a pixel in units of the face's size, across towards point 16 and down.
    fn in_sizes(&self, x: f32, y: f32) -> [f32; 2] {
        let (x, y) = (x - self.origin[0], y - self.origin[1]);
        let [down_x, down_y] = self.down.map(|d| d / self.size);
        [x * down_y - y * down_x, x * down_x + y * down_y]
    }

    /// Paints where `shade` gives a grey for local coordinates.
    fn paint(&self, picture: &mut Picture, shade: impl Fn(f32, f32) -> Option<f32>) {
        picture.paint(|x, y| {
            let [u, v] = self.in_sizes(x, y);
            shade(u, v)
        });
    }

    /// Whether a local x lies across the face, or up to `aside` beside it.
    fn spans(&self, u: f32, aside: f32) -> bool {
        (u - self.middle).abs() < self.half + aside
    }

    /// Height of a head's outline above a local x: the outline ends `aside` of the face, and is `top` at the crown.
    fn crown(&self, u: f32, aside: f32, top: f32) -> f32 {
        let t = ((u - self.middle) / (self.half + aside)).clamp(-1.0, 1.0);
        top * (1.0 - t * t).sqrt()
    }
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

    /// Grey at local coordinates; `across` shifts the strands.
    fn grey(&self, [u, v]: [f32; 2]) -> f32 {
        let at = (u + self.lean * v + self.wave[0] * (self.wave[1] * v + self.wave[2]).sin())
            * self.per_size
            + 300.0;
        (self.base * (1.0 + self.contrast * self.stripe(at, 1))).clamp(0.0, 255.0)
    }

    /// A number −1…1 that changes from strand to strand.
    fn ragged(&self, u: f32) -> f32 {
        self.stripe(u * self.per_size * 0.5 + 100.0, 7)
    }

    /// Interpolates between neighbouring stripes; only one in `one_of` is used.
    fn stripe(&self, at: f32, one_of: usize) -> f32 {
        let (k, part) = (at.max(0.0) as usize, at.max(0.0).fract());
        let [a, b] = [k, k + 1].map(|k| self.stripes[(one_of * k) % self.stripes.len()]);
        a + part * (b - a)
    }
}

/// Hair on the head and beside the face, over the ears and some of the cheeks; mostly with a fringe too.
pub(super) fn mane(rng: &mut Rng, picture: &mut Picture) {
    let (strands, frame) = (Strands::new(rng), Frame::from_points(picture.points));
    if rng.f32() < 0.85 {
        curtain(rng, &strands, &frame, picture);
    }
    if rng.f32() < 0.5 {
        fringe(rng, &strands, &frame, picture);
    }
}

/// Hair above the hairline and down one side or both.
fn curtain(rng: &mut Rng, strands: &Strands, frame: &Frame, picture: &mut Picture) {
    let hairline = -(0.12 + 0.4 * rng.f32());
    let top = hairline - 0.2 - 0.4 * rng.f32();
    // To the ears, the chin, or the chest.
    let length = [0.45, 0.9, 1.9][rng.usize(..3)] + 0.2 * either(rng);
    let outlines = [-1.0f32, 1.0].map(|sign| {
        if rng.f32() < 0.12 {
            // Behind the ear.
            return Vec::new();
        }
        let into = -0.04 + 0.16 * rng.f32() * rng.f32();
        let opens = 0.1 * either(rng);
        let wide = 0.06 + 0.4 * rng.f32() * rng.f32();
        let jaw = |k: usize| frame.local[if sign < 0.0 { k } else { 16 - k }];
        let place = |k: usize| {
            let [u, v] = jaw(k);
            [u - sign * (into + opens * k as f32 / 5.0), v]
        };
        let mut inner: Vec<[f32; 2]> = (0..6).map(place).collect();
        inner.retain(|p| p[1] < length);
        let Some((&first, &last)) = inner.first().zip(inner.last()) else {
            return Vec::new();
        };
        let (ear, end) = (jaw(0)[0], last[1].max(length));
        let mut edge = vec![[first[0] - sign * 0.02, hairline]];
        edge.extend(&inner);
        edge.push([last[0] + sign * 0.02, end]);
        edge.extend([[ear + sign * wide, end], [ear + sign * wide, top]]);
        edge.push([ear, top]);
        edge
    });
    let peak = 0.08 * either(rng);
    frame.paint(picture, |u, v| {
        let tilt = 0.5 + 0.5 * (u - frame.middle) / (frame.half + 0.08);
        let edge = hairline + 0.012 * strands.ragged(u) + peak * tilt;
        let above = frame.spans(u, 0.08) && v < edge && v > top;
        let ragged = u + 0.01 * strands.ragged(v);
        let beside = outlines.iter().any(|outline| inside(outline, ragged, v));
        (above || beside).then(|| strands.grey([u, v]))
    });
}

/// Hair over the forehead down to the brows, sometimes over them and the lids.
fn fringe(rng: &mut Rng, strands: &Strands, frame: &Frame, picture: &mut Picture) {
    let end = -0.1 + 0.22 * rng.f32() * rng.f32().sqrt();
    let (slope, bend) = (0.18 * either(rng), 0.3 * either(rng));
    let ragged = 0.01 + 0.05 * rng.f32();
    // Parted: a gap around the parting.
    let parting = (rng.f32() < 0.3).then(|| (0.25 * either(rng), 0.3 + 0.6 * rng.f32()));
    // Occasionally over one side only.
    let side = (rng.f32() < 0.25).then(|| if rng.bool() { -1.0 } else { 1.0 });
    let thin = 0.35 * rng.f32();
    frame.paint(picture, |u, v| {
        let aside = side.is_some_and(|side: f32| u * side < -0.05);
        if aside || !frame.spans(u, 0.05) || v < frame.crown(u, 0.15, -0.75) {
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
    /// Depth of the knit, and its repetitions across and down.
    knit: [f32; 3],
}

impl Cloth {
    fn new(rng: &mut Rng) -> Self {
        let base = 8.0 + 230.0 * rng.f32() * rng.f32().sqrt();
        let [depth, across, down] = [0.25, 60.0, 60.0].map(|range| range * rng.f32());
        let knit = [depth, 20.0 + across, 20.0 + down];
        Self { base, knit }
    }

    fn grey(&self, [u, v]: [f32; 2]) -> f32 {
        let weave = (u * self.knit[1]).sin() * (v * self.knit[2]).sin();
        (self.base * (1.0 + self.knit[0] * weave)).clamp(0.0, 255.0)
    }
}

/// A cap, a hood, headphones, a scarf or a mask.
pub(super) fn headwear(rng: &mut Rng, picture: &mut Picture) {
    let (frame, cloth) = (Frame::from_points(picture.points), Cloth::new(rng));
    let put_on = match rng.u8(..8) {
        0 | 1 => cap,
        2 => hood,
        3 | 4 => headphones,
        _ => scarf,
    };
    put_on(rng, &frame, &cloth, picture);
}

/// A cap or a band; its brim shades the eyes.
fn cap(rng: &mut Rng, frame: &Frame, cloth: &Cloth, picture: &mut Picture) {
    let edge = -0.25 + 0.27 * rng.f32();
    let (arch, dark) = (0.5 * rng.f32(), 0.9 * rng.f32());
    let low = |u: f32| edge + arch * u * u;
    picture.each(|x, y, grey| {
        let [u, v] = frame.in_sizes(x, y);
        let below = v - low(u);
        if (0.0..0.3).contains(&below) {
            *grey *= 1.0 - dark * (1.0 - below / 0.3);
        }
    });
    frame.paint(picture, |u, v| {
        let on = frame.spans(u, 0.08) && v < low(u) && v > frame.crown(u, 0.1, -0.8);
        on.then(|| cloth.grey([u, v]))
    });
}

/// A hood: everything outside an oval.
fn hood(rng: &mut Rng, frame: &Frame, cloth: &Cloth, picture: &mut Picture) {
    let (aside, tall) = (0.12 * rng.f32() - 0.04, 0.75 + 0.3 * rng.f32());
    frame.paint(picture, |u, v| {
        let across = (u - frame.middle).abs() / (frame.half + aside);
        let within = across.powf(2.5) + ((v - 0.35).abs() / tall).powf(2.5) < 1.0;
        let aside = aside + 0.35;
        let on = !within && frame.spans(u, aside) && v > frame.crown(u, aside, -0.9);
        on.then(|| cloth.grey([u, v]))
    });
}

/// Headphones: cups over the ears, a band over the head.
fn headphones(rng: &mut Rng, frame: &Frame, cloth: &Cloth, picture: &mut Picture) {
    let cup = [0.08 + 0.1 * rng.f32(), 0.16 + 0.14 * rng.f32()];
    let ears = [(0, -1.0), (16, 1.0)].map(|(k, side)| (side, frame.local[k][1] - 0.05));
    let out = 0.1 * rng.f32() - 0.03;
    let band = 0.03 + 0.05 * rng.f32();
    let high = -(0.5 + 0.25 * rng.f32());
    frame.paint(picture, |u, v| {
        let aside = u - frame.middle;
        let over = |(side, y): (f32, f32)| {
            let across = aside - side * (frame.half + out);
            (across / cup[0]).powi(2) + ((v - y) / cup[1]).powi(2) < 1.0
        };
        let t = aside / frame.half;
        let arc = high + (ears[0].1.min(ears[1].1) - high) * t.powi(4);
        let on = ears.into_iter().any(over) || (t.abs() < 1.1 && (v - arc).abs() < band);
        on.then(|| cloth.grey([u, v]))
    });
}

/// A scarf or collar up to the chin, or a mask up to the nose.
fn scarf(rng: &mut Rng, frame: &Frame, cloth: &Cloth, picture: &mut Picture) {
    let (nose, chin) = (frame.local[29][1], frame.local[8][1]);
    let mask = rng.f32() < 0.35;
    let (high, end) = match mask {
        true => (nose + 0.1 * either(rng), chin + 0.06),
        false => (chin - 0.18 * rng.f32(), 9.0),
    };
    let (tilt, wide) = (0.1 * either(rng), if mask { 0.02 } else { 0.2 * rng.f32() });
    frame.paint(picture, |u, v| {
        let on = frame.spans(u, wide) && v > high + tilt * u && v < end;
        on.then(|| cloth.grey([u, v]))
    });
}
