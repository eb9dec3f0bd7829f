//! The field file and the check of its sizes.

use serde::{Deserialize, Serialize};

use crate::toml_file::TomlFileError;

/// Most additional lines, and arcs. The time of a start grows with them: 20,000 lines would take nine seconds.
const EXTRA_MARKINGS_MAX: usize = 500;

/// Content of a field's TOML file. Lengths in metres; 0 leaves a marking out.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FieldConfig {
    /// Length along x, between the goal lines.
    pub length: f32,
    /// Width along y, between the touch lines.
    pub width: f32,
    /// Reference of all sizes: line centres or outer edges.
    #[serde(default)]
    pub measured_to: MeasuredTo,
    /// Width of the painted lines.
    pub line_width: f32,
    /// Width of the carpet beyond the boundary lines.
    pub border: f32,
    /// Radius of the centre circle.
    #[serde(default)]
    pub centre_circle_radius: f32,
    /// Radius of the four corner arcs.
    #[serde(default)]
    pub corner_arc_radius: f32,
    /// Radius of the filled centre and penalty spots.
    #[serde(default)]
    pub spot_radius: f32,
    /// Distance of the penalty spots from the goal line.
    #[serde(default)]
    pub penalty_spot: f32,
    /// The small area in front of each goal.
    #[serde(default)]
    pub goal_area: Area,
    /// The large area in front of each goal.
    #[serde(default)]
    pub penalty_area: Area,
    /// The goals, one at each end. Left out: no goals.
    #[serde(default)]
    pub goal: GoalConfig,
    /// True for walls around the carpet (league fields until 2001).
    #[serde(default)]
    pub walls: bool,
    /// True for lines around the field: both touch lines and both goal lines.
    #[serde(default = "default_true")]
    pub boundary: bool,
    /// True for a line through the centre, across the field.
    #[serde(default = "default_true")]
    pub halfway_line: bool,
    /// Additional lines: end points [x0, y0, x1, y1] of their centre lines.
    #[serde(default, deserialize_with = "crate::fixed_array::deserialize_rows")]
    pub extra_lines: Vec<[f32; 4]>,
    /// Additional circles and arcs: centre, radius of the centre line, and the angles in degrees at which they start and
    /// over which they run counter-clockwise, [x, y, radius, start, sweep].
    #[serde(default, deserialize_with = "crate::fixed_array::deserialize_rows")]
    pub extra_arcs: Vec<[f32; 5]>,
    /// Standard deviations of the numbers of `extra_lines`, in their order, if the field was measured.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[serde(deserialize_with = "crate::fixed_array::deserialize_rows")]
    pub extra_lines_std: Vec<[f32; 4]>,
    /// Standard deviations of centre and radius of `extra_arcs`, in their order, if the field was measured.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[serde(deserialize_with = "crate::fixed_array::deserialize_rows")]
    pub extra_arcs_std: Vec<[f32; 3]>,
}

fn default_true() -> bool {
    true
}

/// Reference of a field's sizes: line centres, or outer edges as in the rule book.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MeasuredTo {
    /// Between the centres of the lines.
    Centres,
    /// To the outer edges of the lines, as in the rule book.
    #[default]
    OuterEdges,
}

impl MeasuredTo {
    /// The value of the key.
    pub fn name(self) -> &'static str {
        match self {
            MeasuredTo::Centres => "centres",
            MeasuredTo::OuterEdges => "outer_edges",
        }
    }

    /// The other reference.
    pub fn other(self) -> Self {
        match self {
            MeasuredTo::Centres => MeasuredTo::OuterEdges,
            MeasuredTo::OuterEdges => MeasuredTo::Centres,
        }
    }
}

/// A rectangle in front of a goal.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Area {
    /// Extent from the goal line into the field.
    pub depth: f32,
    /// Extent along the goal line.
    pub width: f32,
}

/// Size and colours of both goals.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GoalConfig {
    /// Distance between the posts.
    pub width: f32,
    /// Height below the crossbar.
    pub height: f32,
    /// Depth behind the goal line.
    pub depth: f32,
    /// Side length of the square posts.
    pub post: f32,
    /// Colours of the goals at +x and at −x: white, blue or yellow.
    pub colours: [GoalColour; 2],
}

impl Default for GoalConfig {
    /// No goal.
    fn default() -> Self {
        GoalConfig {
            width: 0.0,
            height: 0.0,
            depth: 0.0,
            post: 0.0,
            colours: [GoalColour::White; 2],
        }
    }
}

