use std::time::Instant;

use super::*;
use crate::sensor::device::Received;
use crate::sensor::stream::{Cutter, Layout};

/// One 30 Hz second of packets through parsing, assembly, pairing, unpacking and luma.
#[test]
#[ignore = "a measurement: cargo test --lib kinect -- --ignored --nocapture"]
fn time_per_frame() {
    let mut random = fastrand::Rng::with_seed(1);
    let mut packets: Vec<(Stream, Vec<u8>)> = Vec::new();
    let mut cutters = Stream::BOTH.map(|stream| Cutter::new(stream, 0));
    for number in 0..30 {
        for (cutter, stream) in cutters.iter_mut().zip(Stream::BOTH) {
            let mut picture = vec![0; Layout::of(stream).bytes];
            random.fill(&mut picture);
            for i in 0..cutter.layout().packets() {
                let mut packet = [0; crate::sensor::packet::LONGEST];
                let n = cutter.cut(&picture, number * 2_000_000, i, &mut packet);
                packets.push((stream, packet[..n].to_vec()));
            }
        }
    }
    let mut assemblers = Stream::BOTH.map(Assembler::new);
    let mut pairing = Pairing::default();
    let mut pair = RawPair::default();
    let mut clock = PictureClock::default();
    let mut frame = Frame::default();
    let (mut best_all, mut best_packets) = (f64::MAX, f64::MAX);
    for round in 0..40 {
        let with_pictures = round % 2 == 0;
        let start = Instant::now();
        let mut frames = 0;
        for (stream, bytes) in &packets {
            let received = Received {
                stream: *stream,
                intact: true,
                bytes,
            };
            let assembler = &mut assemblers[stream.index()];
            if let Some(ticks) = assembler.push(received.intact, received.bytes)
                && pairing.offer(*stream, 0, ticks, assembler.picture(), &mut pair)
            {
                frames += 1;
                if with_pictures {
                    let t = Instant::now();
                    unpack_depth(pair.pictures[1].first_chunk().unwrap(), &mut frame.depth);
                    let a = t.elapsed();
                    frame.bayer.copy_from_slice(&pair.pictures[0]);
                    let b = t.elapsed();
                    colour::luma_from_bayer(&frame.bayer, &mut frame.luma);
                    let c = t.elapsed();
                    if round == 20 && frames > 20 { println!("{a:?} {:?} {:?}", b - a, c - b); }
                }
            }
        }
        let ms = start.elapsed().as_secs_f64() * 1e3 / 30.0;
        assert_eq!(frames, 30);
        let best = if with_pictures {
            &mut best_all
        } else {
            &mut best_packets
        };
        *best = best.min(ms);
    }
    let mut unpack = f64::MAX;
    for _ in 0..200 {
        let start = Instant::now();
        unpack_depth(pair.pictures[1].first_chunk().unwrap(), &mut frame.depth);
        std::hint::black_box(&mut frame);
        unpack = unpack.min(start.elapsed().as_secs_f64() * 1e3);
    }
    for what in ["bayer", "luma", "unpack", "develop"] {
        let mut best = f64::MAX;
        for _ in 0..100 {
            let start = Instant::now();
            match what {
                "bayer" => frame.bayer.copy_from_slice(&pair.pictures[0]),
                "luma" => colour::luma_from_bayer(&frame.bayer, &mut frame.luma),
                "unpack" => unpack_depth(pair.pictures[1].first_chunk().unwrap(), &mut frame.depth),
                _ => develop(&pair, &mut clock, &mut frame),
            }
            std::hint::black_box(&mut frame);
            best = best.min(start.elapsed().as_secs_f64() * 1e3);
        }
        println!("{what} {best:.3} ms");
    }
    println!(
        "unpacking {unpack:.3} ms, packets to pictures {best_packets:.3} ms, with depth, Bayer and luma {best_all:.3} ms per frame"
    );
}
