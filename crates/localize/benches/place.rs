//! What does finding the place cost? Medians per frame on an 18 × 12 m field, about 113 points within 5 m.

use std::hint::black_box;

use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use localize::drive::{Drive, DriveConfig, DriveFrame, anywhere, normal, see};
use localize::filter::{Belief, Felt, FilterConfig, Span, Way};
use localize::matching::{MatchConfig, Matcher, Minimiser};
use localize::relocalise::hough::{Hough, HoughConfig};
use localize::relocalise::monte_carlo::{MonteCarlo, MonteCarloConfig};
use localize::relocalise::scan_map::{ScanMap, ScanMapConfig};
use localize::sample::LinePoint;
use localize::search::{HeadingPrior, Search};
use localize::{DistanceField, Field, LocalizeConfig, Localizer, Pose};
use nalgebra::{Matrix3, Vector3};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

fn field() -> Field {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/fields");
    Field::load(&folder.join("msl_18x12.toml")).expect("a field")
}

/// Random poses with what is seen from them and a compass of 10° noise.
fn sights(field: &Field) -> Vec<(Pose, Vec<LinePoint>, HeadingPrior)> {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    (0..64)
        .map(|_| {
            let pose = anywhere(field, &mut rng);
            let points = see(field, &DriveConfig::default(), pose, &mut rng);
            let std = 10.0_f32.to_radians();
            let heading = pose.theta + std * normal(&mut rng);
            (pose, points, HeadingPrior { heading, std })
        })
        .collect()
}

fn tracking(criterion: &mut Criterion) {
    let field = field();
    let config = LocalizeConfig::default();
    let distances = DistanceField::new(&field, &config.distance);
    let sights = sights(&field);
    let near = |pose: Pose| Pose::new(pose.x + 0.02, pose.y - 0.02, pose.theta + 0.01);
    for (name, minimiser, steps_max) in [
        ("match_newton", Minimiser::Newton, 20),
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
                k = (k + 1) % sights.len();
                let (pose, points, _) = &sights[k];
                black_box(matcher.refine(&distances, points, near(*pose), 0.05))
            });
        });
    }
    let drive = Drive::new(&field, DriveConfig::default(), ChaCha8Rng::seed_from_u64(2));
    let frames: Vec<DriveFrame> = drive.take(900).collect();
    let mut begun = Localizer::new(&field, config);
    for frame in &frames[..600] {
        begun.odometry(&frame.odometry);
        begun.compass(&frame.compass);
        begun.see(frame.stamp, &frame.points);
    }
    criterion.bench_function("track_300_frames", |bencher| {
        bencher.iter_batched_ref(
            || begun.clone(),
            |localizer| {
                for frame in &frames[600..] {
                    localizer.odometry(&frame.odometry);
                    localizer.compass(&frame.compass);
                    black_box(localizer.see(frame.stamp, &frame.points));
                }
            },
            BatchSize::LargeInput,
        );
    });
}

fn relocalising(criterion: &mut Criterion) {
    let field = field();
    let config = LocalizeConfig::default();
    let distances = DistanceField::new(&field, &config.distance);
    let sights = sights(&field);
    let mut search = Search::new(&field, &distances, config.search.clone());
    let mut matcher = Matcher::new(config.matching.clone());
    let mut k = 0;
    let mut next = || {
        k = (k + 1) % sights.len();
        &sights[k]
    };
    criterion.bench_function("exact_without_prior", |bencher| {
        bencher.iter(|| search.find(&distances, &mut matcher, &next().1, None));
    });
    criterion.bench_function("exact_with_compass", |bencher| {
        bencher.iter(|| {
            let (_, points, prior) = next();
            search.find(&distances, &mut matcher, points, Some(*prior))
        });
    });
    let map = ScanMap::new(&field, &distances, ScanMapConfig::default());
    criterion.bench_function("scan_map_global", |bencher| {
        bencher.iter(|| {
            let (pose, points, _) = next();
            map.find(points, pose.theta, 6, 0.4)
        });
    });
    criterion.bench_function("scan_map_local", |bencher| {
        bencher.iter(|| {
            let (pose, points, _) = next();
            map.find_near(points, *pose)
        });
    });
    let mut hough = Hough::new(&field, HoughConfig::default());
    criterion.bench_function("hough", |bencher| {
        bencher.iter(|| {
            let (_, points, prior) = next();
            hough.find(points, Some(*prior))
        });
    });
    let mut particles = MonteCarlo::new(&field, &distances, MonteCarloConfig::default());
    criterion.bench_function("monte_carlo_cycle_of_600", |bencher| {
        bencher.iter(|| {
            let (_, points, prior) = next();
            particles.moved([0.05, 0.0, 0.01]);
            particles.cycle(points, Some(*prior))
        });
    });
}

/// A frame's share of the filter: three readings of wheels and inertial unit each, and the update by a sight.
fn fusing(criterion: &mut Criterion) {
    let config = FilterConfig::default();
    let covariance = Matrix3::from_diagonal(&Vector3::new(1e-4, 1e-4, 1e-5));
    let mut belief = Belief::new(Pose::new(1.0, 2.0, 0.5), &covariance, None, &config);
    let span = Span {
        seconds: 0.01,
        felt: Some(Felt {
            force: [0.1, -0.1],
            rate: [0.0, 0.0, 0.2],
            spin: 0.2,
            rattle: 0.15,
            interval: 0.01,
        }),
        ..Span::default()
    };
    let way = Way {
        motion: [0.015, 0.001, 0.002],
        seconds: 0.01,
        slip: 0.0,
        watched: true,
    };
    criterion.bench_function("predict_and_update_a_frame", |bencher| {
        bencher.iter(|| {
            for _ in 0..3 {
                belief.advance(&span, &config);
                belief.wheels(&way, &config);
            }
            let pose = belief.pose();
            belief.correct(pose, &covariance, &config);
            black_box(belief.pose())
        });
    });
}

criterion_group!(place, tracking, relocalising, fusing);
criterion_main!(place);
