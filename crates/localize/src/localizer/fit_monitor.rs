//! How well do images, wheels and compass fit the poses of the last seconds? (docs/methods.md 16.3)
//!
//! A wrong field, a mirrored or turned camera, or a wrong unit lets the localizer find poses that fit each image.
//! Wheels or compass then contradict them over many images, which no single image shows.

use crate::estimate::{Estimate, Fit};
use crate::field::{Field, Marking};
use crate::frames::{At, FieldFrame, Pose, RobotFrame, Tf, wrap_angle};
use crate::matching::MatchConfig;
use crate::matching::distance_field::DistanceField;
use crate::math;
use crate::sample::LinePoint;
use crate::tilt::ground_from_map;

/// Distance between samples of the markings, metres.
const MARKING_STEP: f32 = 0.25;
/// Markings within this distance count as in sight, if the image's points reach as far, metres.
const SIGHT_RANGE: f32 = 4.0;
/// A marking's sample is seen if a line point lies this near: half a step and the error of a point, metres.
const SEEN_DISTANCE: f32 = 0.25;
/// Points on markings are counted in every n-th image, and the markings by its points and those of the image before it:
/// vision may read half of the scan lines in each.
const SEEN_STRIDE: u32 = 5;
/// A point farther than this from every marking lies on none, however uncertain it is, metres.
const ON_MARKING_MAX: f32 = 0.15;
/// Memory of the image figures, in images, and of wheels and compass, in steps.
const IMAGES: f32 = 150.0;
const STEPS: f32 = 20.0;
/// Motion after which wheels and poses are compared: metres or radians.
const STEP_PATH: f32 = 0.3;
const STEP_TURN: f32 = 0.3;
/// Images, or steps of wheels and compass, before a figure can raise a doubt.
const IMAGES_MIN: u32 = 60;
const STEPS_MIN: u32 = 15;
/// Steps before a figure is shown.
const STEPS_SHOWN_MIN: u32 = 3;
/// Agreement (1: equal, 0: unrelated, −1: opposite) below which the wheels contradict the poses: that of a camera turned
/// by 90°, with a margin for what the filter takes from the wheels.
const AGREEMENT_MIN: f32 = 0.2;

/// A mean that forgets, over `count` values at most `memory` long.
#[derive(Debug, Clone, Copy, Default)]
struct Mean {
    value: f32,
    count: u32,
}

impl Mean {
    fn add(&mut self, value: f32, memory: f32) {
        self.count = self.count.saturating_add(1);
        self.value += (value - self.value) / memory.min(self.count as f32);
    }

    fn known(&self, count_min: u32) -> Option<f32> {
        (self.count >= count_min).then_some(self.value)
    }
}

/// Figures of the last images, and wheels and compass against their poses.
#[derive(Debug, Clone)]
pub(super) struct FitMonitor {
    markings: Vec<At<FieldFrame>>,
    on_markings: Mean,
    squared_residual: Mean,
    seen: Mean,
    /// Points of the image before one whose markings are counted, on the field.
    points_before: Vec<At<FieldFrame>>,
    image: u32,
    /// Pose at the start of the current step of the wheels.
    step_start: Option<Pose>,
    step: Tf<RobotFrame, RobotFrame>,
    path: f32,
    turned: f32,
    translation: Mean,
    rotation: Mean,
    compass: Mean,
}

impl FitMonitor {
    pub(super) fn new(field: &Field) -> Self {
        FitMonitor {
            markings: sample_markings(&field.markings),
            on_markings: Mean::default(),
            squared_residual: Mean::default(),
            seen: Mean::default(),
            points_before: Vec::new(),
            image: 0,
            step_start: None,
            step: Tf::new(0.0, 0.0, 0.0),
            path: 0.0,
            turned: 0.0,
            translation: Mean::default(),
            rotation: Mean::default(),
            compass: Mean::default(),
        }
    }

    /// Adds an increment of the wheels, robot frame.
    pub(super) fn add_wheels(&mut self, [dx, dy, dtheta]: [f32; 3]) {
        self.step = self.step * Tf::new(dx, dy, dtheta);
        self.path += math::hypot(dx, dy);
        self.turned += dtheta.abs();
    }

