//! Every compile-time size of the appliance: name, value, unit, reason. `tests/memory` adds them up.
//!
//! | container | when full |
//! | --- | --- |
//! | points of a head's cloud | thinned evenly before they are stored |
//! | heads of an image | the farthest are left out |
//! | users | newcomers wait until a slot is free |
//! | people remembered | the one gone longest is forgotten |
//! | heads without a face | the oldest is tried again |
//! | samples and nodes of a measure | the two most similar are merged |
//! | images waiting for their pair | the oldest is dropped and counted |
//! | frames waiting for the stages | the oldest is dropped and counted |
//! | completed USB transfers | the stream pauses until they are taken; the gap is counted as lost |
//! | a line of the log, of status, of a serial port | cut, or not sent and counted |

/// Columns of the largest depth and grey images.
pub const WIDTH: usize = 640;
/// Rows of the largest depth and grey images.
pub const HEIGHT: usize = 480;
/// Pixels of one image.
pub const PIXELS: usize = WIDTH * HEIGHT;
/// Most raw depth values with a distance. A camera's table of distances takes four bytes each: 40 kB if it measures millimetres to
/// 10 m, at most 262,140.
pub const RAW_DEPTH_VALUES: usize = u16::MAX as usize;
/// Bins of the histogram of depth, equal steps of 1/z: 1.6 mm at 1 m.
pub const DEPTH_BINS: usize = 2047;
/// Tracked points of the face, in the order of iBUG / Multi-PIE 68.
pub const LANDMARKS: usize = 68;
/// Regions of the face whose visibility is judged.
pub const REGIONS: usize = 6;
/// Most points of one head's cloud, which is thinned evenly: beyond about a thousand the sensor's depth steps, not the count,
/// limit the pose.
pub const HEAD_POINTS: usize = 2048;
/// Most people tracked at once.
pub const USERS: usize = 4;
/// Most heads segmented from one depth image: one per user, and two new people or false detections.
pub const HEADS: usize = USERS + 2;
/// Most people remembered after they left: more than pass by in some minutes.
pub const REMEMBERED: usize = 2 * USERS;
/// Geometric measures of a face: the paper's, fore–aft, one-sided, cheeks, and the eye distance.
pub const MEASURES: usize = 21;
/// Measures with a learnt range: all but the eye distance.
pub const LEARNT_MEASURES: usize = MEASURES - 1;
/// Additional face lengths that distinguish units.
pub const LENGTHS: usize = 18;
/// Inputs besides the measures: lengths, gaze (across and up), and lid lift.
pub const FEATURES: usize = LENGTHS + 3;
/// Inputs of a unit's reading: learnt measures and features.
pub const INPUTS: usize = LEARNT_MEASURES + FEATURES;
/// Most weight columns: two for every learnt measure, and the units read from several measures.
pub const UNITS: usize = 2 * LEARNT_MEASURES + 8;
/// Samples kept per measure by the paper's method (16 bytes each): 64, 256 and 1024 do equally well.
pub const PAPER_SAMPLES: usize = 128;
/// Nodes kept per measure by the robust method (32 bytes each): 64, 128 and 256 do equally well.
pub const RANGE_NODES: usize = 64;
/// Most configured gestures; a configuration with more is refused.
pub const GESTURES: usize = 16;
/// Most frames waiting for the stages, including the one being unpacked: bridges a delay of 66 ms.
pub const WAITING_FRAMES: usize = 2;
/// Buffers that a camera's driver fills in turn: one being filled, one being read, two for a delay of 66 ms.
pub const CAMERA_BUFFERS: usize = 4;
/// USB transfers per stream, in flight or completed and not yet taken: 32 ms.
pub const TRANSFERS: usize = 16;
/// Most simultaneous connections of all web servers: a browser or two and some programs. When all are taken, one that has not
/// sent a request yet is closed, else the new one is refused and counted.
pub const WEB_CONNECTIONS: usize = 8;
/// Packets per transfer, a multiple of the eight USB microframes per frame.
pub const PACKETS: usize = 16;
