//! Films without depth: YUV4MPEG2 streams (`.y4m`), from a file or through standard input.
//!
//! ```text
//! ffmpeg -i film.mp4 -pix_fmt gray -f yuv4mpegpipe - | mien run --source -
//! ```
//!
//! Format: yuv4mpeg(5) of mjpegtools. A line `YUV4MPEG2 W640 H480 F30:1 C420jpeg`, then for every frame a line that begins with `FRAME`
//! and its 8-bit planes, luma first; chroma is skipped. Interlacing, pixel aspect and comments are ignored. Images larger than a frame are
//! averaged down by an integer factor. The camera is unknown; [`assumed_view`] replaces its intrinsics.
//!
//! A read waits at most half a second, then reports a stall; the next one goes on where it stopped. So a pipe that delivers nothing cannot
//! keep a run from ending. Memory: the luma of one image, a line and 64 KiB, allocated after the header. Degenerate cases: an incomplete
//! last frame is skipped; the stream ends at data that is not a frame, because the next frame cannot be found. Limitation: limited-range
//! luma (16 to 235) is not stretched.

use std::fs::File;
use std::io::{self, BufRead, BufReader, ErrorKind, Read, Seek, SeekFrom};
use std::os::fd::{AsFd, AsRawFd};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use nix::poll::{PollFd, PollFlags, poll};

use super::NO_DEPTH;
use super::camera::{Camera, Distortion};
use super::picture_file::{Damage, Pixels, RecordingError, Skipped};
use super::reduction::{Reduction, SIZES, assumed_view};
use crate::kinect::frame::FrameSink;
use crate::sensor::{Sensor, SensorError, SensorState};
use mien_stages::base::bounded_read::{self, reason};
use mien_stages::base::time::Timestamp;

/// Longest line, bytes; headers of ffmpeg have about a hundred.
const LINE_MAX: usize = 1024;
/// Longest wait for a frame.
const WAIT: Duration = Duration::from_millis(500);
/// Bytes read at a time: the capacity of a pipe.
const BUFFER: usize = 1 << 16;
/// First word of a stream.
const MAGIC: &str = "YUV4MPEG2";
/// First bytes of a frame.
const FRAME: &[u8] = b"FRAME";
const NO_FRAME: Damage = Damage::Listed(
    "expected a line that begins with FRAME, found something else, and leaves out the rest; write the stream anew",
);
const ADVICE: &str = "write one with ffmpeg -i FILM -pix_fmt gray -f yuv4mpegpipe -";

/// The stream has delivered no frame in time.
#[derive(Debug, thiserror::Error)]
#[error(
    "no frame came through for half a second; is the program that writes the film still running?"
)]
struct Stalled;

/// The content of the first line.
#[derive(Debug, PartialEq)]
struct Header {
    size: [usize; 2],
    /// Frames per second, as a fraction.
    rate: [u32; 2],
    /// Bytes of a frame, luma and chroma.
    bytes: usize,
}

impl Header {
    /// Parses the line.
    ///
    /// # Errors
    /// The problem, in a sentence.
    fn parse(line: &[u8]) -> Result<Self, String> {
        let text = String::from_utf8_lossy(line);
        let mut words = text.split_ascii_whitespace();
        if words.next() != Some(MAGIC) {
            let found: String = text.chars().take(MAGIC.len()).collect();
            return Err(match line {
                [] => format!(
                    "expected a film that begins with {MAGIC}, found no data; did the program that writes it fail?"
                ),
                _ => format!("expected a film that begins with {MAGIC}, found {found:?}; {ADVICE}"),
            });
        }
        if !line.ends_with(b"\n") {
            return Err(format!(
                "expected a header of at most {LINE_MAX} bytes that ends with a line break, found none; {ADVICE}"
            ));
        }
        let mut tags = [None; 4];
        for word in words {
            let (name, value) = word.split_at_checked(1).unwrap_or((word, ""));
            if let Some(known) = ["W", "H", "F", "C"].iter().position(|tag| *tag == name) {
                tags[known] = Some(value);
            }
        }
        let [columns, rows, rate, planes] = tags;
        let found = |tag: Option<&str>| tag.unwrap_or("nothing").to_owned();
        let side = |tag: Option<&str>| tag?.parse().ok().filter(|side| SIZES.contains(side));
        let size = side(columns).zip(side(rows)).ok_or_else(|| {
            let (least, most, columns, rows) = (SIZES.start(), SIZES.end(), found(columns), found(rows));
            format!("expected a width W and a height H of {least} to {most} pixels in the header, found {columns} and {rows}; scale the film with ffmpeg -vf scale=1280:-2")
        })?;
        let count = |text: &str| text.parse().ok().filter(|count| *count > 0);
        let fraction = rate.and_then(|rate| rate.split_once(':'));
        let rate = fraction.and_then(|(over, under)| Some([count(over)?, count(under)?]));
        let rate = rate.ok_or_else(|| {
            let found = found(tags[2]);
            format!("expected frames per second such as F30:1 in the header, found {found}; name them with ffmpeg -r 30")
        })?;
        let (width, height) = size;
        let chroma = match planes.unwrap_or("420") {
            "420" | "420jpeg" | "420mpeg2" | "420paldv" => {
                2 * width.div_ceil(2) * height.div_ceil(2)
            }
            "411" => 2 * width.div_ceil(4) * height,
            "422" => 2 * width.div_ceil(2) * height,
            "444" => 2 * width * height,
            "444alpha" => 3 * width * height,
            "mono" => 0,
            other => {
                return Err(format!(
                    "expected planes of 8 bits (C420, C422, C444 or Cmono) in the header, found C{other}; add -pix_fmt gray to ffmpeg"
                ));
            }
        };
        Ok(Self {
            size: [width, height],
            rate,
            bytes: width * height + chroma,
        })
    }

