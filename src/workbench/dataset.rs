//! Annotated pictures: folders with `landmarks68.csv` or `.pts` beside PNG, JPEG or PGM files.
//!
//! Columns of the CSV are found by name (`file`, `x0`, `y0`, … and, if there, `set`, `person`, `expression`), others are
//! ignored; a row without points is not annotated. A `.pts` file holds 68 lines `x y` between braces. Pixels, pixel
//! centres are integers.

use std::path::{Path, PathBuf};

use image::GrayImage;
use image::imageops::{FilterType, resize};

use crate::csv;
use crate::fault::Fault;
use crate::text_files::{self, display_name, listed};
use mien_stages::base::bounded_read;
use mien_stages::base::capacity::LANDMARKS;
use mien_stages::landmarks::window::LumaImage;

fn unreadable(path: &Path) -> impl Fn(std::io::Error) -> Fault {
    let expected = "; expected a folder of pictures with landmarks68.csv or .pts files, or a table";
    Fault::cannot("read", path, expected)
}

/// An error in a line of a table, counted from 1.
pub fn malformed(path: &Path, line: usize, expected: &str, found: &str) -> Fault {
    let path = path.display();
    Fault::new(format!(
        "{path}, line {line}: expected {expected}, found {found:?}; correct the line or remove it"
    ))
}

/// An error: too few annotated pictures.
pub fn too_few(expected: usize, found: usize) -> Fault {
    Fault::new(format!(
        "expected at least {expected} annotated pictures to train on, found {found}; give more folders with --images"
    ))
}

/// One picture of a data set, not loaded yet.
pub struct Entry {
    /// File name as in the table.
    pub file: String,
    /// Path of the picture.
    pub path: PathBuf,
    /// Data set within the table; may be empty.
    pub set: String,
    /// Name of the person; the file name if unknown.
    pub person: String,
    /// `neutral`, `smile`, …; may be empty.
    pub expression: String,
    /// The 68 points in pixels, if annotated.
    pub points: Option<[[f32; 2]; LANDMARKS]>,
}

/// A view of a loaded picture for sampling.
pub fn picture(grey: &GrayImage) -> LumaImage<'_> {
    LumaImage {
        luma: grey,
        width: grey.width() as usize,
        height: grey.height() as usize,
    }
}

/// Loads a picture as luma, scaled by `scale` (at most 1 is useful) with area averaging.
///
/// # Errors
/// If it does not decode.
pub fn load_grey(path: &Path, scale: f32) -> Result<GrayImage, Fault> {
    let refuse = Fault::cannot("decode", path, "; expected a PNG, JPEG or PGM picture");
    let bytes =
        bounded_read::read_regular(path, text_files::MAX_BYTES).map_err(unreadable(path))?;
    let mut grey = image::load_from_memory(&bytes).map_err(refuse)?.to_luma8();
    let (width, height) = grey.dimensions();
    if width.min(height) < 2 {
        let expected = "expected a picture of 2 by 2 pixels at least";
        return Err(Fault::within(path)(format!(
            "{expected}, found {width} by {height}"
        )));
    }
    if scale < 0.99 {
        let [width, height] = [width, height].map(|side| (side as f32 * scale).round().max(2.0));
        grey = resize(&grey, width as u32, height as u32, FilterType::Triangle);
    }
    Ok(grey)
}

/// Largest distance of points from a picture's corner, pixels.
const MAX_COORDINATE_PX: f32 = 65_536.0;

fn is_coordinate(v: &f32) -> bool {
    v.abs() <= MAX_COORDINATE_PX
}

/// Reads the text of a table.
pub fn read(path: &Path) -> Result<String, Fault> {
    text_files::read(path).map_err(unreadable(path))
}

