//! Tests of the world model on simulated detections of known scenes.

use nalgebra::Matrix3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::{ObjectObservation, TeamColour, WorldConfig, WorldModel, WorldObservation, WorldView};
use crate::estimate::Estimate;
use crate::filter::MotionEstimate;
use crate::frames::{At, FieldFrame, Pose, RobotFrame, Tf};
use crate::localizer::ImageMotion;
use crate::sample::Odometry;
use crate::stamp::Stamp;

const FRAME: f64 = 1.0 / 30.0;
const STD: f32 = 0.05;

fn estimate(stamp: Stamp, pose: Option<Pose>) -> Estimate {
    Estimate {
        pose,
        ..Estimate::tracked(
            stamp,
            Pose::new(0.0, 0.0, 0.0),
            Matrix3::from_diagonal_element(1e-4),
        )
    }
}

/// A robot that drives on a circle at 1.35 m/s and detects the given objects.
struct TrackingScene {
    model: WorldModel,
    rng: ChaCha8Rng,
    frame: i32,
}

impl TrackingScene {
    fn new(seed: u64) -> Self {
        let config = WorldConfig {
            tilt_std_deg: 0.0,
            ..WorldConfig::default()
        };
        TrackingScene {
            model: WorldModel::new(config, 0.8),
            rng: ChaCha8Rng::seed_from_u64(seed),
            frame: 0,
        }
    }

    fn pose(&self) -> Pose {
        let angle = self.frame as f32 * 0.03;
        Pose::new(1.5 * angle.cos(), 1.5 * angle.sin(), angle + 1.57)
    }

    fn noise(&mut self) -> f32 {
        // The sum of twelve uniform values is approximately normal.
        STD * ((0..12).map(|_| self.rng.random::<f32>()).sum::<f32>() - 6.0)
    }

    fn observe(&mut self, at: At<FieldFrame>) -> ObjectObservation {
        let at: At<RobotFrame> = self.pose().inverse() * at;
        ObjectObservation {
            at: At::new(at.x + self.noise(), at.y + self.noise()),
            covariance: [STD * STD, 0.0, STD * STD],
            score: 0.9,
            airborne: false,
            team: None,
            distance: None,
        }
    }

    fn stamp(&self) -> Stamp {
        Stamp::from_seconds(f64::from(self.frame) * FRAME)
    }

    /// Advances by one image; the estimate has a pose if `located`.
    fn step(
        &mut self,
        ball: Option<At<FieldFrame>>,
        robots: &[At<FieldFrame>],
        located: bool,
    ) -> WorldView {
        let before = self.pose();
        self.frame += 1;
        let moved = before.inverse() * self.pose();
        let stamp = self.stamp();
        self.model.add_odometry(&Odometry {
            stamp,
            dx: moved.x,
            dy: moved.y,
            dtheta: moved.theta,
            slip: 0.0,
        });
        let observation = WorldObservation {
            ball: ball.map(|at| self.observe(at)),
            robots: robots.iter().map(|at| self.observe(*at)).collect(),
        };
        let pose = located.then(|| self.pose());
        self.model
            .update(stamp, Some(&observation), &estimate(stamp, pose), None)
    }
}

fn ball_position(from: [f32; 2], speed: [f32; 2], seconds: f32) -> At<FieldFrame> {
    At::new(from[0] + speed[0] * seconds, from[1] + speed[1] * seconds)
}

#[test]
fn ball_state_on_field_has_consistent_covariance() {
    let (mut squared, mut count) = (0.0, 0.0);
    for seed in 0..20 {
        let mut scene = TrackingScene::new(seed);
        let speed = [1.0, -0.5];
        for step in 1..=60 {
            let ball = ball_position([-2.0, 1.0], speed, step as f32 * FRAME as f32);
            let world = scene.step(Some(ball), &[], true);
            if step > 30 {
                let found = world.ball.expect("a ball").on_field.expect("on the field");
                let off = nalgebra::Vector2::new(found.at.x - ball.x, found.at.y - ball.y);
                let information = found.covariance.fixed_view::<2, 2>(0, 0).try_inverse();
                squared += (off.transpose() * information.expect("regular") * off).x;
                count += 1.0;
                if step == 60 {
                    assert!(off.norm() < 0.1, "{off}");
                    let [vx, vy] = found.velocity;
                    assert!((vx - speed[0]).hypot(vy - speed[1]) < 0.5, "{vx} {vy}");
                }
            }
        }
    }
    // Two degrees of freedom. The covariance includes odometry errors, which are absent here, so that less is expected.
    let mean: f32 = squared / count;
    assert!((0.6..2.6).contains(&mean), "{mean}");
}

