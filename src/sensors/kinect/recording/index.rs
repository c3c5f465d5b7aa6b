//! The index of a recording: its pictures, their times, and the pairing of depth and colour.
//!
//! Ticks are unwrapped along the index (they wrap every 71.6 s). A depth picture is paired with the colour picture nearest in ticks,
//! at most half a frame period away, since the two cameras may have a constant offset. A depth picture without one is a frame
//! without colour.
//!
//! Recordings that were copied or merged may be out of order. Wall times, otherwise unused, then help:
//! * if ticks step back along the index, it is sorted by wall time if that gives fewer steps back, or by ticks if it is shuffled
//!   even then;
//! * a single time stamp that matches neither the pictures before nor those after is a fault; its picture is skipped;
//! * colour is assigned to a wrap of the counter and a run of the sensor by the depth picture nearest in wall time. Without usable
//!   wall times it is assigned by the order of the index, which lists one stream after the other if sorted by name.
//!
//! Ticks that step back by more than a second mean a restart of the sensor; time then continues one frame period later. A gap of
//! more than half the counter's range (35.8 s) is indistinguishable from that. A depth picture that is not later than the previous
//! one is skipped.

use std::collections::BinaryHeap;

use crate::kinect::picture_clock::FRAME_TICKS;
use crate::picture_file::nearest;

/// A larger step back (one second, in ticks) is a restart, a smaller one pictures out of order.
const RESTART_TICKS: i64 = 60_000_000;
/// Longest gap between the neighbours of a faulty stamp (10 s, in ticks).
const NEIGHBOURS_TICKS: i64 = 10 * RESTART_TICKS;
/// An index with more than one step back in this many pictures is shuffled.
const SHUFFLED: usize = 20;

/// A file in the index.
#[derive(Clone, Copy, Debug)]
pub(super) struct Entry {
    start: usize,
    end: usize,
    /// Number among the pictures of its stream in the index, from 0.
    pub(super) number: usize,
    /// The counter in the name; `None` if the name is malformed.
    pub(super) ticks: Option<u32>,
    /// Wall time in the name, µs.
    wall_us: Option<i64>,
    /// Whether the counter matches neither the pictures before nor those after.
    pub(super) stray: bool,
    /// Unwrapped ticks since the first depth picture; `None` if the name is malformed, the stamp is stray, or the picture is not later
    /// than the previous one.
    pub(super) time: Option<i64>,
    /// Index in [`Index::colour`] of a depth picture's colour picture.
    pub(super) colour: Option<usize>,
}

/// Stable sort. Uses a heap, whose code is a tenth of the standard sort's.
fn sort(list: &mut [Entry], key: fn(&Entry) -> Option<i64>) {
    let before = list.to_vec();
    let keys = before.iter().enumerate();
    let keys = keys.map(|(at, entry)| (key(entry), at));
    for (entry, (_, at)) in list.iter_mut().zip(sorted(keys)) {
        *entry = before[at];
    }
}

fn sorted(keys: impl Iterator<Item = (Option<i64>, usize)>) -> Vec<(Option<i64>, usize)> {
    keys.collect::<BinaryHeap<_>>().into_sorted_vec()
}

/// File names of the pictures in the text of an index.
pub(super) fn names(text: &str) -> impl Iterator<Item = &str> {
    let lines = text.lines().map(str::trim);
    lines.filter(|line| line.starts_with("d-") || line.starts_with("r-"))
}

/// File name of the first measurement of the accelerometer.
pub(super) fn first_acceleration(text: &str) -> Option<&str> {
    let mut lines = text.lines().map(str::trim);
    lines.find(|line| line.starts_with("a-") && !line.contains(['/', '\\']))
}

/// All pictures of a recording.
pub(super) struct Index {
    text: String,
    /// All depth pictures in playing order, including malformed names.
    pub(super) depth: Vec<Entry>,
    /// Colour pictures with a time, sorted by it.
    pub(super) colour: Vec<Entry>,
}

