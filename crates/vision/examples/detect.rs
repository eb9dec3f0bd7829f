//! Detections of a recording folder: overlays as PNG, and scores if truth.csv exists.
//!
//! `cargo run --release -p vision --example detect -- FOLDER [OUT_FOLDER]`

use std::error::Error;
use std::path::{Path, PathBuf};

use localize::robot::{CameraConfig, DEFAULT_VIEWPOINT_HEIGHT};
use localize::{Field, Pose};
use vision::overlay;
use vision::{GroundMap, Image, Mount, Profile, Vision, VisionConfig, optics};

#[derive(serde::Deserialize)]
struct Robot {
    field: PathBuf,
    camera: CameraConfig,
    mirror: Option<Mirror>,
    map: Option<MapFile>,
}

#[derive(serde::Deserialize)]
struct Mirror {
    profile: PathBuf,
}

#[derive(serde::Deserialize)]
struct MapFile {
    file: PathBuf,
}

#[expect(clippy::too_many_lines, reason = "a script, from top to bottom")]
fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args_os().skip(1).map(PathBuf::from);
    let folder = arguments
        .next()
        .ok_or("usage: detect FOLDER [OUT_FOLDER]")?;
    let out = arguments.next();
    let robot: Robot = toml::from_str(&std::fs::read_to_string(folder.join("robot.toml"))?)?;
    let field = Field::load(&folder.join(&robot.field))?;
    let map = match (&robot.map, &robot.mirror) {
        (Some(map), _) => GroundMap::load(&folder.join(&map.file))?,
        (None, Some(mirror)) => {
            let profile = Profile::load(&folder.join(&mirror.profile))?;
            optics::trace_rays(&robot.camera, &profile, &Mount::default())?.ground_map()
        }
        (None, None) => return Err("robot.toml: missing [map] or [mirror]".into()),
    };
    let mut vision = Vision::new(
        &map,
        &robot.camera,
        field.config.line_width,
        VisionConfig::default(),
    )?;
    println!(
        "{} samples, {} pixels, {:.1} %",
        vision.scan_pattern().samples.len(),
        vision.scan_pattern().pixel_count,
        100.0 * vision.scan_pattern().coverage
    );
    let single = !folder.join("odometry.csv").exists();
    let truth = load_poses(&folder.join("truth.csv"))?;
    let mut total = Score::default();
    let mut reader = csv::Reader::from_path(folder.join("frames.csv"))?;
    for (index, record) in reader.records().enumerate() {
        let record = record?;
        let image = Image::load(&folder.join(&record[1]))?;
        if single {
            vision.reset_colour_model();
        }
        let detections = vision.process(&image.view())?;
        let score = truth
            .get(index)
            .map(|&pose| Score::evaluate(&detections, pose, &field));
        println!(
            "{}: {} line points, {} rejected, carpet {:.2}{} {}",
            &record[1],
            detections.line_points.len(),
            detections.rejected_candidates.len(),
            detections.carpet_share,
            if detections.colours_learned {
                " learned"
            } else {
                ""
            },
            score.as_ref().map_or(String::new(), Score::summary),
        );
        for ball in detections.ball.iter().chain(&detections.other_balls) {
            let [u, v] = ball.position_px;
            println!(
                "   ball {:.2} {:.2} score {:.2} {} px {} ground at {u:.0} {v:.0}",
                ball.at.x, ball.at.y, ball.score, ball.pixels, ball.on_ground
            );
        }
        for robot in &detections.robots {
            let [u, v] = robot.position_px;
            println!(
                "   {:?} {:.2} {:.2} edge {:.2} width {:.2} {:?} score {:.2} at {u:.0} {v:.0}",
                robot.kind,
                robot.at.x,
                robot.at.y,
                robot.edge.distance(),
                robot.width,
                robot.marker,
                robot.score
            );
        }
        for rejected in &detections.rejected_objects {
            let [u, v] = rejected.position_px;
            println!(
                "   {:?} {:.2} at {u:.0} {v:.0}",
                rejected.reason, rejected.probability
            );
        }
        for goal in &detections.goals {
            println!(
                "   goal {:?} {:.2} {:.2} width {:.2} score {:.2}",
                goal.kind, goal.at.x, goal.at.y, goal.width, goal.score
            );
        }
        if detections.colours_learned {
            println!("   {:?}", vision.carpet_model());
        }
        if let Some(score) = score {
            total.add(&score);
        }
        if let Some(out) = &out {
            save_overlays(
                out,
                &record[1],
                &image,
                &map,
                &mut vision,
                &detections,
                truth.get(index),
                &field,
            )?;
        }
    }
    println!("all: {}", total.summary());
    Ok(())
}

