//! `mien-studio inspect`: a recording, a run's CSV, a face model, a mesh or remembered people, as one HTML
//! page or one PNG sheet.
//!
//! ```text
//! path:  recording
//!        run, model, mesh, ranges
//! each draws on a canvas and fills an album ─► HTML page (page) or PNG sheet
//! ```
//! A directory is a recording, and so is a `.y4m` film; a file that begins like a model or like saved people is one; `.csv` is a run, `.obj`
//! and `.glb` a mesh. The page needs only a browser. Nothing is written unless all succeeded.

pub mod album;
mod depth_colours;
mod mesh;
mod model;
mod page;
mod ranges;
mod recording;
mod run;

pub(crate) use depth_colours::DepthColours;
pub(crate) use recording::colour_picture;

use std::path::{Path, PathBuf};

use album::Album;
use mien_appliance::settings::Settings;
use mien_appliance::source::is_film;
use mien_stages::face_model::{FaceModel, file::MAGIC};
use mien_workbench::atomic_write::{write_beside, write_out};
use mien_workbench::fault::Fault;
use mien_workbench::picture_files::png;
use mien_workbench::text_files::{MAX_BYTES, decoded, display_name};

/// Largest table, bytes: an hour of a run, which takes five times as much memory.
const MAX_CSV_BYTES: usize = 256 << 20;

/// Accepted kinds, for messages.
const EXPECTED: &str = "expected a recording directory, a .y4m film, a run's .csv, a face model, an .obj or .glb mesh or saved people";

/// Inspects `path`. `model` and `settings` are for recordings.
///
/// # Errors
/// If it is of an unknown kind or malformed; the text says where and what to do.
pub fn album(path: &Path, model: &FaceModel, settings: &Settings) -> Result<Album, Fault> {
    let advice = format!("; {EXPECTED}");
    let unreadable = Fault::cannot("read", path, &advice);
    let name = display_name(path);
    if std::fs::metadata(path).map_err(&unreadable)?.is_dir() || is_film(path) {
        return recording::inspect(&name, path, model, settings);
    }
    let bytes = mien_stages::base::bounded_read::read(path, MAX_BYTES).map_err(&unreadable)?;
    let ending = path.extension().unwrap_or_default().to_ascii_lowercase();
    file_album(&name, ending.to_str(), &bytes).map_err(Fault::within(path))
}

fn file_album(name: &str, ending: Option<&str>, bytes: &[u8]) -> Result<Album, Fault> {
    if bytes.starts_with(&MAGIC) || ending == Some("model") {
        return Ok(model::inspect(name, &FaceModel::read(bytes)?, bytes.len()));
    }
    if bytes.starts_with(b"glTF") {
        return mesh::inspect_glb(name, bytes);
    }
    if ending == Some("csv") && bytes.len() > MAX_CSV_BYTES {
        let (most, found) = (MAX_CSV_BYTES >> 20, bytes.len() >> 20);
        let expected = format!("expected a table of at most {most} MiB, found {found}; cut it");
        return Err(Fault::new(expected));
    }
    let text = decoded(bytes);
    match ending {
        Some("csv") => run::inspect(name, &text),
        Some("obj") => mesh::inspect(name, &text),
        _ if text.starts_with("mien-people") => ranges::people(name, &text),
        _ => Err(Fault::new(format!("cannot show this; {EXPECTED}"))),
    }
}

/// Writes the inspection of `path` to `out`, by default a page named after it in the working directory. Returns the
/// path written.
///
/// # Errors
/// As [`album()`], or if the output does not end in `.html` or `.png` or cannot be written.
pub fn inspect(
    path: &Path,
    out: Option<&Path>,
    model: &FaceModel,
    settings: &Settings,
) -> Result<PathBuf, Fault> {
    let named = out;
    let beside = || PathBuf::from(format!("{}.html", display_name(path)));
    let out = out.map_or_else(beside, PathBuf::from);
    let ending = out.extension().unwrap_or_default().to_ascii_lowercase();
    if ending != "html" && ending != "png" {
        let expected = "expected a name that ends in .html or .png";
        return Err(Fault::cannot("write", &out, "")(expected));
    }
    let album = album(path, model, settings)?;
    let bytes = match ending == "html" {
        true => album.html().into_bytes(),
        false => png(&album.sheet()),
    };
    if named.is_none() {
        return write_beside(&out, &bytes, false);
    }
    write_out(&out, bytes)?;
    Ok(out)
}

