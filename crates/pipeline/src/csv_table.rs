//! How is a CSV file of a recording read and written? By column name. Errors name file, line and reason.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, bail, ensure};
use localize::input_file;
use vision::csv_error::reason;
use vision::output_file::OutputFile;

use crate::table_input::{COMMENT, ReadingProgress, TableInput};

/// A CSV file in memory: its rows with their line numbers.
pub struct CsvTable {
    path: PathBuf,
    columns: Vec<String>,
    rows: Vec<(u64, csv::StringRecord)>,
}

/// One row of a table, read by column name.
#[derive(Clone, Copy)]
pub struct CsvRow<'a> {
    table: &'a CsvTable,
    line: u64,
    record: &'a csv::StringRecord,
}

impl CsvTable {
    /// Reads a file that has at least the named columns, in any order.
    pub fn read(path: &Path, required: &[&str]) -> Result<Self> {
        let file =
            input_file::open(path).with_context(|| format!("cannot read {}", path.display()))?;
        let progress = ReadingProgress::new();
        let input = TableInput::new(file, progress.clone());
        let mut reader = csv::ReaderBuilder::new()
            .trim(csv::Trim::Headers)
            .comment(Some(COMMENT))
            .from_reader(input);
        let location = |index: usize| {
            let line = progress.line_of_record(index);
            format!("{}: line {line}", path.display())
        };
        let header = reader
            .headers()
            .map_err(|error| anyhow!("{}: {}", location(0), reason(&error)))?;
        progress.end_record();
        let columns: Vec<String> = header
            .iter()
            .map(|name| name.trim_start_matches('\u{feff}').to_owned())
            .collect();
        for (index, name) in columns.iter().enumerate() {
            // Columns are read by name: which of the two is meant is unknown.
            ensure!(
                name.is_empty() || !columns[..index].contains(name),
                "{}: the column {name} is there twice (found {})",
                location(0),
                columns.join(",")
            );
        }
        ensure!(
            columns.iter().any(|name| !name.is_empty()),
            "{}: no header: the file is empty",
            path.display()
        );
        for name in required {
            if !columns.iter().any(|column| column == name) {
                bail!(
                    "{}: no column {name} (found {})",
                    location(0),
                    columns.join(",")
                );
            }
        }
        let mut rows = Vec::new();
        for (index, record) in reader.records().enumerate() {
            let mut record =
                record.map_err(|error| anyhow!("{}: {}", location(index + 1), reason(&error)))?;
            progress.end_record();
            // No column holds text of several lines: the rows that it swallowed would be missing without a word.
            ensure!(
                !record.iter().any(|field| field.contains(['\n', '\r'])),
                "{}: a quotation mark that is not closed on its line",
                location(index + 1)
            );
            record.trim();
            rows.push((progress.line_of_record(index + 1), record));
        }
        Ok(CsvTable {
            path: path.to_owned(),
            columns,
            rows,
        })
    }

    /// The rows in the order of the file.
    pub fn rows(&self) -> impl Iterator<Item = CsvRow<'_>> {
        self.rows.iter().map(|(line, record)| CsvRow {
            table: self,
            line: *line,
            record,
        })
    }
}

impl<'a> CsvRow<'a> {
    /// The field's text.
    pub fn text(&self, column: &str) -> Result<&'a str> {
        let index = self.table.columns.iter().position(|name| name == column);
        index
            .and_then(|index| self.record.get(index))
            .with_context(|| format!("{}: no column {column}", self.location()))
    }

    /// The field as a finite number.
    pub fn number(&self, column: &str) -> Result<f64> {
        let text = self.text(column)?;
        let value: f64 = text
            .parse()
            .ok()
            .with_context(|| format!("{}: {column} = {text:?} is not a number", self.location()))?;
        ensure!(
            value.is_finite(),
            "{}: {column} = {text} is not finite",
            self.location()
        );
        // Most columns become numbers of 32 bits.
        ensure!(
            value.abs() <= f64::from(f32::MAX),
            "{}: {column} = {text} is too large a number",
            self.location()
        );
        Ok(value)
    }

    /// The field as a finite number. None without the column, or if the field is empty.
    pub fn optional_number(&self, column: &str) -> Result<Option<f64>> {
        match self.text(column) {
            Err(_) | Ok("") => Ok(None),
            Ok(_) => self.number(column).map(Some),
        }
    }

    /// File and line, for error messages.
    pub fn location(&self) -> String {
        format!("{}: line {}", self.table.path.display(), self.line)
    }
}