fn read_csv(folder: &Path, path: &Path) -> Result<Vec<Entry>, Fault> {
    let text = read(path)?;
    let table = csv::Table::new(&text);
    let malformed = |line, expected, found: &str| malformed(path, line, expected, found);
    let column = |name: &str| table.find(name);
    let file = column("file")
        .ok_or_else(|| malformed(1, "a column named file", &table.columns.join(",")))?;
    let names = (0..LANDMARKS).flat_map(|i| [format!("x{i}"), format!("y{i}")]);
    let xy = names.map(|name| column(&name).ok_or(format!("no {name}")));
    let xy = xy.collect::<Result<Vec<usize>, _>>();
    let xy = xy.map_err(|found| malformed(1, "columns x0,y0 to x67,y67", &found))?;
    let [set, person, expression] = ["set", "person", "expression"].map(column);
    let mut entries = Vec::new();
    for csv::Row { line, cells, .. } in table.rows() {
        let text = |at: Option<usize>| {
            let cell = at.and_then(|at| cells.get(at));
            cell.map_or(String::new(), |s| (*s).to_owned())
        };
        let values = xy.iter().map(|&at| cells.get(at).copied().unwrap_or(""));
        let points =
            points_in(values).map_err(|found| malformed(line, "136 numbers or none", found))?;
        let (file, mut person) = (text(Some(file)), text(person));
        if person.is_empty() {
            person.clone_from(&file);
        }
        let mut path = folder.join("img").join(&file);
        if !path.exists() {
            path = folder.join(&file);
        }
        entries.push(Entry {
            path,
            set: text(set),
            person,
            expression: text(expression),
            points,
            file,
        });
    }
    Ok(entries)
}

/// The points of a row, `None` if all of its cells are empty; the error is the first cell that is no number.
fn points_in<'a>(
    cells: impl Iterator<Item = &'a str> + Clone,
) -> Result<Option<[[f32; 2]; LANDMARKS]>, &'a str> {
    if cells.clone().all(str::is_empty) {
        return Ok(None);
    }
    let mut points = [[0.0; 2]; LANDMARKS];
    for (slot, cell) in points.as_flattened_mut().iter_mut().zip(cells) {
        let number = cell.parse().ok().filter(is_coordinate);
        *slot = number.ok_or(cell)?;
    }
    Ok(Some(points))
}

fn read_pts(path: &Path) -> Result<[[f32; 2]; LANDMARKS], Fault> {
    let text = read(path)?;
    let rest = text.split_once('{').map(|(_, rest)| rest);
    let inside = rest.and_then(|rest| rest.split_once('}'));
    let inside = inside.map_or(&*text, |(inside, _)| inside);
    let words = inside.split_ascii_whitespace();
    let numbers: Vec<f32> = words.filter_map(|w| w.parse().ok()).collect();
    if let Some(odd) = numbers.iter().find(|v| !is_coordinate(v)) {
        return Err(malformed(path, 1, "pixels of a picture", &odd.to_string()));
    }
    if numbers.len() != 2 * LANDMARKS {
        let expected = "68 lines of x and y between braces";
        let found = format!("{} numbers", numbers.len());
        return Err(malformed(path, 1, expected, &found));
    }
    let points = numbers.as_chunks::<2>().0;
    Ok(std::array::from_fn(|i| points[i]))
}

/// All pictures of a folder, with their points if annotated; in the order of the table, else sorted by name.
///
/// # Errors
/// If the folder or its table is not readable or it holds no picture.
pub fn read_folder(folder: &Path) -> Result<Vec<Entry>, Fault> {
    let table = folder.join("landmarks68.csv");
    if table.exists() {
        return read_csv(folder, &table);
    }
    let mut paths = listed(folder).map_err(unreadable(folder))?;
    let known = ["png", "jpg", "jpeg", "pgm"];
    paths.retain(|path| {
        let ending = path.extension().unwrap_or_default();
        known.iter().any(|known| ending.eq_ignore_ascii_case(known))
    });
    if paths.is_empty() {
        return Err(Fault::within(folder)(
            "expected pictures (PNG, JPEG or PGM), found none; give another folder",
        ));
    }
    let entry = |path: PathBuf| {
        let file = display_name(&path);
        let pts = path.with_extension("pts");
        Ok(Entry {
            points: pts.exists().then(|| read_pts(&pts)).transpose()?,
            person: file.clone(),
            set: String::new(),
            expression: String::new(),
            file,
            path,
        })
    };
    paths.into_iter().map(entry).collect()
}