impl Index {
    pub(super) fn parse(text: &str) -> Self {
        let mut index = Self {
            text: text.to_owned(),
            depth: Vec::new(),
            colour: Vec::new(),
        };
        for line in names(text) {
            let (list, ending) = if line.starts_with('d') {
                (&mut index.depth, ".pgm")
            } else {
                (&mut index.colour, ".ppm")
            };
            let start = line.as_ptr() as usize - text.as_ptr() as usize;
            let (wall, ticks) = parse_stamps(line, ending).unzip();
            list.push(Entry {
                start,
                end: start + line.len(),
                number: list.len(),
                ticks,
                wall_us: wall.flatten(),
                stray: false,
                time: None,
                colour: None,
            });
        }
        let Self { depth, colour, .. } = &mut index;
        for list in [&mut *depth, &mut *colour] {
            sort_by_time(list);
            mark_strays(list);
        }
        let starts = unwrap_ticks(depth, &[]);
        if !time_by_wall_clock(colour, depth) {
            unwrap_ticks(colour, &starts);
        }
        colour.retain(|entry| entry.time.is_some());
        sort(colour, |entry| entry.time);
        let mut latest = None;
        for entry in depth.iter_mut() {
            let Some(time) = entry.time else { continue };
            if latest.is_some_and(|latest| time <= latest) {
                entry.time = None;
            } else {
                latest = Some(time);
            }
        }
        let reach = period(depth) / 2;
        let time_of = |entry: &Entry| entry.time.unwrap_or(i64::MAX);
        for entry in depth.iter_mut() {
            let Some(time) = entry.time else { continue };
            let near = nearest(colour, time, time_of);
            entry.colour = near.filter(|&near| (time_of(&colour[near]) - time).abs() <= reach);
        }
        index
    }

    /// File name of an entry.
    pub(super) fn name(&self, entry: &Entry) -> &str {
        &self.text[entry.start..entry.end]
    }
}

/// Wall time (µs) and counter in a name such as `d-1700000000.033333-2000000.pgm`; `None` if it is malformed or has a path.
fn parse_stamps(name: &str, ending: &str) -> Option<(Option<i64>, u32)> {
    let (front, ticks) = name.strip_suffix(ending)?.rsplit_once('-')?;
    let ticks = ticks.parse().ok().filter(|_| !name.contains(['/', '\\']))?;
    let wall = front.get(2..).and_then(|wall| wall.parse().ok());
    let wall = wall.filter(|wall: &f64| wall.is_finite());
    Some((wall.map(|wall| (wall * 1e6) as i64), ticks))
}

/// Signed difference of two states of the wrapping counter.
fn tick_difference(from: u32, to: u32) -> i64 {
    i64::from(to.wrapping_sub(from).cast_signed())
}

/// Number of steps back of the counter along a list.
fn steps_back(list: &[Entry]) -> usize {
    let known = || list.iter().filter_map(|entry| entry.ticks);
    let pairs = known().zip(known().skip(1));
    pairs
        .filter(|&(one, next)| tick_difference(one, next) < 0)
        .count()
}

/// Sorts a list by the time of its pictures, if it is out of order.
fn sort_by_time(list: &mut [Entry]) {
    let mut back = steps_back(list);
    let mut known = list.iter().filter(|entry| entry.ticks.is_some());
    if back > 0 && known.all(|entry| entry.wall_us.is_some()) {
        let mut by_wall = list.to_vec();
        sort(&mut by_wall, |entry| entry.wall_us);
        let less = steps_back(&by_wall);
        if less < back {
            list.copy_from_slice(&by_wall);
            back = less;
        }
    }
    if back > 1 && back * SHUFFLED > list.len() {
        // The counter is cyclic: the widest gap is before the first picture.
        sort(list, |entry| entry.ticks.map(i64::from));
        let known = list.iter().enumerate();
        let known = known.filter_map(|(at, entry)| Some((at, entry.ticks?)));
        let ticks: Vec<(usize, u32)> = known.collect();
        let before = ticks.iter().cycle().skip(ticks.len().saturating_sub(1));
        let gaps = ticks.iter().zip(before);
        let first = gaps.max_by_key(|((_, one), (_, before))| one.wrapping_sub(*before));
        list.rotate_left(first.map_or(0, |((at, _), _)| *at));
    }
}

/// Marks single faulty time stamps.
fn mark_strays(list: &mut [Entry]) {
    let mut last = None;
    for at in 0..list.len() {
        let Some(ticks) = list[at].ticks else {
            continue;
        };
        let mut next = list[at + 1..].iter().filter_map(|entry| entry.ticks);
        if let (Some(one), Some(two)) = (next.next(), next.next()) {
            list[at].stray = match last {
                Some(last) => {
                    // The next two continue from the last one, and this one is not in between.
                    let (here, one, two) = (
                        tick_difference(last, ticks),
                        tick_difference(last, one),
                        tick_difference(last, two),
                    );
                    let goes_on = 0 < one && one < two && two <= NEIGHBOURS_TICKS;
                    goes_on && (here > two || here < -RESTART_TICKS)
                }
                None => {
                    tick_difference(ticks, one) < 0
                        && (1..=RESTART_TICKS).contains(&tick_difference(one, two))
                }
            };
        }
        if !list[at].stray {
            last = Some(ticks);
        }
    }
}

