//! Promise: a week of people who come and go, lost frames and an unplugged sensor leaves nothing behind: memory does not grow,
//! what a face shows on the last day is what it showed on the first, and nothing panics.
//!
//! Two accelerated runs. `a_week_of_visitors` is a whole week, 18 million frames, in which pictures are replaced by the
//! landmarks of made-up people, through learning, presence, memory of people, every OSC schema, all serial styles and the
//! table. `a_sensor_that_fails` is the whole way from packets to bytes, with packets lost, repeated and damaged and the device
//! unplugged every few seconds. Both take long:
//! `cargo test --release --test memory lives_for_a_week -- --ignored --nocapture --test-threads 1`.
//! `MIEN_HOURS` (168) and `MIEN_FRAMES` (20,000) shorten them.
//! One file: both runs feed the same wires and count the same memory.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant, SystemTime};

use mien_appliance::pipeline::Pipeline;
use mien_appliance::settings::Settings;
use mien_appliance::source;
use mien_outputs::csv::Rows;
use mien_outputs::osc::{self, Datagrams, Osc, Targets, faceosc, vmc, vrchat};
use mien_outputs::serial::{self, Encoder, Style};
use mien_outputs::{Output, Report, TrackingState};
use mien_sensors::kinect::device::{DeviceError, Model};
use mien_sensors::kinect::frame::KinectFrame;
use mien_sensors::kinect::live::LiveKinect;
use mien_simulator::virtual_kinect::VirtualKinect;
use mien_stages::base::capacity::{LANDMARKS, LEARNT_MEASURES};
use mien_stages::base::frames::SensorFromFace;
use mien_stages::base::geometry::{Point, Rigid, Vector};
use mien_stages::base::time::Timestamp;
use mien_stages::expression::{Expression, Measure, Settings as Learning, Units};
use mien_stages::face_model::FaceModel;
use mien_stages::landmarks::Landmarks;
use mien_stages::pose::PoseTracker;
use mien_stages::users::likeness::{FaceLengths, Likeness};
use mien_stages::users::memory::{Gone, Memory};
use mien_stages::users::{Presence, saved};

use crate::common::actors::{ACTED, Acting, FRAME_S, Jitter, Person};
use crate::common::faults::{Faulty, Rates};
use crate::common::paced::Paced;
use crate::{MEMORY, alone};

/// A number from the environment, else the usual one.
fn of_environment(name: &str, usual: u64) -> u64 {
    std::env::var(name).map_or(usual, |text| text.parse().expect(name))
}

/// Resident memory of this process, KiB.
fn resident_kib() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    let words = line.unwrap().split_whitespace().next();
    words.unwrap().parse().unwrap()
}

/// What all outputs have written.
#[derive(Default)]
struct Written {
    datagrams: AtomicU64,
    bytes: AtomicU64,
}

/// A receiver that looks at every datagram.
struct Looks(Arc<Written>);

impl Datagrams for Looks {
    fn send(&mut self, datagram: &[u8]) -> bool {
        assert!(datagram.starts_with(b"#bundle\0") && datagram.len() <= 1472);
        assert!(datagram.len().is_multiple_of(4));
        self.0.datagrams.fetch_add(1, Ordering::Relaxed);
        let bytes = datagram.len() as u64;
        self.0.bytes.fetch_add(bytes, Ordering::Relaxed);
        true
    }
}

/// Every output, to receivers that look at what comes.
struct Wires {
    osc: Vec<Box<dyn Output>>,
    lines: Vec<Encoder>,
    table: Rows,
    written: Arc<Written>,
}

impl Wires {
    fn new(expression: &Expression) -> Self {
        let units = expression.unit_names().iter();
        let units: &[&str] = &units.map(|name| name.as_str()).collect::<Vec<_>>();
        let measures = Measure::ALL.map(|measure| measure.name());
        let written = Arc::<Written>::default();
        let to = || -> Targets { Box::new([Box::new(Looks(Arc::clone(&written)))]) };
        let native = osc::Settings {
            ranges: true,
            ..osc::Settings::default()
        };
        let (vrchat, vmc) = (vrchat::Settings::default(), vmc::Settings::default());
        let faceosc = faceosc::Settings::default();
        let line = |style| {
            let settings = serial::Settings {
                style,
                pose: true,
                ..serial::Settings::default()
            };
            Encoder::new(&settings, units).unwrap()
        };
        Self {
            osc: vec![
                Box::new(Osc::with_targets(to(), native, units).unwrap()),
                Box::new(vmc::Vmc::with_targets(to(), vmc, units)),
                Box::new(vrchat::VrChat::with_targets(to(), vrchat, units).unwrap()),
                Box::new(faceosc::FaceOsc::with_targets(to(), faceosc)),
            ],
            lines: [Style::Text, Style::Plot, Style::Cobs].map(line).into(),
            table: Rows::new(&measures, units, &[]),
            written,
        }
    }

