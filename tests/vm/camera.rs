//! Runs in the guest: a webcam as the product opens it, whose images are the eight bars of the kernel's `vivid`.
//!
//! `vm-camera FRAMES SECONDS [NAME]` ends after that many frames or seconds, and prints what was delivered and why there was nothing.
//! Exit code 1 if nothing came, a picture was not the bars, or times did not rise.

use std::process::ExitCode;
use std::time::{Duration, Instant};

use mien_sensors::Frame;
use mien_sensors::sensor::Sensor;
use mien_sensors::table::SENSORS;
use mien_stages::base::capacity::WIDTH;

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

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().collect();
    let number = |i: usize| arguments.get(i).and_then(|text| text.parse().ok());
    let (frames, seconds) = (number(1).unwrap_or(30), number(2).unwrap_or(60));
    let kind = SENSORS.iter().find(|kind| kind.name == "camera");
    let kind = kind.expect("a row of the table");
    let name = arguments.get(3).map(String::as_str);
    let (mut camera, problem): (Box<dyn Sensor>, _) = (kind.open)(name, &Default::default());
    let mut waiting = problem.map(|problem| problem.to_string());
    if let Some(problem) = &waiting {
        println!("waiting {problem}");
    }
    let deadline = Instant::now() + Duration::from_secs(seconds);
    let mut frame = Frame::default();
    let (mut delivered, mut wrong, mut backwards) = (0_u64, 0_u64, 0_u64);
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
        wrong += u64::from(!has_bars(&frame) || camera.camera().measures(&*frame.depth));
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
        "camera delivered {delivered} of {columns} x {rows}, wrong {wrong}, out of order {backwards}, skipped {}, period {median_us} us, longest {longest_us} us",
        camera.state().skipped
    );
    ExitCode::from(u8::from(delivered == 0 || wrong > 0 || backwards > 0))
}
