//! Settings of the mapping of an unknown field.

/// How a field is mapped from a drive. Lengths in metres.
#[derive(Debug, Clone, PartialEq)]
pub struct FieldMappingConfig {
    /// Largest range of line points that are used.
    pub range_max: f32,
    /// Distance and rotation (radians) between two keyframes.
    pub keyframe_distance: f32,
    /// See `keyframe_distance`.
    pub keyframe_turn: f32,
    /// Standard deviation of the robot's tilt from image to image, per axis, degrees: it displaces far points most.
    pub tilt_std_deg: f32,
    /// Height of the viewpoint (the mirror) above the ground.
    pub viewpoint_height: f32,
    /// Side of the cells in which points become pieces of line.
    pub cell: f32,
    /// Largest distance of a point from its line in the first sweep over the drive, and in the last.
    pub reach_first: f32,
    /// See `reach_first`.
    pub reach_last: f32,
    /// Sweeps over the whole drive.
    pub sweeps: usize,
    /// Error of the wheels along and across the motion, share of it, and of their rotation, before they are corrected.
    pub odometry_noise: f32,
    /// The same of corrected wheels: those that roll, and those that slip. The map that is more compact counts.
    pub corrected_odometry_noise: [f32; 2],
    /// Standard deviation of the correction's entries.
    pub correction_std: f32,
    /// Side of the cells whose points are averaged before shapes are fitted.
    pub element: f32,
    /// Largest distance of a cell's mean from the shape through it.
    pub shape_tolerance: f32,
    /// Shortest line or arc.
    pub length_min: f32,
    /// Longest gap in a line or arc.
    pub gap_max: f32,
    /// Smallest and largest radius of an arc.
    pub radius_min: f32,
    /// See `radius_min`.
    pub radius_max: f32,
    /// Width of the painted lines, for the field file.
    pub line_width: f32,
    /// Carpet beyond the outermost marking, for the field file: a drive does not show where it ends.
    pub border: f32,
}

impl Default for FieldMappingConfig {
    fn default() -> Self {
        FieldMappingConfig {
            range_max: 5.0,
            keyframe_distance: 0.25,
            keyframe_turn: 0.26,
            tilt_std_deg: 0.45,
            viewpoint_height: crate::robot::DEFAULT_VIEWPOINT_HEIGHT,
            cell: 0.4,
            reach_first: 0.4,
            reach_last: 0.12,
            sweeps: 14,
            odometry_noise: 0.05,
            corrected_odometry_noise: [0.007, 0.05],
            correction_std: 0.05,
            element: 0.1,
            shape_tolerance: 0.06,
            length_min: 0.5,
            gap_max: 0.45,
            radius_min: 0.3,
            radius_max: 7.0,
            line_width: 0.125,
            border: 1.0,
        }
    }
}