    fn send(&mut self, report: &Report) {
        for output in &mut self.osc {
            output.send(report).unwrap();
        }
        let mut bytes = 0;
        for encoder in &mut self.lines {
            bytes += encoder.encode(report).map_or(0, |line| line.bytes().len());
        }
        if self.table.fill(report) {
            bytes += self.table.text().len();
        }
        self.written
            .bytes
            .fetch_add(bytes as u64, Ordering::Relaxed);
    }

    fn not_numbers(&self) -> u64 {
        let osc = self.osc.iter().map(|output| output.tally().not_numbers);
        osc.sum()
    }
}

/// Jitter of a tracker, drawn once and played from anywhere: drawing it for a week would take longer than all under test.
struct Noise(Vec<[Vector; LANDMARKS]>);

impl Noise {
    const FRAMES: usize = 3001;

    fn new() -> Self {
        let mut jitter = Jitter::new(0.0025, 1);
        let frames = (0..Self::FRAMES).map(|_| {
            let mut points = [Point::origin(); LANDMARKS];
            jitter.add(&mut points);
            points.map(|point| point.coords)
        });
        Self(frames.collect())
    }

    fn add(&self, at: usize, points: &mut [Point; LANDMARKS]) {
        for (point, noise) in points.iter_mut().zip(&self.0[at % Self::FRAMES]) {
            *point += noise;
        }
    }
}

/// Somebody before the sensor.
struct Visitor {
    number: u64,
    person: Person,
    acting: Acting,
    came: u64,
    until: u64,
}

impl Visitor {
    fn new(units: &Units, number: u64, came: u64, frames: u64) -> Self {
        Self {
            number,
            person: Person::new(units, number),
            acting: Acting::new(number),
            came,
            until: came + frames,
        }
    }
}

/// One slot of the appliance.
struct Seat {
    expression: Expression,
    presence: Presence,
    state: TrackingState,
    visitor: Option<Visitor>,
    landmarks: Landmarks,
    /// Absolute error of the acted weights, and frames, of the visitor there.
    error: [f64; 2],
}

const HOUR: u64 = 108_000;
const MINUTE: u64 = 1_800;
const DAY: u64 = 24 * HOUR;
const SEATS: usize = 4;
/// The seat of one person who comes every day and sits for eight hours, and of one who comes for two minutes.
const RESIDENT: usize = 0;
const REFERENCE: usize = 3;

/// Error of the weights against what is acted.
fn error(units: &Units, expression: &Expression, truth: &[f64; LEARNT_MEASURES]) -> f64 {
    let mut columns = expression.weights().units().iter();
    let mut sum = 0.0;
    for (row, truth) in units.rows.iter().zip(truth).take(ACTED) {
        let kind = row.kind(false);
        let mut next = |there: bool| if there { *columns.next().unwrap() } else { 0.0 };
        let up = next(kind.rises());
        let found = f64::from(up - next(kind.falls()));
        let end = |there: bool| if there { f64::INFINITY } else { 0.0 };
        let truth = truth.clamp(-end(kind.falls()), end(kind.rises()));
        sum += (found - truth).abs();
    }
    sum / ACTED as f64
}

/// What of a face the tracker sees in one frame; `false` if nothing.
fn look(seat: &mut Seat, noise: &Noise, frame: u64, random: &mut fastrand::Rng) -> bool {
    let Some(visitor) = &mut seat.visitor else {
        return false;
    };
    // Turned away for half a second, now and then.
    if (frame / 15 + visitor.number).is_multiple_of(97) {
        return false;
    }
    let since = frame - visitor.came;
    let truth = visitor.acting.at(since as f64 * FRAME_S);
    seat.landmarks.head = visitor.person.face(&truth);
    noise.add(
        (visitor.number * 37 + since) as usize,
        &mut seat.landmarks.head,
    );
    seat.landmarks.point_confidence.fill(1.0);
    if random.u32(..300) == 0 {
        // A wrong fit.
        for point in &mut seat.landmarks.head[17..] {
            point.y += 0.02 * (random.f32() - 0.5);
        }
    }
    if (frame / 30).is_multiple_of(61) {
        // A hand before the mouth.
        seat.landmarks.point_confidence[48..].fill(0.1);
    }
    true
}

