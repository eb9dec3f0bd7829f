//! Calibration of the ground map from nothing but images and the field: no map, no mirror, no centre, no poses.
//!
//! The rim gives the centre, `mirror_search` a map that is good to a few percent, and the joint fit of `lines` the map.
//! Halves of the images are fitted separately: only where they agree do the images decide.

use std::sync::atomic::{AtomicUsize, Ordering};

use localize::Field;
use localize::field::FieldSize;
use localize::robot::CameraConfig;
use rayon::prelude::*;

use crate::calibrate::acceptance::{
    FOUND_SIZES_SHARE_MIN, ensure_field_explains, ensure_halves_agree, is_doubtful, odds,
    unexplained,
};
use crate::calibrate::field_sizes::find_better_size;
use crate::calibrate::halves::compare_halves;
use crate::calibrate::joint_fit::Markings;
use crate::calibrate::line_pixels::{SearchImage, detect_line_pixels};
use crate::calibrate::lines::{
    GUESS_WIDTH_SLACK, IMAGES_MIN, LinesCalibration, NamedImage, refine_map,
};
use crate::calibrate::map_alignment::PlanarTransform;
use crate::calibrate::mirror_search::{MirrorHypothesis, MirrorSearch};
use crate::calibrate::radial_model::KnownSizes;
use crate::calibrate::rim::{Rim, find_rim};
use crate::calibrate::rival_fields::{ensure_no_scaled_field_fits_better, ensure_none_is_better};
use crate::calibrate::two_robots::ensure_one_robot;
use crate::calibrate::unknown_field::find_sizes;
use crate::calibrate::{CalibrationError, listed_reasons};
use crate::config::VisionConfig;
use crate::image::Image;

/// A camera and its map, found without prior knowledge.
#[derive(Debug, Clone)]
pub struct UnknownMirror {
    /// The camera: axis, rim, and forward image up.
    pub camera: CameraConfig,
    /// The rim. None if the images do not show it.
    pub rim: Option<Rim>,
    /// Share of the line points that a mirror of revolution explains, in the images of the search.
    pub search_share: f64,
    /// Map, poses and residuals.
    pub calibration: LinesCalibration,
}

/// Fewest line points of an image of the search.
const POINTS_MIN: usize = 40;

/// Images of the search: enough to tell mirrors apart.
const SEARCH_IMAGES: usize = 12;

/// The same if the sizes of the field are searched, too.
const SIZES_IMAGES: usize = 16;

/// Members of the family that are refined.
const REFINED: usize = 40;

/// The same when fields are compared: only large differences matter.
const FIELD_IMAGES: usize = 6;
const FIELD_REFINED: usize = 16;

/// Rounds of pose search and joint fit for each.
const REFINE_ROUNDS: usize = 3;

/// Time of a mirror's refinement, in those of a member of the family.
const REFINEMENT_WORK: usize = 11;

/// Another mirror explains the points as well if its odds of a point on a marking, times this, exceed those of the best.
const UNDECIDED_ODDS: f64 = 1.3;

/// Images that the map does not explain have a camera of their own from this score on.
const SECOND_CAMERA_SCORE: f64 = 0.75;

/// Share of the points that the mirror found by the search explains at least, before the joint fit. Right mirrors of seven
/// robots explain 0.56 to 0.99, wrong ones up to half: the fit could bend them to the images.
const SEARCH_SHARE_MIN: f64 = 0.53;

/// Ground farther than this is not calibrated by lines, metres.
const MAP_RANGE_MAX: f64 = 12.0;

