//! Made-up people with known truth: faces that have given measures exactly, acting, and the jitter of a tracker.

use mien_stages::base::capacity::{LANDMARKS, LEARNT_MEASURES};
use mien_stages::base::geometry::{Point, Vector};
use mien_stages::expression::{Measure, Units};

pub const FRAME_S: f64 = 1.0 / 30.0;
/// Inner and outer eye-corner distance of the average person, metres.
pub const INNER_M: f32 = 0.037;
pub const OUTER_M: f32 = 0.098;
/// The first measures, the paper's and the fore-aft ones, are acted; the made-up faces hold the others still.
pub const ACTED: usize = 12;

pub fn normal(random: &mut fastrand::Rng) -> f64 {
    (-2.0 * (1.0 - random.f64()).ln()).sqrt() * (std::f64::consts::TAU * random.f64()).cos()
}

/// A made-up person: neutral value and sides of every measure, in their own eye distances.
#[derive(Clone)]
pub struct Person {
    pub w: f32,
    pub rest: [f64; LEARNT_MEASURES],
    pub up: [f64; LEARNT_MEASURES],
    pub down: [f64; LEARNT_MEASURES],
}

impl Person {
    pub fn new(units: &Units, seed: u64) -> Self {
        let mut random = fastrand::Rng::with_seed(seed);
        let w = INNER_M * (1.0 + 0.06 * normal(&mut random).clamp(-2.0, 2.0)) as f32;
        let mut by = |f: &dyn Fn(usize, f64) -> f64| {
            std::array::from_fn(|m| f(m, normal(&mut random).clamp(-2.0, 2.0)))
        };
        let prior = |m: usize| units.rows[m].prior;
        let mut rest: [f64; LEARNT_MEASURES] =
            by(&|m, n| prior(m).rest + 0.8 * prior(m).rest_sd * n);
        rest[Measure::LipGap as usize] = rest[Measure::LipGap as usize].max(0.0);
        Self {
            w,
            rest,
            up: by(&|m, n| prior(m).up * (1.0 + 0.15 * n)),
            down: by(&|m, n| prior(m).down * (1.0 + 0.15 * n)),
        }
    }

    /// A face in the head frame that has these activations exactly, one a measure, signed.
    pub fn face(&self, activation: &[f64; LEARNT_MEASURES]) -> [Point; LANDMARKS] {
        let jaw =
            activation[Measure::JawDrop as usize].max(0.0) * self.up[Measure::JawDrop as usize];
        let g = |measure: Measure| {
            let m = measure as usize;
            let a = activation[m];
            // What an opening jaw does to the lips, as on the ICT head.
            let dragged = match measure {
                Measure::MouthWidth => -0.21,
                Measure::LipProtrusion => -0.40,
                Measure::LipThrust => -0.76,
                _ => 0.0,
            };
            let own = self.rest[m] + a * if a >= 0.0 { self.up[m] } else { self.down[m] };
            (own + dragged * jaw) as f32
        };
        let mut p = [Point::new(0.0, 1.0, 0.5); LANDMARKS];
        let at = |x: f32, y: f32, z: f32| Point::new(x, y, z);
        p[39] = at(-0.5, 0.0, 0.0);
        p[42] = at(0.5, 0.0, 0.0);
        p[36] = at(-1.3, 0.0, 0.15);
        p[45] = at(1.3, 0.0, 0.15);
        for i in [7, 8, 9] {
            p[i] = at(0.3 * (i as f32 - 8.0), g(Measure::JawDrop), -0.1);
        }
        for k in 0..5 {
            p[17 + k] = at(-1.5 + 0.25 * k as f32, -g(Measure::BrowR), -0.1);
            p[22 + k] = at(0.5 + 0.25 * k as f32, -g(Measure::BrowL), -0.1);
        }
        for (upper, lower, x, lid) in [
            (37, 41, -1.05, g(Measure::LidR)),
            (38, 40, -0.75, g(Measure::LidR)),
            (43, 47, 0.75, g(Measure::LidL)),
            (44, 46, 1.05, g(Measure::LidL)),
        ] {
            (p[upper], p[lower]) = (at(x, -0.5 * lid, 0.0), at(x, 0.5 * lid, 0.0));
        }
        for (i, x, y) in [
            (31, -0.35, g(Measure::NostrilR)),
            (32, -0.2, g(Measure::NostrilR)),
            (34, 0.2, g(Measure::NostrilL)),
            (35, 0.35, g(Measure::NostrilL)),
        ] {
            p[i] = at(x, y, -0.5);
        }
        let half = 0.5 * g(Measure::MouthWidth);
        (p[48], p[54]) = (at(-half, 1.9, -0.4), at(half, 1.9, -0.4));
        for k in 0..3 {
            let x = 0.2 * (k as f32 - 1.0);
            let (middle, thrust) = (-g(Measure::LipProtrusion), 0.5 * g(Measure::LipThrust));
            p[50 + k] = at(x, 1.75, middle + thrust);
            p[58 - k] = at(x + g(Measure::LipShift), 2.1, middle - thrust);
            p[61 + k] = at(x, 1.85, -0.6);
            p[67 - k] = at(x, 1.85 + g(Measure::LipGap), -0.6);
        }
        p.map(|p| p * self.w)
    }
}

