//! The workstation: training, pictures, recordings, baking.
fn main() {}
