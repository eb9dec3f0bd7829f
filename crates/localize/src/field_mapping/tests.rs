use super::*;
use crate::field::Field;
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
