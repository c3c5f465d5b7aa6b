//! `device.json`: the calibration of the recorded sensor, in libfreenect's format.
//!
//! ```json
//! {"reg_info": {"ax": 1964, …, "pad_info": {"start_lines": 0, …}, "zero_plane_info": {"reference_distance": 120, …}},
//!  "const_shift": 200}
//! ```
//! Missing integers of `reg_info` are 0; other missing values are nominal; unknown names are ignored.

use std::path::Path;

use serde_json::Value;

use crate::kinect::registration::{PADDING, Registration, integer_names};
use crate::picture_file::RecordingError;
use mien_stages::base::bounded_read;

/// Largest file, bytes.
const FILE_MAX: usize = 64 * 1024;
/// Largest plausible length, centimetres.
const LONGEST_CM: f32 = 1000.0;

/// Reads the calibration at `path`; `None` if there is no such file.
///
/// # Errors
/// If the file exists but cannot be read or parsed.
pub fn read(path: &Path) -> Result<Option<Registration>, RecordingError> {
    match bounded_read::read_regular(path, FILE_MAX) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
        Err(problem) => Err(RecordingError::from_io(path, &problem)),
        Ok(text) => from_json(&text).map(Some).map_err(|problem| {
            let advice = "correct it, or remove the file to use the nominal calibration";
            RecordingError(path.into(), format!("{problem}; {advice}"))
        }),
    }
}

/// Parses a calibration.
///
/// # Errors
/// What is wrong with the text, and where.
fn from_json(text: &[u8]) -> Result<Registration, String> {
    let text = std::str::from_utf8(text).map_err(|error| error.to_string())?;
    let file: Value = serde_json::from_str(text).map_err(|error| error.to_string())?;
    if !file.is_object() {
        return Err("expected an object { … }".to_string());
    }
    let mut registration = Registration::default();
    read_integer(&file, "const_shift", &mut registration.const_shift)?;
    let block = &file["reg_info"];
    if block.is_null() {
        return Ok(registration);
    }
    registration.integers = [0; 29];
    for (name, integer) in integer_names().zip(&mut registration.integers) {
        read_integer(block, name, integer)?;
    }
    for (name, lines) in PADDING.into_iter().zip(&mut registration.padding) {
        read_integer(&block["pad_info"], name, lines)?;
    }
    let (plane, from) = (&mut registration.zero_plane, &block["zero_plane_info"]);
    for (name, field) in [
        ("dcmos_emitter_distance", &mut plane.dcmos_emitter_distance),
        ("dcmos_rcmos_distance", &mut plane.dcmos_rcmos_distance),
        ("reference_distance", &mut plane.reference_distance),
        ("reference_pixel_size", &mut plane.reference_pixel_size),
    ] {
        if let Some(value) = from.get(name) {
            *field = value
                .as_f64()
                .map(|centimetres| centimetres as f32)
                .filter(|&centimetres| centimetres > 0.0 && centimetres <= LONGEST_CM)
                .ok_or(format!(
                    "{name} is {value}, expected centimetres above 0 and at most {LONGEST_CM}"
                ))?;
        }
    }
    Ok(registration)
}

/// Sets `field` to the number called `name`, if there is one.
///
/// # Errors
/// If it is not an integer in the range of `T`.
fn read_integer<T: TryFrom<i64>>(from: &Value, name: &str, field: &mut T) -> Result<(), String> {
    if let Some(value) = from.get(name) {
        *field = value
            .as_i64()
            .and_then(|number| T::try_from(number).ok())
            .ok_or(format!(
                "{name} is {value}, expected a whole number of {} bits",
                8 * size_of::<T>()
            ))?;
    }
    Ok(())
}

