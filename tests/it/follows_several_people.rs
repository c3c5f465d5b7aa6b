//! Promise: people are told apart while they sit side by side, pass each other, leave and come back; what is no face is
//! none; a hand before the face is held, then lost, then over. All without asking for memory after the start.

use mien_appliance::pipeline::Pipeline;
use mien_appliance::settings::Settings;
use mien_sensors::Frame;
use mien_simulator::virtual_head::{HeadAsset, Scene, Simulator};
use mien_stages::base::time::Timestamp;
use mien_stages::face_model::FaceModel;
use mien_stages::users::{Policy, TrackingState};

use crate::common::mien;

/// Who is where in a frame.
struct Seen {
    seconds: f64,
    /// Slot and state of each person of the scene, if they are reported.
    people: Vec<Option<(usize, TrackingState)>>,
    /// Reports of a face where nobody is.
    ghosts: usize,
}

/// Plays a scene with the shipped heads from `from` to `to` seconds, every `step`-th frame.
fn play(scene: Scene, settings: &Settings, [from, to]: [f64; 2], step: usize) -> Vec<Seen> {
    let mut simulator = Simulator::new(HeadAsset::shipped(), scene, 5);
    let (camera, model) = (simulator.camera().clone(), FaceModel::shipped());
    let mut pipeline = Pipeline::new(&settings.stages, &camera, &model).expect("stages");
    let mut frame = Frame::default();
    let frames = (from * 30.0) as u64..(to * 30.0) as u64;
    let seen = frames.step_by(step).map(|number| {
        let at = Timestamp::from_us(number * 1_000_000 / 30);
        simulator.draw(at, &mut frame);
        pipeline.follow(&frame);
        let truths: Vec<_> = simulator.truths().collect();
        let mut people = vec![None; truths.len()];
        let mut ghosts = 0;
        for report in &pipeline.reports() {
            let Some(pose) = report.sensor_from_face else {
                continue;
            };
            let near = truths.iter().position(|truth| {
                truth.is_some_and(|truth| {
                    let place = truth.sensor_from_head.translation.vector;
                    (place - pose.translation.vector).norm() < 0.1
                })
            });
            match near {
                Some(k) => people[k] = report.user.map(|user| (user, report.state)),
                None => ghosts += usize::from(report.state != TrackingState::Held),
            }
        }
        Seen {
            seconds: number as f64 / 30.0,
            people,
            ghosts,
        }
    });
    seen.collect()
}

/// Slots that a person was reported in, without repetition, in their order.
fn slots(seen: &[Seen], person: usize) -> Vec<usize> {
    let people = seen.iter().filter_map(|one| one.people[person]);
    let mut slots: Vec<usize> = people.map(|(slot, _)| slot).collect();
    slots.dedup();
    slots
}

#[test]
fn two_who_pass_each_other_keep_their_slots() {
    let seen = play(Scene::Crossing, &Settings::default(), [0.0, 6.0], 1);
    let both = [slots(&seen, 0), slots(&seen, 1)];
    assert!(both.iter().all(|slots| slots.len() == 1), "{both:?}");
    assert_ne!(both[0], both[1]);
    // They pass at 0 and 5 s; the one behind is hidden then.
    for one in &seen {
        let are_both = (0.7..4.4).contains(&one.seconds) || one.seconds >= 5.6;
        let Seen {
            seconds, people, ..
        } = one;
        assert!(!are_both || !people.contains(&None), "{seconds} {people:?}");
    }
    assert_eq!(seen.iter().map(|one| one.ghosts).sum::<usize>(), 0);
}

#[test]
fn who_comes_back_is_known_and_who_is_new_has_a_slot_of_their_own() {
    let seen = play(Scene::Swap, &Settings::default(), [3.0, 18.0], 1);
    // The first person is wholly in the picture again at 15 s, and known at the latest a second and a half later.
    let unsure = |one: &&Seen| !(14.0..16.6).contains(&one.seconds);
    let settled: Vec<Seen> = seen.into_iter().filter(|one| unsure(&one)).collect();
    assert_eq!([slots(&settled, 0), slots(&settled, 1)], [vec![0], vec![1]]);
    let back = settled.last().expect("frames").people[0];
    assert!(back.is_some(), "the first person was not found again");
    let seen = settled;
    assert_eq!(seen.iter().map(|one| one.ghosts).sum::<usize>(), 0);
}

#[test]
fn with_room_for_one_everybody_has_the_first_slot() {
    let mut settings = Settings::default();
    settings.stages.users.most = 1;
    let seen = play(Scene::Swap, &settings, [4.0, 10.0], 3);
    assert_eq!([slots(&seen, 0), slots(&seen, 1)], [vec![0], vec![0]]);
}

#[test]
fn a_hand_before_the_face_is_held_then_lost_and_the_face_is_found_again() {
    // The second of the three times: 0.9 s from 7 s on.
    let seen = play(Scene::Hand, &Settings::default(), [5.5, 9.0], 1);
    let state = |seconds: f64| {
        let one = seen.iter().find(|one| one.seconds >= seconds);
        one.expect("in the film").people[0].map(|(_, state)| state)
    };
    assert!(state(6.7).is_some_and(TrackingState::is_present));
    assert_eq!(state(7.3), Some(TrackingState::Held));
    // A lost face has no pose.
    assert_eq!(state(7.8), None);
    // Five frames after the hand is below the chin.
    let back = state(8.05 + 5.0 / 30.0);
    let is_back = back.is_some_and(|state| state != TrackingState::Held);
    assert!(is_back, "{back:?}");
    assert_eq!(slots(&seen, 0), [0]);
}

#[test]
fn furniture_and_people_from_behind_have_no_face() {
    for scene in [Scene::Furnished, Scene::Behind] {
        let seen = play(scene, &Settings::default(), [0.0, 2.0], 3);
        for one in &seen {
            let at = format!("{scene:?} at {} s", one.seconds);
            assert!(one.people.iter().all(Option::is_none), "{at}");
            assert_eq!(one.ghosts, 0, "{at}");
        }
    }
}

#[test]
fn four_are_followed_at_once_and_ask_for_no_memory_after_the_start() {
    let mut settings = Settings::default();
    settings.stages.users.single = Policy::Nearest;
    let seen = play(Scene::Four, &settings, [0.0, 0.8], 2);
    let last = seen.last().expect("frames");
    let found = last.people.iter().flatten();
    let mut found: Vec<usize> = found.map(|(slot, _)| *slot).collect();
    found.sort_unstable();
    assert_eq!(found, [0, 1, 2, 3]);

    let bench = mien("bench --source simulated:four --frames 15").output();
    let bench = bench.expect("the program runs");
    let text = String::from_utf8_lossy(&bench.stdout);
    assert!(text.contains("allocations_after_start 0"), "{text}");
}
