//! Pairs colour pictures with depth pictures.
//!
//! Both streams have time stamps of the same clock (60 MHz, wraps after 71.6 s) and the same rate, with a constant offset. A depth
//! picture is paired with the colour picture whose stamp, minus the learned offset, is within half a period. At equal rates there is
//! at most one, so the pair is complete when the second of the two arrives. The offset is learned slowly and kept within one
//! period, so that jitter around half a period does not make the choice flip.
//!
//! Without colour ([`Pairing::depth_only`]), a depth picture is delivered when the next one replaces it, one period late, so that
//! returning colour finds its partner.
//!
//! Memory: one waiting picture per stream, allocated once. A newer picture of the same stream replaces the waiting one, which is
//! counted as unpaired. A pair stays in these buffers until it is swapped for free ones.

use super::device::Stream;
use super::packet::TICKS_PER_PICTURE;
use super::stream::Layout;
use mien_stages::base::defaults;
use mien_stages::base::prelude::*;

/// Largest residual of a pair, ticks.
const HALF_PERIOD: u32 = TICKS_PER_PICTURE / 2;
/// The offset moves by 1/16 of each residual: a time constant of about half a second.
const OFFSET_SMOOTHING: i32 = 16;

fn pictures() -> [Box<[u8]>; 2] {
    Stream::BOTH.map(|stream| vec![0; Layout::new(stream).bytes].into_boxed_slice())
}

defaults! {
    /// A depth picture and the colour picture of the same moment, if there is one, as received.
    #[derive(Clone, Debug)]
    pub struct RawPair {
        /// Number of the depth picture among all whole ones since the start, from 0.
        pub number: u64 = 0,
        /// Time stamps by stream, 60 MHz ticks.
        pub ticks: [u32; 2] = [0; 2],
        /// Whether there is a colour picture; if not, its bytes and stamp are meaningless.
        pub has_colour: bool = true,
        /// Bytes of the pictures by stream: Bayer, packed depth.
        pub pictures: [Box<[u8]>; 2] = pictures(),
    }

    /// Holds the pictures that wait for a partner.
    pub struct Pairing {
        /// Number and time stamp of the waiting picture, by stream.
        waiting: [Option<(u64, u32)>; 2] = [None; 2],
        pictures: [Box<[u8]>; 2] = pictures(),
        /// Learned offset, colour minus depth, ticks.
        offset: i32 = 0,
        /// Pictures without a partner, by stream.
        pub unpaired: [u64; 2] = [0; 2],
        /// Whether depth pictures without a partner are delivered without colour.
        pub depth_only: bool = false,
    }
}

/// A pair, or a depth picture without colour, still in the buffers of [`Pairing`].
pub struct Paired<'a> {
    number: u64,
    ticks: [u32; 2],
    colour: Option<&'a mut Box<[u8]>>,
    depth: &'a mut Box<[u8]>,
}

impl Paired<'_> {
    /// Moves the content into `pair` by swapping buffers.
    pub fn swap_into(self, pair: &mut RawPair) {
        (pair.number, pair.ticks) = (self.number, self.ticks);
        pair.has_colour = self.has_colour();
        let [colour, depth] = &mut pair.pictures;
        core::mem::swap(self.depth, depth);
        if let Some(mine) = self.colour {
            core::mem::swap(mine, colour);
        }
    }

    /// Whether there is a colour picture.
    pub const fn has_colour(&self) -> bool {
        self.colour.is_some()
    }
}

impl Pairing {
    /// Discards waiting pictures and the offset; to be called when the camera's clock may have restarted.
    pub fn restart(&mut self) {
        self.offset = 0;
        self.waiting = [None; 2];
    }

