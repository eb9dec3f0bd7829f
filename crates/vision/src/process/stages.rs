//! What is found in an image that was read? Lines, then objects, each by its detector with this camera's tables.

use crate::image::ImageView;
use crate::lines::detection::{ScanReadout, detect_line_points};
use crate::lines::validator::{LineValidator, WhiteKnowledge};
use crate::lines::wall_bases::detect_wall_bases;
use crate::objects::ball::BallDetector;
use crate::objects::carpet_end::CarpetEnd;
use crate::objects::ground_contact::GroundContactSearch;
use crate::objects::pixel_stage::PixelStageInput;
use crate::objects::robots::detect_robots;
use crate::scan::pattern::ScanLines;

use super::Vision;
use super::colour_model::ColourModel;
use super::detections::Detections;

impl Vision {
    pub(super) fn detect_objects(
        &mut self,
        image: &ImageView<'_>,
        colour_model: &ColourModel,
        carpet_ends: &[CarpetEnd],
        detections: &mut Detections,
    ) {
        let contact_search = GroundContactSearch {
            image,
            map: &self.map,
            lookup_table: &colour_model.lookup_table,
            centre_px: self.centre_px,
        };
        let robots = detect_robots(
            &self.radial_scan,
            carpet_ends,
            &self.own_body,
            &contact_search,
            &self.config.objects,
        );
        let stage_input = PixelStageInput {
            image,
            map: &self.map,
            lookup_table: &colour_model.lookup_table,
            chroma_table: colour_model.chroma_table.as_ref(),
            config: &self.config.objects,
        };
        let rejected = &mut detections.rejected_objects;
        let own_body = &self.own_body;
        let is_hidden = |turns, range| own_body.hides(turns, range);
        detections.robots = self.pixel_stage.detect_obstacles(
            stage_input,
            robots,
            &detections.carpet_end,
            is_hidden,
            rejected,
        );
        if self.pixel_stage.is_new_view() {
            self.own_body.add_view(&self.radial_scan);
        }
        let ball_detector = BallDetector {
            image,
            map: &self.map,
            lookup_table: &colour_model.lookup_table,
            config: &self.config.objects,
            carpet_end: &detections.carpet_end,
            centre_px: self.centre_px,
        };
        let (carpet_end, robots) = (&detections.carpet_end, &detections.robots);
        let mut balls = self
            .pixel_stage
            .detect_balls(stage_input, carpet_end, robots);
        if balls.is_empty() {
            // In the air, at the robot's feet, or farther than the network looks: the ball's colour finds it.
            let seeds = self.radial_scan.ball_seeds(&self.config.objects);
            let seeds = seeds
                .filter(|(turns, sample)| !ball_detector.is_beyond_carpet(*turns, sample.range))
                .map(|(_, sample)| [sample.u, sample.v]);
            let by_colour = ball_detector.detect(seeds, &mut self.visited_mask);
            let rejected = &mut detections.rejected_objects;
            balls.extend(by_colour.and_then(|ball| {
                self.pixel_stage
                    .judge_ball_by_colour(stage_input, ball, rejected)
            }));
        }
        let radius = self.config.objects.ball_radius;
        detections
            .robots
            .retain(|robot| !balls.iter().any(|ball| robot.is_ball(ball, radius)));
        let mut balls = balls.into_iter();
        detections.ball = balls.next();
        detections.other_balls = balls.collect();
        let ball_px = detections.ball.map(|ball| ball.position_px);
        detections.virtual_sensors =
            self.virtual_sensors
                .read(image, &colour_model.lookup_table, ball_px);
    }

    pub(super) fn detect_lines(
        &mut self,
        image: &ImageView<'_>,
        colour_model: &ColourModel,
        lines: ScanLines,
        white: WhiteKnowledge,
        detections: &mut Detections,
    ) {
        let mut scratch = std::mem::take(&mut self.scratch);
        let (points, rejected) = (
            &mut detections.line_points,
            &mut detections.rejected_candidates,
        );
        let validator = LineValidator {
            white,
            ..self.line_validator(image, colour_model, &detections.carpet_end)
        };
        detect_line_points(
            &self.scan_readout(lines),
            &validator,
            &mut scratch,
            points,
            rejected,
        );
        self.scratch = scratch;
    }

    /// Adds base points of walls if configured.
    pub(super) fn detect_wall_bases(
        &self,
        image: &ImageView<'_>,
        colour_model: &ColourModel,
        lines: ScanLines,
        detections: &mut Detections,
    ) {
        if self.config.lines.detect_wall_bases {
            let validator = self.line_validator(image, colour_model, &detections.carpet_end);
            detect_wall_bases(
                &self.scan_readout(lines),
                &validator,
                &mut detections.line_points,
            );
        }
    }

    fn scan_readout(&self, lines: ScanLines) -> ScanReadout<'_> {
        ScanReadout {
            lines,
            pattern: &self.pattern,
            limits: &self.scan_limits,
            pixels: &self.sample_pixels,
            ground: &self.sample_ground,
            brightness: &self.brightness,
            peak_thresholds: &self.peak_thresholds,
        }
    }

    fn line_validator<'a>(
        &'a self,
        image: &'a ImageView<'a>,
        colour_model: &'a ColourModel,
        carpet_end: &'a [f32],
    ) -> LineValidator<'a> {
        LineValidator {
            image,
            lookup_table: &colour_model.lookup_table,
            carpet_model: &colour_model.carpet_model,
            config: &self.config.lines,
            line_width: self.line_width,
            noise: colour_model.brightness_noise,
            carpet_end,
            white: WhiteKnowledge::Full,
        }
    }
}