/// A CSV file that is written row by row.
pub struct CsvWriter {
    path: PathBuf,
    out: OutputFile,
}

impl CsvWriter {
    /// Starts a file that gets its name only when it is complete. Links are followed; pipes and devices are written directly.
    pub fn create(path: &Path, header: &str) -> Result<Self> {
        CsvWriter::start(path, header, OutputFile::create(path))
    }

    /// Starts a file that has its name from the start, for a folder that appears when it is complete: the rows before
    /// [`CsvWriter::flush`] outlive a killed process.
    pub fn create_in_place(path: &Path, header: &str) -> Result<Self> {
        CsvWriter::start(path, header, OutputFile::create_in_place(path))
    }

    fn start(path: &Path, header: &str, out: std::io::Result<OutputFile>) -> Result<Self> {
        let out = out.with_context(|| format!("cannot write {}", path.display()))?;
        let mut writer = CsvWriter {
            path: path.to_owned(),
            out,
        };
        writer.write_row(format_args!("{header}"))?;
        Ok(writer)
    }

    /// Adds one line.
    pub fn write_row(&mut self, row: std::fmt::Arguments<'_>) -> Result<()> {
        writeln!(self.out, "{row}").with_context(|| format!("cannot write {}", self.path.display()))
    }

    /// Passes all rows to the system.
    pub fn flush(&mut self) -> Result<()> {
        self.out
            .flush()
            .with_context(|| format!("cannot write {}", self.path.display()))
    }

    /// Completes the file and gives it its name.
    pub fn finish(self) -> Result<()> {
        self.out
            .finish()
            .with_context(|| format!("cannot write {}", self.path.display()))
    }
}

