//! Tracks and shapes as CSV: `2F x P` image tracks in, `3F x P` shapes out.
//!
//! No header; row `2t` holds x, row `2t + 1` holds y of frame t, one column per point; a missing point is empty or `nan` in
//! either row. Units are the file's own. Everything is checked before use: a bad file is one sentence with the line.

use mien_workbench::fault::Fault;
use nalgebra::Vector2;
use std::fmt::Write as _;
use std::path::Path;

/// Image tracks of P points over F frames, possibly with gaps.
#[derive(Clone, Debug)]
pub struct Tracks {
    frames: usize,
    points: usize,
    /// `F * P` image points, frame by frame; `None` where missing.
    positions: Vec<Option<[f64; 2]>>,
}

impl Tracks {
    /// Tracks of `frames` x `points` image points, frame by frame; a point with a non-finite coordinate is missing.
    ///
    /// # Errors
    /// Too few frames or points, or a point seen in fewer than [`Tracks::LEAST_SIGHTINGS`] frames.
    pub fn new(frames: usize, points: usize, positions: Vec<[f64; 2]>) -> Result<Self, Fault> {
        if frames < Self::LEAST_FRAMES
            || points < Self::LEAST_POINTS
            || positions.len() != frames * points
        {
            return Err(Fault::new(format!(
                "expected at least 4 frames of at least 4 points, found {frames} frames of {points} points; track longer"
            )));
        }
        let seen = |p: &[f64; 2]| p.iter().all(|v| v.is_finite());
        let positions = positions.into_iter().map(|p| Some(p).filter(seen));
        let positions: Vec<_> = positions.collect();
        for point in 0..points {
            let of_point = positions.iter().skip(point).step_by(points);
            let sightings = of_point.flatten().count();
            if sightings < Self::LEAST_SIGHTINGS {
                return Err(Fault::new(format!(
                    "column {}: expected the point in at least 3 frames, found it in {sightings}; remove the column",
                    point + 1
                )));
            }
        }
        Ok(Self {
            frames,
            points,
            positions,
        })
    }

    /// Fewest frames for a reconstruction.
    pub const LEAST_FRAMES: usize = 4;
    /// Fewest points for a reconstruction.
    pub const LEAST_POINTS: usize = 4;
    /// Fewest frames in which every point must be seen.
    pub const LEAST_SIGHTINGS: usize = 3;

    /// Number of frames, F.
    pub fn frames(&self) -> usize {
        self.frames
    }

    /// Number of points, P.
    pub fn points(&self) -> usize {
        self.points
    }

    /// An image point; `None` where missing.
    pub fn position(&self, frame: usize, point: usize) -> Option<[f64; 2]> {
        self.positions[frame * self.points + point]
    }

    /// The seen points of a frame, with their positions.
    pub(crate) fn seen_in(&self, frame: usize) -> impl Iterator<Item = (usize, Vector2<f64>)> {
        let position = move |j| Some((j, self.position(frame, j)?.into()));
        (0..self.points).filter_map(position)
    }

    /// Whether a point is seen in a frame.
    pub fn is_seen(&self, frame: usize, point: usize) -> bool {
        self.position(frame, point).is_some()
    }

    /// Number of seen image points.
    pub fn sightings(&self) -> usize {
        self.positions.iter().flatten().count()
    }

    /// The same tracks with every coordinate multiplied by `factor`.
    pub(crate) fn scaled(&self, factor: f64) -> Self {
        let mut scaled = self.clone();
        let coordinates = scaled.positions.iter_mut().flatten().flatten();
        coordinates.for_each(|v| *v *= factor);
        scaled
    }

    /// Reads tracks from CSV text; see the module header.
    ///
    /// # Errors
    /// A field that is no number, uneven or odd rows, or too little data.
    pub fn parse(text: &str) -> Result<Self, Fault> {
        let rows = parse_rows(text)?;
        if rows.len() % 2 != 0 {
            return Err(broken_off(rows.len(), 2));
        }
        let frames = rows.len() / 2;
        let points = rows.first().map_or(0, Vec::len);
        let mut positions = Vec::with_capacity(frames * points);
        for pair in rows.chunks_exact(2) {
            positions.extend(pair[0].iter().zip(&pair[1]).map(|(x, y)| [*x, *y]));
        }
        Self::new(frames, points, positions)
    }

    /// Reads tracks from a file.
    ///
    /// # Errors
    /// As [`Tracks::parse`], or the file cannot be read; each names the file.
    pub fn read(path: &Path) -> Result<Self, Fault> {
        Self::parse(&read_text(path)?).map_err(Fault::within(path))
    }
}

/// 3D shapes of P points over F frames; the unit is that of the tracks they come from.
#[derive(Clone, Debug, PartialEq)]
pub struct Shapes {
    /// Number of points, P.
    pub points: usize,
    /// `F * P` points, frame by frame.
    pub positions: Vec<[f64; 3]>,
}

impl Shapes {
    /// Number of frames, F.
    pub fn frames(&self) -> usize {
        self.positions.len() / self.points.max(1)
    }

    /// The points of one frame.
    pub fn frame(&self, t: usize) -> &[[f64; 3]] {
        &self.positions[t * self.points..(t + 1) * self.points]
    }

