//! How long do tracking and global search take? Line points of a synthetic drive.

use std::hint::black_box;
use std::time::Instant;

use anyhow::Result;
use localize::advice::{AdviceConfig, Advisor, CheckedMarkings, Considered, PointWeights};
use localize::flight::{BallRay, FlightConfig, FlightTracker, RobotRay, TeamFlightTracker};
use localize::global_search::branch_and_bound::{BranchAndBound, HeadingPrior};
use localize::global_search::hough::Hough;
use localize::global_search::monte_carlo::MonteCarlo;
use localize::global_search::scan_map::ScanMap;
use localize::matching::Matcher;
use localize::synthetic::drive::{SyntheticDrive, SyntheticDriveConfig, SyntheticSample};
use localize::{DistanceField, Field, LocalizeConfig, Localizer, Pose, Stamp, Tf, math};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::measure::{BenchFigure, CallTimes, Figures, REPEATS};
use super::team_sightings;
use pipeline::PipelineConfig;
use pipeline::paths;
use pipeline::setup::Setup;

/// A synthetic drive with the data rate that published systems were measured with: 30 Hz, about 113 points within 5 m.
fn drive_frames(field: &Field) -> Vec<SyntheticSample> {
    SyntheticDrive::new(
        field,
        SyntheticDriveConfig::default(),
        ChaCha8Rng::seed_from_u64(2),
    )
    .take(900)
    .collect()
}

/// Figures of `measure_localization`.
pub(super) const NAMES: &[&str] = &[
    "match_points",
    "track_frame",
    "track_frame_p99",
    "map_correction",
    "exact_no_prior",
    "exact_compass",
    "exact_certified",
    "advice",
    "ball_flight",
    "ball_rays_of_team",
    "team_sightings",
];

/// Times the matching, the tracking and the branch-and-bound search of the default preset.
pub(super) fn measure_localization(figures: &mut Figures) -> Result<()> {
    let field = Field::load(&paths::find_resource("config/fields/msl_18x12.toml")?)?;
    let frames = drive_frames(&field);
    let config = PipelineConfig::default().localize;
    let distances = DistanceField::new(&field, &config.distance_field);
    let mut matcher = Matcher::new(config.matching.clone());
    let mut search = BranchAndBound::new(&field, &distances, config.branch_and_bound.clone());
    let mut number = 0;
    let mut next = || {
        number = (number + 7) % frames.len();
        &frames[number]
    };
    let perturbed = |pose: Pose| Pose::new(pose.x + 0.02, pose.y - 0.02, pose.theta + 0.01);
    figures.time_calls("match_points", "<= 0.08", 3000, || {
        let frame = next();
        black_box(matcher.refine(&distances, &frame.points, perturbed(frame.true_pose), 0.05));
    });
    if figures.wants("map_correction") {
        let added = map_correction_time(&field, &frames, &config)?;
        figures.push(BenchFigure::new("map_correction", added, "ms", "<= 0.05"));
    }
    let mut localizer = Localizer::new(&field, config);
    let mut times = Vec::new();
    for frame in &frames {
        let started = Instant::now();
        localizer.add_odometry(&frame.odometry);
        localizer.add_compass(&frame.compass);
        black_box(localizer.process_points(frame.stamp, &frame.points));
        times.push(started.elapsed().as_secs_f64() * 1e3);
    }
    figures.push_times(
        "track_frame",
        &CallTimes::of(times),
        ["<= 0.025", "<= 0.06"],
    );
    figures.time_calls("exact_no_prior", "<= 3", REPEATS, || {
        black_box(search.find_hypotheses(&distances, &mut matcher, &next().points, None));
    });
    figures.time_calls("exact_compass", "<= 0.5", REPEATS, || {
        let frame = next();
        let prior = HeadingPrior {
            heading: frame.compass.heading,
            std: 10f32.to_radians(),
        };
        black_box(search.find_hypotheses(&distances, &mut matcher, &frame.points, Some(prior)));
    });
    figures.time_calls("exact_certified", "<= 3.3", REPEATS, || {
        black_box(search.find_certified(&distances, &mut matcher, &next().points, None));
    });
    let advisor = Advisor::new(&field, AdviceConfig::default());
    let weights = PointWeights {
        kernel_scale_sigmas: 3.0,
        map_std: 0.015,
        likelihood_exponent: 0.3,
        deciding_log_odds: 3.0,
    };
    let checked = CheckedMarkings::default();
    figures.time_calls("advice", "<= 1", REPEATS, || {
        let frame = next();
        // A rival half a field away, turned by a quarter.
        let poses = [frame.true_pose, frame.true_pose * Tf::new(4.0, 1.0, 1.57)];
        let considered = poses.map(|pose| Considered {
            pose,
            checked: &checked,
        });
        black_box(advisor.advise(&distances, &frame.points, considered, &weights, None));
    });
    measure_flight(figures);
    if figures.wants("team_sightings") {
        let added = team_sightings::added_time(&field, &frames);
        figures.push(BenchFigure::new("team_sightings", added, "ms", "<= 0.05"));
    }
    Ok(())
}

