//! `mirrorball field from-svg`: a drawn field as a field file.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use localize::field::FieldConfig;
use localize::input_file;

use super::field_file::{self, Arc, Line, Outcome};
use super::svg_document::{Tag, tags};
use super::svg_path::{Scanner, Stroke, strokes};
use super::svg_transform::Similarity;
use crate::commands::arguments::UsageError;
use crate::commands::inputs::Inputs;

/// Convert a drawing of the markings (SVG) to a field file: line, polyline, polygon, rect, circle, and path.
///
/// The drawing shows the centre lines of the markings. Sizes come from its width in mm, cm, m or in and its viewBox, or from
/// --scale. Its y axis points down, that of the field to the left of x.
#[derive(clap::Args)]
#[command(
    allow_negative_numbers = true,
    after_help = "Example: mirrorball field from-svg hall.svg --out hall.toml\n         \
                  mirrorball field from-svg hall.svg --scale 0.001 --line-width 0.05 --out hall.toml"
)]
pub(super) struct Args {
    /// The drawing.
    svg: PathBuf,
    /// The field file to write.
    #[arg(long, value_name = "FIELD.toml")]
    out: PathBuf,
    /// Metres per unit of the drawing, in place of its own width.
    #[arg(long, value_name = "METRES")]
    scale: Option<f64>,
    /// Width of the painted or taped lines, metres.
    #[arg(long, value_name = "METRES", default_value_t = 0.125)]
    line_width: f32,
    /// Floor beyond the outermost marking, metres.
    #[arg(long, value_name = "METRES", default_value_t = 1.0)]
    border: f32,
}

/// Elements whose content is not drawn where it stands.
const NOT_DRAWN: [&str; 8] = [
    "defs", "clipPath", "symbol", "style", "text", "marker", "mask", "pattern",
];

/// Runs the command.
pub(super) fn run(args: &Args, json: bool) -> Result<()> {
    if args
        .scale
        .is_some_and(|scale| !(scale > 0.0 && scale.is_finite()))
    {
        return Err(UsageError("--scale must be a positive number of metres".to_owned()).into());
    }
    Inputs::of([&*args.svg]).ensure_kept([Some(&*args.out)])?;
    let text = input_file::read_text(&args.svg)
        .with_context(|| format!("cannot read {}", args.svg.display()))?;
    let drawing =
        read_drawing(&text, args.scale).with_context(|| args.svg.display().to_string())?;
    let field = lay_out(&drawing, args).with_context(|| args.svg.display().to_string())?;
    field_file::write(
        &args.out,
        &field,
        &format!("Drawn: {}.", file_name(&args.svg)),
    )?;
    Outcome::new(&args.out, &field, drawing.warnings)?.print(json)
}

fn file_name(path: &Path) -> String {
    path.file_name()
        .map(|name| name.to_string_lossy().into_owned())
        .unwrap_or_default()
}

/// Lines and arcs of a drawing, metres; y points down.
struct Drawing {
    strokes: Vec<Stroke>,
    warnings: Vec<String>,
}

fn read_drawing(text: &str, scale: Option<f64>) -> Result<Drawing> {
    let mut drawing = Drawing {
        strokes: Vec::new(),
        warnings: Vec::new(),
    };
    let mut transforms: Vec<(String, Similarity)> = Vec::new();
    let mut hidden: Vec<String> = Vec::new();
    let mut root_scale = None;
    for tag in tags(text)? {
        match tag {
            Tag::Start(name, attributes, is_empty) => {
                let get = |key: &str| {
                    let found = attributes.iter().find(|(name, _)| name == key);
                    found.map(|(_, value)| value.as_str())
                };
                if name == "svg" && root_scale.is_none() {
                    root_scale = Some(match scale {
                        Some(scale) => scale,
                        None => page_scale(get("width"), get("viewBox"))?,
                    });
                }
                if !hidden.is_empty() || NOT_DRAWN.contains(&name.as_str()) {
                    if !is_empty {
                        hidden.push(name);
                    }
                    continue;
                }
                let outer = transforms
                    .last()
                    .map_or(Similarity::default(), |(_, outer)| *outer);
                let own = match get("transform") {
                    Some(text) => Similarity::parse(text).with_context(|| format!("<{name}>"))?,
                    None => Similarity::default(),
                };
                let here = outer.then_inner(&own);
                match element_strokes(&name, &get).with_context(|| format!("<{name}>"))? {
                    Some(strokes) => drawing
                        .strokes
                        .extend(strokes.iter().map(|stroke| here.stroke(stroke))),
                    None if ["ellipse", "use", "image"].contains(&name.as_str()) => drawing
                        .warnings
                        .push(format!("<{name}> is not a marking and is left out")),
                    None => {}
                }
                if !is_empty {
                    transforms.push((name, here));
                }
            }
            Tag::End(name) => {
                let stack_top = |top: Option<&String>| top.is_some_and(|top| *top == name);
                if stack_top(hidden.last()) {
                    hidden.pop();
                } else if hidden.is_empty() && stack_top(transforms.last().map(|(name, _)| name)) {
                    transforms.pop();
                }
            }
        }
    }
    let scale = root_scale.context("no <svg> element")?;
    ensure!(
        !drawing.strokes.is_empty(),
        "no markings (expected line, polyline, polygon, rect, circle or path)"
    );
    let scaled = Similarity::scaling(scale);
    drawing.strokes = drawing
        .strokes
        .iter()
        .map(|stroke| scaled.stroke(stroke))
        .collect();
    Ok(drawing)
}

