//! What does this frame show? The tables of one camera and map, and the way from a frame to everything seen in it.

mod learning;

use std::sync::Arc;

use crate::colour::carpet_model::CarpetModel;
use crate::colour::colour_table::ColourTable;
use crate::colour::lookup_table::{ColourClass, ColourLookupTable};
use crate::colour::pixel_classifier::PixelClassifier;
use crate::config::{ImageRect, VisionConfig};
use crate::error::VisionError;
use crate::image::ImageView;
use crate::lines::detection::{
    LinePointDetection, LineScratch, RejectedCandidate, ScanReadout, detect_line_points,
};
use crate::lines::validator::LineValidator;
use crate::lines::wall_bases::detect_wall_bases;
use crate::objects::ball::{BallDetection, BallDetector, VisitedMask};
use crate::objects::goals::{GoalDetection, detect_goals};
use crate::objects::ground_contact::GroundContactSearch;
use crate::objects::radial_scan::{CarpetEnd, RadialScan};
use crate::objects::robots::{RobotDetection, detect_robots};
use crate::objects::virtual_sensors::{VirtualSensorReadings, VirtualSensors};
use crate::optics::ground_map::GroundMap;
use crate::scan::brightness::BrightnessReader;
use crate::scan::limits::ScanLimits;
use crate::scan::pattern::ScanPattern;
use localize::config::{SettingError, bound};
use localize::robot::CameraConfig;

use learning::ColourModel;

/// Everything that one frame shows.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Detections {
    /// Points of the field's markings.
    pub line_points: Vec<LinePointDetection>,
    /// Runs that look like a line and are none.
    pub rejected_candidates: Vec<RejectedCandidate>,
    /// The ball.
    pub ball: Option<BallDetection>,
    /// Robots, and legs of people.
    pub robots: Vec<RobotDetection>,
    /// Goals and posts.
    pub goals: Vec<GoalDetection>,
    /// What the virtual sensors say.
    pub virtual_sensors: VirtualSensorReadings,
    /// Where the carpet ends in each direction around the mirror's axis, metres (infinite: not seen); the first is
    /// image right, then towards image up.
    pub carpet_end: Vec<f32>,
    /// Share of the scanned pixels that are carpet.
    pub carpet_share: f32,
    /// True if the colours were learned anew from this frame.
    pub colours_learned: bool,
}

/// The carpet's share is counted over each so manieth sample: thousands are left, which tell it to a percent.
const CARPET_SAMPLE_STRIDE: usize = 16;

/// So many rows are read by one reader and then by the next: what the first fetched is in the core's cache for the others.
const BAND_ROWS: usize = 4;

/// The eyes of one robot: tables of its camera and map, and the colours of the light it is in.
#[derive(Debug, Clone)]
pub struct Vision {
    map: GroundMap,
    config: VisionConfig,
    line_width: f32,
    pattern: ScanPattern,
    /// Column and row of each of the pattern's samples, together in memory.
    sample_pixels: Vec<[u16; 2]>,
    brightness: BrightnessReader,
    scan_limits: ScanLimits,
    /// Reads all of the pattern's samples.
    sample_classifier: PixelClassifier,
    /// Reads each [`SHARE_STEP`]th of them.
    subsample_classifier: PixelClassifier,
    subsample_classes: Vec<ColourClass>,
    radial_scan: RadialScan,
    visited_mask: VisitedMask,
    virtual_sensors: VirtualSensors,
    centre_px: [f32; 2],
    colour_table: Option<Arc<ColourTable>>,
    colour_model: Option<ColourModel>,
    classes: Vec<ColourClass>,
    peak_thresholds: Vec<u8>,
    scratch: LineScratch,
}

impl Vision {
    /// Builds the tables; `line_width` of the field's markings in metres.
    pub fn new(
        map: &GroundMap,
        camera: &CameraConfig,
        line_width: f32,
        config: VisionConfig,
    ) -> Result<Self, VisionError> {
        Vision::with_mask(map, camera, None, line_width, config)
    }

