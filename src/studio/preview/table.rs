//! Plays the CSV of a run, or any table that [`Columns`] reads.
//!
//! Every row is sent as it is read and kept by the hub, so that the page can scrub back. Damaged rows are counted and skipped.
//! From standard input (`-`) rows are shown as they arrive.

use std::io::{BufRead, Read};
use std::path::Path;

use super::hub::Hub;
use mien_outputs::csv::Columns;
use mien_outputs::received::Receive as _;
use mien_workbench::fault::Fault;
use mien_workbench::text_files::decoded;

/// Longest line, bytes: a row has some 3 kB.
const MAX_LINE: u64 = 1 << 16;

/// Opens the table and reads its header.
///
/// # Errors
/// If it cannot be read or is another kind of table.
pub fn open(path: &Path) -> Result<(Columns, Box<dyn BufRead + Send>), Fault> {
    let unreadable = Fault::cannot("read", path, "");
    let file: Box<dyn Read + Send> = match path.as_os_str() == "-" {
        true => Box::new(std::io::stdin()),
        false => Box::new(std::fs::File::open(path).map_err(&unreadable)?),
    };
    let mut reader = std::io::BufReader::new(file);
    let mut header = Vec::new();
    let mut first = reader.by_ref().take(MAX_LINE);
    first.read_until(b'\n', &mut header).map_err(unreadable)?;
    let header = decoded(&header);
    let table = Columns::new(&header).ok_or_else(|| {
        let found: String = header.trim_end().chars().take(60).collect();
        Fault::within(path)(format!(
            "line 1: expected a header with time_us, user and w_<unit> columns, found {found:?}; mien run --csv writes one"
        ))
    })?;
    Ok((table, Box::new(reader)))
}

/// Sends all rows to the hub.
pub fn play(mut table: Columns, mut reader: Box<dyn BufRead + Send>, hub: &Hub) {
    let mut line = Vec::new();
    loop {
        line.clear();
        match reader.by_ref().take(MAX_LINE).read_until(b'\n', &mut line) {
            Ok(0) => break,
            Ok(_) if line.trim_ascii().is_empty() => {}
            Ok(_) => match table.row(&String::from_utf8_lossy(&line)) {
                Some(sample) => {
                    hub.sample(&sample);
                    hub.count(1, 0);
                }
                None => hub.count(0, 1),
            },
            Err(error) => {
                hub.note(&format!("the CSV ends early: {error}"));
                break;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_kind_of_table_is_refused_with_its_first_line() {
        let path = std::env::temp_dir().join(format!("mien-table-{}.csv", std::process::id()));
        std::fs::write(&path, "a,b\n1,2\n").unwrap();
        let wrong = open(&path).err().unwrap().to_string();
        std::fs::remove_file(&path).unwrap();
        assert!(wrong.contains("time_us") && wrong.contains("\"a,b\""));
    }
}