#[expect(clippy::too_many_arguments, reason = "one caller")]
fn save_overlays(
    out: &Path,
    file: &str,
    image: &Image,
    map: &GroundMap,
    vision: &mut Vision,
    detections: &vision::Detections,
    pose: Option<&Pose>,
    field: &Field,
) -> Result<(), Box<dyn Error>> {
    std::fs::create_dir_all(out)?;
    let name = Path::new(file).file_stem().ok_or("missing file name")?;
    let mut drawn = overlay::upscale(image, 2);
    if let Some(&pose) = pose {
        let upright = overlay::FieldView {
            map,
            tilt: [0.0; 2],
            viewpoint_height: DEFAULT_VIEWPOINT_HEIGHT,
            pose,
        };
        overlay::draw_field(&mut drawn, 2, upright, &field.markings);
    }
    overlay::draw_carpet_end(&mut drawn, 2, vision.scan_pattern(), detections);
    overlay::draw_detections(&mut drawn, 2, detections);
    drawn.save(&out.join(name).with_extension("png"))?;
    let mut points = csv::Writer::from_path(out.join(name).with_extension("csv"))?;
    points.write_record([
        "u_px",
        "v_px",
        "x_m",
        "y_m",
        "std_radial_m",
        "width_m",
        "contrast",
    ])?;
    for point in &detections.line_points {
        let [u, v] = point.position_px;
        let (at, std) = (point.point.at, point.point.std_radial);
        points.serialize([u, v, at.x, at.y, std, point.width, point.contrast])?;
    }
    points.flush()?;
    let mut classes = overlay::upscale(image, 2);
    let of_samples = vision.classify_samples(&image.view())?.to_vec();
    for (sample, class) in vision.scan_pattern().samples.iter().zip(of_samples) {
        let colour = overlay::class_colour(class);
        let (u, v) = (2 * i64::from(sample.u), 2 * i64::from(sample.v));
        overlay::draw_pixel(&mut classes, u, v, colour);
        overlay::draw_pixel(&mut classes, u + 1, v, colour);
        overlay::draw_pixel(&mut classes, u, v + 1, colour);
    }
    let name = format!("{}_classes.png", name.display());
    classes.save(&out.join(name))?;
    Ok(())
}

fn load_poses(path: &Path) -> Result<Vec<Pose>, Box<dyn Error>> {
    if !path.exists() {
        return Ok(Vec::new());
    }
    let mut poses = Vec::new();
    for record in csv::Reader::from_path(path)?.records() {
        let record = record?;
        poses.push(Pose::new(
            record[1].parse()?,
            record[2].parse()?,
            record[3].parse()?,
        ));
    }
    Ok(poses)
}

#[derive(Default)]
struct Score {
    /// Points within 5 m, and those within max(5 cm, 2 pixels) of a true line; points within 4 m, and those within 10 cm.
    points: usize,
    correct: usize,
    near_points: usize,
    near_correct: usize,
    /// Marking points at 0.4 to 4 m, and those with a correct line point nearby.
    marking_points: usize,
    covered_points: usize,
}

/// Spacing of marking points, metres; one is covered if a correct line point is within `COVERAGE_RADIUS`.
const MARKING_STEP: f32 = 0.05;
const COVERAGE_RADIUS: f32 = 0.25;

impl Score {
    fn evaluate(detections: &vision::Detections, pose: Pose, field: &Field) -> Self {
        let mut score = Score::default();
        let mut good = Vec::new();
        for point in &detections.line_points {
            let at = point.point.at;
            let off = field
                .markings
                .iter()
                .map(|marking| overlay::marking_distance(marking, pose * at))
                .fold(f32::INFINITY, f32::min);
            let pixel = 2.0 * point.point.std_radial.max(point.point.std_tangential);
            let right = off <= (2.0 * pixel).max(0.05);
            if right {
                good.push(pose * at);
            }
            if at.distance() <= 5.0 {
                score.points += 1;
                score.correct += usize::from(right);
            }
            if at.distance() <= 4.0 {
                score.near_points += 1;
                score.near_correct += usize::from(off <= 0.1);
            }
        }
        for at in localize::field::marking_points(&field.markings, MARKING_STEP) {
            let seen_from = pose.inverse() * at;
            let range = seen_from.distance();
            if !(0.4..=4.0).contains(&range) {
                continue;
            }
            score.marking_points += 1;
            score.covered_points += usize::from(
                good.iter()
                    .any(|point| point.distance_to(at) <= COVERAGE_RADIUS),
            );
        }
        score
    }

    fn add(&mut self, other: &Score) {
        self.points += other.points;
        self.correct += other.correct;
        self.near_points += other.near_points;
        self.near_correct += other.near_correct;
        self.marking_points += other.marking_points;
        self.covered_points += other.covered_points;
    }

    fn summary(&self) -> String {
        let percent = |part: usize, all: usize| 100.0 * part as f32 / all.max(1) as f32;
        format!(
            "correct {:.1} % of {}; within 10 cm up to 4 m {:.1} % of {}; covered {:.0} %",
            percent(self.correct, self.points),
            self.points,
            percent(self.near_correct, self.near_points),
            self.near_points,
            percent(self.covered_points, self.marking_points),
        )
    }
}
