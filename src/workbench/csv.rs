//! Tables as comma-separated text: columns are found by name, cells are trimmed, lines with nothing in them are passed over.
//!
//! No quotes: none of the tables has commas or line ends in a cell. What a missing column or a damaged cell means is for
//! the reader of each table to say.

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
    /// Counted from 1 with the header.
    pub line: usize,
    /// As it stands.
    pub text: &'a str,
    /// One per comma, and one more; as many as there are, whatever the header has.
    pub cells: Vec<&'a str>,
}

impl<'a> Table<'a> {
    /// A table with the first line of a text as its header; of no text, one without columns or rows.
    pub fn new(text: &'a str) -> Self {
        let mut lines = text.lines();
        let header = lines.next().unwrap_or_default();
        Self {
            header,
            columns: cells(header),
            lines,
        }
    }

    /// Where a column stands in a row.
    pub fn find(&self, column: &str) -> Option<usize> {
        self.columns.iter().position(|name| *name == column)
    }

    /// Where several columns stand in a row, if all of them are there.
    pub fn find_all<N: AsRef<str>>(
        &self,
        columns: impl IntoIterator<Item = N>,
    ) -> Option<Vec<usize>> {
        let found = columns.into_iter().map(|name| self.find(name.as_ref()));
        found.collect()
    }

    /// Where x and y of the 68 points stand in a row, if all of them are there.
    pub fn find_points(&self) -> Option<Vec<usize>> {
        self.find_all((0..LANDMARKS).flat_map(|k| [format!("x{k}"), format!("y{k}")]))
    }

    /// Columns whose names begin so: the rest of the name, and where they stand.
    pub fn beginning_with(&self, prefix: &str) -> Vec<(&'a str, usize)> {
        let columns = self.columns.iter().zip(0..);
        columns
            .filter_map(|(name, at)| Some((name.strip_prefix(prefix)?, at)))
            .collect()
    }

    /// The lines below the header.
    pub fn rows(&self) -> impl Iterator<Item = Row<'a>> + use<'a> {
        let numbered = self.lines.clone().zip(2..);
        numbered
            .filter(|(text, _)| !text.trim().is_empty())
            .map(|(text, line)| Row {
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