#[test]
#[ignore = "a quarter of an hour"]
fn a_week_of_visitors() {
    let _alone = alone();
    let hours = of_environment("MIEN_HOURS", 7 * 24);
    let started = Instant::now();
    let units = Units::shipped().by_measure();
    let noise = Noise::new();
    let anchor = FaceModel::shipped().standard_head;
    let pose = PoseTracker::new(mien_stages::pose::Settings::default(), &anchor).unwrap();
    let likeness = Likeness {
        head: pose.signature(),
        face: FaceLengths::default(),
    };
    let mut seats: [Seat; SEATS] = std::array::from_fn(|_| Seat {
        expression: Expression::new(Learning::default(), units.clone()),
        presence: Presence::new(0.5, 5.0),
        state: TrackingState::Absent,
        visitor: None,
        landmarks: Landmarks {
            pixels: [[320.0, 240.0]; LANDMARKS],
            ..Landmarks::certain([Point::origin(); LANDMARKS])
        },
        error: [0.0; 2],
    });
    let mut wires = Wires::new(&seats[0].expression);
    let mut memory = Memory::default();
    let mut text = String::with_capacity(1 << 17);
    let mut random = fastrand::Rng::with_seed(8);
    let sensor_from_head = Rigid::translation(0.0, 0.0, 0.8);
    let (mut unplugged_until, mut faces, mut visitors, mut gaps) = (0, 0u64, 0u64, [0u64; 2]);
    // At most one an hour: this test's own memory does not grow either.
    let scores = || Vec::with_capacity(hours as usize);
    let (mut resident, mut reference) = (scores(), scores());
    let mut midnights: Vec<(u64, usize)> = Vec::with_capacity(32);
    for frame in 0..hours * HOUR {
        let (day, of_day) = (frame / DAY, frame % DAY);
        if of_day == 6 * HOUR {
            // Nobody has been there for hours: what is held now is what is held always.
            midnights.push((resident_kib(), MEMORY.bytes_in_use()));
        }
        let at = Timestamp::from_us(frame * 100_000 / 3);
        // Visitors between eight and twenty o'clock.
        for (number, seat) in seats.iter_mut().enumerate() {
            seat.visitor.take_if(|visitor| frame >= visitor.until);
            let came = match number {
                RESIDENT if of_day == 9 * HOUR => Some((1, 8 * HOUR)),
                REFERENCE if of_day == 12 * HOUR => Some((2, 2 * MINUTE)),
                RESIDENT | REFERENCE => None,
                _ => {
                    let open = (8 * HOUR..20 * HOUR).contains(&of_day);
                    let comes = open && seat.visitor.is_none() && random.u64(..8 * MINUTE) == 0;
                    // Some have been here before.
                    comes.then(|| (1000 + random.u64(..500), random.u64(MINUTE / 2..6 * MINUTE)))
                }
            };
            if let Some((person, stays)) = came
                && seat.state == TrackingState::Absent
            {
                visitors += 1;
                seat.error = [0.0; 2];
                seat.visitor = Some(Visitor::new(&units, person, frame, stays));
            }
        }
        // Packets are lost, and somebody trips over the cable every few hours.
        if random.u64(..3 * HOUR) == 0 {
            unplugged_until = frame + random.u64(30..10 * MINUTE);
            gaps[1] += 1;
        }
        if frame < unplugged_until || random.u32(..100) == 0 {
            gaps[0] += 1;
            continue;
        }
        memory.forget_older(at, 3600.0);
        let mut anybody = false;
        for (number, seat) in seats.iter_mut().enumerate() {
            let before = seat.state;
            if look(seat, &noise, frame, &mut random) {
                faces += 1;
                let came_back = before == TrackingState::Absent
                    && memory.gone().iter().any(|gone| gone.slot == number)
                    && random.bool();
                if came_back && let Some(gone) = memory.take(number) {
                    // Perhaps it is somebody else: then learning has to find out.
                    if number != REFERENCE {
                        seat.expression.restore(&gone.learned);
                    }
                }
                seat.expression.observe(
                    &seat.landmarks,
                    &SensorFromFace::assume_frames(sensor_from_head),
                    at,
                );
                let ready = !seat.expression.weights().warming;
                seat.state = seat.presence.seen(at, ready);
                let weights = seat.expression.weights().units();
                assert!(weights.iter().all(|w| (0.0..100.0).contains(w)));
                let visitor = seat.visitor.as_mut().unwrap();
                if frame - visitor.came > MINUTE {
                    let truth = visitor.acting.at((frame - visitor.came) as f64 * FRAME_S);
                    seat.error[0] += error(&units, &seat.expression, &truth);
                    seat.error[1] += 1.0;
                }
            } else {
                seat.state = seat.presence.unseen(at);
            }
            let gone = seat.state == TrackingState::Absent && before != TrackingState::Absent;
            if gone {
                memory.keep(Gone {
                    slot: number,
                    likeness: likeness.clone(),
                    learned: seat.expression.learned(),
                    last_seen: at,
                    before_s: 0.0,
                });
                seat.expression.reset();
            }
            let scored = [RESIDENT, REFERENCE].contains(&number);
            let hour = frame.is_multiple_of(HOUR) && number == RESIDENT;
            if scored && seat.error[1] > 500.0 && (gone || hour) {
                let scores = match number {
                    RESIDENT => &mut resident,
                    _ => &mut reference,
                };
                scores.push((day, seat.error[0] / seat.error[1]));
                seat.error = [0.0; 2];
            }
            if seat.state == TrackingState::Absent && !gone {
                continue;
            }
            anybody |= !gone;
            let there = seat.state.is_present();
            let ranges = seat.expression.unit_ranges();
            let weights = seat.expression.weights();
            wires.send(&Report {
                frame,
                at,
                user: Some(number),
                state: seat.state,
                confidence: 0.9,
                sensor_from_face: there.then_some(&sensor_from_head),
                landmarks: there.then_some(&seat.landmarks),
                measures: if there { &weights.measures } else { &[] },
                weights: if there { weights.units() } else { &[] },
                ranges: if there { &ranges } else { &[] },
                ..Report::default()
            });
        }
        if !anybody {
            wires.send(&Report {
                frame,
                at,
                none_left: true,
                ..Report::default()
            });
        }
        if frame.is_multiple_of(MINUTE) && !memory.gone().is_empty() {
            let now = SystemTime::UNIX_EPOCH + Duration::from_micros(at.as_us());
            saved::write(memory.gone().iter().cloned(), (at, now), &mut text).unwrap();
            let back = saved::read(&text, now).unwrap();
            assert_eq!(back.len(), memory.gone().len());
        }
    }
    let (first, last) = (midnights.first().copied(), midnights.last().copied());
    let took = started.elapsed().as_secs_f64();
    println!(
        "{hours} hours in {took:.0} s ({:.0} times real time): {} frames, {} of them lost ({} times unplugged), {faces} faces of \
         {visitors} visits, {} datagrams, {:.1} GB",
        hours as f64 * 3600.0 / took,
        hours * HOUR,
        gaps[0],
        gaps[1],
        wires.written.datagrams.load(Ordering::Relaxed),
        wires.written.bytes.load(Ordering::Relaxed) as f64 * 1e-9,
    );
    println!("resident KiB and bytes in use, each day at six: {midnights:?}");
    let by_day = |scores: &[(u64, f64)], day: u64| {
        let of_day: Vec<f64> = scores.iter().filter(|s| s.0 == day).map(|s| s.1).collect();
        of_day.iter().sum::<f64>() / of_day.len() as f64
    };
    let days = hours / 24;
    let resident: Vec<f64> = (0..days).map(|day| by_day(&resident, day)).collect();
    let reference: Vec<f64> = (0..days).map(|day| by_day(&reference, day)).collect();
    println!("mean error of weights by day, of who sits for eight hours: {resident:.4?}");
    println!("... and of who comes for two minutes: {reference:.4?}");
    assert_eq!(wires.not_numbers(), 0);
    for scores in [&resident, &reference] {
        let most = scores.iter().copied().fold(0.0, f64::max);
        let least = scores.iter().copied().fold(f64::MAX, f64::min);
        // Faults fall differently each day.
        assert!(most < 0.05 && most - least < 0.01, "{scores:.4?}");
    }
    if let (Some(first), Some(last)) = (first, last) {
        assert_eq!(first.1, last.1, "bytes in use");
        assert!(last.0 <= first.0 + 256, "resident {first:?} {last:?}");
    }
}

