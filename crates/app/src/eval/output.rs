//! Where are results written? One CSV per part, results.json for the page, a table for the terminal.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use serde::Serialize;
use vision::output_file::write_file;

use super::metric::Metric;
use pipeline::csv_table::CsvWriter;

/// The CSV file of one part, created with its header.
pub(crate) struct CsvRows {
    path: PathBuf,
    file: Option<CsvWriter>,
}

impl CsvRows {
    /// A file at `path` that does not exist yet.
    pub(crate) fn new(path: PathBuf) -> Self {
        CsvRows { path, file: None }
    }

    /// Starts the file.
    pub(crate) fn header(&mut self, header: &str) -> Result<()> {
        self.file = Some(CsvWriter::create(&self.path, header)?);
        Ok(())
    }

    /// Adds a row.
    pub(crate) fn row(&mut self, row: std::fmt::Arguments<'_>) -> Result<()> {
        self.file
            .as_mut()
            .context("rows before their header")?
            .write_row(row)
    }

    /// Completes the file.
    pub(crate) fn finish(self) -> Result<()> {
        self.file.map_or(Ok(()), CsvWriter::finish)
    }
}

/// A text as one quoted CSV field.
pub(crate) fn csv_quote(text: &str) -> String {
    format!("\"{}\"", text.replace('"', "\"\""))
}

/// Content of results.json.
#[derive(Debug, Serialize)]
pub(crate) struct EvalResults {
    /// The experiment's name.
    pub name: String,
    /// Its heading.
    pub title: String,
    /// The paper.
    pub source: String,
    /// Differences from the paper's experiment.
    pub differs: Vec<String>,
    /// Version of this program.
    pub version: &'static str,
    /// Processor.
    pub machine: String,
    /// First seed, and the last plus one.
    pub seeds: [u64; 2],
    /// The parts.
    pub parts: Vec<PartResults>,
}

/// One part's figures.
#[derive(Debug, Serialize)]
pub(crate) struct PartResults {
    /// Its name.
    pub name: String,
    /// Its heading.
    pub title: String,
    /// Kind of the part, by which the page draws it.
    pub kind: &'static str,
    /// Name of its CSV file in the folder of results.json.
    pub rows: String,
    /// Its figures.
    pub figures: Vec<Metric>,
}

impl EvalResults {
    /// Writes results.json and figures.csv.
    pub(crate) fn write(&self, folder: &Path) -> Result<()> {
        let path = folder.join("results.json");
        let text = serde_json::to_string_pretty(self)?;
        write_file(&path, text).with_context(|| format!("cannot write {}", path.display()))?;
        let mut table = CsvWriter::create(
            &folder.join("figures.csv"),
            "part,variant,method,figure,value,low,high,interval,paper,paper_until,paper_place",
        )?;
        let number =
            |value: Option<f64>| value.map_or_else(String::new, |value| format!("{value:.6}"));
        for part in &self.parts {
            for figure in &part.figures {
                let (interval, paper) = (figure.interval, figure.paper.as_ref());
                table.write_row(format_args!(
                    "{},{},{},{},{},{},{},{},{},{},{}",
                    part.name,
                    csv_quote(&figure.variant),
                    csv_quote(&figure.method),
                    csv_quote(figure.name),
                    number(figure.value),
                    number(interval.map(|interval| interval.low)),
                    number(interval.map(|interval| interval.high)),
                    interval.map_or("", |interval| interval.kind),
                    number(paper.map(|paper| paper.value)),
                    number(paper.and_then(|paper| paper.until)),
                    csv_quote(paper.map_or("", |paper| &paper.place)),
                ))?;
            }
        }
        table.finish()
    }

    /// Prints every figure next to the paper's.
    pub(crate) fn print(&self) {
        println!("{}", self.title);
        for part in &self.parts {
            println!("\n{}", part.title);
            println!(
                "{:<26} {:<14} {:<35} {:>10} {:<22} paper",
                "", "", "", "value", "interval"
            );
            for figure in &part.figures {
                println!("{}", figure.table_line());
            }
        }
        if !self.differs.is_empty() {
            println!("\nDifferences from the paper:");
            for difference in &self.differs {
                println!("- {difference}");
            }
        }
    }
}