    /// Takes picture `number` of a stream, swapping its buffer for a free one. Returns a completed pair or, with `depth_only`, the
    /// depth picture that the new one replaces; valid until the next call.
    pub fn offer<'a>(
        &'a mut self,
        stream: Stream,
        number: u64,
        ticks: u32,
        picture: &'a mut Box<[u8]>,
    ) -> Option<Paired<'a>> {
        let index = stream.index();
        let replaced = self.waiting[index].replace((number, ticks));
        self.unpaired[index] += u64::from(replaced.is_some());
        core::mem::swap(&mut self.pictures[index], picture);
        if let [Some((_, colour)), Some((number, depth))] = self.waiting
            && let Some(residual) = self.residual(colour, depth)
        {
            self.update_offset(residual);
            self.waiting = [None; 2];
            let [colour_buffer, depth_buffer] = &mut self.pictures;
            return Some(Paired {
                number,
                ticks: [colour, depth],
                colour: Some(colour_buffer),
                depth: depth_buffer,
            });
        }
        let (number, ticks) = replaced.filter(|_| self.depth_only && stream == Stream::Depth)?;
        Some(Paired {
            number,
            ticks: [0, ticks],
            colour: None,
            depth: picture,
        })
    }

    /// Difference of the stamps minus the offset, ticks; `None` if it is more than half a period.
    fn residual(&self, colour: u32, depth: u32) -> Option<i32> {
        let difference = colour.wrapping_sub(depth).cast_signed();
        Some(difference.wrapping_sub(self.offset))
            .filter(|residual| residual.unsigned_abs() <= HALF_PERIOD)
    }

    fn update_offset(&mut self, residual: i32) {
        self.offset += residual / OFFSET_SMOOTHING;
        // Beyond three quarters of a period the next picture is the natural partner.
        let period = TICKS_PER_PICTURE.cast_signed();
        if self.offset.abs() > period * 3 / 4 {
            self.offset -= period * self.offset.signum();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HALF_PERIOD: i32 = super::HALF_PERIOD.cast_signed();

    struct Bench {
        pairing: Pairing,
        pair: RawPair,
        buffers: [Box<[u8]>; 2],
    }

    impl Bench {
        fn new() -> Self {
            Self {
                pairing: Pairing::default(),
                pair: RawPair::default(),
                buffers: RawPair::default().pictures,
            }
        }

        /// Offers picture `number`, marked with it; returns the numbers paired, `[colour, depth]`.
        fn offer(&mut self, stream: Stream, number: u8, ticks: u32) -> Option<[u8; 2]> {
            let buffer = &mut self.buffers[stream.index()];
            buffer[0] = number;
            let made = self.pairing.offer(stream, number.into(), ticks, buffer)?;
            made.swap_into(&mut self.pair);
            let pictures = [0, 1].map(|side| self.pair.pictures[side][0]);
            assert_eq!(self.pair.number, u64::from(pictures[1]));
            Some(pictures)
        }
    }

    #[test]
    fn pairs_by_nearest_stamp_across_the_wrap_with_offset_and_jitter() {
        for seed in 0..200 {
            let mut random = fastrand::Rng::with_seed(seed);
            let mut bench = Bench::new();
            let start = u32::MAX - TICKS_PER_PICTURE * 5;
            let offset = random.i32(-HALF_PERIOD * 4 / 5..HALF_PERIOD * 4 / 5);
            let (mut made, mut expected) = (0, 0);
            for number in 0..40u8 {
                let base = start.wrapping_add(u32::from(number) * TICKS_PER_PICTURE);
                let jitter = random.i32(-HALF_PERIOD / 10..HALF_PERIOD / 10);
                let colour = base.wrapping_add_signed(offset + jitter);
                // One of four pictures does not come.
                let came = [random.u8(..4) > 0, random.u8(..4) > 0];
                expected += u32::from(came[0] && came[1]);
                let mut order = [(Stream::Depth, base), (Stream::Colour, colour)];
                if offset < 0 {
                    order.reverse();
                }
                for (stream, ticks) in order {
                    if came[stream.index()]
                        && let Some([colour, depth]) = bench.offer(stream, number, ticks)
                    {
                        assert_eq!([colour, depth], [number; 2], "seed {seed} offset {offset}");
                        made += 1;
                    }
                }
            }
            assert_eq!(made, expected, "seed {seed}: every possible pair");
        }
    }

    #[test]
    fn an_offset_at_the_edge_does_not_flip() {
        let mut random = fastrand::Rng::with_seed(9);
        let mut bench = Bench::new();
        // Learn 0.48 of a period, then jitter across the half.
        let mut relations = [0u32; 3];
        for number in 0..200u8 {
            let base = u32::from(number) * TICKS_PER_PICTURE;
            let jitter = if number < 60 {
                0
            } else {
                random.i32(-HALF_PERIOD / 10..HALF_PERIOD / 10)
            };
            let colour = base.wrapping_add_signed(HALF_PERIOD * 96 / 100 + jitter);
            for (stream, ticks) in [(Stream::Depth, base), (Stream::Colour, colour)] {
                if let Some([colour, depth]) = bench.offer(stream, number, ticks) {
                    relations[usize::from(colour.wrapping_sub(depth).wrapping_add(1))] += 1;
                }
            }
        }
        assert_eq!(relations, [0, 200, 0]);
    }

    #[test]
    fn depth_alone_comes_one_picture_late_and_whole_until_colour_is_back() {
        let mut bench = Bench::new();
        bench.pairing.depth_only = true;
        let mut came = Vec::new();
        for number in 0..20u8 {
            let ticks = u32::from(number) * TICKS_PER_PICTURE;
            let mut offer = |stream, number: u8| {
                let made = bench.offer(stream, number, ticks + 500);
                came.extend(made.map(|[_, depth]| (depth, bench.pair.has_colour)));
                assert!(bench.pair.has_colour || bench.pair.ticks[0] == 0);
            };
            // Colour is away for ten pictures.
            if !(5..15).contains(&number) {
                offer(Stream::Colour, number);
            }
            offer(Stream::Depth, number);
        }
        // The one before colour came back gave way to a pair.
        let expected = (0..20).filter(|number| *number != 14);
        assert_eq!(
            came,
            expected
                .map(|number| (number, !(5..15).contains(&number)))
                .collect::<Vec<_>>()
        );
        assert_eq!(bench.pairing.unpaired, [0, 10]);
    }

    #[test]
    fn what_finds_no_partner_is_dropped_and_counted() {
        let mut bench = Bench::new();
        for number in 0..10 {
            let ticks = u32::from(number) * TICKS_PER_PICTURE;
            assert_eq!(bench.offer(Stream::Depth, number, ticks), None);
        }
        assert_eq!(bench.pairing.unpaired, [0, 9]);
        assert_eq!(
            bench.offer(Stream::Colour, 9, 9 * TICKS_PER_PICTURE),
            Some([9, 9])
        );
        assert_eq!(bench.pairing.unpaired, [0, 9]);
    }

    #[test]
    fn clocks_that_drift_apart_pair_with_the_next_picture_beyond_three_quarters_of_a_period() {
        let period = TICKS_PER_PICTURE.cast_signed();
        for direction in [1, -1] {
            let mut bench = Bench::new();
            let mut relations = Vec::new();
            // A hundredth of a period a picture: from none to two and a half. They come in the order of their stamps.
            let mut pictures: Vec<(u32, Stream, u8)> = Vec::new();
            for number in 0..250u8 {
                let base = 1_000_000_000 + u32::from(number) * TICKS_PER_PICTURE;
                let drift = direction * i32::from(number) * (period / 100);
                pictures.push((base, Stream::Depth, number));
                pictures.push((base.wrapping_add_signed(drift), Stream::Colour, number));
            }
            pictures.sort_by_key(|(ticks, ..)| *ticks);
            for (ticks, stream, number) in pictures {
                if let Some([colour, depth]) = bench.offer(stream, number, ticks) {
                    relations.push(i32::from(depth) - i32::from(colour));
                }
                let offset = bench.pairing.offset.abs();
                assert!(offset <= period * 3 / 4, "{number}: {offset}");
            }
            let mut kinds = relations.clone();
            kinds.dedup();
            // Each partner for about a period, then the next one: the offset learned lags sixteen hundredths behind.
            assert_eq!(kinds, [0, 1, 2].map(|k| k * direction));
            let first = relations.iter().filter(|relation| **relation == 0).count();
            assert!((85..=95).contains(&first), "{first}");
        }
    }

    #[test]
    fn three_quarters_of_a_period_are_still_this_pictures() {
        let period = TICKS_PER_PICTURE.cast_signed();
        let learned = |offset: i32, residual: i32| {
            let mut pairing = Pairing {
                offset,
                ..Pairing::default()
            };
            pairing.update_offset(residual);
            pairing.offset
        };
        let edge = period * 3 / 4;
        for side in [-1, 1] {
            assert_eq!(learned(side * edge, 0), side * edge);
            assert_eq!(
                learned(side * edge, side * OFFSET_SMOOTHING),
                side * (edge + 1 - period)
            );
        }
    }
}