/// Finds the map of a mirror of which nothing is known.
///
/// `other_fields`: named fields that are tried if the images fit this one badly. `progress` is called with the work done,
/// 0 to 1, from several threads.
pub fn calibrate_unknown_mirror(
    size_px: [usize; 2],
    field: &Field,
    other_fields: &[(String, Field)],
    images: &[NamedImage],
    vision_config: &VisionConfig,
    progress: &(dyn Fn(f32) + Sync),
) -> Result<UnknownMirror, CalibrationError> {
    let attempt = Attempt::new(size_px, field, images, vision_config)?;
    progress(0.05);
    let result = attempt.calibrate(field, images, vision_config, progress);
    let doubtful = match &result {
        Ok(found) => is_doubtful(&found.calibration),
        // On a wrong field one mirror may explain some of the images and another one the rest.
        Err(error) => matches!(
            error,
            CalibrationError::Undecided(_) | CalibrationError::TwoCameras { .. }
        ),
    };
    if doubtful {
        // The most frequent reason is the field file. The shorter search of the comparison may fail on the right field, so
        // a calibration that is otherwise accepted counts with its own score.
        let accepted = result
            .as_ref()
            .ok()
            .filter(|found| found.ensure_accepted().is_ok());
        let own = accepted.map_or(0.0, |found| found.search_share);
        attempt.ensure_no_better_field(field, other_fields, own)?;
    }
    let mut found = result?;
    found.ensure_accepted()?;
    ensure_no_scaled_field_fits_better(
        &found.calibration,
        &found.camera,
        field,
        other_fields,
        images,
        vision_config,
        &|done| progress(0.65 + 0.2 * done),
    )?;
    found.calibration.better_size = find_better_size(
        &found.calibration,
        &found.camera,
        field,
        images,
        vision_config,
    );
    progress(1.0);
    Ok(found)
}

/// A field whose sizes were found, and the camera on it.
#[derive(Debug, Clone)]
pub struct UnknownField {
    /// The field. Its scale is that in which the median size is that of the file.
    pub field: Field,
    /// The sizes that differ from those of the file, as edits of it.
    pub changed: Vec<String>,
    /// Sizes that the images do not tell, as edits of the file. They are what one of the fits that explain the images has.
    pub untold: Vec<String>,
    /// The others of `changed`.
    pub told: Vec<String>,
    /// The camera and its map.
    pub mirror: UnknownMirror,
}

/// As [`calibrate_unknown_mirror`] on a field whose sizes are not known, but near those of `field`, without other fields.
pub fn calibrate_unknown_field(
    size_px: [usize; 2],
    field: &Field,
    images: &[NamedImage],
    vision_config: &VisionConfig,
    progress: &(dyn Fn(f32) + Sync),
) -> Result<UnknownField, CalibrationError> {
    let attempt = Attempt::new(size_px, field, images, vision_config)?;
    let found = find_sizes(
        &choose_images(&attempt.all, SIZES_IMAGES),
        field,
        attempt.known_sizes(field),
        |share, best| odds(share) * UNDECIDED_ODDS > odds(best),
        &|done| progress(0.5 * done),
    )
    .ok_or_else(|| CalibrationError::Undecided("no mirror explains the line points".into()))?;
    let count = found.fields.len() as f32;
    let mut best: Option<(Field, UnknownMirror)> = None;
    let mut refused = CalibrationError::Undecided("no field explains the images".into());
    for (tried, sized) in found.fields.into_iter().enumerate() {
        let result = attempt.calibrate(&sized, images, vision_config, &|done| {
            progress(0.5 + 0.5 * (tried as f32 + done) / count);
        });
        let share = |mirror: &UnknownMirror| mirror.calibration.on_field_share;
        match result.and_then(UnknownMirror::with_certain_sizes) {
            Ok(mirror)
                if best
                    .as_ref()
                    .is_none_or(|(_, best)| share(&mirror) > share(best)) =>
            {
                best = Some((sized, mirror));
            }
            Ok(_) => {}
            Err(error) => refused = error,
        }
    }
    let (sized, mirror) = best.ok_or(refused)?;
    Ok(UnknownField::new(field, sized, &found.told, mirror))
}

impl UnknownField {
    /// `told`: the sizes that the images tell.
    fn new(configured: &Field, field: Field, told: &[FieldSize], mirror: UnknownMirror) -> Self {
        let (from, to) = (&configured.config, &field.config);
        let is_changed = |size: &FieldSize| size.get(from) != size.get(to);
        let texts = |of_told: bool| -> Vec<String> {
            let sizes = FieldSize::all(from).into_iter();
            sizes
                .filter(|size| told.contains(size) == of_told && (is_changed(size) || !of_told))
                .map(|size| size.text(from, to))
                .collect()
        };
        let changed = FieldSize::all(from).into_iter().filter(is_changed);
        UnknownField {
            changed: changed.map(|size| size.text(from, to)).collect(),
            told: texts(true),
            untold: texts(false),
            field,
            mirror,
        }
    }
}

