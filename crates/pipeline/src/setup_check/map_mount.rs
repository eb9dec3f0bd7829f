//! How is a ground map mounted on the robot? Its side, forward direction and origin, by the steps of the wheels.
//!
//! The lines of a field look alike turned by half a turn and mirrored, and do not tell the robot's origin from another point
//! (docs/methods.md 16.4).

use std::f32::consts::FRAC_PI_4;

use anyhow::{Result, bail, ensure};
use localize::At;
use localize::frames::wrap_angle;
use localize::math;
use localize::setup_check::{Explanation, compare};
use rayon::prelude::*;
use vision::GroundMap;

use super::assess::Trial;
use super::change::Change;
use super::effort::Effort;
use super::latency;
use super::measurements::{MeasuredKeyframe, measure, with_points};
use super::variant::SetupVariant;
use super::{KEYFRAMES_MIN, assess};
use crate::config::PipelineConfig;
use crate::recording::Recording;
use crate::setup::Setup;

/// Passes of the fit of an angle: steps of a turned camera join with an error.
const TURN_PASSES: usize = 3;
/// Mounts that differ by less are one, radians.
const SAME_TURN: f32 = 0.2;
/// Standard deviation of the direction that right wheels measure, radians: their radii differ by some per cent.
const WHEELS_TURN_STD: f32 = 0.01;
/// Logarithm of the likelihood ratio to the next best mount.
const GAIN_MIN: f32 = 15.0;
/// Agreement of the wheels with the best mount.
const AGREEMENT_MIN: f32 = 0.8;

/// Standard deviation per axis of the origin that lines alone give, metres: seven maps, most of mirrors tilted by up to 0.5 degrees, were
/// 0.1 to 10.5 cm off.
pub const LINES_ORIGIN_STD: f32 = 0.06;

/// How a map's ground points become those of the robot frame.
#[derive(Debug, Clone, PartialEq)]
pub struct MapMount {
    /// Left and right are exchanged.
    pub mirrored: bool,
    /// Turn counter-clockwise, radians: before left and right are exchanged.
    pub turn: f32,
    /// Its standard deviation, radians.
    pub turn_std: f32,
    /// The map's origin in the robot frame, metres. None if the drive tells it no better than it is known.
    pub origin: Option<[f32; 2]>,
    /// Standard deviation of the mounted map's origin per axis, metres.
    pub origin_std: f32,
    /// That by the drive alone, metres.
    pub origin_std_by_drive: f32,
    /// How far the wheels agree with the poses, with the map as it was and as it is mounted: at most 1.
    pub wheels_agree: [f32; 2],
    /// Keyframes that were compared.
    pub keyframes: usize,
    variant: SetupVariant,
}

impl MapMount {
    /// The map in the robot frame.
    pub fn apply(&self, map: &GroundMap) -> GroundMap {
        let [dx, dy] = self.origin.unwrap_or_default();
        let ground = map.x.iter().zip(&map.y).map(|(&x, &y)| {
            let turned = self.variant.turn(At::new(x, y));
            (turned.x + dx, turned.y + dy)
        });
        let (x, y) = ground.unzip();
        GroundMap {
            width_px: map.width_px,
            height_px: map.height_px,
            x,
            y,
        }
    }
}

/// Finds the mount of a robot's calibrated map by a drive with wheels; a compass is not asked.
///
/// Errors if the drive has too few images with line points, or its wheels fit no mount, or two alike.
pub fn find_map_mount(
    recording: &Recording,
    setup: &Setup,
    config: &PipelineConfig,
) -> Result<MapMount> {
    ensure!(
        setup.traced_mirror.is_none(),
        "the robot has no calibrated map, but a mirror profile: `mirrorball doctor --recording` names forward_deg, flipped and centre_px"
    );
    let measured = measure(recording, setup, config, Effort::Brief)?.keyframes;
    let mut measured = with_points(measured, config.localize.mode.points_min);
    ensure!(
        measured.len() >= KEYFRAMES_MIN,
        "only {} images with line points, some way apart (expected at least {KEYFRAMES_MIN})",
        measured.len()
    );
    for keyframe in &mut measured {
        keyframe.compass = None;
    }
    let trial = assess::Trial::new(setup, &config.localize, &measured);
    best_mount(&trial, &measured)
}

