//! The memory of a run, part by part, added up at compile time.
//!
//! All of it is allocated before the first frame and kept. The stages and the live sensor each have a budget; a recording
//! or the simulated sensor uses other buffers instead of the sensor's. Rows that depend on the face model (its own numbers,
//! the prepared standard head, the learned head of a person) are bounds for the built-in model; a test measures every row.
//! Not in the table: `landmarks.method = "paper"` takes 1.5 MB more per person.
//!
//! | part | bytes | what |
//! | --- | --- | --- |
//! | frame | 1,228,800 | depth, Bayer, luma |
//! | segment | 331,216 | regions, histogram, clouds of six heads |
//! | camera | 12,288 | distances by raw value |
//! | landmarks | 1,000,192 | window, orientation maps, features: shared by all |
//! | model | 510,000 | shape modes, scales, biases; the update matrices stay in the binary |
//! | anchor | 700,000 | the standard head, prepared |
//! | people | 5 × 305,000 | four users and one candidate |
//! | **stages** | **5,307,496** | of 8 MiB |
//! | waiting frames | 2 × 729,600 | in the ring or being unpacked |
//! | pairing | 729,600 | one picture per stream |
//! | assembling | 729,600 | one picture per stream |
//! | transfers | 983,040 | 16 per stream, in flight or landed |
//! | **live sensor** | **3,901,440** | of 8 MiB |

use crate::base::capacity::{
    PACKETS, PIXELS, RAW_DEPTH_VALUES, TRANSFERS, UNPAIRED_PICTURES, USERS, WAITING_FRAMES,
};
use crate::landmarks::Scratch;
use crate::segment::Segmenter;
use crate::sensor::packet::LONGEST;
use crate::sensor::pairing::RawPair;

/// One frame: depth 16 bits, Bayer and luma 8 bits a pixel.
pub const FRAME: usize = 4 * PIXELS;
/// The segment stage.
pub const SEGMENT: usize = Segmenter::BYTES;
/// The camera's tables: metres and millimetres.
pub const CAMERA: usize = RAW_DEPTH_VALUES * (4 + 2);
/// What the fitters of all users share.
pub const LANDMARKS: usize = Scratch::BYTES;
/// The built-in model, at most.
pub const MODEL: usize = 510_000;
/// The built-in standard head prepared for the pose stage, at most.
pub const ANCHOR: usize = 700_000;
/// One person's stages, at most.
pub const PERSON: usize = 305_000;
/// All stages.
pub const STAGES: usize =
    FRAME + SEGMENT + CAMERA + LANDMARKS + MODEL + ANCHOR + (USERS + 1) * PERSON;

/// Frames between the sensor's thread and the stages.
pub const WAITING: usize = WAITING_FRAMES * RawPair::BYTES;
/// Pictures that wait for their other half, and those that are being assembled.
pub const PICTURES: usize = (UNPAIRED_PICTURES + 1) * RawPair::BYTES;
/// Transfers of both streams.
pub const IN_FLIGHT: usize = 2 * TRANSFERS * PACKETS * LONGEST;
/// The live sensor.
pub const SENSOR: usize = WAITING + PICTURES + IN_FLIGHT;

/// What the stages may take, and the same again for the live sensor.
pub const BUDGET: usize = 8 << 20;

const _: () = assert!(STAGES <= BUDGET, "the stages exceed their memory budget");
const _: () = assert!(SENSOR <= BUDGET, "the sensor exceeds its memory budget");