/// Times what a ball in the air adds to an image: the paths of one robot's rays, and the rays of four robots.
fn measure_flight(figures: &mut Figures) {
    let config = FlightConfig::default();
    let ray = |image: i64, origin: [f32; 3]| {
        // A ball that is kicked into the air after half a second, again and again.
        let t = ((image % 45 - 15).max(0)) as f32 / 30.0;
        let height = (0.11 + 4.0 * t - 4.9 * t * t).max(0.11);
        let offset = [
            2.0 + 3.0 * t - origin[0],
            1.0 - t - origin[1],
            height - origin[2],
        ];
        let level = math::hypot(offset[0], offset[1]);
        let wobble = 0.003 * math::sin(2.4 * image as f32);
        BallRay {
            stamp: Stamp(image * 33_333_333),
            origin,
            azimuth: math::atan2(offset[1], offset[0]) + wobble,
            elevation: math::atan2(offset[2], level) - wobble,
            azimuth_std: 0.004,
            elevation_std: 0.004,
            distance: None,
        }
    };
    let mut tracker = FlightTracker::new(config.clone());
    let mut image = 0;
    figures.time_calls("ball_flight", "<= 0.05", 3000, || {
        image += 1;
        black_box(tracker.update(&ray(image, [0.0, 0.0, 0.8])));
    });
    let origins = [
        [-3.0, 0.0, 0.8],
        [3.0, 1.0, 0.8],
        [0.0, 4.0, 0.8],
        [1.0, -4.0, 0.8],
    ];
    let mut tracker = TeamFlightTracker::new(config);
    let mut image = 0;
    figures.time_calls("ball_rays_of_team", "<= 0.05", 3000, || {
        image += 1;
        for (robot, origin) in origins.into_iter().enumerate() {
            // Team-mates report every second image, one image late.
            let late = i64::from(robot > 0);
            if robot == 0 || (image + robot as i64) % 2 == 0 {
                tracker.add(&RobotRay {
                    robot: robot as u32,
                    ray: ray(image - late, origin),
                    pose_std: [0.03, 0.01],
                });
            }
        }
        black_box(tracker.ball());
    });
}

/// Passes over the drive: the least time of an image counts, without what else the machine did.
const PASSES: usize = 5;

/// Mean time that the correction of a mirror's map adds to a tracked image, milliseconds. Images with and without it alternate.
fn map_correction_time(
    field: &Field,
    frames: &[SyntheticSample],
    config: &LocalizeConfig,
) -> Result<f64> {
    let robot = paths::find_resource("config/robots/default.toml")?;
    let setup = Setup::load(&robot, None)?;
    let mut config = config.clone();
    if let Some(height) = setup.viewpoint_height {
        config.matching.viewpoint_height = height;
    }
    let basis = setup.map_basis(&config)?;
    let mut least = vec![[f64::INFINITY; 2]; frames.len()];
    for _ in 0..PASSES {
        let mut localizers = [(); 2].map(|()| Localizer::new(field, config.clone()));
        localizers[1].set_map_basis(basis.clone());
        for (frame, least) in frames.iter().zip(&mut least) {
            for (localizer, least) in localizers.iter_mut().zip(least) {
                localizer.add_odometry(&frame.odometry);
                localizer.add_compass(&frame.compass);
                let started = Instant::now();
                black_box(localizer.process_points(frame.stamp, &frame.points));
                *least = least.min(started.elapsed().as_secs_f64() * 1e3);
            }
        }
    }
    let added = least.iter().map(|[without, with]| with - without);
    Ok(added.sum::<f64>() / frames.len() as f64)
}

/// Figures of `measure_paper_methods`.
pub(super) const PAPERS: &[&str] = &[
    "hough",
    "scan_map_global",
    "scan_map_local",
    "monte_carlo_cycle",
];

/// Times the global searches of the three papers.
pub(super) fn measure_paper_methods(figures: &mut Figures) -> Result<()> {
    let field = Field::load(&paths::find_resource("config/fields/msl_18x12.toml")?)?;
    let frames = drive_frames(&field);
    let config = PipelineConfig::default().localize;
    let distances = DistanceField::new(&field, &config.distance_field);
    let mut number = 0;
    let mut next = || {
        number = (number + 7) % frames.len();
        let frame = &frames[number];
        (
            frame,
            HeadingPrior {
                heading: frame.compass.heading,
                std: 10f32.to_radians(),
            },
        )
    };
    let mut hough = Hough::new(&field, config.global_search.hough.clone());
    figures.time_calls("hough", "<= 1", REPEATS, || {
        let (frame, prior) = next();
        black_box(hough.find_poses(&frame.points, Some(prior)));
    });
    let map = ScanMap::new(&field, &distances, config.global_search.scan_map.clone());
    figures.time_calls("scan_map_global", "<= 2", REPEATS, || {
        let (frame, prior) = next();
        black_box(map.find_poses(&frame.points, prior.heading, 6, 0.4));
    });
    figures.time_calls("scan_map_local", "<= 0.05", REPEATS, || {
        let (frame, _) = next();
        black_box(map.find_pose_near(&frame.points, frame.true_pose));
    });
    let mut filter = MonteCarlo::new(&field, &distances, config.global_search.monte_carlo.clone());
    figures.time_calls("monte_carlo_cycle", "<= 0.3", REPEATS, || {
        let (frame, prior) = next();
        filter.reset();
        black_box(filter.update(&frame.points, Some(prior)));
    });
    Ok(())
}
