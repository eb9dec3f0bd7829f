//! For which images is the odometry missing? It begins late, ends early, has gaps, or its clock jumps.

use localize::Stamp;

use super::measurements::ODOMETRY_GAP_MAX;
use crate::recording::{RecordedData, Recording};

/// Rows this many times farther apart than usual have a gap between them.
const GAP_FACTOR: f64 = 4.0;
/// Gaps that are named one by one.
const NAMED_MAX: usize = 3;
/// Motion in one row after a gap that covers all of it: the base has summed it up, metres. Such a base reports while it moves.
const SUMMED_MIN: f32 = 0.1;
/// A clock that jumps leaves a gap of the same length at the end, seconds.
const JUMP_TOLERANCE: f64 = 0.5;

/// What is known about the times without odometry.
#[derive(Debug, Default, PartialEq)]
pub(super) struct OdometryGaps {
    /// Sentences; empty when all is well.
    pub(super) found: Vec<String>,
    /// Its rows belong to other images than their stamps say: it must not be used.
    pub(super) clock_jumps: bool,
}

/// Finds the times without odometry. Nothing for a recording without it.
pub(super) fn find_gaps(recording: &Recording) -> OdometryGaps {
    let mut rows: Vec<(Stamp, f32)> = Vec::new();
    let (mut images, mut from_points) = (Vec::new(), false);
    for event in recording.remaining_samples() {
        match &event.data {
            RecordedData::Odometry(row) => {
                rows.push((event.stamp, row.path()));
            }
            RecordedData::Image(_) => images.push(event.stamp),
            RecordedData::Points(_) => {
                from_points = true;
                images.push(event.stamp);
            }
            RecordedData::Compass(_) | RecordedData::Imu(_) | RecordedData::Truth(_) => {}
        }
    }
    let images_name = if from_points {
        "points.csv"
    } else {
        "frames.csv"
    };
    describe(&rows, &images, images_name)
}

/// `rows`: stamp and motion of each row of the odometry.
fn describe(rows: &[(Stamp, f32)], images: &[Stamp], images_name: &str) -> OdometryGaps {
    let (Some((first, _)), Some((last, _))) = (rows.first(), rows.last()) else {
        return OdometryGaps::default();
    };
    let (Some(first_image), Some(last_image)) = (images.first(), images.last()) else {
        return OdometryGaps::default();
    };
    let limit = gap_limit(rows);
    let shows = |from: Stamp, to: Stamp| images.iter().any(|image| *image > from && *image < to);
    let gaps = rows.windows(2).filter_map(|pair| {
        let [(from, _), (to, moved)] = [pair[0], pair[1]];
        let is_gap = to - from > limit && moved < SUMMED_MIN && shows(from, to);
        is_gap.then_some((from, to))
    });
    let gaps: Vec<(Stamp, Stamp)> = gaps.collect();
    let mut found = Vec::new();
    let beyond = *last - *last_image;
    let jump = gaps
        .iter()
        .find(|(from, to)| (to.seconds() - from.seconds() - beyond).abs() < JUMP_TOLERANCE);
    if let Some((from, to)) = jump {
        found.push(format!(
            "odometry.csv: its clock jumps by {:.1} s: the row after {:.3} s has {:.3} s, and its last row is {beyond:.1} s later than \
             the last image of {images_name}. It is not used. Subtract {:.3} from stamp_s of the rows after the jump",
            *to - *from,
            from.seconds(),
            to.seconds(),
            *to - *from
        ));
    } else if !gaps.is_empty() {
        let named: Vec<String> = gaps
            .iter()
            .take(NAMED_MAX)
            .map(|(from, to)| format!("{:.3} to {:.3} s", from.seconds(), to.seconds()))
            .collect();
        let more = gaps.len().saturating_sub(NAMED_MAX);
        let more = if more > 0 {
            format!(", and {more} more")
        } else {
            String::new()
        };
        found.push(format!(
            "odometry.csv has no row from {}{more}, while there are images: the motion in between is unknown",
            named.join(", ")
        ));
    }
    let unknown = |missing: f64, place: &str, at: Stamp, image: Stamp, which: &str| {
        format!(
            "odometry.csv {place} at {:.3} s, {missing:.1} s {which} image of {images_name} ({:.3} s): was it cut off? The motion of those \
             images is unknown",
            at.seconds(),
            image.seconds()
        )
    };
    if *first - *first_image > limit {
        found.push(unknown(
            *first - *first_image,
            "begins",
            *first,
            *first_image,
            "after the first",
        ));
    }
    if *last_image - *last > limit {
        found.push(unknown(
            *last_image - *last,
            "ends",
            *last,
            *last_image,
            "before the last",
        ));
    }
    OdometryGaps {
        found,
        clock_jumps: jump.is_some(),
    }
}

