//! The vision pipeline: precomputed tables of one camera and map, and the stages from an image to its detections.

mod colour_model;
mod detections;
mod learning;
mod stages;

use std::sync::Arc;

use crate::colour::adaptation::CarpetSample;
use crate::colour::carpet_model::CarpetModel;
use crate::colour::colour_table::ColourTable;
use crate::colour::lookup_table::{ColourClass, ColourLookupTable};
use crate::colour::pixel_classifier::PixelClassifier;
use crate::config::{ImageRect, VisionConfig};
use crate::error::VisionError;
use crate::image::ImageView;
use crate::lines::detection::LineScratch;
use crate::lines::validator::WhiteKnowledge;
use crate::objects::ball::VisitedMask;
use crate::objects::carpet_end::{CarpetEnd, find_carpet_ends};
use crate::objects::goals::detect_goals;
use crate::objects::own_body::OwnBody;
use crate::objects::pixel_stage::PixelStage;
use crate::objects::radial_scan::RadialScan;
use crate::objects::virtual_sensors::VirtualSensors;
use crate::optics::ground_map::GroundMap;
use crate::scan::brightness::BrightnessReader;
use crate::scan::limits::ScanLimits;
use crate::scan::pattern::{ScanLines, ScanPattern};
use localize::config::{SettingError, bound};
use localize::robot::CameraConfig;

pub use detections::Detections;

use colour_model::ColourModel;

/// The carpet share is measured on every n-th sample: thousands remain, which is exact to a percent.
const CARPET_SAMPLE_STRIDE: usize = 16;

/// All readers process this many rows before the next band, so that the band stays in the core's cache.
const BAND_ROWS: usize = 8;

/// What localization needs of an image, found before its objects are sought.
#[derive(Debug, Clone)]
pub struct FoundLines {
    /// Line points and goals; no objects yet.
    pub detections: Detections,
    /// The scan lines that were read.
    lines: ScanLines,
    /// Points of markings; base points of walls follow them.
    marking_points: usize,
    carpet_ends: Vec<CarpetEnd>,
}

/// The vision pipeline of one robot: tables of its camera and map, and the colour model of the present light.
///
/// Processes images in order; the colour model adapts from image to image.
#[derive(Debug, Clone)]
pub struct Vision {
    map: GroundMap,
    config: VisionConfig,
    line_width: f32,
    pattern: ScanPattern,
    /// Column and row of each of the pattern's samples, contiguous in memory.
    sample_pixels: Vec<[u16; 2]>,
    /// Their ground points, robot frame, metres, contiguous in memory.
    sample_ground: Vec<[f32; 2]>,
    brightness: BrightnessReader,
    scan_limits: ScanLimits,
    /// Classifies all of the pattern's samples.
    sample_classifier: PixelClassifier,
    /// Classifies every [`CARPET_SAMPLE_STRIDE`]-th sample.
    subsample_classifier: PixelClassifier,
    subsample_classes: Vec<ColourClass>,
    /// The same samples, contiguous in memory.
    carpet_samples: Vec<CarpetSample>,
    radial_scan: RadialScan,
    own_body: OwnBody,
    pixel_stage: PixelStage,
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
    /// Builds the tables; `line_width`: width of the field's markings, metres.
    pub fn new(
        map: &GroundMap,
        camera: &CameraConfig,
        line_width: f32,
        config: VisionConfig,
    ) -> Result<Self, VisionError> {
        Vision::with_mask(map, camera, None, line_width, config)
    }

