//! Which measurements does a set-up have to explain? Line points with their pixels, wheels and compass at keyframes.

use anyhow::Result;
use localize::Stamp;
use localize::sample::{LinePoint, Odometry};
use localize::setup_check::METRES_PER_RADIAN;
use vision::calibrate::Rim;
use vision::image::Image;
use vision::image_check::VisibleRim;
use vision::process::Vision;

use super::effort::Effort;
use super::image_scan::{find_image_faults, summarize};
use super::inertial_motion::{InertialCollector, InertialMotion};
use crate::config::PipelineConfig;
use crate::image_faults::ImageFaults;
use crate::recording::{RecordedData, Recording};
use crate::setup::Setup;

/// Keyframes of a recording: more add time, not certainty.
pub(super) const KEYFRAMES_MAX: usize = 40;
/// Motion between keyframes: metres, where a radian counts as [`METRES_PER_RADIAN`] and two seconds as a quarter.
pub(super) const SPACING_MIN: f32 = 0.3;
/// Wheels that report less in a whole recording report no motion, metres.
pub(super) const WHEEL_PATH_MIN: f32 = 0.1;
pub(super) const METRES_PER_SECOND: f32 = 0.125;
/// Keyframes of a short recording, closer together: wheels that report half of the motion would leave too few to find that out.
const KEYFRAMES_WANTED: usize = 12;
/// Longest gap in the odometry that connects two keyframes, seconds.
pub(super) const ODOMETRY_GAP_MAX: f64 = 1.0;
/// Rows of the odometry this far from an image give the velocity at it, seconds.
const VELOCITY_REACH: f64 = 0.05;
/// Largest age of a compass reading at an image, seconds.
pub(super) const COMPASS_AGE_MAX: f64 = 0.5;

/// What was measured at one image and since the keyframe before it.
#[derive(Debug, Clone, Default)]
pub struct MeasuredKeyframe {
    /// Stamp of the image.
    pub stamp: Stamp,
    /// Line points in the robot frame of the configured camera.
    pub points: Vec<LinePoint>,
    /// Their pixels. Empty for line points of another vision system.
    pub pixels: Vec<[f32; 2]>,
    /// Rows of the odometry since the previous keyframe. None if no odometry connects them.
    pub odometry: Option<Vec<[f32; 3]>>,
    /// Heading of the compass, radians.
    pub compass: Option<f32>,
    /// Motion of the wheels per second about the image: metres, metres, radians.
    pub velocity: Option<[f32; 3]>,
    /// What the inertial unit measured since the previous keyframe. None without it.
    pub inertial: Option<InertialMotion>,
}

/// Time line of a recording before images are read: one entry per image.
struct TimelineEntry {
    index: usize,
    stamp: Stamp,
    odometry: Option<Vec<[f32; 3]>>,
    compass: Option<f32>,
    velocity: Option<[f32; 3]>,
    inertial: Option<InertialMotion>,
    /// Motion since the previous image, metres.
    progress: f32,
    /// False for an image that is known to be no image of the field.
    usable: bool,
}

/// What was measured in a recording.
pub(super) struct Measured {
    pub(super) keyframes: Vec<MeasuredKeyframe>,
    /// Which samples of the recording their images are.
    images: Vec<usize>,
    /// None if not every image was checked.
    pub(super) image_faults: Option<ImageFaults>,
    /// The mirror's rim in the keyframes' images. None where it is not seen.
    pub(super) rim: Option<Rim>,
}