impl UnknownMirror {
    /// Sizes that were found must explain about what right ones do, since free sizes explain more than given ones.
    fn with_certain_sizes(self) -> Result<Self, CalibrationError> {
        self.ensure_accepted()?;
        match self.calibration.on_field_share >= FOUND_SIZES_SHARE_MIN {
            true => Ok(self),
            false => Err(unexplained(&self.calibration)),
        }
    }

    fn ensure_accepted(&self) -> Result<(), CalibrationError> {
        ensure_field_explains(&self.calibration)?;
        if self.search_share < SEARCH_SHARE_MIN {
            return Err(CalibrationError::Undecided(format!(
                "the best mirror of the search explains {:.0} % of the line points. Take more images of one camera all over \
                 the field, with the centre circle and corners in view",
                100.0 * self.search_share
            )));
        }
        ensure_halves_agree(self.calibration.disagreement)
    }
}

/// Line points of the images that have enough of them; an error if there are too few such images.
fn search_images(
    camera: &CameraConfig,
    field: &Field,
    images: &[NamedImage],
    vision_config: &VisionConfig,
) -> Result<Vec<SearchImage>, CalibrationError> {
    let found = detect_line_pixels(camera, field.config.line_width, images, vision_config)?;
    let all: Vec<SearchImage> = found
        .iter()
        .enumerate()
        .filter(|(_, image)| image.points.len() >= POINTS_MIN)
        .map(|(index, image)| SearchImage {
            index,
            points: image.points.clone(),
        })
        .collect();
    if all.len() >= IMAGES_MIN {
        return Ok(all);
    }
    let reasons: Vec<String> = found
        .iter()
        .zip(images)
        .filter(|(found, _)| found.points.len() < POINTS_MIN)
        .map(|(found, image)| match &found.refused {
            Some(reason) => format!("{}: {reason}", image.name),
            None => format!("{}: {} line points", image.name, found.points.len()),
        })
        .take(3)
        .collect();
    Err(CalibrationError::TooFewImages {
        used: all.len(),
        total: images.len(),
        required: IMAGES_MIN,
        reasons: listed_reasons(&reasons),
    })
}

/// Puts the origin of the robot frame where the mirror's centre is, with forward up.
///
/// Markings and free poses do not determine the frame: the joint fit may shift and rotate it by centimetres.
fn fix_robot_frame(calibration: &mut LinesCalibration, rim_camera: &CameraConfig) {
    let transform = PlanarTransform::to_mirror_centre(&calibration.map, rim_camera);
    transform.apply_to_map(&mut calibration.map);
    for pose in calibration.poses.iter_mut().flatten() {
        *pose = transform.apply_to_pose(*pose);
    }
}

/// The camera before the axis is known: the rim's, else the image's centre.
fn start_camera([width_px, height_px]: [usize; 2], rim: Option<Rim>) -> CameraConfig {
    let (width, height) = (width_px as f32, height_px as f32);
    let (centre_px, radius) = match rim {
        Some(rim) => (rim.centre_px, rim.radius_px),
        // Without a visible rim the mirror fills the image, and its rim lies near the image's corners.
        None => (
            [(width - 1.0) / 2.0, (height - 1.0) / 2.0],
            0.5 * width.min(height) * 1.15,
        ),
    };
    CameraConfig {
        width_px,
        height_px,
        focal_px: None,
        centre_px,
        height: None,
        forward_deg: 90.0,
        flipped: true,
        outer_radius_px: Some(radius),
    }
}

/// What all searches of one set of images share.
struct Attempt {
    rim: Option<Rim>,
    /// Before the axis is known.
    camera: CameraConfig,
    rim_px: f64,
    /// Of the viewpoint above the ground, metres.
    height: f64,
    /// Least width of a line point, in line widths.
    width_ratio_min: f64,
    all: Vec<SearchImage>,
}

