//! JSON over WebSocket: every report as one text message, to every connected page.
//!
//! ```json
//! {"frame":12,"time_us":400000,"user":0,"state":"tracking","confidence":0.9310,"frozen":false,"latency_us":9100,
//!  "seen":{"brow_L":1.0000,"brow_R":1.0000,"eye_L":1.0000,"eye_R":1.0000,"nose":1.0000,"mouth":0.2500},
//!  "pose":[0.01,0.02,0.8,0.0,0.0,0.0,1.0],"weights":{"AU26":0.2500,"AU25":0.1200},"gestures":{"smile":true}}
//! ```
//! `pose` is the position in metres and the quaternion x, y, z, w in the sensor's frame, or null; weights are 0…1 with four
//! decimals; `seen` is how far each region of the face can be seen, 0…1, and is present with a face; `gestures` is present if any are configured. A frame with nobody is `{"frame":12,"time_us":400000,"user":null}`.
//! Messages from clients are ignored.

use std::fmt::Write as _;
use std::net::IpAddr;

use super::http::Request;
use super::server::{Answer, Service, serve};
use crate::OutputError;
use crate::features::WebSocketSettings;
use crate::limits::Listening;
use crate::mailbox::{Mailbox, Snapshot, ThreadedOutput, Weight};
use mien_stages::base::json::Quoted;

/// Bytes of the longest message, with the longest names.
const MESSAGE: usize = 4096;

struct Pages {
    /// Names as JSON keys with a colon.
    units: Box<[String]>,
    gestures: Box<[String]>,
}

impl Service for Pages {
    const BUFFER: usize = MESSAGE;

    fn answer(&self, request: &Request, _: IpAddr, _: &mut String) -> Result<Answer, u16> {
        match request.upgrade()? {
            Some(accepted) if !request.is_post => Ok(Answer::WebSocket(accepted)),
            Some(_) => Err(405),
            None => Err(426),
        }
    }

    fn next_message(&mut self, mailbox: &mut Mailbox, message: &mut String) -> bool {
        let mut users = mailbox.users.iter_mut().enumerate();
        if let Some((slot, snapshot)) = users.find(|(_, snapshot)| snapshot.fresh) {
            snapshot.fresh = false;
            // A string takes everything.
            let _ = self.write(slot, snapshot, message);
            return true;
        }
        let Snapshot { frame, at_us, .. } = mailbox.nobody;
        let fresh = std::mem::take(&mut mailbox.nobody.fresh);
        if fresh {
            let _ = write!(
                message,
                "{{\"frame\":{frame},\"time_us\":{at_us},\"user\":null}}"
            );
        }
        fresh
    }
}

impl Pages {
    fn write(&self, slot: usize, snapshot: &Snapshot, message: &mut String) -> std::fmt::Result {
        write!(
            message,
            "{{\"frame\":{},\"time_us\":{},\"user\":{slot},{snapshot},\"pose\":",
            snapshot.frame, snapshot.at_us
        )?;
        match snapshot.pose {
            Some([x, y, z, a, b, c, d]) => write!(
                message,
                "[{x:.5},{y:.5},{z:.5},{a:.6},{b:.6},{c:.6},{d:.6}]"
            )?,
            None => message.write_str("null")?,
        }
        message.write_str(",\"weights\":{")?;
        for (i, (name, weight)) in self.units.iter().zip(&snapshot.weights).enumerate() {
            let comma = if i > 0 { "," } else { "" };
            write!(message, "{comma}{name}{}", Weight(*weight))?;
        }
        for (i, name) in self.gestures.iter().enumerate() {
            let comma = if i > 0 { "," } else { "},\"gestures\":{" };
            write!(message, "{comma}{name}{}", snapshot.gestures >> i & 1 == 1)?;
        }
        message.write_str("}}")
    }
}

/// Starts serving weights. `units` are the names in the order of the weights, `gestures` the names of the gestures.
///
/// # Errors
/// If the address is unusable or no thread can be started; not if it is in use.
pub fn open(
    settings: &WebSocketSettings,
    units: &[&str],
    gestures: &[&str],
) -> Result<ThreadedOutput, OutputError> {
    let listener = Listening::new(&settings.listen)?;
    let key = |name: &str| format!("{}:", Quoted(name));
    let unit = |unit: &&str| key(settings.view.name(unit));
    let pages = Pages {
        units: units.iter().map(unit).collect(),
        gestures: gestures.iter().map(|name| key(name)).collect(),
    };
    let work = move |shared, waker| serve(pages, listener, shared, waker);
    ThreadedOutput::start("websocket", units, &settings.view, work)
}
