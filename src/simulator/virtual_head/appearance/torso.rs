//! Shoulders, chest and arms in clothes.

use super::material::{grain, part_seed, share, slope};
use super::options::Appearance;
use super::outfit::{Outfit, Surface, path};
use mien_stages::base::geometry::{Point, Vector};

/// Half width, half depth and height (y) of the trunk from the neck down, head frame, metres.
const TRUNK: [[f32; 3]; 10] = [
    [0.062, 0.058, 0.136],
    [0.094, 0.070, 0.150],
    [0.132, 0.082, 0.166],
    [0.162, 0.090, 0.190],
    [0.186, 0.096, 0.222],
    [0.200, 0.102, 0.262],
    [0.198, 0.112, 0.320],
    [0.186, 0.122, 0.420],
    [0.178, 0.124, 0.540],
    [0.180, 0.124, 1.250],
];
/// Half width of an arm, from the shoulder down, metres.
const ARM: [f32; 10] = [
    0.012, 0.045, 0.056, 0.06, 0.06, 0.058, 0.056, 0.054, 0.052, 0.05,
];
/// z of the trunk's middle, head frame, metres.
const BACK_M: f32 = 0.105;

impl Outfit {
    pub(super) fn torso(&mut self, appearance: &Appearance) {
        let material = appearance.clothes_material();
        let mut surface = Surface::new(material, appearance.clothes, 1.0);
        surface.cells = [2400.0, 420.0];
        let seed = part_seed(appearance.seed, 2);
        // 0 plain, 1 striped, 2 checked.
        let pattern = (share(seed, 0) * 3.0) as usize;
        let step = 0.02 + 0.03 * share(seed, 1);
        let other = 0.6 + 0.7 * share(seed, 2);
        const COLUMNS: usize = 40;
        const ROWS: usize = 37;
        self.grid([ROWS, COLUMNS], true, material, |row, column| {
            let t = row as f32 / (ROWS - 1) as f32 * (TRUNK.len() - 1) as f32;
            let k = (t as usize).min(TRUNK.len() - 2);
            let f = t - k as f32;
            let [wide, deep, y] =
                [0, 1, 2].map(|n| TRUNK[k][n] + f * (TRUNK[k + 1][n] - TRUNK[k][n]));
            let phi = std::f32::consts::TAU * column as f32 / COLUMNS as f32;
            // Folds.
            let fold = 0.005 * grain(phi * 3.0 + 40.0, y * 14.0) * slope(y, 0.2, 0.3);
            let (across, ahead) = ((wide + fold) * phi.sin(), (deep + fold) * phi.cos());
            let p = Point::new(across, y, BACK_M - ahead);
            let mut vertex = surface.vertex(p, [phi * 0.16, y], 1.0);
            let on = |x: f32| (x / step).rem_euclid(2.0) < 1.0;
            let marked = match pattern {
                1 => on(y),
                2 => on(y) != on(p.x),
                _ => false,
            };
            if marked {
                vertex.colour = vertex.colour.map(|c| (c * other).min(235.0));
            }
            vertex
        });
        for side in [-1.0, 1.0f32] {
            let path = path(10, |t| {
                let out = side * (0.165 + 0.07 * t.sqrt());
                Point::new(out, 0.235 + 0.55 * t, BACK_M + 0.01 - 0.05 * t * t)
            });
            let section = |i: usize| (Vector::new(0.0, 0.0, -1.0), [ARM[i]; 2]);
            self.tube(&path, 16, material, section, |i, p, turn| {
                surface.vertex(p, [turn * 0.4, 0.04 * i as f32], 1.0)
            });
        }
    }
}