#[test]
fn occluded_ball_is_kept_and_removed_ball_is_dropped() {
    let ball = At::new(3.0, 0.0);
    for (hidden, kept) in [(true, true), (false, false)] {
        let mut scene = TrackingScene::new(1);
        let before = |scene: &TrackingScene| {
            let origin = scene.pose().origin();
            At::new((origin.x + ball.x) / 2.0, (origin.y + ball.y) / 2.0)
        };
        for _ in 0..15 {
            scene.step(Some(ball), &[], true);
        }
        let mut world = WorldView::default();
        for _ in 0..25 {
            let blocker = before(&scene);
            let robots: &[_] = if hidden { &[blocker] } else { &[] };
            world = scene.step(None, robots, true);
        }
        assert_eq!(world.ball.is_some(), kept, "hidden: {hidden}");
        if let Some(found) = world.ball.and_then(|ball| ball.on_field) {
            assert!(found.at.distance_to(ball) < 0.5, "{:?}", found.at);
            assert!(
                found.covariance[(0, 0)] > STD * STD,
                "variance below that of a detection: {}",
                found.covariance[(0, 0)]
            );
        }
    }
}

#[test]
fn kicked_ball_is_tracked_within_two_frames() {
    let mut scene = TrackingScene::new(2);
    for _ in 0..20 {
        scene.step(Some(At::new(2.0, 0.5)), &[], true);
    }
    let mut late = 0;
    for step in 1..=15 {
        let ball = ball_position([2.0, 0.5], [-8.0, 0.0], step as f32 * FRAME as f32);
        let world = scene.step(Some(ball), &[], true);
        let found = world.ball.expect("a ball").on_field.expect("on the field");
        late += i32::from(found.at.distance_to(ball) > 0.3);
        if step > 5 {
            assert!(
                (found.velocity[0] + 8.0).abs() < 2.0,
                "{:?}",
                found.velocity
            );
        }
    }
    assert!(late <= 2, "{late} frames");
}

#[test]
fn a_pass_is_known_within_five_frames_and_doubted_before() {
    let (mut squared, mut count) = (0.0, 0.0);
    for seed in 0..20 {
        let mut scene = TrackingScene::new(seed);
        for _ in 0..30 {
            scene.step(Some(At::new(2.0, 0.5)), &[], true);
        }
        for step in 1..=10 {
            let ball = ball_position([2.0, 0.5], [-3.0, 1.0], step as f32 * FRAME as f32);
            let world = scene.step(Some(ball), &[], true);
            let found = world.ball.expect("a ball").on_field.expect("on the field");
            let off = nalgebra::Vector2::new(found.velocity[0] + 3.0, found.velocity[1] - 1.0);
            let information = found.covariance.fixed_view::<2, 2>(2, 2).try_inverse();
            squared += (off.transpose() * information.expect("regular") * off).x;
            count += 1.0;
            assert!(step < 6 || off.norm() < 1.5, "{off} in image {step}");
        }
    }
    // Two degrees of freedom. In the first image nothing tells a kick from noise.
    let mean: f32 = squared / count;
    assert!(mean < 6.0, "{mean}");
}

#[test]
fn tracks_survive_a_lost_or_jumping_pose() {
    let mut scene = TrackingScene::new(3);
    let (ball, robot) = (At::new(1.0, 2.5), At::new(-1.0, -2.0));
    for _ in 0..20 {
        scene.step(Some(ball), &[robot], true);
    }
    for _ in 0..20 {
        let world = scene.step(None, &[], false);
        // Without detections the position is predicted by odometry alone.
        if let Some(found) = world.ball {
            assert_eq!(found.on_field, None);
            let wanted = scene.pose().inverse() * ball;
            assert!(found.at.distance_to(wanted) < 0.3);
        }
    }
    for _ in 0..4 {
        scene.step(Some(ball), &[robot], false);
    }
    let world = scene.step(Some(ball), &[robot], true);
    let found = world
        .robots
        .first()
        .expect("a robot")
        .on_field
        .expect("on the field");
    assert!(found.at.distance_to(robot) < 0.2);
    assert!(f32::hypot(found.velocity[0], found.velocity[1]) < 0.6);
}

#[test]
fn passing_robots_keep_their_ids() {
    let mut scene = TrackingScene::new(4);
    let mut ids = Vec::new();
    for step in 0..90 {
        let time = step as f32 * FRAME as f32;
        let a = ball_position([-1.5, 3.0], [1.0, 0.0], time);
        let b = ball_position([1.5, 3.7], [-1.0, 0.0], time);
        let world = scene.step(None, &[a, b], true);
        if step > 5 {
            assert_eq!(world.robots.len(), 2, "at {time} s");
            let near = |at: At<FieldFrame>| {
                world
                    .robots
                    .iter()
                    .find(|robot| robot.on_field.is_some_and(|on| on.at.distance_to(at) < 0.3))
                    .map(|robot| robot.id)
            };
            ids.push((near(a).expect("a"), near(b).expect("b")));
        }
    }
    assert!(ids.iter().all(|pair| *pair == ids[0]), "{ids:?}");
}