/// Selects keyframes of a recording and detects their line points. Images that cannot be used have none. With full effort every
/// image is checked first, and the keyframes are usable ones.
pub(super) fn measure(
    recording: &Recording,
    setup: &Setup,
    config: &PipelineConfig,
    effort: Effort,
) -> Result<Measured> {
    let latency = setup.camera_latency(&config.localize.filter);
    let mut entries = timeline(recording, setup, latency.into());
    let images: Vec<usize> = entries.iter().map(|entry| entry.index).collect();
    let find_faults = |images: &[usize]| find_image_faults(recording, setup, config, images);
    let (entries, faults, image_faults) = match effort {
        Effort::Full => {
            let faults = find_faults(&images);
            for entry in &mut entries {
                entry.usable = !faults.contains_key(&entry.index);
            }
            let summary = summarize(recording, &images, &faults);
            (select(entries), faults, Some(summary))
        }
        Effort::Brief => {
            let entries = select(entries);
            let faults = find_faults(&with_predecessors(&entries, &images));
            (entries, faults, None)
        }
    };
    let mut vision = match &setup.camera {
        Some((camera, map)) => Some(Vision::with_mask(
            map,
            camera,
            setup.mask.as_deref(),
            setup.field.config.line_width,
            config.vision.clone(),
        )?),
        None => None,
    };
    if let (Some(vision), Some(colours)) = (&mut vision, &setup.colours) {
        vision.set_colour_table(colours.clone());
    }
    let mut last: Option<Stamp> = None;
    let (mut keyframes, mut used) = (Vec::new(), Vec::new());
    let mut visible_rim = setup
        .camera
        .as_ref()
        .and_then(|(camera, map)| VisibleRim::new(camera, [map.width_px, map.height_px]));
    for entry in entries {
        let (index, stamp) = (entry.index, entry.stamp);
        let mut keyframe = MeasuredKeyframe::without_points(entry);
        match &recording.remaining_samples()[index].data {
            RecordedData::Points(points) => keyframe.points.clone_from(points),
            RecordedData::Image(path) if !faults.contains_key(&index) => {
                let (Some(vision), Ok(image)) = (&mut vision, Image::load(path)) else {
                    continue;
                };
                if let Some(rim) = &mut visible_rim {
                    rim.add(&image.view());
                }
                if last.is_some_and(|last| (stamp - last).abs() > 1.0) {
                    vision.reset_colour_model();
                }
                last = Some(stamp);
                // An image that cannot be used has no line points.
                if let Ok(detections) = vision.process_lines(&image.view()) {
                    let found = &detections.line_points;
                    keyframe.points = found.iter().map(|found| found.point).collect();
                    keyframe.pixels = found.iter().map(|found| found.position_px).collect();
                }
            }
            _ => {}
        }
        keyframes.push(keyframe);
        used.push(index);
    }
    Ok(Measured {
        keyframes,
        images: used,
        image_faults,
        rim: visible_rim.and_then(|rim| rim.find()),
    })
}

impl MeasuredKeyframe {
    fn without_points(entry: TimelineEntry) -> Self {
        MeasuredKeyframe {
            stamp: entry.stamp,
            odometry: entry.odometry,
            compass: entry.compass,
            velocity: entry.velocity,
            inertial: entry.inertial,
            ..MeasuredKeyframe::default()
        }
    }
}

impl Measured {
    /// The keyframes with what wheels and compass measured if the images are `excess` seconds older at their stamps than `latency` says.
    /// Younger ones are wheels whose stamps are late: the compass stays. Whose clock an inertial unit has is not known.
    pub(super) fn at_age(
        &self,
        recording: &Recording,
        setup: &Setup,
        latency: f64,
        excess: f64,
    ) -> Vec<MeasuredKeyframe> {
        let entries = timeline(recording, setup, latency + excess);
        let chosen = |entry: &TimelineEntry| self.images.binary_search(&entry.index).is_ok();
        let entries = join(entries, chosen).into_iter().zip(&self.keyframes);
        let keyframes = entries.map(|(entry, keyframe)| MeasuredKeyframe {
            points: keyframe.points.clone(),
            pixels: keyframe.pixels.clone(),
            compass: if excess < 0.0 {
                keyframe.compass
            } else {
                entry.compass
            },
            inertial: None,
            ..MeasuredKeyframe::without_points(entry)
        });
        keyframes.collect()
    }
}

/// The keyframes' images, each behind the image before it: only these tell a frozen camera. `images`: indices of all.
fn with_predecessors(keyframes: &[TimelineEntry], images: &[usize]) -> Vec<usize> {
    let mut wanted: Vec<usize> = Vec::new();
    for keyframe in keyframes {
        let after = images.partition_point(|index| *index <= keyframe.index);
        wanted.extend(&images[after.saturating_sub(2)..after]);
    }
    wanted.dedup();
    wanted
}

