//! The ground map's correction within localization: corrects points before they are matched, learns from the match, and
//! adds the map's remaining uncertainty to the pose's (docs/methods.md 2.13).

use nalgebra::Matrix3;

use super::Localizer;
use crate::estimate::{Estimate, Mode, Reason};
use crate::filter::{PoseFilter, TiltPrior};
use crate::map_correction::{MapBasis, MapCorrection, MapFit, TrackedImage, smooth_terms};
use crate::matching::{Match, PosePrior};
use crate::sample::LinePoint;
use crate::stamp::Stamp;

/// Factor of the pose's covariance after a knock: the images before it moved the pose.
const KNOCK_INFLATION: f32 = 9.0;

/// Images without a pose after which the map counts as new: a knock may be the reason.
const LOST_IMAGES_MAX: u32 = 15;

impl Localizer {
    /// Sets the possible errors of the camera's ground map, and forgets what was learned. None: line points of another
    /// vision system, whose errors are smooth and learned if `map_correction.points_without_map` is true. Without effect if
    /// `map_correction.enabled` is false.
    pub fn set_map_basis(&mut self, basis: Option<MapBasis>) {
        let config = &self.config.map_correction;
        if !config.enabled || (basis.is_none() && !config.points_without_map) {
            self.map_correction = None;
            return;
        }
        let basis = basis.unwrap_or_else(|| {
            let terms = smooth_terms(config.smooth_std);
            MapBasis::new(terms, self.config.matching.viewpoint_height)
        });
        self.map_correction = Some(Box::new(MapCorrection::new(basis, config.clone())));
    }

    /// Goes on with errors of the map that images told, after [`Localizer::set_map_basis`]. Without effect if they are of a map with other
    /// unknowns.
    pub fn adopt_map_fit(&mut self, fit: &MapFit) {
        let Some(shift) = self.map_correction.as_mut().and_then(|map| map.adopt(fit)) else {
            return;
        };
        self.map_origin_std = self.map_origin_std.max(fit.viewpoint_shift());
        // A late image restarts from the snapshot.
        let snapshot = self.snapshot.as_mut().map(|snapshot| &mut snapshot.state);
        for state in [Some(&mut self.state), snapshot].into_iter().flatten() {
            if let Some(track) = state.track_mut() {
                track.filter.shift_pose(shift);
            }
        }
    }

    /// What was learned about the map. None while the map as given is in use.
    pub fn map_fit(&self) -> Option<MapFit> {
        let map = self.map_correction.as_ref()?;
        map.fit(self.map_origin_std)
    }

    /// Sets the standard deviations of the map's origin from the robot's centre, per axis, metres, and of its forward direction,
    /// radians. 0 at first.
    pub fn set_map_mount_std(&mut self, origin: f32, turn: f32) {
        self.map_origin_std = origin;
        self.map_turn_std = turn;
    }

    /// The correction of the ground map. None if it is switched off.
    pub fn map_correction(&self) -> Option<&MapCorrection> {
        self.map_correction.as_deref()
    }

    /// Corrects the points of an image. Without wheels images are single: nothing is learned from them, and the map's whole
    /// uncertainty is the pose's.
    pub(super) fn correct_line_points(&mut self, points: &mut [LinePoint]) {
        let learns = self.learns_map();
        if let Some(map) = &mut self.map_correction {
            if learns {
                map.correct(points);
            } else {
                map.correct_single(points);
            }
        }
    }

    /// Do the wheels connect the images of a drive?
    fn learns_map(&self) -> bool {
        self.last_odometry.is_some()
    }

    /// Learns from a tracked image. `prior`: of the match; None if it had none.
    pub(super) fn learn_map(
        &mut self,
        stamp: Stamp,
        points: &[LinePoint],
        matched: &Match,
        prior: Option<PosePrior>,
        filter: &mut PoseFilter,
    ) {
        let image = TrackedImage {
            stamp,
            points,
            matched,
            predicted: prior.map_or(matched.pose, |prior| prior.pose),
            prior_information: prior.map(|prior| prior.information),
            independent_tilt_std: self.independent_tilt_std(),
            repetition: self.matcher.repetition(),
            expected_tilt: self.expected_tilt,
        };
        let (distances, matching) = (&self.distance_field, self.matcher.config());
        let learns = self.learns_map();
        let Some(map) = &mut self.map_correction else {
            return;
        };
        if !learns {
            map.restart(&image, distances, matching);
            return;
        }
        map.take_origin(filter.origin_offset().as_ref(), matched.pose.theta);
        if let Some(shift) = map.observe(&image, distances, matching) {
            filter.shift_pose(shift);
        }
    }