    /// As [`Vision::new`], with a mask: one entry per pixel, row by row, false on the robot's own body and rods.
    pub fn with_mask(
        map: &GroundMap,
        camera: &CameraConfig,
        mask: Option<&[bool]>,
        line_width: f32,
        config: VisionConfig,
    ) -> Result<Self, VisionError> {
        config.check()?;
        let size = |width_px, height_px| VisionError::ImageSize {
            actual_width_px: width_px,
            actual_height_px: height_px,
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
            let shows_ground =
                |mask: &[bool]| (0..mask.len()).any(|at| mask[at] && map.x[at].is_finite());
            if mask.is_some_and(|mask| !shows_ground(mask)) {
                return Err(VisionError::MaskHidesGround);
            }
            if let Some(rim) = camera.outer_radius_px {
                let farthest = map.farthest_ground_within(camera.centre_px, rim);
                if farthest < config.scan.range_min {
                    return Err(VisionError::RimTooSmall {
                        outer_radius_px: rim,
                        farthest,
                        range_min: config.scan.range_min,
                    });
                }
            }
            let nearest = map.nearest_ground().max(config.scan.range_min);
            if nearest < config.scan.range_max {
                return Err(VisionError::NoScanLines { nearest });
            }
            return Err(SettingError {
                key: "vision.scan.range_max".to_owned(),
                value: f64::from(config.scan.range_max),
                min: f64::from(nearest),
                max: f64::INFINITY,
                why: "no pixel of the map shows ground within range",
            }
            .into());
        }
        let radial_scan =
            RadialScan::new(map, camera, mask, config.scan.range_min, &config.objects);
        let pixels: Vec<[u16; 2]> = pattern.samples.iter().map(|s| [s.u, s.v]).collect();
        let subsample: Vec<[u16; 2]> = pixels
            .iter()
            .copied()
            .step_by(CARPET_SAMPLE_STRIDE)
            .collect();
        Ok(Vision {
            map: map.clone(),
            brightness: BrightnessReader::new(&pattern, map.width_px, map.height_px),
            scan_limits: ScanLimits::new(&pattern, radial_scan.count()),
            sample_classifier: PixelClassifier::new(&pixels, map.height_px),
            carpet_samples: pattern
                .samples
                .iter()
                .step_by(CARPET_SAMPLE_STRIDE)
                .map(CarpetSample::new)
                .collect(),
            subsample_classes: vec![ColourClass::OTHER; subsample.len()],
            subsample_classifier: PixelClassifier::new(&subsample, map.height_px),
            sample_pixels: pixels,
            sample_ground: pattern.samples.iter().map(|s| s.ground).collect(),
            own_body: OwnBody::new(&radial_scan),
            radial_scan,
            pixel_stage: PixelStage::new(map, camera, mask, &config.objects),
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

    /// Uses a table learned from labels for classification; brightness and noise are still learned from images.
    pub fn set_colour_table(&mut self, table: ColourTable) {
        self.colour_table = Some(Arc::new(table));
        self.colour_model = None;
    }

    /// The pixels that line detection reads.
    pub fn scan_pattern(&self) -> &ScanPattern {
        &self.pattern
    }

    /// Regions of the virtual sensors with their names: bumper, goal, ball, kick, lens.
    pub fn virtual_sensor_regions(&self) -> &[(&'static str, ImageRect)] {
        self.virtual_sensors.regions()
    }

    /// Classifies the pattern's samples, one class per sample, with the colour model of the last processed image.
    ///
    /// Errors if the image has the wrong size or no colour model is learned.
    pub fn classify_samples(
        &mut self,
        image: &ImageView<'_>,
    ) -> Result<&[ColourClass], VisionError> {
        image.check(self.map.width_px, self.map.height_px)?;
        let Some(colour_model) = self.colour_model.take() else {
            return Err(VisionError::NoColourModel);
        };
        self.classify_all_samples(image, &colour_model.lookup_table);
        self.colour_model = Some(colour_model);
        Ok(&self.classes)
    }

    /// Colours of carpet and white in the present light. None before the first image.
    pub fn carpet_model(&self) -> Option<&CarpetModel> {
        self.colour_model
            .as_ref()
            .map(|colour_model| &colour_model.carpet_model)
    }

    /// Discards the colour model, so that it is learned from the next image: for images that are not a sequence.
    pub fn reset_colour_model(&mut self) {
        self.colour_model = None;
    }

    /// Detects lines and objects. Learns the colour model first if there is none or the light has changed much.
    pub fn process(&mut self, image: &ImageView<'_>) -> Result<Detections, VisionError> {
        self.process_with(image, ScanLines::All)
    }

    /// As [`Vision::process`], but reads these scan lines only: half of the line points in half of their time. An image
    /// from which colours are learned is read along all lines.
    pub fn process_with(
        &mut self,
        image: &ImageView<'_>,
        lines: ScanLines,
    ) -> Result<Detections, VisionError> {
        let found = self.find_lines(image, lines)?;
        Ok(self.find_objects(image, found))
    }

    /// As [`Vision::process_with`], but detects line points and goals only, as localization needs.
    pub fn process_lines_with(
        &mut self,
        image: &ImageView<'_>,
        lines: ScanLines,
    ) -> Result<Detections, VisionError> {
        let found = self.find_lines(image, lines)?;
        if let Some(mut colour_model) = self.colour_model.take() {
            self.adapt_colours(image, &mut colour_model, &found);
            self.colour_model = Some(colour_model);
        }
        Ok(found.detections)
    }

    /// Detects line points only, along all scan lines.
    pub fn process_lines(&mut self, image: &ImageView<'_>) -> Result<Detections, VisionError> {
        self.process_lines_with(image, ScanLines::All)
    }

    /// The first half of [`Vision::process_with`]: what localization needs.
    pub fn find_lines(
        &mut self,
        image: &ImageView<'_>,
        lines: ScanLines,
    ) -> Result<FoundLines, VisionError> {
        let (mut found, colour_model) = self.scan_image(image, lines)?;
        self.detect_lines(
            image,
            &colour_model,
            found.lines,
            WhiteKnowledge::Full,
            &mut found.detections,
        );
        found.marking_points = found.detections.line_points.len();
        self.detect_wall_bases(image, &colour_model, found.lines, &mut found.detections);
        found.detections.goals =
            detect_goals(&self.radial_scan, &found.carpet_ends, &self.config.objects);
        self.colour_model = Some(colour_model);
        Ok(found)
    }

    /// The second half of [`Vision::process_with`], of the same image: its objects. Then the colours adapt to its light.
    pub fn find_objects(&mut self, image: &ImageView<'_>, mut found: FoundLines) -> Detections {
        let Some(mut colour_model) = self.colour_model.take() else {
            return found.detections;
        };
        let (ends, detections) = (&found.carpet_ends, &mut found.detections);
        self.detect_objects(image, &colour_model, ends, detections);
        self.adapt_colours(image, &mut colour_model, &found);
        self.colour_model = Some(colour_model);
        found.detections
    }

    /// Reads brightness and classes with the present colour model, or with one learned from this image.
    fn scan_image(
        &mut self,
        image: &ImageView<'_>,
        lines: ScanLines,
    ) -> Result<(FoundLines, ColourModel), VisionError> {
        image.check(self.map.width_px, self.map.height_px)?;
        let mut detections = Detections::default();
        // Without a line the model is unreliable: it may be of a hand in front of the camera or of a dark corner.
        let colour_model = self.colour_model.take().filter(|colour_model| {
            colour_model.format == image.format && colour_model.carpet_model.white_measured
        });
        let usable = match colour_model {
            Some(colour_model) => {
                let share = self.read_scan(image, &colour_model, lines);
                (share
                    >= self.config.colours.relearn_carpet_share * colour_model.learned_carpet_share)
                    .then_some((colour_model, share))
            }
            None => None,
        };
        let (colour_model, share, lines) = match usable {
            Some((colour_model, share)) => (colour_model, share, lines),
            None => {
                detections.colours_learned = true;
                let (colour_model, share) = self.learn_colour_model(image)?;
                (colour_model, share, ScanLines::All)
            }
        };
        detections.carpet_share = share;
        let carpet_ends = self.find_carpet_ends(&mut detections);
        let found = FoundLines {
            detections,
            lines,
            marking_points: 0,
            carpet_ends,
        };
        Ok((found, colour_model))
    }

    /// Reads brightness and rays; returns the fraction of samples that are carpet.
    fn read_scan(
        &mut self,
        image: &ImageView<'_>,
        colour_model: &ColourModel,
        lines: ScanLines,
    ) -> f32 {
        let classes = &mut self.subsample_classes;
        for start in (0..image.height_px).step_by(BAND_ROWS) {
            let rows = start..(start + BAND_ROWS).min(image.height_px);
            // One band lies between, in whose time the rows arrive.
            image.prefetch_rows(rows.end + BAND_ROWS..rows.end + 2 * BAND_ROWS);
            self.brightness
                .read(image, colour_model.channel_weights, lines, &rows);
            self.subsample_classifier.classify_rows(
                image,
                &colour_model.lookup_table,
                &rows,
                classes,
            );
            self.radial_scan
                .read(image, &colour_model.lookup_table, &rows);
        }
        let carpet = classes
            .iter()
            .filter(|&&class| class == ColourClass::CARPET);
        carpet.count() as f32 / classes.len() as f32
    }

    /// Classifies all of the pattern's samples.
    fn classify_all_samples(&mut self, image: &ImageView<'_>, table: &ColourLookupTable) {
        let all = 0..image.height_px;
        self.sample_classifier
            .classify_rows(image, table, &all, &mut self.classes);
    }

    /// Finds the carpet's boundary along each ray.
    fn find_carpet_ends(&self, detections: &mut Detections) -> Vec<CarpetEnd> {
        let carpet_ends = find_carpet_ends(&self.radial_scan, &self.config.objects);
        detections.carpet_end = carpet_ends
            .iter()
            .map(|carpet_end| carpet_end.range)
            .collect();
        carpet_ends
    }
}