    /// A gap in the odometry: the current step is void.
    pub(super) fn restart_wheels(&mut self) {
        self.step_start = None;
    }

    /// Adds the figures of an image; `heading`: the compass's, if it is recent.
    pub(super) fn add_image(
        &mut self,
        estimate: &Estimate,
        points: &[LinePoint],
        markings: &FitMarkings<'_>,
        heading: Option<f32>,
    ) {
        let Some(pose) = estimate.pose else {
            self.step_start = None;
            return;
        };
        if estimate.inlier_share > 0.0 {
            self.squared_residual
                .add(estimate.inlier_rms * estimate.inlier_rms, IMAGES);
            if self.image.is_multiple_of(SEEN_STRIDE) {
                let on_markings = markings.share_of(pose, estimate.tilt, points);
                self.on_markings
                    .add(on_markings, IMAGES / SEEN_STRIDE as f32);
                if let Some(share) = self.seen_share(pose, points) {
                    self.seen.add(share, IMAGES / SEEN_STRIDE as f32);
                }
            }
            self.image = self.image.wrapping_add(1);
            self.points_before.clear();
            if self.image.is_multiple_of(SEEN_STRIDE) {
                let on_field = points.iter().map(|point| pose * point.at);
                self.points_before.extend(on_field);
            }
        }
        self.compare_step(pose);
        if let Some(heading) = heading
            && self.path == 0.0
        {
            // Once per step, since the errors of successive readings are correlated.
            self.compass.add(math::cos(pose.theta - heading), STEPS);
        }
    }

    /// Compares the wheels with the poses once the robot has moved far enough.
    fn compare_step(&mut self, pose: Pose) {
        if self.step_start.is_some() && self.path < STEP_PATH && self.turned < STEP_TURN {
            return;
        }
        if let Some(start) = self.step_start {
            let seen = start.inverse() * pose;
            let measured = self.step;
            if self.path >= STEP_PATH {
                let difference = math::hypot(seen.x - measured.x, seen.y - measured.y);
                let size =
                    seen.x.powi(2) + seen.y.powi(2) + measured.x.powi(2) + measured.y.powi(2);
                self.translation
                    .add(1.0 - difference * difference / size.max(1e-6), STEPS);
            }
            if self.turned >= STEP_TURN {
                let difference = wrap_angle(seen.theta - measured.theta);
                let size = seen.theta.powi(2) + measured.theta.powi(2);
                let agreement = 1.0 - difference * difference / size.max(1e-6);
                self.rotation.add(agreement.max(-1.0), STEPS);
            }
        }
        self.step_start = Some(pose);
        self.step = Tf::new(0.0, 0.0, 0.0);
        (self.path, self.turned) = (0.0, 0.0);
    }

    /// Share of the markings in sight at which there is a line point. None if few are in sight.
    fn seen_share(&self, pose: Pose, points: &[LinePoint]) -> Option<f32> {
        let robot_from_field = pose.inverse();
        let mut ranges: Vec<f32> = points.iter().map(|point| point.at.distance()).collect();
        ranges.sort_by(f32::total_cmp);
        let (nearest, farthest) = (*ranges.first()?, *ranges.last()?);
        let range = farthest.min(SIGHT_RANGE);
        let here = PointsNear::new(points.iter().map(|point| [point.at.x, point.at.y]));
        let before = PointsNear::new(self.points_before.iter().map(|point| [point.x, point.y]));
        let (mut in_sight, mut seen) = (0, 0);
        for marking in &self.markings {
            if marking.distance_to(pose.origin()) > range {
                continue;
            }
            let at = robot_from_field * *marking;
            if at.distance() < nearest {
                continue;
            }
            in_sight += 1;
            seen += usize::from(here.any([at.x, at.y]) || before.any([marking.x, marking.y]));
        }
        (in_sight >= 8).then(|| seen as f32 / in_sight as f32)
    }

    /// Agreement of the wheels with the poses' translation and rotation, the smaller one.
    fn wheels(&self, count_min: u32) -> Option<f32> {
        let means = [self.translation, self.rotation];
        let known = means.iter().filter_map(|mean| mean.known(count_min));
        known.reduce(f32::min)
    }

