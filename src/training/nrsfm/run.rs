//! The command `mien-studio nrsfm`.

use super::align::{rigid_mean_shape, shape_error};
use super::reconstruction::{Settings, nrsfm};
use super::tracks::{Shapes, Tracks};
use mien_workbench::atomic_write::write_out;
use mien_workbench::fault::Fault;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Tracks in, shapes out.
#[derive(clap::Args)]
pub struct Args {
    /// 2F x P image tracks: x row, y row per frame; a missing point is empty or nan
    #[arg(long)]
    tracks: PathBuf,
    /// Number of shape modes, 0 for a rigid reconstruction [default: chosen from the tracks]
    // Ranks above this fit noise on any sequence a face gives, and cost cubically.
    #[arg(long, value_parser = clap::value_parser!(u8).range(0..=30))]
    rank: Option<u8>,
    /// 3F x P shapes to write
    #[arg(long)]
    pub out: PathBuf,
    /// 3F x P true shapes, to print the error: each frame rigidly aligned, one reflection for the whole sequence
    #[arg(long)]
    truth: Option<PathBuf>,
}

/// Recovers the shapes behind the tracks of one file and writes them to another; prints one line per step.
///
/// # Errors
/// Files that cannot be read, parsed or written. Nothing is written then.
pub fn run(args: &Args) -> Result<(), Fault> {
    let settings = Settings {
        rank: args.rank.map(usize::from),
        ..Settings::default()
    };
    let tracks = Tracks::read(&args.tracks)?;
    let truth = args.truth.as_deref();
    let truth = truth.map(|path| truth_for(&tracks, path)).transpose()?;
    let (frames, points) = (tracks.frames(), tracks.points());
    let gaps = 100.0 * (1.0 - tracks.sightings() as f64 / (frames * points) as f64);
    println!("tracks: {frames} frames, {points} points, {gaps:.1} % missing");
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
    write_out(&args.out, recovered.shapes.to_csv())?;
    println!("wrote {}", args.out.display());
    Ok(())
}

fn truth_for(tracks: &Tracks, path: &Path) -> Result<Shapes, Fault> {
    let truth = Shapes::read(path)?;
    if (truth.frames(), truth.points) != (tracks.frames(), tracks.points()) {
        return Err(Fault::new(format!(
            "expected truth of {} frames and {} points as in the tracks, found {} of {}; give the shapes of the same sequence",
            tracks.frames(),
            tracks.points(),
            truth.frames(),
            truth.points
        )));
    }
    Ok(truth)
}

fn print_errors(tracks: &Tracks, shapes: &Shapes, truth: &Shapes) {
    let settings = Settings {
        rank: Some(0),
        ..Settings::default()
    };
    let rigid = nrsfm(tracks, &settings).shapes;
    let of = |shapes: &Shapes| shape_error(shapes, truth).unwrap_or(f64::NAN);
    println!(
        "error: mean of |S - truth| / |truth|, each frame rigidly aligned, all mirrored in depth if that fits better:"
    );
    println!("  recovered                           {:.4}", of(shapes));
    println!("  rigid reconstruction, same tracks   {:.4}", of(&rigid));
    let mean = of(&rigid_mean_shape(truth));
    println!("  rigid mean of the true shapes       {mean:.4}");
}
