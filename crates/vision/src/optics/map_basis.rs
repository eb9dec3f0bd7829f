//! How does a ground map change with the mount of its mirror? The displacement fields that localization estimates
//! (docs/methods.md 2.13), traced from the mirror's profile, or taken from the map itself where the profile is unknown.

use std::f32::consts::FRAC_PI_2;

use localize::map_correction::{
    BasisTerm, Harmonic, MapBasis, MapCorrectionConfig, MirrorModel, NODES, TermKind, height_term,
    smooth_terms,
};
use localize::math;
use localize::robot::CameraConfig;

use crate::optics::ground_map::GroundMap;
use crate::optics::mirror::Profile;
use crate::optics::ray_tracing::{Mount, OpticsError, Tracer};

/// Image radii at which the fields are traced.
const RADII: usize = 400;

/// Steps of the derivatives: far above the rounding of single precision, far below what changes the linearisation.
const TILT_STEP_DEG: f64 = 0.1;
const OFFSET_STEP: f64 = 2e-4;
const FOCAL_STEP: f32 = 2e-3;

/// A field by γ: (γ, radial, tangential) per unit, in the order of γ.
type FieldSamples = Vec<[f32; 3]>;

/// Possible errors of a map that is traced from a profile: mirror tilt, mirror offset, focal length, and height.
/// `height`: of the viewpoint above the ground, metres.
pub fn basis_from_profile(
    camera: &CameraConfig,
    profile: &Profile,
    height: f32,
    config: &MapCorrectionConfig,
) -> Result<MapBasis, OpticsError> {
    let tilted = |tilt_deg| Mount {
        mirror_tilt_deg: [tilt_deg, 0.0],
        ..Mount::default()
    };
    let displaced = |offset| Mount {
        mirror_offset: [offset, 0.0],
        ..Mount::default()
    };
    let zoomed = |step: f32| CameraConfig {
        focal_px: camera.focal_px.map(|focal| focal * (1.0 + step)),
        ..camera.clone()
    };
    let field = |cameras: [&CameraConfig; 2], mounts: [Mount; 2], step: f64| {
        let tracers = [
            Tracer::new(cameras[0], profile, &mounts[0])?,
            Tracer::new(cameras[1], profile, &mounts[1])?,
        ];
        Ok(trace_field(camera, &tracers, step as f32, height))
    };
    let tilt = field(
        [camera, camera],
        [tilted(-TILT_STEP_DEG), tilted(TILT_STEP_DEG)],
        2.0 * TILT_STEP_DEG.to_radians(),
    )?;
    let offset = field(
        [camera, camera],
        [displaced(-OFFSET_STEP), displaced(OFFSET_STEP)],
        2.0 * OFFSET_STEP,
    )?;
    let focal = field(
        [&zoomed(-FOCAL_STEP), &zoomed(FOCAL_STEP)],
        [Mount::default(); 2],
        f64::from(2.0 * FOCAL_STEP),
    )?;
    let tilt_std = config.mirror_tilt_std_deg.to_radians();
    let terms = vec![
        term(TermKind::MirrorTiltX, tilt_std, Harmonic::Cosine, &tilt),
        term(TermKind::MirrorTiltY, tilt_std, Harmonic::Sine, &tilt),
        term(
            TermKind::MirrorOffsetX,
            config.mirror_offset_std,
            Harmonic::Cosine,
            &offset,
        ),
        term(
            TermKind::MirrorOffsetY,
            config.mirror_offset_std,
            Harmonic::Sine,
            &offset,
        ),
        term(
            TermKind::FocalLength,
            config.focal_std,
            Harmonic::Constant,
            &focal,
        ),
        height_term(config.height_std, height),
    ];
    let focal_px = camera.focal_px.ok_or(OpticsError::Missing("focal_px"))?;
    let pinhole_height = camera.height.ok_or(OpticsError::Missing("height"))?;
    let mirror = MirrorModel::new(
        |radius| profile.height_and_slope(radius),
        profile.radii().1,
        pinhole_height.into(),
        rim_px(camera) / focal_px,
        height,
    );
    Ok(MapBasis::new(terms, height).with_mirror(mirror))
}

/// Possible errors of a calibrated map: smooth errors, and a shift of the image's centre.
pub fn basis_from_map(
    camera: &CameraConfig,
    map: &GroundMap,
    height: f32,
    config: &MapCorrectionConfig,
) -> MapBasis {
    let mut terms = smooth_terms(config.smooth_std);
    let shift = centre_field(camera, map, height);
    if !shift.is_empty() {
        for (kind, harmonic) in [
            (TermKind::CentreX, Harmonic::Cosine),
            (TermKind::CentreY, Harmonic::Sine),
        ] {
            terms.push(term(kind, config.smooth_std, harmonic, &shift));
        }
    }
    MapBasis::new(terms, height)
}

