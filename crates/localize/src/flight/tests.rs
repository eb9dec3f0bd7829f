//! Rays of balls that roll, fly, bounce and are held, generated apart from the estimators' model.

use super::*;
use crate::stamp::Stamp;
use crate::synthetic::flying_ball::{Flight, trajectory};

/// A viewpoint at a mirror's height.
const VIEWPOINT: [f32; 3] = [0.0, 0.0, 0.8];
/// Error of a ray, radians.
const RAY_STD: f32 = 0.004;

fn ray_to(centre: [f64; 3], origin: [f32; 3], seconds: f64, errors: [f32; 2]) -> BallRay {
    let offset: [f64; 3] = std::array::from_fn(|axis| centre[axis] - f64::from(origin[axis]));
    let level = offset[0].hypot(offset[1]);
    BallRay {
        stamp: Stamp::from_seconds(seconds),
        origin,
        azimuth: offset[1].atan2(offset[0]) as f32 + errors[0],
        elevation: offset[2].atan2(level) as f32 + errors[1],
        azimuth_std: RAY_STD,
        elevation_std: RAY_STD,
        distance: None,
    }
}

/// What the tracker says after each image of a path at 30 images per second.
fn track(path: &[[f64; 3]]) -> Vec<TrackedFlight> {
    let mut tracker = FlightTracker::new(FlightConfig::default());
    let rays = path.iter().enumerate().map(|(image, &centre)| {
        // A fixed pattern in place of noise, of half the stated size.
        let error = |phase: f32| 0.5 * RAY_STD * (2.4 * image as f32 + phase).sin();
        ray_to(
            centre,
            VIEWPOINT,
            image as f64 / 30.0,
            [error(0.0), error(2.0)],
        )
    });
    rays.map(|ray| tracker.update(&ray).expect("a state"))
        .collect()
}

fn chip(at: [f64; 3], velocity: [f64; 3], images: usize) -> Vec<[f64; 3]> {
    let flight = Flight {
        at,
        velocity,
        ..Flight::default()
    };
    trajectory(&flight, images, 30.0)
}

#[test]
fn flight_is_told_from_rolling_and_its_depth_is_found() {
    let path = chip([1.5, -1.0, 0.11], [2.0, 3.0, 3.5], 20);
    let tracked = track(&path);
    let last = tracked.last().expect("states");
    assert!(last.airborne_probability > 0.99, "{last:?}");
    let state = last.flight.expect("a flight");
    let error: f64 = (0..3)
        .map(|axis| (state.state[axis] - path[19][axis]).powi(2))
        .sum();
    assert!(error.sqrt() < 0.15, "{:?} {:?}", state.state, path[19]);
}

#[test]
fn rolling_ball_is_never_in_the_air() {
    for velocity in [[0.0, 0.0], [2.0, 0.5], [-3.0, 1.0], [0.3, 5.0]] {
        let path: Vec<[f64; 3]> = (0..40)
            .map(|image| {
                let t = image as f64 / 30.0;
                [2.5 + velocity[0] * t * 0.5, -1.5 + velocity[1] * t, 0.11]
            })
            .collect();
        for (image, tracked) in track(&path).iter().enumerate() {
            assert!(
                tracked.airborne_probability < 0.5,
                "{velocity:?} {image}: {tracked:?}"
            );
        }
    }
}

#[test]
fn ball_kicked_along_the_ground_stays_on_the_ground() {
    let path: Vec<[f64; 3]> = (0..40)
        .map(|image| {
            let t = (f64::from(image) - 15.0).max(0.0) / 30.0;
            [2.0 + 3.0 * t, 0.5 + 4.0 * t, 0.11]
        })
        .collect();
    let airborne = track(&path)
        .iter()
        .filter(|tracked| tracked.airborne_probability > 0.5)
        .count();
    assert!(airborne <= 2, "{airborne}");
}

#[test]
fn flight_after_rolling_and_landing_are_found_in_time() {
    let mut path: Vec<[f64; 3]> = (0..20)
        .map(|image| [1.5 + 0.02 * f64::from(image), 1.0, 0.11])
        .collect();
    // 0.61 s in the air.
    let flight = chip([1.9, 1.0, 0.11], [3.0, -2.0, 3.0], 18);
    let end = flight[17];
    path.extend(flight);
    path.extend((1..20).map(|image| {
        [
            end[0] + 0.06 * f64::from(image),
            end[1] - 0.04 * f64::from(image),
            0.11,
        ]
    }));
    let tracked = track(&path);
    let in_air = |image: usize| tracked[image].airborne_probability > 0.5;
    assert!((0..20).all(|image| !in_air(image)));
    let found = (20..38).find(|&image| in_air(image)).expect("a flight");
    assert!(found <= 28, "{found}");
    assert!(!in_air(50));
}

