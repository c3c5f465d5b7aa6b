use super::*;
use crate::kinect::packet::{LONGEST, TICKS_PER_PICTURE};

type Packets = Vec<(bool, Vec<u8>)>;

fn picture(stream: Stream, number: u32) -> Vec<u8> {
    let mut random = fastrand::Rng::with_seed(u64::from(number));
    (0..Layout::new(stream).bytes)
        .map(|_| random.u8(..))
        .collect()
}

fn cut(cutter: &mut Cutter, picture: &[u8], ticks: u32) -> Packets {
    let mut packet = [0; LONGEST];
    (0..cutter.layout.packets())
        .map(|number| {
            let n = cutter.cut(picture, ticks, number, &mut packet);
            (true, packet[..n].to_vec())
        })
        .collect()
}

#[test]
fn sizes_are_the_cameras() {
    for (stream, packets, last) in [(Stream::Depth, 242, 1132), (Stream::Colour, 162, 12)] {
        let layout = Layout::new(stream);
        assert_eq!(layout.packets(), packets);
        assert_eq!(layout.range(packets - 1).len(), last);
        assert_eq!(layout.position(packets - 1), Position::Last);
    }
}

#[test]
fn undisturbed_pictures_come_out_as_they_went_in() {
    for stream in Stream::BOTH {
        let mut cutter = Cutter::new(stream, 250);
        let mut assembler = Assembler::new(stream);
        for number in 0..4 {
            let sent = picture(stream, number);
            let ticks = number.wrapping_mul(TICKS_PER_PICTURE);
            let packets = cut(&mut cutter, &sent, ticks);
            for (i, (intact, bytes)) in packets.iter().enumerate() {
                assert_eq!(assembler.push(true, &[]), None);
                let done = assembler.push(*intact, bytes);
                assert_eq!(done, (i + 1 == packets.len()).then_some(ticks));
            }
            assert!(*assembler.picture == sent);
        }
        let expected = Tally {
            pictures: 4,
            packets: 4 * Layout::new(stream).packets() as u64,
            ..Tally::default()
        };
        assert_eq!(assembler.tally, expected);
    }
}

fn assert_counts(found: &Tally, expected: &Tally, seed: u64) {
    // A short packet of a picture already given up is passed over, not measured.
    assert!(found.wrong_length <= expected.wrong_length, "seed {seed}");
    assert_eq!(
        [
            found.pictures,
            found.lost,
            found.repeated,
            found.damaged,
            found.bus_errors
        ],
        [
            expected.pictures,
            expected.lost,
            expected.repeated,
            expected.damaged,
            expected.bus_errors
        ],
        "seed {seed} lost/repeated/damaged/bus errors"
    );
}

/// The promise: whatever happens to the packets, exactly the untouched pictures are delivered, bit for bit, and the
/// counts equal what was done.
#[test]
fn exactly_the_untouched_pictures_are_delivered_and_losses_are_counted() {
    for seed in 0..60 {
        let mut random = fastrand::Rng::with_seed(seed);
        let stream = Stream::BOTH[random.usize(..2)];
        let mut cutter = Cutter::new(stream, random.u8(..));
        let mut assembler = Assembler::new(stream);
        let mut expected = Tally::default();
        let rate = [0.0, 0.0002, 0.002, 0.01, 0.05][random.usize(..5)];
        let pictures = 12;
        for number in 0..pictures {
            let sent = picture(stream, number);
            let mut untouched = true;
            // The last picture is clean, so that every loss before it shows.
            let rate = if number + 1 == pictures { 0.0 } else { rate };
            let mut delivered = false;
            let packets = cut(&mut cutter, &sent, number);
            let mut i = 0;
            while i < packets.len() {
                let mut bytes = packets[i].1.clone();
                i += 1;
                let mut times = 1;
                let mut intact = true;
                if random.f64() < rate {
                    match random.usize(..5) {
                        0 => {
                            let burst = random.usize(1..9).min(packets.len() - i + 1);
                            i += burst - 1;
                            expected.lost += burst as u64;
                            (times, untouched) = (0, false);
                        }
                        1 => {
                            times = 2;
                            expected.repeated += 1;
                        }
                        2 => {
                            bytes[random.usize(..2)] ^= random.u8(1..);
                            expected.damaged += 1;
                            untouched = false;
                        }
                        3 => {
                            bytes.truncate(random.usize(1..bytes.len()));
                            expected.wrong_length += 1;
                            untouched = false;
                        }
                        _ => {
                            intact = false;
                            bytes.clear();
                            expected.bus_errors += 1;
                            expected.lost += 1;
                            untouched = false;
                        }
                    }
                }
                for _ in 0..times {
                    if let Some(ticks) = assembler.push(intact, &bytes) {
                        assert_eq!(ticks, number);
                        assert!(*assembler.picture == sent, "seed {seed}: wrong picture");
                        delivered = true;
                    }
                }
            }
            assert_eq!(delivered, untouched, "seed {seed} picture {number}");
            expected.pictures += u64::from(untouched);
        }
        assert_counts(&assembler.tally, &expected, seed);
    }
}

#[test]
fn a_loss_of_whole_sequence_rounds_is_not_mistaken_for_none() {
    for stream in Stream::BOTH {
        for rounds in 1..6 {
            let mut cutter = Cutter::new(stream, 0);
            let mut assembler = Assembler::new(stream);
            let mut all: Packets = Vec::new();
            for number in 0..12 {
                all.extend(cut(&mut cutter, &picture(stream, number), number));
            }
            all.drain(100..100 + 256 * rounds);
            for (_, bytes) in &all {
                if let Some(ticks) = assembler.push(true, bytes) {
                    assert!(*assembler.picture == picture(stream, ticks));
                }
            }
            assert!(assembler.tally.misplaced > 0);
        }
    }
}

/// As many cases as a short fuzzing run: arbitrary bytes, arbitrary lengths, mutated real packets.
#[test]
fn any_bytes_are_survived_and_never_make_a_wrong_picture() {
    let sent = picture(Stream::Colour, 7);
    let mut random = fastrand::Rng::with_seed(5);
    let mut assembler = Assembler::new(Stream::Colour);
    let mut noise = [0; 2100];
    for round in 0..400 {
        let mut cutter = Cutter::new(Stream::Colour, random.u8(..));
        let mut touched_payload = false;
        for (_, mut bytes) in cut(&mut cutter, &sent, round) {
            if random.u8(..) < 3 {
                random.fill(&mut noise);
                let n = random.usize(..noise.len());
                noise[..2].copy_from_slice(b"RB");
                noise[3] = 0x80 | [1, 2, 5][random.usize(..3)];
                touched_payload = true;
                let _ = assembler.push(random.bool(), &noise[..n]);
            }
            if random.u8(..) < 2 {
                let byte = random.usize(..HEADER);
                bytes[byte] ^= 1 << random.u8(..8);
            }
            if assembler.push(true, &bytes).is_some() && !touched_payload {
                assert!(*assembler.picture == sent, "round {round}");
            }
        }
    }
    assert!(assembler.tally.pictures > 0 && assembler.tally.broken > 0);
}