/// One expression after another, with ramps, holds and pauses; the jaw opens the lips too.
pub struct Acting {
    pub random: fastrand::Rng,
    pub played: [usize; 2],
    pub from: f64,
    pub ramp: f64,
    pub hold: f64,
    pub size: f64,
}

/// What is acted: measures that move together, and which way.
pub const ACTS: [(&[Measure], f64); 15] = [
    (&[Measure::LipGap], 1.0),
    (&[Measure::JawDrop, Measure::LipGap], 1.0),
    (&[Measure::MouthWidth], 1.0),
    (&[Measure::MouthWidth], -1.0),
    (&[Measure::BrowL, Measure::BrowR], 1.0),
    (&[Measure::BrowL, Measure::BrowR], -1.0),
    (&[Measure::BrowL], 1.0),
    (&[Measure::LidL, Measure::LidR], -1.0),
    (&[Measure::LidL, Measure::LidR], 1.0),
    (&[Measure::LidR], -1.0),
    (&[Measure::NostrilL, Measure::NostrilR], -1.0),
    (&[Measure::LipProtrusion], 1.0),
    (&[Measure::LipProtrusion], -1.0),
    (&[Measure::LipShift], 1.0),
    (&[Measure::LipThrust], 1.0),
];

impl Acting {
    pub fn new(seed: u64) -> Self {
        Self {
            random: fastrand::Rng::with_seed(seed),
            played: [0; 2],
            from: 0.0,
            ramp: 0.0,
            hold: 0.0,
            size: 0.0,
        }
    }

    pub fn at(&mut self, t: f64) -> [f64; LEARNT_MEASURES] {
        if t >= self.from + 2.0 * self.ramp + self.hold {
            self.played = [
                self.random.usize(..ACTS.len()),
                self.random.usize(..ACTS.len()),
            ];
            self.from = t + 0.2 + 0.6 * self.random.f64();
            self.ramp = 0.15 + 0.25 * self.random.f64();
            self.hold = 0.1 + 0.6 * self.random.f64();
            self.size = 0.5 + 0.5 * self.random.f64();
        }
        let s = t - self.from;
        let shape = if s < self.ramp {
            s / self.ramp
        } else {
            ((2.0 * self.ramp + self.hold - s) / self.ramp).min(1.0)
        };
        let envelope =
            self.size * (0.5 - 0.5 * (std::f64::consts::PI * shape.clamp(0.0, 1.0)).cos());
        let mut activation = [0.0; LEARNT_MEASURES];
        for played in self.played {
            let (measures, sign) = ACTS[played];
            for &measure in measures {
                activation[measure as usize] = sign * envelope;
            }
        }
        activation
    }
}

/// Landmark jitter of standard deviation `share` of the outer eye-corner distance: 0.6 white, 0.8 slow (0.25 s).
pub struct Jitter {
    pub random: fastrand::Rng,
    pub slow: [Vector; LANDMARKS],
    pub share: f32,
}

impl Jitter {
    pub fn new(share: f32, seed: u64) -> Self {
        Self {
            random: fastrand::Rng::with_seed(seed),
            slow: [Vector::zeros(); LANDMARKS],
            share,
        }
    }

    pub fn add(&mut self, points: &mut [Point; LANDMARKS]) {
        let keep = (-FRAME_S / 0.25).exp() as f32;
        let fresh = (1.0 - keep * keep).sqrt();
        let mut draw = || {
            let mut n = || normal(&mut self.random) as f32;
            Vector::new(n(), n(), 1.7 * n())
        };
        for (point, slow) in points.iter_mut().zip(&mut self.slow) {
            *slow = *slow * keep + draw() * fresh;
            *point += (draw() * 0.6 + *slow * 0.8) * self.share * OUTER_M;
        }
    }
}