/// How much faster than the world the sensor runs.
const SPEED: u32 = 2;

#[test]
#[ignore = "minutes"]
fn a_sensor_that_fails() {
    let _alone = alone();
    let frames = of_environment("MIEN_FRAMES", 20_000);
    let started = Instant::now();
    // Ten seconds of people who come and go, played to and fro.
    let mut simulated = source::simulated(Some("four")).unwrap();
    let mut drawn = KinectFrame::default();
    let scene: Arc<[(Box<_>, Box<_>)]> = (0..300)
        .map(|_| {
            simulated.next_frame(&mut drawn).unwrap();
            (drawn.depth.clone(), drawn.original.bayer.clone())
        })
        .collect();
    let settings = Settings::default();
    let model = FaceModel::shipped();
    let mut pipeline = Pipeline::new(&settings.stages, simulated.camera(), &model).unwrap();
    drop((simulated, drawn));
    let number = Arc::new(AtomicU64::new(0));
    let attempts = AtomicU64::new(0);
    let open = move || {
        let attempt = attempts.fetch_add(1, Ordering::Relaxed);
        if attempt.is_multiple_of(3) {
            return Err(DeviceError::Absent);
        }
        let (number, scene) = (Arc::clone(&number), Arc::clone(&scene));
        let until = number.load(Ordering::Relaxed) + 400 + 97 * (attempt % 7);
        let view = move |frame: &mut KinectFrame| {
            let now = number.fetch_add(1, Ordering::Relaxed);
            let place = (now % (2 * scene.len() as u64)) as usize;
            let (depth, bayer) = &scene[place.min(2 * scene.len() - 1 - place)];
            frame.depth.copy_from_slice(&**depth);
            frame.original.bayer.copy_from_slice(&**bayer);
            frame.original.ticks = (now as u32).wrapping_mul(2_000_000);
            frame.original.colour_ticks = frame.original.ticks;
            now < until
        };
        let rates = Rates {
            lost: 0.0001,
            longest_run: 40,
            repeated: 0.0005,
            damaged: 0.00002,
            short: 0.00002,
            bus_error: 0.00002,
            stall: 0.0,
        };
        let device = VirtualKinect::new(Model::Xbox1414, "A", view);
        Ok(Paced::new(Faulty::new(device, rates, attempt), SPEED))
    };
    let mut live = LiveKinect::with_source(open, mien_sensors::kinect::driver::Settings::default());
    let units = Units::shipped().by_measure();
    let mut wires = Wires::new(&Expression::new(Learning::default(), units));
    let mut frame = KinectFrame::default();
    let (mut followed, mut faces, mut slots, mut last) = (0, 0u64, [0u64; SEATS], None);
    let mut held = Vec::with_capacity(16);
    while followed < frames {
        let took = started.elapsed();
        assert!(took < Duration::from_secs(3600), "no more frames come");
        if !live.next_frame(&mut frame, Duration::from_millis(500)) {
            continue;
        }
        assert!(last.replace(frame.at) < Some(frame.at), "time goes on");
        pipeline.follow(&frame);
        for report in &pipeline.reports() {
            wires.send(report);
            if let Some(slot) = report.user.filter(|_| report.state.is_present()) {
                faces += 1;
                slots[slot] += 1;
            }
        }
        followed += 1;
        if followed.is_multiple_of((frames / 8).max(1)) {
            held.push((resident_kib(), MEMORY.bytes_in_use()));
        }
    }
    let status = live.status();
    println!(
        "{followed} frames in {:.0} s: the sensor {} times unplugged and opened again, {} frames given up for newer ones, {} \
         times 68 points, by slot {slots:?}; {} datagrams, {:.2} GB; {} weights that are no numbers",
        started.elapsed().as_secs_f64(),
        status.openings - 1,
        status.overwritten,
        faces,
        wires.written.datagrams.load(Ordering::Relaxed),
        wires.written.bytes.load(Ordering::Relaxed) as f64 * 1e-9,
        wires.not_numbers(),
    );
    println!("resident KiB and bytes in use, each eighth: {held:?}");
    assert_eq!(wires.not_numbers(), 0);
    assert!(
        faces > followed,
        "people are followed: {faces} of {followed}"
    );
    // The device's own state is new at every opening; it is in use or not when looked at.
    let least = |of: &[(u64, usize)]| of.iter().map(|held| held.1).min();
    assert!(least(&held[4..]) <= least(&held[1..4]), "in use {held:?}");
    assert!(held[7].0 <= held[3].0 + 1024, "resident {held:?}");
}
