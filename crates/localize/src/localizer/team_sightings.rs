//! Sightings between team-mates correct a pose that the field's markings determine badly (docs/methods.md 12.5).
//!
//! A mate saw a robot that may be this one, or this robot saw one that may be the mate. A sighting is used if one pair of
//! robots explains it, and no other does.

use nalgebra::{Matrix2, Matrix2x3, Vector2};

use super::Localizer;
use super::cooperative_config::CooperativeConfig;
use super::own_motion::OwnMotion;
use super::state::{PoseTrack, State};
use crate::filter::{ERRORS_PER_MATE, FilterConfig, MateMeasurement, PoseFilter};
use crate::frames::{At, FieldFrame, RobotFrame};
use crate::stamp::Stamp;

/// Who saw whom.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SightingDirection {
    /// The mate saw this robot.
    ByMate,
    /// This robot saw the mate.
    OfMate,
}

/// A robot seen by one side that may be the other side: one point in both frames.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SightingPair {
    /// The point relative to this robot: its own place, or a robot that it saw. Metres.
    pub from_robot: At<RobotFrame>,
    /// The point by the mate: a robot that it saw, or its own place. Metres.
    pub on_field: At<FieldFrame>,
    /// Covariance of the difference but for this robot's pose: xx, xy, yy on the field, m².
    pub covariance: [f32; 3],
}

/// A robot that may have been taken for one of a pair.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SightingRival {
    /// Index of the pair.
    pub pair: usize,
    /// The point if it is the other robot.
    pub explanation: SightingPair,
}

/// What one message of a mate says about this robot's pose.
#[derive(Debug, Clone, PartialEq)]
pub struct TeamSighting {
    /// Number of the mate.
    pub robot: u32,
    /// Who saw whom.
    pub direction: SightingDirection,
    /// Time to which `from_robot` of all points refers.
    pub stamp: Stamp,
    /// Variances of the mate's position on the field: x, y, m². They are part of each pair's covariance.
    pub mate_variance: [f32; 2],
    /// Each of the robots that may have been seen.
    pub pairs: Vec<SightingPair>,
    /// Other robots that may have been seen instead.
    pub rivals: Vec<SightingRival>,
}

/// What became of a sighting.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SightingOutcome {
    /// It corrected the pose.
    Used,
    /// There is no pose whose half of the field is known, or another pose is probable.
    NoPose,
    /// The pose is too uncertain to tell robots apart.
    TooUncertain,
    /// No robot was seen where it had to be.
    NotSeen,
    /// The same, for so long and by so many mates that the pose now counts as less certain.
    PoseDoubted,
    /// The mate contradicted another one lately.
    Distrusted,
    /// It may have been another robot.
    Ambiguous,
    /// It is too old, or of the future.
    Late,
    /// The filter knows no more mates, or none at all.
    TooManyMates,
}

/// Standard deviation of a sighting's error that does not last, metres.
const NOISE_STD: f32 = 0.02;
/// Largest squared Mahalanobis distance of a robot that may be this one although the pose excludes it. Dead reckoning
/// errs by this much if its noise is stated too small; a larger distance is that of another robot.
const DOUBT_GATE: f32 = 36.0;
/// Largest error that is assumed of a doubted pose, and standard deviation beyond which it is doubtful already, over
/// `own_std_max`.
const DOUBT_SHARE: f32 = 0.7;
/// Way over which an error of the heading becomes one of the position, metres.
const TYPICAL_RANGE: f32 = 3.0;

impl Localizer {
    /// Corrects the pose at the last image by sightings of team-mates, and returns what became of each.
    ///
    /// The state at the last image is corrected, and the later samples are applied to it again.
    pub fn apply_team_sightings(
        &mut self,
        sightings: &[TeamSighting],
        config: &CooperativeConfig,
    ) -> Vec<SightingOutcome> {
        if sightings.is_empty() {
            return Vec::new();
        }
        let Some(mut snapshot) = self.snapshot.take() else {
            return vec![SightingOutcome::NoPose; sightings.len()];
        };
        let filter_config = &self.config.filter;
        let half_known = |state: &State| state.track().is_some_and(|track| self.half_known(track));
        let outcomes: Vec<SightingOutcome> = if half_known(&snapshot.state)
            && let State::Tracking(track) = &mut snapshot.state
        {
            let motion = &self.own_motion;
            sightings
                .iter()
                .map(|sighting| apply(track, motion, sighting, config, filter_config))
                .collect()
        } else {
            vec![SightingOutcome::NoPose; sightings.len()]
        };
        let changes = [SightingOutcome::Used, SightingOutcome::PoseDoubted];
        if outcomes.iter().any(|outcome| changes.contains(outcome)) {
            self.filter_stamp = snapshot.filter_stamp;
            self.motion_inputs = snapshot.motion_inputs.clone();
            self.state = snapshot.state.clone();
            let later = std::mem::take(&mut self.buffered);
            self.snapshot = Some(snapshot);
            for measurement in later {
                self.receive(measurement);
            }
        } else {
            if let (Some(track), Some(judged)) = (self.state.track_mut(), snapshot.state.track()) {
                track.mates.clone_from(&judged.mates);
            }
            self.snapshot = Some(snapshot);
        }
        outcomes
    }
}

