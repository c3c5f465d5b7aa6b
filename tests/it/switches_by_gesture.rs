//! Gestures from the configuration to receivers, and nothing left on however a run ends.

use std::path::Path;
use std::process::Output;

use crate::common::mien;
use crate::common::whole_run::has_wires;

const GESTURES: &str = r#"
[[gesture]]
name = "smile"
key = "space"

[[gesture]]
name = "jaw"
of = "AU26"
on = 0.5
off = 0.3
person = "each"
speaking = true
"#;

/// Runs the acted scene with these gestures.
fn run(folder: &Path, before: &str, words: &[&str]) -> Output {
    let config = folder.join("mien.toml");
    std::fs::write(&config, format!("{before}\n{GESTURES}")).unwrap();
    let mut command = mien("run --source simulated:acted --fast --csv -");
    command.args(words).arg("--config").arg(&config);
    command.output().unwrap()
}

#[test]
fn a_key_that_this_build_cannot_press_is_refused() {
    if has_wires() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let output = run(folder.path(), "", &["--frames", "1"]);
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(
        !output.status.success() && said.contains("build with --features wires"),
        "{said}"
    );
}

#[cfg(feature = "wires")]
mod pressed {
    use super::*;
    use crate::common::{make_pipe, signal};
    use crate::talks_to_rigs::{messages, receiver};
    use rosc::OscType;
    use std::io::Read;
    use std::net::UdpSocket;
    use std::process::{Child, Stdio};
    use std::sync::{Arc, Mutex};
    use std::time::{Duration, Instant};

    fn osc(socket: &UdpSocket) -> String {
        let to = socket.local_addr().unwrap();
        format!("[osc]\ntarget = \"{to}\"\ncommands = false\nstyle = \"vector\"\n")
    }

    /// Key downs (`true`) and ups that were written where `uinput` would be: pairs of events, each a time and eight bytes.
    fn presses(events: &[u8]) -> Vec<bool> {
        let event = 2 * size_of::<std::ffi::c_ulong>() + 8;
        let pairs = events.chunks_exact(2 * event);
        pairs.map(|pair| pair[event - 4] == 1).collect()
    }

    fn keys(folder: &Path) -> (String, std::path::PathBuf) {
        let path = folder.join("events");
        std::fs::write(&path, []).unwrap();
        (format!("[keys]\ndevice = {path:?}\n"), path)
    }

    #[test]
    fn a_smile_is_a_column_a_message_and_a_key() {
        let folder = tempfile::tempdir().unwrap();
        let socket = receiver("127.0.0.1:0");
        let (device, path) = keys(folder.path());
        let before = osc(&socket) + &device;
        // Read on the way: a socket holds less than a run sends.
        let (output, all) = std::thread::scope(|scope| {
            let run = scope.spawn(|| run(folder.path(), &before, &["--frames", "1500"]));
            let mut all = Vec::new();
            while !run.is_finished() {
                all.extend(messages(&socket));
            }
            all.extend(messages(&socket));
            (run.join().unwrap(), all)
        });
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{said}");
        let csv = String::from_utf8(output.stdout).unwrap();
        let header = csv.lines().next().unwrap();
        assert!(
            header.contains(",head_y1,g_smile,g_jaw,s_brow_L,"),
            "{header}"
        );
        let mut names = header.split(',');
        let column = names.position(|name| name == "g_smile").unwrap();
        let smiles = |row: &str| row.split(',').nth(column) == Some("1");
        let smiles: Vec<bool> = csv.lines().skip(1).map(smiles).collect();
        let begins = smiles.windows(2).filter(|pair| !pair[0] && pair[1]).count();
        assert!(begins > 0, "nobody smiles");
        // As often a key, and up again at the end.
        let pressed = presses(&std::fs::read(&path).unwrap());
        assert_eq!(pressed.len(), 2 * begins);
        assert!(pressed.chunks(2).all(|press| press == [true, false]));
        let of = |address: &'static str| all.iter().filter(move |one| one.addr == address);
        let smile = of("/mien/gesture/smile");
        let values: Vec<&OscType> = smile.map(|message| &message.args[0]).collect();
        assert!(values.contains(&&OscType::Int(1)));
        assert_eq!(values.last(), Some(&&OscType::Int(0)), "off at the end");
        assert!(of("/mien/gesture/jaw/0").next().is_some());
    }

    fn start(folder: &Path, config: &str) -> Child {
        let path = folder.join("mien.toml");
        std::fs::write(&path, config).unwrap();
        mien("run --source simulated:acted --fast --config")
            .arg(path)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap()
    }

    /// A key that is down most of the time.
    const AWAKE: &str = r#"
[[gesture]]
name = "awake"
of = "AU26 - AU43L"
on = 0.02
off = 0.01
hold_s = 0.0
pause_s = 0.0
speaking = true
key = "a"
press = "hold"
"#;

    #[test]
    fn no_key_stays_down_however_a_run_ends() {
        let mut random = fastrand::Rng::with_seed(7);
        for round in 0..6 {
            let folder = tempfile::tempdir().unwrap();
            // A pipe: what is at its other end learns of the process's end, as the kernel does of a keyboard's.
            let path = folder.path().join("events");
            make_pipe(&path);
            let events = Arc::new(Mutex::new(Vec::new()));
            let reader = {
                let (path, events) = (path.clone(), Arc::clone(&events));
                std::thread::spawn(move || {
                    let mut pipe = std::fs::File::open(path).unwrap();
                    let mut bytes = [0; 4096];
                    while let Ok(length @ 1..) = pipe.read(&mut bytes) {
                        events.lock().unwrap().extend_from_slice(&bytes[..length]);
                    }
                })
            };
            let device = format!("[osc]\nenabled = false\n[keys]\ndevice = {path:?}\n");
            let mut run = start(folder.path(), &format!("{device}{AWAKE}"));
            let wait = |random: &mut fastrand::Rng| {
                std::thread::sleep(Duration::from_millis(random.u64(1..600)));
            };
            let begun = Instant::now();
            while events.lock().unwrap().is_empty() && begun.elapsed() < Duration::from_secs(60) {
                std::thread::sleep(Duration::from_millis(10));
            }
            wait(&mut random);
            if round % 3 == 1 {
                // Without the gesture: what it held is let go.
                std::fs::write(folder.path().join("mien.toml"), &device).unwrap();
                signal(&run, "-HUP");
                wait(&mut random);
            }
            let killed = round % 3 == 2;
            signal(&run, if killed { "-KILL" } else { "-TERM" });
            assert_eq!(run.wait().unwrap().success(), !killed);
            // All there is: the device is closed.
            reader.join().unwrap();
            let mut presses = presses(&events.lock().unwrap());
            assert!(!presses.is_empty(), "round {round}: nothing was pressed");
            if killed && presses.len() % 2 == 1 {
                // The kernel releases what is held when it is closed.
                presses.push(false);
            }
            assert!(
                presses.chunks(2).all(|press| press == [true, false]),
                "round {round}: {presses:?}"
            );
        }
    }
}
