//! Point cloud of a head: of one cut from the image ([`gather`]), or of one at a predicted pose ([`gather_at_pose`]), where
//! connected hair, hands and collars do not matter.
//!
//! Pixels are averaged in square blocks just large enough for the cloud's capacity: the mean of b² readings has 1/b of their
//! noise and quantisation, so thinning loses little. Only pixels near their cell's depth count, so that no block mixes nose and
//! cheek; blocks less than half full are dropped, because readings are ragged at the outline.
//!
//! Sensor frame, metres. Memory: 12 kB of the stack. Cost: one pass over the head's pixels, two if the first overflows.

use super::cut::Head;
use super::regions::{CELL_PX, COLUMNS, HeadCloud, PixelRect, Regions};
use crate::base::capacity::{HEAD_POINTS, HEIGHT, PIXELS, WIDTH};
use crate::base::frames::SensorFromHead;
use crate::base::geometry::{Point, mean};
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;
use crate::camera::Camera;
use crate::frame::NO_DEPTH;

/// Largest depth difference on one surface, as a share of the distance.
const SAME_SURFACE: f32 = 0.03;
/// Smallest solid angle of a head, steradians: a sixth of a head at 2 m.
const MIN_SOLID_ANGLE_SR: f32 = 1.2065e-3;
/// Nearest distance of the sensor, metres.
const NEAREST_M: f32 = 0.3;

/// Distance of a fractional raw value, metres.
fn metres(camera: &Camera, raw: f32) -> f32 {
    let below = raw as u16;
    let (a, b) = (camera.depth_m(below), camera.depth_m(below + 1));
    a + (b - a) * (raw - f32::from(below))
}

/// Fills `cloud` (sensor frame, metres) with the points of a cut head; `false` if there are too few.
pub(crate) fn gather(
    depth: &[u16; PIXELS],
    camera: &Camera,
    regions: &Regions,
    head: &Head,
    cloud: &mut HeadCloud,
) -> bool {
    let cells = (head.top..)
        .zip(&head.rows)
        .map(|(row, &(begin, end))| {
            (usize::from(begin)..usize::from(end))
                .filter(|&col| regions.belongs(head, row, col))
                .count()
        })
        .sum::<usize>();
    let mut block = 1;
    while cells * CELL_PX * CELL_PX > HEAD_POINTS * block * block {
        block += 1;
    }
    while !gather_blocks(depth, camera, regions, head, block, cloud) {
        block += 1;
    }
    set_extent(cloud, head.rect(), camera)
}

/// Sets rectangle and centre of the cloud; `false` if it has too few pixels.
fn set_extent(cloud: &mut HeadCloud, rect: PixelRect, camera: &Camera) -> bool {
    cloud.rect = rect;
    cloud.whole = rect.is_within(camera.depth_size());
    cloud.centre = mean(cloud.points.iter().copied());
    cloud.pixels >= camera.pixels_in_solid_angle(MIN_SOLID_ANGLE_SR)
}

/// Least x, y, z of the visible part of a head with hair, head frame, metres at the standard size.
const HEAD_LOW_M: [f32; 3] = [-0.100, -0.140, -0.050];
/// Largest x, y, z of the visible part of a head with hair, head frame, metres at the standard size.
const HEAD_HIGH_M: [f32; 3] = [0.100, 0.120, 0.110];
/// Height y of the lower end of the head at the chin, head frame, metres: neck and collar are below.
const CHIN_Y_M: f32 = 0.115;
/// Rise of that lower end per metre behind the chin, along the front of the neck.
const NECK_SLOPE: f32 = 0.75;
/// Approximate share of a head's bounding rectangle covered by its pixels.
const FILLED: f32 = 0.75;

fn in_head(p: &Point) -> bool {
    (0..3).all(|k| (HEAD_LOW_M[k]..HEAD_HIGH_M[k]).contains(&p[k]))
        && p.y < CHIN_Y_M - NECK_SLOPE * (p.z + 0.012).max(0.0)
}