    /// Time of a frame since the first one.
    fn time(&self, number: u64) -> Timestamp {
        let [over, under] = self.rate.map(u128::from);
        Timestamp::from_us((u128::from(number) * under * 1_000_000 / over) as u64)
    }
}

/// A file or pipe whose reads fail with [`ErrorKind::TimedOut`] once a given time has passed.
struct Timed {
    file: File,
    until: Instant,
}

impl Read for Timed {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        let left = self.until.saturating_duration_since(Instant::now());
        let mut polled = [PollFd::new(self.file.as_raw_fd(), PollFlags::POLLIN)];
        // A signal ends the wait early, so that the caller can react to it. Files are always ready.
        match poll(&mut polled, left.as_millis() as i32) {
            Ok(1..) => self.file.read(into),
            _ => Err(ErrorKind::TimedOut.into()),
        }
    }
}

impl Seek for Timed {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.file.seek(to)
    }
}

fn is_stall(problem: &io::Error) -> bool {
    // Another program that shares the pipe may have made it non-blocking.
    let kinds = [
        ErrorKind::TimedOut,
        ErrorKind::WouldBlock,
        ErrorKind::Interrupted,
    ];
    kinds.contains(&problem.kind())
}

/// A film that is being played.
pub struct Y4m {
    /// Its name in messages.
    name: PathBuf,
    stream: BufReader<Timed>,
    header: Header,
    reduction: Reduction,
    camera: Camera,
    /// The line being read.
    line: Vec<u8>,
    luma: Vec<u8>,
    /// Number of bytes read of the frame after its line; `None` until the line is complete.
    done: Option<usize>,
    /// Number of the next frame.
    next: u64,
    skipped: Skipped,
    /// Whether the present stall has been logged.
    stall_logged: bool,
    ended: bool,
    /// Number of frames of a file; the offset of the first one and the distance to the next, bytes.
    frames: usize,
    layout: [u64; 2],
}

