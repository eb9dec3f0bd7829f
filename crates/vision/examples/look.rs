//! What do the eyes see in a recording folder? Overlays as PNG, and scores where the truth is known.
//!
//! `cargo run --release -p vision --example look -- FOLDER [OUT_FOLDER]`

use std::error::Error;
use std::path::{Path, PathBuf};

use localize::robot::CameraConfig;
use localize::{Field, Pose};
use vision::overlay;
use vision::{Eyes, GroundMap, Image, Mount, Profile, VisionConfig, optics};

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

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args_os().skip(1).map(PathBuf::from);
    let folder = arguments.next().ok_or("look FOLDER [OUT_FOLDER]")?;
    let out = arguments.next();
    let robot: Robot = toml::from_str(&std::fs::read_to_string(folder.join("robot.toml"))?)?;
    let field = Field::load(&folder.join(&robot.field))?;
    let map = match (&robot.map, &robot.mirror) {
        (Some(map), _) => GroundMap::load(&folder.join(&map.file))?,
        (None, Some(mirror)) => {
            let profile = Profile::load(&folder.join(&mirror.profile))?;
            optics::trace_rays(&robot.camera, &profile, &Mount::default())?.ground_map()
        }
        (None, None) => return Err("robot.toml has neither [map] nor [mirror]".into()),
    };
    let mut eyes = Eyes::new(
        &map,
        &robot.camera,
        field.config.line_width,
        VisionConfig::default(),
    )?;
    println!(
        "{} samples, {} pixels, {:.1} %",
        eyes.pattern().samples.len(),
        eyes.pattern().pixels,
        100.0 * eyes.pattern().coverage
    );
    let single = !folder.join("odometry.csv").exists();
    let truth = poses(&folder.join("truth.csv"))?;
    let mut total = Score::default();
    let mut reader = csv::Reader::from_path(folder.join("frames.csv"))?;
    for (index, record) in reader.records().enumerate() {
        let record = record?;
        let image = Image::load(&folder.join(&record[1]))?;
        if single {
            eyes.forget_light();
        }
        let seen = eyes.see(&image.frame())?;
        let score = truth.get(index).map(|&pose| Score::of(&seen, pose, &field));
        println!(
            "{} points {} refused {} carpet {:.2}{} {}",
            &record[1],
            seen.line_points.len(),
            seen.refused.len(),
            seen.carpet_share,
            if seen.learned { " learned" } else { "" },
            score.as_ref().map_or(String::new(), Score::text),
        );
        if let Some(ball) = &seen.ball {
            println!(
                "   ball {:.2} {:.2} score {:.2} {} px {} ground",
                ball.at.x, ball.at.y, ball.score, ball.pixels, ball.on_ground
            );
        }
        for robot in &seen.robots {
            println!(
                "   robot {:.2} {:.2} edge {:.2} width {:.2} {:?} score {:.2}",
                robot.at.x,
                robot.at.y,
                robot.edge.distance(),
                robot.width,
                robot.marker,
                robot.score
            );
        }
        for goal in &seen.goals {
            println!(
                "   goal {:?} {:.2} {:.2} width {:.2} score {:.2}",
                goal.kind, goal.at.x, goal.at.y, goal.width, goal.score
            );
        }
        if seen.learned {
            println!("   {:?}", eyes.carpet_model());
        }
        if let Some(score) = score {
            total.add(&score);
        }
        if let Some(out) = &out {
            save(
                out,
                &record[1],
                &image,
                &map,
                &mut eyes,
                &seen,
                truth.get(index),
                &field,
            )?;
        }
    }
    println!("all: {}", total.text());
    Ok(())
}

#[expect(clippy::too_many_arguments, reason = "one caller, nothing to group")]
fn save(
    out: &Path,
    file: &str,
    image: &Image,
    map: &GroundMap,
    eyes: &mut Eyes,
    seen: &vision::Seen,
    pose: Option<&Pose>,
    field: &Field,
) -> Result<(), Box<dyn Error>> {
    std::fs::create_dir_all(out)?;
    let name = Path::new(file).file_stem().ok_or("no file name")?;
    let mut drawn = overlay::enlarged(image, 2);
    if let Some(&pose) = pose {
        overlay::draw_field(&mut drawn, 2, map, pose, &field.markings);
    }
    overlay::draw_carpet_end(&mut drawn, 2, eyes.pattern(), seen);
    overlay::draw_seen(&mut drawn, 2, seen);
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
    for seen in &seen.line_points {
        let [u, v] = seen.at_px;
        let (at, std) = (seen.point.at, seen.point.std_radial);
        points.serialize([u, v, at.x, at.y, std, seen.width, seen.contrast])?;
    }
    points.flush()?;
    let mut classes = overlay::enlarged(image, 2);
    let of_samples = eyes.classify(&image.frame())?.to_vec();
    for (sample, class) in eyes.pattern().samples.iter().zip(of_samples) {
        let colour = overlay::class_colour(class);
        let (u, v) = (2 * i64::from(sample.u), 2 * i64::from(sample.v));
        overlay::dot(&mut classes, u, v, colour);
        overlay::dot(&mut classes, u + 1, v, colour);
        overlay::dot(&mut classes, u, v + 1, colour);
    }
    let name = format!("{}_classes.png", name.display());
    classes.save(&out.join(name))?;
    Ok(())
}

fn poses(path: &Path) -> Result<Vec<Pose>, Box<dyn Error>> {
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
    /// Points inside 5 m, and those within max(5 cm, 2 pixels) and 10 cm (inside 4 m) of a true line.
    points: usize,
    right: usize,
    near_points: usize,
    near_right: usize,
    /// Marking pieces within 4 m on the map, and those with a line point near.
    pieces: usize,
    sampled: usize,
}

/// Markings are cut into pieces of this length, metres; a piece is sampled if a right point lies within `REACH`.
const PIECE: f32 = 0.05;
const REACH: f32 = 0.25;

impl Score {
    fn of(seen: &vision::Seen, pose: Pose, field: &Field) -> Self {
        let mut score = Score::default();
        let mut good = Vec::new();
        for point in &seen.line_points {
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
                score.right += usize::from(right);
            }
            if at.distance() <= 4.0 {
                score.near_points += 1;
                score.near_right += usize::from(off <= 0.1);
            }
        }
        for at in overlay::marking_points(&field.markings, PIECE) {
            let seen_from = pose.inverse() * at;
            let range = seen_from.distance();
            if !(0.4..=4.0).contains(&range) {
                continue;
            }
            score.pieces += 1;
            score.sampled += usize::from(good.iter().any(|point| point.distance_to(at) <= REACH));
        }
        score
    }

    fn add(&mut self, other: &Score) {
        self.points += other.points;
        self.right += other.right;
        self.near_points += other.near_points;
        self.near_right += other.near_right;
        self.pieces += other.pieces;
        self.sampled += other.sampled;
    }

    fn text(&self) -> String {
        let percent = |part: usize, all: usize| 100.0 * part as f32 / all.max(1) as f32;
        format!(
            "right {:.1} % of {}; within 10 cm inside 4 m {:.1} % of {}; sampled {:.0} %",
            percent(self.right, self.points),
            self.points,
            percent(self.near_right, self.near_points),
            self.near_points,
            percent(self.sampled, self.pieces),
        )
    }
}
