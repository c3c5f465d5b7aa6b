//! Hair: a shell around the skull within the hairline, and locks that hang from it.

use super::material::{along, grain, part_seed, share, slope};
use super::options::{Appearance, HairStyle, Headgear};
use super::outfit::{FREE, Outfit, Surface, Vertex, path};
use super::skull::{HANGS, Skull};
use mien_stages::base::geometry::{Point, Vector};

/// Hairline: angle from the face (degrees), height (y, metres); forehead, temples, before, above and behind the ear, nape.
const LINE: [[f32; 2]; 8] = [
    [0.0, -0.066],
    [30.0, -0.066],
    [48.0, -0.052],
    [62.0, -0.012],
    [76.0, 0.006],
    [90.0, -0.018],
    [115.0, -0.012],
    [140.0, 0.055],
];
/// Hairline of styles that cover the ears, as [`LINE`].
const LINE_OVER_EARS: [[f32; 2]; 5] = [
    [0.0, -0.066],
    [30.0, -0.066],
    [46.0, -0.048],
    [62.0, 0.02],
    [90.0, 0.06],
];

/// Degrees from the face, 0…180.
fn degrees_from_face(phi: f32) -> f32 {
    phi.sin().atan2(phi.cos()).abs().to_degrees()
}

impl Outfit {
    pub(super) fn hair(&mut self, skull: &Skull, appearance: &Appearance) {
        let surface = Surface {
            material: appearance.hair_material(),
            colour: appearance.hair_colour,
            torso_share: 0.0,
            cells: [300.0, 9.0],
        };
        let seed = part_seed(appearance.seed, 1);
        let covered = matches!(appearance.headgear, Headgear::Cap | Headgear::Hood);
        // Hair under a cap or hood is flat.
        let flat = if covered { 0.35 } else { 1.0 };
        let mut shell = |lift, over_ears, frizz| {
            self.shell(skull, &surface, lift, over_ears, frizz, seed);
        };
        match appearance.hair {
            HairStyle::Bald => return,
            HairStyle::Cropped => shell(0.005 * flat, false, 0.0),
            HairStyle::Short | HairStyle::Fringe => shell(0.012 * flat, false, 0.0),
            HairStyle::Bushy => shell(0.042 * flat, true, 0.5),
            HairStyle::Long | HairStyle::LongFringe => shell(0.010 * flat, true, 0.0),
            HairStyle::Curly => shell(0.022 * flat, true, 0.35),
            HairStyle::Bun => shell(0.006, false, 0.0),
        }
        if matches!(appearance.hair, HairStyle::Short | HairStyle::Fringe) {
            self.tufts(skull, &surface, 0.014 * flat, seed);
        }
        let long = 0.10 + 0.16 * share(seed, 1);
        match appearance.hair {
            HairStyle::Long | HairStyle::LongFringe => {
                self.locks(skull, &surface, long, 0.0, seed);
            }
            HairStyle::Curly => self.locks(skull, &surface, 0.8 * long, 0.012, seed),
            HairStyle::Bun => {
                let up = skull.point(0.75, std::f32::consts::PI, 0.018);
                self.ball(up.into(), [0.038, 0.034, 0.034], &surface);
            }
            _ => {}
        }
        if matches!(appearance.hair, HairStyle::Fringe | HairStyle::LongFringe) && !covered {
            self.fringe(skull, &surface, seed);
        }
    }

    /// Adds the shell, at `lift` metres from the skull; `frizz`: share of loose hair outside of it, 0…1.
    fn shell(
        &mut self,
        skull: &Skull,
        surface: &Surface,
        lift: f32,
        over_ears: bool,
        frizz: f32,
        seed: u64,
    ) {
        const ROWS: usize = 44;
        const COLUMNS: usize = 88;
        let table: &[[f32; 2]] = if over_ears { &LINE_OVER_EARS } else { &LINE };
        let receding = 0.012 * (share(seed, 2) - 0.4);
        let shift = share(seed, 3) * 900.0;
        for loose in [false, true] {
            if loose && frizz == 0.0 {
                continue;
            }
            self.grid([ROWS, COLUMNS], true, surface.material, |row, column| {
                let theta = 2.35 * row as f32 / (ROWS - 1) as f32;
                let phi = std::f32::consts::TAU * column as f32 / COLUMNS as f32;
                let foot = skull.point(theta, phi, 0.0);
                // Noise over the sphere, so that there is no seam at phi = 0.
                let d = super::skull::direction(theta, phi) * 4.0;
                let clump = grain(d.x * 1.7 + d.z + shift, d.y * 1.7 + d.z * 0.6);
                let tuft = grain(d.x * 4.3 + d.z * 2.7 - shift, d.y * 4.1 - d.z * 1.9);
                let edge = along(table, degrees_from_face(phi)) - receding + 0.006 * tuft;
                let within = (edge - foot.y) / 0.006 + 0.5;
                // Thin at the edge, thickest on top.
                let body = slope(edge - foot.y, -0.004, 0.03).sqrt();
                let mut high = 0.0035 + lift * body * (1.0 + 0.28 * clump + 0.14 * tuft);
                let mut coverage = within.clamp(0.0, 1.0);
                if loose {
                    high += 0.004 + 0.35 * lift * (0.6 + 0.4 * tuft);
                    coverage = coverage.min(1.0) * frizz * (0.7 + 0.5 * clump);
                }
                let p = skull.point(theta, phi, high);
                let mut vertex = surface.vertex(p, [phi * 0.5, theta], coverage);
                let shade = 0.8 + 0.35 * slope(clump + tuft, -1.2, 1.2);
                vertex.colour = vertex.colour.map(|c| c * shade);
                vertex
            });
        }
    }