    /// The figures.
    pub(super) fn fit(&self) -> Fit {
        Fit {
            on_markings: self.on_markings.value,
            inlier_rms: self.squared_residual.value.max(0.0).sqrt(),
            markings_seen: self.seen.value,
            wheel_agreement: self.wheels(STEPS_SHOWN_MIN),
            compass_agreement: self.compass.known(STEPS_SHOWN_MIN),
        }
    }

    /// Do wheels or points contradict the poses for longer than any right set-up does?
    ///
    /// A compass alone raises no doubt: magnets disturb it for seconds in right set-ups.
    pub(super) fn is_doubtful(&self, inlier_share_min: f32) -> bool {
        let wheels = self.wheels(STEPS_MIN);
        let points = self.on_markings.known(IMAGES_MIN / SEEN_STRIDE);
        wheels.is_some_and(|agreement| agreement < AGREEMENT_MIN)
            || points.is_some_and(|share| share < inlier_share_min)
    }
}

/// Points with which markings are compared, coordinate by coordinate: eight comparisons at a time.
struct PointsNear {
    x: Vec<f32>,
    y: Vec<f32>,
}

impl PointsNear {
    fn new(points: impl Iterator<Item = [f32; 2]>) -> Self {
        let (x, y) = points.map(|[x, y]| (x, y)).unzip();
        PointsNear { x, y }
    }

    /// Is a point within [`SEEN_DISTANCE`]? Counts them all: a loop that ends early is not vectorised.
    fn any(&self, [x, y]: [f32; 2]) -> bool {
        let near = |(px, py): (&f32, &f32)| {
            let (dx, dy) = (px - x, py - y);
            u32::from(dx * dx + dy * dy < SEEN_DISTANCE * SEEN_DISTANCE)
        };
        self.x.iter().zip(&self.y).map(near).sum::<u32>() > 0
    }
}

/// The markings with which points are compared.
pub(super) struct FitMarkings<'a> {
    pub(super) distances: &'a DistanceField,
    pub(super) matching: &'a MatchConfig,
}

impl FitMarkings<'_> {
    /// Share of the points that lie on markings, by their stated spread and within a limit.
    ///
    /// The match learns the spread, and the map's uncertainty widens it, until both explain the points: the inliers of the
    /// match say nothing about the set-up.
    /// `tilt`: what the points are not compensated for, radians.
    fn share_of(&self, pose: Pose, tilt: [f32; 2], points: &[LinePoint]) -> f32 {
        let MatchConfig {
            viewpoint_height,
            kernel_scale_sigmas,
            map_std,
            ..
        } = *self.matching;
        let is_on_marking = |point: &&LinePoint| {
            let [x, y] = ground_from_map([point.at.x, point.at.y], tilt, viewpoint_height);
            let at = pose * At::<RobotFrame>::new(x, y);
            let std = point.std_radial.max(point.std_tangential);
            let reach = (kernel_scale_sigmas * math::hypot(map_std, std)).min(ON_MARKING_MAX);
            self.distances.nearest(at.x, at.y).signed_distance.abs() < reach
        };
        points.iter().filter(is_on_marking).count() as f32 / points.len().max(1) as f32
    }
}

/// Points of all markings' centre lines.
fn sample_markings(markings: &[Marking]) -> Vec<At<FieldFrame>> {
    let mut samples = Vec::new();
    for marking in markings {
        match *marking {
            Marking::Line { from, to } => {
                let count = (from.distance_to(to) / MARKING_STEP).ceil().max(1.0) as usize;
                samples.extend((0..count).map(|k| {
                    let part = (k as f32 + 0.5) / count as f32;
                    At::new(
                        from.x + part * (to.x - from.x),
                        from.y + part * (to.y - from.y),
                    )
                }));
            }
            Marking::Arc {
                centre,
                radius,
                start,
                sweep,
            } => {
                let count = (radius * sweep / MARKING_STEP).ceil().max(1.0) as usize;
                samples.extend((0..count).map(|k| {
                    let part = (k as f32 + 0.5) / count as f32;
                    let (sin, cos) = math::sin_cos(start + sweep * part);
                    At::new(centre.x + radius * cos, centre.y + radius * sin)
                }));
            }
            Marking::Spot { .. } => {}
        }
    }
    samples
}
