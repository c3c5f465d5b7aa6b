//! JSON over WebSocket: every report as one text message, to every connected page.
//!
//! ```json
//! {"frame":12,"time_us":400000,"user":0,"state":"tracking","confidence":0.9310,"frozen":false,"latency_us":9100,
//!  "pose":[0.01,0.02,0.8,0.0,0.0,0.0,1.0],"weights":{"AU26":0.2500,"AU25":0.1200},"gestures":{"smile":true}}
//! ```
//! `pose` is the place in metres and the rotation (x, y, z, w) in the sensor's frame, or null; weights are 0…1 with four
//! decimals; gestures are there if any are configured. A frame with nobody is `{"frame":12,"time_us":400000,"user":null}`. Whatever pages send is ignored.

use std::fmt::Write as _;
use std::net::IpAddr;

use super::http::Request;
use super::server::{Answer, Service, serve};
use crate::OutputError;
use crate::board::{Board, Front, Shot, Weight};
use crate::features::WebSocketSettings;
use crate::limits::Listening;
use mien_stages::base::json::Quoted;

/// Bytes of a message, with room for the longest names.
const MESSAGE: usize = 4096;

struct Pages {
    /// Names as JSON keys, with a colon.
    units: Box<[String]>,
    gestures: Box<[String]>,
}

impl Service for Pages {
    const WAITING: usize = MESSAGE;

    fn answer(&self, request: &Request, _: IpAddr, _: &mut String) -> Result<Answer, u16> {
        match request.upgrade()? {
            Some(accepted) if !request.is_post => Ok(Answer::WebSocket(accepted)),
            Some(_) => Err(405),
            None => Err(426),
        }
    }

    fn next_message(&mut self, board: &mut Board, message: &mut String) -> bool {
        let mut users = board.users.iter_mut().enumerate();
        if let Some((slot, shot)) = users.find(|(_, shot)| shot.fresh) {
            shot.fresh = false;
            // A string takes everything.
            let _ = self.write(slot, shot, message);
            return true;
        }
        let nobody = &mut board.nobody;
        if !std::mem::take(&mut nobody.fresh) {
            return false;
        }
        let _ = write!(
            message,
            "{{\"frame\":{},\"time_us\":{},\"user\":null}}",
            nobody.frame, nobody.at_us
        );
        true
    }
}

impl Pages {
    fn write(&self, slot: usize, shot: &Shot, message: &mut String) -> std::fmt::Result {
        write!(
            message,
            "{{\"frame\":{},\"time_us\":{},\"user\":{slot},{shot},\"pose\":",
            shot.frame, shot.at_us
        )?;
        match shot.pose {
            Some([x, y, z, a, b, c, d]) => write!(
                message,
                "[{x:.5},{y:.5},{z:.5},{a:.6},{b:.6},{c:.6},{d:.6}]"
            )?,
            None => message.write_str("null")?,
        }
        message.write_str(",\"weights\":{")?;
        for (i, (name, weight)) in self.units.iter().zip(&shot.weights).enumerate() {
            let comma = if i > 0 { "," } else { "" };
            write!(message, "{comma}{name}{}", Weight(*weight))?;
        }
        for (i, name) in self.gestures.iter().enumerate() {
            let comma = if i > 0 { "," } else { "},\"gestures\":{" };
            write!(message, "{comma}{name}{}", shot.gestures >> i & 1 == 1)?;
        }
        message.write_str("}}")
    }
}

/// Starts serving weights to pages. `units` are the names in the order of the weights, `gestures` those of the gestures.
///
/// # Errors
/// If the address is unusable or no thread can be started; not if it is in use.
pub fn open(
    settings: &WebSocketSettings,
    units: &[&str],
    gestures: &[&str],
) -> Result<Front, OutputError> {
    let at = Listening::on(&settings.listen)?;
    let key = |name: &str| format!("{}:", Quoted(name));
    let pages = Pages {
        units: units
            .iter()
            .map(|unit| key(settings.view.name(unit)))
            .collect(),
        gestures: gestures.iter().map(|name| key(name)).collect(),
    };
    let work = move |shared, bell| serve(pages, at, shared, bell);
    Front::start("websocket", units, &settings.view, work)
}
