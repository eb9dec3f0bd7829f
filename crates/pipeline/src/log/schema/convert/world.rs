//! How is the world view converted to its message and back?

use anyhow::{Context, Result, bail};
use localize::Stamp;
use localize::flight::Landing;
use localize::frames::At;
use localize::world::{
    AirborneState, BallInAir, BallSighting, FieldState, TeamColour, TrackedObject, WorldView,
};
use nalgebra::Matrix4;

use super::super::wire;
use super::names::names;

names!(team_name, team_named: TeamColour { Cyan = "cyan", Magenta = "magenta" });

pub(crate) fn world_to_wire(world: &WorldView) -> wire::WorldView {
    let WorldView {
        ball,
        robots,
        ball_in_air,
        ball_sighting,
    } = world;
    wire::WorldView {
        ball_in_air: ball_in_air.as_ref().map(|ball| wire::BallInAir {
            probability: ball.probability,
            from_robot: airborne_to_wire(&ball.from_robot),
            on_field: ball.on_field.as_ref().map(airborne_to_wire),
        }),
        ball_sighting: ball_sighting
            .as_ref()
            .map(sighting_to_wire)
            .unwrap_or_default(),
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
        ball_in_air: match &world.ball_in_air {
            None => None,
            Some(ball) => Some(BallInAir {
                probability: ball.probability,
                from_robot: airborne_from_wire(&ball.from_robot)?,
                on_field: ball.on_field.as_ref().map(airborne_from_wire).transpose()?,
            }),
        },
        ball_sighting: sighting_from_wire(&world.ball_sighting)?,
    })
}

pub(super) fn sighting_to_wire(sighting: &BallSighting) -> Vec<f32> {
    let &BallSighting {
        azimuth,
        elevation,
        std: [azimuth_std, elevation_std],
        viewpoint_height,
        distance,
    } = sighting;
    let mut values = vec![
        azimuth,
        elevation,
        azimuth_std,
        elevation_std,
        viewpoint_height,
    ];
    values.extend(distance.into_iter().flatten());
    values
}

pub(super) fn sighting_from_wire(values: &[f32]) -> Result<Option<BallSighting>> {
    Ok(match *values {
        [] => None,
        [
            azimuth,
            elevation,
            azimuth_std,
            elevation_std,
            viewpoint_height,
            ref distance @ ..,
        ] => Some(BallSighting {
            azimuth,
            elevation,
            std: [azimuth_std, elevation_std],
            viewpoint_height,
            distance: match *distance {
                [] => None,
                [distance, std] => Some([distance, std]),
                _ => bail!("a ball's direction of {} numbers", values.len()),
            },
        }),
        _ => bail!("a ball's direction of {} numbers", values.len()),
    })
}

pub(super) fn airborne_to_wire(state: &AirborneState) -> wire::AirborneState {
    let &AirborneState {
        at: [x, y, z],
        velocity: [velocity_x, velocity_y, velocity_z],
        covariance,
        landing,
    } = state;
    let numbers = |landing: Landing| {
        let ([x, y], [xx, xy, yy]) = (landing.at, landing.covariance);
        vec![landing.after, x, y, xx, xy, yy]
    };
    wire::AirborneState {
        x,
        y,
        z,
        velocity_x,
        velocity_y,
        velocity_z,
        covariance: covariance.to_vec(),
        landing: landing.map(numbers).unwrap_or_default(),
    }
}

pub(super) fn airborne_from_wire(state: &wire::AirborneState) -> Result<AirborneState> {
    Ok(AirborneState {
        at: [state.x, state.y, state.z],
        velocity: [state.velocity_x, state.velocity_y, state.velocity_z],
        covariance: state.covariance[..]
            .try_into()
            .context("an airborne ball's covariance has not 6 entries")?,
        landing: match state.landing[..] {
            [] => None,
            [after, x, y, xx, xy, yy] => Some(Landing {
                after,
                at: [x, y],
                covariance: [xx, xy, yy],
            }),
            _ => bail!("a landing of {} numbers", state.landing.len()),
        },
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
