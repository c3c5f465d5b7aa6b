//! Converts the colour camera's Bayer mosaic to RGB and luma, and RGB back to the mosaic.
//!
//! Method: bilinear interpolation. A missing colour is the mean, rounded down, of the 2 or 4 nearest pixels that have it; the
//! border is mirrored. Luma is ITU-R BT.601 in integers, full range: `(77 R + 150 G + 29 B + 128) / 256`.
//!
//! The mosaic's samples are kept unchanged, so the conversion back is exact. [`luma_from_bayer`] equals [`pixel_luma`] of
//! [`rgb_from_bayer`], so a recording stored as RGB replays with the same luma.
//! Layout: even rows G R G R…, odd rows B G B G…. Memory: four rows on the stack. Cost of luma: below 0.1 ms per picture.

use core::num::Wrapping;
use mien_stages::base::capacity::{HEIGHT, PIXELS, WIDTH};
use mien_stages::base::vectors::with_avx2;

/// Bytes of an RGB picture.
pub const RGB_BYTES: usize = 3 * PIXELS;

/// Luma of one RGB pixel, 0…255.
#[inline(always)]
pub fn pixel_luma([red, green, blue]: [u8; 3]) -> u8 {
    // Not `map`: it loads the three bytes as one number, which prevents vector instructions.
    luma_from_sums([
        Wrapping(red.into()),
        Wrapping(green.into()),
        Wrapping(blue.into()),
    ])
}

/// Luma of channel sums. The weights add up to 256, so that the result fits 16 bits and grey keeps its value.
#[inline(always)]
fn luma_from_sums([red, green, blue]: [Sum; 3]) -> u8 {
    let weights = [77, 150, 29, 128].map(Wrapping);
    ((weights[0] * red + weights[1] * green + weights[2] * blue + weights[3]).0 >> 8) as u8
}

/// Luma of the demosaiced picture, 0…255, without storing the RGB picture.
pub fn luma_from_bayer(bayer: &[u8; PIXELS], luma: &mut [u8; PIXELS]) {
    with_avx2(
        #[inline(always)]
        || {
            demosaic(
                bayer,
                &mut luma[..],
                #[inline(always)]
                |colours, luma: &mut [u8; 2]| {
                    *luma = colours.map(luma_from_sums);
                },
            );
        },
    );
}

/// The demosaiced picture; `rgb` holds [`RGB_BYTES`].
///
/// # Panics
/// If `rgb` is shorter.
pub fn rgb_from_bayer(bayer: &[u8; PIXELS], rgb: &mut [u8]) {
    demosaic(bayer, rgb, |[even, odd], pixels: &mut [u8; 6]| {
        pixels[..3].copy_from_slice(&even.map(|channel| channel.0 as u8));
        pixels[3..].copy_from_slice(&odd.map(|channel| channel.0 as u8));
    });
}

/// The mosaic of a demosaiced picture: of each pixel, the colour that its position in the mosaic has. Exact inverse of
/// [`rgb_from_bayer`].
///
/// # Panics
/// If `rgb` is shorter than [`RGB_BYTES`].
pub fn bayer_from_rgb(rgb: &[u8], bayer: &mut [u8; PIXELS]) {
    with_avx2(|| {
        let rows = rgb[..RGB_BYTES].as_chunks::<{ 6 * WIDTH }>().0.iter();
        for (rgb, bayer) in rows.zip(bayer.as_chunks_mut::<{ 2 * WIDTH }>().0) {
            mosaic_row::<1, 3>(&rgb[..3 * WIDTH], &mut bayer[..WIDTH]);
            mosaic_row::<2, 4>(&rgb[3 * WIDTH..], &mut bayer[WIDTH..]);
        }
    });
}

/// Picks two of the six channel values of each pair of pixels, at indices `EVEN` and `ODD`.
#[inline(always)]
fn mosaic_row<const EVEN: usize, const ODD: usize>(rgb: &[u8], bayer: &mut [u8]) {
    let pairs = bayer.as_chunks_mut::<2>().0.iter_mut();
    for (pair, pixels) in pairs.zip(rgb.as_chunks::<6>().0) {
        *pair = [pixels[EVEN], pixels[ODD]];
    }
}

