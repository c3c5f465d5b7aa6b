//! The command `mien-studio nrsfm`.

use super::align::{rigid_mean_shape, shape_error};
use super::error::Error;
use super::reconstruction::{Settings, nrsfm};
use super::tracks::{Shapes, Tracks};
use crate::studio::atomic_write;
use std::path::Path;
use std::time::Instant;

/// Recovers the shapes behind the tracks of one file and writes them to `out`; prints one line per step.
///
/// # Errors
/// A rank beyond reason, files that cannot be read, parsed or written. Nothing is written then.
pub fn run(
    tracks: &Path,
    rank: Option<usize>,
    out: &Path,
    truth: Option<&Path>,
) -> Result<(), Error> {
    if rank.is_some_and(|rank| rank > LARGEST_RANK) {
        return Err(Error::Usage {
            problem: format!("--rank wants a number from 0 to {LARGEST_RANK}"),
        });
    }
    let settings = Settings {
        rank,
        ..Settings::default()
    };
    let tracks = Tracks::read(tracks)?;
    let truth = truth.map(|path| truth_for(&tracks, path)).transpose()?;
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
    atomic_write::write(out, recovered.shapes.to_csv()).map_err(|source| Error::Write {
        path: out.into(),
        source,
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
        "error: mean of |S - truth| / |truth|, each frame rigidly aligned, all mirrored in depth if that fits better:"
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

    #[test]
    fn bad_arguments_are_named() {
        let refused = |rank| {
            let error = run(
                Path::new("no-such-file.csv"),
                rank,
                Path::new("o.csv"),
                None,
            );
            error.unwrap_err().to_string()
        };
        assert!(refused(Some(31)).contains("0 to 30"));
        assert!(refused(None).contains("cannot read no-such-file.csv"));
    }
}
