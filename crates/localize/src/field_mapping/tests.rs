use super::*;
use crate::field::Field;
use crate::math;
use crate::sample::LinePoint;
use crate::synthetic::field_mapping::evaluate_mapping;
use crate::synthetic::rough_drive::RoughDriveConfig;

/// A floor that nobody painted for a league, without symmetry.
fn taped_hall() -> Field {
    let path = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../config/fields/drawn/taped_hall.toml"
    );
    Field::load(std::path::Path::new(path)).expect("a field")
}

fn slow_drive() -> RoughDriveConfig {
    let mut drive = RoughDriveConfig::blind_with_unequal_wheels();
    drive.blind = None;
    drive.dazzled_outlier_share = 0.0;
    drive.frame_rate = 15.0;
    drive.speed_max = [1.2, 1.0];
    drive
}

#[test]
fn a_taped_hall_is_mapped_with_unequal_wheels_within_3_cm() {
    // The robot of this drive stands upright, so that far points are as true as near ones.
    let config = FieldMappingConfig {
        tilt_std_deg: 0.0,
        ..FieldMappingConfig::default()
    };
    let score = evaluate_mapping(&taped_hall(), &slow_drive(), &config, 60.0, 1).expect("a map");
    assert!(score.marking_error < 0.03, "{score:?}");
    assert!(
        score.found_share > 0.9 && score.false_share < 0.1,
        "{score:?}"
    );
    assert!(
        score.position_error.is_some_and(|error| error < 0.06),
        "{score:?}"
    );
    assert!(score.tracked_share > 0.9, "{score:?}");
}

#[test]
fn a_robot_that_stands_or_sees_nothing_yields_a_reason() {
    let config = FieldMappingConfig::default();
    assert_eq!(
        map_field(&[], &config),
        Err(FieldMappingError::FewImages(0, 5))
    );
    let point = LinePoint {
        at: crate::frames::At::new(1.0, 0.5),
        std_radial: 0.03,
        std_tangential: 0.03,
    };
    let standing = vec![
        MappingImage {
            motion: [0.0; 3],
            points: vec![point; 10],
        };
        20
    ];
    assert_eq!(
        map_field(&standing, &config),
        Err(FieldMappingError::NoMotion)
    );
}

#[test]
fn points_that_are_no_numbers_are_left_out() {
    let mut images = Vec::new();
    for k in 0..40 {
        let x = -0.1 * k as f32;
        let at = |along: f32| crate::frames::At::new(x + along, 1.0);
        let mut points: Vec<LinePoint> = (0..40)
            .map(|i| LinePoint {
                at: at(0.1 * i as f32),
                std_radial: 0.03,
                std_tangential: 0.03,
            })
            .collect();
        points.push(LinePoint {
            at: crate::frames::At::new(f32::NAN, 1.0),
            std_radial: 0.03,
            std_tangential: 0.03,
        });
        images.push(MappingImage {
            motion: [0.1, 0.0, if k == 7 { f32::INFINITY } else { 0.0 }],
            points,
        });
    }
    let mapped = map_field(&images, &FieldMappingConfig::default()).expect("a map");
    let lengths = mapped.config.extra_lines.iter();
    assert!(
        lengths
            .map(|[x0, _, x1, _]| (x1 - x0).abs())
            .fold(0.0, f32::max)
            > 2.0
    );
}

/// A drive twice around a rectangle of 10 × 6 m past its border, which the robot sees 1.5 m far. Wheels make the motion longer
/// and turn the robot; everything else is exact.
fn two_rounds() -> Vec<MappingImage> {
    use crate::frames::{At, FieldFrame};
    let (length, width, inset, seen) = (10.0_f32, 6.0_f32, 0.8_f32, 1.5_f32);
    let corners = [
        [inset, inset],
        [length - inset, inset],
        [length - inset, width - inset],
        [inset, width - inset],
    ];
    let mut poses = Vec::new();
    for side in 0..8 {
        let (from, to) = (corners[side % 4], corners[(side + 1) % 4]);
        let theta = side as f32 * std::f32::consts::FRAC_PI_2;
        for k in 0..12 {
            poses.push(Pose::new(
                from[0],
                from[1],
                theta - std::f32::consts::FRAC_PI_2 * (1.0 - k as f32 / 12.0),
            ));
        }
        let steps = (math::hypot(to[0] - from[0], to[1] - from[1]) / 0.1) as usize;
        for k in 0..steps {
            let share = k as f32 / steps as f32;
            poses.push(Pose::new(
                from[0] + share * (to[0] - from[0]),
                from[1] + share * (to[1] - from[1]),
                theta,
            ));
        }
    }
    let mut painted: Vec<At<FieldFrame>> = Vec::new();
    for k in 0..=200 {
        let at = 0.05 * k as f32;
        painted.extend([At::new(at, 0.0), At::new(at, width)]);
        if at <= width {
            painted.extend([
                At::new(0.0, at),
                At::new(length, at),
                At::new(0.5 * length, at),
            ]);
        }
    }
    let mut previous = poses[0];
    let images = poses.into_iter().map(|pose| {
        let motion = previous.inverse() * pose;
        previous = pose;
        let robot_from_field = pose.inverse();
        let near = painted
            .iter()
            .filter(|at| at.distance_to(pose.origin()) < seen);
        MappingImage {
            motion: [
                1.02 * motion.x,
                motion.y,
                0.98 * motion.theta + 0.02 * motion.x,
            ],
            points: near
                .map(|&at| LinePoint {
                    at: robot_from_field * at,
                    std_radial: 0.01,
                    std_tangential: 0.01,
                })
                .collect(),
        }
    });
    images.collect()
}

#[test]
fn passes_of_a_drive_with_wrong_wheels_meet_on_one_copy_of_each_line() {
    let mapped = map_field(&two_rounds(), &FieldMappingConfig::default()).expect("a map");
    let lines = &mapped.config.extra_lines;
    // The middle of the halfway line is out of sight: six pieces.
    assert_eq!(lines.len(), 6, "{lines:?}");
    assert!(mapped.config.extra_arcs.is_empty() && mapped.copies == 0);
    let [length, width] = [mapped.config.length, mapped.config.width];
    assert!(
        (length - 10.0).abs() < 0.1 && (width - 6.0).abs() < 0.1,
        "{length} {width}"
    );
}