/// `latency`: age of an image at its stamp, seconds. Wheels and compass belong to its exposure.
fn timeline(recording: &Recording, setup: &Setup, latency: f64) -> Vec<TimelineEntry> {
    let mut inertial = InertialCollector::new(setup);
    let mut entries: Vec<TimelineEntry> = Vec::new();
    let mut rows: Vec<[f32; 3]> = Vec::new();
    let mut last_odometry: Option<Stamp> = None;
    let mut connected = false;
    let mut compass: Vec<(Stamp, f32)> = Vec::new();
    let mut motion: Vec<Odometry> = Vec::new();
    for event in recording.remaining_samples() {
        match &event.data {
            RecordedData::Compass(reading) => compass.push((event.stamp, reading.heading)),
            RecordedData::Odometry(odometry) => motion.push(*odometry),
            _ => {}
        }
    }
    for (measured, index) in by_time(recording, latency) {
        let event = &recording.remaining_samples()[index];
        match &event.data {
            RecordedData::Odometry(odometry) => {
                connected &=
                    last_odometry.is_none_or(|last| event.stamp - last <= ODOMETRY_GAP_MAX);
                last_odometry = Some(event.stamp);
                rows.push([odometry.dx, odometry.dy, odometry.dtheta]);
                inertial.add_odometry(odometry);
            }
            RecordedData::Image(_) | RecordedData::Points(_) => {
                connected &= last_odometry.is_some_and(|last| measured - last <= ODOMETRY_GAP_MAX);
                let seconds = entries
                    .last()
                    .map_or(0.0, |last| (event.stamp - last.stamp) as f32);
                let moved: f32 = rows
                    .iter()
                    .map(|[dx, dy, turn]| {
                        localize::math::hypot(*dx, *dy) + METRES_PER_RADIAN * turn.abs().min(0.5)
                    })
                    .sum();
                entries.push(TimelineEntry {
                    index,
                    stamp: event.stamp,
                    odometry: connected.then(|| rows.clone()),
                    compass: nearest_reading(&compass, measured),
                    velocity: velocity_at(&motion, measured),
                    inertial: inertial.take_motion(),
                    progress: moved + METRES_PER_SECOND * seconds.clamp(0.0, 4.0),
                    usable: true,
                });
                rows.clear();
                connected = true;
            }
            RecordedData::Imu(imu) => inertial.add_imu(imu),
            RecordedData::Compass(_) | RecordedData::Truth(_) => {}
        }
    }
    entries
}

/// When each sample was measured, and its index, in the order of these times: an image when it was exposed.
fn by_time(recording: &Recording, latency: f64) -> Vec<(Stamp, usize)> {
    let samples = recording.remaining_samples().iter();
    let mut order: Vec<(Stamp, usize)> = samples
        .enumerate()
        .map(|(index, sample)| match sample.data {
            RecordedData::Image(_) | RecordedData::Points(_) => (sample.stamp + -latency, index),
            _ => (sample.stamp, index),
        })
        .collect();
    order.sort_by_key(|(measured, _)| *measured);
    order
}

/// Velocity of the wheels about a time, from rows in the order of their stamps, of which later ones may be missing.
pub(super) fn velocity_at(rows: &[Odometry], stamp: Stamp) -> Option<[f32; 3]> {
    let first = rows_before_velocity(rows, stamp);
    let end = rows.partition_point(|row| row.stamp - stamp <= VELOCITY_REACH);
    // A row's motion began at the stamp of the one before.
    let (before, near) = rows.get(first..end)?.split_first()?;
    let seconds = (near.last()?.stamp - before.stamp) as f32;
    let sum = near.iter().fold([0.0; 3], |[x, y, turn], row| {
        [x + row.dx, y + row.dy, turn + row.dtheta]
    });
    (seconds > 0.0 && f64::from(seconds) < ODOMETRY_GAP_MAX).then(|| sum.map(|all| all / seconds))
}

/// Number of rows that the velocity at this time does not need.
pub(super) fn rows_before_velocity(rows: &[Odometry], stamp: Stamp) -> usize {
    let near = rows.partition_point(|row| stamp - row.stamp > VELOCITY_REACH);
    near.saturating_sub(1)
}

fn nearest_reading(readings: &[(Stamp, f32)], stamp: Stamp) -> Option<f32> {
    let after = readings.partition_point(|(at, _)| *at <= stamp);
    let near = readings[after.saturating_sub(1)..].iter().take(2);
    near.map(|(at, heading)| ((stamp - *at).abs(), *heading))
        .filter(|(age, _)| *age <= COMPASS_AGE_MAX)
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, heading)| heading)
}

/// Path and turn of odometry rows, metres, where a radian counts as half a metre.
pub(super) fn wheel_path(rows: Option<&[[f32; 3]]>) -> f32 {
    let rows = rows.into_iter().flatten();
    rows.map(|[dx, dy, turn]| localize::math::hypot(*dx, *dy) + METRES_PER_RADIAN * turn.abs())
        .sum()
}

/// Evenly spaced entries among the usable ones; the motion of those between is joined.
fn select(entries: Vec<TimelineEntry>) -> Vec<TimelineEntry> {
    let usable = || entries.iter().filter(|entry| entry.usable);
    let total: f32 = usable().map(|entry| entry.progress).sum();
    let spacing = SPACING_MIN
        .min(total / KEYFRAMES_WANTED as f32)
        .max(total / KEYFRAMES_MAX as f32);
    let stride = usable().count().div_ceil(KEYFRAMES_MAX).max(1);
    // Wheels that report no motion may be wrong: the images decide (`dead_sensors`).
    let path: f32 = entries
        .iter()
        .map(|entry| wheel_path(entry.odometry.as_deref()))
        .sum();
    let connected = path > WHEEL_PATH_MIN;
    let (mut progress, mut position, mut count) = (f32::INFINITY, 0, 0);
    join(entries, |entry| {
        progress += entry.progress;
        if !entry.usable {
            return false;
        }
        let due = if connected {
            progress >= spacing
        } else {
            position % stride == 0
        };
        position += 1;
        let chosen = due && count < KEYFRAMES_MAX;
        if chosen {
            progress = 0.0;
            count += 1;
        }
        chosen
    })
}