impl Y4m {
    /// Opens the film in a file.
    ///
    /// # Errors
    /// If it cannot be read or its header is unusable.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let problem = |problem: io::Error| {
            let advice = "check the path, or give a pipe as standard input with --source -";
            RecordingError(
                path.to_owned(),
                format!("cannot be read ({}); {advice}", reason(&problem)),
            )
        };
        let file = bounded_read::open_regular(path).map_err(problem)?;
        let length = file.metadata().map_err(problem)?.len();
        let mut film = Self::new(file, path)?;
        let first = film.stream.stream_position().map_err(problem)?;
        // The line of a frame may have parameters, which are taken to be the same in all frames.
        let ahead = film.stream.fill_buf().map_err(problem)?;
        let line = ahead.iter().position(|byte| *byte == b'\n');
        let line = line.map_or(FRAME.len() + 1, |at| at + 1);
        let every = (line + film.header.bytes) as u64;
        film.frames = length.saturating_sub(first).div_ceil(every) as usize;
        film.layout = [first, every];
        Ok(film)
    }

    /// Waits for the film at standard input.
    ///
    /// # Errors
    /// If it is a terminal or closed, or the header is unusable.
    pub fn standard_input() -> Result<Self, RecordingError> {
        let (stdin, name) = (io::stdin(), Path::new("standard input"));
        if io::IsTerminal::is_terminal(&stdin) {
            return Err(RecordingError(
                name.to_owned(),
                format!("expected a film through a pipe, found a terminal; {ADVICE}"),
            ));
        }
        let owned = stdin.as_fd().try_clone_to_owned();
        let file = owned.map_err(|problem| RecordingError::from_io(name, &problem))?;
        Self::new(file.into(), name)
    }

    fn new(file: File, name: &Path) -> Result<Self, RecordingError> {
        let fails = |problem| RecordingError(name.to_owned(), problem);
        let until = Instant::now() + WAIT;
        let mut stream = BufReader::with_capacity(BUFFER, Timed { file, until });
        let mut line = Vec::with_capacity(LINE_MAX);
        // Signals still end the program here, so the wait needs no limit.
        while let Err(problem) = read_line(&mut stream, &mut line) {
            if !is_stall(&problem) {
                return Err(fails(format!(
                    "cannot be read ({}); {ADVICE}",
                    reason(&problem)
                )));
            }
            if stream.get_ref().until == until {
                tracing::info!("{}: waiting for a film", name.display());
            }
            stream.get_mut().until = Instant::now() + WAIT;
        }
        let header = Header::parse(&line).map_err(fails)?;
        line.clear();
        let reduction = Reduction::new(header.size);
        let view = reduction.averaged(assumed_view(header.size));
        Ok(Self {
            name: name.to_owned(),
            stream,
            camera: Camera::without_depth(view, Distortion::default(), reduction.frame_size()),
            luma: vec![0; header.size[0] * header.size[1]],
            header,
            reduction,
            line,
            done: None,
            next: 0,
            skipped: Skipped::default(),
            stall_logged: false,
            ended: false,
            frames: 0,
            layout: [0; 2],
        })
    }

    /// Reads the luma of the next frame, or the rest of it after a stall; `false` at the end of the stream.
    fn read(&mut self) -> Result<bool, Damage> {
        self.stream.get_mut().until = Instant::now() + WAIT;
        let mut done = match self.done {
            Some(done) => done,
            None => {
                read_line(&mut self.stream, &mut self.line)?;
                if self.line.is_empty() {
                    return Ok(false);
                }
                let is_whole = self.line.ends_with(b"\n");
                if !is_whole && self.line.len() < LINE_MAX {
                    return Err(Damage::Short);
                }
                if !is_whole || !self.line.starts_with(FRAME) {
                    return Err(NO_FRAME);
                }
                self.line.clear();
                0
            }
        };
        while done < self.header.bytes {
            self.done = Some(done);
            let ahead = self.stream.fill_buf()?;
            if ahead.is_empty() {
                return Err(Damage::Short);
            }
            let some = ahead.len().min(self.header.bytes - done);
            if let Some(luma) = self.luma.get_mut(done..) {
                let some = some.min(luma.len());
                luma[..some].copy_from_slice(&ahead[..some]);
            }
            self.stream.consume(some);
            done += some;
        }
        self.done = None;
        Ok(true)
    }
}

/// Continues to read to the end of the line or the stream, or until `line` has [`LINE_MAX`] bytes; `line` keeps what was read before an error.
fn read_line(stream: &mut BufReader<Timed>, line: &mut Vec<u8>) -> io::Result<()> {
    let room = (LINE_MAX - line.len()) as u64;
    stream.take(room).read_until(b'\n', line).map(drop)
}

impl Sensor for Y4m {
    fn next_frame(&mut self, into: &mut dyn FrameSink) -> Result<bool, SensorError> {
        if self.ended {
            return Ok(false);
        }
        match self.read() {
            Ok(true) => self.stall_logged = false,
            Ok(false) => {
                self.ended = true;
                return Ok(false);
            }
            Err(Damage::Unreadable(problem)) if is_stall(&problem) => {
                if !std::mem::replace(&mut self.stall_logged, true) {
                    tracing::warn!("{}: {Stalled}", self.name.display());
                }
                return Err(SensorError::new(Stalled));
            }
            Err(damage) => {
                self.skipped.add(self.next as usize, &self.name, &damage);
                self.ended = true;
                return Ok(false);
            }
        }
        let (frame, original) = into.parts();
        let pixels = Pixels::grey(self.header.size[0], &self.luma);
        pixels.brightness(&self.reduction, 255, &mut frame.luma);
        frame.has_colour = true;
        frame.depth.fill(NO_DEPTH);
        (frame.index, frame.at) = (self.next, self.header.time(self.next));
        self.next += 1;
        if let Some(original) = original {
            original.set_grey(frame);
        }
        Ok(true)
    }

