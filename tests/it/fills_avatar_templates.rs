//! Promise: every parameter of VRChat that public avatar templates read and that our units can fill is sent, all of them stand in
//! `docs/receivers.md`, and those beyond what templates read cost no datagram.

use std::sync::{Arc, Mutex};

use mien_outputs::osc::vrchat::{Settings, VrChat};
use mien_outputs::osc::{Datagrams, Targets};
use mien_outputs::{Output, Report, TrackingState};
use mien_stages::base::time::Timestamp;
use mien_stages::expression::units::Units;
use rosc::{OscPacket, OscType};

/// What templates read, by name: two of Adjerry91's VRCFaceTracking templates, for ARKit's and for Unified Expressions' shapes.
const TEMPLATES: [&str; 2] = [
    "EyeLeftX EyeRightX EyeY EyeLidLeft EyeLidRight EyeSquintLeft EyeSquintRight JawOpen MouthUpperUp MouthClosed MouthLowerDown \
     SmileFrownRight SmileFrownLeft LipPucker LipFunnel JawX MouthX CheekPuffLeft MouthRaiserLower JawForward TongueOut NoseSneer \
     MouthStretchLeft MouthStretchRight BrowExpressionLeft BrowExpressionRight LipSuckUpper LipSuckLower MouthRaiserUpper",
    "EyeLeftX EyeRightX EyeY EyeLidLeft EyeLidRight EyeSquintLeft EyeSquintRight JawOpen MouthClosed MouthUpperUp MouthLowerDown \
     SmileFrownRight SmileFrownLeft LipFunnel MouthX LipPucker BrowExpressionLeft BrowExpressionRight NoseSneer MouthStretchLeft \
     MouthStretchRight MouthTightenerLeft MouthTightenerRight LipSuckUpper LipSuckLower JawForward JawX TongueOut TongueX TongueY \
     PupilDilation CheekPuffSuckLeft CheekPuffSuckRight MouthRaiserLower MouthRaiserUpper MouthDimple MouthPress",
];
/// What of it no unit of ours says anything about: AU7, AU16, AU23, AU24, tongue and pupils are not measured, lips sideways without the
/// jaw neither, and a raised upper lip is no unit of FACS.
const UNFILLED: &str = "EyeSquintLeft EyeSquintRight MouthLowerDown MouthX TongueOut TongueX TongueY MouthTightenerLeft \
     MouthTightenerRight PupilDilation MouthRaiserUpper MouthPress";
/// What other avatars read of the kind that templates combine.
const BOTH_WAYS: &str = "EyeX EyeY EyeLeftY EyeRightY EyeLid EyeOpenLeft EyeClosedRight EyeWideLeft JawZ JawLeft CheekPuffSuck \
     CheekSquint SmileFrown SmileSad SmileSadLeft MouthSmileLeft MouthFrownRight BrowExpression BrowInnerUp BrowOuterUpLeft \
     LipSuckFunnelUpper MouthDimpleRight NoseSneerLeft";
/// What goes out at once although the templates above combine it otherwise.
const AT_ONCE: [&str; 3] = ["EyeX", "EyeLeftY", "EyeRightY"];
/// Frames of the run that is counted.
const FRAMES: u64 = 300;

#[derive(Clone, Default)]
struct Received(Arc<Mutex<Vec<Vec<u8>>>>);

impl Datagrams for Received {
    fn send(&mut self, datagram: &[u8]) -> bool {
        self.0.lock().unwrap().push(datagram.to_vec());
        true
    }
}

/// A number received: frame of the sender, name, value.
type Heard = (u64, String, f32);

/// Frames of weights that all change with each frame: datagrams, and the numbers in them.
fn run(still: bool) -> (usize, Vec<Heard>) {
    let units = Units::shipped().columns(false);
    let units: Vec<&str> = units.iter().map(|unit| unit.as_str()).collect();
    let received = Received::default();
    let targets: Targets = Box::new([Box::new(received.clone())]);
    let mut vrchat = VrChat::with_targets(targets, Settings::default(), &units).unwrap();
    let mut random = fastrand::Rng::with_seed(7);
    let mut heard = Vec::new();
    let mut count = 0;
    for frame in 0..FRAMES {
        let weights: Vec<f32> = units
            .iter()
            .map(|_| if still { 0.5 } else { random.f32() })
            .collect();
        let report = Report {
            at: Timestamp::from_us(33_333 * frame),
            user: Some(0),
            state: TrackingState::Tracking,
            weights: &weights,
            ..Report::default()
        };
        vrchat.send(&report).unwrap();
        for datagram in received.0.lock().unwrap().drain(..) {
            count += 1;
            let (_, packet) = rosc::decoder::decode_udp(&datagram).unwrap();
            let OscPacket::Bundle(bundle) = packet else {
                panic!("not a bundle")
            };
            let mut opens_it = false;
            for packet in bundle.content {
                let OscPacket::Message(message) = packet else {
                    panic!("a bundle in a bundle")
                };
                let name = message.addr.strip_prefix("/avatar/parameters/FT/v2/");
                let name = name.unwrap();
                opens_it |= name.ends_with("Active") || AT_ONCE.contains(&name);
                opens_it |= TEMPLATES
                    .iter()
                    .any(|all| all.split_whitespace().any(|one| one == name));
                if let [OscType::Float(value)] = message.args[..] {
                    heard.push((frame, name.to_owned(), value));
                }
            }
            assert!(
                opens_it,
                "a datagram at frame {frame} has nothing that templates read"
            );
        }
    }
    (count, heard)
}

#[test]
fn what_avatar_templates_read_is_sent_and_documented() {
    let (_, heard) = run(false);
    let mut sent: Vec<&str> = heard.iter().map(|(_, name, _)| name.as_str()).collect();
    sent.sort_unstable();
    sent.dedup();
    let unfilled: Vec<&str> = UNFILLED.split_whitespace().collect();
    let read = TEMPLATES.into_iter().chain([BOTH_WAYS]);
    for name in read.flat_map(str::split_whitespace) {
        assert_eq!(sent.contains(&name), !unfilled.contains(&name), "{name}");
    }
    let page = include_str!("../../docs/receivers.md");
    let table = page.split("## What VRChat gets").nth(1).unwrap();
    let table = table.split("\n## ").next().unwrap();
    let said: Vec<&str> = table.split('`').skip(1).step_by(2).collect();
    for name in &sent {
        assert!(said.contains(name), "{name} is sent, but not in the table");
    }
    for name in said.iter().filter(|name| !name.contains('/')) {
        let known = sent.contains(name) || unfilled.contains(name);
        assert!(known, "{name} is in the table, but not sent");
    }
}

#[test]
fn parameters_beyond_the_templates_cost_no_datagram_and_come_all_the_same() {
    // The parameters that templates read take 1.5 kB: two datagrams where all of them change.
    let (datagrams, heard) = run(false);
    assert!(datagrams as u64 <= 2 * FRAMES, "{datagrams} datagrams");
    let (still, _) = run(true);
    println!("{datagrams} datagrams of {FRAMES} frames that change, {still} of a still face");
    // Once a second two; the others go in those.
    assert!(still <= 2 * 10 + 1, "{still} datagrams");
    let mut last = std::collections::BTreeMap::new();
    let mut longest = (0, "");
    for (frame, name, _) in &heard {
        let before = last.insert(name.as_str(), *frame).unwrap_or(*frame);
        longest = longest.max((frame - before, name));
    }
    println!("longest pause of a parameter: {longest:?} frames");
    assert!(last.len() > 100 && longest.0 <= 30, "{longest:?}");
}