/// Appearance of a goal: a white frame with a net, or a coloured box.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GoalColour {
    /// White posts and a net.
    White,
    /// Blue walls (until 2007).
    Blue,
    /// Yellow walls (until 2007).
    Yellow,
}

/// Why a field cannot be loaded.
#[derive(Debug, thiserror::Error)]
pub enum FieldError {
    /// The file cannot be read, or its content is something else.
    #[error(transparent)]
    File(#[from] TomlFileError),
    /// A size that is out of range.
    #[error("{key} = {value}: {reason}")]
    InvalidSize {
        /// The key in the file.
        key: &'static str,
        /// Its value, metres.
        value: f32,
        /// What is wrong with it.
        reason: &'static str,
    },
    /// Like `InvalidSize`, with its place.
    #[error("{place}: {source}")]
    InFile {
        /// The file, and the line if known.
        place: String,
        /// The invalid size.
        source: Box<FieldError>,
    },
}

impl FieldConfig {
    /// A field without goals and markings, for lines and arcs of any place. Length, width and the others in metres.
    pub fn without_markings([length, width]: [f32; 2], line_width: f32, border: f32) -> Self {
        FieldConfig {
            length,
            width,
            measured_to: MeasuredTo::Centres,
            line_width,
            border,
            centre_circle_radius: 0.0,
            corner_arc_radius: 0.0,
            spot_radius: 0.0,
            penalty_spot: 0.0,
            goal_area: Default::default(),
            penalty_area: Default::default(),
            goal: GoalConfig::default(),
            walls: false,
            boundary: false,
            halfway_line: false,
            extra_lines: Vec::new(),
            extra_arcs: Vec::new(),
            extra_lines_std: Vec::new(),
            extra_arcs_std: Vec::new(),
        }
    }

    /// The field with all lengths multiplied by `factor`: a mirror that hangs lower by as much shows the same.
    pub fn scaled(&self, factor: f32) -> FieldConfig {
        let area = |area: Area| Area {
            depth: factor * area.depth,
            width: factor * area.width,
        };
        let lengths = |values: &[f32; 4]| values.map(|value| factor * value);
        FieldConfig {
            length: factor * self.length,
            width: factor * self.width,
            measured_to: self.measured_to,
            line_width: factor * self.line_width,
            border: factor * self.border,
            centre_circle_radius: factor * self.centre_circle_radius,
            corner_arc_radius: factor * self.corner_arc_radius,
            spot_radius: factor * self.spot_radius,
            penalty_spot: factor * self.penalty_spot,
            goal_area: area(self.goal_area),
            penalty_area: area(self.penalty_area),
            goal: GoalConfig {
                width: factor * self.goal.width,
                height: factor * self.goal.height,
                depth: factor * self.goal.depth,
                post: factor * self.goal.post,
                colours: self.goal.colours,
            },
            walls: self.walls,
            boundary: self.boundary,
            halfway_line: self.halfway_line,
            extra_lines: self.extra_lines.iter().map(lengths).collect(),
            extra_arcs: self
                .extra_arcs
                .iter()
                .map(|&[x, y, radius, start, sweep]| {
                    [factor * x, factor * y, factor * radius, start, sweep]
                })
                .collect(),
            extra_lines_std: self.extra_lines_std.iter().map(lengths).collect(),
            extra_arcs_std: self
                .extra_arcs_std
                .iter()
                .map(|stds| stds.map(|std| factor * std))
                .collect(),
        }
    }

