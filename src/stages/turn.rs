//! A sensor mounted on its side or upside down: its images are turned upright before any stage sees them.
//!
//! Angles are those by which the sensor is turned clockwise, as seen by the person in front of it. The sensor itself looks the other
//! way, so at 90° the world's up is the right of its images, which are therefore turned counterclockwise.
//!
//! An image is turned in place, since frames have a fixed size. By 90° or 270° columns become rows, of which a frame holds
//! [`HEIGHT`]: of a wider image the middle [`HEIGHT`] columns are kept. Cost: half a millisecond a frame of 640 × 480 on one core of a
//! Xeon, 0.03 ms if upside down.

use crate::base::capacity::{HEIGHT, PIXELS, WIDTH};
use crate::base::geometry::Point;
use crate::frame::{Frame, NO_DEPTH};

/// How far a sensor is turned about its optical axis: clockwise, as seen by the person in front of it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Turn {
    /// Not at all.
    #[default]
    Upright,
    /// 90°: the foot of the sensor points to the left of the person in front of it.
    Quarter,
    /// 180°: upside down.
    Half,
    /// 270°: the foot of the sensor points to the right of the person in front of it.
    ThreeQuarters,
}

impl Turn {
    /// The turn of a resting sensor by its accelerometer: x to the left in the image, y up, z forward; in any unit, at rest upwards.
    /// A sensor that looks straight up or down, or measures nothing, counts as upright.
    pub fn from_acceleration([x, y, z]: [i16; 3]) -> Self {
        let [wide, high, along] = [x, y, z].map(i16::unsigned_abs);
        match () {
            () if wide.max(high) <= along => Self::Upright,
            () if wide > high && x < 0 => Self::Quarter,
            () if wide > high => Self::ThreeQuarters,
            () if y < 0 => Self::Half,
            () => Self::Upright,
        }
    }

    /// The angle, degrees.
    pub fn degrees(self) -> u16 {
        90 * self as u16
    }

    /// Whether columns become rows.
    fn is_on_side(self) -> bool {
        matches!(self, Self::Quarter | Self::ThreeQuarters)
    }

    /// A pair of lengths along column and row, after the turn.
    pub fn lengths<T>(self, [along, across]: [T; 2]) -> [T; 2] {
        if self.is_on_side() {
            [across, along]
        } else {
            [along, across]
        }
    }

    /// From a displacement in the sensor's image (right, down) to the one upright.
    fn upright(self, [x, y]: [f32; 2]) -> [f32; 2] {
        match self {
            Self::Upright => [x, y],
            Self::Quarter => [y, -x],
            Self::Half => [-x, -y],
            Self::ThreeQuarters => [-y, x],
        }
    }

    /// A point of the upright frame in the frame of the turned sensor.
    pub fn native_from_upright(self, p: &Point) -> Point {
        let back = match self {
            Self::Quarter => Self::ThreeQuarters,
            Self::ThreeQuarters => Self::Quarter,
            other => other,
        };
        let [x, y] = back.upright([p.x, p.y]);
        Point::new(x, y, p.z)
    }

    /// Turns both images of a frame upright; `depth` and `luma` are their columns and rows as the sensor takes them.
    pub fn turn_upright(self, frame: &mut Frame, depth: [usize; 2], luma: [usize; 2]) {
        let image = |size| TurnedImage { turn: self, size };
        image(depth).turn_upright(&mut frame.depth, Some(NO_DEPTH));
        if frame.has_colour {
            image(luma).turn_upright(&mut frame.luma, None);
        }
    }
}

/// An image of a turned sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TurnedImage {
    /// Turn of the sensor.
    pub turn: Turn,
    /// Columns and rows as the sensor takes them, at most [`WIDTH`] and [`HEIGHT`].
    pub size: [usize; 2],
}