    /// Adds short locks all over the head, combed to one side.
    fn tufts(&mut self, skull: &Skull, surface: &Surface, lift: f32, seed: u64) {
        const TUFTS: u64 = 170;
        const STEPS: usize = 6;
        let comb = if share(seed, 6) < 0.5 { -0.5 } else { 0.5 };
        for k in 0..TUFTS {
            let chance = |channel| share(seed, 6000 + 8 * k + channel);
            let theta = 0.1 + 1.75 * chance(0).sqrt();
            let phi = std::f32::consts::TAU * chance(1);
            let long = 0.22 + 0.16 * chance(2);
            let path = path(STEPS, |t| {
                let rise = 0.55 + 0.6 * (t * 2.6).sin().max(0.0);
                let aside = comb * t * (1.0 - slope(theta, 0.3, 1.4)) + 0.2 * t * (chance(3) - 0.5);
                skull.point(theta + long * t, phi + aside, lift * rise + 0.003)
            });
            let end = path[STEPS - 1];
            if end.y < along(&LINE, degrees_from_face(phi)) + 0.004 {
                let wide = 0.005 + 0.004 * chance(4);
                self.lock(&path, wide, 0.78 + 0.4 * chance(5), surface, k as f32 * 3.0);
            }
        }
    }

    /// Adds locks that hang from a parting onto the shoulders. `below`: length below the ears, metres; `curl`: amplitude of curls,
    /// metres.
    fn locks(&mut self, skull: &Skull, surface: &Surface, below: f32, curl: f32, seed: u64) {
        const LOCKS: u64 = 96;
        const STEPS: usize = 16;
        let front = 44.0 + 22.0 * share(seed, 4);
        for k in 0..LOCKS {
            let chance = |channel| share(seed, 100 + 8 * k + channel);
            let side = if k % 2 == 0 { -1.0 } else { 1.0 };
            let spread = (k / 2) as f32 / (LOCKS / 2 - 1) as f32;
            let end = (front + (180.0 - front) * spread + 5.0 * (chance(0) - 0.5)).to_radians();
            // From a parting on top towards the side.
            let start = end * 0.85 + 0.2;
            let ends = below * (0.82 + 0.26 * chance(1)) * slope(spread, -0.5, 0.2);
            let lift = 0.011 + 0.007 * chance(2);
            let wave = std::f32::consts::TAU * chance(3);
            let path = path(STEPS, |t| {
                let on_head = slope(t, 0.0, 0.45);
                let hanging = slope(t, 0.45, 1.0);
                let phi = side * (start + (end - start) * on_head);
                let mut p = skull.drape(0.18 + (HANGS - 0.18) * on_head, 0.0, phi, lift);
                p.y += hanging * ends;
                let turn = wave + t * if curl > 0.0 { 17.0 } else { 5.0 };
                let swing = (curl + 0.002) * slope(t, 0.15, 0.5);
                p.x += side * swing * turn.sin();
                p.z += swing * turn.cos();
                // In front of the shoulder or behind it.
                let out = slope(p.y, 0.10, 0.26) * 0.06;
                p.z += if end < 1.75 { -out } else { out };
                p.x -= side * slope(p.y, 0.02, 0.14) * 0.008;
                p
            });
            let wide = 0.006 + 0.006 * chance(5);
            let shade = 0.75 + 0.45 * chance(6);
            self.lock(&path, wide, shade, surface, k as f32 * 7.0);
        }
    }

    /// Adds strands over the brow.
    fn fringe(&mut self, skull: &Skull, surface: &Surface, seed: u64) {
        const LOCKS: u64 = 34;
        let lowest = -0.034 + 0.022 * share(seed, 5);
        for k in 0..LOCKS {
            let chance = |channel| share(seed, 3000 + 8 * k + channel);
            let turn = (k as f32 + chance(0) - 0.5) / (LOCKS - 1) as f32 * 2.0 - 1.0;
            let phi = turn * 56f32.to_radians();
            let end = lowest + 0.010 * (chance(1) - 0.5) + 0.012 * turn * turn;
            let mut path = Vec::with_capacity(12);
            for i in 0..60 {
                let (down, across) = (0.42 + 0.025 * i as f32, 0.8 + 0.006 * i as f32);
                if i % 4 == 0 {
                    let rise = 0.012 + 0.004 * chance(2);
                    path.push(skull.point(down, phi * across, rise));
                }
                if skull.point(down, phi * across, 0.0).y > end {
                    break;
                }
            }
            if path.len() > 2 {
                let shade = 0.8 + 0.35 * chance(3);
                self.lock(&path, 0.007, shade, surface, k as f32 * 5.0);
            }
        }
    }

    /// Adds a lock: a flat tube, thin at its end. `wide`: half width, metres; `shade`: gain of the colour.
    fn lock(&mut self, path: &[Point], wide: f32, shade: f32, surface: &Surface, uv: f32) {
        let along = |i: usize| i as f32 / (path.len() - 1) as f32;
        let section = |i: usize| {
            let mut out = path[i].coords - Vector::new(0.0, 0.0, 0.085);
            out.y = out.y.min(0.0);
            let thin = (1.0 - along(i) * along(i) * along(i)).max(0.06);
            (
                out / out.norm().max(1e-6),
                [wide * thin, 0.45 * wide * thin],
            )
        };
        self.tube(path, 6, surface.material, section, |i, p, turn| Vertex {
            base: FREE,
            offset: p.coords,
            torso_share: 0.85 * slope(p.y, 0.06, 0.22),
            colour: surface.colour.map(|c| c * shade),
            uv: [uv + 14.0 * turn, 7.0 * along(i) + uv],
            coverage: 1.0 - 0.55 * slope(along(i), 0.6, 1.0),
        });
    }
}
