//! The index of a recording: which pictures there are, when they were taken, and which belong together.
//!
//! Ticks are unwrapped along the index (they wrap every 71.6 s), depth and colour each for itself: an index sorted by name
//! lists one after the other. Each depth picture goes with the colour picture nearest in
//! ticks, at most half a frame period away: the two cameras may run at a constant offset. Degenerate: ticks that step
//! back by more than a second mean that the sensor was started again, and time goes on one frame period later; a gap of
//! more than half the counter's range (35.8 s) cannot be told from that. A depth picture that is not later than the one
//! before is marked to be skipped.

/// Ticks per frame period, at 60 MHz and 30 frames a second.
pub(super) const FRAME_TICKS: i64 = 2_000_000;
/// A step back beyond this many ticks (a second) is a restart, not pictures out of order.
const RESTART_TICKS: i64 = 60_000_000;

/// A file the index names.
#[derive(Clone, Copy, Debug)]
pub(super) struct Entry {
    start: usize,
    end: usize,
    /// The counter as in the name; `None` if the name cannot be understood.
    pub(super) ticks: Option<u32>,
    /// Unwrapped ticks since the first depth picture; `None` if the name cannot be understood or the picture comes too late.
    pub(super) time: Option<i64>,
    /// For a depth picture: its colour picture in [`Index::colour`].
    pub(super) colour: Option<usize>,
}

/// All pictures of a recording.
pub(super) struct Index {
    text: String,
    /// Every line that starts with `d-`, in order, whether it can be understood or not.
    pub(super) depth: Vec<Entry>,
    /// Colour pictures by time.
    pub(super) colour: Vec<Entry>,
}

impl Index {
    pub(super) fn parse(text: &str) -> Self {
        let mut index = Self {
            text: text.to_owned(),
            depth: Vec::new(),
            colour: Vec::new(),
        };
        for line in text.lines().map(str::trim) {
            let (list, ending) = match line.get(..2) {
                Some("d-") => (&mut index.depth, ".pgm"),
                Some("r-") => (&mut index.colour, ".ppm"),
                _ => continue,
            };
            let start = line.as_ptr() as usize - text.as_ptr() as usize;
            let ticks = ticks_of(line, ending);
            list.push(Entry {
                start,
                end: start + line.len(),
                ticks,
                time: None,
                colour: None,
            });
        }
        let mut clock = Unwrapped::leading();
        for depth in &mut index.depth {
            depth.time = depth.ticks.map(|ticks| clock.unwrap(ticks));
        }
        let mut clock = Unwrapped::following(clock);
        for colour in &mut index.colour {
            colour.time = colour.ticks.map(|ticks| clock.unwrap(ticks));
        }
        index.colour.retain(|colour| colour.time.is_some());
        index.colour.sort_by_key(|colour| colour.time);
        let mut latest = None;
        for depth in &mut index.depth {
            let Some(time) = depth.time else { continue };
            if latest.is_some_and(|latest| time <= latest) {
                depth.time = None;
                continue;
            }
            latest = Some(time);
            depth.colour = nearest(&index.colour, time);
        }
        index
    }

    /// File name of an entry.
    pub(super) fn name(&self, entry: &Entry) -> &str {
        &self.text[entry.start..entry.end]
    }
}

/// The counter in a name like `d-1700000000.033333-2000000.pgm`, which must not lead out of the directory.
fn ticks_of(name: &str, ending: &str) -> Option<u32> {
    let (_, ticks) = name.strip_suffix(ending)?.rsplit_once('-')?;
    (!name.contains(['/', '\\'])).then(|| ticks.parse().ok())?
}

/// The colour picture nearest in time, at most half a frame period away; of two equally near the earlier.
fn nearest(colour: &[Entry], time: i64) -> Option<usize> {
    let distance = |i: usize| colour[i].time.map_or(i64::MAX, |at| (at - time).abs());
    let after = colour.partition_point(|entry| entry.time < Some(time));
    [after.checked_sub(1), Some(after)]
        .into_iter()
        .flatten()
        .filter(|&i| i < colour.len() && distance(i) <= FRAME_TICKS / 2)
        .min_by_key(|&i| distance(i))
}

/// Unwraps the counter of one stream of pictures.
struct Unwrapped {
    last: Option<u32>,
    total: i64,
    /// Where each run of the sensor began: counter and unwrapped ticks. The depth stream makes them; colour follows them,
    /// so that both streams keep one time over a restart, in whatever order the index lists them.
    starts: Vec<(u32, i64)>,
    follows: bool,
    runs: usize,
}

impl Unwrapped {
    /// The stream that makes the time, from 0.
    fn leading() -> Self {
        Self {
            last: None,
            total: 0,
            starts: Vec::new(),
            follows: false,
            runs: 0,
        }
    }

    /// A stream that keeps the time of `leader`.
    fn following(leader: Self) -> Self {
        Self {
            starts: leader.starts,
            follows: true,
            ..Self::leading()
        }
    }

    fn unwrap(&mut self, ticks: u32) -> i64 {
        // The difference of a wrapping counter, as a signed number.
        let since = |earlier: u32| i64::from(ticks.wrapping_sub(earlier).cast_signed());
        match self.last.map(since) {
            Some(step) if step >= -RESTART_TICKS => self.total += step,
            other => {
                // A new run: the first one, or one after a step back.
                let gap = if other.is_some() { FRAME_TICKS } else { 0 };
                let start = self.starts.get(self.runs).filter(|_| self.follows);
                self.total = start.map_or(self.total + gap, |&(first, total)| total + since(first));
                self.runs += 1;
                if !self.follows {
                    self.starts.push((ticks, self.total));
                }
            }
        }
        self.last = Some(ticks);
        self.total
    }
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
}
