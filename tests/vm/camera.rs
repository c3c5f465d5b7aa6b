//! Runs in the guest: a webcam or depth camera as the product opens it. Its images are the eight bars of the kernel's `vivid`, or the test
//! pattern of `virtual-uvc`, of which every pixel follows from the frame's number.
//!
//! `vm-camera FRAMES SECONDS SOURCE[:NAME] bars|pattern` ends after that many frames or seconds, and prints what was delivered and why
//! there was nothing. Exit code 1 if nothing came, a frame was wrong, or times or numbers did not rise.

use std::process::ExitCode;
use std::time::{Duration, Instant};

use mien_appliance::source::parts;
use mien_sensors::Frame;
use mien_sensors::sensor::Sensor;
use mien_sensors::table::SENSORS;
use mien_stages::base::capacity::WIDTH;

#[path = "../common/test_pattern.rs"]
mod test_pattern;

use test_pattern::NEAREST_MM;

/// Row below the text that `vivid` writes into its images.
const ROW: usize = 400;

/// Whether luma falls from bar to bar, from white to black, and is even within each.
fn has_bars(frame: &Frame) -> bool {
    let row = &frame.luma[ROW * WIDTH..][..WIDTH];
    let bars = row.chunks(WIDTH / 8).map(|bar| &bar[5..75]);
    let bars: Vec<[u8; 2]> = bars
        .map(|bar| [bar.iter().min(), bar.iter().max()].map(|luma| *luma.expect("70 columns")))
        .collect();
    let is_even = bars.iter().all(|[least, most]| most - least <= 3);
    is_even && bars.windows(2).all(|two| two[0][0] > two[1][1] + 3)
}

/// The number of the frame if luma and depth, as far as there are any, are the test pattern of that one number.
fn pattern_number(frame: &Frame, [columns, rows]: [usize; 2], has_depth: bool) -> Option<u64> {
    let luma = frame.luma.first_chunk().copied().map(u32::from_le_bytes);
    let depth = frame.depth.first_chunk().map(|first: &[u16; 4]| {
        u32::from_le_bytes(first.map(|mm| mm.wrapping_sub(NEAREST_MM) as u8))
    });
    let number = u64::from(if has_depth { depth? } else { luma? });
    let (mut luma, mut depth) = (vec![0; columns * rows], vec![0; columns * rows]);
    test_pattern::draw_luma(number, &mut luma);
    test_pattern::draw_depth(number, NEAREST_MM, &mut depth);
    let has_luma = !frame.has_colour || is_image(&frame.luma[..], columns, &luma);
    (has_luma && (!has_depth || is_image(&frame.depth[..], columns, &depth))).then_some(number)
}

/// Whether the upper left corner of a frame is this image.
fn is_image<T: PartialEq>(frame: &[T], columns: usize, image: &[T]) -> bool {
    let mut rows = frame.chunks(WIDTH).zip(image.chunks(columns));
    rows.all(|(row, expected)| row[..columns] == *expected)
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().collect();
    let number = |i: usize| arguments.get(i).and_then(|text| text.parse().ok());
    let (frames, seconds) = (number(1).unwrap_or(30), number(2).unwrap_or(60));
    let (kind, name) = parts(arguments.get(3).map_or("camera", String::as_str));
    let kind = SENSORS.iter().find(|known| known.name == kind);
    let kind = kind.expect("a row of the table");
    let has_depth = kind.name == "depth-camera";
    let has_pattern = arguments.get(4).is_some_and(|image| image == "pattern");
    let (mut camera, problem): (Box<dyn Sensor>, _) = (kind.open)(name, &Default::default());
    let mut waiting = problem.map(|problem| problem.to_string());
    if let Some(problem) = &waiting {
        println!("waiting {problem}");
    }
    let deadline = Instant::now() + Duration::from_secs(seconds);
    let mut frame = Frame::default();
    let (mut delivered, mut wrong, mut backwards) = (0_u64, 0_u64, 0_u64);
    let (mut without_luma, mut last_number) = (0_u64, None);
    let mut last = None;
    let mut steps_us = Vec::new();
    while delivered < frames && Instant::now() < deadline {
        if let Err(problem) = camera.next_frame(&mut frame) {
            let problem = Some(problem.to_string());
            if problem != waiting {
                println!("waiting {}", problem.as_deref().unwrap_or_default());
                waiting = problem;
            }
            continue;
        }
        if delivered == 0 {
            println!("first frame at {} us", frame.at.as_us());
        }
        delivered += 1;
        without_luma += u64::from(!frame.has_colour);
        if has_pattern {
            let number = pattern_number(&frame, camera.luma_size(), has_depth);
            wrong += u64::from(number.is_none());
            backwards += u64::from(number.is_some() && number <= last_number);
            last_number = number.or(last_number);
        } else {
            wrong += u64::from(!has_bars(&frame));
        }
        wrong += u64::from(camera.camera().measures(&*frame.depth) != has_depth);
        let at_us = frame.at.as_us();
        if let Some(last) = last.replace(at_us) {
            backwards += u64::from(at_us <= last);
            steps_us.push(at_us.saturating_sub(last));
        }
    }
    steps_us.sort_unstable();
    let [columns, rows] = camera.luma_size();
    let median_us = steps_us.get(steps_us.len() / 2).copied().unwrap_or(0);
    let longest_us = steps_us.last().copied().unwrap_or(0);
    println!(
        "camera delivered {delivered} of {columns} x {rows}, wrong {wrong}, out of order {backwards}, without luma {without_luma}, skipped {}, period {median_us} us, longest {longest_us} us",
        camera.state().skipped
    );
    ExitCode::from(u8::from(delivered == 0 || wrong > 0 || backwards > 0))
}