    fn camera(&self) -> &Camera {
        &self.camera
    }

    fn luma_size(&self) -> [usize; 2] {
        self.reduction.frame_size()
    }

    fn state(&self) -> SensorState {
        SensorState {
            frames: self.frames,
            skipped: self.skipped.0,
            reduced: [self.reduction.factor; 2],
            ..SensorState::default()
        }
    }

    fn seek(&mut self, number: usize) {
        let ([first, every], number) = (self.layout, number.min(self.frames) as u64);
        // A pipe cannot seek.
        if self.frames > 0 {
            let sought = self.stream.seek(SeekFrom::Start(first + number * every));
            (self.next, self.done, self.ended) = (number, None, sought.is_err());
            self.line.clear();
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::{PipeWriter, Write};
    use std::os::fd::OwnedFd;

    use super::*;
    use crate::Frame;
    use mien_stages::base::capacity::WIDTH;

    /// A film through a pipe that begins with `bytes`, and the pipe's other end.
    fn piped(bytes: &[u8]) -> (Result<Y4m, RecordingError>, PipeWriter) {
        let (reader, mut writer) = io::pipe().unwrap();
        writer.write_all(bytes).unwrap();
        let film = Y4m::new(OwnedFd::from(reader).into(), Path::new("film"));
        (film, writer)
    }

    /// A frame of 64 × 64 pixels of this luma, without chroma.
    fn grey(luma: u8) -> Vec<u8> {
        [b"FRAME\n".as_slice(), &[luma; 64 * 64]].concat()
    }

    const SMALL: &[u8] = b"YUV4MPEG2 W64 H64 F25:1 Cmono\n";

    #[test]
    fn a_header_gives_size_rate_and_bytes_of_a_frame() {
        let ffmpeg = b"YUV4MPEG2 W1281 H721 F30000:1001 Ip A1:1 C420jpeg XYSCSS=420JPEG XCOLORRANGE=LIMITED\n";
        let header = Header::parse(ffmpeg).unwrap();
        // Chroma of 641 × 361 pixels, twice.
        let expected = Header {
            size: [1281, 721],
            rate: [30000, 1001],
            bytes: 1281 * 721 + 2 * 641 * 361,
        };
        assert_eq!(header, expected);
        assert_eq!(header.time(0).as_us(), 0);
        assert_eq!(header.time(2).as_us(), 66_733);
        // A day.
        assert_eq!(header.time(2_592_000).as_us(), 86_486_400_000);
        for (planes, bytes) in [
            ("", 96 * 64 * 3 / 2),
            (" C420mpeg2", 96 * 64 * 3 / 2),
            (" C411", 96 * 64 * 3 / 2),
            (" C422", 96 * 64 * 2),
            (" C444", 96 * 64 * 3),
            (" C444alpha", 96 * 64 * 4),
            (" Cmono", 96 * 64),
        ] {
            let line = format!("YUV4MPEG2 F25:1 H64 W96{planes}\n");
            assert_eq!(
                Header::parse(line.as_bytes()).unwrap().bytes,
                bytes,
                "{line}"
            );
        }
    }

    #[test]
    fn what_is_no_usable_header_gets_a_sentence() {
        for (line, expected) in [
            ("", "found no data; did the program that writes it fail?"),
            (
                "RIFFxxxxAVI LIST",
                "begins with YUV4MPEG2, found \"RIFFxxxxA\"; write one with ffmpeg -i FILM",
            ),
            (
                "YUV4MPEG2 W64 H64 F25:1",
                "ends with a line break, found none",
            ),
            (
                "YUV4MPEG2 W63 H64 F25:1\n",
                "of 64 to 8192 pixels in the header, found 63 and 64; scale",
            ),
            (
                "YUV4MPEG2 W64 H9999999999999999999999 F25:1\n",
                "found 64 and 9999999999999999999999",
            ),
            ("YUV4MPEG2 W64 F25:1\n", "found 64 and nothing"),
            (
                "YUV4MPEG2 W64 H64\n",
                "such as F30:1 in the header, found nothing",
            ),
            (
                "YUV4MPEG2 W64 H64 F0:0\n",
                "found 0:0; name them with ffmpeg -r 30",
            ),
            (
                "YUV4MPEG2 W64 H64 F25:1 C420p10\n",
                "found C420p10; add -pix_fmt gray",
            ),
            ("YUV4MPEG2 W64 H64 F25:1 Cmono16\n", "found Cmono16"),
        ] {
            let said = Header::parse(line.as_bytes()).unwrap_err();
            assert!(said.contains(expected) && !said.contains('\n'), "{said}");
        }
        let (film, writer) = piped(b"YUV4MPEG2 W64 H64 F25:1 C420p12\nFRAME\n");
        drop(writer);
        let said = film.err().unwrap().to_string();
        assert!(
            said.starts_with("film: expected planes of 8 bits"),
            "{said}"
        );
    }

    #[test]
    fn luma_is_averaged_and_chroma_skipped() {
        // Three by three pixels to one: 30, 60 and 60 in every row.
        let row = |first: u8| -> Vec<u8> {
            let cols = (0..1283).map(|col| if col % 3 == 0 { 30 } else { 60 });
            cols.map(|luma| luma + first).collect()
        };
        let bytes = [0, 7].map(|first| {
            let chroma = vec![200; 2 * 642 * 64];
            [b"FRAME Ip\n".to_vec(), row(first).repeat(64), chroma].concat()
        });
        let (film, mut writer) = piped(b"YUV4MPEG2 W1283 H64 F30000:1001 C422\n");
        let mut film = film.unwrap();
        let writing = std::thread::spawn(move || {
            writer.write_all(&bytes.concat()).unwrap();
        });
        assert_eq!(film.luma_size(), [427, 21]);
        let mut read = Frame::default();
        for (number, at, luma) in [(0, 0, 50), (1, 33_366, 57)] {
            read.depth.fill(700);
            assert!(film.next_frame(&mut read).unwrap());
            assert_eq!((read.index, read.at.as_us()), (number, at));
            assert!(read.has_colour && !film.camera().measures(&*read.depth));
            assert!(read.luma.iter().all(|&found| found == luma));
        }
        assert!(!film.next_frame(&mut read).unwrap());
        assert_eq!((film.state().skipped, film.state().reduced), (0, [3, 3]));
        writing.join().unwrap();
    }

    #[test]
    fn a_pipe_that_stalls_says_so_in_time_and_goes_on_where_it_stopped() {
        let (film, mut writer) = piped(SMALL);
        let (mut film, mut read) = (film.unwrap(), Frame::default());
        let whole = grey(90);
        // The stall is in the line, then in the pixels.
        for part in [&whole[..3], &whole[3..2000]] {
            writer.write_all(part).unwrap();
            let began = Instant::now();
            let said = film.next_frame(&mut read).unwrap_err().to_string();
            let waited = began.elapsed().as_secs_f64();
            assert!((0.4..2.0).contains(&waited), "{waited} s");
            assert!(said.contains("half a second; is the program"), "{said}");
        }
        writer.write_all(&whole[2000..]).unwrap();
        assert!(film.next_frame(&mut read).unwrap());
        assert_eq!((read.index, read.luma[63 * WIDTH + 63]), (0, 90));
        // The stream ends within a frame.
        writer.write_all(&whole[..4000]).unwrap();
        drop(writer);
        for _ in 0..2 {
            assert!(!film.next_frame(&mut read).unwrap());
        }
        assert_eq!(film.state().skipped, 1);
    }

    #[test]
    fn what_is_no_frame_ends_the_stream_and_is_counted() {
        let bytes = [SMALL, &grey(1), b"FRIES\n", &grey(2)].concat();
        let long = [
            SMALL,
            &grey(1),
            b"FRAME",
            &[b'-'; LINE_MAX],
            b"\n",
            &grey(2),
        ]
        .concat();
        let cut = [SMALL, &grey(1), b"FRAM"].concat();
        for bytes in [bytes, long, cut] {
            let (film, writer) = piped(&bytes);
            drop(writer);
            let (mut film, mut read) = (film.unwrap(), Frame::default());
            assert!(film.next_frame(&mut read).unwrap());
            assert!(!film.next_frame(&mut read).unwrap());
            assert_eq!((read.luma[0], film.state().skipped), (1, 1));
        }
    }
}
