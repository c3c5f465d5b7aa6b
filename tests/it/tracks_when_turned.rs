//! Promise: a sensor on its side or upside down tracks as one that stands upright, by its accelerometer or by the configuration.

use std::f32::consts::FRAC_PI_2;
use std::path::Path;
use std::time::Duration;

use mien_appliance::pipeline::Pipeline;
use mien_appliance::settings::Settings;
use mien_appliance::source;
use mien_sensors::Frame;
use mien_sensors::kinect::device::Model;
use mien_sensors::kinect::driver::{Kinect, Settings as KinectSettings};
use mien_sensors::kinect::frame::KinectFrame;
use mien_sensors::kinect::live::LiveKinect;
use mien_sensors::kinect::recording::Recorder;
use mien_sensors::sensor::Sensor;
use mien_sensors::turned::upright;
use mien_simulator::simulated::Simulated;
use mien_simulator::virtual_head::{
    Appearance, HeadAsset, Light, Scene, Sensor as Mount, Simulator,
};
use mien_simulator::virtual_kinect::VirtualKinect;
use mien_stages::base::geometry::{Rigid, Rotation, Vector};
use mien_stages::face_model::FaceModel;
use mien_stages::turn::Turn;

use crate::common;

const FRAMES: usize = 300;
/// Frames until the face is found and the filters have settled.
const SETTLED: usize = 45;

/// Somebody who acts in front of a Kinect that is turned by so many quarters, with the light of the room staying where it is.
fn simulated(quarters: u8) -> Simulated {
    let turned = f32::from(quarters) * FRAC_PI_2;
    let light = Light::default();
    let towards = Rotation::from_axis_angle(&Vector::z_axis(), turned) * light.towards;
    let simulator = Simulator::new(HeadAsset::shipped(), Scene::Acted, 3)
        .dressed([Appearance::default()])
        .with_light(Light { towards, ..light }, 1.0)
        .with_sensor(Mount {
            turned,
            ..Mount::default()
        });
    Simulated::from(simulator)
}

/// Pose and weights of a face.
type Seen = (Rigid, Vec<f32>);
/// What each frame shows; `None` without a face.
type Run = Vec<Option<Seen>>;

fn play(mut source: Box<dyn Sensor>) -> Run {
    let model = FaceModel::shipped();
    let stages = Settings::default().stages;
    let mut pipeline = Pipeline::new(&stages, source.camera(), &model).expect("stages");
    let mut frame = Frame::default();
    (0..FRAMES)
        .map(|_| {
            assert!(source.next_frame(&mut frame).expect("a frame"));
            pipeline.follow(&frame);
            let report = pipeline.report();
            let pose = *report.sensor_from_face?;
            Some((pose, report.weights.to_vec()))
        })
        .collect()
}

/// Mean differences of two runs of the same act.
#[derive(Debug)]
struct Apart {
    faces: usize,
    rotation_deg: f32,
    position_mm: f32,
    weight: f32,
}

fn compare(one: &Run, other: &Run) -> Apart {
    let both = one.iter().zip(other).skip(SETTLED);
    let both: Vec<_> = both
        .filter_map(|(a, b)| a.as_ref().zip(b.as_ref()))
        .collect();
    let mean = |apart: &dyn Fn(&Seen, &Seen) -> f32| {
        both.iter().map(|(a, b)| apart(a, b)).sum::<f32>() / both.len() as f32
    };
    Apart {
        faces: both.len(),
        rotation_deg: mean(&|a, b| a.0.rotation.angle_to(&b.0.rotation).to_degrees()),
        position_mm: mean(&|a, b| 1e3 * (a.0.translation.vector - b.0.translation.vector).norm()),
        weight: mean(&|a, b| {
            let apart = a.1.iter().zip(&b.1).map(|(a, b)| (a - b).abs());
            apart.sum::<f32>() / a.1.len() as f32
        }),
    }
}

#[test]
fn a_turned_kinect_gives_the_poses_and_weights_of_an_upright_one() {
    let level = play(Box::new(simulated(0)));
    for (quarters, turn) in [
        (1, Turn::Quarter),
        (2, Turn::Half),
        (3, Turn::ThreeQuarters),
    ] {
        let turned = play(upright(Box::new(simulated(quarters)), Some(turn)));
        let apart = compare(&level, &turned);
        eprintln!("{} degrees: {apart:?}", turn.degrees());
        assert!(apart.faces > FRAMES - SETTLED - 3, "{turn:?}: {apart:?}");
        assert!(apart.rotation_deg < 1.0, "{turn:?}: {apart:?}");
        assert!(apart.position_mm < 2.0, "{turn:?}: {apart:?}");
        assert!(apart.weight < 0.05, "{turn:?}: {apart:?}");
    }
}

