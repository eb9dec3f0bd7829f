//! Computing time of localization: medians per image on an 18 × 12 m field, about 113 points within 5 m.

use std::hint::black_box;

use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use localize::filter::{
    FilterConfig, ImuInterval, OdometryPrior, PoseFilter, PredictionInput, WheelIncrement,
};
use localize::global_search::branch_and_bound::{BranchAndBound, HeadingPrior};
use localize::global_search::hough::{Hough, HoughConfig};
use localize::global_search::monte_carlo::{MonteCarlo, MonteCarloConfig};
use localize::global_search::scan_map::{ScanMap, ScanMapConfig};
use localize::matching::{MatchConfig, Matcher, Minimiser};
use localize::random::standard_normal;
use localize::sample::LinePoint;
use localize::synthetic::drive::{
    SyntheticDrive, SyntheticDriveConfig, SyntheticSample, random_pose, simulate_line_points,
};
use localize::{DistanceField, Field, LocalizeConfig, Localizer, Pose};
use nalgebra::{Matrix3, Vector3};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

fn field() -> Field {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/fields");
    Field::load(&folder.join("msl_18x12.toml")).expect("a field")
}

/// Random poses with their line points and a compass heading of 10° noise.
fn observations(field: &Field) -> Vec<(Pose, Vec<LinePoint>, HeadingPrior)> {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    (0..64)
        .map(|_| {
            let pose = random_pose(field, &mut rng);
            let points =
                simulate_line_points(field, &SyntheticDriveConfig::default(), pose, &mut rng);
            let std = 10.0_f32.to_radians();
            let heading = pose.theta + std * standard_normal(&mut rng);
            (pose, points, HeadingPrior { heading, std })
        })
        .collect()
}

fn tracking(criterion: &mut Criterion) {
    let field = field();
    let config = LocalizeConfig::default();
    let distances = DistanceField::new(&field, &config.distance_field);
    let views = observations(&field);
    let near = |pose: Pose| Pose::new(pose.x + 0.02, pose.y - 0.02, pose.theta + 0.01);
    for (name, minimiser, steps_max) in [
        ("match_newton", Minimiser::GaussNewton, 20),
        ("match_rprop", Minimiser::Rprop, 60),
    ] {
        let mut matcher = Matcher::new(MatchConfig {
            minimiser,
            steps_max,
            ..config.matching.clone()
        });
        let mut k = 0;
        criterion.bench_function(name, |bencher| {
            bencher.iter(|| {
                k = (k + 1) % views.len();
                let (pose, points, _) = &views[k];
                black_box(matcher.refine(&distances, points, near(*pose), 0.05))
            });
        });
    }
    let drive = SyntheticDrive::new(
        &field,
        SyntheticDriveConfig::default(),
        ChaCha8Rng::seed_from_u64(2),
    );
    let frames: Vec<SyntheticSample> = drive.take(900).collect();
    let mut warm_localizer = Localizer::new(&field, config);
    for frame in &frames[..600] {
        warm_localizer.add_odometry(&frame.odometry);
        warm_localizer.add_compass(&frame.compass);
        warm_localizer.process_points(frame.stamp, &frame.points);
    }
    criterion.bench_function("track_300_frames", |bencher| {
        bencher.iter_batched_ref(
            || warm_localizer.clone(),
            |localizer| {
                for frame in &frames[600..] {
                    localizer.add_odometry(&frame.odometry);
                    localizer.add_compass(&frame.compass);
                    black_box(localizer.process_points(frame.stamp, &frame.points));
                }
            },
            BatchSize::LargeInput,
        );
    });
}

fn global_localization(criterion: &mut Criterion) {
    let field = field();
    let config = LocalizeConfig::default();
    let distances = DistanceField::new(&field, &config.distance_field);
    let views = observations(&field);
    let mut search = BranchAndBound::new(&field, &distances, config.branch_and_bound.clone());
    let mut matcher = Matcher::new(config.matching.clone());
    let mut k = 0;
    let mut next = || {
        k = (k + 1) % views.len();
        &views[k]
    };
    criterion.bench_function("exact_without_prior", |bencher| {
        bencher.iter(|| search.find_hypotheses(&distances, &mut matcher, &next().1, None));
    });
    criterion.bench_function("exact_with_compass", |bencher| {
        bencher.iter(|| {
            let (_, points, prior) = next();
            search.find_hypotheses(&distances, &mut matcher, points, Some(*prior))
        });
    });
    let map = ScanMap::new(&field, &distances, ScanMapConfig::default());
    criterion.bench_function("scan_map_global", |bencher| {
        bencher.iter(|| {
            let (pose, points, _) = next();
            map.find_poses(points, pose.theta, 6, 0.4)
        });
    });
    criterion.bench_function("scan_map_local", |bencher| {
        bencher.iter(|| {
            let (pose, points, _) = next();
            map.find_pose_near(points, *pose)
        });
    });
    let mut hough = Hough::new(&field, HoughConfig::default());
    criterion.bench_function("hough", |bencher| {
        bencher.iter(|| {
            let (_, points, prior) = next();
            hough.find_poses(points, Some(*prior))
        });
    });
    let mut particles = MonteCarlo::new(&field, &distances, MonteCarloConfig::default());
    criterion.bench_function("monte_carlo_cycle_of_600", |bencher| {
        bencher.iter(|| {
            let (_, points, prior) = next();
            particles.predict([0.05, 0.0, 0.01]);
            particles.update(points, Some(*prior))
        });
    });
}

/// The filter's computation per image: three readings of wheels and inertial unit each, and one pose update.
fn bench_filter(criterion: &mut Criterion) {
    let config = FilterConfig::default();
    let covariance = Matrix3::from_diagonal(&Vector3::new(1e-4, 1e-4, 1e-5));
    let pose = Pose::new(1.0, 2.0, 0.5);
    let mut filter = PoseFilter::new(pose, &covariance, None, &config, &OdometryPrior::default());
    let span = PredictionInput {
        dt: 0.01,
        imu: Some(ImuInterval {
            specific_force: [0.1, -0.1],
            mean_angular_velocity: [0.0, 0.0, 0.2],
            final_yaw_rate: 0.2,
            vibration_std: 0.15,
            sample_period: 0.01,
        }),
        ..PredictionInput::default()
    };
    let increment = WheelIncrement {
        motion: [0.015, 0.001, 0.002],
        dt: 0.01,
        slip: 0.0,
        imu_active: true,
    };
    criterion.bench_function("predict_and_update_a_frame", |bencher| {
        bencher.iter(|| {
            for _ in 0..3 {
                filter.predict(&span, &config);
                filter.update_wheels(&increment, &config);
            }
            let pose = filter.pose();
            filter.update_pose(pose, &covariance, &config);
            black_box(filter.pose())
        });
    });
}

criterion_group!(benches, tracking, global_localization, bench_filter);
criterion_main!(benches);
