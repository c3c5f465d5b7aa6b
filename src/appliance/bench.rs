//! `mien bench`: time per step of a frame, excluding the source's own cost: with one person and with four in front of the
//! simulated sensor, or from a named source.
//!
//! Each frame is split into the USB packets of a sensor (not timed) and then runs through all steps: packet assembly, unpacking
//! of depth and colour, segmentation, pose, landmarks, expression. Depth and colour packets are interleaved and read from
//! freshly written memory, so that the cache is realistically cold. Times are wall-clock: on a busy machine prefer the median
//! to the mean. A stage's time is that of the first thread; with people on a second core, only `frame` covers both. Peak memory is
//! that of the whole process; how much of it the sources take is printed beside it.

use std::io::{self, Write};
use std::time::Instant;

use crate::cli::Run;
use crate::pipeline::Pipeline;
use crate::service::{self, Failure};
use crate::settings::Settings;
use crate::source;
use mien_outputs::Report;
use mien_sensors::Frame;
use mien_simulator::round_trip::PacketRoundTrip;
use mien_stages::base::peak_memory::{peak_resident_bytes, resident_bytes};
use mien_stages::base::sorting::sort;

/// Frames without `--frames`: ten seconds at 30 Hz.
const FRAMES: u64 = 300;
/// Frames before the measurement, which allocate memory and fill caches.
const WARM_UP: u64 = 5;

/// Names of the timed steps; `sensor` is the sum of those before it, `frame` the total.
const STEPS: &str = "packets unpack luma sensor segment pose landmarks expression frame";
const PACKETS: usize = 0;
const UNPACK: usize = 1;
const LUMA: usize = 2;
const SENSOR: usize = 3;
/// Index of the first pipeline stage; the others follow in the order of [`crate::pipeline::Stage`].
const STAGES: usize = 4;
const FRAME: usize = 8;

/// Times of every step, milliseconds.
struct Times {
    by_step: [Vec<f32>; FRAME + 1],
    /// Times of the current frame, milliseconds; `None` if the step was not reached.
    current: [Option<f32>; FRAME + 1],
    /// Number of people reported, summed over all frames.
    people: usize,
}

impl Times {
    fn new(frames: u64) -> Self {
        let capacity = usize::try_from(frames).unwrap_or(usize::MAX).min(1 << 20);
        Self {
            by_step: std::array::from_fn(|_| Vec::with_capacity(capacity)),
            current: [None; FRAME + 1],
            people: 0,
        }
    }

    fn end_frame(&mut self, counts: bool) {
        self.current[SENSOR] = Some(self.current[..SENSOR].iter().flatten().sum());
        for (all, now) in self.by_step.iter_mut().zip(&mut self.current) {
            all.extend(now.take().filter(|_| counts));
        }
    }

    fn write(&mut self, out: &mut impl Write) -> io::Result<()> {
        out.write_all(b"ms per frame      min   median      p99      max   frames\n")?;
        for (name, times) in STEPS.split(' ').zip(&mut self.by_step) {
            sort(times);
            let quantile = |share: f32| {
                let last = times.len().checked_sub(1)?;
                Some(times[(last as f32 * share).ceil() as usize])
            };
            write!(out, "{name:<12}")?;
            for share in [0.0, 0.5, 0.99, 1.0] {
                match quantile(share) {
                    Some(time) => write!(out, "{time:>9.3}")?,
                    None => write!(out, "{:>9}", "-")?,
                }
            }
            writeln!(out, "{:>9}", times.len())?;
        }
        // Format of the paper's Table 1.
        let frames = &self.by_step[FRAME];
        if let (Some(least), Some(most)) = (frames.first(), frames.last()) {
            let mean = frames.iter().sum::<f32>() / frames.len() as f32;
            let rate = 1e3 / mean;
            writeln!(
                out,
                "frame: {least:.2} / {mean:.2} / {most:.2} ms (min / mean / max), {rate:.1} per second"
            )?;
            let people = (self.people as f32 / frames.len() as f32).round();
            let noun = if people == 1.0 { "person" } else { "people" };
            // Percent of the sensor's 33 ms.
            let share = format!("{:.0} % of a frame", mean * 3.0);
            writeln!(out, "{people} {noun}: {share} at 30 per second")?;
        }
        Ok(())
    }
}

/// Sources if none is named: one person, four people.
const SOURCES: [&str; 2] = ["simulated", "simulated:four"];

/// `mien bench`: writes a table for each source to `out`. `allocations` returns the process's number of allocations.
///
/// # Errors
/// If a source cannot be opened or a table not written; as [`Failure`] lists.
pub fn run(bench: &Run, allocations: fn() -> u64, out: &mut impl Write) -> Result<(), Failure> {
    let settings = service::settings(bench.config.as_deref())?;
    crate::log::start(settings.log_level);
    let frames = bench.frames.unwrap_or(FRAMES);
    let sources = match &bench.source {
        Some(named) => &[named.as_str()][..],
        None => &SOURCES,
    };
    let (mut allocated, mut source_bytes) = (0, 0);
    for name in sources {
        let (mut times, more, bytes) = time(name, frames, &settings, allocations)?;
        allocated += more;
        source_bytes += bytes;
        let people = times.people as f64 / times.by_step[FRAME].len().max(1) as f64;
        writeln!(out, "{name}: {people:.2} people per frame")
            .and_then(|()| times.write(out))
            .map_err(Failure::Print)?;
    }
    let peak = peak_resident_bytes();
    peak.map_or(Ok(()), |bytes| {
        writeln!(out, "peak_rss_bytes {bytes}")?;
        writeln!(out, "of_it_sources_bytes {source_bytes}")
    })
    .and_then(|()| writeln!(out, "allocations_after_start {allocated}"))
    .map_err(Failure::Print)
}

