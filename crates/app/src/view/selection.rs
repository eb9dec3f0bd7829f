//! The object that a click selects: panels point it out, and list its numbers and their history.

use localize::frames::{At, FieldFrame};
use pipeline::Cycle;

use crate::view::ground_placement::GroundPlacement;

/// A selected object.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Selection {
    /// The estimated pose.
    Estimate,
    /// The true pose.
    Truth,
    /// The ball as seen.
    Ball,
    /// A robot as seen, by its index in the cycle.
    Robot(usize),
    /// A tracked robot, by its identifier.
    Track(u32),
    /// An alternative pose, by its rank.
    Hypothesis(usize),
    /// A line point, by its index in the cycle.
    LinePoint(usize),
}

impl Selection {
    /// What is near a place on the field; the nearest object within `radius` metres, small ones before large ones.
    pub(crate) fn nearest(
        cycle: &Cycle,
        viewpoint_height: Option<f32>,
        at: At<FieldFrame>,
        radius: f32,
    ) -> Option<Self> {
        let mut found: Vec<(f32, Selection)> = Vec::new();
        let mut consider = |place: Option<At<FieldFrame>>, size: f32, selection: Selection| {
            let distance = place.map(|place| place.distance_to(at));
            if let Some(distance) = distance.filter(|distance| *distance < radius.max(size)) {
                found.push((distance, selection));
            }
        };
        for selection in Selection::all(cycle) {
            let place = selection.place(cycle, viewpoint_height);
            consider(place, selection.size(), selection);
        }
        found
            .into_iter()
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .map(|(_, selection)| selection)
    }

    /// The object after (or before) this one in a cycle; the first one after none. Line points are left out.
    pub(crate) fn next(of: Option<Self>, cycle: &Cycle, ahead: bool) -> Option<Self> {
        let mut all = Selection::all(cycle);
        all.retain(|object| {
            !matches!(object, Selection::LinePoint(_)) && object.place(cycle, None).is_some()
        });
        let now = of.and_then(|of| all.iter().position(|object| *object == of));
        let next = match (now, ahead) {
            (None, true) => 0,
            (None, false) => all.len().checked_sub(1)?,
            (Some(now), true) => (now + 1) % all.len(),
            (Some(now), false) => (now + all.len() - 1) % all.len(),
        };
        all.get(next).copied()
    }

    /// Every object of a cycle.
    fn all(cycle: &Cycle) -> Vec<Self> {
        let mut all = vec![Selection::Estimate, Selection::Truth, Selection::Ball];
        let robots = cycle.detections.as_ref().map_or(0, |d| d.robots.len());
        all.extend((0..robots).map(Selection::Robot));
        all.extend(
            cycle
                .world
                .robots
                .iter()
                .map(|track| Selection::Track(track.id)),
        );
        all.extend((0..cycle.estimate.runners_up.len()).map(Selection::Hypothesis));
        all.extend((0..cycle.line_points.len()).map(Selection::LinePoint));
        all
    }

    /// Radius of the object on the field, metres.
    fn size(self) -> f32 {
        match self {
            Selection::Ball | Selection::LinePoint(_) => 0.0,
            _ => 0.2,
        }
    }

    /// Where it is on the field in a cycle; None if the cycle does not hold it. `viewpoint_height`: of the camera, metres.
    pub(crate) fn place(
        self,
        cycle: &Cycle,
        viewpoint_height: Option<f32>,
    ) -> Option<At<FieldFrame>> {
        let estimate = &cycle.estimate;
        let detections = cycle.detections.as_ref();
        let on_robot = match self {
            Selection::Estimate => return Some(estimate.pose?.origin()),
            Selection::Truth => return Some(cycle.inputs.truth.as_ref()?.pose.origin()),
            Selection::Hypothesis(rank) => {
                return Some(estimate.runners_up.get(rank)?.pose.origin());
            }
            Selection::Track(id) => {
                let track = cycle.world.robots.iter().find(|track| track.id == id);
                return Some(track?.on_field?.at);
            }
            Selection::Ball => detections?.ball.as_ref()?.at,
            Selection::Robot(index) => detections?.robots.get(index)?.at,
            Selection::LinePoint(index) => cycle.line_points.get(index)?.at,
        };
        Some(GroundPlacement::of(cycle, viewpoint_height)?.place(on_robot))
    }

    /// Its title.
    pub(crate) fn title(self) -> String {
        match self {
            Selection::Estimate => "Estimated pose".to_owned(),
            Selection::Truth => "True pose".to_owned(),
            Selection::Ball => "Ball as seen".to_owned(),
            Selection::Robot(index) => format!("Robot {} as seen", index + 1),
            Selection::Track(id) => format!("Tracked robot {id}"),
            Selection::Hypothesis(rank) => format!("Hypothesis {}", rank + 1),
            Selection::LinePoint(index) => format!("Line point {}", index + 1),
        }
    }

    /// Its numbers: names, and the fields of the log that hold them. `cycle` gives the place of a track in its list.
    pub(crate) fn fields(self, cycle: &Cycle) -> Vec<(&'static str, String)> {
        let under = |base: String, names: &[&'static str]| {
            let field = |name: &&'static str| (*name, format!("{base}{name}"));
            names.iter().map(field).collect()
        };
        match self {
            Selection::Estimate => under(
                "/cycle.estimate.".to_owned(),
                &[
                    "pose.x",
                    "pose.y",
                    "pose.theta",
                    "covariance[0]",
                    "covariance[4]",
                    "covariance[8]",
                    "residual",
                    "inlier_share",
                    "mode",
                    "reason",
                ],
            ),
            Selection::Truth => under("/cycle.truth.pose.".to_owned(), &["x", "y", "theta"]),
            Selection::Ball => under(
                "/cycle.seen.ball.".to_owned(),
                &[
                    "x",
                    "y",
                    "score",
                    "covariance[0]",
                    "covariance[2]",
                    "pixels",
                ],
            ),
            Selection::Robot(index) => under(
                format!("/cycle.seen.robots[{index}]."),
                &["x", "y", "edge_x", "edge_y", "width", "score", "marker"],
            ),
            Selection::Track(id) => {
                let index = cycle.world.robots.iter().position(|track| track.id == id);
                under(
                    format!("/cycle.world.robots[{}].", index.unwrap_or_default()),
                    &[
                        "id",
                        "x",
                        "y",
                        "velocity_x",
                        "velocity_y",
                        "on_field.x",
                        "on_field.y",
                        "probability",
                        "team",
                    ],
                )
            }
            Selection::Hypothesis(rank) => under(
                format!("/cycle.estimate.runners_up[{rank}]."),
                &[
                    "pose.x",
                    "pose.y",
                    "pose.theta",
                    "probability",
                    "score",
                    "inlier_share",
                    "residual",
                ],
            ),
            Selection::LinePoint(index) => ["x", "y", "std_radial", "std_tangential"]
                .map(|name| (name, format!("/cycle.points.{name}[{index}]")))
                .to_vec(),
        }
    }
}
