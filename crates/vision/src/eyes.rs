//! What does this frame show? The tables of one camera and map, and the way from a frame to everything seen in it.

mod light;

use std::sync::Arc;

use crate::ball::{Ball, BallSearch, Visited};
use crate::carpet::CarpetModel;
use crate::classify::ClassReader;
use crate::colours::{Class, NativeTable};
use crate::config::{VisionConfig, Window};
use crate::error::VisionError;
use crate::foot::Floor;
use crate::goals::{Goal, goals};
use crate::ground_map::GroundMap;
use crate::image::Frame;
use crate::judge::Judge;
use crate::labels::ColourTable;
use crate::line_points::{Reading, RefusedRun, Scratch, SeenLinePoint, line_points};
use crate::rays::{RaySight, Rays};
use crate::reach::Reach;
use crate::read::BrightnessReader;
use crate::robots::{Robot, robots};
use crate::scan::ScanPattern;
use crate::transitions::wall_feet;
use crate::windows::{WindowReadings, Windows};
use localize::robot::CameraConfig;

use light::Light;

/// Everything that one frame shows.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Seen {
    /// Points of the field's markings.
    pub line_points: Vec<SeenLinePoint>,
    /// Runs that look like a line and are none.
    pub refused: Vec<RefusedRun>,
    /// The ball.
    pub ball: Option<Ball>,
    /// Robots, and legs of people.
    pub robots: Vec<Robot>,
    /// Goals and posts.
    pub goals: Vec<Goal>,
    /// What the virtual sensors say.
    pub windows: WindowReadings,
    /// Where the carpet ends in each direction around the mirror's axis, metres (infinite: not seen); the first is
    /// image right, then towards image up.
    pub carpet_end: Vec<f32>,
    /// Share of the scanned pixels that are carpet.
    pub carpet_share: f32,
    /// True if the colours were learned anew from this frame.
    pub learned: bool,
}

/// The carpet's share is counted over each so manieth sample: thousands are left, which tell it to a percent.
const SHARE_STEP: usize = 16;

/// So many rows are read by one reader and then by the next: what the first fetched is in the core's cache for the others.
const BAND_ROWS: usize = 4;

/// The eyes of one robot: tables of its camera and map, and the colours of the light it is in.
#[derive(Debug, Clone)]
pub struct Eyes {
    map: GroundMap,
    config: VisionConfig,
    line_width: f32,
    pattern: ScanPattern,
    /// Column and row of each of the pattern's samples, together in memory.
    places: Vec<[u16; 2]>,
    brightness: BrightnessReader,
    reach: Reach,
    /// Reads all of the pattern's samples.
    every: ClassReader,
    /// Reads each [`SHARE_STEP`]th of them.
    some: ClassReader,
    some_classes: Vec<Class>,
    rays: Rays,
    visited: Visited,
    windows: Windows,
    centre_px: [f32; 2],
    labelled: Option<Arc<ColourTable>>,
    light: Option<Light>,
    classes: Vec<Class>,
    thresholds: Vec<u8>,
    scratch: Scratch,
}

