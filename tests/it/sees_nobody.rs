//! Promise: real Kinect frames without a face never give one. Needs the data sets; skips without.
#![cfg(feature = "studio")]

use mien_appliance::pipeline::Pipeline;
use mien_appliance::settings::Settings;
use mien_appliance::source;
use mien_sensors::Frame;
use mien_stages::face_model::FaceModel;

use crate::common;
use crate::common::data::Set;

#[test]
fn people_from_behind_and_a_desk_have_no_face() {
    let Some(data) = common::data::folder(Set::KinectV1Pcl) else {
        return;
    };
    let folder = tempfile::tempdir().expect("temporary folder");
    common::write_kinect_recording(
        &data,
        &["five_people", "desk_000", "desk_001"],
        10,
        folder.path(),
    );
    let mut source = source::recording(folder.path()).expect("a recording");
    let model = FaceModel::shipped();
    let mut pipeline =
        Pipeline::new(&Settings::default().stages, source.camera(), &model).expect("stages");
    let mut frame = Frame::default();
    let mut frames = 0;
    while source.next_frame(&mut frame).expect("readable") {
        pipeline.follow(&frame);
        let report = pipeline.report();
        assert!(
            report.landmarks.is_none(),
            "frame {}: a face of confidence {}",
            report.frame,
            report.confidence
        );
        frames += 1;
    }
    assert_eq!(frames, 30);
}