/// Times colour pictures relative to the depth pictures nearest in wall time, by the difference of the counters; `false` if wall
/// times are missing or constant.
fn time_by_wall_clock(colour: &mut [Entry], depth: &[Entry]) -> bool {
    let mut all = colour.iter().chain(depth);
    if all.any(|entry| entry.ticks.is_some() && entry.wall_us.is_none()) {
        return false;
    }
    let timed = depth.iter().filter(|entry| entry.time.is_some());
    let mut anchors: Vec<Entry> = timed.copied().collect();
    sort(&mut anchors, |entry| entry.wall_us);
    let (Some(first), Some(last)) = (anchors.first(), anchors.last()) else {
        return false;
    };
    let times = || anchors.iter().filter_map(|anchor| anchor.time);
    let span = times().max().unwrap_or(0) - times().min().unwrap_or(0);
    let wall = |entry: &Entry| entry.wall_us.unwrap_or(0);
    // Wall times must span at least a quarter of the ticks' time (60 ticks per µs).
    if wall(last).saturating_sub(wall(first)) < span / 240 {
        return false;
    }
    for entry in colour.iter_mut().filter(|entry| !entry.stray) {
        let near = nearest(&anchors, wall(entry), wall).map(|near| anchors[near]);
        entry.time =
            near.and_then(|near| Some(near.time? + tick_difference(near.ticks?, entry.ticks?)));
    }
    true
}

/// Median time between depth pictures, ticks: a frame period, or up to two at lower rates.
fn period(depth: &[Entry]) -> i64 {
    let times = || depth.iter().filter_map(|entry| entry.time);
    let steps = times().zip(times().skip(1));
    let steps = sorted(steps.map(|(before, time)| (Some(time - before), 0)));
    let usual = steps.get(steps.len() / 2).and_then(|step| step.0);
    let usual = usual.unwrap_or(FRAME_TICKS);
    // The cameras' rate is not exactly 30 Hz.
    if usual * 4 > FRAME_TICKS * 5 {
        usual.min(2 * FRAME_TICKS)
    } else {
        FRAME_TICKS
    }
}

/// Unwraps the counter of one stream. Returns the start of each run of the sensor: counter and unwrapped ticks. Depth starts at 0;
/// colour takes the starts of depth as `leader`, so that both streams have the same time after a restart.
fn unwrap_ticks(list: &mut [Entry], leader: &[(u32, i64)]) -> Vec<(u32, i64)> {
    let (mut last, mut total, mut starts) = (None, 0, Vec::new());
    for entry in list.iter_mut().filter(|entry| !entry.stray) {
        let Some(ticks) = entry.ticks else { continue };
        match last.map(|last| tick_difference(last, ticks)) {
            Some(step) if step >= -RESTART_TICKS => total += step,
            other => {
                // A new run: the first one, or one after a step back.
                let gap = if other.is_some() { FRAME_TICKS } else { 0 };
                let start = leader.get(starts.len());
                total = start.map_or(total + gap, |&(first, at)| {
                    at + tick_difference(first, ticks)
                });
                starts.push((ticks, total));
            }
        }
        last = Some(ticks);
        entry.time = Some(total);
    }
    starts
}

#[cfg(test)]
mod tests {
    use super::*;

    fn times(index: &Index) -> Vec<Option<i64>> {
        index.depth.iter().map(|depth| depth.time).collect()
    }

    #[test]
    fn the_counter_wraps_without_a_step_in_time() {
        let text =
            "d-1.0-4294000000.pgm\nr-1.0-4294000100.ppm\nd-1.03-1032704.pgm\nr-1.03-1032804.ppm\n";
        let index = Index::parse(text);
        assert_eq!(times(&index), [Some(0), Some(2_000_000)]);
        assert_eq!(index.depth[1].colour, Some(1));
        assert_eq!(index.name(&index.depth[1]), "d-1.03-1032704.pgm");
    }