    /// Tests a match before its image is used: does another mounting of the camera explain clearly more points? The
    /// filter takes over the pose under the new map.
    pub(super) fn detect_knock(
        &mut self,
        stamp: Stamp,
        points: &[LinePoint],
        matched: &Match,
        poor: bool,
        filter: &mut PoseFilter,
    ) -> bool {
        let prior = filter.pose_prior(self.tilt_prior);
        let image = TrackedImage {
            stamp,
            points,
            matched,
            predicted: prior.pose,
            prior_information: Some(prior.information),
            independent_tilt_std: self.independent_tilt_std(),
            repetition: self.matcher.repetition(),
            expected_tilt: self.expected_tilt,
        };
        let margin = self.score_margin(points.len());
        let learns = self.learns_map();
        let Some(map) = self.map_correction.as_mut().filter(|_| learns) else {
            return false;
        };
        let (distances, matching) = (&self.distance_field, self.matcher.config());
        let moved = map
            .try_mounts(&image, margin, distances, matching)
            .or_else(|| map.detect_knock(&image, poor, margin, distances, matching));
        let Some(pose) = moved else {
            return false;
        };
        let [x, y, theta] = pose.difference(filter.pose()).into();
        filter.shift_pose([x, y, theta, 0.0, 0.0]);
        filter.inflate_covariance(KNOCK_INFLATION);
        filter.forget_origin();
        true
    }

    fn independent_tilt_std(&self) -> Option<f32> {
        match self.tilt_prior {
            TiltPrior::Independent(std) => Some(std),
            TiltPrior::FromState { .. } => None,
        }
    }

    /// A pose of the global search: its error by the map follows from this image alone.
    pub(super) fn restart_map(&mut self, stamp: Stamp, points: &[LinePoint], estimate: &Estimate) {
        let margin = self.score_margin(points.len());
        let learns = self.learns_map();
        let Some(map) = &mut self.map_correction else {
            return;
        };
        let Some(pose) = estimate.pose else {
            self.lost_images += u32::from(estimate.reason == Some(Reason::NoMatch));
            if self.lost_images == LOST_IMAGES_MAX {
                map.forget();
            }
            return;
        };
        self.lost_images = 0;
        let matched = self.matcher.refine(&self.distance_field, points, pose, 0.0);
        let image = TrackedImage {
            stamp,
            points,
            matched: &matched,
            predicted: pose,
            prior_information: None,
            independent_tilt_std: Some(self.matcher.tilt_std()),
            repetition: self.matcher.repetition(),
            expected_tilt: self.expected_tilt,
        };
        let (distances, matching) = (&self.distance_field, self.matcher.config());
        if learns {
            map.search_when_due(&image, margin, distances, matching);
        }
        map.restart(&image, distances, matching);
    }

    /// The tracked pose was moved to the other field half.
    pub(super) fn half_turn_map(&mut self) {
        if let Some(map) = &mut self.map_correction {
            map.apply_half_turn();
        }
    }

    /// Covariance of (x, y, θ) by the map's remaining uncertainty.
    pub(super) fn map_pose_covariance(&self) -> Matrix3<f32> {
        let map = self.map_correction.as_ref();
        map.map_or_else(Matrix3::zeros, |map| map.pose_covariance())
    }

    /// Adds what the map's uncertainty means for the pose, and the estimate of the map.
    pub(super) fn add_map_uncertainty(&self, estimate: &mut Estimate) {
        let located = estimate.mode != Mode::Lost;
        let mut origin_std = self.map_origin_std;
        if located {
            estimate.covariance += self.map_pose_covariance();
        }
        if let Some(map) = &self.map_correction {
            if map.is_in_use() {
                origin_std = origin_std.max(map.config().origin_std);
            }
            estimate.map_correction = Some(map.estimate());
        }
        if located {
            // Constant in the robot's frame, whatever it does: a parameter that no measurement tells. So are the errors of a
            // measured field, as long as the robot sees the same markings.
            for k in 0..2 {
                estimate.covariance[(k, k)] +=
                    origin_std * origin_std + self.marking_std * self.marking_std;
            }
            estimate.covariance[(2, 2)] += self.map_turn_std * self.map_turn_std;
        }
    }
}