impl TurnedImage {
    /// First column that is kept, and the number of them.
    fn kept(&self) -> [usize; 2] {
        let columns = self.size[0];
        let most = if self.turn.is_on_side() {
            HEIGHT
        } else {
            WIDTH
        };
        let kept = columns.min(most);
        [(columns - kept) / 2, kept]
    }

    /// Columns and rows after the turn.
    pub fn upright_size(&self) -> [usize; 2] {
        self.turn.lengths([self.kept()[1], self.size[1]])
    }

    /// Pixel of the upright image that shows this pixel of the sensor's image; outside of the image if it is not kept.
    pub fn upright_pixel(&self, [col, row]: [f32; 2]) -> [f32; 2] {
        let middle = |first: usize, length: usize| first as f32 + 0.5 * (length as f32 - 1.0);
        let [first, kept] = self.kept();
        let from = [middle(first, kept), middle(0, self.size[1])];
        let to = self.upright_size().map(|length| middle(0, length));
        let [x, y] = self.turn.upright([col - from[0], row - from[1]]);
        [x + to[0], y + to[1]]
    }

    /// Turns the image upright. Pixels beyond it become `beyond`, or repeat its border.
    fn turn_upright<T: Copy>(&self, pixels: &mut [T; PIXELS], beyond: Option<T>) {
        let ([columns, rows], [first, kept]) = (self.upright_size(), self.kept());
        // The kept pixels lie in this square before and after the turn. Afterwards the image is at one end of it.
        let side = kept.max(self.size[1]);
        let [left, top] = match self.turn {
            Turn::Upright => return,
            Turn::Quarter => {
                turn_square(pixels, first, side, 3);
                [first, side - rows]
            }
            Turn::Half => {
                pixels[..rows * WIDTH].reverse();
                [WIDTH - columns, 0]
            }
            Turn::ThreeQuarters => {
                turn_square(pixels, first, side, 1);
                [first + side - columns, 0]
            }
        };
        for row in 0..rows {
            let from = (top + row) * WIDTH + left;
            pixels.copy_within(from..from + columns, row * WIDTH);
        }
        let (image, below) = pixels.split_at_mut(rows * WIDTH);
        for row in image.chunks_exact_mut(WIDTH) {
            let last = row[columns - 1];
            row[columns..].fill(beyond.unwrap_or(last));
        }
        for row in below.chunks_exact_mut(WIDTH) {
            match beyond {
                Some(value) => row.fill(value),
                None => row.copy_from_slice(&image[(rows - 1) * WIDTH..]),
            }
        }
    }
}