/// Updates a tracked pose by a sighting.
fn apply(
    track: &mut PoseTrack,
    motion: &OwnMotion,
    sighting: &TeamSighting,
    config: &CooperativeConfig,
    filter_config: &FilterConfig,
) -> SightingOutcome {
    let (robot, stamp) = (sighting.robot, sighting.stamp);
    match associate(&mut track.filter, motion, sighting, config) {
        Ok(_) if !track.mates.is_believed(robot, stamp, config.doubt_after) => {
            SightingOutcome::Distrusted
        }
        Ok(measurement) => {
            track.filter.update_by_mate(&measurement, filter_config);
            SightingOutcome::Used
        }
        Err(Refusal::Elsewhere(distance))
            if track.mates.mark_refused(robot, stamp, config.doubt_after)
                && track.filter.position_std() < DOUBT_SHARE * config.own_std_max =>
        {
            // The distance is one standard deviation.
            let doubt = distance.min(DOUBT_SHARE * config.own_std_max);
            track.filter.doubt_pose(doubt, doubt / TYPICAL_RANGE);
            SightingOutcome::PoseDoubted
        }
        Err(Refusal::Elsewhere(_)) => SightingOutcome::NotSeen,
        Err(Refusal::Other(outcome)) => outcome,
    }
}

/// Why a sighting is not used.
enum Refusal {
    /// The nearest robot that was seen is this far from where it had to be, metres.
    Elsewhere(f32),
    Other(SightingOutcome),
}

/// The one pair that explains a sighting, as a measurement of the filter.
fn associate(
    filter: &mut PoseFilter,
    motion: &OwnMotion,
    sighting: &TeamSighting,
    config: &CooperativeConfig,
) -> Result<MateMeasurement, Refusal> {
    if filter.position_std() > config.own_std_max {
        return Err(Refusal::Other(SightingOutcome::TooUncertain));
    }
    let moved = motion
        .since(sighting.stamp)
        .ok_or(Refusal::Other(SightingOutcome::Late))?;
    let now_from_then = moved.inverse();
    // The robot's frame at the sighting, as seen from its frame at the last image.
    let explain =
        |pair: &SightingPair| Explanation::new(filter, now_from_then * pair.from_robot, pair);
    let all: Vec<Explanation> = sighting.pairs.iter().map(explain).collect();
    let best = all
        .iter()
        .enumerate()
        .min_by(|a, b| a.1.mahalanobis_squared.total_cmp(&b.1.mahalanobis_squared));
    let (index, best) = best.ok_or(Refusal::Other(SightingOutcome::NotSeen))?;
    // A robot too far away is another one, and of two near ones nobody knows which.
    let near = all
        .iter()
        .filter(|explanation| explanation.mahalanobis_squared <= DOUBT_GATE);
    let is_single = near.count() == 1;
    let elsewhere = || match is_single {
        true => Refusal::Elsewhere(best.residual.norm()),
        false => Refusal::Other(SightingOutcome::NotSeen),
    };
    if !(best.mahalanobis_squared <= config.gate) {
        return Err(elsewhere());
    }
    let limit = best.mahalanobis_squared + config.ambiguity_margin;
    let other_pair = all
        .iter()
        .enumerate()
        .any(|(other, explanation)| other != index && explanation.mahalanobis_squared < limit);
    let other_robot = sighting
        .rivals
        .iter()
        .filter(|rival| rival.pair == index)
        .any(|rival| explain(&rival.explanation).mahalanobis_squared < limit);
    if other_pair || other_robot {
        return Err(Refusal::Other(SightingOutcome::Ambiguous));
    }
    let measurement = best.measurement(sighting, &sighting.pairs[index].covariance);
    let innovation = filter
        .mate_innovation(&measurement, config.error_time)
        .ok_or(Refusal::Other(SightingOutcome::TooManyMates))?;
    let squared = mahalanobis_squared(&innovation.innovation, &innovation.covariance);
    if squared <= config.gate {
        Ok(measurement)
    } else {
        Err(elsewhere())
    }
}

/// How well does the own pose explain a pair?
struct Explanation {
    /// Measured minus predicted point on the field.
    residual: Vector2<f32>,
    /// Derivative of the predicted point by the own heading.
    by_heading: [f32; 2],
    mahalanobis_squared: f32,
}

