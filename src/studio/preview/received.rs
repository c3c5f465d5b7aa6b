//! Passes what the receivers parse to the hub.

use super::hub::Hub;
use crate::output::received::{Listener, Sample, UnitRange};

impl Listener for Hub {
    fn schema(&self, names: &[String]) {
        Self::schema(self, names.iter().map(String::as_str));
    }

    fn sample(&self, sample: &Sample) {
        self.tell(sample);
    }

    fn ranges(&self, slot: usize, ranges: &[Option<UnitRange>]) {
        Self::ranges(self, slot, ranges);
    }

    fn gesture(&self, name: &str, slot: Option<usize>, is_on: bool) {
        let json = serde_json::json!({"name": name, "u": slot, "on": is_on});
        self.fact(
            "gesture",
            &format!("gesture {name} {slot:?}"),
            &json.to_string(),
        );
    }

    fn count(&self, taken: u64, refused: u64) {
        Self::count(self, taken, refused);
    }
}