impl Attempt {
    fn new(
        size_px: [usize; 2],
        field: &Field,
        images: &[NamedImage],
        vision_config: &VisionConfig,
    ) -> Result<Self, CalibrationError> {
        let pictures: Vec<&Image> = images.iter().map(|image| &image.image).collect();
        let rim = find_rim(&pictures).ok();
        let camera = start_camera(size_px, rim);
        let all = search_images(&camera, field, images, vision_config)?;
        ensure_one_robot(images)?;
        Ok(Attempt {
            rim,
            rim_px: f64::from(camera.outer_radius_px.unwrap_or(1.0)),
            height: f64::from(vision_config.objects.viewpoint_height),
            width_ratio_min: f64::from(GUESS_WIDTH_SLACK * vision_config.lines.width_ratio_min),
            camera,
            all,
        })
    }

    fn calibrate(
        &self,
        field: &Field,
        images: &[NamedImage],
        vision_config: &VisionConfig,
        progress: &(dyn Fn(f32) + Sync),
    ) -> Result<UnknownMirror, CalibrationError> {
        let chosen = choose_images(&self.all, SEARCH_IMAGES);
        let step = |done: f32| progress(0.05 + 0.35 * done);
        let ranked = self.rank_models(&chosen, field, REFINED, &step);
        let model = self.decide(field, &ranked)?.model;
        let camera = CameraConfig {
            centre_px: model.centre_px(&self.camera),
            ..self.camera.clone()
        };
        let start = model.ground_map(&camera, MAP_RANGE_MAX);
        let mut calibration = refine_map(&camera, &start, field, images, vision_config)?;
        progress(0.53);
        self.separate_cameras(field, &calibration, images)?;
        calibration.disagreement =
            compare_halves(&camera, &start, field, images, vision_config, &calibration);
        progress(0.65);
        fix_robot_frame(&mut calibration, &self.camera);
        Ok(UnknownMirror {
            camera,
            rim: self.rim,
            search_share: ranked.first().map_or(0.0, |best| best.score),
            calibration,
        })
    }

