//! Comma-separated tables: columns are found by name, cells are trimmed, blank lines skipped.
//!
//! No quotes: no table has commas or line ends in a cell. Each table's reader decides on missing columns and damaged
//! cells.

use mien_stages::base::capacity::LANDMARKS;

/// Cells of a line, trimmed.
pub fn cells(line: &str) -> Vec<&str> {
    line.split(',').map(str::trim).collect()
}

/// A table with a header.
pub struct Table<'a> {
    /// The first line.
    pub header: &'a str,
    /// Names of the columns.
    pub columns: Vec<&'a str>,
    lines: std::str::Lines<'a>,
}

/// A line of a table below its header.
pub struct Row<'a> {
    /// Line number, from 1 with the header.
    pub line: usize,
    /// The unchanged text.
    pub text: &'a str,
    /// The cells, however many the header has.
    pub cells: Vec<&'a str>,
}

impl<'a> Table<'a> {
    /// Reads a table whose header is the text's first line; empty without text.
    pub fn new(text: &'a str) -> Self {
        let mut lines = text.lines();
        let header = lines.next().unwrap_or_default();
        Self {
            header,
            columns: cells(header),
            lines,
        }
    }

    /// Index of a column, if it exists.
    pub fn find(&self, column: &str) -> Option<usize> {
        self.columns.iter().position(|name| *name == column)
    }

    /// Indices of several columns, if all exist.
    pub fn find_all<N: AsRef<str>>(
        &self,
        columns: impl IntoIterator<Item = N>,
    ) -> Option<Vec<usize>> {
        let found = columns.into_iter().map(|name| self.find(name.as_ref()));
        found.collect()
    }

    /// Indices of x and y of the 68 points, if all exist.
    pub fn find_points(&self) -> Option<Vec<usize>> {
        self.find_all((0..LANDMARKS).flat_map(|k| [format!("x{k}"), format!("y{k}")]))
    }

    /// Columns whose names begin with a prefix: the rest of the name, and the index.
    pub fn beginning_with(&self, prefix: &str) -> Vec<(&'a str, usize)> {
        let rest = |(name, at): (&&'a str, _)| Some((name.strip_prefix(prefix)?, at));
        self.columns.iter().zip(0..).filter_map(rest).collect()
    }

    /// The rows below the header.
    pub fn rows(&self) -> impl Iterator<Item = Row<'a>> + use<'a> {
        let numbered = self.lines.clone().zip(2..);
        let filled = numbered.filter(|(text, _)| !text.trim().is_empty());
        filled.map(|(text, line)| Row {
            line,
            text,
            cells: cells(text),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::Table;

    #[test]
    fn columns_are_found_by_name_and_lines_are_counted_as_an_editor_does() {
        let table = Table::new("file, x0 ,y0\r\n\r\na.png, 1,2\n  \nb.png,3\n");
        assert_eq!(table.find("x0"), Some(1));
        assert_eq!(table.find("z0"), None);
        let rows: Vec<_> = table.rows().map(|row| (row.line, row.cells)).collect();
        assert_eq!(
            rows,
            [(3, vec!["a.png", "1", "2"]), (5, vec!["b.png", "3"])]
        );
        assert_eq!(Table::new("").rows().count(), 0);
    }
}
