//! The pixels of a head as points.
//!
//! Pixels are averaged in square blocks, just big enough that the cloud holds them: the mean of b² readings has a b-th of
//! a reading's noise and of its quantisation, so thinning loses little. Only pixels near their cell's depth count, so
//! that no block mixes nose and cheek, and blocks less than half full are dropped: at the outline readings are ragged.
//!
//! Sensor frame, metres. Memory: 12 kB of the stack. Cost: one pass over the head's pixels, two if the first overflows.

use super::HeadCloud;
use super::cut::Head;
use super::regions::{CELL_PX, COLUMNS, Regions};
use crate::capacity::{HEAD_POINTS, PIXELS, WIDTH};
use crate::geometry::Point;
#[cfg(not(feature = "std"))]
use crate::prelude::*;
use crate::sensor::NO_DEPTH;
use crate::sensor::camera::Camera;

/// Distance of a pixel from its cell, as a share of the distance, up to which it is the same surface.
const SAME_SURFACE: f32 = 0.03;
/// A cloud of fewer pixels than this is no head: a head at 2 m has 2,500.
const MIN_PIXELS: u32 = 400;

/// Distance of a fractional raw value.
fn metres(camera: &Camera, raw: f32) -> f32 {
    let below = raw.floor();
    let (a, b) = (
        camera.depth_m(below as u16),
        camera.depth_m(below as u16 + 1),
    );
    a + (b - a) * (raw - below)
}

/// Fills `cloud` with the head's points; `false` if there are too few.
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
    while !blocks(depth, camera, regions, head, block, cloud) {
        block += 1;
    }
    cloud.rect = head.rect();
    let sum = cloud
        .points
        .iter()
        .fold(nalgebra::Vector3::<f64>::zeros(), |s, p| {
            s + p.coords.cast::<f64>()
        });
    cloud.centre = Point::from((sum / cloud.points.len().max(1) as f64).cast::<f32>());
    cloud.pixels >= MIN_PIXELS
}

/// Sums over the readings of a block.
#[derive(Clone, Copy, Default)]
struct Block {
    raws: u32,
    cols: u32,
    rows: u32,
    count: u32,
}

/// One pass with blocks of a size; `false` if the cloud overflows.
fn blocks(
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
                    if raw < NO_DEPTH && (camera.depth_m(raw) - near).abs() <= SAME_SURFACE * near {
                        let sum = &mut sums[usize::from(block_of[col])];
                        sum.raws += u32::from(raw);
                        sum.cols += col as u32;
                        sum.rows += row as u32;
                        sum.count += 1;
                    }
                }
            }
        }
        for sum in &*sums {
            cloud.pixels += sum.count;
            if sum.count as usize * 2 < block * block {
                continue;
            }
            let mean = |of: u32| of as f32 / sum.count as f32;
            let point = camera.point(
                mean(sum.cols),
                mean(sum.rows),
                metres(camera, mean(sum.raws)),
            );
            if cloud.points.push(point).is_err() {
                return false;
            }
        }
    }
    true
}