#[test]
fn landing_of_a_parabola_is_its_end() {
    let config = FlightConfig {
        drag: 0.0,
        ..FlightConfig::default()
    };
    let state = BallMotionState {
        stamp: Stamp(0),
        state: [1.0, 2.0, 0.11, 3.0, -1.0, 4.0],
        covariance: nalgebra::SMatrix::identity() * 1e-4,
    };
    let landing = predict_landing(&state, &config).expect("a landing");
    let after = 8.0 / crate::sensors::attitude::GRAVITY;
    assert!((landing.after - after).abs() < 0.01, "{landing:?}");
    assert!((landing.at[0] - 1.0 - 3.0 * after).abs() < 0.02);
    assert!((landing.at[1] - 2.0 + after).abs() < 0.02);
    // δx = δx₀ + t·δv_x + (v_x/|v_z|)·(δz + t·δv_z)
    let variance = 1e-4 * (1.0 + after * after) * (1.0 + 9.0 / 16.0);
    assert!((landing.covariance[0] / variance - 1.0).abs() < 0.03);
}

#[test]
fn three_robots_find_a_held_ball_and_the_one_that_errs() {
    let ball = [1.0, 0.5, 1.2];
    let origins = [[-2.0, -1.0, 0.8], [3.0, -2.0, 0.75], [0.0, 4.0, 0.8]];
    let rays = |wrong: Option<usize>| -> Vec<RobotRay> {
        let mut rays = Vec::new();
        for image in 0..6 {
            for (robot, origin) in origins.into_iter().enumerate() {
                let off = if wrong == Some(robot) { 0.3 } else { 0.0 };
                rays.push(RobotRay {
                    robot: robot as u32 + 1,
                    ray: ray_to(ball, origin, f64::from(image) / 30.0, [off, -0.5 * off]),
                    pose_std: [0.03, 0.01],
                });
            }
        }
        rays
    };
    let triangulate = |rays: &[RobotRay]| {
        let mut tracker = TeamFlightTracker::new(FlightConfig::default());
        rays.iter().for_each(|ray| tracker.add(ray));
        tracker.ball()
    };
    let found = triangulate(&rays(None)).expect("a ball");
    assert_eq!((found.inliers.len(), found.mode), (3, BallMotionMode::Held));
    for wrong in 0..3 {
        let found = triangulate(&rays(Some(wrong))).expect("a ball");
        assert_eq!(found.outliers, [wrong as u32 + 1]);
        for (axis, wanted) in ball.iter().enumerate() {
            assert!((found.state.state[axis] - wanted).abs() < 0.1, "{found:?}");
        }
    }
    assert_eq!(triangulate(&rays(None)[..1]), None);
}

#[test]
fn late_rays_give_the_same_ball_as_rays_in_order() {
    let path = chip([1.5, -1.0, 0.11], [2.0, 3.0, 3.5], 12);
    let origins = [[-2.0, -1.0, 0.8], [3.0, -2.0, 0.75], [0.0, 4.0, 0.8]];
    let ray = |image: usize, robot: usize| RobotRay {
        robot: robot as u32,
        ray: ray_to(path[image], origins[robot], image as f64 / 30.0, [0.001; 2]),
        pose_std: [0.03, 0.01],
    };
    let mut in_order = TeamFlightTracker::new(FlightConfig::default());
    let mut late = in_order.clone();
    for image in 0..path.len() {
        for robot in 0..3 {
            in_order.add(&ray(image, robot));
        }
        in_order.ball();
        late.add(&ray(image, 0));
        // The first image has no ray before it, so that later ones have a place.
        for robot in 1..3 {
            let behind = if image == 0 { 0 } else { 2 * robot };
            if image == 0 || image > behind {
                late.add(&ray(image - behind, robot));
            }
        }
        late.ball();
    }
    for robot in 1..3 {
        for behind in 0..2 * robot {
            late.add(&ray(path.len() - 1 - behind, robot));
        }
    }
    assert_eq!(in_order.ball(), late.ball());
}

#[test]
fn senseless_rays_give_no_state_and_do_no_harm() {
    let mut tracker = FlightTracker::new(FlightConfig::default());
    let good = ray_to([2.0, 1.0, 0.11], VIEWPOINT, 0.0, [0.0; 2]);
    for bad in [
        BallRay {
            azimuth: f32::NAN,
            ..good
        },
        BallRay {
            elevation: f32::INFINITY,
            ..good
        },
        BallRay {
            azimuth_std: 0.0,
            ..good
        },
        BallRay {
            elevation_std: -1.0,
            ..good
        },
    ] {
        assert_eq!(tracker.update(&bad), None);
    }
    assert!(tracker.update(&good).is_some());
    // The same stamp again is no new image.
    assert_eq!(tracker.update(&good), None);
}