    #[test]
    fn colour_is_paired_by_nearest_ticks_within_half_a_period() {
        // A constant offset of 0.9 M ticks, one colour picture missing, and colour listed late.
        let text = "d-0-10000000.pgm\nd-0-12000000.pgm\nr-0-10900000.ppm\nd-0-14000000.pgm\nr-0-14900000.ppm\n";
        let index = Index::parse(text);
        let partner: Vec<_> = index.depth.iter().map(|depth| depth.colour).collect();
        // The second is 1.1 M ticks from the first colour picture: too far.
        assert_eq!(partner, [Some(0), None, Some(1)]);
    }

    #[test]
    fn pictures_of_the_same_time_are_in_order() {
        let back = |text| steps_back(&Index::parse(text).depth);
        assert_eq!(back("d-0-100.pgm\nd-0-100.pgm\nd-0-101.pgm\n"), 0);
    }

    #[test]
    fn the_order_of_the_index_does_not_matter_to_the_pairs() {
        let seconds = |i: u32| 4_294_000_000u32.wrapping_add(i.wrapping_mul(60_000_000));
        let (mut mixed, mut sorted, mut colour) = (String::new(), String::new(), String::new());
        for i in 0..200 {
            // After the 150th the sensor starts again.
            let ticks = if i < 150 {
                seconds(i)
            } else {
                1_000_000 + (i - 150) * 60_000_000
            };
            let (d, r) = (
                format!("d-{i:03}-{ticks}.pgm\n"),
                format!("r-{i:03}-{}.ppm\n", ticks.wrapping_add(700_000)),
            );
            mixed += &format!("{r}{d}");
            sorted += &d;
            colour += &r;
        }
        for text in [mixed, sorted + &colour] {
            let index = Index::parse(&text);
            for (i, depth) in index.depth.iter().enumerate() {
                let expected = if i < 150 {
                    60_000_000 * i as i64
                } else {
                    60_000_000 * (i as i64 - 1) + 2_000_000
                };
                assert_eq!((depth.time, depth.colour), (Some(expected), Some(i)));
            }
        }
    }

    #[test]
    fn a_restarted_sensor_goes_on_a_frame_later() {
        let index = Index::parse(
            "d-0-900000000.pgm\nd-1-902000000.pgm\nd-2-5000000.pgm\nd-3-7000000.pgm\n",
        );
        assert_eq!(
            times(&index),
            [Some(0), Some(2_000_000), Some(4_000_000), Some(6_000_000)]
        );
    }

    #[test]
    fn a_picture_that_comes_after_its_time_is_marked_and_moves_nothing() {
        let index = Index::parse(
            "d-0-10000000.pgm\nd-1-14000000.pgm\nd-2-12000000.pgm\nd-3-16000000.pgm\n",
        );
        assert_eq!(
            times(&index),
            [Some(0), Some(4_000_000), None, Some(6_000_000)]
        );
    }

    #[test]
    fn what_cannot_be_understood_keeps_its_number() {
        let text = "a-0-5.dump\n\nd-0-nonsense.pgm\nd-0-5.pgm\r\nd-0-5.pgm\nd-0-4294967296.pgm\nd-0-x/../9.pgm\nd-\nd";
        let index = Index::parse(text);
        assert_eq!(times(&index), [None, Some(0), None, None, None, None]);
        assert_eq!(index.name(&index.depth[1]), "d-0-5.pgm");
        // Repeated: understood, but not later.
        assert_eq!(index.depth[2].ticks, Some(5));
    }

    /// A depth and a colour line for each picture, 30 a second, walls as told.
    fn lines(ticks: &[u32], wall: fn(usize) -> f64) -> Vec<String> {
        let lines = ticks.iter().enumerate().flat_map(|(i, ticks)| {
            let (wall, colour) = (wall(i), ticks.wrapping_add(700_000));
            [
                format!("d-{wall:.6}-{ticks}.pgm"),
                format!("r-{wall:.6}-{colour}.ppm"),
            ]
        });
        lines.collect()
    }

    fn in_time(i: usize) -> f64 {
        1.7e9 + i as f64 / 30.0
    }

    fn standing(_: usize) -> f64 {
        0.0
    }

    fn shuffled(mut lines: Vec<String>) -> String {
        fastrand::Rng::with_seed(5).shuffle(&mut lines);
        lines.join("\n")
    }

    fn partners(index: &Index) -> usize {
        let colour = |depth: &Entry| {
            let colour = index.colour[depth.colour?];
            Some(tick_difference(depth.ticks?, colour.ticks?) == 700_000)
        };
        index
            .depth
            .iter()
            .filter_map(colour)
            .filter(|&own| own)
            .count()
    }