/// Radius of the mirror's rim in the image, pixels; at least that of the image where it is not given.
fn rim_px(camera: &CameraConfig) -> f32 {
    camera
        .outer_radius_px
        .unwrap_or_else(|| camera.width_px.max(camera.height_px) as f32)
}

/// The field of a change along x, from its traces ahead (radial) and to the left (tangential).
fn trace_field(
    camera: &CameraConfig,
    tracers: &[Tracer<'_>; 2],
    step: f32,
    height: f32,
) -> FieldSamples {
    let rim = rim_px(camera);
    let [row_u, row_v] = camera.image_from_robot();
    let trace = |tracer: &Tracer<'_>, ahead: f32, left: f32| {
        let u = camera.centre_px[0] + row_u[0] * ahead + row_u[1] * left;
        let v = camera.centre_px[1] + row_v[0] * ahead + row_v[1] * left;
        let ground = tracer.ray(f64::from(u), f64::from(v))?.at_height(0.0)?;
        let range = math::hypot(ground.x, ground.y);
        Some((math::atan(range / height), math::atan2(ground.y, ground.x)))
    };
    let mut samples = FieldSamples::new();
    for k in 1..RADII {
        let radius = rim * k as f32 / RADII as f32;
        let ahead = [0, 1].map(|n| trace(&tracers[n], radius, 0.0));
        let left = [0, 1].map(|n| trace(&tracers[n], 0.0, radius));
        let ([Some((low, _)), Some((high, _))], [Some((_, from)), Some((_, to))]) = (ahead, left)
        else {
            continue;
        };
        let angle = 0.5 * (low + high);
        // A second ring of the mirror may show near ground again; the fields are those of the first one.
        if samples.last().is_none_or(|last| angle > last[0]) {
            let radial = (high - low) / step;
            let tangential = math::sin(angle) * localize::frames::wrap_angle(to - from) / step;
            // Ahead of the robot's left the harmonic's tangential factor is −1.
            samples.push([angle, radial, -tangential]);
        }
    }
    samples
}

/// The field of a shift of the image's centre along x by the rim's radius, from the map's mean range per image radius.
fn centre_field(camera: &CameraConfig, map: &GroundMap, height: f32) -> FieldSamples {
    const BINS: usize = 120;
    let mut radius_sums = [[0.0f64; 2]; BINS];
    let mut rim = 0.0f32;
    for row in 0..map.height_px {
        for column in 0..map.width_px {
            let Some(at) = map.at(column, row) else {
                continue;
            };
            let radius = math::hypot(
                column as f32 - camera.centre_px[0],
                row as f32 - camera.centre_px[1],
            );
            rim = rim.max(radius);
            let bin = math::atan(at.distance() / height) / FRAC_PI_2 * BINS as f32;
            let sums = &mut radius_sums[(bin as usize).min(BINS - 1)];
            sums[0] += f64::from(radius);
            sums[1] += 1.0;
        }
    }
    let nodes: Vec<[f32; 2]> = radius_sums
        .iter()
        .enumerate()
        .filter(|(_, sums)| sums[1] > 0.0)
        .map(|(bin, sums)| {
            let angle = FRAC_PI_2 * (bin as f32 + 0.5) / BINS as f32;
            [angle, (sums[0] / sums[1]) as f32]
        })
        .collect();
    // Over a few bins, since pixels are coarse near the robot.
    const SPAN: usize = 4;
    nodes
        .windows(SPAN + 1)
        .filter_map(|window| {
            let ([low, near], [high, far]) = (window[0], window[SPAN]);
            let [angle, radius] = window[SPAN / 2];
            let step = far - near;
            (step > 0.5 && radius > 1.0).then(|| {
                [
                    angle,
                    rim * (high - low) / step,
                    rim * math::sin(angle) / radius,
                ]
            })
        })
        .collect()
}

/// A term with the tables of a field.
fn term(kind: TermKind, std: f32, harmonic: Harmonic, samples: &FieldSamples) -> BasisTerm {
    let mut term = BasisTerm {
        kind,
        std,
        harmonic,
        radial: [0.0; NODES],
        tangential: [0.0; NODES],
    };
    for node in 0..NODES {
        [term.radial[node], term.tangential[node]] =
            interpolate(samples, MapBasis::node_angle(node));
    }
    term
}

/// Linear between the samples, constant beyond them.
fn interpolate(samples: &FieldSamples, angle: f32) -> [f32; 2] {
    let after = samples.partition_point(|sample| sample[0] < angle);
    let (Some(low), Some(high)) = (
        samples.get(after.saturating_sub(1)),
        samples.get(after.min(samples.len().saturating_sub(1))),
    ) else {
        return [0.0; 2];
    };
    let span = high[0] - low[0];
    let share = if span > 0.0 {
        ((angle - low[0]) / span).clamp(0.0, 1.0)
    } else {
        0.0
    };
    [1, 2].map(|k| low[k] + share * (high[k] - low[k]))
}
