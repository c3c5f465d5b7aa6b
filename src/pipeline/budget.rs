//! The memory of a run, part by part, added up at compile time.
//!
//! All of it is allocated before the first frame and kept. The live sensor has a budget of its own, beside its driver. Rows that depend on the face model (its own numbers,
//! the prepared standard head, the learned head of a person) are bounds for the built-in model; a test measures every row.
//! Not in the table: `landmarks.method = "paper"` takes 1.5 MB more per person.
//!
//! | part | bytes | what |
//! | --- | --- | --- |
//! | frame | 921,600 | depth, luma |
//! | segment | 312,016 | regions, histogram, clouds of six heads |
//! | camera | 8,192 | distances by raw value |
//! | landmarks | 1,000,192 | window, orientation maps, features: shared by all |
//! | model | 510,000 | shape modes, scales, biases; the update matrices stay in the binary |
//! | anchor | 700,000 | the standard head, prepared |
//! | people | 5 × 305,000 | four users and one candidate |
//! | **stages** | **4,977,000** | of 8 MiB |

use crate::base::capacity::{PIXELS, RAW_DEPTH_VALUES, USERS};
use crate::landmarks::Scratch;
use crate::segment::Segmenter;

/// One frame: depth 16 bits, luma 8 bits a pixel.
pub const FRAME: usize = 3 * PIXELS;
/// The segment stage.
pub const SEGMENT: usize = Segmenter::BYTES;
/// The camera's table.
pub const CAMERA: usize = RAW_DEPTH_VALUES * 4;
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

/// What the stages may take.
pub const BUDGET: usize = 8 << 20;

const _: () = assert!(STAGES <= BUDGET, "the stages exceed their memory budget");
