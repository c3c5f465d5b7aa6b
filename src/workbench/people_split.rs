//! The data sets, and a fixed split of the portraits by person.

use std::path::PathBuf;

/// Where the data sets are.
#[derive(Clone, Debug, clap::Args)]
pub struct Data {
    /// Folder of the data sets
    #[arg(
        long,
        env = "MIEN_DATA",
        hide_env_values = true,
        default_value = "../shared/data"
    )]
    pub data: PathBuf,
}

/// Allowed use of a person's pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Split {
    /// Training.
    Train,
    /// Choosing settings (`train --hold-out-dev` keeps them out); trained on in the end, as for the shipped model.
    Dev,
    /// Figures that are reported. Never trained on, never tuned on.
    Test,
}

impl Split {
    /// Split of the person at this index of the list sorted by (set, person).
    pub fn from_index(index: usize) -> Self {
        match index % 5 {
            0 => Self::Test,
            1 => Self::Dev,
            _ => Self::Train,
        }
    }

    /// Split of each (set, person), in the order given; equal entries get the same one.
    pub fn from_persons(persons: &[(&str, &str)]) -> Vec<Self> {
        let indices = numbered(persons).into_iter();
        indices.map(Self::from_index).collect()
    }
}

/// Index of each (set, person) in the sorted list of all.
pub fn numbered(persons: &[(&str, &str)]) -> Vec<usize> {
    let mut sorted = persons.to_vec();
    sorted.sort_unstable();
    sorted.dedup();
    let place = |person| sorted.binary_search(person).unwrap_or(0);
    persons.iter().map(place).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_person_stays_on_one_side() {
        let persons = [("b", "1"), ("a", "2"), ("a", "1"), ("b", "1"), ("c", "0")];
        let splits = Split::from_persons(&persons);
        assert_eq!(
            splits,
            [
                Split::Train,
                Split::Dev,
                Split::Test,
                Split::Train,
                Split::Train
            ]
        );
    }
}