impl Explanation {
    /// `from_robot`: the pair's point in the robot's frame at the last image.
    fn new(filter: &PoseFilter, from_robot: At<RobotFrame>, pair: &SightingPair) -> Self {
        let pose = filter.pose();
        let predicted = pose * from_robot;
        let by_heading = [pose.y - predicted.y, predicted.x - pose.x];
        let residual = Vector2::new(pair.on_field.x - predicted.x, pair.on_field.y - predicted.y);
        let jacobian = Matrix2x3::new(1.0, 0.0, by_heading[0], 0.0, 1.0, by_heading[1]);
        let [xx, xy, yy] = pair.covariance;
        let covariance = jacobian * filter.covariance() * jacobian.transpose()
            + Matrix2::new(xx, xy, xy, yy)
            + Matrix2::identity() * (NOISE_STD * NOISE_STD);
        Explanation {
            residual,
            by_heading,
            mahalanobis_squared: mahalanobis_squared(&residual, &covariance),
        }
    }

    fn measurement(&self, sighting: &TeamSighting, covariance: &[f32; 3]) -> MateMeasurement {
        MateMeasurement {
            robot: sighting.robot,
            residual: self.residual.into(),
            by_heading: self.by_heading,
            by_errors: errors_of(sighting, covariance),
            variance: NOISE_STD * NOISE_STD,
        }
    }
}

/// Derivative by the mate's errors: those of its position, which both directions share, and the rest of each direction.
fn errors_of(sighting: &TeamSighting, [xx, xy, yy]: &[f32; 3]) -> [[f32; ERRORS_PER_MATE]; 2] {
    let [pose_x, pose_y] = sighting.mate_variance.map(|variance| variance.max(0.0));
    let first = match sighting.direction {
        SightingDirection::ByMate => 2,
        SightingDirection::OfMate => 4,
    };
    // Lower triangle of the rest's square root.
    let x = (xx - pose_x).max(NOISE_STD * NOISE_STD).sqrt();
    let cross = xy / x;
    let y = (yy - pose_y - cross * cross)
        .max(NOISE_STD * NOISE_STD)
        .sqrt();
    let mut rows = [[0.0; ERRORS_PER_MATE]; 2];
    (rows[0][0], rows[1][1]) = (pose_x.sqrt(), pose_y.sqrt());
    rows[0][first] = x;
    (rows[1][first], rows[1][first + 1]) = (cross, y);
    rows
}