    /// As [`Eyes::new`], with a mask: one entry a pixel, row by row, false where the robot's own body and rods are.
    pub fn with_mask(
        map: &GroundMap,
        camera: &CameraConfig,
        mask: Option<&[bool]>,
        line_width: f32,
        config: VisionConfig,
    ) -> Result<Self, VisionError> {
        config.check()?;
        let size = |found_width_px, found_height_px| VisionError::ImageSize {
            actual_width_px: found_width_px,
            actual_height_px: found_height_px,
            expected_width_px: map.width_px,
            expected_height_px: map.height_px,
        };
        if (camera.width_px, camera.height_px) != (map.width_px, map.height_px) {
            return Err(size(camera.width_px, camera.height_px));
        }
        if let Some(mask) = mask.filter(|mask| mask.len() != map.x.len()) {
            return Err(size(mask.len() / map.height_px.max(1), map.height_px));
        }
        bound("", 0.001, 10.0, "width of the field's lines, metres")
            .check("line_width", f64::from(line_width))?;
        let pattern = ScanPattern::new(map, camera, mask, line_width, &config.scan);
        if pattern.samples.is_empty() {
            return Err(SettingError {
                key: "vision.scan.range_max".to_owned(),
                value: f64::from(config.scan.range_max),
                min: f64::from(map.nearest_ground()),
                max: f64::INFINITY,
                why: "no pixel of the map shows ground within range",
            }
            .into());
        }
        let rays = RadialScan::new(map, camera, mask, config.scan.range_min, &config.objects);
        let places: Vec<[u16; 2]> = pattern.samples.iter().map(|s| [s.u, s.v]).collect();
        let some: Vec<[u16; 2]> = places
            .iter()
            .copied()
            .step_by(CARPET_SAMPLE_STRIDE)
            .collect();
        Ok(Vision {
            map: map.clone(),
            brightness: BrightnessReader::new(&places, map.width_px, map.height_px),
            scan_limits: ScanLimits::new(&pattern, rays.count()),
            sample_classifier: PixelClassifier::new(&places, map.height_px),
            subsample_classes: vec![ColourClass::OTHER; some.len()],
            subsample_classifier: PixelClassifier::new(&some, map.height_px),
            sample_pixels: places,
            radial_scan: rays,
            visited_mask: VisitedMask::default(),
            virtual_sensors: VirtualSensors::new(map, camera, &config.virtual_sensors)?,
            centre_px: camera.centre_px,
            classes: vec![ColourClass::OTHER; pattern.samples.len()],
            peak_thresholds: Vec::new(),
            scratch: LineScratch::default(),
            config,
            line_width,
            pattern,
            colour_table: None,
            colour_model: None,
        })
    }

    /// Takes classes from a table learned from labels; brightness and noise are still learned from the images.
    pub fn set_colour_table(&mut self, table: ColourTable) {
        self.colour_table = Some(Arc::new(table));
        self.colour_model = None;
    }

    /// The pixels that are read.
    pub fn scan_pattern(&self) -> &ScanPattern {
        &self.pattern
    }

