//! Pictures with a part of the face, or all of it, under a disc of the skin's grey.

use crate::base::capacity::{LANDMARKS, PIXELS, WIDTH};
use crate::simulator::virtual_head::Truth;

/// Covered points: a fifth.
pub(super) const COVERED: usize = 14;

/// Copies a picture and lays a rough disc of the skin's grey on so many points, those nearest to one of them, or on more than
/// all; tells which.
pub(super) fn cover(
    out: &mut [u8; PIXELS],
    luma: &[u8; PIXELS],
    truth: &Truth,
    (centre, count): (usize, usize),
    random: &mut fastrand::Rng,
) -> [bool; LANDMARKS] {
    let points = &truth.landmarks_px;
    let [x, y] = points[centre];
    let far = points.map(|p| (p[0] - x).hypot(p[1] - y));
    let mut order: [usize; LANDMARKS] = std::array::from_fn(|i| i);
    order.sort_by(|&a, &b| far[a].total_cmp(&far[b]));
    let last = far[order[count - 1]];
    let radius = order
        .get(count)
        .map_or(1.1 * last, |&next| 0.5 * (last + far[next]));
    out.copy_from_slice(luma);
    let nose = points[30];
    let skin = f32::from(luma[(nose[1] as usize * WIDTH + nose[0] as usize).min(PIXELS - 1)]);
    let reach = radius.ceil() as i64;
    for row in -reach..=reach {
        for column in -reach..=reach {
            let (px, py) = (x as i64 + column, y as i64 + row);
            let off = (px as f32 - x).hypot(py as f32 - y) / radius;
            if off < 1.0 && (0..WIDTH as i64).contains(&px) && py >= 0 {
                let at = py as usize * WIDTH + px as usize;
                if at < PIXELS {
                    let grey = skin * (1.0 - 0.4 * off * off) + 6.0 * random.f32();
                    out[at] = grey.clamp(0.0, 255.0) as u8;
                }
            }
        }
    }
    std::array::from_fn(|i| order[..count].contains(&i))
}
