//! Conversion between sRGB and linear light (IEC 61966-2-1), which glTF uses.

/// Linear light of one sRGB channel, both 0 to 1.
pub fn linear(value: f64) -> f64 {
    if value <= 0.04045 {
        value / 12.92
    } else {
        ((value + 0.055) / 1.055).powf(2.4)
    }
}

/// The sRGB channel of linear light, both 0 to 1.
pub fn coded(light: f64) -> f64 {
    if light <= 0.003_130_8 {
        light * 12.92
    } else {
        1.055 * light.powf(1.0 / 2.4) - 0.055
    }
}

#[cfg(test)]
mod tests {
    use super::{coded, linear};

    #[test]
    fn half_grey_is_a_fifth_of_the_light_and_the_ends_stay() {
        assert_eq!(linear(0.0), 0.0);
        assert!((linear(1.0) - 1.0).abs() < 1e-12);
        // The standard's own table: 8-bit 128 is 0.215861.
        assert!((linear(128.0 / 255.0) - 0.215_861).abs() < 1e-6);
        assert!((linear(0.04045) - 0.003_130_8).abs() < 1e-7);
        assert!([0.0, 0.02, 0.5, 1.0].map(|c| (coded(linear(c)) - c).abs() < 1e-9) == [true; 4]);
    }
}
