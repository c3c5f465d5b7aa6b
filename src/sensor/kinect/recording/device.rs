//! `device.json`: the calibration of the sensor that was recorded, in libfreenect's form.
//!
//! ```json
//! {"reg_info": {"ax": 1964, …, "pad_info": {"start_lines": 0, …}, "zero_plane_info": {"reference_distance": 120, …}},
//!  "const_shift": 200}
//! ```
//! An integer of `reg_info` that is absent is 0; everything else that is absent keeps its nominal value; unknown names are
//! ignored. Read by our own small strict parser, because one file of numbers does not justify a dependency.

use std::io::Read;
use std::path::Path;

use super::error::RecordingError;
use crate::base::bounded_read;
use crate::sensor::kinect::registration::{Registration, RegistrationIntegers};

/// Larger files are no calibration.
const LARGEST_BYTES: u64 = 64 * 1024;
/// Deeper nesting is no calibration, and must not exhaust the stack.
const DEEPEST: usize = 16;

/// Where the text departs from what is expected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct JsonFault {
    /// Byte offset.
    pub at: usize,
    /// What should stand there.
    pub expected: &'static str,
}

/// Reads the calibration at `path`; `None` if there is no such file.
///
/// # Errors
/// If the file is there and cannot be read or understood.
pub fn read(path: &Path) -> Result<Option<Registration>, RecordingError> {
    let file_error = |source| RecordingError::File {
        path: path.to_path_buf(),
        source,
    };
    let mut text = Vec::new();
    match bounded_read::open_regular(path) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(file_error(error)),
        Ok(file) => file
            .take(LARGEST_BYTES)
            .read_to_end(&mut text)
            .map_err(file_error)?,
    };
    from_json(&text).map(Some).map_err(|fault| {
        let before = &text[..fault.at.min(text.len())];
        let line_start = before
            .iter()
            .rposition(|&byte| byte == b'\n')
            .map_or(0, |at| at + 1);
        RecordingError::Device {
            path: path.to_path_buf(),
            line: 1 + before.iter().filter(|&&byte| byte == b'\n').count(),
            column: 1 + before.len() - line_start,
            expected: fault.expected,
        }
    })
}

/// Parses a calibration.
///
/// # Errors
/// The first place where the text is not JSON or a value is out of range.
pub fn from_json(text: &[u8]) -> Result<Registration, JsonFault> {
    let mut registration = Registration::default();
    let r = &mut registration;
    let mut json = Json {
        text,
        at: 0,
        depth: 0,
    };
    json.object(&mut |json, key| match key {
        b"reg_info" => {
            r.integers = RegistrationIntegers::zero();
            json.object(&mut |json, key| match key {
                b"pad_info" => json.object(&mut |json, key| {
                    let field = match key {
                        b"start_lines" => &mut r.padding.start_lines,
                        b"end_lines" => &mut r.padding.end_lines,
                        b"cropping_lines" => &mut r.padding.cropping_lines,
                        _ => return json.skip(),
                    };
                    json.whole(field, "a whole number from 0 to 65535")
                }),
                b"zero_plane_info" => json.object(&mut |json, key| {
                    let plane = &mut r.zero_plane;
                    let field = match key {
                        b"dcmos_emitter_distance" => &mut plane.dcmos_emitter_distance,
                        b"dcmos_rcmos_distance" => &mut plane.dcmos_rcmos_distance,
                        b"reference_distance" => &mut plane.reference_distance,
                        b"reference_pixel_size" => &mut plane.reference_pixel_size,
                        _ => return json.skip(),
                    };
                    json.positive(field)
                }),
                name => match std::str::from_utf8(name)
                    .ok()
                    .and_then(|name| r.integers.by_name(name))
                {
                    Some(field) => json.whole(field, "a whole number of 32 bits"),
                    None => json.skip(),
                },
            })
        }
        b"const_shift" => json.whole(&mut r.const_shift, "a whole number from 0 to 65535"),
        _ => json.skip(),
    })?;
    json.space();
    if json.at < text.len() {
        return Err(json.fault("nothing after the closing brace"));
    }
    Ok(registration)
}

