//! Cuts heads from regions by size and shape.
//!
//! From the crown downwards a head widens to 0.13 – 0.26 m (hair included), is rounded (its sides are behind its middle), and
//! ends where the outline narrows to the neck, widens to the shoulders, or reaches the height of a head. A hand and forearm are
//! narrower and flat; a wall or a chair's back is flat and wide. Every local top of a region is tried, so a raised hand does not
//! hide the head beside it. The limits are wider for a head found in the last frame, because a hand may cover half of it.
//!
//! Cells and metres. Memory: a profile of at most [`MAX_PROFILE`] rows. Cost: linear in the cells of the tops' columns.
//! Limitation: the cut is level with the image, so a head lying on its side is cut badly.

use super::regions::{CELL_PX, COLUMNS, PixelRect, ROWS, Regions};
use crate::base::capacity::HEADS;
use crate::base::geometry::Point;

/// Most rows of cells of a head: 0.3 m at 0.4 m.
const MAX_PROFILE: usize = 110;
/// Largest height of a head with hair, crown to chin, metres.
const MAX_HEIGHT_M: f32 = 0.27;
/// Least distance from the crown to the neck, metres.
const NECK_FROM_M: f32 = 0.17;
/// Least distance from the crown to the shoulders, metres: less than to the neck, because the chin may be on the chest.
const SHOULDERS_FROM_M: f32 = 0.12;
/// Largest width of a neck, as a share of the head's.
const NECK_SHARE: f32 = 0.80;
/// Least ratio of the width below a neck to the neck's.
const NECK_FLARE: f32 = 1.1;
/// Least width of shoulders, as a share of the head's.
const SHOULDER_SHARE: f32 = 1.35;
/// Depth of a head behind its nearest tenth, metres.
const HEAD_DEPTH_M: f32 = 0.19;
/// Points this far before or behind a head belong to another person, metres; its own shoulders are closer.
const BEHIND_M: f32 = 0.08;
/// Largest gap without depth within a row of the outline, cells.
const ROW_GAP: usize = 3;
/// Least share of the last rectangle covered by the same head.
const SAME_HEAD_SHARE: f32 = 0.4;

/// Size limits of a head, metres.
struct Limits {
    /// Least and largest width.
    width_m: (f32, f32),
    /// Least height.
    height_m: f32,
    /// Least distance of the sides behind the middle.
    relief_m: f32,
}

/// Limits of a head not seen in the last frame.
const NEW_HEAD: Limits = Limits {
    width_m: (0.115, 0.28),
    height_m: 0.13,
    relief_m: 0.018,
};
/// Limits of a head seen in the last frame.
const TRACKED_HEAD: Limits = Limits {
    width_m: (0.08, 0.30),
    height_m: 0.08,
    relief_m: 0.006,
};

/// A head in cells: its rows from `top`, each as first and one past the last column, its label and depth interval.
pub(crate) struct Head {
    pub(crate) top: usize,
    pub(crate) rows: heapless::Vec<(u16, u16), MAX_PROFILE>,
    pub(crate) label: u16,
    pub(crate) near_m: f32,
    pub(crate) far_m: f32,
}

impl Head {
    /// Bounding rectangle in pixels.
    pub(crate) fn rect(&self) -> PixelRect {
        let left = self.rows.iter().map(|r| r.0).min().unwrap_or(0);
        let right = self.rows.iter().map(|r| r.1).max().unwrap_or(0);
        PixelRect {
            x0: left * CELL_PX as u16,
            y0: (self.top * CELL_PX) as u16,
            x1: right * CELL_PX as u16,
            y1: ((self.top + self.rows.len()) * CELL_PX) as u16,
        }
    }
}

/// Share of `a` covered by `b`.
fn overlap_share(a: &PixelRect, b: &PixelRect) -> f32 {
    let width = f32::from(a.x1.min(b.x1)) - f32::from(a.x0.max(b.x0));
    let height = f32::from(a.y1.min(b.y1)) - f32::from(a.y0.max(b.y0));
    let area = f32::from(a.x1 - a.x0) * f32::from(a.y1 - a.y0);
    width.max(0.0) * height.max(0.0) / area.max(1.0)
}