impl Eyes {
    /// Builds the tables; `line_width` of the field's markings in metres.
    pub fn new(
        map: &GroundMap,
        camera: &CameraConfig,
        line_width: f32,
        config: VisionConfig,
    ) -> Result<Self, VisionError> {
        Eyes::with_mask(map, camera, None, line_width, config)
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
        let size = |found_width_px, found_height_px| VisionError::Size {
            found_width_px,
            found_height_px,
            wanted_width_px: map.width_px,
            wanted_height_px: map.height_px,
        };
        if (camera.width_px, camera.height_px) != (map.width_px, map.height_px) {
            return Err(size(camera.width_px, camera.height_px));
        }
        if let Some(mask) = mask.filter(|mask| mask.len() != map.x.len()) {
            return Err(size(mask.len() / map.height_px.max(1), map.height_px));
        }
        if !(line_width.is_finite() && line_width > 0.0) {
            return Err(VisionError::Config {
                key: "line_width",
                value: f64::from(line_width),
                reason: "must be positive",
            });
        }
        let pattern = ScanPattern::new(map, camera, mask, line_width, &config.scan);
        if pattern.samples.is_empty() {
            return Err(VisionError::Config {
                key: "scan.range_max",
                value: f64::from(config.scan.range_max),
                reason: "no pixel of the map shows ground within range",
            });
        }
        let rays = Rays::new(map, camera, mask, config.scan.range_min, &config.objects);
        let places: Vec<[u16; 2]> = pattern.samples.iter().map(|s| [s.u, s.v]).collect();
        let some: Vec<[u16; 2]> = places.iter().copied().step_by(SHARE_STEP).collect();
        Ok(Eyes {
            map: map.clone(),
            brightness: BrightnessReader::new(&places, map.width_px, map.height_px),
            reach: Reach::new(&pattern, rays.count()),
            every: ClassReader::new(&places, map.height_px),
            some_classes: vec![Class::OTHER; some.len()],
            some: ClassReader::new(&some, map.height_px),
            places,
            rays,
            visited: Visited::default(),
            windows: Windows::new(map, camera, &config.windows)?,
            centre_px: camera.centre_px,
            classes: vec![Class::OTHER; pattern.samples.len()],
            thresholds: Vec::new(),
            scratch: Scratch::default(),
            config,
            line_width,
            pattern,
            labelled: None,
            light: None,
        })
    }

    /// Takes classes from a table learned from labels; brightness and noise are still learned from the images.
    pub fn set_colours(&mut self, table: ColourTable) {
        self.labelled = Some(Arc::new(table));
        self.light = None;
    }

    /// The pixels that are read.
    pub fn pattern(&self) -> &ScanPattern {
        &self.pattern
    }