/// Infinite if the covariance is singular.
fn mahalanobis_squared(residual: &Vector2<f32>, covariance: &Matrix2<f32>) -> f32 {
    covariance.try_inverse().map_or(f32::INFINITY, |inverse| {
        residual.dot(&(inverse * residual)).abs()
    })
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix3;

    use super::*;
    use crate::config::LocalizeConfig;
    use crate::estimate::Estimate;
    use crate::field::Field;
    use crate::frames::Pose;
    use crate::sample::Odometry;

    const IMAGE: Stamp = Stamp(33_000_000);

    fn odometry(milliseconds: i64) -> Odometry {
        Odometry {
            stamp: Stamp(milliseconds * 1_000_000),
            dx: 0.02,
            dy: 0.0,
            dtheta: 0.0,
            slip: 0.0,
        }
    }

    /// A robot near (1, 2) that has seen nothing in its last image.
    fn localizer(std: f32) -> Localizer {
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("../../config/fields/msl_18x12.toml");
        let field = Field::load(&path).expect("the field");
        let mut localizer = Localizer::new(&field, LocalizeConfig::default());
        let covariance = Matrix3::from_diagonal(&[std * std, std * std, 0.001].into());
        localizer.set_pose(Stamp(0), Pose::new(1.0, 2.0, 0.0), &covariance);
        localizer.add_odometry(&odometry(20));
        localizer.process_points(IMAGE, &[]);
        localizer
    }

    /// A mate saw a robot here.
    fn seen_at(x: f32, y: f32) -> TeamSighting {
        TeamSighting {
            robot: 2,
            direction: SightingDirection::ByMate,
            stamp: IMAGE,
            mate_variance: [0.001; 2],
            pairs: vec![pair(x, y)],
            rivals: Vec::new(),
        }
    }

    fn pair(x: f32, y: f32) -> SightingPair {
        SightingPair {
            from_robot: At::new(0.0, 0.0),
            on_field: At::new(x, y),
            covariance: [0.005, 0.0, 0.005],
        }
    }

    /// One outcome, and the estimate of the next image.
    fn judge(localizer: &mut Localizer, sighting: TeamSighting) -> (SightingOutcome, Estimate) {
        let config = CooperativeConfig::default();
        let outcomes = localizer.apply_team_sightings(&[sighting], &config);
        localizer.add_odometry(&odometry(60));
        (
            outcomes[0],
            localizer.process_points(Stamp(66_000_000), &[]),
        )
    }

    #[test]
    fn sighting_moves_an_uncertain_pose_and_shrinks_its_covariance() {
        let mut before = localizer(0.2);
        let mut corrected = before.clone();
        let (_, alone) = judge(&mut before, seen_at(9.0, 9.0));
        let (outcome, estimate) = judge(&mut corrected, seen_at(1.3, 2.2));
        assert_eq!(outcome, SightingOutcome::Used);
        let moved = estimate
            .pose
            .expect("a pose")
            .difference(alone.pose.expect("a pose"));
        assert!(
            (0.15..0.3).contains(&moved.x) && (0.1..0.2).contains(&moved.y),
            "{moved}"
        );
        assert!(estimate.covariance[(0, 0)] < 0.3 * alone.covariance[(0, 0)]);
    }

    #[test]
    fn sighted_mate_corrects_the_heading_too() {
        let mut alone = localizer(0.05);
        let mut corrected = alone.clone();
        let sighting = TeamSighting {
            direction: SightingDirection::OfMate,
            pairs: vec![SightingPair {
                from_robot: At::new(5.0, 0.0),
                ..pair(6.0, 2.3)
            }],
            ..seen_at(0.0, 0.0)
        };
        let (outcome, estimate) = judge(&mut corrected, sighting);
        assert_eq!(outcome, SightingOutcome::Used);
        let (_, alone) = judge(&mut alone, seen_at(9.0, 9.0));
        assert!(estimate.pose.expect("a pose").theta > alone.pose.expect("a pose").theta + 0.01);
        assert!(estimate.covariance[(2, 2)] < alone.covariance[(2, 2)]);
    }

    #[test]
    fn sighting_that_another_robot_may_explain_is_refused() {
        let localizer = localizer(0.2);
        // The mate saw a second robot nearby.
        let mut sighting = seen_at(1.2, 2.0);
        sighting.pairs.push(pair(1.5, 2.1));
        let (outcome, _) = judge(&mut localizer.clone(), sighting);
        assert_eq!(outcome, SightingOutcome::Ambiguous);
        // This robot sees another one beside itself.
        let mut sighting = seen_at(1.2, 2.0);
        sighting.rivals.push(SightingRival {
            pair: 0,
            explanation: SightingPair {
                from_robot: At::new(0.5, 0.0),
                ..pair(1.2, 2.0)
            },
        });
        let (outcome, _) = judge(&mut localizer.clone(), sighting);
        assert_eq!(outcome, SightingOutcome::Ambiguous);
        let (outcome, _) = judge(&mut localizer.clone(), seen_at(-1.0, -2.0));
        assert_eq!(outcome, SightingOutcome::NotSeen);
        let late = TeamSighting {
            stamp: Stamp(-900_000_000),
            ..seen_at(1.2, 2.0)
        };
        assert_eq!(judge(&mut localizer.clone(), late).0, SightingOutcome::Late);
    }

    #[test]
    fn samples_after_the_image_are_applied_again() {
        let config = CooperativeConfig::default();
        let mut early = localizer(0.2);
        let mut late = early.clone();
        early.apply_team_sightings(&[seen_at(1.3, 2.2)], &config);
        early.add_odometry(&odometry(50));
        late.add_odometry(&odometry(50));
        late.apply_team_sightings(&[seen_at(1.3, 2.2)], &config);
        let next = Stamp(66_000_000);
        assert_eq!(
            early.process_points(next, &[]),
            late.process_points(next, &[])
        );
    }

    #[test]
    fn late_image_keeps_the_correction() {
        // The image at 45 ms arrives after the wheels of 60 ms.
        let config = CooperativeConfig::default();
        let mut localizer = localizer(0.2);
        let mut ordered = localizer.clone();
        localizer.add_odometry(&odometry(40));
        ordered.add_odometry(&odometry(40));
        localizer.add_odometry(&odometry(60));
        for one in [&mut localizer, &mut ordered] {
            one.apply_team_sightings(&[seen_at(1.3, 2.2)], &config);
        }
        let image = Stamp(45_000_000);
        let [rewound, ordered] = [&mut localizer, &mut ordered]
            .map(|one| one.process_points(image, &[]).pose.expect("a pose"));
        assert!(
            rewound.difference(ordered).norm() < 1e-3,
            "{rewound:?} {ordered:?}"
        );
    }

    #[test]
    fn pose_of_unknown_half_is_not_corrected() {
        let mut localizer = localizer(0.2);
        localizer.add_half_log_odds(-9.0);
        let (outcome, _) = judge(&mut localizer, seen_at(1.3, 2.2));
        assert_eq!(outcome, SightingOutcome::NoPose);
    }
}