#[test]
fn an_accelerometer_says_what_could_be_configured() {
    for (quarters, turn) in [
        (1, Turn::Quarter),
        (2, Turn::Half),
        (3, Turn::ThreeQuarters),
    ] {
        let mut asked = upright(Box::new(simulated(quarters)), None);
        let mut told = upright(Box::new(simulated(quarters)), Some(turn));
        assert!(asked.camera() == told.camera(), "{turn:?}");
        let mut frames = [Frame::default(), Frame::default()];
        assert!(asked.next_frame(&mut frames[0]).expect("a frame"));
        assert!(told.next_frame(&mut frames[1]).expect("a frame"));
        let [asked, told] = frames;
        assert!(
            asked.depth == told.depth && asked.luma == told.luma,
            "{turn:?}"
        );
    }
}

#[test]
fn the_driver_asks_the_accelerometer_of_every_model() {
    for model in [Model::Xbox1414, Model::Xbox1473, Model::Windows1517] {
        let mut device = VirtualKinect::new(model, "A", |_: &mut KinectFrame| true);
        device.camera.acceleration = [-812, 33, -70];
        let mut kinect = Kinect::open(device, KinectSettings::default()).expect("a Kinect");
        assert_eq!(kinect.acceleration, Some([-812, 33, -70]), "{model}");
        // Nothing is left over for the next message.
        kinect.tilt(5.0).expect("a motor");
    }
}

#[test]
fn a_live_kinect_is_turned_as_it_is_found() {
    let open = || {
        let mut device = VirtualKinect::new(Model::Xbox1414, "A", |_: &mut KinectFrame| true);
        device.camera.acceleration = [819, 0, 40];
        Ok(device)
    };
    let mut live = LiveKinect::with_source(open, KinectSettings::default());
    let status = live.wait_for_first_attempt(Duration::from_secs(10));
    assert_eq!(status.openings, 1);
    let native = live.camera.clone();
    let source = upright(Box::new(live), None);
    let expected = native.turned(Turn::ThreeQuarters, [640, 480]);
    assert!(*source.camera() == expected);
    assert!(source.state().is_live && source.luma_size() == [480; 2]);
}

/// Records the first frames of a turned Kinect as `mien-studio record` does.
fn record(folder: &Path, quarters: u8) {
    let mut source = simulated(quarters);
    let registration = source.registration().clone();
    let mut recorder = Recorder::create(folder, &registration, 1.0e9).expect("a folder");
    let axes = source.acceleration().expect("an accelerometer");
    recorder.write_acceleration(axes).expect("space");
    let mut frame = KinectFrame::default();
    for _ in 0..90 {
        source.next_frame(&mut frame);
        recorder.write(&frame).expect("space");
    }
}

/// Frames that `mien run` writes of a recording with a face turned by less than 46° from upright and frontal.
fn upright_faces(folder: &Path, turned: &str) -> usize {
    let config = folder.join("mien.toml");
    std::fs::write(&config, format!("[sensor]\nturned = {turned}\n")).expect("space");
    let mut run = common::mien("run --fast --csv - --source");
    let output = run.arg(folder).arg("--config").arg(&config).output();
    let output = output.expect("mien runs");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    let is_logged = said.contains("the sensor is turned by 90 degrees");
    assert_eq!(is_logged, turned != "0", "{said}");
    let table = String::from_utf8(output.stdout).expect("text");
    let names: Vec<&str> = table.lines().next().expect("a header").split(',').collect();
    let column = |name| names.iter().position(|known| *known == name);
    let [state, qw] = ["state", "qw"].map(|name| column(name).expect("a column"));
    let upright = |row: &&str| {
        let fields: Vec<&str> = row.split(',').collect();
        let has_face = ["warming", "tracking"].contains(&fields[state]);
        has_face && fields[qw].parse().is_ok_and(|qw: f32| qw.abs() > 0.92)
    };
    table.lines().skip(1).filter(upright).count()
}

#[test]
fn a_recording_says_how_its_sensor_was_turned() {
    let folder = tempfile::tempdir().expect("a folder");
    record(folder.path(), 1);
    assert!(
        source::recording(folder.path())
            .unwrap()
            .acceleration()
            .is_some()
    );
    let found = ["\"auto\"", "90", "0"].map(|turned| upright_faces(folder.path(), turned));
    assert!(found[0] > 80 && found[0] == found[1], "{found:?}");
    assert!(found[2] == 0, "{found:?}");
    // Damaged or missing, it counts as upright, and the recording still plays.
    let index = std::fs::read_to_string(folder.path().join("INDEX.txt")).unwrap();
    let dump = index
        .lines()
        .find(|line| line.starts_with("a-"))
        .expect("a dump");
    std::fs::write(folder.path().join(dump), [0; 5]).expect("space");
    let acceleration = || source::recording(folder.path()).unwrap().acceleration();
    assert_eq!(acceleration(), None);
    std::fs::remove_file(folder.path().join(dump)).expect("a dump");
    assert_eq!(acceleration(), None);
}
