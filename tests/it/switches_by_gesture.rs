//! Gestures from the configuration to receivers, and nothing left on however a run ends.

use std::net::UdpSocket;
use std::path::Path;
use std::process::{Command, Output};

use crate::talks_to_rigs::{messages, receiver};
use rosc::OscType;

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
    let run = ["run", "--source", "simulated:acted", "--fast", "--csv", "-"];
    let mut command = Command::new(env!("CARGO_BIN_EXE_mien"));
    command.args(run).args(words).arg("--config").arg(&config);
    command.output().unwrap()
}

fn osc(socket: &UdpSocket) -> String {
    let to = socket.local_addr().unwrap();
    format!("[osc]\ntargets = \"{to}\"\ncommands = false\nstyle = \"vector\"\n")
}

#[cfg(not(feature = "gestures"))]
#[test]
fn a_key_that_this_build_cannot_press_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let output = run(folder.path(), "", &["--frames", "1"]);
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(
        !output.status.success() && said.contains("build with --features gestures"),
        "{said}"
    );
}

#[cfg(feature = "gestures")]
mod pressed {
    use super::*;
    use std::process::{Child, Stdio};
    use std::time::Duration;

    /// Key downs and ups that were written where `uinput` would be: pairs of events, 24 bytes each on 64 bits.
    fn pressed(path: &Path) -> Vec<bool> {
        let bytes = std::fs::read(path).unwrap();
        let event = size_of::<libc_timeval::Timeval>() + 8;
        let downs = bytes
            .chunks_exact(2 * event)
            .map(|pair| pair[event - 4] == 1);
        downs.collect()
    }

    mod libc_timeval {
        /// As the kernel's events begin.
        #[repr(C)]
        pub struct Timeval(i64, i64);
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
        let output = run(folder.path(), &before, &["--frames", "900"]);
        assert!(
            output.status.success(),
            "{}",
            String::from_utf8_lossy(&output.stderr)
        );
        let csv = String::from_utf8(output.stdout).unwrap();
        let header = csv.lines().next().unwrap();
        assert!(header.ends_with(",head_y1,g_smile,g_jaw"), "{header}");
        let column = header
            .split(',')
            .position(|name| name == "g_smile")
            .unwrap();
        let smiles = csv
            .lines()
            .skip(1)
            .map(|row| row.split(',').nth(column).unwrap());
        let smiles: Vec<bool> = smiles.map(|smile| smile == "1").collect();
        let begins = smiles.windows(2).filter(|pair| !pair[0] && pair[1]).count();
        assert!(begins > 0, "nobody smiles");
        // As often a key, and up again at the end.
        let pressed = pressed(&path);
        assert_eq!(pressed.len(), 2 * begins);
        assert!(pressed.chunks(2).all(|press| press == [true, false]));
        let all = messages(&socket);
        let smile = all
            .iter()
            .filter(|message| message.addr == "/mien/gesture/smile");
        let values: Vec<&OscType> = smile.map(|message| &message.args[0]).collect();
        assert!(values.contains(&&OscType::Int(1)));
        assert_eq!(values.last(), Some(&&OscType::Int(0)), "off at the end");
        assert!(
            all.iter()
                .any(|message| message.addr == "/mien/gesture/jaw/0")
        );
    }

    fn start(folder: &Path, config: &str) -> Child {
        let path = folder.join("mien.toml");
        std::fs::write(&path, config).unwrap();
        Command::new(env!("CARGO_BIN_EXE_mien"))
            .args(["run", "--source", "simulated:acted", "--fast", "--config"])
            .arg(path)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap()
    }

    fn signal(run: &Child, name: &str) {
        let id = run.id().to_string();
        Command::new("kill").args([name, &id]).status().unwrap();
    }

    #[test]
    fn no_key_stays_down_when_a_run_is_stopped_or_reads_its_configuration_again() {
        let mut random = fastrand::Rng::with_seed(7);
        for round in 0..12 {
            let folder = tempfile::tempdir().unwrap();
            let (device, path) = keys(folder.path());
            // A key that is down most of the time.
            let always = "[[gesture]]\nname = \"awake\"\nof = \"AU26 - AU43L\"\non = 0.02\noff = 0.01\nhold_s = 0.0\nspeaking = true\nkey = \"a\"\n";
            let config = format!("[osc]\nenabled = false\n{device}{always}");
            let mut run = start(folder.path(), &config);
            let wait = |random: &mut fastrand::Rng| {
                std::thread::sleep(Duration::from_millis(random.u64(300..900)));
            };
            wait(&mut random);
            if round % 2 == 1 {
                // Without the gesture: what it held is let go.
                std::fs::write(
                    folder.path().join("mien.toml"),
                    format!("[osc]\nenabled = false\n{device}"),
                )
                .unwrap();
                signal(&run, "-HUP");
                wait(&mut random);
            }
            signal(&run, "-TERM");
            assert!(run.wait().unwrap().success());
            let pressed = pressed(&path);
            assert!(
                pressed.chunks(2).all(|press| press == [true, false]),
                "round {round}: {pressed:?}"
            );
        }
    }
}
