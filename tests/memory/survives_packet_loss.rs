//! Promise: whatever happens to the packets, a delivered frame is whole and true, and what was lost is counted.

use std::time::Duration;

use mien_sensors::kinect::device::{Model, Stream};
use mien_sensors::kinect::driver::{Kinect, Settings, unpack_into};
use mien_sensors::kinect::frame::KinectFrame;
use mien_sensors::kinect::pairing::RawPair;
use mien_sensors::kinect::picture_clock::PictureClock;
use mien_sensors::kinect::stream::Tally;
use mien_simulator::virtual_kinect::VirtualKinect;

use crate::common::faults::{Faulty, Injected, Rates};
use crate::common::test_pattern;
use crate::{MEMORY, alone};

/// A picture is drawn once for many frames: drawing would take longer than everything under test. The number in its first
/// pixels, and so its content, is `number % VARIANTS`.
const VARIANTS: u64 = 16;
/// Ticks from frame to frame: 2^21 instead of 2 000 000, so that a stamp tells the variant across the wrap of the counter.
const STAMP: u32 = 1 << 21;

fn variants() -> Vec<KinectFrame> {
    (0..VARIANTS)
        .map(|number| {
            let mut frame = KinectFrame::default();
            test_pattern::draw(number, &mut frame);
            frame
        })
        .collect()
}

struct Outcome {
    frames: u64,
    delivered: u64,
    sent: [Tally; 2],
    injected: [Injected; 2],
    unpaired: [u64; 2],
    /// Requests for memory after the first second.
    allocations: u64,
}

/// Streams `seconds` of virtual time through faults, checks every frame delivered, then lets the last losses show.
fn stream(model: Model, rates: Rates, seconds: u64, seed: u64) -> Outcome {
    let _alone = alone();
    let variants = variants();
    let mut number = 0u64;
    let scene = |frame: &mut KinectFrame| {
        let variant = &variants[(number % VARIANTS) as usize];
        frame.depth.copy_from_slice(&*variant.depth);
        frame
            .original
            .bayer
            .copy_from_slice(&*variant.original.bayer);
        frame.original.ticks = (number as u32).wrapping_mul(STAMP);
        frame.original.colour_ticks = frame.original.ticks.wrapping_add(70_000);
        number += 1;
        true
    };
    let source = Faulty::new(VirtualKinect::new(model, "A", scene), rates, seed);
    let mut kinect = Kinect::open(source, Settings::default()).unwrap();
    kinect.start().unwrap();
    let mut pair = RawPair::default();
    let mut clock = PictureClock::default();
    let mut frame = KinectFrame::default();
    let mut delivered = 0;
    let mut index = None;
    let milliseconds = seconds * 1000;
    let mut before = 0;
    for millisecond in 0..milliseconds + 200 {
        if millisecond == 1000 {
            before = MEMORY.requests();
        }
        if millisecond == milliseconds {
            kinect.source.faults.rates = Rates::default();
        }
        kinect
            .poll(Duration::from_millis(1), |paired| {
                paired.swap_into(&mut pair);
                unpack_into(&mut pair, &mut clock, &mut frame);
                // The first frame may be lost: the stamp says which one this is, the number in the pixels must agree.
                let expected = stamped(frame.original.ticks);
                let drawn = &variants[expected as usize];
                assert!(
                    *frame.depth == *drawn.depth,
                    "depth of frame {}",
                    frame.index
                );
                assert!(index.replace(frame.index) < Some(frame.index));
                // A second without a pair, as at one percent: depth comes alone.
                if !frame.has_colour {
                    return;
                }
                assert!(
                    *frame.original.bayer == *drawn.original.bayer,
                    "colour of frame {}",
                    frame.index
                );
                assert_eq!(
                    frame.original.colour_ticks,
                    frame.original.ticks.wrapping_add(70_000)
                );
                delivered += 1;
            })
            .unwrap();
    }
    let allocations = MEMORY.requests() - before;
    let health = kinect.health();
    // Numbered are the whole depth pictures, paired or not.
    assert!(index < Some(health.streams[Stream::Depth.index()].pictures));
    Outcome {
        frames: kinect.source.inner.player.frames,
        delivered,
        sent: health.streams,
        injected: kinect.source.faults.injected,
        unpaired: health.unpaired,
        allocations,
    }
}

/// The variant that carries this stamp.
fn stamped(ticks: u32) -> u64 {
    u64::from(ticks / STAMP) % VARIANTS
}

fn counts_agree(outcome: &Outcome) {
    for stream in Stream::BOTH {
        let (found, done) = (
            outcome.sent[stream.index()],
            outcome.injected[stream.index()],
        );
        assert_eq!(
            [found.lost, found.repeated, found.damaged, found.bus_errors],
            [
                done.lost + done.bus_errors,
                done.repeated,
                done.damaged,
                done.bus_errors
            ],
            "{stream:?}: lost, repeated, damaged, bus errors"
        );
        assert!(found.wrong_length <= done.short, "{stream:?}");
    }
}

#[test]
fn without_faults_every_frame_arrives() {
    for model in [Model::Xbox1414, Model::Xbox1473, Model::Windows1517] {
        let outcome = stream(model, Rates::default(), 3, 0);
        // The last frame is on its way.
        assert!(outcome.frames - outcome.delivered <= 1);
        assert!(outcome.delivered >= 94);
        assert_eq!(outcome.unpaired, [0; 2]);
        counts_agree(&outcome);
    }
}

#[test]
fn ten_minutes_at_one_percent_loss() {
    let rates = Rates {
        lost: 0.01,
        ..Rates::default()
    };
    let outcome = stream(Model::Xbox1414, rates, 600, 1);
    println!(
        "frames {} delivered {} lost packets {} + {}, unpaired {:?}",
        outcome.frames,
        outcome.delivered,
        outcome.sent[0].lost,
        outcome.sent[1].lost,
        outcome.unpaired
    );
    counts_agree(&outcome);
    // Nothing grows: 18 000 frames ask for no memory. The test harness, which reports other tests meanwhile, asks for a little.
    assert!(outcome.allocations < 200, "{}", outcome.allocations);
    // 0.99^242 of the depth pictures and 0.99^162 of the colour pictures are untouched: 1.7 % of 18 000 have both.
    assert!(
        (220..=410).contains(&outcome.delivered),
        "{}",
        outcome.delivered
    );
}

#[test]
fn every_fault_at_once() {
    for seed in 0..4 {
        let rates = Rates {
            lost: 0.0005,
            longest_run: 40,
            repeated: 0.002,
            damaged: 0.0003,
            short: 0.0003,
            bus_error: 0.0003,
            stall: 0.0,
        };
        let outcome = stream(Model::Windows1517, rates, 60, seed);
        counts_agree(&outcome);
        assert!(outcome.delivered > 200, "{}", outcome.delivered);
    }
}