/// Fills `cloud` (sensor frame, metres) with the points inside the head's box at `sensor_from_head`, `scale` times the standard
/// size; `false` if there are too few.
pub fn gather_at_pose(
    depth: &[u16; PIXELS],
    camera: &Camera,
    sensor_from_head: &SensorFromHead,
    scale: f32,
    cloud: &mut HeadCloud,
) -> bool {
    cloud.points.clear();
    cloud.pixels = 0;
    let Some([low, high]) = extent(camera, sensor_from_head, scale) else {
        return false;
    };
    let span = |k: usize, most: usize| {
        let from = low[k].clamp(0.0, most as f32) as usize;
        let to = (high[k] + 1.0).clamp(0.0, most as f32) as usize;
        from..to.max(from)
    };
    let (columns, rows) = (span(0, WIDTH), span(1, HEIGHT));
    // Raw values grow with the distance.
    let near = camera.raw_from_m(low[2]).max(0.0) as u16;
    let end = (camera.raw_from_m(high[2]) as u16).min(NO_DEPTH - 1) + 1;
    let middle = (sensor_from_head.translation.vector.z).max(NEAREST_M);
    let same = camera.raw_from_m(middle * (1.0 + SAME_SURFACE)) - camera.raw_from_m(middle);
    let area = (columns.len() * rows.len()) as f32 * FILLED;
    let block = (area / HEAD_POINTS as f32).sqrt().ceil().max(1.0) as usize;
    let head_from_sensor = sensor_from_head.inverse();
    let mut rect: Option<PixelRect> = None;
    let (range, same) = (near..end, same as u16);
    for top in rows.step_by(block) {
        for across in 0..columns.len().div_ceil(block) {
            let left = columns.start + across * block;
            let size = [block.min(WIDTH - left), block.min(HEIGHT - top)];
            // Constant sizes, so that the compiler unrolls the usual blocks.
            let sums = |size| block_sums(depth, (left, top), size, &range, same);
            let sum = match size {
                [1, 1] => sums([1, 1]),
                [2, 2] => sums([2, 2]),
                [3, 3] => sums([3, 3]),
                _ => sums(size),
            };
            let Some(point) = sum.point(camera, block) else {
                continue;
            };
            if !in_head(&Point::from((head_from_sensor * point).coords / scale)) {
                continue;
            }
            cloud.pixels += sum.count;
            let (x0, y0) = (left as u16, top as u16);
            let (x1, y1) = (x0 + block as u16, y0 + block as u16);
            rect = Some(rect.map_or(PixelRect { x0, y0, x1, y1 }, |r| PixelRect {
                x0: r.x0.min(x0),
                y0: r.y0.min(y0),
                x1: r.x1.max(x1).min(WIDTH as u16),
                y1: r.y1.max(y1).min(HEIGHT as u16),
            }));
            if cloud.points.push(point).is_err() {
                break;
            }
        }
    }
    set_extent(cloud, rect.unwrap_or_default(), camera)
}

/// Least and largest column, row and distance (metres) of the corners of a head's box; `None` if one is too near.
fn extent(camera: &Camera, sensor_from_head: &SensorFromHead, scale: f32) -> Option<[[f32; 3]; 2]> {
    let (mut low, mut high) = ([f32::MAX; 3], [f32::MIN; 3]);
    for corner in 0..8 {
        let corner_at = |k: usize| [HEAD_LOW_M, HEAD_HIGH_M][corner >> k & 1][k] * scale;
        let seen = sensor_from_head * Point::new(corner_at(0), corner_at(1), corner_at(2));
        if seen.z < NEAREST_M {
            return None;
        }
        let [col, row] = camera.depth_pixel(&seen);
        for (k, value) in [col, row, seen.z].into_iter().enumerate() {
            low[k] = low[k].min(value);
            high[k] = high[k].max(value);
        }
    }
    Some([low, high])
}

/// Sums over the readings of a block of this width and height that lie in `range` and within `same` raw steps of its middle one.
#[inline(always)]
fn block_sums(
    depth: &[u16; PIXELS],
    (left, top): (usize, usize),
    [width, height]: [usize; 2],
    range: &core::ops::Range<u16>,
    same: u16,
) -> Block {
    let pixels = &depth[top * WIDTH + left..][..(height - 1) * WIDTH + width];
    let line = |row: usize| &pixels[row * WIDTH..][..width];
    let mut seed = line(height / 2)[width / 2];
    if !range.contains(&seed) {
        seed = NO_DEPTH;
        for row in 0..height {
            for &raw in line(row) {
                seed = seed.min(if range.contains(&raw) { raw } else { NO_DEPTH });
            }
        }
        if seed == NO_DEPTH {
            return Block::default();
        }
    }
    let least = seed.saturating_sub(same).max(range.start);
    let most = seed.saturating_add(same).min(range.end - 1);
    let mut sum = Block::default();
    for row in 0..height {
        for (col, &raw) in line(row).iter().enumerate() {
            // Not a branch, which would be mispredicted at outlines.
            let counts = u32::from(least <= raw && raw <= most);
            sum.raws += counts * u32::from(raw);
            sum.cols += counts * col as u32;
            sum.rows += counts * row as u32;
            sum.count += counts;
        }
    }
    sum.cols += sum.count * left as u32;
    sum.rows += sum.count * top as u32;
    sum
}