    fn search<'m>(&self, field: &Field, markings: &'m Markings) -> MirrorSearch<'m> {
        MirrorSearch::new(field, markings, self.known_sizes(field))
    }

    fn known_sizes(&self, field: &Field) -> KnownSizes {
        KnownSizes {
            rim_px: self.rim_px,
            viewpoint_height: self.height,
            line_width_min: self.width_ratio_min * f64::from(field.config.line_width),
        }
    }

    /// Plausible mirrors for some images, by the share of the points that they explain; of the family's best members.
    fn rank_models(
        &self,
        chosen: &[SearchImage],
        field: &Field,
        refined: usize,
        progress: &(dyn Fn(f32) + Sync),
    ) -> Vec<MirrorHypothesis> {
        let markings = Markings::new(field);
        let search = self.search(field, &markings);
        let work = AtomicUsize::new(0);
        let total = search.family_size() + REFINEMENT_WORK * refined;
        let done = |steps: usize| {
            let done = steps + work.fetch_add(steps, Ordering::Relaxed);
            progress(done as f32 / total as f32);
        };
        let family = search.search_family(chosen, &|| done(1));
        let mut plausible: Vec<MirrorHypothesis> = family
            .into_par_iter()
            .take(refined)
            .filter_map(|hypothesis| {
                let refined = search.refine_repeatedly(hypothesis, chosen, REFINE_ROUNDS);
                done(REFINEMENT_WORK);
                let [inner, outer] = refined.radii_px;
                refined.model.is_plausible(inner, outer).then_some(refined)
            })
            .collect();
        plausible.sort_by(|a, b| b.score.total_cmp(&a.score));
        plausible
    }

    /// The best of the ranked mirrors, refined with all images; an error if another one explains the points as well.
    fn decide(
        &self,
        field: &Field,
        ranked: &[MirrorHypothesis],
    ) -> Result<MirrorHypothesis, CalibrationError> {
        let Some(first) = ranked.first() else {
            return Err(CalibrationError::Undecided(
                "no mirror explains the line points. Take more images all over the field".into(),
            ));
        };
        let markings = Markings::new(field);
        let search = self.search(field, &markings);
        let best = search.locate_and_refine(&first.model, &self.all);
        // With few images two mirrors may differ that are one with all of them.
        let mut tried = vec![first];
        for other in &ranked[1..] {
            if !explains_as_well(other, first) || tried.iter().any(|it| other.is_similar_to(it)) {
                continue;
            }
            tried.push(other);
            let rival = search.locate_and_refine(&other.model, &self.all);
            if explains_as_well(&rival, &best) && !rival.is_similar_to(&best) {
                return Err(undecided(&best, &rival));
            }
        }
        Ok(best)
    }

    /// An error if one of the other fields explains the images better, by a shorter search for all of them. `own`: share
    /// that the given field explains at least.
    fn ensure_no_better_field(
        &self,
        field: &Field,
        others: &[(String, Field)],
        own: f64,
    ) -> Result<(), CalibrationError> {
        let chosen = choose_images(&self.all, FIELD_IMAGES);
        let score = |field: &Field| {
            let ranked = self.rank_models(&chosen, field, FIELD_REFINED, &|_| ());
            ranked.first().map_or(0.0, |best| best.score)
        };
        let own = score(field).max(own);
        let scores = others
            .iter()
            .map(|(name, other)| (name.as_str(), score(other)));
        ensure_none_is_better(
            own,
            scores.filter(|(_, score)| *score >= SEARCH_SHARE_MIN),
            "",
        )
    }

    /// An error if images that the map does not explain have a map of their own.
    fn separate_cameras(
        &self,
        field: &Field,
        calibration: &LinesCalibration,
        images: &[NamedImage],
    ) -> Result<(), CalibrationError> {
        let is_used = |index: usize| calibration.images[index].left_out.is_none();
        // Of many images some are not needed: only those that the fit tried say something.
        let is_refused =
            |index: usize| !is_used(index) && calibration.images[index].rms_px.is_finite();
        let left: Vec<SearchImage> = self
            .all
            .iter()
            .filter(|image| is_refused(image.index))
            .cloned()
            .collect();
        if left.len() < IMAGES_MIN {
            return Ok(());
        }
        let chosen = choose_images(&left, FIELD_IMAGES);
        let ranked = self.rank_models(&chosen, field, FIELD_REFINED, &|_| ());
        if ranked
            .first()
            .is_none_or(|found| found.score < SECOND_CAMERA_SCORE)
        {
            return Ok(());
        }
        let name = |index: usize| images[index].name.clone();
        Err(CalibrationError::TwoCameras {
            sign: "no map explains both".into(),
            first: (0..images.len())
                .filter(|&i| is_used(i))
                .map(name)
                .collect(),
            second: left.iter().map(|image| name(image.index)).collect(),
        })
    }
}

/// True if the odds of a point on a marking are nearly those by another mirror, or better.
fn explains_as_well(mirror: &MirrorHypothesis, other: &MirrorHypothesis) -> bool {
    odds(mirror.score) * UNDECIDED_ODDS > odds(other.score)
}

fn undecided(best: &MirrorHypothesis, rival: &MirrorHypothesis) -> CalibrationError {
    CalibrationError::Undecided(format!(
        "two mirrors explain them alike, with ranges of {} ({:.0} % of the points) and {} ({:.0} %). Take images with \
         the centre circle and corners in view",
        best.model.describe(),
        100.0 * best.score,
        rival.model.describe(),
        100.0 * rival.score
    ))
}

/// Images of the search: evenly over the recording, of those with many line points.
fn choose_images(all: &[SearchImage], count: usize) -> Vec<SearchImage> {
    let mut order: Vec<&SearchImage> = all.iter().collect();
    order.sort_by_key(|image| std::cmp::Reverse(image.points.len()));
    order.truncate((2 * order.len() / 3).max(count));
    order.sort_by_key(|image| image.index);
    let step = order.len().div_ceil(count).max(1);
    order.into_iter().step_by(step).cloned().collect()
}
