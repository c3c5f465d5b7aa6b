//! Annotated portraits: photograph, 68 points, and who it is.

use std::fs;
use std::path::{Path, PathBuf};

use crate::base::capacity::LANDMARKS;
use crate::simulator::virtual_head::Texture;
use crate::studio::csv;
use crate::studio::fault::Fault;

/// One annotated photograph.
#[derive(Clone, Debug)]
pub struct Portrait {
    /// Where the photograph is.
    pub path: PathBuf,
    /// Place of the person in the list of all persons sorted by (set, person): decides the split.
    pub person: usize,
    /// The 68 points, pixels (pixel centres are integers).
    pub points: [[f32; 2]; LANDMARKS],
}

impl Portrait {
    /// Decodes the photograph.
    ///
    /// # Errors
    /// If it cannot be decoded.
    pub fn photograph(&self) -> Result<Texture, Fault> {
        let advice = "; expected a JPEG or PNG photograph";
        let picture = image::open(&self.path).map_err(Fault::cannot("decode", &self.path, advice));
        let picture = picture?.to_rgb8();
        Ok(Texture {
            width: picture.width() as usize,
            height: picture.height() as usize,
            rgb: picture.into_raw(),
        })
    }
}

/// Reads the table of a folder (`landmarks68.csv`, photographs in `img/`); photographs without points are left out.
///
/// # Errors
/// If the table cannot be read or lacks a column.
pub fn read(folder: &Path) -> Result<Vec<Portrait>, Fault> {
    let path = folder.join("landmarks68.csv");
    let advice = "; expected the table of the portraits' points";
    let text = fs::read_to_string(&path).map_err(Fault::cannot("read", &path, advice))?;
    let table = csv::Table::new(&text);
    let column = |name: &str| {
        table.find(name).ok_or_else(|| {
            let found: String = table.header.chars().take(80).collect();
            let expected = "columns file, set, person, expression, x0, y0, … x67, y67";
            Fault::within(&path)(format!("expected {expected}, found {found:?}"))
        })
    };
    let [file, set, person, first] = ["file", "set", "person", "x0"].map(column);
    let (file, set, person, first) = (file?, set?, person?, first?);
    let rows: Vec<Vec<&str>> = table.rows().map(|row| row.cells).collect();
    let cell = |row: &[&str], k: usize| row.get(k).copied().unwrap_or_default().to_owned();
    let of = |row: &Vec<&str>| (cell(row, set), cell(row, person));
    let mut persons: Vec<(String, String)> = rows.iter().map(of).collect();
    persons.sort_unstable();
    persons.dedup();
    let mut portraits = Vec::new();
    for row in &rows {
        let numbers = (0..2 * LANDMARKS).filter_map(|k| row.get(first + k)?.parse().ok());
        let numbers: Vec<f32> = numbers.filter(|x: &f32| x.is_finite()).collect();
        if numbers.len() == 2 * LANDMARKS {
            portraits.push(Portrait {
                path: folder.join("img").join(cell(row, file)),
                person: persons.binary_search(&of(row)).unwrap_or(0),
                points: std::array::from_fn(|k| [numbers[2 * k], numbers[2 * k + 1]]),
            });
        }
    }
    Ok(portraits)
}
