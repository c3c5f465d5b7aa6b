//! Settings for tracking people.

use super::choice::Policy;
use crate::base::capacity::USERS;

/// Which people are tracked, and what happens when a face is lost.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Maximum number of people tracked at once.
    pub most: u32,
    /// Which person a single-person output sends.
    pub single: Policy,
    /// Seconds for which values are held after the face was last seen.
    pub hold_s: f32,
    /// Seconds after which a lost person's slot is free again.
    pub forget_s: f32,
    /// Seconds during which a person who left can be recognised by the shape of the head; 0 never.
    pub remember_s: f32,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            most: USERS as u32,
            single: Policy::default(),
            hold_s: 0.5,
            forget_s: 2.0,
            remember_s: 600.0,
        }
    }
}
