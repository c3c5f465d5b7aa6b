//! Names of blend shapes in avatars, in terms of action units.
//!
//! ARKit's shapes are FACS units almost one to one. The expressions of VRM avatars are coarser: five vowels, blinks and a
//! few moods. The vowels are read off the mouth: A an open jaw that is neither rounded nor spread, I spread lips, U
//! pursed lips, E half of a spread mouth that is open, O funnelled lips. They are an approximation: speech is not heard.

use super::parameters::{Definition, Term, plain};

/// ARKit's blend shapes in terms of action units.
pub(super) const ARKIT: [Definition; 44] = [
    plain("browInnerUp", &[(1.0, &["AU1L", "AU1R", "AU1"])]),
    plain("browOuterUpLeft", &[(1.0, &["AU2L", "AU2"])]),
    plain("browOuterUpRight", &[(1.0, &["AU2R", "AU2"])]),
    plain("browDownLeft", &[(1.0, &["AU4L", "AU4"])]),
    plain("browDownRight", &[(1.0, &["AU4R", "AU4"])]),
    plain("eyeWideLeft", &[(1.0, &["AU5L", "AU5"])]),
    plain("eyeWideRight", &[(1.0, &["AU5R", "AU5"])]),
    plain("cheekSquintLeft", &[(1.0, &["AU6L", "AU6"])]),
    plain("cheekSquintRight", &[(1.0, &["AU6R", "AU6"])]),
    plain("eyeSquintLeft", &[(1.0, &["AU7L", "AU7"])]),
    plain("eyeSquintRight", &[(1.0, &["AU7R", "AU7"])]),
    plain("noseSneerLeft", &[(1.0, &["AU9L", "AU9"])]),
    plain("noseSneerRight", &[(1.0, &["AU9R", "AU9"])]),
    plain("mouthUpperUpLeft", &[(1.0, &["AU10L", "AU10"])]),
    plain("mouthUpperUpRight", &[(1.0, &["AU10R", "AU10"])]),
    plain("mouthSmileLeft", &[(1.0, &["AU12L", "AU12"])]),
    plain("mouthSmileRight", &[(1.0, &["AU12R", "AU12"])]),
    plain("mouthDimpleLeft", &[(1.0, &["AU14L", "AU14"])]),
    plain("mouthDimpleRight", &[(1.0, &["AU14R", "AU14"])]),
    plain("mouthFrownLeft", &[(1.0, &["AU15L", "AU15"])]),
    plain("mouthFrownRight", &[(1.0, &["AU15R", "AU15"])]),
    plain("mouthLowerDownLeft", &[(1.0, &["AU16L", "AU16"])]),
    plain("mouthLowerDownRight", &[(1.0, &["AU16R", "AU16"])]),
    plain("mouthShrugLower", &[(1.0, &["AU17"])]),
    plain("mouthPucker", &[(1.0, &["AU18"])]),
    plain("mouthStretchLeft", &[(1.0, &["AU20L", "AU20"])]),
    plain("mouthStretchRight", &[(1.0, &["AU20R", "AU20"])]),
    plain("mouthFunnel", &[(1.0, &["AU22"])]),
    plain("mouthPressLeft", &[(1.0, &["AU24L", "AU24"])]),
    plain("mouthPressRight", &[(1.0, &["AU24R", "AU24"])]),
    plain("jawOpen", &[(1.0, &["AU26", "AU27"])]),
    plain("mouthRollLower", &[(1.0, &["AU28"])]),
    plain("mouthRollUpper", &[(1.0, &["AU28"])]),
    plain("jawForward", &[(1.0, &["AU29"])]),
    plain("jawLeft", &[(1.0, &["AU30L"])]),
    plain("jawRight", &[(1.0, &["AU30R"])]),
    plain("cheekPuff", &[(1.0, &["AU33", "AU34", "AU34L", "AU34R"])]),
    plain("eyeBlinkLeft", &[(1.0, &["AU43L", "AU43", "AU45L"])]),
    plain("eyeBlinkRight", &[(1.0, &["AU43R", "AU43", "AU45R"])]),
    plain("eyeLookInLeft", &[(1.0, &["AU62L"])]),
    plain("eyeLookInRight", &[(1.0, &["AU61R"])]),
    plain("eyeLookOutLeft", &[(1.0, &["AU61L"])]),
    plain("eyeLookOutRight", &[(1.0, &["AU62R"])]),
    plain("tongueOut", &[(1.0, &["AU19"])]),
];

const A: &[Term] = &[(1.0, &["AU26"]), (-1.0, &["AU18"]), (-0.5, &["AU20"])];
const I: &[Term] = &[(1.0, &["AU20"]), (-1.0, &["AU26"])];
const U: &[Term] = &[(1.0, &["AU18"]), (-0.5, &["AU26"])];
const E: &[Term] = &[(0.5, &["AU20"]), (0.5, &["AU25"]), (-1.0, &["AU18"])];
const O: &[Term] = &[(1.0, &["AU22"])];
const JOY: &[Term] = &[(1.0, &["AU12L", "AU12R", "AU12"])];
const ANGER: &[Term] = &[(1.0, &["AU4L", "AU4R", "AU4"])];
const SORROW: &[Term] = &[(1.0, &["AU15L", "AU15R", "AU15"])];
const SURPRISE: &[Term] = &[
    (0.5, &["AU2L", "AU2R", "AU2"]),
    (0.5, &["AU5L", "AU5R", "AU5"]),
];
const BLINK_LEFT: &[Term] = &[(1.0, &["AU43L", "AU43", "AU45L"])];
const BLINK_RIGHT: &[Term] = &[(1.0, &["AU43R", "AU43", "AU45R"])];

/// Expressions of VRM 0 in terms of action units.
pub(super) const VRM0: [Definition; 10] = [
    plain("A", A),
    plain("I", I),
    plain("U", U),
    plain("E", E),
    plain("O", O),
    plain("Joy", JOY),
    plain("Angry", ANGER),
    plain("Sorrow", SORROW),
    plain("Blink_L", BLINK_LEFT),
    plain("Blink_R", BLINK_RIGHT),
];

/// Expressions of VRM 1 in terms of action units.
pub(super) const VRM1: [Definition; 11] = [
    plain("aa", A),
    plain("ih", I),
    plain("ou", U),
    plain("ee", E),
    plain("oh", O),
    plain("happy", JOY),
    plain("angry", ANGER),
    plain("sad", SORROW),
    plain("surprised", SURPRISE),
    plain("blinkLeft", BLINK_LEFT),
    plain("blinkRight", BLINK_RIGHT),
];