/// Luma of an RGB picture, 0…255.
///
/// # Panics
/// If `rgb` is shorter than [`RGB_BYTES`].
pub fn luma_from_rgb(rgb: &[u8], luma: &mut [u8; PIXELS]) {
    with_avx2(|| {
        let pixels = rgb[..RGB_BYTES].as_chunks::<3>().0;
        for (luma, &pixel) in luma.iter_mut().zip(pixels) {
            *luma = pixel_luma(pixel);
        }
    });
}

/// A sum of pixels, which cannot overflow here; `Wrapping`, because overflow checks would prevent vector instructions in debug
/// builds.
type Sum = Wrapping<u16>;
/// Pairs of pixels in a row.
const PAIRS: usize = WIDTH / 2;

/// A row of the mosaic with even and odd columns in separate arrays and a mirrored border: pair `i` is `even[i]` and `odd[i + 1]`.
/// Separate arrays keep neighbours of one colour contiguous.
#[derive(Clone, Copy)]
struct Row {
    even: [Sum; PAIRS + 1],
    odd: [Sum; PAIRS + 1],
}

impl Row {
    const EMPTY: Self = Self {
        even: [Wrapping(0); PAIRS + 1],
        odd: [Wrapping(0); PAIRS + 1],
    };

    #[inline(always)]
    fn load(&mut self, bayer: &[u8; PIXELS], row: usize) {
        let (pairs, _) = bayer[row * WIDTH..(row + 1) * WIDTH].as_chunks::<2>();
        for (i, &pair) in pairs.iter().enumerate() {
            let pair = u16::from_le_bytes(pair);
            self.even[i] = Wrapping(pair & 0xff);
            self.odd[i + 1] = Wrapping(pair >> 8);
        }
        self.even[PAIRS] = self.even[PAIRS - 1];
        self.odd[0] = self.odd[1];
    }
}

/// Fills `out`, `N` bytes for two pixels, by `write_pair([even, odd], …)` of the colours red, green, blue of every pair.
#[inline(always)]
fn demosaic<const N: usize>(
    bayer: &[u8; PIXELS],
    out: &mut [u8],
    write_pair: impl Fn([[Sum; 3]; 2], &mut [u8; N]) + Copy,
) {
    // Row r is in `rows[r % 3]`; the row above the first one is row 1, mirrored.
    let mut rows = [Row::EMPTY; 3];
    // A local row: otherwise the compiler assumes that the pictures overlap, which is ten times as slow.
    let mut pairs = [[0; N]; PAIRS];
    rows[0].load(bayer, 0);
    rows[2].load(bayer, 1);
    for row in 0..HEIGHT {
        let next = row + 1;
        let shown = if next < HEIGHT { next } else { HEIGHT - 2 };
        rows[next % 3].load(bayer, shown);
        let [above, here, below] = [row + 2, row, row + 1].map(|row| &rows[row % 3]);
        if row % 2 == 0 {
            demosaic_row::<N, true>(above, here, below, &mut pairs, write_pair);
        } else {
            demosaic_row::<N, false>(above, here, below, &mut pairs, write_pair);
        }
        out[N * row * PAIRS..N * (row + 1) * PAIRS].copy_from_slice(pairs.as_flattened());
    }
}