/// Formats a calibration; [`read`] restores it exactly.
pub fn to_json(registration: &Registration) -> String {
    use std::fmt::Write;
    let mut text = String::from("{\n  \"reg_info\": {\n");
    for (name, value) in integer_names().zip(registration.integers) {
        writeln!(text, "    \"{name}\": {value},").expect("a String takes everything");
    }
    let ([start, end, cropping], plane) = (registration.padding, &registration.zero_plane);
    write!(
        text,
        "    \"pad_info\": {{ \"start_lines\": {start}, \"end_lines\": {end}, \"cropping_lines\": {cropping} }},\n    \
         \"zero_plane_info\": {{\n      \"dcmos_emitter_distance\": {},\n      \"dcmos_rcmos_distance\": {},\n      \
         \"reference_distance\": {},\n      \"reference_pixel_size\": {}\n    }}\n  }},\n  \"const_shift\": {}\n}}\n",
        plane.dcmos_emitter_distance,
        plane.dcmos_rcmos_distance,
        plane.reference_distance,
        plane.reference_pixel_size,
        registration.const_shift,
    )
    .expect("a String takes everything");
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_calibration_survives_the_file() {
        let mut registration = Registration::default();
        registration.integers[1] = -17;
        registration.padding[1] = 3;
        registration.zero_plane.dcmos_rcmos_distance = 2.3;
        registration.const_shift = 187;
        assert_eq!(
            from_json(to_json(&registration).as_bytes()),
            Ok(registration)
        );
    }

    #[test]
    fn absent_integers_are_zero_and_the_rest_nominal() {
        let text =
            br#" {"other": [1, {"x": "a\"}"}, true, null, -1e3], "reg_info": {"ax": 5, "bx": 7}} "#;
        let registration = from_json(text).unwrap();
        // dx_center, ax, bx, cx, dx, dx_start.
        assert_eq!(registration.integers[..6], [0, 5, 7, 0, 0, 0]);
        assert_eq!(registration.zero_plane, Registration::default().zero_plane);
        assert_eq!(registration.const_shift, 200);
        assert_eq!(from_json(b"{}"), Ok(Registration::default()));
    }

    #[test]
    fn faults_are_named() {
        for (text, expected) in [
            (&b""[..], "EOF while parsing a value at line 1 column 0"),
            (
                b"{\"a\": 1",
                "EOF while parsing an object at line 1 column 7",
            ),
            (b"{} x", "trailing characters at line 1 column 4"),
            (b"[]", "expected an object { … }"),
            (
                b"{\"const_shift\": -1}",
                "const_shift is -1, expected a whole number of 16 bits",
            ),
            (
                b"{\"const_shift\": 1.5}",
                "const_shift is 1.5, expected a whole number of 16 bits",
            ),
            (
                b"{\"reg_info\": {\"ax\": 3000000000}}",
                "ax is 3000000000, expected a whole number of 32 bits",
            ),
            (
                b"{\"reg_info\": {\"zero_plane_info\": {\"reference_distance\": 0}}}",
                "reference_distance is 0, expected centimetres above 0 and at most 1000",
            ),
            (
                b"{\"reg_info\": {\"zero_plane_info\": {\"reference_distance\": \"far\"}}}",
                "reference_distance is \"far\", expected centimetres above 0 and at most 1000",
            ),
        ] {
            assert_eq!(from_json(text).unwrap_err(), expected);
        }
        let deep = [b"{\"a\":".repeat(5000), b"1".to_vec()].concat();
        assert!(from_json(&deep).is_err());
    }

    #[test]
    fn no_damaged_text_breaks_the_parser() {
        let good = to_json(&Registration::default()).into_bytes();
        let mut random = fastrand::Rng::with_seed(3);
        for _ in 0..20_000 {
            let mut text = good.clone();
            for _ in 0..random.usize(1..4) {
                let at = random.usize(..text.len());
                text[at] = random.u8(..);
            }
            text.truncate(random.usize(..=text.len()));
            // Any answer will do; a panic will not.
            let _ = from_json(&text);
        }
    }
}