/// Finds heads from the top of the image down, at most [`HEADS`]. `last`: the heads of the last frame.
pub(crate) fn heads(regions: &Regions, last: &[(PixelRect, Point)]) -> heapless::Vec<Head, HEADS> {
    let mut found = heapless::Vec::new();
    for row in 0..ROWS {
        let mut col = 0;
        while col < COLUMNS {
            let Some((begin, end)) =
                label_run(regions, row, col, regions.label[row * COLUMNS + col])
            else {
                col += 1;
                continue;
            };
            let label = regions.label[row * COLUMNS + begin];
            col = end;
            if found.is_full()
                || !is_top(regions, row, begin, end, label)
                || is_below_head(&found, regions, row, begin, end)
            {
                continue;
            }
            let Some(head) = follow_down(regions, row, (begin, end), label) else {
                continue;
            };
            let rect = head.rect();
            let known = last
                .iter()
                .any(|(last, _)| overlap_share(last, &rect) > SAME_HEAD_SHARE);
            let limits = if known { TRACKED_HEAD } else { NEW_HEAD };
            if fits(regions, &head, &limits) {
                // Cannot be full: checked above.
                let _ = found.push(head);
            }
        }
    }
    found
}

impl Regions {
    /// Whether a cell within a head's outline has its label and depth.
    pub(crate) fn belongs(&self, head: &Head, row: usize, col: usize) -> bool {
        let at = row * COLUMNS + col;
        self.label[at] == head.label && (head.near_m..=head.far_m).contains(&self.depth_m[at])
    }
}

/// First and one past the last column of the label's run from `col` (which must have it), gaps up to [`ROW_GAP`] bridged.
fn label_run(regions: &Regions, row: usize, col: usize, label: u16) -> Option<(usize, usize)> {
    if label == 0 {
        return None;
    }
    let (mut end, mut at) = (col + 1, col + 1);
    while at < COLUMNS && at <= end + ROW_GAP {
        if regions.label[row * COLUMNS + at] == label {
            end = at + 1;
        }
        at += 1;
    }
    Some((col, end))
}

/// Whether the two rows above have no cell of the label there.
fn is_top(regions: &Regions, row: usize, begin: usize, end: usize, label: u16) -> bool {
    (row.saturating_sub(2)..row).all(|above| {
        regions.label
            [above * COLUMNS + begin.saturating_sub(1)..above * COLUMNS + (end + 1).min(COLUMNS)]
            .iter()
            .all(|&l| l != label)
    })
}

/// Whether a top is in a head already found, or in its neck and chest; a person before or behind it has another depth.
fn is_below_head(found: &[Head], regions: &Regions, row: usize, begin: usize, end: usize) -> bool {
    let middle = ((begin + end) / 2 * CELL_PX) as u16;
    let y = (row * CELL_PX) as u16;
    let z = regions.depth_m[row * COLUMNS + begin];
    found.iter().any(|head| {
        let rect = head.rect();
        let half_width = (rect.x1 - rect.x0) / 2;
        let apart = z > head.far_m + BEHIND_M || z < head.near_m - BEHIND_M;
        !apart
            && (rect.x0.saturating_sub(half_width)..rect.x1 + half_width).contains(&middle)
            && y < rect.y1 + (rect.y1 - rect.y0)
    })
}

/// First and one past the last column of the label in a row where it touches the run above.
fn connected_run(
    regions: &Regions,
    row: usize,
    (left, right): (usize, usize),
    label: u16,
) -> Option<(usize, usize)> {
    let labels = &regions.label[row * COLUMNS..][..COLUMNS];
    let mut found: Option<(usize, usize)> = None;
    let mut col = left.saturating_sub(2);
    while col < (right + 2).min(COLUMNS) {
        if labels[col] == label {
            let before = labels[..col].iter().rev();
            let start = col - before.take_while(|&&other| other == label).count();
            let (_, stop) = label_run(regions, row, start, label)?;
            found = Some((found.map_or(start, |(first, _)| first), stop));
            col = stop;
        }
        col += 1;
    }
    found
}

