//! From rendered colours to a camera's grey image: mixed skins, backdrop, blur, exposure, gamma and noise.

use fastrand::Rng;

use super::random::either;
use mien_sensors::kinect::colour::pixel_luma;
use mien_simulator::virtual_head::Points;
use mien_simulator::virtual_head::draw::Canvas;
use mien_stages::face_model::scheme;

/// Mixes a face's skin with that of another photograph: by a constant share, possibly extrapolated, or from one to
/// the other across the face.
pub(super) fn mix_skins(rng: &mut Rng, points: &Points, canvas: &mut Canvas, other: &Canvas) {
    let width = canvas.depth.width;
    let [x0, y0] = points[30];
    let size = scheme::outer_eye_distance(points).max(4.0);
    let even = rng.f32() < 0.5;
    let level = 1.6 * rng.f32() - 0.3;
    let (sin, cos) = (std::f32::consts::TAU * rng.f32()).sin_cos();
    let steep = (0.8 + 2.0 * rng.f32()) / size;
    let middle = 0.5 + 0.4 * either(rng);
    for (k, (own, other)) in canvas.rgb.iter_mut().zip(&other.rgb).enumerate() {
        let share = if even {
            level
        } else {
            let (x, y) = ((k % width) as f32 - x0, (k / width) as f32 - y0);
            (middle + steep * (x * cos + y * sin)).clamp(0.0, 1.0)
        };
        for (a, b) in own.iter_mut().zip(other) {
            let (from, to) = (f32::from(*a), f32::from(*b));
            *a = (from + share * (to - from) + 0.5).clamp(0.0, 255.0) as u8;
        }
    }
}

/// Converts the colours to grey over the backdrop; sometimes as in the near infrared.
pub(super) fn to_grey(rng: &mut Rng, canvas: &Canvas, out: &mut [f32]) {
    let infrared = (rng.f32() < 0.15).then(|| 0.6 + 0.6 * rng.f32());
    let drawn = canvas.rgb.iter().zip(&canvas.depth.inverse);
    for (grey, (rgb, &inverse)) in out.iter_mut().zip(drawn) {
        if inverse > 0.0 {
            *grey = f32::from(pixel_luma(*rgb));
            if let Some(red) = infrared {
                // In the near infrared skin is light and even, and lips hardly differ from it, as in the red channel.
                *grey += red * (f32::from(rgb[0]) - *grey);
            }
        }
    }
}

/// Random noise at several scales, so that backdrops cannot be learned.
pub(super) fn backdrop(rng: &mut Rng, width: usize, height: usize, grey: &mut Vec<f32>) {
    let base = 20.0 + 215.0 * rng.f32();
    let slope = [either(rng), either(rng)].map(|s| 60.0 * s / width.max(height) as f32);
    grey.clear();
    for row in 0..height {
        for col in 0..width {
            let x = col as f32 - width as f32 * 0.5;
            let y = row as f32 - height as f32 * 0.5;
            grey.push(base + slope[0] * x + slope[1] * y);
        }
    }
    let loud = rng.f32() * 60.0;
    for cell in [61.0f32, 23.0, 8.0] {
        let amplitude = loud * rng.f32();
        let [columns, rows] = [width, height].map(|side| (side as f32 / cell) as usize + 2);
        let knots = (0..columns * rows).map(|_| amplitude * either(rng));
        let lattice: Vec<f32> = knots.collect();
        // Occasional hard-edged cells: shelves, windows, door frames.
        let hard = rng.f32() < 0.3;
        for row in 0..height {
            let y = row as f32 / cell;
            let fy = if hard { 0.0 } else { y.fract() };
            let at = (y as usize) * columns;
            for col in 0..width {
                let x = col as f32 / cell;
                let fx = if hard { 0.0 } else { x.fract() };
                let k = at + x as usize;
                let upper = lattice[k] + fx * (lattice[k + 1] - lattice[k]);
                let lower =
                    lattice[k + columns] + fx * (lattice[k + columns + 1] - lattice[k + columns]);
                grey[row * width + col] += upper + fy * (lower - upper);
            }
        }
    }
}

/// Blur, exposure, gamma, noise.
pub(super) fn photographed(
    rng: &mut Rng,
    width: usize,
    height: usize,
    grey: &mut [f32],
    spare: &mut Vec<f32>,
) -> Vec<u8> {
    let sigma = 0.25 + 1.0 * rng.f32() * rng.f32();
    spare.clear();
    spare.resize(grey.len(), 0.0);
    let side = (-0.5 / (sigma * sigma)).exp();
    let far = (-2.0 / (sigma * sigma)).exp();
    let total = 1.0 + 2.0 * (side + far);
    let (middle, side, far) = (1.0 / total, side / total, far / total);
    for row in 0..height {
        let line = &grey[row * width..(row + 1) * width];
        let at = |k: usize| line[k.min(width - 1)];
        for col in 0..width {
            spare[row * width + col] = middle * line[col]
                + side * (at(col.saturating_sub(1)) + at(col + 1))
                + far * (at(col.saturating_sub(2)) + at(col + 2));
        }
    }
    let mut gain = (0.4f32.ln() + (1.35f32 / 0.4).ln() * rng.f32().sqrt()).exp();
    // An occasional dim room.
    if rng.f32() < 0.12 {
        gain *= 0.2 + 0.4 * rng.f32();
    }
    let gamma = 0.75 + 0.55 * rng.f32();
    let curve = (0..=1023).map(|v| 255.0 * (v as f32 / 1023.0 * 1.6).powf(gamma) * gain);
    let curve: Vec<f32> = curve.collect();
    let noise = 0.5 + 5.5 * rng.f32() * rng.f32();
    let mut luma = Vec::with_capacity(width * height);
    for row in 0..height {
        let line = |k: usize| k.min(height - 1) * width;
        let [a, b] = [2, 1].map(|up| line(row.saturating_sub(up)));
        let [c, d, e] = [0, 1, 2].map(|down| line(row + down));
        for col in 0..width {
            let value = middle * spare[c + col]
                + side * (spare[b + col] + spare[d + col])
                + far * (spare[a + col] + spare[e + col]);
            let level = (value.max(0.0) * (1023.0 / 255.0 / 1.6)) as usize;
            // The sum of two uniforms approximates a normal distribution cheaply.
            let bits = rng.u32(..);
            let n = ((bits & 0xffff) as f32 + (bits >> 16) as f32) / 65536.0 - 1.0;
            luma.push((curve[level.min(1023)] + noise * 2.45 * n + 0.5).clamp(0.0, 255.0) as u8);
        }
    }
    luma
}