/// Turns the square whose upper left corner is in this column of row 0, clockwise by so many quarters.
fn turn_square<T: Copy>(pixels: &mut [T; PIXELS], column: usize, side: usize, quarters: usize) {
    // Every pixel of a quarter of the square, and the three that change places with it.
    for row in 0..side / 2 {
        for col in 0..side.div_ceil(2) {
            let (right, bottom) = (side - 1 - col, side - 1 - row);
            let corners = [[col, row], [bottom, col], [right, bottom], [row, right]];
            let four = corners.map(|[col, row]| row * WIDTH + column + col);
            let values = four.map(|pixel| pixels[pixel]);
            for (k, value) in values.into_iter().enumerate() {
                pixels[four[(k + quarters) % 4]] = value;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TURNS: [Turn; 3] = [Turn::Quarter, Turn::Half, Turn::ThreeQuarters];

    /// Pixel of the sensor's image that an upright pixel shows, written out.
    fn source(turn: Turn, [columns, rows]: [usize; 2], [col, row]: [usize; 2]) -> [usize; 2] {
        let first = columns.saturating_sub(HEIGHT) / 2;
        let kept = columns.min(HEIGHT);
        match turn {
            Turn::Upright => [col, row],
            Turn::Quarter => [first + kept - 1 - row, col],
            Turn::Half => [columns - 1 - col, rows - 1 - row],
            Turn::ThreeQuarters => [first + row, rows - 1 - col],
        }
    }

    /// A frame of this size with a different value in every pixel.
    fn numbered([columns, rows]: [usize; 2]) -> Frame {
        let mut frame = Frame::default();
        for row in 0..HEIGHT {
            for col in 0..WIDTH {
                let (x, y) = (col.min(columns - 1), row.min(rows - 1));
                frame.luma[row * WIDTH + col] = (x * 7 + y * 31) as u8;
                if col < columns && row < rows {
                    frame.depth[row * WIDTH + col] = ((x * 641 + y * 3) % 2000) as u16;
                }
            }
        }
        frame
    }

    #[test]
    fn images_are_turned_in_place_as_pixel_by_pixel() {
        for size in [
            [640, 480],
            [632, 480],
            [512, 424],
            [321, 241],
            [240, 320],
            [501, 37],
            [7, 480],
        ] {
            for turn in TURNS {
                let (before, mut frame) = (numbered(size), numbered(size));
                turn.turn_upright(&mut frame, size, size);
                let image = TurnedImage { turn, size };
                let [columns, rows] = image.upright_size();
                for k in 0..PIXELS {
                    let [col, row] = [k % WIDTH, k / WIDTH];
                    let is_inside = col < columns && row < rows;
                    let [x, y] = source(turn, size, [col.min(columns - 1), row.min(rows - 1)]);
                    let (depth, luma) = (before.depth[y * WIDTH + x], before.luma[y * WIDTH + x]);
                    let depth = if is_inside { depth } else { NO_DEPTH };
                    assert_eq!(
                        (frame.depth[k], frame.luma[k]),
                        (depth, luma),
                        "{size:?} {turn:?} column {col} row {row}"
                    );
                    if is_inside {
                        let seen = image.upright_pixel([x as f32, y as f32]);
                        assert_eq!(seen, [col as f32, row as f32], "{size:?} {turn:?}");
                    }
                }
            }
        }
    }

    #[test]
    fn up_in_the_world_is_up_in_the_image() {
        // 90° clockwise from the front: the world's up is at the right of the sensor's image.
        let image = |turn| TurnedImage {
            turn,
            size: [640, 480],
        };
        assert_eq!(image(Turn::Quarter).upright_pixel([559.0, 0.0]), [0.0, 0.0]);
        assert_eq!(
            image(Turn::ThreeQuarters).upright_pixel([80.0, 479.0]),
            [0.0, 0.0]
        );
        assert_eq!(image(Turn::Half).upright_pixel([639.0, 479.0]), [0.0, 0.0]);
        let up = Point::new(0.0, -1.0, 2.0);
        for (turn, native) in [
            (Turn::Upright, [0.0, -1.0, 2.0]),
            (Turn::Quarter, [1.0, 0.0, 2.0]),
            (Turn::Half, [0.0, 1.0, 2.0]),
            (Turn::ThreeQuarters, [-1.0, 0.0, 2.0]),
        ] {
            let p = turn.native_from_upright(&up);
            assert_eq!([p.x, p.y, p.z], native, "{turn:?}");
            // What the accelerometer says then: x to the left, y up.
            let g = 819.0;
            let acceleration = [-g * p.x, -g * p.y, 0.0].map(|count| count as i16);
            assert_eq!(Turn::from_acceleration(acceleration), turn);
        }
    }

    #[test]
    fn a_sensor_that_lies_flat_or_says_nothing_is_upright() {
        for flat in [[0, 0, 819], [300, -200, -760], [0; 3], [i16::MIN; 3]] {
            assert_eq!(Turn::from_acceleration(flat), Turn::Upright);
        }
        // Tilted down by 30°, and a little askew.
        assert_eq!(Turn::from_acceleration([-700, 90, 410]), Turn::Quarter);
        assert_eq!(Turn::from_acceleration([90, -700, 410]), Turn::Half);
    }
}