/// Times of one source's frames, the number of allocations after warm-up, and the memory that the source and the cutting of its
/// frames into packets take, bytes.
fn time(
    name: &str,
    frames: u64,
    settings: &Settings,
    allocations: fn() -> u64,
) -> Result<(Times, u64, u64), Failure> {
    let before = resident_bytes();
    let (mut source, _) = source::open(name, true, &settings.sensor.device)?;
    let mut round_trip = PacketRoundTrip::default();
    // The first frame is not measured, and a source without frames ends below.
    let _ = source.next_frame(round_trip.next_frame());
    let source_bytes = before
        .zip(resident_bytes())
        .map_or(0, |(before, after)| after.saturating_sub(before));
    let mut pipeline = Pipeline::new(&settings.stages, source.camera(), &service::model(None)?)?;
    let mut times = Times::new(frames);
    let mut frame = Frame::default();
    let mut allocated = 0;
    for number in 0..frames.saturating_add(WARM_UP) {
        match source.next_frame(round_trip.next_frame()) {
            Ok(true) => {}
            Ok(false) => break,
            Err(_) => continue,
        }
        round_trip.cut();
        let before = allocations();
        let began = Instant::now();
        let mut last = began;
        let mut lap = |step: usize, times: &mut Times| {
            let now = Instant::now();
            // A stage that runs for several users counts as one.
            let before = times.current[step].unwrap_or_default();
            times.current[step] = Some(before + (now - last).as_secs_f32() * 1e3);
            last = now;
        };
        round_trip.assemble(number);
        lap(PACKETS, &mut times);
        round_trip.unpack(&mut frame);
        lap(UNPACK, &mut times);
        round_trip.demosaic(&mut frame);
        lap(LUMA, &mut times);
        (frame.index, frame.at) = (round_trip.sent().index, round_trip.sent().at);
        frame.has_colour = round_trip.sent().has_colour;
        pipeline.follow_by_stage(&frame, |stage| lap(STAGES + stage as usize, &mut times));
        times.current[FRAME] = Some(began.elapsed().as_secs_f32() * 1e3);
        let counts = number >= WARM_UP;
        if counts {
            allocated += allocations() - before;
            let reports = pipeline.reports();
            let present = |report: &&Report| report.user.is_some() && report.state.is_present();
            times.people += reports.iter().filter(present).count();
        }
        times.end_frame(counts);
    }
    Ok((times, allocated, source_bytes))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_step_is_timed_and_sums_are_right() {
        let mut out = Vec::new();
        let bench = Run {
            source: Some("simulated".into()),
            frames: Some(3),
            ..Run::default()
        };
        run(&bench, || 7, &mut out).unwrap();
        let text = String::from_utf8(out).unwrap();
        let median = |name: &str| -> f32 {
            let row = text.lines().find(|line| line.starts_with(name)).unwrap();
            assert!(row.ends_with("        3"), "{row}");
            row.split_whitespace().nth(2).unwrap().parse().unwrap()
        };
        let medians: Vec<f32> = STEPS.split(' ').map(median).collect();
        assert!(medians.iter().all(|&ms| ms >= 0.0), "{text}");
        assert!(medians[FRAME] >= medians[SENSOR], "{text}");
        assert!(text.ends_with("allocations_after_start 0\n"), "{text}");
    }

    #[test]
    fn without_a_source_one_person_and_four_are_timed() {
        let mut out = Vec::new();
        let bench = Run {
            frames: Some(8),
            ..Run::default()
        };
        run(&bench, || 7, &mut out).unwrap();
        let text = String::from_utf8(out).unwrap();
        let rows = |name: &str| text.lines().filter(|line| line.starts_with(name)).count();
        assert_eq!([rows("frame "), rows("allocations_after_start ")], [2, 1]);
        assert!(
            text.starts_with("simulated: 1.00 people per frame\n"),
            "{text}"
        );
        let four = text
            .lines()
            .find_map(|line| line.strip_prefix("simulated:four: "));
        let people = four.unwrap().split(' ').next().unwrap();
        assert!(people.parse::<f64>().unwrap() > 2.0, "{text}");
    }

    #[test]
    fn statistics_exclude_warm_up_frames() {
        let mut times = Times::new(200);
        for number in 0..=200u8 {
            times.current[PACKETS] = Some(f32::from(number));
            times.current[UNPACK] = Some(1.0);
            times.current[FRAME] = Some(f32::from(number) + 1.0);
            times.end_frame(number > 0);
        }
        let mut out = Vec::new();
        times.write(&mut out).unwrap();
        let text = String::from_utf8(out).unwrap();
        let row = |i: usize| -> Vec<String> {
            text.lines()
                .nth(i)
                .unwrap()
                .split_whitespace()
                .map(str::to_owned)
                .collect()
        };
        assert_eq!(
            row(1),
            ["packets", "1.000", "101.000", "199.000", "200.000", "200"]
        );
        assert_eq!(
            row(4),
            ["sensor", "2.000", "102.000", "200.000", "201.000", "200"]
        );
        assert!(
            text.ends_with("0 people: 304 % of a frame at 30 per second\n"),
            "{text}"
        );
        assert_eq!(row(5), ["segment", "-", "-", "-", "-", "0"]);
    }
}