fn best_mount(trial: &Trial<'_>, measured: &[MeasuredKeyframe]) -> Result<MapMount> {
    let configured = SetupVariant::configured(trial.setup);
    let mounts = [false, true].into_iter().flat_map(|mirrored| {
        (0..8).map(move |eighths: u8| (mirrored, FRAC_PI_4 * f32::from(eighths)))
    });
    let mounted = |(mirrored, turn): (bool, f32)| SetupVariant {
        mirrored,
        camera_turn: wrap_angle(turn),
        ..configured.clone()
    };
    let tried: Vec<(SetupVariant, Explanation)> = mounts
        .collect::<Vec<_>>()
        .into_par_iter()
        .filter_map(|mount| {
            let variant = mounted(mount);
            let explanation = trial.explain(&variant, measured)?;
            Some((variant, explanation))
        })
        .collect();
    let before = tried.first().and_then(|(_, first)| first.wheels_agree());
    let Some(before) = before else {
        bail!("no wheel motion between the images (odometry.csv)");
    };
    let by_cost = |a: &(SetupVariant, Explanation), b: &(SetupVariant, Explanation)| {
        a.1.cost().total_cmp(&b.1.cost())
    };
    let refined = tried.into_par_iter().map(|start| refine_turn(trial, start));
    let mut refined: Vec<(SetupVariant, Explanation)> = refined.collect();
    refined.sort_by(by_cost);
    let Some((variant, explanation)) = refined.first() else {
        bail!("the field of robot.toml is impossible");
    };
    let after = explanation.wheels_agree().unwrap_or(0.0);
    ensure!(
        after >= AGREEMENT_MIN,
        "the wheels agree with the line points by {:.0} % only, however the map is mounted: is the map right, and odometry.csv?",
        100.0 * after
    );
    let is_other = |other: &&(SetupVariant, Explanation)| {
        other.0.mirrored != variant.mirrored
            || wrap_angle(other.0.camera_turn - variant.camera_turn).abs() > SAME_TURN
    };
    if let Some((other, near)) = refined.iter().find(is_other) {
        ensure!(
            compare(near, explanation).gain > GAIN_MIN,
            "the drive does not tell a map turned by {:.0} degrees from one turned by {:.0}{}: drive farther, forward and sideways, with turns",
            variant.camera_turn.to_degrees(),
            other.camera_turn.to_degrees(),
            if other.mirrored == variant.mirrored {
                ""
            } else {
                " whose left and right are exchanged against it"
            }
        );
    }
    // Older images look like a turned map: a delay shifts the poses of a robot that accelerates.
    let latency = trial.setup.camera_latency(&trial.config.filter);
    let wheels = variant.wheels(trial.setup);
    if let Some(other) = latency::other_latency(measured, explanation, &wheels, latency) {
        bail!(
            "the images seem {:.0} ms old at their stamps, the set-up says {:.0} ms, which looks like a turned map: measure it first \
             (`mirrorball calibrate latency`) and set [timing] camera_latency of robot.toml",
            1e3 * other.age,
            1e3 * other.configured
        );
    }
    let Some(fit) = explanation.wheels_fit() else {
        bail!("too few steps of the wheels to tell a direction: drive farther");
    };
    let origin_std_by_drive = fit.origin.variance.sqrt();
    let known_std = trial.setup.map_origin_std(LINES_ORIGIN_STD);
    Ok(MapMount {
        mirrored: variant.mirrored,
        turn: variant.camera_turn,
        turn_std: math::hypot(fit.turn_std, WHEELS_TURN_STD),
        origin: (origin_std_by_drive < known_std).then(|| fit.origin.at.into()),
        origin_std: origin_std_by_drive.min(known_std),
        origin_std_by_drive,
        wheels_agree: [before, after],
        keyframes: explanation.keyframes.len(),
        variant: variant.clone(),
    })
}

/// Turns a mount by the angle between wheels and poses, until it fits.
fn refine_turn(
    trial: &Trial<'_>,
    (mut variant, mut explanation): (SetupVariant, Explanation),
) -> (SetupVariant, Explanation) {
    for _ in 0..TURN_PASSES {
        let Some(fit) = explanation.wheels_fit() else {
            break;
        };
        let mut next = Change::CameraTurn(-fit.turn).apply(&variant);
        next.camera_turn = wrap_angle(next.camera_turn);
        let Some(found) = trial.explain(&next, trial.measured) else {
            break;
        };
        (variant, explanation) = (next, found);
    }
    (variant, explanation)
}
