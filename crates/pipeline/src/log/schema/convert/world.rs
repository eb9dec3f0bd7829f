//! How is the world view converted to its message and back?

use anyhow::{Context, Result};
use localize::Stamp;
use localize::frames::At;
use localize::world::{FieldState, TeamColour, TrackedObject, WorldView};
use nalgebra::Matrix4;

use super::super::wire;
use super::names::names;

names!(team_name, team_named: TeamColour { Cyan = "cyan", Magenta = "magenta" });

pub(crate) fn world_to_wire(WorldView { ball, robots }: &WorldView) -> wire::WorldView {
    wire::WorldView {
        ball: ball.as_ref().map(object_to_wire),
        robots: robots.iter().map(object_to_wire).collect(),
    }
}

pub(crate) fn world_from_wire(world: &wire::WorldView) -> Result<WorldView> {
    Ok(WorldView {
        ball: world.ball.as_ref().map(object_from_wire).transpose()?,
        robots: world
            .robots
            .iter()
            .map(object_from_wire)
            .collect::<Result<_>>()?,
    })
}

fn object_to_wire(object: &TrackedObject) -> wire::Object {
    let &TrackedObject {
        id,
        at,
        velocity: [velocity_x, velocity_y],
        covariance,
        on_field,
        probability,
        last_seen,
        team,
    } = object;
    wire::Object {
        id,
        x: at.x,
        y: at.y,
        velocity_x,
        velocity_y,
        covariance: rows(&covariance),
        on_field: on_field.as_ref().map(on_field_to_wire),
        probability,
        seen_ns: last_seen.0,
        team: team.map_or("", team_name).to_owned(),
    }
}

fn object_from_wire(object: &wire::Object) -> Result<TrackedObject> {
    Ok(TrackedObject {
        id: object.id,
        at: At::new(object.x, object.y),
        velocity: [object.velocity_x, object.velocity_y],
        covariance: matrix(&object.covariance)?,
        on_field: object
            .on_field
            .as_ref()
            .map(on_field_from_wire)
            .transpose()?,
        probability: object.probability,
        last_seen: Stamp(object.seen_ns),
        team: match object.team.as_str() {
            "" => None,
            team => Some(team_named(team)?),
        },
    })
}

fn on_field_to_wire(place: &FieldState) -> wire::OnField {
    let &FieldState {
        at,
        velocity: [velocity_x, velocity_y],
        covariance,
    } = place;
    wire::OnField {
        x: at.x,
        y: at.y,
        velocity_x,
        velocity_y,
        covariance: rows(&covariance),
    }
}

fn on_field_from_wire(place: &wire::OnField) -> Result<FieldState> {
    Ok(FieldState {
        at: At::new(place.x, place.y),
        velocity: [place.velocity_x, place.velocity_y],
        covariance: matrix(&place.covariance)?,
    })
}

fn rows(matrix: &Matrix4<f32>) -> Vec<f32> {
    matrix.transpose().iter().copied().collect()
}

fn matrix(values: &[f32]) -> Result<Matrix4<f32>> {
    let values: &[f32; 16] = values
        .try_into()
        .context("an object's covariance has not 16 entries")?;
    Ok(Matrix4::from_row_slice(values))
}
