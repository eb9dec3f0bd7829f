//! Which file describes a drawn or mapped field? A field file without the markings of a league, and what is said about it.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use localize::field::{Field, FieldConfig};
use localize::global_search::branch_and_bound::BranchAndBound;
use localize::{DistanceField, LocalizeConfig};
use serde::Serialize;
use vision::output_file::write_file;

/// End points of a centre line: x, y, x, y, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Line(pub(super) [f32; 4]);

/// Centre, radius, start and length counter-clockwise, metres and degrees.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Arc(pub(super) [f32; 5]);

impl Arc {
    /// From a start point by a signed angle, radians counter-clockwise.
    pub(super) fn between([x, y]: [f32; 2], start: [f32; 2], sweep: f64) -> Self {
        let (dx, dy) = (start[0] - x, start[1] - y);
        let from = f64::from(dy).atan2(dx.into());
        let first = if sweep < 0.0 { from + sweep } else { from };
        let degrees = first.to_degrees().rem_euclid(360.0);
        let length = sweep.abs().to_degrees().min(360.0);
        Arc([x, y, dx.hypot(dy), degrees as f32, length as f32])
    }
}

/// A field that consists of these markings alone. Sizes in metres.
pub(super) fn drawn_field(
    size: [f32; 2],
    line_width: f32,
    border: f32,
    lines: &[Line],
    arcs: &[Arc],
) -> Result<FieldConfig> {
    let config = FieldConfig {
        extra_lines: lines.iter().map(|line| line.0).collect(),
        extra_arcs: arcs.iter().map(|arc| arc.0).collect(),
        ..FieldConfig::without_markings(size, line_width, border)
    };
    Field::new(config.clone())?;
    Ok(config)
}

/// Writes a field of lines and arcs. `origin`: where it comes from, a sentence.
pub(super) fn write(path: &Path, field: &FieldConfig, origin: &str) -> Result<()> {
    let rows = |values: &[Vec<f32>]| {
        let row = |row: &Vec<f32>| {
            // Adding zero makes −0 a 0.
            let numbers: Vec<String> = row
                .iter()
                .map(|value| format!("{:.4}", (value * 1e4).round() / 1e4 + 0.0))
                .collect();
            format!("  [{}],\n", numbers.join(", "))
        };
        values.iter().map(row).collect::<String>()
    };
    let table = |key: &str, comment: &str, values: Vec<Vec<f32>>| {
        if values.is_empty() {
            return String::new();
        }
        format!("# {comment}\n{key} = [\n{}]\n", rows(&values))
    };
    let text = format!(
        "# {origin}\n\
         # extent of the markings along x and y, metres\n\
         length = {:.4}\nwidth = {:.4}\n\
         measured_to = \"centres\"\n\
         # width of the painted or taped lines\n\
         line_width = {:.4}\n\
         # floor beyond the outermost marking, on all sides: the robot is searched up to there\n\
         border = {:.4}\n\
         # no lines but those below, and no goals\n\
         boundary = false\nhalfway_line = false\n{}{}{}{}",
        field.length,
        field.width,
        field.line_width,
        field.border,
        table(
            "extra_lines",
            "centre lines: x, y of one end and of the other, metres",
            field.extra_lines.iter().map(|line| line.to_vec()).collect(),
        ),
        table(
            "extra_lines_std",
            "their standard deviations, metres",
            field
                .extra_lines_std
                .iter()
                .map(|std| std.to_vec())
                .collect(),
        ),
        table(
            "extra_arcs",
            "circles and arcs: x, y of the centre, radius (metres), start and length counter-clockwise (degrees)",
            field.extra_arcs.iter().map(|arc| arc.to_vec()).collect(),
        ),
        table(
            "extra_arcs_std",
            "standard deviations of centre and radius, metres",
            field
                .extra_arcs_std
                .iter()
                .map(|std| std.to_vec())
                .collect(),
        ),
    );
    write_file(path, text).with_context(|| format!("cannot write {}", path.display()))
}

/// What a command that writes a field prints.
#[derive(Debug, Serialize)]
pub(super) struct Outcome {
    /// The file.
    field: PathBuf,
    lines: usize,
    arcs: usize,
    /// Extent of the markings, metres.
    size: [f32; 2],
    /// A half turn maps the markings onto themselves, so that only a compass or a team-mate tells the halves apart.
    half_turn_symmetric: bool,
    /// Sentences about what was left out.
    warnings: Vec<String>,
    /// Figures of the map. None for a drawing.
    #[serde(skip_serializing_if = "Option::is_none")]
    mapping: Option<MappingFigures>,
}

/// How good a mapped field is, by its own drive.
#[derive(Debug, Serialize)]
pub(super) struct MappingFigures {
    /// Keyframes of the drive.
    pub(super) keyframes: usize,
    /// Keyframes that saw places which others had seen.
    pub(super) revisits: usize,
    /// Share of the line points on the lines and arcs found.
    pub(super) explained_share: f32,
    /// Root mean square distance of these points' means from them, metres.
    pub(super) residual: f32,
    /// Root mean square of the markings' standard deviations, metres.
    pub(super) marking_std: f32,
    /// Matrix from the wheels' measured motion (x, y, θ) to the true one.
    pub(super) odometry_correction: [[f32; 3]; 3],
}

impl Outcome {
    pub(super) fn new(path: &Path, config: &FieldConfig, warnings: Vec<String>) -> Result<Self> {
        let field = Field::new(config.clone())?;
        let settings = LocalizeConfig::default();
        let distances = DistanceField::new(&field, &settings.distance_field);
        let search = BranchAndBound::new(&field, &distances, settings.branch_and_bound);
        Ok(Outcome {
            field: path.to_owned(),
            lines: config.extra_lines.len(),
            arcs: config.extra_arcs.len(),
            size: [config.length, config.width],
            half_turn_symmetric: search.is_half_turn_symmetric(),
            warnings,
            mapping: None,
        })
    }

    pub(super) fn with_mapping(self, mapping: MappingFigures) -> Self {
        Outcome {
            mapping: Some(mapping),
            ..self
        }
    }

    pub(super) fn print(&self, json: bool) -> Result<()> {
        if json {
            println!("{}", serde_json::to_string(self)?);
            return Ok(());
        }
        for warning in &self.warnings {
            stderr_line!("warning: {warning}");
        }
        println!(
            "{}: {} lines and {} arcs on {:.2} x {:.2} m",
            self.field.display(),
            self.lines,
            self.arcs,
            self.size[0],
            self.size[1]
        );
        if self.half_turn_symmetric {
            println!(
                "a half turn changes nothing: a compass or a team-mate must tell the halves apart"
            );
        }
        if let Some(mapping) = &self.mapping {
            println!(
                "{} keyframes, {} of them at places seen before; {:.0} % of the points on the markings, {:.1} cm off; standard deviation {:.1} cm",
                mapping.keyframes,
                mapping.revisits,
                100.0 * mapping.explained_share,
                100.0 * mapping.residual,
                100.0 * mapping.marking_std
            );
        }
        Ok(())
    }
}
