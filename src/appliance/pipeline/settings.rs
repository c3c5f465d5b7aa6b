//! Settings of the stages.

use mien_stages::base::defaults;
use mien_stages::base::second_core::SecondCore;
use mien_stages::{expression, landmarks, pose, segment, users};

defaults! {
    /// The settings of every stage, each in its own type.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Settings {
        /// Head segmentation.
        pub segment: segment::Settings = segment::Settings::default(),
        /// Head pose.
        pub pose: pose::Settings = pose::Settings::default(),
        /// Landmarks.
        pub landmarks: landmarks::StageSettings = landmarks::StageSettings::default(),
        /// Learning of ranges.
        pub learning: expression::Settings = expression::Settings::default(),
        /// Selection of tracked people, and handling of a lost face.
        pub users: users::Settings = users::Settings::default(),
        /// Whether two threads share the people, with the same results; by default if a second core is available.
        pub second_core: bool = SecondCore::is_available(),
    }
}