    /// Reads `3F x P` rows.
    ///
    /// # Errors
    /// A field that is no number or is missing, uneven rows, or rows that are not a multiple of three.
    pub fn parse(text: &str) -> Result<Self, Fault> {
        let rows = parse_rows(text)?;
        if rows.len() % 3 != 0 || rows.is_empty() {
            return Err(broken_off(rows.len(), 3));
        }
        let points = rows[0].len();
        let mut positions = Vec::with_capacity(rows.len() / 3 * points);
        for (t, triple) in rows.chunks_exact(3).enumerate() {
            for j in 0..points {
                let p = [triple[0][j], triple[1][j], triple[2][j]];
                if let Some(axis) = p.iter().position(|v| !v.is_finite()) {
                    return Err(no_number(3 * t + axis + 1, j + 1, "nothing"));
                }
                positions.push(p);
            }
        }
        Ok(Self { points, positions })
    }

    /// Reads shapes from a file.
    ///
    /// # Errors
    /// As [`Shapes::parse`], or the file cannot be read; each names the file.
    pub fn read(path: &Path) -> Result<Self, Fault> {
        Self::parse(&read_text(path)?).map_err(Fault::within(path))
    }

    /// `3F x P` CSV text; [`Shapes::parse`] reads it back to the digits written.
    pub fn to_csv(&self) -> String {
        let mut text = String::with_capacity(self.positions.len() * 36);
        for t in 0..self.frames() {
            for axis in 0..3 {
                for (j, p) in self.frame(t).iter().enumerate() {
                    let comma = if j == 0 { "" } else { "," };
                    let _ = write!(text, "{comma}{:.9}", p[axis]);
                }
                text.push('\n');
            }
        }
        text
    }
}

fn read_text(path: &Path) -> Result<String, Fault> {
    let advice = "; give a CSV file of tracks";
    mien_workbench::text_files::read(path).map_err(Fault::cannot("read", path, advice))
}

/// An error: a field, line and column counted from 1, is no finite number.
fn no_number(line: usize, column: usize, found: &str) -> Fault {
    Fault::new(format!(
        "line {line}, column {column}: expected a number, found `{found}`; leave a missing point empty or write nan"
    ))
}

/// An error: the rows do not form whole frames.
fn broken_off(rows: usize, multiple: usize) -> Fault {
    Fault::new(format!(
        "expected a multiple of {multiple} rows, found {rows} rows; write {multiple} rows per frame, without a header"
    ))
}

/// Parses rows of numbers; missing fields become NaN.
fn parse_rows(text: &str) -> Result<Vec<Vec<f64>>, Fault> {
    let mut rows: Vec<Vec<f64>> = Vec::new();
    // A row with a single, missing point is an empty line; only the end of the file may be blank.
    for (i, line) in text.trim_end().lines().enumerate() {
        let mut row = Vec::with_capacity(rows.first().map_or(0, Vec::len));
        for (j, field) in line.split(',').enumerate() {
            let field = field.trim();
            if field.is_empty() || field.eq_ignore_ascii_case("nan") {
                row.push(f64::NAN);
                continue;
            }
            match field.parse::<f64>() {
                Ok(value) if value.abs() < MAX_COORDINATE => row.push(value),
                _ => {
                    let found: String = field.chars().take(24).collect();
                    return Err(no_number(i + 1, j + 1, &found));
                }
            }
        }
        if let Some(first) = rows.first()
            && first.len() != row.len()
        {
            return Err(Fault::new(format!(
                "line {}: expected {} columns as in the first line, found {}; write one column per point",
                i + 1,
                first.len(),
                row.len()
            )));
        }
        rows.push(row);
    }
    Ok(rows)
}

/// Largest coordinate: the squares of larger ones would spoil the sums.
const MAX_COORDINATE: f64 = 1e12;

/// Mean of the seen points of each frame; zero where nothing is seen.
pub(crate) fn mean_positions(tracks: &Tracks) -> Vec<Vector2<f64>> {
    (0..tracks.frames())
        .map(|t| {
            let sum = tracks.seen_in(t).fold(Vector2::zeros(), |s, (_, w)| s + w);
            sum / tracks.seen_in(t).count().max(1) as f64
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(text: &str) -> String {
        Tracks::parse(text).unwrap_err().to_string()
    }

    #[test]
    fn gaps_are_read_as_missing() {
        let mut text = String::new();
        for t in 0..4 {
            text += if t == 1 {
                "1,,3,4\n5,6,NaN,8\n"
            } else {
                "1,2,3,4\n5,6,7,8\n"
            };
        }
        let tracks = Tracks::parse(&text).unwrap();
        assert_eq!(
            (tracks.frames(), tracks.points(), tracks.sightings()),
            (4, 4, 14)
        );
        assert_eq!(tracks.position(0, 1), Some([2.0, 6.0]));
        assert_eq!((tracks.position(1, 1), tracks.position(1, 2)), (None, None));
    }

    #[test]
    fn bad_files_get_one_sentence() {
        assert!(message("1,2\n3,4\n5,6\n").contains("3 rows"));
        assert!(message("1,2\n3\n").contains("line 2"));
        assert!(
            message("1,2\n3,four\n").contains("line 2, column 2: expected a number, found `four`")
        );
        assert!(message("1,inf\n3,4\n").contains("found `inf`"));
        assert!(message("").contains("at least 4 frames"));
        let unseen = "1,2,3,nan\n1,2,3,4\n".repeat(5);
        assert!(message(&unseen).contains("column 4"));
    }

    #[test]
    fn shapes_survive_the_round_trip() {
        let shapes = Shapes {
            points: 2,
            positions: vec![
                [1.0, 2.5, -3.0],
                [4.0, 0.0, 6.0],
                [7.0, 8.0, 9.0],
                [0.5, 0.25, 0.125],
            ],
        };
        assert_eq!(Shapes::parse(&shapes.to_csv()).unwrap(), shapes);
        assert!(
            Shapes::parse("1,2\n3,\n5,6\n")
                .unwrap_err()
                .to_string()
                .contains("line 2")
        );
    }
}
