//! Can robots and ball start where the scenario places them? Bodies apart, in the room, and the ball in play.

use localize::field::Field;
use localize::frames::{At, Pose};
use localize::robot::{BodyConfig, RobotConfig};
use rapier2d::prelude::SharedShape;

use super::Scenario;
use crate::behaviour::throw_in;
use crate::world::{Room, other_shape, overlap, own_shape};

/// A robot at its start.
struct PlacedBody {
    key: String,
    pose: Pose,
    /// Its outlines: a robot of ours is round in its own simulation, and a square in those of its teammates.
    shapes: Vec<SharedShape>,
}

/// The first key that places something where it cannot be, and the reason.
pub(super) fn check_places(
    scenario: &Scenario,
    robot: &RobotConfig,
    field: &Field,
) -> Result<(), (String, String)> {
    let bodies = placed_bodies(scenario, &robot.body.clone().unwrap_or_default());
    let room = Room::of(field);
    for (index, body) in bodies.iter().enumerate() {
        if !body
            .shapes
            .iter()
            .all(|shape| room.contains(shape, body.pose))
        {
            let Pose { x, y, .. } = body.pose;
            let reason = format!("outside the room: a robot at ({x}, {y}) (expected {room})");
            return Err((body.key.clone(), reason));
        }
        if let Some(other) = bodies[..index].iter().find(|other| body.overlaps(other)) {
            let distance = body.pose.origin().distance_to(other.pose.origin());
            let reason = format!(
                "inside another robot: {distance:.2} m from {} (expected bodies apart, 0.5 to 0.7 m between centres)",
                other.key
            );
            return Err((body.key.clone(), reason));
        }
    }
    check_ball(scenario, field, &room)
}

fn placed_bodies(scenario: &Scenario, body: &BodyConfig) -> Vec<PlacedBody> {
    let mut ours = vec![own_shape(body)];
    if !scenario.squad.is_empty() {
        ours.push(other_shape());
    }
    let mates = scenario.squad.iter().enumerate();
    let mates = mates.map(|(index, mate)| (format!("squad[{index}].start"), mate.start.pose()));
    let ours = [("start".to_owned(), scenario.start.pose())]
        .into_iter()
        .chain(mates)
        .map(|(key, pose)| PlacedBody {
            key,
            pose,
            shapes: ours.clone(),
        });
    let others = scenario.others.placed.iter().enumerate();
    let others = others.map(|(index, robot)| PlacedBody {
        key: format!("others.placed[{index}]"),
        pose: robot.pose(),
        shapes: vec![other_shape()],
    });
    ours.chain(others).collect()
}

impl PlacedBody {
    fn overlaps(&self, other: &PlacedBody) -> bool {
        let outlines = |shape| {
            other
                .shapes
                .iter()
                .any(|of_other| overlap((shape, self.pose), (of_other, other.pose)))
        };
        self.shapes.iter().any(outlines)
    }
}

