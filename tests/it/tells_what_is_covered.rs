//! Promise: what a mask or dark glasses cover gives no weights, from the first frame on and when they are put on; the rest of the
//! face goes on, the head keeps its pose, and what is uncovered is back within a second.

use mien_appliance::pipeline::Pipeline;
use mien_appliance::settings::Settings;
use mien_sensors::Frame;
use mien_simulator::virtual_head::{HeadAsset, Scene, Simulator};
use mien_stages::base::capacity::{HEIGHT, LANDMARKS, WIDTH};
use mien_stages::base::geometry::Rotation;
use mien_stages::base::time::Timestamp;
use mien_stages::expression::Units;
use mien_stages::expression::regions::RegionSet;
use mien_stages::face_model::FaceModel;

/// What covers the face.
#[derive(Clone, Copy, PartialEq)]
enum Cover {
    /// A flat area of this grey level from the bridge of the nose to the jaw.
    Mask(u8),
    /// Two black ellipses over the eyes.
    Glasses,
}

/// Region of each cover among `Landmarks::seen`, and the names of units that it hides.
fn hidden(cover: Cover) -> (&'static [usize], &'static [&'static str]) {
    match cover {
        Cover::Mask(_) => (
            &[5],
            &[
                "AU25", "AU26", "AU12L", "AU12R", "AU15L", "AU15R", "AU20", "AU18",
            ],
        ),
        Cover::Glasses => (
            &[2, 3],
            &[
                "AU43L", "AU43R", "AU5L", "AU5R", "AU2L", "AU2R", "AU61", "AU62",
            ],
        ),
    }
}

/// Whether `point` is inside the convex or concave outline.
fn is_inside(outline: &[[f32; 2]], [x, y]: [f32; 2]) -> bool {
    let mut inside = false;
    for (k, [x0, y0]) in outline.iter().enumerate() {
        let [x1, y1] = outline[(k + 1) % outline.len()];
        if (y0 > &y) != (y1 > y) && x < (x1 - x0) * (y - y0) / (y1 - y0) + x0 {
            inside = !inside;
        }
    }
    inside
}

fn paint(frame: &mut Frame, points: &[[f32; 2]; LANDMARKS], cover: Cover) {
    let mut fill = |is_covered: &dyn Fn([f32; 2]) -> bool, level: u8| {
        for row in 0..HEIGHT {
            for col in 0..WIDTH {
                if is_covered([col as f32, row as f32]) {
                    frame.luma[row * WIDTH + col] = level;
                }
            }
        }
    };
    match cover {
        Cover::Mask(level) => {
            let outline: Vec<[f32; 2]> = (2..15).chain([28]).map(|k| points[k]).collect();
            fill(&|at| is_inside(&outline, at), level);
        }
        Cover::Glasses => {
            for [a, b] in [[36, 39], [42, 45]] {
                let middle = [0, 1].map(|k| 0.5 * (points[a][k] + points[b][k]));
                let radius = 0.85 * (points[a][0] - points[b][0]).abs();
                let inside = |[x, y]: [f32; 2]| {
                    ((x - middle[0]) / radius).powi(2) + ((y - middle[1]) / (0.75 * radius)).powi(2)
                        < 1.0
                };
                fill(&inside, 12);
            }
        }
    }
}

/// One frame of the person with and without the cover.
struct Both {
    seconds: f32,
    seen: [f32; 6],
    /// Largest weight of a unit that the cover hides.
    loudest: f32,
    /// Rotation between the two poses, degrees.
    turned_deg: f32,
    /// Largest AU of the seen regions on the free face, and the same unit's weight with the cover.
    seen_unit: [f32; 2],
}

/// Plays the acted scene for `seconds`; the cover is worn where `worn` says so.
fn play(cover: Cover, seconds: f32, worn: impl Fn(f32) -> bool) -> Vec<Both> {
    let mut simulator = Simulator::new(HeadAsset::shipped(), Scene::Acted, 5);
    let camera = simulator.camera().clone();
    let model = FaceModel::shipped();
    let pipeline = || Pipeline::new(&Settings::default().stages, &camera, &model).expect("stages");
    let (mut free, mut covered) = (pipeline(), pipeline());
    let units = Units::shipped().columns(false);
    let (regions, names) = hidden(cover);
    let mut frame = Frame::default();
    let mut both = Vec::new();
    for number in 0..(seconds * 30.0) as u64 {
        let at = number as f32 / 30.0;
        simulator.draw(Timestamp::from_us(number * 1_000_000 / 30), &mut frame);
        free.follow(&frame);
        let bare = free.report();
        if let Some(points) = bare.landmarks.filter(|_| worn(at)) {
            paint(&mut frame, &points.pixels, cover);
        }
        covered.follow(&frame);
        let report = covered.report();
        let (Some(landmarks), Some(own), Some(other)) = (
            report.landmarks,
            report.sensor_from_face,
            bare.sensor_from_face,
        ) else {
            continue;
        };
        let weight = |name: &str| {
            let column = units.iter().position(|unit| unit == name).expect("a unit");
            report.weights[column]
        };
        let mut seen_unit = [0.0; 2];
        for (k, unit) in units.iter().enumerate() {
            let mut all = [1.0; 6];
            regions.iter().for_each(|&region| all[region] = 0.0);
            if RegionSet::of_unit(unit).seen(&all) == 1.0 && bare.weights[k] > seen_unit[0] {
                seen_unit = [bare.weights[k], report.weights[k]];
            }
        }
        both.push(Both {
            seconds: at,
            seen: landmarks.seen,
            loudest: names.iter().map(|name| weight(name)).fold(0.0, f32::max),
            turned_deg: Rotation::angle_to(&own.rotation, &other.rotation).to_degrees(),
            seen_unit,
        });
    }
    both
}

#[test]
fn a_cover_worn_from_the_start_hides_what_is_under_it_and_nothing_else() {
    for cover in [
        Cover::Mask(230),
        Cover::Mask(90),
        Cover::Mask(20),
        Cover::Glasses,
    ] {
        let frames = play(cover, 20.0, |_| true);
        assert!(frames.len() > 560, "{} frames with a face", frames.len());
        let (regions, _) = hidden(cover);
        let late: Vec<&Both> = frames.iter().filter(|frame| frame.seconds > 1.0).collect();
        for frame in &late {
            assert!(
                frame.loudest < 0.15,
                "{} at {} s",
                frame.loudest,
                frame.seconds
            );
            for region in 0..6 {
                // The nose is partly under a mask.
                if matches!(cover, Cover::Mask(_)) && region == 4 {
                    continue;
                }
                let is_hidden = regions.contains(&region);
                assert_eq!(
                    frame.seen[region] < 0.5,
                    is_hidden,
                    "region {region} at {} s",
                    frame.seconds
                );
            }
        }
        let turned = late.iter().map(|frame| frame.turned_deg).sum::<f32>() / late.len() as f32;
        // Nothing else tells the face's pose in this head; 4.2° with black glasses.
        assert!(turned < 5.0, "turned by {turned}°");
    }
}

#[test]
fn a_cover_put_on_is_noticed_and_taken_off_it_leaves_nothing() {
    for cover in [Cover::Mask(200), Cover::Glasses] {
        let frames = play(cover, 20.0, |at| (8.0..14.0).contains(&at));
        let (regions, _) = hidden(cover);
        for frame in &frames {
            let seconds = frame.seconds;
            let is_seen = regions.iter().all(|&region| frame.seen[region] > 0.5);
            match seconds {
                ..8.0 | 15.0.. => assert!(is_seen, "{seconds} s"),
                8.8..14.0 => {
                    assert!(!is_seen, "{seconds} s");
                    assert!(frame.loudest < 0.15, "{} at {seconds} s", frame.loudest);
                    assert!(
                        frame.turned_deg < 1.0,
                        "{}° at {seconds} s",
                        frame.turned_deg
                    );
                }
                _ => {}
            }
        }
        // What can be seen goes on: a clear expression reads at least half of what it reads on the free face.
        let acted = frames
            .iter()
            .filter(|frame| (9.0..14.0).contains(&frame.seconds));
        let clear: Vec<[f32; 2]> = acted
            .map(|frame| frame.seen_unit)
            .filter(|unit| unit[0] > 0.6)
            .collect();
        let kept = clear
            .iter()
            .filter(|[bare, covered]| *covered > 0.5 * bare)
            .count();
        assert!(
            5 * kept >= 4 * clear.len(),
            "{kept} of {} frames",
            clear.len()
        );
    }
}
