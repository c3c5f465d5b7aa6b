//! The command `mien-studio nrsfm`.

use super::{Error, Settings, Shapes, Tracks, nrsfm, rigid_mean_shape, shape_error};
use std::path::{Path, PathBuf};
use std::time::Instant;

const HELP: &str = "mien-studio nrsfm --tracks FILE.csv [--rank K] --out FILE.csv [--truth FILE.csv]
2F x P image tracks (x row, y row per frame; a missing point empty or nan) to 3F x P shapes.
--rank K    number of shape modes, 0 for a rigid reconstruction; chosen from the tracks if not given
--truth F   3F x P true shapes: prints the error, each frame rigidly aligned, one mirror for the whole sequence
example: mien-studio nrsfm --tracks shark_W.csv --out shapes.csv --truth shark_S.csv";

/// Runs the command with the arguments after its name; prints one line per step.
///
/// # Errors
/// Arguments that do not fit, files that cannot be read, parsed or written. Nothing is written then.
pub fn run(args: &[String]) -> Result<(), Error> {
    let (mut tracks, mut out, mut truth) = (None::<PathBuf>, None::<PathBuf>, None::<PathBuf>);
    let mut settings = Settings::default();
    let mut rest = args.iter();
    while let Some(option) = rest.next() {
        if option == "--help" || option == "-h" {
            println!("{HELP}");
            return Ok(());
        }
        let value = rest.next();
        let place = match option.as_str() {
            "--tracks" => &mut tracks,
            "--out" => &mut out,
            "--truth" => &mut truth,
            "--rank" => {
                let rank = value
                    .and_then(|v| v.parse::<usize>().ok())
                    .filter(|rank| *rank <= LARGEST_RANK);
                let problem = || format!("--rank wants a number from 0 to {LARGEST_RANK}");
                settings.rank = Some(rank.ok_or_else(|| Error::Usage { problem: problem() })?);
                continue;
            }
            _ => {
                return Err(Error::Usage {
                    problem: format!("unknown option `{option}`"),
                });
            }
        };
        let value = value.ok_or_else(|| Error::Usage {
            problem: format!("{option} wants a file"),
        })?;
        *place = Some(value.into());
    }
    let missing = |option: &str| Error::Usage {
        problem: format!("{option} is missing"),
    };
    let tracks_path = tracks.ok_or_else(|| missing("--tracks"))?;
    let out = out.ok_or_else(|| missing("--out"))?;
    let tracks = Tracks::read(&tracks_path)?;
    let truth = truth
        .as_deref()
        .map(|path| truth_for(&tracks, path))
        .transpose()?;
    let gaps = 1.0 - tracks.sightings() as f64 / (tracks.frames() * tracks.points()) as f64;
    println!(
        "tracks: {} frames, {} points, {:.1} % missing",
        tracks.frames(),
        tracks.points(),
        100.0 * gaps
    );
    let start = Instant::now();
    let recovered = nrsfm(&tracks, &settings);
    println!(
        "recovered: rank {}, noise {:.4} (unit of the tracks), smoothness {:.3}, {:.2} s",
        recovered.rank,
        recovered.noise,
        recovered.smoothness,
        start.elapsed().as_secs_f64()
    );
    if let Some(truth) = &truth {
        print_errors(&tracks, &recovered.shapes, truth);
    }
    std::fs::write(&out, recovered.shapes.to_csv()).map_err(|source| {
        // A partial file is worse than none; that it cannot be removed adds nothing to the error reported.
        let _ = std::fs::remove_file(&out);
        Error::Write {
            path: out.clone(),
            source,
        }
    })?;
    println!("wrote {}", out.display());
    Ok(())
}

/// Ranks above this fit noise on any sequence a face gives, and cost cubically.
const LARGEST_RANK: usize = 30;

fn truth_for(tracks: &Tracks, path: &Path) -> Result<Shapes, Error> {
    let truth = Shapes::read(path)?;
    if (truth.frames(), truth.points) != (tracks.frames(), tracks.points()) {
        return Err(Error::TruthSize {
            frames: tracks.frames(),
            points: tracks.points(),
            found_frames: truth.frames(),
            found_points: truth.points,
        });
    }
    Ok(truth)
}

fn print_errors(tracks: &Tracks, shapes: &Shapes, truth: &Shapes) {
    let rigid = nrsfm(
        tracks,
        &Settings {
            rank: Some(0),
            ..Settings::default()
        },
    );
    let of = |shapes: &Shapes| shape_error(shapes, truth).unwrap_or(f64::NAN);
    println!(
        "error, mean of |S - truth| / |truth|, each frame rigidly aligned, the whole mirrored in depth if that fits better:"
    );
    println!("  recovered                           {:.4}", of(shapes));
    println!(
        "  rigid reconstruction, same tracks   {:.4}",
        of(&rigid.shapes)
    );
    println!(
        "  rigid mean of the true shapes       {:.4}",
        of(&rigid_mean_shape(truth))
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(args: &[&str]) -> String {
        run(&args.iter().map(ToString::to_string).collect::<Vec<_>>())
            .unwrap_err()
            .to_string()
    }

    #[test]
    fn bad_arguments_are_named() {
        assert!(refused(&[]).starts_with("--tracks is missing"));
        assert!(refused(&["--trakcs", "a"]).contains("unknown option `--trakcs`"));
        assert!(refused(&["--rank", "many"]).contains("0 to 30"));
        assert!(
            refused(&["--tracks", "no-such-file.csv", "--out", "o.csv"])
                .contains("cannot read no-such-file.csv")
        );
    }
}
