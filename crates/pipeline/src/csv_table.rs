//! How is a CSV file of a recording read and written? By column name. Errors name file, line and reason.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use vision::output_file::OutputFile;

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
        let mut reader = csv::ReaderBuilder::new()
            .trim(csv::Trim::All)
            .comment(Some(b'#'))
            .from_path(path)
            .with_context(|| format!("cannot read {}", path.display()))?;
        let header = reader
            .headers()
            .with_context(|| format!("{}: line 1", path.display()))?;
        let columns: Vec<String> = header
            .iter()
            .map(|name| name.trim_start_matches('\u{feff}').to_owned())
            .collect();
        for name in required {
            if !columns.iter().any(|column| column == name) {
                bail!(
                    "{}: line 1: no column {name} (found {})",
                    path.display(),
                    columns.join(",")
                );
            }
        }
        let mut rows = Vec::new();
        for record in reader.records() {
            let record = record.map_err(|error| {
                let line = error.position().map_or(0, csv::Position::line);
                anyhow::anyhow!("{}: line {line}: {}", path.display(), reason(&error))
            })?;
            rows.push((record.position().map_or(0, csv::Position::line), record));
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

fn reason(error: &csv::Error) -> String {
    match error.kind() {
        csv::ErrorKind::UnequalLengths {
            expected_len, len, ..
        } => {
            format!("has {len} fields, the header has {expected_len}")
        }
        csv::ErrorKind::Utf8 { .. } => "is not UTF-8 text".to_owned(),
        _ => error.to_string(),
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
        Ok(value)
    }

    /// File and line, for error messages.
    pub fn location(&self) -> String {
        format!("{}: line {}", self.table.path.display(), self.line)
    }
}

/// A CSV file that gets its name only when it is complete.
pub struct CsvWriter {
    path: PathBuf,
    out: OutputFile,
}

impl CsvWriter {
    /// Starts the file with its header line. Links are followed; pipes and devices are written directly.
    pub fn create(path: &Path, header: &str) -> Result<Self> {
        let out =
            OutputFile::create(path).with_context(|| format!("cannot write {}", path.display()))?;
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
