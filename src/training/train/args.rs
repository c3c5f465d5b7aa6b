//! The words of `mien-studio train`.

use std::path::PathBuf;

use mien_workbench::people_split::Data;

/// What to train from and where to write.
#[derive(Clone, Debug, clap::Args)]
pub struct TrainArgs {
    /// Folders of annotated portraits
    #[arg(long, num_args = 1.., required_unless_present_any = ["paper_into", "person"])]
    pub images: Vec<PathBuf>,
    /// Model file to write
    #[arg(long)]
    pub out: PathBuf,
    /// The heads to draw (`ict_facekit`) and the photographs that are their textures (`faces_frl189`).
    #[command(flatten)]
    pub data: Data,
    /// Number of rendered faces to train on
    #[arg(long, default_value_t = 200_000)]
    pub drawn: usize,
    /// Folder of other head shapes, of every age, that some of the faces get; tests/people/run --shapes FOLDER writes it
    #[arg(long)]
    pub shapes: Option<PathBuf>,
    /// Number of perturbed starts for each portrait and its mirror image
    #[arg(long, default_value_t = 32)]
    pub starts: usize,
    /// Seed of everything random
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Tracks of an actor, to give the paper's model that actor's 3D shape [default: a rendered actor]
    #[arg(long)]
    pub tracks: Option<PathBuf>,
    /// Where to write the mean offset of each landmark
    #[arg(long)]
    pub offsets: Option<PathBuf>,
    /// Model file from which the paper's appearance model is kept
    #[arg(long)]
    pub paper_of: Option<PathBuf>,
    /// Train the paper's appearance model alone and put it into this model file, which otherwise stays the same
    #[arg(long)]
    pub paper_into: Option<PathBuf>,
    /// Train the template of a face for the search in whole pictures alone, and write it instead of a model
    #[arg(long, conflicts_with_all = ["paper_into", "person"])]
    pub template: bool,
    /// Convert this model of version 3 to the current format, on faces like those of the training, instead of training one
    #[arg(long, conflicts_with_all = ["paper_into", "person", "template"])]
    pub round: Option<PathBuf>,
    /// A recording of one person who goes through all expressions: train a model of that person alone
    #[arg(long)]
    pub person: Option<PathBuf>,
    /// Also hold out the people used for choosing settings, to evaluate on them
    #[arg(long)]
    pub hold_out_dev: bool,
}