#[test]
fn place_taken_for_a_ball_in_a_quarter_of_the_images_is_none_and_a_ball_seen_in_most_is_one() {
    let reported = |seen: f32| {
        let mut scene = TrackingScene::new(9);
        let images = 900;
        let views = (0..images).map(|_| {
            let is_seen = scene.rng.random::<f32>() < seen;
            scene.step(is_seen.then_some(At::new(2.0, 1.0)), &[], true)
        });
        views.filter(|view| view.ball.is_some()).count() as f32 / images as f32
    };
    let (false_one, ball) = (reported(0.25), reported(0.85));
    assert!(false_one < 0.1, "{false_one}");
    assert!(ball > 0.97, "{ball}");
}

#[test]
fn single_false_alarm_and_non_finite_observations_give_no_object() {
    let mut scene = TrackingScene::new(5);
    assert_eq!(scene.step(Some(At::new(1.0, 1.0)), &[], true).ball, None);
    let mut model = WorldModel::new(WorldConfig::default(), 0.8);
    let nonsense = ObjectObservation {
        at: At::new(f32::NAN, 1.0),
        covariance: [f32::INFINITY, 0.0, 1.0],
        score: 1.0,
        airborne: true,
        team: Some(TeamColour::Cyan),
        distance: None,
    };
    let observation = WorldObservation {
        ball: Some(nonsense),
        robots: vec![nonsense; 3],
    };
    for frame in 0..10 {
        let stamp = Stamp::from_seconds(f64::from(frame) * FRAME);
        let world = model.update(stamp, Some(&observation), &estimate(stamp, None), None);
        assert_eq!(world, WorldView::default());
    }
}

#[test]
fn pose_differences_replace_missing_odometry() {
    let mut scene = TrackingScene::new(6);
    let robot = At::new(2.0, 2.0);
    let mut world = WorldView::default();
    for _ in 0..20 {
        scene.frame += 1;
        let stamp = scene.stamp();
        let observation = WorldObservation {
            ball: None,
            robots: vec![scene.observe(robot)],
        };
        let pose = scene.pose();
        world = scene.model.update(
            stamp,
            Some(&observation),
            &estimate(stamp, Some(pose)),
            None,
        );
    }
    let found = world.robots[0].on_field.expect("on the field");
    assert!(found.at.distance_to(robot) < 0.15);
    assert!(f32::hypot(found.velocity[0], found.velocity[1]) < 0.6);
}

#[test]
fn slipping_wheels_move_no_object_if_localization_knows_the_motion() {
    let mut scene = TrackingScene::new(7);
    let ball = At::new(0.5, 0.5);
    let mut world = WorldView::default();
    let covariance = Matrix3::from_diagonal_element(1e-6);
    for frame in 0..60 {
        let (before, from) = (scene.pose(), scene.stamp());
        scene.frame += 1;
        let moved = before.inverse() * scene.pose();
        let to = scene.stamp();
        // From the twentieth image on the wheels report three times the motion.
        let slip = if frame < 20 { 1.0 } else { 3.0 };
        scene.model.add_odometry(&Odometry {
            stamp: to,
            dx: slip * moved.x,
            dy: slip * moved.y,
            dtheta: slip * moved.theta,
            slip: 0.0,
        });
        let observation = WorldObservation {
            ball: Some(scene.observe(ball)),
            robots: Vec::new(),
        };
        let motion = ImageMotion {
            from,
            to,
            estimate: MotionEstimate {
                motion: moved,
                covariance,
            },
        };
        let pose = scene.pose();
        let estimate = estimate(to, Some(pose));
        world = (scene.model).update(to, Some(&observation), &estimate, Some(&motion));
        if frame > 25 {
            let found = world.ball.expect("a ball").on_field.expect("on the field");
            let speed = f32::hypot(found.velocity[0], found.velocity[1]);
            assert!(speed < 0.8, "{speed} m/s in image {frame}");
            assert!(found.at.distance_to(ball) < 0.15, "{:?}", found.at);
        }
    }
    // A motion that began at another image is not used: the wheels' is.
    let at = world.ball.expect("a ball").at;
    scene.frame += 1;
    let stamp = scene.stamp();
    let motion = ImageMotion {
        from: Stamp(1),
        to: stamp,
        estimate: MotionEstimate {
            motion: Tf::new(5.0, 0.0, 0.0),
            covariance,
        },
    };
    let estimate = estimate(stamp, Some(scene.pose()));
    let world = (scene.model).update(stamp, None, &estimate, Some(&motion));
    assert!(world.ball.expect("a ball").at.distance_to(at) < 0.5);
}