/// Sums over the readings of a block.
#[derive(Clone, Copy, Default)]
struct Block {
    raws: u32,
    cols: u32,
    rows: u32,
    count: u32,
}

impl Block {
    fn add(&mut self, raw: u16, col: usize, row: usize) {
        self.raws += u32::from(raw);
        self.cols += col as u32;
        self.rows += row as u32;
        self.count += 1;
    }

    /// Mean point of a block of `size`² pixels, if at least half of them count.
    fn point(&self, camera: &Camera, size: usize) -> Option<Point> {
        let mean = |sum: u32| sum as f32 / self.count as f32;
        let half = self.count as usize * 2 >= size * size;
        half.then(|| {
            let metres = metres(camera, mean(self.raws));
            camera.point(mean(self.cols), mean(self.rows), metres)
        })
    }
}

/// One pass with blocks of `block`² pixels; `false` if the cloud overflows.
fn gather_blocks(
    depth: &[u16; PIXELS],
    camera: &Camera,
    regions: &Regions,
    head: &Head,
    block: usize,
    cloud: &mut HeadCloud,
) -> bool {
    cloud.points.clear();
    cloud.pixels = 0;
    let rect = head.rect();
    let (x0, x1) = (usize::from(rect.x0), usize::from(rect.x1));
    let (y0, y1) = (usize::from(rect.y0), usize::from(rect.y1));
    // The block of each column, and the sums of a row of blocks.
    let mut block_of = [0u16; WIDTH];
    for (k, columns) in block_of[x0..x1].chunks_mut(block).enumerate() {
        columns.fill(k as u16);
    }
    let mut sums = [Block::default(); WIDTH];
    let sums = &mut sums[..(x1 - x0).div_ceil(block)];
    for top in (y0..y1).step_by(block) {
        sums.fill(Block::default());
        for row in top..(top + block).min(y1) {
            let cell_row = row / CELL_PX;
            let (begin, end) = head.rows[cell_row - head.top];
            let (begin, end) = (usize::from(begin), usize::from(end));
            let pixels = depth[row * WIDTH..][begin * CELL_PX..end * CELL_PX].as_chunks();
            for (cell, pixels) in (begin..end).zip::<&[[u16; CELL_PX]]>(pixels.0) {
                if !regions.belongs(head, cell_row, cell) {
                    continue;
                }
                let near = regions.depth_m[cell_row * COLUMNS + cell];
                for (col, &raw) in (cell * CELL_PX..).zip(pixels) {
                    if (camera.depth_m(raw) - near).abs() <= SAME_SURFACE * near {
                        sums[usize::from(block_of[col])].add(raw, col, row);
                    }
                }
            }
        }
        for sum in &*sums {
            cloud.pixels += sum.count;
            let Some(point) = sum.point(camera, block) else {
                continue;
            };
            if cloud.points.push(point).is_err() {
                return false;
            }
        }
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_block_holds_the_readings_that_are_like_its_middle_one() {
        let mut depth: Box<[u16; PIXELS]> = vec![600; PIXELS].try_into().expect("PIXELS long");
        // The right half of a block, and its middle with it, is nearer.
        for row in 40..44 {
            depth[row * WIDTH + 102..row * WIDTH + 104].fill(500);
        }
        let sum = block_sums(&depth, (100, 40), [4, 4], &(400..700), 20);
        assert_eq!((sum.count, sum.raws), (8, 8 * 500));
        let (cols, rows) = (4 * (102 + 103), 2 * (40 + 41 + 42 + 43));
        assert_eq!((sum.cols, sum.rows), (cols, rows));
        // In place of a middle out of range the nearest one within counts.
        depth[42 * WIDTH + 102] = 300;
        let sum = block_sums(&depth, (100, 40), [4, 4], &(400..700), 20);
        assert_eq!((sum.count, sum.raws), (7, 7 * 500));
    }
}
