//! Which images of a run cannot be used, and why? However many images have one problem, it is one sentence.

use std::path::{Path, PathBuf};

use localize::Stamp;
use serde::Serialize;

use crate::cycle::Cycle;

/// The images of a run that cannot be used, by their problems.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct ImageFaults {
    /// Images of the run, good ones included.
    pub images: usize,
    /// The problems in the order in which they came up.
    pub problems: Vec<ImageProblem>,
}

/// What is wrong with several images.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ImageProblem {
    /// Number of images with it.
    pub images: usize,
    /// Stamp of the first image with it, seconds.
    pub first_s: f64,
    /// Stamp of the last one, seconds.
    pub last_s: f64,
    /// File of the first one. None in a log.
    pub first_file: Option<PathBuf>,
    /// Why the first one cannot be used.
    pub reason: String,
    /// What the reasons of these images have in common.
    #[serde(skip)]
    problem: String,
}

impl ImageFaults {
    /// Adds the image of a cycle.
    pub fn add_cycle(&mut self, cycle: &Cycle, file: Option<&Path>) {
        self.add_image(cycle.stamp, file, cycle.image_fault.as_deref());
    }

    /// Adds an image; `fault`: why it cannot be used.
    pub(crate) fn add_image(&mut self, stamp: Stamp, file: Option<&Path>, fault: Option<&str>) {
        self.images += 1;
        let Some(reason) = fault else { return };
        let problem = problem_of(reason, file);
        let last_s = stamp.seconds();
        let mut known = self.problems.iter_mut();
        match known.find(|known| known.problem == problem) {
            Some(known) => {
                known.images += 1;
                known.last_s = last_s;
            }
            None => self.problems.push(ImageProblem {
                images: 1,
                first_s: last_s,
                last_s,
                first_file: file.map(Path::to_owned),
                reason: reason.to_owned(),
                problem,
            }),
        }
    }

    /// One sentence for each problem.
    pub fn sentences(&self) -> impl Iterator<Item = String> {
        self.problems
            .iter()
            .map(|problem| problem.sentence(self.images))
    }
}

impl ImageProblem {
    fn sentence(&self, all: usize) -> String {
        let (count, reason) = (self.images, &self.reason);
        let file = self.first_file.as_ref();
        // The reason may name the file.
        let file = file
            .map(|file| file.display().to_string())
            .filter(|file| !reason.contains(file));
        let place = if count == 1 {
            let file = file.map_or_else(String::new, |file| format!(" ({file})"));
            format!("at {:.3} s{file}", self.first_s)
        } else {
            let file = file.map_or_else(String::new, |file| format!(", the first is {file}"));
            format!("from {:.3} to {:.3} s{file}", self.first_s, self.last_s)
        };
        format!("{count} of {all} images cannot be used, {place}: {reason}")
    }
}

/// The part of a reason that is the same for all images with its problem: reasons read `PROBLEM: VALUE`.
fn problem_of(reason: &str, file: Option<&Path>) -> String {
    let without_file = match file {
        Some(file) => reason.replace(&*file.to_string_lossy(), ""),
        None => reason.to_owned(),
    };
    let (problem, _) = without_file.split_once(':').unwrap_or((&without_file, ""));
    problem.to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_with_one_problem_are_one_sentence_with_count_times_and_first_file() {
        let mut faults = ImageFaults::default();
        for number in 0..20 {
            let file = PathBuf::from(format!("frames/{number:06}.png"));
            let fault = match number {
                4 => Some("the image is white (overexposed)".to_owned()),
                5..8 => Some(format!("cannot read image {}: end of file", file.display())),
                10.. => Some(format!("the image is incomplete: rows {number} to 300")),
                _ => None,
            };
            let stamp = Stamp::from_seconds(0.1 * f64::from(number));
            faults.add_image(stamp, Some(&file), fault.as_deref());
        }
        let sentences: Vec<String> = faults.sentences().collect();
        assert_eq!(
            sentences,
            [
                "1 of 20 images cannot be used, at 0.400 s (frames/000004.png): the image is white (overexposed)",
                "3 of 20 images cannot be used, from 0.500 to 0.700 s: cannot read image frames/000005.png: end of file",
                "10 of 20 images cannot be used, from 1.000 to 1.900 s, the first is frames/000010.png: the image is \
                 incomplete: rows 10 to 300",
            ]
        );
    }
}
