//! The page's data: one user at one frame, and their ranges, as JSON.
//!
//! Untrusted numbers are filtered here: non-finite ones are omitted, weights are clamped to what a page can draw. Units:
//! seconds, metres (`sensor_from_head`, quaternion x y z w), pixels of the colour picture, milliseconds of latency.

use std::fmt::Write;

pub use crate::output::received::{Sample, UnitRange};

/// Weights are shown up to this: exaggerated expressions exceed 1.
const MOST_WEIGHT: f32 = 4.0;

/// A number with so many decimals, without what says nothing; `null` if it is none.
fn number(out: &mut String, value: f32, decimals: usize) {
    if !value.is_finite() {
        out.push_str("null");
        return;
    }
    // A string takes everything.
    let start = out.len();
    let _ = write!(out, "{value:.decimals$}");
    if out[start..].contains('.') {
        let kept = out.trim_end_matches('0').trim_end_matches('.').len();
        out.truncate(kept);
    }
    if &out[start..] == "-0" {
        out.replace_range(start.., "0");
    }
}

fn list(out: &mut String, values: impl Iterator<Item = f32>, decimals: usize) {
    out.push('[');
    for (i, value) in values.enumerate() {
        if i > 0 {
            out.push(',');
        }
        number(out, value, decimals);
    }
    out.push(']');
}

impl Sample {
    /// As the page reads it.
    #[must_use]
    pub fn json(&self) -> String {
        let mut out = String::with_capacity(512);
        let user = self.user.map_or(-1, |slot| slot as i64);
        let seconds = if self.seconds.is_finite() {
            self.seconds
        } else {
            0.0
        };
        let _ = write!(
            out,
            "{{\"u\":{user},\"n\":{},\"t\":{seconds:.4},\"s\":{},\"c\":",
            self.number, self.state
        );
        number(&mut out, self.confidence.clamp(0.0, 1.0), 3);
        if let Some(latency) = self.latency_ms {
            out.push_str(",\"l\":");
            number(&mut out, latency, 2);
        }
        if self.frozen {
            out.push_str(",\"f\":1");
        }
        if let Some(pose) = self.pose.filter(|p| p.iter().all(|v| v.is_finite())) {
            out.push_str(",\"p\":");
            list(&mut out, pose.into_iter(), 4);
        }
        if let Some(sides) = self.head_box {
            let _ = write!(out, ",\"b\":{sides:?}");
        }
        out.push_str(",\"w\":");
        let weights = self.weights.iter().map(|w| w.clamp(0.0, MOST_WEIGHT));
        list(&mut out, weights, 3);
        if !self.points.is_empty() {
            out.push_str(",\"m\":");
            list(&mut out, self.points.iter().flatten().copied(), 1);
        }
        out.push('}');
        out
    }
}

/// The ranges of a user, in the order of the schema; `None` where nothing was told.
#[must_use]
pub fn ranges_json(user: usize, ranges: &[Option<UnitRange>]) -> String {
    let mut out = format!("{{\"u\":{user},\"r\":[");
    for (i, range) in ranges.iter().enumerate() {
        if i > 0 {
            out.push(',');
        }
        match range {
            None => out.push_str("null"),
            Some((bounds, ready)) => {
                let ready = ready.unwrap_or(f32::NAN);
                list(&mut out, bounds.iter().copied().chain([ready]), 4);
            }
        }
    }
    out.push_str("]}");
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whatever_is_in_it_the_page_can_parse_it() {
        let sample = Sample {
            user: Some(1),
            number: 7,
            seconds: 0.25,
            state: 2,
            confidence: f32::NAN,
            latency_ms: Some(12.5),
            pose: Some([0.0, -0.0, 0.7, 0.0, 0.0, 0.0, 1.0]),
            head_box: Some([1, 2, 30, 40]),
            weights: vec![0.5, f32::NAN, -1.0, 90.0, 0.0004],
            points: vec![[1.25, 2.0]],
            frozen: true,
        };
        let json: serde_json::Value = serde_json::from_str(&sample.json()).unwrap();
        assert_eq!(json["w"], serde_json::json!([0.5, null, 0, 4, 0]));
        assert_eq!(json["p"], serde_json::json!([0, 0, 0.7, 0, 0, 0, 1]));
        assert_eq!(json["b"], serde_json::json!([1, 2, 30, 40]));
        assert_eq!(
            (&json["u"], &json["f"], &json["l"]),
            (&1.into(), &1.into(), &12.5.into())
        );
        assert!(json["c"].is_null());
        let nobody: serde_json::Value = serde_json::from_str(&Sample::default().json()).unwrap();
        assert_eq!(nobody["u"], -1);
        let ranges = ranges_json(0, &[None, Some(([0.1, 0.2, 0.30004], Some(0.5)))]);
        let json: serde_json::Value = serde_json::from_str(&ranges).unwrap();
        assert_eq!(json["r"], serde_json::json!([null, [0.1, 0.2, 0.3, 0.5]]));
    }
}