#[cfg(test)]
mod tests {
    use std::fmt::Write as _;

    use super::*;
    use crate::golden::{coloured, equals_golden};
    use crate::record::record;
    use mien_appliance::source;

    #[test]
    fn a_bad_path_is_one_sentence() {
        let model = FaceModel::default();
        let folder = tempfile::tempdir().unwrap();
        let message = |path: &Path, out: &str| {
            inspect(
                path,
                Some(&folder.path().join(out)),
                &model,
                &Settings::default(),
            )
            .unwrap_err()
            .to_string()
        };
        assert!(
            message(Path::new("/nowhere/x.csv"), "a.html")
                .starts_with("cannot read /nowhere/x.csv")
        );
        assert!(message(folder.path(), "a.html").contains("INDEX.txt"));
        let other = folder.path().join("x.bin");
        std::fs::write(&other, [0, 255, 3]).unwrap();
        assert!(message(&other, "a.html").contains("cannot show"));
        assert!(message(&other, "a.gif").contains(".html or .png"));
        assert!(!folder.path().join("a.html").exists(), "no partial output");
    }

    /// Weights of two users, a face model, a recording of two people.
    #[test]
    fn albums_equal_the_golden_ones() {
        let folder = tempfile::tempdir().unwrap();
        let run = folder.path().join("run.csv");
        let mut text =
            "frame,time_us,user,state,confidence,tx_m,qx,w_AU25,w_AU12L,w_AU61,m_lip_gap\n"
                .to_owned();
        for n in 0..120 {
            let t = f64::from(n) / 10.0;
            let state = ["warming", "tracking", "lost"][n as usize / 15 % 3];
            let gap = if n % 40 < 30 {
                format!("{:.3}", 0.5 + 0.4 * t.sin())
            } else {
                String::new()
            };
            writeln!(
                text,
                "{n},{:.0},{},{state},{:.2},{:.3},{:.3},{gap},{:.3},0.2,{:.3}",
                t * 1e6,
                n % 2,
                0.9 - 0.2 * (t * 0.7).cos(),
                0.05 * t.cos(),
                0.2 * (t * 0.3).sin(),
                (0.5 * t).sin().abs(),
                0.1 + 0.05 * (t * 2.0).sin(),
            )
            .unwrap();
        }
        std::fs::write(&run, text).unwrap();
        let recording = folder.path().join("recording");
        let mut simulated = source::simulated(Some("two")).unwrap();
        record(&mut *simulated, &recording, 0.5, 0.0, &false.into()).unwrap();
        let model = FaceModel::shipped();
        let of_model = &*crate::data::root().join("config/face.model");
        for (name, path) in [
            ("run", &*run),
            ("model", of_model),
            ("recording", &recording),
        ] {
            let album = album(path, &model, &Settings::default()).unwrap();
            equals_golden(
                &format!("inspect/{name}"),
                &coloured::<40, 60>(&album.sheet()),
            );
        }
    }

    #[test]
    fn a_run_is_written_in_both_forms() {
        let folder = tempfile::tempdir().unwrap();
        let run = folder.path().join("run.csv");
        std::fs::write(
            &run,
            "frame,time_us,user,state,w_AU25\n0,0,0,tracking,0.5\n1,33333,0,tracking,0.7\n",
        )
        .unwrap();
        for out in ["run.html", "run.png"] {
            let out = folder.path().join(out);
            assert_eq!(
                inspect(
                    &run,
                    Some(&out),
                    &FaceModel::default(),
                    &Settings::default()
                )
                .unwrap(),
                out
            );
            assert!(std::fs::metadata(out).unwrap().len() > 200);
        }
    }
}
