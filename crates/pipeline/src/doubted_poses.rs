//! When did the localizer doubt its poses, and by what? Wheels or line points contradicted them (docs/methods.md 16.3).

use localize::Stamp;
use localize::estimate::{Estimate, Reason};
use nalgebra::Matrix3;

use crate::cycle::Cycle;

/// The poses of a run that the localizer doubted while no check of the set-up did.
#[derive(Debug, Clone, Default)]
pub struct DoubtedPoses {
    /// A check of the set-up doubts the poses and says why.
    is_set_up_doubted: bool,
    /// Stamps of the first and the last one.
    span: Option<[Stamp; 2]>,
    images: usize,
    /// Least agreement with the wheels, and least share of the line points on markings.
    wheels: Option<f32>,
    on_markings: Option<f32>,
}

impl DoubtedPoses {
    /// Adds the next image of the run.
    pub fn add(&mut self, cycle: &Cycle) {
        self.add_image(&cycle.estimate, cycle.inputs.setup_doubt);
    }

    fn add_image(&mut self, estimate: &Estimate, setup_doubt: Option<Matrix3<f32>>) {
        if let Some(covariance) = setup_doubt {
            self.is_set_up_doubted = covariance != Matrix3::zeros();
        }
        if self.is_set_up_doubted || estimate.reason != Some(Reason::DoubtfulSetup) {
            return;
        }
        let [first, _] = self.span.unwrap_or([estimate.stamp; 2]);
        self.span = Some([first, estimate.stamp]);
        self.images += 1;
        let least = |before: Option<f32>, now: Option<f32>| {
            let values = [before, now].into_iter().flatten();
            values.reduce(f32::min)
        };
        self.wheels = least(self.wheels, estimate.fit.wheel_agreement);
        self.on_markings = least(self.on_markings, Some(estimate.fit.on_markings));
    }

    /// The warning, if there were such poses.
    pub fn warning(&self) -> Option<String> {
        let [first, last] = self.span?.map(Stamp::seconds);
        let wheels = self.wheels.map_or_else(String::new, |agreement| {
            format!("wheels and poses agreed by {agreement:.2} (1: equal, 0: unrelated), and ")
        });
        Some(format!(
            "from {first:.1} to {last:.1} s the measurements contradicted the poses, of which {} are marked as doubtful: at worst \
             {wheels}{:.0} % of the line points lay on markings. The poses were wrong then, the robot was pushed, or the set-up is wrong",
            self.images,
            100.0 * self.on_markings.unwrap_or_default()
        ))
    }
}

#[cfg(test)]
mod tests {
    use localize::Pose;
    use localize::estimate::Fit;

    use super::*;

    /// The warning after ten seconds of poses that the wheels contradict from 3 to 5 s. `found`: by a check at 2 s.
    fn warning(agreement: f32, found: Option<Matrix3<f32>>) -> Option<String> {
        let mut doubted = DoubtedPoses::default();
        for image in 0..100 {
            let time = 0.1 * f64::from(image);
            let covariance = Matrix3::from_diagonal_element(1e-4);
            let pose = Pose::new(0.0, 0.0, 0.0);
            let mut estimate = Estimate::tracked(Stamp::from_seconds(time), pose, covariance);
            if agreement < 0.2 && (30..=50).contains(&image) {
                estimate.fit = Fit {
                    on_markings: 0.97,
                    wheel_agreement: Some(agreement),
                    ..Fit::default()
                };
                estimate.mark_setup_doubtful(&covariance);
            }
            doubted.add_image(&estimate, found.filter(|_| image == 20));
        }
        doubted.warning()
    }

    #[test]
    fn poses_that_the_wheels_contradict_are_named_with_their_times() {
        let text = warning(-0.06, None).expect("a warning");
        assert!(text.starts_with("from 3.0 to 5.0 s"), "{text}");
        assert!(
            text.contains("21 are marked") && text.contains("by -0.06"),
            "{text}"
        );
        assert_eq!(warning(0.9, None), None);
        assert_eq!(
            warning(-0.06, Some(Matrix3::identity())),
            None,
            "the check says why"
        );
        assert!(warning(-0.06, Some(Matrix3::zeros())).is_some());
    }
}
