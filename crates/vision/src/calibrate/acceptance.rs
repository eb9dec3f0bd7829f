//! Is a map from field lines good enough to be used? By the share of points on markings, and by maps of two halves of the images.

use crate::calibrate::lines::{IMAGES_MIN, LinesCalibration};
use crate::calibrate::{CalibrationError, Disagreement};

/// Below this share of the points on the field on markings, or above this disagreement of halves (metres), other fields
/// are tried.
const DOUBTFUL_SHARE: f64 = 0.92;
const DOUBTFUL_DISAGREEMENT: f32 = 0.03;

/// Another field is better if its odds of a point on a marking exceed those of the given one this many times.
pub(super) const BETTER_FIELD_ODDS: f64 = 1.5;

/// Smallest accepted share of the points on the field that lie on markings.
const SHARE_MIN: f64 = 0.7;

/// The same on a field whose sizes were found by the images.
pub(super) const FOUND_SIZES_SHARE_MIN: f64 = 0.9;

/// The same for images that are too few for a comparison of halves.
const SHARE_MIN_UNCHECKED: f64 = 0.85;

/// Largest accepted disagreement of the halves up to 3 m, metres.
const DISAGREEMENT_MAX: f32 = 0.06;

/// Line points that reach less far leave most of what a robot looks at unchecked, metres.
const REACH_WANTED: f64 = 3.0;

/// True if another field may explain the images better.
pub(super) fn is_doubtful(found: &LinesCalibration) -> bool {
    let apart = found.disagreement.map_or(0.0, |apart| apart.near);
    found.on_field_share < DOUBTFUL_SHARE || apart > DOUBTFUL_DISAGREEMENT
}

/// What is doubtful about a map that is accepted: maps of real robots that are right explain 93 % and more. None if nothing is.
pub fn doubt(found: &LinesCalibration) -> Option<String> {
    let share = 100.0 * found.on_field_share;
    let (used, needed) = (found.used_count(), 2 * IMAGES_MIN);
    if used < needed {
        return Some(format!(
            "nothing checks the map: {used} images were used, and maps of two halves are compared from {needed} on. A field \
             file that is wrong by half a metre or the map of another robot may fit so few images. {share:.0} % of the line \
             points on the field lie on markings"
        ));
    }
    if let Some(edit) = &found.better_size {
        return Some(format!(
            "the images fit the field better with {edit}. A map bends to a wrong size: measure it, and calibrate again"
        ));
    }
    if found.reach < REACH_WANTED {
        return Some(format!(
            "the line points reach only {:.1} m (95 % are nearer): farther out nothing checks the map, and objects may be metres off \
             there. More pixels, a sharper image or more light show lines farther away",
            found.reach
        ));
    }
    let halves = found.disagreement.map_or_else(String::new, |apart| {
        let centimetres = 100.0 * apart.near;
        format!(", and halves of the images differ by {centimetres:.1} cm up to 3 m")
    });
    is_doubtful(found).then(|| {
        format!(
            "the map is doubtful: {share:.0} % of the line points on the field lie on markings{halves}. Are all images of one \
             camera and turned alike, and are the sizes in the field file right (`mirrorball doctor --recording` tries others)?"
        )
    })
}

/// Odds that a point lies on a marking.
pub(super) fn odds(share: f64) -> f64 {
    share / (1.0 - share).max(1e-3)
}

/// Refuses images of another field.
pub(super) fn ensure_field_explains(found: &LinesCalibration) -> Result<(), CalibrationError> {
    let share = found.on_field_share;
    let share_min = match found.disagreement {
        Some(_) => SHARE_MIN,
        None => SHARE_MIN_UNCHECKED,
    };
    if share >= share_min {
        return Ok(());
    }
    Err(unexplained(found))
}

/// The images show another field.
pub(super) fn unexplained(found: &LinesCalibration) -> CalibrationError {
    CalibrationError::WrongField {
        share_percent: (100.0 * found.on_field_share) as u32,
        hint: "Check the sizes in the field file; if they are right, take more images, with the centre circle and corners \
               in view"
            .into(),
        is_known: false,
    }
}

/// Refuses a map by which most images show too few line points, if those that are left are too few for a comparison of
/// halves: the map of another mirror bends to a few images without any error.
pub(super) fn ensure_most_images_count(
    used: usize,
    given: usize,
    disagreement: Option<Disagreement>,
) -> Result<(), CalibrationError> {
    if disagreement.is_some() || 2 * used >= given {
        return Ok(());
    }
    Err(CalibrationError::Undecided(format!(
        "only {used} of {given} images show enough line points by this map, too few to check it. The initial map may be of \
         another mirror: try --from-nothing"
    )))
}

/// Refuses images whose halves give different maps.
pub(super) fn ensure_halves_agree(
    disagreement: Option<Disagreement>,
) -> Result<(), CalibrationError> {
    match disagreement {
        Some(apart) if apart.near > DISAGREEMENT_MAX => Err(CalibrationError::Undecided(format!(
            "the maps of two halves of the images differ by {:.0} cm up to 3 m. Take more images of one camera all over the \
             field, with the centre circle and corners in view",
            100.0 * apart.near
        ))),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::ImageResidual;
    use crate::optics::ground_map::GroundMap;

    /// A calibration that explains everything, of some images.
    fn calibration(used: usize, disagreement: Option<Disagreement>) -> LinesCalibration {
        let image = ImageResidual {
            name: "000.jpg".into(),
            points: 100,
            rms_px: 0.5,
            left_out: None,
        };
        LinesCalibration {
            map: GroundMap {
                width_px: 1,
                height_px: 1,
                x: vec![1.0],
                y: vec![0.0],
            },
            images: vec![image; used],
            poses: vec![None; used],
            rms: 0.01,
            reach: 6.0,
            inlier_share: 0.99,
            on_field_share: 0.99,
            disagreement,
            better_size: None,
            costs: vec![0.1; used],
        }
    }

    #[test]
    fn map_of_few_images_is_called_unchecked_however_well_it_fits() {
        let warning = doubt(&calibration(5, None)).expect("a warning");
        assert!(warning.contains("5 images"), "{warning}");
        let agree = Disagreement {
            near: 0.004,
            far: 0.01,
        };
        assert_eq!(doubt(&calibration(8, Some(agree))), None);
        let short = LinesCalibration {
            reach: 2.3,
            ..calibration(8, Some(agree))
        };
        let warning = doubt(&short).expect("a warning");
        assert!(warning.contains("2.3 m"), "{warning}");
        let sized = LinesCalibration {
            better_size: Some("length = 14.00 (now 13.50)".into()),
            ..calibration(8, Some(agree))
        };
        let warning = doubt(&sized).expect("a warning");
        assert!(warning.contains("length = 14.00"), "{warning}");
        let apart = Disagreement {
            near: 0.04,
            ..agree
        };
        let warning = doubt(&calibration(8, Some(apart))).expect("a warning");
        assert!(warning.contains("4.0 cm"), "{warning}");
    }

    #[test]
    fn few_images_of_many_are_accepted_only_if_their_halves_were_compared() {
        let compared = Some(Disagreement {
            near: 0.01,
            far: 0.02,
        });
        assert!(ensure_most_images_count(6, 37, None).is_err());
        assert!(ensure_most_images_count(8, 37, compared).is_ok());
        assert!(ensure_most_images_count(5, 5, None).is_ok());
    }
}