/// Seconds with at least three decimals, more if the stamp needs them.
pub fn format_seconds(stamp: localize::Stamp) -> String {
    let nanoseconds = stamp.0.unsigned_abs();
    let sign = if stamp.0 < 0 { "-" } else { "" };
    let mut text = format!(
        "{sign}{}.{:09}",
        nanoseconds / 1_000_000_000,
        nanoseconds % 1_000_000_000
    );
    while text.ends_with('0')
        && !text.ends_with(".000")
        && text.len() - text.find('.').unwrap_or(0) > 4
    {
        text.pop();
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use localize::Stamp;

    fn file(content: &str) -> (tempfile::TempDir, PathBuf) {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("odometry.csv");
        std::fs::write(&path, content).expect("written");
        (folder, path)
    }

    #[test]
    fn non_numeric_field_is_reported_with_its_line() {
        let (_folder, path) = file("stamp_s,dx_m\n0.0,0.1\n0.1,fast\n");
        let table = CsvTable::read(&path, &["stamp_s", "dx_m"]).expect("a table");
        let message = table
            .rows()
            .nth(1)
            .expect("a row")
            .number("dx_m")
            .expect_err("not a number")
            .to_string();
        assert!(
            message.contains("line 3") && message.contains("\"fast\""),
            "{message}"
        );
    }

    #[test]
    fn empty_lines_and_comments_count_as_lines() {
        let (_folder, path) = file("# drive\nstamp_s,dx_m\n\n# rest\n0.0,0.1\r\n\r\n0.1,fast\n");
        let table = CsvTable::read(&path, &["stamp_s"]).expect("a table");
        let lines: Vec<_> = table.rows().map(|row| row.line).collect();
        assert_eq!(lines, [5, 7]);
    }

    #[test]
    fn short_row_is_reported_with_its_line() {
        let (_folder, path) = file("stamp_s,dx_m\n0.0,0.1\n0.1\n");
        let message = CsvTable::read(&path, &["stamp_s"])
            .err()
            .expect("short")
            .to_string();
        assert!(
            message.contains("line 3: has 1 fields, the header has 2"),
            "{message}"
        );
    }

    #[test]
    fn column_that_is_there_twice_is_refused() {
        let (_folder, path) = file("# drive\nstamp_s, dx_m,dx_m\n0.0,0.1,0.2\n");
        let read = CsvTable::read(&path, &["stamp_s"]);
        let message = read.err().expect("twice").to_string();
        let wanted = "line 2: the column dx_m is there twice (found stamp_s,dx_m,dx_m)";
        assert!(message.ends_with(wanted), "{message}");
    }

    #[test]
    fn quotation_mark_that_swallows_rows_is_reported_with_its_line() {
        for (text, line) in [
            ("stamp_s,file\n0.0,a.png\n0.1,\"b.png\n0.2,c.png\n", 3),
            (
                "stamp_s,file\n# note\n\n0.0,\"a.png\n0.1,b.png\"\n0.2,c.png\n",
                4,
            ),
            ("stamp_s,file\n0.0,a.png\n0.1,\"b.png\n", 3),
            (
                "# a\r\n\r\nstamp_s,file\r\n# b\r\n0.0,a.png\r\n0.1,\"b.png\r\n",
                6,
            ),
        ] {
            let (_folder, path) = file(text);
            let read = CsvTable::read(&path, &["stamp_s", "file"]);
            let message = read.err().expect("swallowed").to_string();
            let wanted = format!("line {line}: a quotation mark that is not closed on its line");
            assert!(message.ends_with(&wanted), "{message}");
        }
        let (_folder, path) = file("stamp_s,file\r\n0.0,\"a,b.png\"\r\n 0.1 , c.png \r\n");
        let table = CsvTable::read(&path, &["stamp_s", "file"]).expect("a table");
        let files: Vec<_> = table
            .rows()
            .map(|row| row.text("file").expect("text"))
            .collect();
        assert_eq!(files, ["a,b.png", "c.png"]);
    }

    #[test]
    fn number_beyond_32_bits_is_refused_as_it_is_written() {
        let (_folder, path) = file("stamp_s,dx_m\n0.0,1e300\n");
        let table = CsvTable::read(&path, &["stamp_s"]).expect("a table");
        let row = table.rows().next().expect("a row");
        let message = row.number("dx_m").expect_err("too large").to_string();
        assert!(
            message.ends_with("line 2: dx_m = 1e300 is too large a number"),
            "{message}"
        );
    }

    #[test]
    fn optional_number_may_be_absent_but_is_a_number() {
        let (_folder, path) = file("stamp_s,range_m\n0.0,1.5\n0.1,\n0.2,far\n");
        let table = CsvTable::read(&path, &["stamp_s"]).expect("a table");
        let read = |column: &str| -> Vec<Option<f64>> {
            let numbers = table.rows().map(|row| row.optional_number(column));
            numbers.map_while(Result::ok).collect()
        };
        assert_eq!(read("range_m"), [Some(1.5), None]);
        assert_eq!(read("size_m"), [None; 3]);
    }

    #[test]
    fn record_that_does_not_end_is_refused() {
        let (_folder, path) = file("stamp_s,dx_m\n0.0,0.1\n0.1,\"");
        let mut text = std::fs::read_to_string(&path).expect("read");
        text.push_str(&"0.2,0.1\n".repeat(1 << 18));
        std::fs::write(&path, text).expect("written");
        let error = CsvTable::read(&path, &["stamp_s"]).err().expect("endless");
        let message = error.to_string();
        assert!(
            message.ends_with("a record is longer than 1048576 bytes"),
            "{message}"
        );
    }

    #[test]
    fn table_of_many_short_records_is_read() {
        let rows = 1 << 18;
        let (_folder, path) = file(&format!("stamp_s\n{}", "0.125\n".repeat(rows)));
        let table = CsvTable::read(&path, &["stamp_s"]).expect("a table");
        assert_eq!(table.rows().count(), rows);
    }

    #[test]
    fn endless_device_is_no_table() {
        let error = CsvTable::read(Path::new("/dev/zero"), &[])
            .err()
            .expect("endless");
        assert_eq!(
            format!("{error:#}"),
            "cannot read /dev/zero: not a regular file"
        );
    }

    #[test]
    fn unfinished_csv_leaves_no_file() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("poses.csv");
        let mut written = CsvWriter::create(&path, "a,b").expect("created");
        written.write_row(format_args!("1,2")).expect("written");
        drop(written);
        assert_eq!(std::fs::read_dir(folder.path()).expect("listed").count(), 0);
    }

    #[test]
    fn stamps_keep_their_decimals() {
        assert_eq!(format_seconds(Stamp(100_000_000)), "0.100");
        assert_eq!(format_seconds(Stamp(33_333_333)), "0.033333333");
        assert_eq!(format_seconds(Stamp(-1_500_000_000)), "-1.500");
        assert_eq!(format_seconds(Stamp(40_000_000_000)), "40.000");
    }
}
