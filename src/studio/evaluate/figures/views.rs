//! Figures that show what the sensor sees.

use image::RgbImage;

use super::error::FiguresError;
use super::pictures::{crop, draw_points, title};
use super::subjects::Studio;
use crate::base::geometry::{Point, Rigid, rotation_from_yaw_pitch_roll, yaw_pitch_roll};
use crate::sensor::kinect::frame::KinectFrame;
use crate::simulator::virtual_head::{Held, Look, Scene, Simulator};
use crate::studio::bake::render::sheet;
use crate::studio::frame_time::frame_time;
use crate::studio::inspect::draw_axes;

/// Half of what is shown of a picture, colour pixels.
const HALF: [u32; 2] = [80, 95];

/// Fig. 14: before, under and after a hand over the mouth; the paper's system above, the default below.
pub(super) fn hand(studio: &Studio<'_>, say: &mut dyn FnMut(&str)) -> Result<(), FiguresError> {
    const SHOWN_S: [f64; 5] = [6.6, 7.0, 7.6, 8.1, 8.8];
    let look = Look {
        held: Held::Mouth,
        ..Look::demonstration()
    };
    let asset = studio.heads[0].asset.clone();
    let mut simulator = Simulator::new(asset, Scene::Acted, 14).dressed([look]);
    let mut pipelines = studio.pipelines(&simulator)?;
    let mut rows: Vec<Vec<RgbImage>> = vec![Vec::new(); pipelines.len()];
    let mut frame = KinectFrame::default();
    let last = (SHOWN_S[SHOWN_S.len() - 1] * 30.0) as i64;
    for n in 0..=last {
        let Some(truth) = simulator.draw(frame_time(n), &mut frame) else {
            continue;
        };
        let shown = SHOWN_S.iter().find(|s| (**s * 30.0) as i64 == n);
        for (k, (name, pipeline)) in pipelines.iter_mut().enumerate() {
            pipeline.follow(&frame);
            let Some(seconds) = shown else { continue };
            let report = pipeline.report();
            let mut picture = crop(&frame, truth.landmarks_px[30], HALF, |picture, place| {
                if let Some(found) = report.landmarks {
                    draw_points(picture, found, place);
                }
            });
            title(
                &mut picture,
                &format!("{name} {seconds:.1} s {}", report.state.name()),
            );
            rows[k].push(picture);
        }
    }
    say(&studio.save("hand", &sheet(&rows.concat(), SHOWN_S.len() as u32))?);
    Ok(())
}

/// Fig. 18: the ends of yaw and pitch, with what is found there.
pub(super) fn poses(studio: &Studio<'_>, say: &mut dyn FnMut(&str)) -> Result<(), FiguresError> {
    const ENDS_DEG: [[f32; 2]; 5] = [
        [0.0, 0.0],
        [-25.0, 0.0],
        [25.0, 0.0],
        [0.0, -15.0],
        [0.0, 15.0],
    ];
    /// Frames on the way from the front, and at the end.
    const WAY: usize = 25;
    const STAYS: usize = 6;
    let asset = studio.heads[0].asset.clone();
    let mut rows: Vec<Vec<RgbImage>> = vec![Vec::new(); studio.settings.len()];
    // Where a head's frame sits on a face is a convention: what is found from the front is taken for 0.
    let mut front = vec![Rigid::identity(); studio.settings.len()];
    for [yaw, pitch] in ENDS_DEG {
        let mut simulator = Simulator::new(asset.clone(), Scene::Still, 18);
        let mut pipelines = studio.pipelines(&simulator)?;
        let mut frame = KinectFrame::default();
        let mut truth = None;
        for n in 0..WAY + STAYS {
            let share = (n as f32 / WAY as f32).min(1.0);
            let [yaw, pitch] = [yaw, pitch].map(|angle: f32| (angle * share).to_radians());
            let turn = rotation_from_yaw_pitch_roll(yaw, pitch, 0.0);
            let pose = Rigid::from_parts(nalgebra::Translation3::new(0.0, -0.02, 0.7), turn);
            let at = frame_time(n as i64);
            truth = Some(simulator.draw_pose(&pose, &[], at, &mut frame));
            for (_, pipeline) in &mut pipelines {
                pipeline.follow(&frame);
            }
        }
        let Some(truth) = truth else { continue };
        for (k, (name, pipeline)) in pipelines.iter().enumerate() {
            let report = pipeline.report();
            let found = report.sensor_from_head.copied();
            if [yaw, pitch] == [0.0, 0.0]
                && let Some(found) = found
            {
                front[k] = truth.sensor_from_head.inverse() * found;
            }
            let found = found.map(|found| found * front[k].inverse());
            let mut picture = crop(&frame, truth.landmarks_px[30], HALF, |picture, place| {
                if let Some(points) = report.landmarks {
                    draw_points(picture, points, place);
                }
                if let Some(found) = &found {
                    let pixel = |p: &Point| place(simulator.camera().colour_pixel(p));
                    draw_axes(picture, found, pixel);
                }
            });
            let angles = found.map_or("lost".to_owned(), |found| {
                let (yaw, pitch, _) = yaw_pitch_roll(&found.rotation);
                let [yaw, pitch] = [yaw, pitch].map(|angle| angle.to_degrees() + 0.0);
                format!("{yaw:+.1} {pitch:+.1}")
            });
            say(&format!(
                "{name}: true {yaw:+.0} {pitch:+.0}, found {angles}"
            ));
            title(
                &mut picture,
                &format!("{name} {yaw:+.0} {pitch:+.0}: {angles}"),
            );
            rows[k].push(picture);
        }
    }
    say(&studio.save("poses", &sheet(&rows.concat(), ENDS_DEG.len() as u32))?);
    Ok(())
}