    /// Returns an error for sizes that are out of range or contradict each other.
    pub(super) fn check(&self) -> Result<(), FieldError> {
        check(self)
    }
}

fn check(config: &FieldConfig) -> Result<(), FieldError> {
    for (key, value) in [
        ("length", config.length),
        ("width", config.width),
        ("line_width", config.line_width),
    ] {
        // The largest football pitch is 120 m long. The tables' memory grows with the area.
        if !(value > 0.0 && value <= 200.0) {
            return invalid_size(
                key,
                value,
                "must be a positive number of metres, at most 200",
            );
        }
    }
    for (key, value, limit, reason) in size_limits(config) {
        if !(value.is_finite() && value >= 0.0) {
            return invalid_size(
                key,
                value,
                "must be zero (left out) or a positive number of metres",
            );
        }
        if value > limit {
            return invalid_size(key, value, reason);
        }
    }
    for (key, markings) in [
        ("extra_lines", config.extra_lines.len()),
        ("extra_arcs", config.extra_arcs.len()),
    ] {
        if markings > EXTRA_MARKINGS_MAX {
            let reason = "is the count of markings (expected at most 500)";
            return invalid_size(key, markings as f32, reason);
        }
    }
    if config.line_width > config.width / 4.0 {
        let reason = "is wider than a quarter of the field";
        return invalid_size("line_width", config.line_width, reason);
    }
    let extra = config.extra_lines.iter().flatten();
    // A marking may lie outside the boundary, within the size of one more field.
    let limit = config.length.max(config.width);
    if let Some(&value) = extra.into_iter().find(|value| !(value.abs() <= limit)) {
        return invalid_size(
            "extra_lines",
            value,
            "lies farther off than the field is long",
        );
    }
    check_arcs(config, limit)?;
    for (key, stds, markings) in [
        (
            "extra_lines_std",
            config.extra_lines_std.as_flattened(),
            4 * config.extra_lines.len(),
        ),
        (
            "extra_arcs_std",
            config.extra_arcs_std.as_flattened(),
            3 * config.extra_arcs.len(),
        ),
    ] {
        if !stds.is_empty() && stds.len() != markings {
            let reason =
                "is the count of standard deviations, but not that of the markings' numbers";
            return invalid_size(key, stds.len() as f32, reason);
        }
        if let Some(&value) = stds.iter().find(|std| !(0.0..=10.0).contains(*std)) {
            return invalid_size(key, value, "must be a standard deviation from 0 to 10 m");
        }
    }
    Ok(())
}

/// Additional arcs: within the field's surroundings, with a radius and a length.
fn check_arcs(config: &FieldConfig, limit: f32) -> Result<(), FieldError> {
    let key = "extra_arcs";
    for &[x, y, radius, start, sweep] in &config.extra_arcs {
        if let Some(far) = [x, y, radius]
            .into_iter()
            .find(|value| !(value.abs() <= limit))
        {
            return invalid_size(key, far, "lies farther off than the field is long");
        }
        if radius <= 0.0 {
            return invalid_size(key, radius, "must be a positive radius");
        }
        if !(start.abs() <= 360.0) {
            return invalid_size(key, start, "must be a start angle from -360 to 360 degrees");
        }
        if !(sweep > 0.0 && sweep <= 360.0) {
            return invalid_size(key, sweep, "must be an angle above 0, at most 360 degrees");
        }
    }
    Ok(())
}

fn invalid_size(key: &'static str, value: f32, reason: &'static str) -> Result<(), FieldError> {
    Err(FieldError::InvalidSize { key, value, reason })
}

/// Sizes that may be zero: key, value, upper limit, and the reason for the limit.
fn size_limits(config: &FieldConfig) -> [(&'static str, f32, f32, &'static str); 13] {
    let FieldConfig {
        goal,
        goal_area,
        penalty_area,
        ..
    } = config;
    let (half_length, half_width) = (config.length / 2.0, config.width / 2.0);
    let wide = "does not fit on the goal line";
    let deep = "reaches beyond the halfway line";
    // Without a penalty area, the goal area may cover the field's half.
    let whole = Area {
        depth: half_length,
        width: config.width,
    };
    let both = penalty_area.depth > 0.0 && penalty_area.width > 0.0;
    let (inside, deeper, wider) = if both {
        let beyond_penalty_area = "reaches beyond the penalty area";
        (*penalty_area, beyond_penalty_area, beyond_penalty_area)
    } else {
        (whole, deep, wide)
    };
    let round = "does not fit on the field";
    let far = "is more than any field has";
    let (circle, arc) = (config.centre_circle_radius, config.corner_arc_radius);
    [
        ("border", config.border, 100.0, far),
        ("centre_circle_radius", circle, half_width, round),
        ("corner_arc_radius", arc, half_width, round),
        ("spot_radius", config.spot_radius, half_width, round),
        ("penalty_spot", config.penalty_spot, half_length, deep),
        ("goal_area.depth", goal_area.depth, inside.depth, deeper),
        ("goal_area.width", goal_area.width, inside.width, wider),
        ("penalty_area.depth", penalty_area.depth, half_length, deep),
        ("penalty_area.width", penalty_area.width, config.width, wide),
        ("goal.width", goal.width, config.width, wide),
        ("goal.height", goal.height, 10.0, far),
        ("goal.depth", goal.depth, 10.0, far),
        ("goal.post", goal.post, config.width, wide),
    ]
}