    #[test]
    fn a_shuffled_index_is_played_whole_and_in_order() {
        // Across the wrap; a minute's pictures fit one turn of the counter, two minutes' need wall times.
        for (pictures, wall) in [(1800u32, standing as fn(usize) -> f64), (3600, in_time)] {
            let ticks: Vec<u32> = (0..pictures)
                .map(|i| 4_290_000_000u32.wrapping_add(i.wrapping_mul(2_000_000)))
                .collect();
            let index = Index::parse(&shuffled(lines(&ticks, wall)));
            let expected: Vec<_> = (0..i64::from(pictures))
                .map(|i| Some(i * 2_000_000))
                .collect();
            assert_eq!(times(&index), expected);
            assert_eq!(partners(&index), pictures as usize);
            // Numbers stay those of the index.
            let mut numbers: Vec<usize> = index.depth.iter().map(|entry| entry.number).collect();
            assert_ne!(numbers, (0..pictures as usize).collect::<Vec<_>>());
            numbers.sort_unstable();
            assert_eq!(numbers, (0..pictures as usize).collect::<Vec<_>>());
        }
    }

    #[test]
    fn one_stamp_far_off_costs_its_own_picture_only() {
        for off in [
            6_000_000u32,
            50_000_000,
            1_500_000_000,
            2_500_000_000,
            4_000_000_000,
        ] {
            for at in [0, 1, 50, 97] {
                for side in [0, 1] {
                    for wall in [in_time as fn(usize) -> f64, standing] {
                        let ticks: Vec<u32> = (0..100).map(|i| 5_000_000 + i * 2_000_000).collect();
                        let mut lines = lines(&ticks, wall);
                        let name = &mut lines[2 * at + side];
                        let ending = if side == 0 { ".pgm" } else { ".ppm" };
                        let (front, ticks) =
                            name.strip_suffix(ending).unwrap().rsplit_once('-').unwrap();
                        let wrong = ticks.parse::<u32>().unwrap().wrapping_add(off);
                        *name = format!("{front}-{wrong}{ending}");
                        let index = Index::parse(&lines.join("\n"));
                        let played = index.depth.iter().filter(|depth| depth.time.is_some());
                        let what = format!("{off} at {at}, stream {side}");
                        assert!(played.count() >= 100 - (1 - side), "{what}");
                        assert!(partners(&index) >= 99, "{what}");
                    }
                }
            }
        }
    }

    #[test]
    fn colour_now_and_then_finds_its_depth_across_long_gaps_wraps_and_restarts() {
        // Ten minutes at 30 a second; the sensor starts again after five; colour for two seconds of every 50, and not in
        // the minute of the restart.
        let mut text = String::new();
        let mut expected = 0;
        for i in 0..18_000u32 {
            let ticks = match i {
                0..9000 => 4_000_000_000u32.wrapping_add(i.wrapping_mul(2_000_000)),
                _ => 1_000_000u32.wrapping_add((i - 9000).wrapping_mul(2_000_000)),
            };
            text += &format!("d-{:.6}-{ticks}.pgm\n", in_time(i as usize));
            if i % 1500 < 60 && !(8000..10_000).contains(&i) {
                expected += 1;
                let colour = ticks.wrapping_add(700_000);
                text += &format!("r-{:.6}-{colour}.ppm\n", in_time(i as usize));
            }
        }
        let index = Index::parse(&text);
        assert_eq!(
            index
                .depth
                .iter()
                .filter(|depth| depth.time.is_none())
                .count(),
            0
        );
        assert_eq!((partners(&index), index.colour.len()), (expected, expected));
        let with = index.depth.iter().filter(|depth| depth.colour.is_some());
        assert_eq!(with.count(), expected, "nobody else's colour");
    }

    #[test]
    fn half_a_period_is_the_recordings_own() {
        // Colour 1.4 M ticks after depth: at 15 a second it is within half a period, at 30 it is not.
        for (period, every) in [(2_000_000u32, 0), (4_000_000, 40)] {
            let text: String = (0..40)
                .map(|i| {
                    let ticks = i * period;
                    format!("d-0-{ticks}.pgm\nr-0-{}.ppm\n", ticks + 1_400_000)
                })
                .collect();
            let index = Index::parse(&text);
            let own = |(i, depth): &(usize, &Entry)| depth.colour == Some(*i);
            assert_eq!(index.depth.iter().enumerate().filter(own).count(), every);
        }
    }
}
