//! Every compile-time size of the appliance: name, value, unit, reason. `tests/memory` adds them up.
//!
//! | container | when full |
//! | --- | --- |
//! | points of a head's cloud | thinned evenly before they are stored |
//! | heads of a picture | the farthest are left out |
//! | users | newcomers wait until a slot is free |
//! | people remembered | the one who left first is forgotten |
//! | heads without a face | the oldest is tried again |
//! | samples and nodes of a measure | the two that are most alike are merged |
//! | pictures waiting for their pair | the oldest is dropped and counted |
//! | frames waiting for the stages | the oldest is dropped and counted |
//! | landed USB transfers | the stream pauses until they are taken; what it misses is counted as lost |
//! | a line of the log, of status, of a serial port | cut, or not sent and counted |

/// Columns of the largest pictures, depth and grey.
pub const WIDTH: usize = 640;
/// Their rows.
pub const HEIGHT: usize = 480;
/// Pixels of one picture.
pub const PIXELS: usize = WIDTH * HEIGHT;
/// Values a raw 11-bit depth pixel can take; the last one, 2047, means "no measurement".
pub const RAW_DEPTH_VALUES: usize = 2048;
/// Points of the face that are tracked: the order of iBUG / Multi-PIE 68.
pub const LANDMARKS: usize = 68;
/// Points kept of one head's depth cloud. The cloud is thinned evenly to this: beyond about a thousand the sensor's
/// depth steps, not the count, limit the pose.
pub const HEAD_POINTS: usize = 2048;
/// People followed at once.
pub const USERS: usize = 4;
/// Heads cut from one depth picture at most: one per user, and two that may be new people or false detections.
pub const HEADS: usize = USERS + 2;
/// People who left and can be recognised: more than pass by during an absence of some minutes.
pub const REMEMBERED: usize = 2 * USERS;
/// Geometric measures of a face: the paper's, the fore–aft ones, those of single sides and the cheeks, with the eye distance.
pub const MEASURES: usize = 21;
/// Measures whose range is learnt: all but the eye distance.
pub const LEARNT_MEASURES: usize = MEASURES - 1;
/// Lengths of the face that are no measure but tell units apart.
pub const LENGTHS: usize = 18;
/// Inputs besides the measures that distinguish units: lengths, where the eyes look (across and up), and how far lids are lifted.
pub const FEATURES: usize = LENGTHS + 3;
/// What a unit is read from: learnt measures and features.
pub const INPUTS: usize = LEARNT_MEASURES + FEATURES;
/// Weight columns at most: two for every learnt measure, and units that are read from several.
pub const UNITS: usize = 2 * LEARNT_MEASURES + 8;
/// Samples kept per measure by the paper's method (16 bytes each): 64, 256 and 1024 do equally well.
pub const PAPER_SAMPLES: usize = 128;
/// Nodes kept per measure by the robust method (32 bytes each): 64, 128 and 256 do equally well.
pub const RANGE_NODES: usize = 64;
/// Gestures configured at most; a configuration with more is refused.
pub const GESTURES: usize = 16;
/// Frames of the sensor that may wait for the stages, with the one being unpacked: a hiccup of 66 ms.
pub const WAITING_FRAMES: usize = 2;
/// USB transfers per stream, in flight or landed and not yet taken: 32 ms.
pub const TRANSFERS: usize = 16;
/// Connections at once of every server of the web, [`mien_appliance::wires`]: a browser or two and some programs. When all
/// are taken, who has not asked yet makes room, else the newcomer is refused and counted.
pub const WEB_CONNECTIONS: usize = 8;
/// Packets per transfer, a multiple of the eight microframes of a frame.
pub const PACKETS: usize = 16;