/// The chosen entries, each with what was measured since the one before.
fn join(
    entries: Vec<TimelineEntry>,
    mut choose: impl FnMut(&TimelineEntry) -> bool,
) -> Vec<TimelineEntry> {
    let mut chosen: Vec<TimelineEntry> = Vec::new();
    let mut skipped: Option<Vec<[f32; 3]>> = Some(Vec::new());
    let mut skipped_inertial: Option<InertialMotion> = None;
    for mut entry in entries {
        skipped = skipped.zip(entry.odometry.take()).map(|(mut all, rows)| {
            all.extend(rows);
            all
        });
        add_motion(&mut skipped_inertial, entry.inertial.take());
        if choose(&entry) {
            entry.odometry = skipped.take().filter(|_| !chosen.is_empty());
            entry.inertial = skipped_inertial.take();
            skipped = Some(Vec::new());
            chosen.push(entry);
        }
    }
    chosen
}

/// Adds what an inertial unit measured to what it measured before.
fn add_motion(sum: &mut Option<InertialMotion>, more: Option<InertialMotion>) {
    if let Some(more) = more {
        *sum.get_or_insert_default() += more;
    }
}

/// Keyframes with so many points, the motion between joined.
pub(super) fn with_points(measured: Vec<MeasuredKeyframe>, least: usize) -> Vec<MeasuredKeyframe> {
    let (mut skipped, mut inertial) = (Some(Vec::new()), None);
    let mut kept: Vec<MeasuredKeyframe> = Vec::new();
    for mut keyframe in measured {
        skipped = skipped
            .zip(keyframe.odometry.take())
            .map(|(mut all, rows)| {
                all.extend(rows);
                all
            });
        add_motion(&mut inertial, keyframe.inertial.take());
        if keyframe.points.len() >= least {
            keyframe.odometry = skipped.take().filter(|_| !kept.is_empty());
            keyframe.inertial = inertial.take();
            skipped = Some(Vec::new());
            kept.push(keyframe);
        }
    }
    kept
}

/// Every `stride`-th keyframe, the motion between joined.
pub(super) fn thin_out(measured: &[MeasuredKeyframe], stride: usize) -> Vec<MeasuredKeyframe> {
    measured
        .chunks(stride)
        .scan(
            (Some(Vec::new()), None),
            |(carried, inertial): &mut (Option<Vec<[f32; 3]>>, Option<InertialMotion>), chunk| {
                let first = &chunk[0];
                let join = |before: Option<Vec<[f32; 3]>>, rows: &Option<Vec<[f32; 3]>>| {
                    before.zip(rows.clone()).map(|(mut all, rows)| {
                        all.extend(rows);
                        all
                    })
                };
                let odometry = join(carried.take(), &first.odometry);
                *carried = chunk[1..]
                    .iter()
                    .try_fold(Vec::new(), |all, next| join(Some(all), &next.odometry));
                let mut motion = inertial.take();
                add_motion(&mut motion, first.inertial);
                let rest = chunk[1..].iter();
                rest.for_each(|next| add_motion(inertial, next.inertial));
                Some(MeasuredKeyframe {
                    odometry,
                    inertial: motion,
                    ..first.clone()
                })
            },
        )
        .collect()
}

#[cfg(test)]
mod tests {
    use localize::frames::At;

    use super::*;

    #[test]
    fn motion_of_images_with_few_lines_is_that_of_the_next_one() {
        let point = LinePoint {
            at: At::new(1.0, 0.0),
            std_radial: 0.01,
            std_tangential: 0.01,
        };
        let keyframe = |k: u8, points: usize| MeasuredKeyframe {
            stamp: Stamp::from_seconds(f64::from(k)),
            points: vec![point; points],
            odometry: (k > 0).then(|| vec![[f32::from(k), 0.0, 0.0]]),
            ..MeasuredKeyframe::default()
        };
        let measured = [(0, 0), (1, 20), (2, 3), (3, 2), (4, 20)].map(|(k, n)| keyframe(k, n));
        let kept = with_points(measured.to_vec(), 6);
        let motions: Vec<_> = kept.iter().map(|keyframe| &keyframe.odometry).collect();
        let joined = [2.0, 3.0, 4.0].map(|k| [k, 0.0, 0.0]).to_vec();
        assert_eq!(motions, [&None, &Some(joined)]);
    }
}