    /// The virtual sensors' windows with their names: bumper, goal, ball, kick, lens.
    pub fn windows(&self) -> &[(&'static str, Window)] {
        self.windows.laid()
    }

    /// The classes of the pattern's samples in a frame, one a sample, under the light of the frame that was seen last.
    pub fn classify(&mut self, frame: &Frame<'_>) -> Result<&[Class], VisionError> {
        frame.check(self.map.width_px, self.map.height_px)?;
        if let Some(light) = self.light.take() {
            self.read_every(frame, &light.table);
            self.light = Some(light);
        }
        Ok(&self.classes)
    }

    /// Carpet and white under the present light, once a frame was seen.
    pub fn carpet_model(&self) -> Option<&CarpetModel> {
        self.light.as_ref().map(|light| &light.model)
    }

    /// Forgets the light, so that the next frame is learned from: for single images that do not follow each other.
    pub fn forget_light(&mut self) {
        self.light = None;
    }

    /// Everything that a frame shows; the first frame, and one in quite another light, is learned from first.
    pub fn see(&mut self, frame: &Frame<'_>) -> Result<Seen, VisionError> {
        let (mut light, sights, mut seen) = self.adapt(frame)?;
        self.find_lines(frame, &light, &mut seen);
        self.find_objects(frame, &light, &sights, &mut seen);
        self.follow(frame, &mut light, &seen);
        self.find_walls(frame, &light, &mut seen);
        self.light = Some(light);
        Ok(seen)
    }

    /// As [`Eyes::see`], but for line points alone: what localisation needs.
    pub fn see_lines(&mut self, frame: &Frame<'_>) -> Result<Seen, VisionError> {
        let (mut light, _, mut seen) = self.adapt(frame)?;
        self.find_lines(frame, &light, &mut seen);
        self.follow(frame, &mut light, &seen);
        self.find_walls(frame, &light, &mut seen);
        self.light = Some(light);
        Ok(seen)
    }

    /// Segments the frame under the light known so far, or learned from it.
    fn adapt(&mut self, frame: &Frame<'_>) -> Result<(Light, Vec<RaySight>, Seen), VisionError> {
        frame.check(self.map.width_px, self.map.height_px)?;
        let mut seen = Seen::default();
        // What was learned where no line was seen may be anything: a hand before the camera, a dark corner.
        let light = self
            .light
            .take()
            .filter(|light| light.format == frame.format && light.model.white_seen);
        let known = match light {
            Some(light) => {
                let share = self.read(frame, &light);
                (share >= self.config.colours.relearn_below * light.carpet_share)
                    .then_some((light, share))
            }
            None => None,
        };
        let (light, share) = match known {
            Some(known) => known,
            None => {
                seen.learned = true;
                self.learn(frame)?
            }
        };
        seen.carpet_share = share;
        let sights = self.sights(&mut seen);
        Ok((light, sights, seen))
    }

    /// Reads brightness and rays; returns the share of samples that are carpet.
    fn read(&mut self, frame: &Frame<'_>, light: &Light) -> f32 {
        let classes = &mut self.some_classes;
        for start in (0..frame.height_px).step_by(BAND_ROWS) {
            let rows = start..(start + BAND_ROWS).min(frame.height_px);
            self.brightness.read(frame, light.weights, &rows);
            self.some.read(frame, &light.table, &rows, classes);
            self.rays.read(frame, &light.table, &rows);
        }
        let carpet = classes.iter().filter(|&&class| class == Class::CARPET);
        carpet.count() as f32 / classes.len() as f32
    }

    /// Classifies all of the pattern's samples.
    fn read_every(&mut self, frame: &Frame<'_>, table: &NativeTable) {
        let all = 0..frame.height_px;
        self.every.read(frame, table, &all, &mut self.classes);
    }

    /// Follows the rays to the carpet's end.
    fn sights(&self, seen: &mut Seen) -> Vec<RaySight> {
        let sights = self.rays.sights(&self.config.objects);
        seen.carpet_end = sights.iter().map(|sight| sight.end).collect();
        sights
    }

    fn find_objects(
        &mut self,
        frame: &Frame<'_>,
        light: &Light,
        sights: &[RaySight],
        seen: &mut Seen,
    ) {
        let floor = Floor {
            frame,
            map: &self.map,
            table: &light.table,
            centre_px: self.centre_px,
        };
        seen.robots = robots(&self.rays, sights, &floor, &self.config.objects);
        seen.goals = goals(&self.rays, sights, &self.config.objects);
        let search = BallSearch {
            frame,
            map: &self.map,
            table: &light.table,
            config: &self.config.objects,
            carpet_end: &seen.carpet_end,
            centre_px: self.centre_px,
        };
        let seeds = self.rays.of_class(Class::BALL);
        let seeds = seeds
            // The near part of a ball seems to lie no farther than it is.
            .filter(|(turns, sample)| !search.beyond_carpet(*turns, sample.range / 1.5))
            .map(|(_, sample)| [sample.u, sample.v]);
        seen.ball = search.best(seeds, &mut self.visited);
        let ball_px = seen.ball.map(|ball| ball.at_px);
        seen.windows = self.windows.read(frame, &light.table, ball_px);
    }

    fn find_lines(&mut self, frame: &Frame<'_>, light: &Light, seen: &mut Seen) {
        let mut scratch = std::mem::take(&mut self.scratch);
        let (points, refused) = (&mut seen.line_points, &mut seen.refused);
        let judge = self.judge(frame, light, &seen.carpet_end);
        line_points(&self.reading(), &judge, &mut scratch, points, refused);
        self.scratch = scratch;
    }

    /// The feet of walls, where they are wanted.
    fn find_walls(&self, frame: &Frame<'_>, light: &Light, seen: &mut Seen) {
        if self.config.lines.walls {
            let judge = self.judge(frame, light, &seen.carpet_end);
            wall_feet(&self.reading(), &judge, &mut seen.line_points);
        }
    }

    fn reading(&self) -> Reading<'_> {
        Reading {
            pattern: &self.pattern,
            reach: &self.reach,
            places: &self.places,
            brightness: &self.brightness,
            thresholds: &self.thresholds,
        }
    }

    fn judge<'a>(
        &'a self,
        frame: &'a Frame<'a>,
        light: &'a Light,
        carpet_end: &'a [f32],
    ) -> Judge<'a> {
        Judge {
            frame,
            table: &light.table,
            model: &light.model,
            config: &self.config.lines,
            line_width: self.line_width,
            noise: light.noise,
            carpet_end,
        }
    }
}
