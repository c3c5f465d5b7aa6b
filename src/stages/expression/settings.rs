//! Settings of the expression stage.

use super::measures::Scale;
use super::one_way::Scan;
use super::robust::RobustSettings;
use crate::base::defaults;

/// Method of learning ranges.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Method {
    /// The default: mode for rest, ends by evidence, bounded motion.
    #[default]
    Robust,
    /// Sections 2.2 to 2.6 of the paper.
    Paper,
}

defaults! {
    /// Settings of the stage.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct Settings {
        /// Method of learning ranges.
        pub method: Method = Method::Robust,
        /// Divisor of the measures.
        pub scale: Scale = Scale::ByMethod,
        /// z_opt of equation (4): distance of full sample weight, metres; 0.3 to 4.
        pub best_distance_m: f64 = 0.5,
        /// Half-life of learned evidence, seconds of presence; 0 never forgets; 0 to 86400.
        pub half_life_s: f64 = 300.0,
        /// κ: how many half seconds of expression outweigh the population's range (robust); 0.5 to 100.
        pub range_prior: f64 = 8.0,
        /// Dead zone about rest, standard deviations of the noise (robust); 0 to 3.
        pub dead_zone: f64 = 1.5,
        /// Cut-off of the output filter at rest, Hz (robust); 0 disables it; 0 to 30.
        pub smoothing_hz: f64 = 3.0,
        /// Whether units of a covered mouth are inferred over time (robust).
        pub infer_covered: bool = true,
        /// σ of compensating samples as a share of the measure's range (paper); 0 is the literal σ = −ln ω; 0 to 1.
        pub compensation_scale: f64 = 0.0,
        /// l, k and m of the interval of one-way units, percent (paper); each 0 to 100.
        pub scan: Scan = Scan::DEFAULT,
        /// Seconds until the population's ranges have faded into the person's (paper); 0 to 60.
        pub prior_s: f64 = 10.0,
    }
}

impl Settings {
    pub(super) fn robust(&self) -> RobustSettings {
        RobustSettings {
            half_life_s: self.half_life_s,
            range_prior: self.range_prior,
        }
    }

    pub(super) fn scale(&self) -> Scale {
        match (self.scale, self.method) {
            (Scale::ByMethod, Method::Paper) => Scale::Frame,
            (Scale::ByMethod, Method::Robust) => Scale::Learnt,
            (scale, _) => scale,
        }
    }
}

/// Least confidence of a face or measure that is learned from.
pub(super) const LEAST_CONFIDENCE: f32 = 0.3;