/// The ball at the start and at kicks that place it.
fn check_ball(scenario: &Scenario, field: &Field, room: &Room) -> Result<(), (String, String)> {
    let ball = &scenario.ball;
    if !ball.present {
        return Ok(());
    }
    let start = ball.state();
    let kicks = scenario.kicks.iter().enumerate();
    let placing = kicks.filter(|(_, kick)| kick.position.is_some());
    let kicked =
        placing.map(|(index, kick)| (format!("kicks[{index}].position"), kick.apply(start)));
    let outline = SharedShape::ball(ball.diameter / 2.0);
    for (key, state) in [("ball.position".to_owned(), start)]
        .into_iter()
        .chain(kicked)
    {
        let At { x, y, .. } = state.at;
        if !room.contains(&outline, Pose::new(x, y, 0.0)) {
            let reason = format!("outside the room: a ball at ({x}, {y}) (expected {room})");
            return Err((key, reason));
        }
        if let Some(to) = throw_in(field, &state) {
            let reason = format!(
                "out of play: a ball at ({x}, {y}), which would be put at ({:.2}, {:.2}) at once (expected on the field, beside its \
                 lines, or moving)",
                to.x, to.y
            );
            return Err((key, reason));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    /// Why the scenario of five robots with other values is refused.
    fn refusal(changes: toml::Table) -> Option<String> {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/scenarios/squad.toml");
        let text = std::fs::read_to_string(&path).expect("a scenario");
        let mut table: toml::Table = toml::from_str(&text).expect("a table");
        table.extend(changes);
        let loaded = Scenario::from_table(table, &path);
        loaded.err().map(|refused| refused.to_string())
    }

    #[track_caller]
    fn assert_refused(changes: toml::Table, parts: [&str; 3]) {
        let message = refusal(changes).expect("refused");
        assert!(message.contains("squad.toml: "), "{message}");
        for part in parts {
            assert!(message.contains(part), "{message}");
        }
    }

    #[test]
    fn robots_inside_one_another_are_refused() {
        let first = toml::toml! { squad = [{ start = { x = -4.5, y = 0.1 } }] };
        assert_refused(
            first,
            [
                "squad[0].start",
                "inside another robot",
                "0.14 m from start",
            ],
        );
        let mates = toml::toml! { squad = [{ start = { x = 1.0, y = 1.0 } }, { start = { x = 1.4, y = 1.0 } }] };
        assert_refused(
            mates,
            ["squad[1].start", "inside", "0.40 m from squad[0].start"],
        );
        let placed =
            toml::toml! { others = { placed = [{ x = -4.6, y = 0.3, team = "magenta" }] } };
        assert_refused(placed, ["others.placed[0]", "inside", "0.30 m from start"]);
    }

    #[test]
    fn robots_that_touch_are_accepted() {
        let placed = toml::toml! {
            squad = []
            others = { placed = [{ x = -4.12, y = 0.48, team = "cyan" }, { x = -4.12, y = 0.96, team = "magenta" }] }
        };
        assert_eq!(refusal(placed), None);
    }

    #[test]
    fn robots_outside_the_room_are_refused() {
        let mate = toml::toml! { squad = [{ start = { x = 60.0, y = 0.0 } }] };
        assert_refused(mate, ["squad[0].start", "outside the room", "(60, 0)"]);
        let first = toml::toml! { start = { x = 0.0, y = -30.0 } };
        assert_refused(
            first,
            [
                "start: outside the room",
                "(0, -30)",
                "expected a whole body within",
            ],
        );
        let placed = toml::toml! { others = { placed = [{ x = 0.0, y = 30.0, team = "cyan" }] } };
        assert_refused(placed, ["others.placed[0]", "outside", "(0, 30)"]);
        let beside_the_field = toml::toml! { start = { x = 0.0, y = -6.8 } };
        assert_eq!(refusal(beside_the_field), None);
    }

    #[test]
    fn ball_that_would_be_moved_at_once_is_refused() {
        let far = toml::toml! { ball = { position = [50.0, 0.0] } };
        assert_refused(far, ["ball.position", "outside the room", "(50, 0)"]);
        let behind = toml::toml! { ball = { position = [9.5, 3.0] } };
        assert_refused(
            behind,
            [
                "ball.position",
                "out of play",
                "put at (8.64, 3.00) at once",
            ],
        );
        let kicked = toml::toml! { kicks = [{ time = 1.0, position = [0.0, 20.0], velocity = [0.0, -3.0] }] };
        assert_refused(kicked, ["kicks[0].position", "outside the room", "(0, 20)"]);
    }

    #[test]
    fn ball_beside_the_line_in_a_goal_or_moving_is_accepted() {
        for ball in [
            toml::toml! { ball = { position = [0.0, 6.5] } },
            toml::toml! { ball = { position = [9.2, 0.0] } },
            toml::toml! { ball = { position = [9.5, 3.0], velocity = [-2.0, 0.0] } },
            toml::toml! { ball = { position = [50.0, 0.0], present = false } },
        ] {
            assert_eq!(refusal(ball), None);
        }
    }
}