/// The calibration as text that [`from_json`] reads back exactly.
#[must_use]
pub fn to_json(registration: &Registration) -> String {
    use std::fmt::Write;
    let mut text = String::from("{\n  \"reg_info\": {\n");
    let integers = registration.integers.to_array();
    for (name, value) in RegistrationIntegers::NAMES.iter().zip(integers) {
        writeln!(text, "    \"{name}\": {value},").expect("a String takes everything");
    }
    let (padding, plane) = (&registration.padding, &registration.zero_plane);
    write!(
        text,
        "    \"pad_info\": {{ \"start_lines\": {}, \"end_lines\": {}, \"cropping_lines\": {} }},\n    \
         \"zero_plane_info\": {{\n      \"dcmos_emitter_distance\": {},\n      \"dcmos_rcmos_distance\": {},\n      \
         \"reference_distance\": {},\n      \"reference_pixel_size\": {}\n    }}\n  }},\n  \"const_shift\": {}\n}}\n",
        padding.start_lines,
        padding.end_lines,
        padding.cropping_lines,
        plane.dcmos_emitter_distance,
        plane.dcmos_rcmos_distance,
        plane.reference_distance,
        plane.reference_pixel_size,
        registration.const_shift,
    )
    .expect("a String takes everything");
    text
}

/// A position in JSON text.
struct Json<'a> {
    text: &'a [u8],
    at: usize,
    depth: usize,
}

type Parsed<T> = Result<T, JsonFault>;

impl<'a> Json<'a> {
    fn fault(&self, expected: &'static str) -> JsonFault {
        JsonFault {
            at: self.at,
            expected,
        }
    }

    fn space(&mut self) {
        while matches!(self.text.get(self.at), Some(b' ' | b'\t' | b'\r' | b'\n')) {
            self.at += 1;
        }
    }

    /// The next byte that is not space.
    fn peek(&mut self) -> Option<u8> {
        self.space();
        self.text.get(self.at).copied()
    }

    fn take(&mut self, byte: u8, expected: &'static str) -> Parsed<()> {
        if self.peek() != Some(byte) {
            return Err(self.fault(expected));
        }
        self.at += 1;
        Ok(())
    }

    /// Calls `each(key)` at every value of an object; it must pass over the value.
    fn object(&mut self, each: &mut dyn FnMut(&mut Self, &'a [u8]) -> Parsed<()>) -> Parsed<()> {
        self.list(b'{', b'}', "an object { … }", &mut |json| {
            let key = json.string()?;
            json.take(b':', "a colon")?;
            each(json, key)
        })
    }

    fn list(
        &mut self,
        open: u8,
        close: u8,
        expected: &'static str,
        item: &mut dyn FnMut(&mut Self) -> Parsed<()>,
    ) -> Parsed<()> {
        self.take(open, expected)?;
        self.depth += 1;
        if self.depth > DEEPEST {
            return Err(self.fault("at most 16 levels of nesting"));
        }
        if self.peek() == Some(close) {
            self.at += 1;
        } else {
            loop {
                item(self)?;
                match self.peek() {
                    Some(b',') => self.at += 1,
                    Some(byte) if byte == close => {
                        self.at += 1;
                        break;
                    }
                    _ => return Err(self.fault("a comma or a closing bracket")),
                }
            }
        }
        self.depth -= 1;
        Ok(())
    }

    /// The bytes between quotes, escapes left as they stand: no name we look for has any.
    fn string(&mut self) -> Parsed<&'a [u8]> {
        self.take(b'"', "a name in quotes")?;
        let start = self.at;
        loop {
            match self.text.get(self.at) {
                Some(b'"') => break,
                Some(b'\\') => self.at += 2,
                Some(byte) if *byte >= 0x20 => self.at += 1,
                _ => return Err(self.fault("a closing quote")),
            }
        }
        self.at += 1;
        Ok(&self.text[start..self.at - 1])
    }