/// Follows the outline down from a top and cuts at the neck, the shoulders or [`MAX_HEIGHT_M`].
fn follow_down(
    regions: &Regions,
    top: usize,
    (mut left, mut right): (usize, usize),
    label: u16,
) -> Option<Head> {
    let mut rows: heapless::Vec<(u16, u16), MAX_PROFILE> = heapless::Vec::new();
    let (mut height, mut widest, mut last_width) = (0.0f32, 0.0f32, 0.0f32);
    // Narrowest outline where a neck may be, and the rows down to it.
    let mut neck = (f32::INFINITY, 0);
    let mut last_z = 0.0;
    for row in top..ROWS {
        let Some((first, past)) = connected_run(regions, row, (left, right), label) else {
            // A row without depth is bridged once (hair, glasses), then the region has ended.
            let is_second = rows.last().is_none_or(|r| r.0 == r.1);
            if is_second || rows.push((left as u16, left as u16)).is_err() {
                break;
            }
            height += last_z * regions.cell_at_1m;
            continue;
        };
        let middle = (first + past) / 2;
        let z = (middle..past)
            .chain(first..middle)
            .map(|c| row * COLUMNS + c)
            .find(|&at| regions.label[at] == label)
            .map_or(last_z, |at| regions.depth_m[at]);
        last_z = z;
        let width = (past - first) as f32 * z * regions.cell_at_1m;
        if height >= MAX_HEIGHT_M || (height >= SHOULDERS_FROM_M && width > SHOULDER_SHARE * widest)
        {
            break;
        }
        if height >= NECK_FROM_M && width < neck.0 {
            neck = (width, rows.len() + 1);
        }
        last_width = width;
        widest = widest.max(width);
        if rows.push((first as u16, past as u16)).is_err() {
            break;
        }
        height += z * regions.cell_at_1m;
        (left, right) = (first, past);
    }
    // A chin narrows too; a neck widens again below.
    if neck.0 < NECK_SHARE * widest && last_width > NECK_FLARE * neck.0 {
        rows.truncate(neck.1);
    }
    let mut head = Head {
        top,
        rows,
        label,
        near_m: 0.0,
        far_m: f32::INFINITY,
    };
    let near = nearest_tenth(regions, &head)?;
    head.near_m = near - HEAD_DEPTH_M * 0.5;
    head.far_m = near + HEAD_DEPTH_M;
    Some(head)
}

/// First decile of the head's depths, metres: the face's front, robust to stray cells.
fn nearest_tenth(regions: &Regions, head: &Head) -> Option<f32> {
    // Centimetres from 0.3 m on, to 4.4 m.
    let mut bins = [0u32; 410];
    let mut total = 0u32;
    for (row, &(begin, end)) in (head.top..).zip(&head.rows) {
        for col in usize::from(begin)..usize::from(end) {
            let at = row * COLUMNS + col;
            if regions.label[at] == head.label {
                let bin = ((regions.depth_m[at] - 0.3) * 100.0).max(0.0) as usize;
                bins[bin.min(409)] += 1;
                total += 1;
            }
        }
    }
    let mut sum = 0;
    for (bin, count) in bins.iter().enumerate() {
        sum += count;
        if total > 0 && sum * 10 >= total {
            return Some(0.3 + bin as f32 * 0.01);
        }
    }
    None
}

/// Whether width, height and roundness are within the limits.
fn fits(regions: &Regions, head: &Head, limits: &Limits) -> bool {
    let mut widths: heapless::Vec<f32, MAX_PROFILE> = heapless::Vec::new();
    let mut reliefs: heapless::Vec<f32, MAX_PROFILE> = heapless::Vec::new();
    let mut height = 0.0;
    for (row, &(begin, end)) in (head.top..).zip(&head.rows) {
        let (begin, end) = (usize::from(begin), usize::from(end));
        let mut inside = (begin..end).filter(|&col| regions.belongs(head, row, col));
        let Some(first) = inside.next() else { continue };
        let last = inside.next_back().unwrap_or(first);
        let z = |col: usize| regions.depth_m[row * COLUMNS + col];
        let middle_third = (first + (last - first) / 3)..=(last - (last - first) / 3);
        let middle = middle_third
            .filter(|&col| regions.belongs(head, row, col))
            .map(z)
            .fold(f32::INFINITY, f32::min);
        height += z(first) * regions.cell_at_1m;
        let _ = widths.push((last + 1 - first) as f32 * z(first).min(middle) * regions.cell_at_1m);
        if middle.is_finite() && last - first >= 6 {
            let _ = reliefs.push((z(first) + z(last)) * 0.5 - middle);
        }
    }
    let width = quantile(&mut widths, 0.8);
    let relief = quantile(&mut reliefs, 0.5);
    (limits.width_m.0..=limits.width_m.1).contains(&width)
        && height >= limits.height_m
        && relief >= limits.relief_m
}

fn quantile(values: &mut [f32], share: f32) -> f32 {
    if values.is_empty() {
        return 0.0;
    }
    crate::base::sorting::sort(values);
    values[((values.len() - 1) as f32 * share) as usize]
}
