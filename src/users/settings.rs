//! Settings for tracking people.

use super::choice::Policy;
use crate::base::capacity::USERS;
use crate::base::defaults;

defaults! {
    /// Which people are tracked, and what happens when a face is lost.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Settings {
        /// Maximum number of people tracked at once.
        pub most: u32 = USERS as u32,
        /// Which person a single-person output sends.
        pub single: Policy = Policy::default(),
        /// Seconds for which values are held after the face was last seen.
        pub hold_s: f32 = 0.5,
        /// Seconds after which a lost person's slot is free again.
        pub forget_s: f32 = 2.0,
        /// Seconds during which a person who left can be recognised by the shape of the head; 0 never.
        pub remember_s: f32 = 600.0,
    }
}
