//! Which images contradict those before and after them, although these agree? Files with swapped names, or of another camera.

use std::collections::BTreeMap;
use std::path::PathBuf;

use localize::Stamp;
use localize::estimate::{Estimate, Mode, Reason};

/// Fewer such images may be chance.
const FOUND_MIN: usize = 2;

/// Finds the images of a run that show another place than the images around them.
#[derive(Debug, Clone, Default)]
pub(crate) struct MisplacedImages {
    images: usize,
    found: Vec<Stamp>,
    /// Images since the last matched one whose points contradict the pose. None if the pose was not tracked there.
    suspects: Option<Vec<Stamp>>,
}

impl MisplacedImages {
    /// Adds the next image of the run.
    ///
    /// Only when a later image matches the pose that the motion predicts are those between known to be wrong: after a kidnapping
    /// or a collision none does.
    pub(crate) fn add(&mut self, estimate: &Estimate) {
        self.images += 1;
        let is_tracked = estimate.mode == Mode::Tracking;
        match (&mut self.suspects, estimate.reason) {
            (suspects, _) if is_tracked && !estimate.is_predicted() => {
                let between = suspects.replace(Vec::new());
                self.found.extend(between.unwrap_or_default());
            }
            (Some(suspects), Some(Reason::PoorMatch | Reason::BetterAlternative)) if is_tracked => {
                suspects.push(estimate.stamp);
            }
            (suspects, _) => *suspects = None,
        }
    }

    /// The warning, if there are such images; `files`: of the images. Two files change places; a single image contradicts wrong
    /// wheels, too.
    pub(crate) fn warning(&self, files: &BTreeMap<Stamp, PathBuf>) -> Option<String> {
        if self.found.len() < FOUND_MIN {
            return None;
        }
        let (first, last) = (self.found.first()?, self.found.last()?);
        let file = files.get(first).map_or_else(String::new, |file| {
            format!(", the first is {}", file.display())
        });
        Some(format!(
            "{} of {} images contradict the images before and after them, which agree (from {:.3} to {:.3} s{file}): images of \
             another time, place or camera? Check the files that frames.csv names",
            self.found.len(),
            self.images,
            first.seconds(),
            last.seconds()
        ))
    }
}

#[cfg(test)]
mod tests {
    use localize::Pose;
    use nalgebra::Matrix3;

    use super::*;

    /// The warning after images that match (m), contradict the pose (c), have few points (f) or no pose (l).
    fn warning(images: &str) -> Option<String> {
        let mut misplaced = MisplacedImages::default();
        for (number, image) in images.chars().enumerate() {
            let stamp = Stamp::from_seconds(0.1 * number as f64);
            let tracked = Estimate::tracked(stamp, Pose::new(0.0, 0.0, 0.0), Matrix3::identity());
            let predicted = |reason| Estimate {
                inlier_share: 0.0,
                reason: Some(reason),
                ..tracked.clone()
            };
            misplaced.add(&match image {
                'm' => tracked,
                'c' => predicted(Reason::PoorMatch),
                'f' => predicted(Reason::FewPoints),
                _ => Estimate::lost(stamp, Matrix3::identity()),
            });
        }
        let files = [(Stamp::from_seconds(0.2), PathBuf::from("frames/2.png"))];
        misplaced.warning(&files.into())
    }

    #[test]
    fn images_between_agreeing_ones_are_named_with_count_times_and_file() {
        let text = warning("mmccmmcm").expect("a warning");
        assert!(text.starts_with("3 of 8 images contradict"), "{text}");
        assert!(
            text.contains("(from 0.200 to 0.600 s, the first is frames/2.png)"),
            "{text}"
        );
    }

    #[test]
    fn kidnapped_robots_covered_views_and_starts_are_not_taken_for_wrong_files() {
        for images in ["mmmm", "mmccllmm", "mmcc", "mfffm", "ccmm", "mmcfcmm"] {
            assert_eq!(warning(images), None, "{images}");
        }
    }
}