/// Rows farther apart have a gap between them, seconds.
fn gap_limit(rows: &[(Stamp, f32)]) -> f64 {
    let mut apart: Vec<f64> = rows.windows(2).map(|pair| pair[1].0 - pair[0].0).collect();
    apart.sort_by(f64::total_cmp);
    let median = apart.get(apart.len() / 2).copied().unwrap_or(0.0);
    ODOMETRY_GAP_MAX.max(GAP_FACTOR * median)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is found in 20 s of images at 10 Hz with rows of the odometry at these times.
    fn found(times: impl Iterator<Item = f64>) -> Vec<String> {
        let rows: Vec<(Stamp, f32)> = times
            .map(|time| (Stamp::from_seconds(time), 0.02))
            .collect();
        let images: Vec<Stamp> = (0..=200)
            .map(|k| Stamp::from_seconds(0.1 * f64::from(k)))
            .collect();
        describe(&rows, &images, "frames.csv").found
    }

    fn seconds() -> impl Iterator<Item = f64> {
        (0..=1000).map(|k| 0.02 * f64::from(k))
    }

    #[test]
    fn odometry_of_the_whole_recording_has_no_finding() {
        assert_eq!(found(seconds()), Vec::<String>::new());
        assert_eq!(
            found(seconds().filter(|time| !(6.0..6.8).contains(time))),
            Vec::<String>::new()
        );
        assert_eq!(found(std::iter::empty()), Vec::<String>::new());
    }

    #[test]
    fn odometry_that_begins_late_or_ends_early_is_named_with_its_times() {
        let late = found(seconds().filter(|time| *time > 3.0));
        assert!(
            late.len() == 1 && late[0].contains("begins at 3.020 s"),
            "{late:?}"
        );
        let cut = found(seconds().filter(|time| *time < 12.0));
        assert!(
            cut.len() == 1 && cut[0].contains("ends at 11.980 s, 8.0 s before"),
            "{cut:?}"
        );
    }

    #[test]
    fn gap_is_named_and_a_jump_of_the_clock_is_told_from_it() {
        let gap = found(seconds().filter(|time| !(6.01..9.0).contains(time)));
        assert!(
            gap.len() == 1 && gap[0].contains("no row from 6.000 to 9.000 s"),
            "{gap:?}"
        );
        let jump = found(seconds().map(|time| if time > 12.01 { time + 5.0 } else { time }));
        assert!(
            jump.len() == 1 && jump[0].contains("its clock jumps by 5.0 s"),
            "{jump:?}"
        );
    }

    #[test]
    fn base_that_sums_its_motion_up_has_no_gap() {
        let rows: Vec<(Stamp, f32)> = [0.0, 0.5, 1.0, 4.0, 4.5, 20.0]
            .map(|time| (Stamp::from_seconds(time), 0.5))
            .to_vec();
        let images: Vec<Stamp> = (0..=200)
            .map(|k| Stamp::from_seconds(0.1 * f64::from(k)))
            .collect();
        assert_eq!(
            describe(&rows, &images, "frames.csv"),
            OdometryGaps::default()
        );
    }
}
