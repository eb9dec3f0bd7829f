//! Which scan lines does vision read in the next image? Half of them, in alternation, while the pose is tracked well.
//!
//! The choice follows from the estimates of earlier cycles, so replay repeats it. A new pipeline starts with all lines.

use localize::estimate::{Estimate, Mode};
use vision::scan::pattern::ScanLines;

/// Longest time between two images whose halves are joined, seconds. The motion in between must be known much better
/// than one image tells the pose, and slower cameras leave time for all lines.
const GAP_MAX: f64 = 0.06;

/// State of the choice.
#[derive(Debug, Clone)]
pub(crate) struct Interlace {
    /// Fewest points expected of half of the lines; 0: all lines are read in every image.
    points_min: usize,
    next: ScanLines,
    /// The half that comes next: [`ScanLines::Even`] or [`ScanLines::Odd`].
    half: ScanLines,
    /// The lines that were read in the present image; None if vision did not look at it.
    read: Option<ScanLines>,
}

impl Interlace {
    /// `points_min`: `[vision.scan] interlaced_points_min`.
    pub(crate) fn new(points_min: usize) -> Self {
        Interlace {
            points_min,
            next: ScanLines::All,
            half: ScanLines::Even,
            read: None,
        }
    }

    /// Lines to read in this image; `gap`: time since the last one, seconds, if there was one.
    pub(crate) fn lines(&self, gap: Option<f64>) -> ScanLines {
        match gap {
            Some(gap) if (0.0..=GAP_MAX).contains(&gap) => self.next,
            _ => ScanLines::All,
        }
    }

    /// Takes the lines that were read in this image: all of them if colours were learned.
    pub(crate) fn set_read(&mut self, lines: ScanLines) {
        self.read = Some(lines);
    }

    /// Takes the estimate of this image and decides about the next one.
    pub(crate) fn update(&mut self, estimate: &Estimate) {
        let expected = match self.read.take() {
            None => 0,
            Some(ScanLines::All) => estimate.line_points / 2,
            Some(ScanLines::Even | ScanLines::Odd) => estimate.line_points,
        };
        let certain = estimate.mode == Mode::Tracking
            && estimate.reason.is_none()
            && estimate.runners_up.is_empty()
            && !estimate.collision;
        if self.points_min == 0 || !certain || expected < self.points_min {
            self.next = ScanLines::All;
            return;
        }
        self.next = self.half;
        self.half = match self.half {
            ScanLines::Even => ScanLines::Odd,
            _ => ScanLines::Even,
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use localize::estimate::Reason;
    use localize::{Pose, Stamp};
    use nalgebra::Matrix3;

    fn tracked(line_points: usize) -> Estimate {
        Estimate {
            pose: Some(Pose::new(1.0, 2.0, 0.3)),
            mode: Mode::Tracking,
            line_points,
            ..Estimate::lost(Stamp(0), Matrix3::identity())
        }
    }

    const GAP: Option<f64> = Some(0.033);

    /// Processes an image along the chosen lines and returns them.
    fn read_image(interlace: &mut Interlace, estimate: &Estimate) -> ScanLines {
        let lines = interlace.lines(GAP);
        interlace.set_read(lines);
        interlace.update(estimate);
        lines
    }

    #[test]
    fn halves_alternate_while_the_pose_is_tracked() {
        use ScanLines::{All, Even, Odd};
        let mut interlace = Interlace::new(40);
        let lines = [100, 50, 50, 50].map(|points| read_image(&mut interlace, &tracked(points)));
        assert_eq!(lines, [All, Even, Odd, Even]);
    }

    #[test]
    fn any_doubt_and_few_points_read_all_lines() {
        let doubts: [fn(&mut Estimate); 6] = [
            |estimate| estimate.mode = Mode::Global,
            |estimate| estimate.mode = Mode::Lost,
            |estimate| estimate.reason = Some(Reason::PoorMatch),
            |estimate| estimate.collision = true,
            |estimate| estimate.line_points = 39,
            |estimate| estimate.mark_setup_doubtful(&Matrix3::identity()),
        ];
        for (number, doubt) in doubts.into_iter().enumerate() {
            let mut interlace = Interlace::new(40);
            read_image(&mut interlace, &tracked(100));
            let mut doubtful = tracked(50);
            doubt(&mut doubtful);
            assert_eq!(read_image(&mut interlace, &doubtful), ScanLines::Even);
            assert_eq!(interlace.lines(GAP), ScanLines::All, "{number}");
        }
        // Half of them would have 39.
        let mut interlace = Interlace::new(40);
        read_image(&mut interlace, &tracked(79));
        assert_eq!(interlace.lines(GAP), ScanLines::All);
    }

    #[test]
    fn gaps_and_images_that_vision_did_not_read_are_followed_by_all_lines() {
        let mut interlace = Interlace::new(40);
        read_image(&mut interlace, &tracked(100));
        assert_eq!(interlace.lines(GAP), ScanLines::Even);
        assert_eq!(interlace.lines(Some(0.1)), ScanLines::All);
        assert_eq!(interlace.lines(None), ScanLines::All);
        interlace.update(&tracked(100));
        assert_eq!(interlace.lines(GAP), ScanLines::All);
    }

    #[test]
    fn interlacing_can_be_switched_off() {
        let mut interlace = Interlace::new(0);
        read_image(&mut interlace, &tracked(1000));
        assert_eq!(interlace.lines(GAP), ScanLines::All);
    }
}