/// Metres per user unit, from the width of the page.
fn page_scale(width: Option<&str>, view_box: Option<&str>) -> Result<f64> {
    let hint = "Give --scale METRES per unit, or a width in mm, cm, m or in and a viewBox";
    let width = width.with_context(|| format!("no width. {hint}"))?.trim();
    let units = [("mm", 0.001), ("cm", 0.01), ("in", 0.0254), ("m", 1.0)];
    let found = units
        .iter()
        .find_map(|(unit, metres)| Some((width.strip_suffix(unit)?, *metres)));
    let (number, metres) =
        found.with_context(|| format!("width: {width:?} has no unit of length. {hint}"))?;
    let value: f64 = number
        .trim()
        .parse()
        .ok()
        .filter(|value: &f64| *value > 0.0 && value.is_finite())
        .with_context(|| format!("invalid width: {width:?}. {hint}"))?;
    let mut scanner = Scanner::new(view_box.with_context(|| format!("no viewBox. {hint}"))?);
    let mut values = [0.0; 4];
    for value in &mut values {
        *value = scanner.number().context("viewBox")?;
    }
    ensure!(
        values[2] > 0.0,
        "invalid viewBox: width {} (expected more than 0)",
        values[2]
    );
    Ok(value * metres / values[2])
}

/// The strokes of one element in its own units. None if it draws no marking.
fn element_strokes<'a>(
    name: &str,
    get: &impl Fn(&str) -> Option<&'a str>,
) -> Result<Option<Vec<Stroke>>> {
    let number = |key: &str| -> Result<f64> {
        let Some(text) = get(key) else {
            return Ok(0.0);
        };
        let text = text.trim().trim_end_matches("px");
        let value = text.parse::<f64>().ok().filter(|value| value.is_finite());
        value.with_context(|| format!("invalid {key}: {text:?} (expected a number without a unit)"))
    };
    let closed = |points: &[[f64; 2]], close: bool| {
        let mut strokes: Vec<Stroke> = points
            .windows(2)
            .map(|pair| Stroke::Line(pair[0], pair[1]))
            .collect();
        if let (true, [first, .., last]) = (close, points) {
            strokes.push(Stroke::Line(*last, *first));
        }
        strokes
    };
    Ok(Some(match name {
        "line" => vec![Stroke::Line(
            [number("x1")?, number("y1")?],
            [number("x2")?, number("y2")?],
        )],
        "rect" => {
            let (x, y) = (number("x")?, number("y")?);
            let (width, height) = (number("width")?, number("height")?);
            ensure!(width > 0.0 && height > 0.0, "a rectangle without a size");
            let corners = [
                [x, y],
                [x + width, y],
                [x + width, y + height],
                [x, y + height],
            ];
            closed(&corners, true)
        }
        "circle" => {
            let (x, y, radius) = (number("cx")?, number("cy")?, number("r")?);
            ensure!(radius > 0.0, "a circle without a radius");
            vec![Stroke::Arc {
                centre: [x, y],
                start: [x + radius, y],
                sweep: std::f64::consts::TAU,
            }]
        }
        "polyline" | "polygon" => {
            let mut scanner = Scanner::new(get("points").unwrap_or_default());
            let mut points = Vec::new();
            while !scanner.is_at_end() {
                points.push([scanner.number()?, scanner.number()?]);
            }
            ensure!(points.len() > 1, "fewer than two points");
            closed(&points, name == "polygon")
        }
        "path" => strokes(get("d").unwrap_or_default())?,
        _ => return Ok(None),
    }))
}

/// The field: the middle of the markings is its origin.
fn lay_out(drawing: &Drawing, args: &Args) -> Result<FieldConfig> {
    let (mut low, mut high) = ([f64::MAX; 2], [f64::MIN; 2]);
    for point in drawing.strokes.iter().flat_map(outline) {
        for k in 0..2 {
            low[k] = low[k].min(point[k]);
            high[k] = high[k].max(point[k]);
        }
    }
    let middle = [0, 1].map(|k| 0.5 * (low[k] + high[k]));
    let size = [0, 1].map(|k| high[k] - low[k]);
    if size.iter().any(|side| *side > 200.0) {
        bail!(
            "the markings are {:.0} by {:.0} m large (expected at most 200 m). Is the scale right?",
            size[0],
            size[1]
        );
    }
    if size.iter().all(|side| *side < 1.0) {
        bail!(
            "the markings are {:.3} by {:.3} m large (expected at least 1 m). Is the scale right?",
            size[0],
            size[1]
        );
    }
    let moved = |[x, y]: [f64; 2]| [(x - middle[0]) as f32, (middle[1] - y) as f32];
    let (mut lines, mut arcs) = (Vec::new(), Vec::new());
    for stroke in &drawing.strokes {
        match *stroke {
            Stroke::Line(from, to) => {
                let ([x0, y0], [x1, y1]) = (moved(from), moved(to));
                lines.push(Line([x0, y0, x1, y1]));
            }
            Stroke::Arc {
                centre,
                start,
                sweep,
            } => arcs.push(Arc::between(moved(centre), moved(start), -sweep)),
        }
    }
    let sides = size.map(|side| side.max(1.0) as f32);
    field_file::drawn_field(sides, args.line_width, args.border, &lines, &arcs)
}

/// Points along a stroke.
fn outline(stroke: &Stroke) -> Vec<[f64; 2]> {
    match *stroke {
        Stroke::Line(from, to) => vec![from, to],
        Stroke::Arc {
            centre,
            start,
            sweep,
        } => (0..=32)
            .map(|k| {
                let (sin, cos) = (sweep * f64::from(k) / 32.0).sin_cos();
                let (dx, dy) = (start[0] - centre[0], start[1] - centre[1]);
                [
                    centre[0] + cos * dx - sin * dy,
                    centre[1] + sin * dx + cos * dy,
                ]
            })
            .collect(),
    }
}

#[cfg(test)]
#[path = "from_svg_tests.rs"]
mod tests;
