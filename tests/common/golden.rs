//! Pictures and figures as lines that [`compare_with_golden`] and [`equals_golden`] compare with a table in `tests/golden`.

use std::fmt::Write as _;

use image::RgbImage;

#[allow(unused_imports, reason = "some crates use one of them")]
pub(crate) use super::hold::{compare_with_golden, equals_golden};

/// Means of the cells of a grid, in rows.
pub(crate) fn cells<const COLUMNS: usize, const ROWS: usize>(
    luma: &[u8],
    width: usize,
) -> Vec<String> {
    let height = luma.len() / width;
    let mean = |row: usize, column: usize| {
        let [x, to] = [column, column + 1].map(|c| c * width / COLUMNS);
        let rows = row * height / ROWS..(row + 1) * height / ROWS;
        let inside: Vec<u32> = rows
            .flat_map(|y| &luma[y * width..][x..to])
            .map(|&luma| u32::from(luma))
            .collect();
        (inside.iter().sum::<u32>() / inside.len() as u32).to_string()
    };
    let row = |row| {
        (0..COLUMNS)
            .map(|column| mean(row, column))
            .collect::<Vec<_>>()
            .join(" ")
    };
    (0..ROWS).map(row).collect()
}

/// The same of a picture's channels, one after the other.
pub(crate) fn coloured<const COLUMNS: usize, const ROWS: usize>(picture: &RgbImage) -> Vec<String> {
    let channel = |channel: usize| {
        let values: Vec<u8> = picture.pixels().map(|pixel| pixel[channel]).collect();
        cells::<COLUMNS, ROWS>(&values, picture.width() as usize)
    };
    (0..3).flat_map(channel).collect()
}

/// Every line of a text with its numbers as words of their own, to two decimals and without their points: a number may
/// differ by one in its last digit.
pub(crate) fn figures(text: &str) -> Vec<String> {
    let figures = |line: &str| {
        let (mut out, mut before) = (String::new(), ' ');
        // Digits that are still taken.
        let mut left = usize::MAX;
        for (k, this) in line.char_indices() {
            let next = line[k..].chars().nth(1).unwrap_or(' ');
            if this == '.' && before.is_ascii_digit() && next.is_ascii_digit() {
                left = 2;
                continue;
            }
            if this.is_ascii_digit() && left == 0 {
                continue;
            }
            left = match this.is_ascii_digit() {
                true => left.saturating_sub(1),
                false => usize::MAX,
            };
            if this.is_ascii_digit() != before.is_ascii_digit() && before != '-' && before != '+' {
                out.push(' ');
            }
            write!(out, "{this}").expect("a string takes all");
            before = this;
        }
        out.split_whitespace().collect::<Vec<_>>().join(" ")
    };
    text.lines().map(figures).collect()
}
