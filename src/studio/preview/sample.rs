//! The page's data as JSON: one user at one frame, and ranges.
//!
//! Untrusted numbers are filtered: non-finite ones are omitted, weights are clamped to what a page can draw. Units:
//! seconds, metres (`sensor_from_head`, quaternion x y z w), pixels of the colour image, milliseconds of latency.

use mien_outputs::received::{Sample, UnitRange};
use mien_stages::face_model::scheme::VISIBLE_REGIONS;
use serde_json::{Map, Value, json};

/// Largest weight shown: exaggerated expressions exceed 1.
const MAX_WEIGHT: f32 = 4.0;

/// A rounded number, `null` if not finite.
fn number(value: impl Into<f64>, decimals: i32) -> Value {
    let scale = 10.0_f64.powi(decimals);
    let value = (value.into() * scale).round() / scale;
    match value.fract() == 0.0 {
        true => json!(value as i64),
        false => json!(value),
    }
}

fn list(values: impl IntoIterator<Item = f32>, decimals: i32) -> Value {
    let values = values.into_iter();
    values.map(|value| number(value, decimals)).collect()
}

/// The sample as JSON for the page.
pub fn sample_json(sample: &Sample) -> String {
    let weights = sample.weights.iter().map(|w| w.clamp(0.0, MAX_WEIGHT));
    let points = sample.points.iter().flatten().copied();
    let pose = sample.pose.filter(|p| p.iter().all(|v| v.is_finite()));
    // Only those that are not wholly seen, as most are.
    let hidden = sample.seen.map(|seen| {
        let regions = VISIBLE_REGIONS.iter().zip(seen);
        let hidden = regions.filter(|(_, share)| *share < 1.0);
        hidden.map(|((name, _), share)| ((*name).to_owned(), number(share.max(0.0), 2)))
    });
    let hidden = hidden.map(Iterator::collect::<Map<_, _>>);
    let mut json = json!({
        "u": sample.user.map_or(-1, |slot| slot as i64),
        "n": sample.number,
        "t": number(Some(sample.seconds).filter(|t| t.is_finite()).unwrap_or(0.0), 4),
        "s": sample.state.code(),
        "c": number(sample.confidence.clamp(0.0, 1.0), 3),
        "w": list(weights, 3),
    });
    for (key, value) in [
        ("l", sample.latency_ms.map(|latency| number(latency, 2))),
        ("f", sample.frozen.then(|| json!(1))),
        ("p", pose.map(|pose| list(pose, 4))),
        ("b", sample.head_box.map(|sides| json!(sides))),
        ("v", hidden.filter(|all| !all.is_empty()).map(Value::Object)),
        ("m", (!sample.points.is_empty()).then(|| list(points, 1))),
    ] {
        if let Some(value) = value {
            json[key] = value;
        }
    }
    json.to_string()
}

/// A user's ranges as JSON, in the order of the schema; `None` for those not received.
pub fn ranges_json(user: usize, ranges: &[Option<UnitRange>]) -> String {
    let range = |range: &Option<UnitRange>| {
        range.map(|(bounds, ready)| list(bounds.into_iter().chain([ready.unwrap_or(f32::NAN)]), 4))
    };
    let ranges: Vec<_> = ranges.iter().map(range).collect();
    json!({"u": user, "r": ranges}).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;
    use mien_stages::users::TrackingState;

    #[test]
    fn samples_are_valid_json_for_any_numbers() {
        let sample = Sample {
            user: Some(1),
            number: 7,
            seconds: 0.25,
            state: TrackingState::Tracking,
            confidence: f32::NAN,
            latency_ms: Some(12.5),
            pose: Some([0.0, -0.0, 0.7, 0.0, 0.0, 0.0, 1.0]),
            head_box: Some([1, 2, 30, 40]),
            seen: Some([1.0, 0.504, 1.0, -1.0, f32::NAN, 0.0]),
            weights: vec![0.5, f32::NAN, -1.0, 90.0, 0.0004],
            points: vec![[1.25, 2.0]],
            frozen: true,
        };
        let json: serde_json::Value = serde_json::from_str(&sample_json(&sample)).unwrap();
        assert_eq!(json["w"], serde_json::json!([0.5, null, 0, 4, 0]));
        assert_eq!(json["p"], serde_json::json!([0, 0, 0.7, 0, 0, 0, 1]));
        assert_eq!(json["b"], serde_json::json!([1, 2, 30, 40]));
        let hidden = serde_json::json!({"brow_R": 0.5, "eye_R": 0, "mouth": 0});
        assert_eq!(json["v"], hidden);
        assert_eq!(
            (&json["u"], &json["f"], &json["l"]),
            (&1.into(), &1.into(), &12.5.into())
        );
        assert!(json["c"].is_null());
        let nobody: serde_json::Value =
            serde_json::from_str(&sample_json(&Sample::default())).unwrap();
        assert_eq!(nobody["u"], -1);
        let ranges = ranges_json(0, &[None, Some(([0.1, 0.2, 0.30004], Some(0.5)))]);
        let json: serde_json::Value = serde_json::from_str(&ranges).unwrap();
        assert_eq!(json["r"], serde_json::json!([null, [0.1, 0.2, 0.3, 0.5]]));
    }
}