    fn number(&mut self, expected: &'static str) -> Parsed<f64> {
        self.space();
        let rest = &self.text[self.at..];
        let end = rest
            .iter()
            .position(|byte| !matches!(byte, b'0'..=b'9' | b'-' | b'+' | b'.' | b'e' | b'E'))
            .unwrap_or(rest.len());
        let value = std::str::from_utf8(&rest[..end])
            .ok()
            .and_then(|text| text.parse().ok());
        let value = value
            .filter(|value: &f64| value.is_finite())
            .ok_or(self.fault(expected))?;
        self.at += end;
        Ok(value)
    }

    fn whole<T: TryFrom<i64>>(&mut self, to: &mut T, expected: &'static str) -> Parsed<()> {
        self.space();
        let fault = self.fault(expected);
        let value = self.number(expected)?;
        // Every whole number that fits 53 bits is exact; those that do not are refused by the field's own range.
        *to = (value.fract() == 0.0)
            .then(|| T::try_from(value as i64).ok())
            .flatten()
            .ok_or(fault)?;
        Ok(())
    }

    fn positive(&mut self, to: &mut f32) -> Parsed<()> {
        self.space();
        let fault = self.fault("a length in centimetres, above 0 and at most 1000");
        let value = self.number(fault.expected)? as f32;
        if value <= 0.0 || value > 1000.0 {
            return Err(fault);
        }
        *to = value;
        Ok(())
    }

    /// Passes over any value.
    fn skip(&mut self) -> Parsed<()> {
        match self.peek() {
            Some(b'{') => self.object(&mut |json, _| json.skip()),
            Some(b'[') => self.list(b'[', b']', "a list", &mut |json| json.skip()),
            Some(b'"') => self.string().map(|_| ()),
            Some(b't' | b'f' | b'n') => {
                let rest = &self.text[self.at..];
                let word = [&b"true"[..], b"false", b"null"]
                    .into_iter()
                    .find(|word| rest.starts_with(word));
                self.at += word.ok_or(self.fault("a value"))?.len();
                Ok(())
            }
            _ => self.number("a value").map(|_| ()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_calibration_survives_the_file() {
        let mut registration = Registration::default();
        registration.integers.ax = -17;
        registration.padding.end_lines = 3;
        registration.zero_plane.dcmos_rcmos_distance = 2.3;
        registration.const_shift = 187;
        assert_eq!(
            from_json(to_json(&registration).as_bytes()),
            Ok(registration)
        );
    }

    #[test]
    fn absent_integers_are_zero_and_the_rest_nominal() {
        let text = br#" {"other": [1, {"x": "a\"}"}, true, null, -1e3], "reg_info": {"ax": 5, "bx": 7.0}} "#;
        let registration = from_json(text).unwrap();
        assert_eq!((registration.integers.ax, registration.integers.bx), (5, 7));
        assert_eq!(registration.integers.dx_start, 0);
        assert_eq!(registration.zero_plane, Registration::default().zero_plane);
        assert_eq!(registration.const_shift, 200);
        assert_eq!(from_json(b"{}"), Ok(Registration::default()));
    }

    #[test]
    fn faults_are_found_where_they_are() {
        for (text, at) in [
            (&b""[..], 0),
            (b"[]", 0),
            (b"{\"a\" 1}", 5),
            (b"{\"a\": 1", 7),
            (b"{\"a\": tru}", 6),
            (b"{\"a", 3),
            (b"{\"a\\", 5),
            (b"{} x", 3),
            (b"{\"const_shift\": -1}", 16),
            (b"{\"const_shift\": 1.5}", 16),
            (b"{\"const_shift\": \"200\"}", 16),
            (b"{\"reg_info\": {\"ax\": 3000000000}}", 20),
            (
                b"{\"reg_info\": {\"zero_plane_info\": {\"reference_distance\": 0}}}",
                56,
            ),
            (
                b"{\"reg_info\": {\"zero_plane_info\": {\"reference_distance\": 1e999}}}",
                56,
            ),
        ] {
            let fault = from_json(text).unwrap_err();
            assert_eq!(
                fault.at,
                at,
                "{}: {}",
                String::from_utf8_lossy(text),
                fault.expected
            );
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