    /// The virtual sensors' windows with their names: bumper, goal, ball, kick, lens.
    pub fn virtual_sensor_regions(&self) -> &[(&'static str, ImageRect)] {
        self.virtual_sensors.regions()
    }

    /// The classes of the pattern's samples in a frame, one a sample, under the light of the frame that was seen last.
    pub fn classify_samples(
        &mut self,
        frame: &ImageView<'_>,
    ) -> Result<&[ColourClass], VisionError> {
        frame.check(self.map.width_px, self.map.height_px)?;
        if let Some(light) = self.colour_model.take() {
            self.classify_all_samples(frame, &light.lookup_table);
            self.colour_model = Some(light);
        }
        Ok(&self.classes)
    }

    /// Carpet and white under the present light, once a frame was seen.
    pub fn carpet_model(&self) -> Option<&CarpetModel> {
        self.colour_model.as_ref().map(|light| &light.carpet_model)
    }

    /// Forgets the light, so that the next frame is learned from: for single images that do not follow each other.
    pub fn reset_colour_model(&mut self) {
        self.colour_model = None;
    }

    /// Everything that a frame shows; the first frame, and one in quite another light, is learned from first.
    pub fn process(&mut self, frame: &ImageView<'_>) -> Result<Detections, VisionError> {
        let (mut light, sights, mut seen) = self.scan_image(frame)?;
        self.detect_lines(frame, &light, &mut seen);
        self.detect_objects(frame, &light, &sights, &mut seen);
        self.adapt_colours(frame, &mut light, &seen);
        self.detect_wall_bases(frame, &light, &mut seen);
        self.colour_model = Some(light);
        Ok(seen)
    }

    /// As [`Eyes::see`], but for line points alone: what localisation needs.
    pub fn process_lines(&mut self, frame: &ImageView<'_>) -> Result<Detections, VisionError> {
        let (mut light, _, mut seen) = self.scan_image(frame)?;
        self.detect_lines(frame, &light, &mut seen);
        self.adapt_colours(frame, &mut light, &seen);
        self.detect_wall_bases(frame, &light, &mut seen);
        self.colour_model = Some(light);
        Ok(seen)
    }

    /// Segments the frame under the light known so far, or learned from it.
    fn scan_image(
        &mut self,
        frame: &ImageView<'_>,
    ) -> Result<(ColourModel, Vec<CarpetEnd>, Detections), VisionError> {
        frame.check(self.map.width_px, self.map.height_px)?;
        let mut seen = Detections::default();
        // What was learned where no line was seen may be anything: a hand before the camera, a dark corner.
        let light = self
            .colour_model
            .take()
            .filter(|light| light.format == frame.format && light.carpet_model.white_measured);
        let known = match light {
            Some(light) => {
                let share = self.read_scan(frame, &light);
                (share >= self.config.colours.relearn_carpet_share * light.learned_carpet_share)
                    .then_some((light, share))
            }
            None => None,
        };
        let (light, share) = match known {
            Some(known) => known,
            None => {
                seen.colours_learned = true;
                self.learn_colour_model(frame)?
            }
        };
        seen.carpet_share = share;
        let sights = self.find_carpet_ends(&mut seen);
        Ok((light, sights, seen))
    }

    /// Reads brightness and rays; returns the share of samples that are carpet.
    fn read_scan(&mut self, frame: &ImageView<'_>, light: &ColourModel) -> f32 {
        let classes = &mut self.subsample_classes;
        for start in (0..frame.height_px).step_by(BAND_ROWS) {
            let rows = start..(start + BAND_ROWS).min(frame.height_px);
            self.brightness.read(frame, light.channel_weights, &rows);
            self.subsample_classifier
                .classify_rows(frame, &light.lookup_table, &rows, classes);
            self.radial_scan.read(frame, &light.lookup_table, &rows);
        }
        let carpet = classes
            .iter()
            .filter(|&&class| class == ColourClass::CARPET);
        carpet.count() as f32 / classes.len() as f32
    }

    /// Classifies all of the pattern's samples.
    fn classify_all_samples(&mut self, frame: &ImageView<'_>, table: &ColourLookupTable) {
        let all = 0..frame.height_px;
        self.sample_classifier
            .classify_rows(frame, table, &all, &mut self.classes);
    }

    /// Follows the rays to the carpet's end.
    fn find_carpet_ends(&self, seen: &mut Detections) -> Vec<CarpetEnd> {
        let sights = self.radial_scan.find_carpet_ends(&self.config.objects);
        seen.carpet_end = sights.iter().map(|sight| sight.range).collect();
        sights
    }

    fn detect_objects(
        &mut self,
        frame: &ImageView<'_>,
        light: &ColourModel,
        sights: &[CarpetEnd],
        seen: &mut Detections,
    ) {
        let floor = GroundContactSearch {
            image: frame,
            map: &self.map,
            lookup_table: &light.lookup_table,
            centre_px: self.centre_px,
        };
        seen.robots = detect_robots(&self.radial_scan, sights, &floor, &self.config.objects);
        seen.goals = detect_goals(&self.radial_scan, sights, &self.config.objects);
        let search = BallDetector {
            image: frame,
            map: &self.map,
            lookup_table: &light.lookup_table,
            config: &self.config.objects,
            carpet_end: &seen.carpet_end,
            centre_px: self.centre_px,
        };
        let seeds = self.radial_scan.samples_of_class(ColourClass::BALL);
        let seeds = seeds
            // The near part of a ball seems to lie no farther than it is.
            .filter(|(turns, sample)| !search.is_beyond_carpet(*turns, sample.range / 1.5))
            .map(|(_, sample)| [sample.u, sample.v]);
        seen.ball = search.detect(seeds, &mut self.visited_mask);
        let ball_px = seen.ball.map(|ball| ball.position_px);
        seen.virtual_sensors = self
            .virtual_sensors
            .read(frame, &light.lookup_table, ball_px);
    }

    fn detect_lines(&mut self, frame: &ImageView<'_>, light: &ColourModel, seen: &mut Detections) {
        let mut scratch = std::mem::take(&mut self.scratch);
        let (points, refused) = (&mut seen.line_points, &mut seen.rejected_candidates);
        let judge = self.line_validator(frame, light, &seen.carpet_end);
        detect_line_points(&self.scan_readout(), &judge, &mut scratch, points, refused);
        self.scratch = scratch;
    }

    /// The feet of walls, where they are wanted.
    fn detect_wall_bases(&self, frame: &ImageView<'_>, light: &ColourModel, seen: &mut Detections) {
        if self.config.lines.detect_wall_bases {
            let judge = self.line_validator(frame, light, &seen.carpet_end);
            detect_wall_bases(&self.scan_readout(), &judge, &mut seen.line_points);
        }
    }

    fn scan_readout(&self) -> ScanReadout<'_> {
        ScanReadout {
            pattern: &self.pattern,
            limits: &self.scan_limits,
            pixels: &self.sample_pixels,
            brightness: &self.brightness,
            peak_thresholds: &self.peak_thresholds,
        }
    }

    fn line_validator<'a>(
        &'a self,
        frame: &'a ImageView<'a>,
        light: &'a ColourModel,
        carpet_end: &'a [f32],
    ) -> LineValidator<'a> {
        LineValidator {
            image: frame,
            lookup_table: &light.lookup_table,
            carpet_model: &light.carpet_model,
            config: &self.config.lines,
            line_width: self.line_width,
            noise: light.noise,
            carpet_end,
        }
    }
}
