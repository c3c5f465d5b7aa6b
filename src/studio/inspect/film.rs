//! Pictures that play, inside one page: at the pace they were taken, or one by one.
//!
//! Each is a JPEG in base 64, so that the file needs nothing beside it: about 30 kB a picture.

use std::fmt::Write as _;

use base64::{Engine as _, engine::general_purpose::STANDARD};
use image::RgbImage;

use crate::studio::picture_files::jpeg;

/// Enough to read labels and see landmarks.
const QUALITY: u8 = 75;

/// Play and pause by the button or the space bar, steps by the arrows or the slider.
const SCRIPT: &str = include_str!("film.js");

/// Pictures with their times.
#[derive(Default)]
pub struct Film {
    /// Seconds, ascending, and the JPEG.
    frames: Vec<(f64, Vec<u8>)>,
}

impl Film {
    /// Adds a picture.
    pub fn add(&mut self, seconds: f64, picture: &RgbImage) {
        self.frames.push((seconds, jpeg(picture, QUALITY)));
    }

    /// Picture, button, slider and time; nothing for fewer than two pictures.
    pub fn html(&self) -> String {
        let [(first, _), _, ..] = &self.frames[..] else {
            return String::new();
        };
        let mut html = format!(
            "<figure><img id=\"film\" alt=\"the recording\"><figcaption><button id=\"play\">Play</button> \
             <input id=\"at\" type=\"range\" min=\"0\" max=\"{}\" value=\"0\" aria-label=\"frame\"> \
             <output id=\"when\"></output> space plays, arrows step</figcaption></figure><script>const film=[",
            self.frames.len() - 1
        );
        for (seconds, jpeg) in &self.frames {
            let (after, jpeg) = (seconds - first, STANDARD.encode(jpeg));
            let _ = write!(html, "[{after:.3},\"{jpeg}\"],");
        }
        html + "];\n" + SCRIPT + "</script>"
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_picture_is_in_the_page_at_its_time() {
        let mut film = Film::default();
        assert!(film.html().is_empty());
        for (k, seconds) in [7.0, 7.1, 7.5].into_iter().enumerate() {
            let picture = RgbImage::from_pixel(16, 8, image::Rgb([80 * k as u8; 3]));
            film.add(seconds, &picture);
        }
        let html = film.html();
        let list = html.split("const film=[").nth(1).unwrap();
        let list = list.split("];").next().unwrap();
        let frames: Vec<_> = list.split("],").filter(|one| !one.is_empty()).collect();
        assert_eq!(frames.len(), 3);
        for (k, (one, seconds)) in frames.iter().zip(["0.000", "0.100", "0.500"]).enumerate() {
            let (at, data) = one[1..].split_once(",\"").unwrap();
            assert_eq!(at, seconds);
            let jpeg = STANDARD.decode(data.trim_end_matches('"')).unwrap();
            let picture = image::load_from_memory(&jpeg).unwrap().to_rgb8();
            let [grey, ..] = picture.get_pixel(3, 3).0;
            assert!(grey.abs_diff(80 * k as u8) < 4, "{grey}");
        }
        assert!(html.contains("max=\"2\""));
    }
}