/// One row from itself and the rows above and below. `RED`: a row G R G R…, else B G B G….
#[inline(always)]
fn demosaic_row<const N: usize, const RED: bool>(
    above: &Row,
    here: &Row,
    below: &Row,
    pairs: &mut [[u8; N]; PAIRS],
    write_pair: impl Fn([[Sum; 3]; 2], &mut [u8; N]),
) {
    for i in 0..PAIRS {
        // This row: the even pixel, the pixel right of the odd one, the pixel left of the even one, the odd pixel.
        let (even, right) = (here.even[i], here.even[i + 1]);
        let (left, odd) = (here.odd[i], here.odd[i + 1]);
        // Sums of the rows above and below.
        let even_upright = above.even[i] + below.even[i];
        let odd_upright = above.odd[i + 1] + below.odd[i + 1];
        let colours = if RED {
            let right_upright = above.even[i + 1] + below.even[i + 1];
            [
                [(left + odd) >> 1, even, even_upright >> 1],
                [
                    odd,
                    (even + right + odd_upright) >> 2,
                    (even_upright + right_upright) >> 2,
                ],
            ]
        } else {
            let left_upright = above.odd[i] + below.odd[i];
            [
                [
                    (left_upright + odd_upright) >> 2,
                    (left + odd + even_upright) >> 2,
                    even,
                ],
                [odd_upright >> 1, odd, (even + right) >> 1],
            ]
        };
        write_pair(colours, &mut pairs[i]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(bytes: usize, mut value: impl FnMut(usize) -> u8) -> Box<[u8]> {
        (0..bytes).map(&mut value).collect()
    }

    fn mosaic(value: impl FnMut(usize) -> u8) -> Box<[u8; PIXELS]> {
        picture(PIXELS, value).try_into().unwrap()
    }

    fn noise() -> Box<[u8; PIXELS]> {
        let mut random = fastrand::Rng::with_seed(7);
        mosaic(|_| random.u8(..))
    }

    /// The definition, pixel by pixel: the mean of the nearest pixels that have the colour.
    fn by_definition(bayer: &[u8; PIXELS], col: i32, row: i32) -> [u8; 3] {
        let colour_of = |col: i32, row: i32| match (row & 1, col & 1) {
            (0, 1) => 0,
            (1, 0) => 2,
            _ => 1,
        };
        let mirrored = |i: i32, n: i32| {
            if i < 0 {
                -i
            } else if i >= n {
                2 * (n - 1) - i
            } else {
                i
            }
        };
        let rings: [&[(i32, i32)]; 3] = [
            &[(0, 0)],
            &[(-1, 0), (1, 0), (0, -1), (0, 1)],
            &[(-1, -1), (1, -1), (-1, 1), (1, 1)],
        ];
        [0, 1, 2].map(|colour| {
            let ring = rings
                .iter()
                .find(|ring| {
                    ring.iter()
                        .any(|&(x, y)| colour_of(col + x, row + y) == colour)
                })
                .unwrap();
            let values: Vec<u32> = ring
                .iter()
                .filter(|&&(x, y)| colour_of(col + x, row + y) == colour)
                .map(|&(x, y)| {
                    (
                        mirrored(col + x, WIDTH as i32),
                        mirrored(row + y, HEIGHT as i32),
                    )
                })
                .map(|(x, y)| u32::from(bayer[y as usize * WIDTH + x as usize]))
                .collect();
            (values.iter().sum::<u32>() / values.len() as u32) as u8
        })
    }

    #[test]
    fn every_pixel_is_the_mean_of_its_nearest_of_each_colour() {
        let bayer = noise();
        let mut rgb = vec![0; RGB_BYTES];
        rgb_from_bayer(&bayer, &mut rgb);
        for (pixel, found) in rgb.chunks_exact(3).enumerate() {
            let (col, row) = (pixel % WIDTH, pixel / WIDTH);
            let expected = by_definition(&bayer, col as i32, row as i32);
            assert_eq!(found, expected, "pixel ({col}, {row})");
        }
    }

    #[test]
    fn luma_is_that_of_the_rgb_picture() {
        let bayer = noise();
        let (mut rgb, mut direct, mut through_rgb) =
            (vec![0; RGB_BYTES], mosaic(|_| 0), mosaic(|_| 1));
        rgb_from_bayer(&bayer, &mut rgb);
        luma_from_bayer(&bayer, &mut direct);
        luma_from_rgb(&rgb, &mut through_rgb);
        assert!(direct == through_rgb);
        assert_eq!(
            direct[12_345],
            pixel_luma(rgb[37_035..37_038].try_into().unwrap())
        );
    }

    #[test]
    fn the_mosaic_comes_back_exactly() {
        let bayer = noise();
        let (mut rgb, mut back) = (vec![0; RGB_BYTES], mosaic(|_| 0));
        rgb_from_bayer(&bayer, &mut rgb);
        bayer_from_rgb(&rgb, &mut back);
        assert!(back == bayer);
    }

    #[test]
    fn an_even_colour_stays_even_and_grey_keeps_its_value() {
        let colour = [200, 90, 30];
        let rgb = picture(RGB_BYTES, |i| colour[i % 3]);
        let (mut bayer, mut back) = (mosaic(|_| 0), vec![0; RGB_BYTES]);
        bayer_from_rgb(&rgb, &mut bayer);
        rgb_from_bayer(&bayer, &mut back);
        assert!(back[..] == rgb[..]);
        assert_eq!(bayer[..4], [90, 200, 90, 200]);
        assert_eq!(bayer[WIDTH..WIDTH + 4], [30, 90, 30, 90]);
        for grey in 0..=255 {
            assert_eq!(pixel_luma([grey; 3]), grey);
        }
    }
}
