//! `mirrorball bench`: how fast and how exact is it on this machine? Each stage's figures beside what is wanted.

mod accuracy;
mod others;

use std::hint::black_box;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use localize::drive::{Drive, DriveConfig, DriveFrame};
use localize::matching::Matcher;
use localize::relocalise::hough::Hough;
use localize::relocalise::monte_carlo::MonteCarlo;
use localize::relocalise::scan_map::ScanMap;
use localize::search::{HeadingPrior, Search};
use localize::{At, DistanceField, Field, Localizer, Pose};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde::Serialize;
use sim::Scenario;
use sim::render::{Renderer, Scene, Setting};
use sim::scenario::Team;
use sim::world::RobotState;
use vision::image::Image;
use vision::{Eyes, Profile};

use crate::arguments::WrongArguments;
use crate::baseline::{self, Baseline, Compared, Measured};
use crate::cycle::{Spine, SpineConfig};
use crate::home;
use crate::sample::Sample;
use crate::score::spread;
use crate::setup::Setup;
use crate::simulation::Simulation;

/// Measure every stage on this machine: times (medians, one core) and accuracies.
///
/// Each figure stands beside the one that is wanted. Let the machine rest meanwhile.
#[derive(clap::Args)]
#[command(
    after_help = "Example: mirrorball bench --save baseline.json, later: mirrorball bench --baseline baseline.json"
)]
pub struct Args {
    /// Measure only the figures whose name contains this.
    #[arg(long, value_name = "TEXT", default_value = "")]
    only: String,
    /// Keep the figures in a file, to compare with later.
    #[arg(long, value_name = "FILE.json")]
    save: Option<PathBuf>,
    /// Compare with figures kept earlier.
    #[arg(long, value_name = "FILE.json")]
    baseline: Option<PathBuf>,
}

/// One measured figure.
#[derive(Debug, Serialize)]
pub struct Figure {
    name: &'static str,
    value: f64,
    unit: &'static str,
    /// Bound to be met, as text with its direction.
    wanted: &'static str,
}

#[derive(Serialize)]
struct Report {
    machine: String,
    figures: Vec<Figure>,
    /// Beside the baseline's, if one was given.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    compared: Vec<Compared>,
    /// What the baseline has and this run has not.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    gone: Vec<String>,
}

impl Report {
    fn kept(&self) -> Baseline {
        let figures = self.figures.iter().map(|figure| Measured {
            name: figure.name.to_owned(),
            value: figure.value,
            unit: figure.unit.to_owned(),
            wanted: figure.wanted.to_owned(),
        });
        Baseline {
            machine: self.machine.clone(),
            figures: figures.collect(),
        }
    }
}

/// Repetitions of a stage's measurement, at least.
const REPEATS: usize = 300;

/// Runs the command.
pub fn run(args: &Args, json: bool) -> Result<()> {
    let mut report = Report {
        machine: machine(),
        figures: Vec::new(),
        compared: Vec::new(),
        gone: Vec::new(),
    };
    // Before minutes of measuring.
    let earlier = args.baseline.as_deref().map(Baseline::load).transpose()?;
    type Bench = fn(&mut Vec<Figure>) -> Result<()>;
    let benches: [(&[&str], Bench); 9] = [
        (
            &[
                "see_lines_480",
                "see_all_480",
                "see_new_light_480",
                "image_to_pose_480",
            ],
            seeing,
        ),
        (
            &[
                "match_points",
                "track_frame",
                "exact_no_prior",
                "exact_compass",
            ],
            placing,
        ),
        (
            &[
                "hough",
                "scan_map_global",
                "scan_map_local",
                "monte_carlo_cycle",
            ],
            papers,
        ),
        (accuracy::DRIVES, accuracy::drives),
        (others::FUSED, others::fused),
        (others::SEEN, others::seen),
        (&["render_480_nine_robots"], rendering),
        (&["simulation_30_hz", "game_all_cores"], simulating),
        (others::MIRRORS, others::mirrors),
    ];
    for (names, bench) in benches {
        if names.iter().any(|name| name.contains(&args.only)) {
            bench(&mut report.figures)?;
        }
    }
    report
        .figures
        .retain(|figure| figure.name.contains(&args.only));
    if report.figures.is_empty() {
        return Err(WrongArguments(format!("no figure's name contains {:?}", args.only)).into());
    }
    let kept = report.kept();
    if let Some(path) = &args.save {
        kept.save(path)?;
    }
    if let Some(earlier) = &earlier {
        report.compared = kept.compared(earlier);
        report.gone = kept.missing(earlier);
        // What was not asked for is not missing.
        report.gone.retain(|name| name.contains(&args.only));
    }
    if json {
        println!("{}", serde_json::to_string(&report)?);
        return Ok(());
    }
    println!("{}", report.machine);
    baseline::print(&kept, earlier.as_ref(), &report.compared, &report.gone);
    if let Some(path) = &args.save {
        println!("kept in {}", path.display());
    }
    Ok(())
}

/// Processor and number of cores, as the system names them.
pub(crate) fn machine() -> String {
    let info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = info
        .lines()
        .find_map(|line| line.strip_prefix("model name")?.split_once(':'));
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    format!(
        "{}, {cores} cores, {}",
        name.map_or("unknown processor", |(_, name)| name.trim()),
        std::env::consts::OS
    )
}

/// A stage is measured for so long at least: other guests of a shared machine come and go within a second.
const LONG_ENOUGH: Duration = Duration::from_secs(2);

/// Median time of a call in milliseconds.
fn median_ms(repeats: usize, mut call: impl FnMut()) -> f64 {
    let mut once = || {
        let started = Instant::now();
        call();
        started.elapsed().as_secs_f64() * 1e3
    };
    // The first calls fill caches.
    for _ in 0..repeats.div_ceil(10) {
        once();
    }
    let (started, mut times) = (Instant::now(), Vec::new());
    while times.len() < repeats || started.elapsed() < LONG_ENOUGH {
        times.push(once());
    }
    spread(times).map_or(f64::NAN, |spread| spread.median)
}

fn seeing(figures: &mut Vec<Figure>) -> Result<()> {
    let folder = home::find("samples/sequence")?;
    let setup = Setup::load(&folder.join("robot.toml"), None)?;
    let (camera, map) = setup
        .camera
        .as_ref()
        .context("samples/sequence has no camera")?;
    let mut images = Vec::new();
    for number in 0..8 {
        images.push(Image::load(
            &folder.join(format!("frames/{number:03}.jpg")),
        )?);
    }
    let config = SpineConfig::default();
    let mut eyes = Eyes::new(
        map,
        camera,
        setup.field.config.line_width,
        config.vision.clone(),
    )?;
    let mut number = 0;
    let mut next = || {
        number = (number + 1) % images.len();
        images[number].frame()
    };
    let see_lines = median_ms(REPEATS, || drop(black_box(eyes.see_lines(&next()))));
    let see_all = median_ms(REPEATS, || drop(black_box(eyes.see(&next()))));
    let see_new_light = median_ms(30, || {
        eyes.forget_light();
        drop(black_box(eyes.see(&next())));
    });
    figures.push(Figure {
        name: "see_lines_480",
        value: see_lines,
        unit: "ms",
        wanted: "<= 0.15",
    });
    figures.push(Figure {
        name: "see_all_480",
        value: see_all,
        unit: "ms",
        wanted: "<= 0.5",
    });
    figures.push(Figure {
        name: "see_new_light_480",
        value: see_new_light,
        unit: "ms",
        wanted: "-",
    });
    let recording = crate::recording::Recording::open(&folder, crate::locate::FOREIGN_POINT_STD)?;
    let samples: Vec<Sample> = recording.collect();
    let mut whole = Vec::new();
    for _ in 0..10 {
        let mut spine = Spine::new(&setup, &config)?;
        for sample in &samples {
            let started = Instant::now();
            if let Some(cycle) = spine.take(sample.clone()) {
                // The first frame learns its colours and searches the field.
                if cycle
                    .inputs
                    .odometry
                    .first()
                    .is_some_and(|odometry| odometry.stamp.0 > 0)
                {
                    whole.push(started.elapsed().as_secs_f64() * 1e3);
                }
            }
        }
    }
    let value = spread(whole).map_or(f64::NAN, |spread| spread.median);
    figures.push(Figure {
        name: "image_to_pose_480",
        value,
        unit: "ms",
        wanted: "<= 1",
    });
    Ok(())
}

/// The league's drive that existing systems were measured on: 30 Hz, about 113 points within 5 m.
fn frames(field: &Field) -> Vec<DriveFrame> {
    Drive::new(field, DriveConfig::default(), ChaCha8Rng::seed_from_u64(2))
        .take(900)
        .collect()
}

fn placing(figures: &mut Vec<Figure>) -> Result<()> {
    let field = Field::load(&home::find("config/fields/msl_18x12.toml")?)?;
    let frames = frames(&field);
    let config = SpineConfig::default().localize;
    let distances = DistanceField::new(&field, &config.distance);
    let mut matcher = Matcher::new(config.matching.clone());
    let mut search = Search::new(&field, &distances, config.search.clone());
    let mut number = 0;
    let mut next = || {
        number = (number + 7) % frames.len();
        &frames[number]
    };
    let near = |pose: Pose| Pose::new(pose.x + 0.02, pose.y - 0.02, pose.theta + 0.01);
    let value = median_ms(3000, || {
        let frame = next();
        black_box(matcher.refine(&distances, &frame.points, near(frame.truth), 0.05));
    });
    figures.push(Figure {
        name: "match_points",
        value,
        unit: "ms",
        wanted: "<= 0.08",
    });
    let mut localizer = Localizer::new(&field, config);
    let mut times = Vec::new();
    for frame in &frames {
        let started = Instant::now();
        localizer.odometry(&frame.odometry);
        localizer.compass(&frame.compass);
        black_box(localizer.see(frame.stamp, &frame.points));
        times.push(started.elapsed().as_secs_f64() * 1e3);
    }
    let value = spread(times).map_or(f64::NAN, |spread| spread.median);
    figures.push(Figure {
        name: "track_frame",
        value,
        unit: "ms",
        wanted: "<= 0.03",
    });
    let value = median_ms(REPEATS, || {
        black_box(search.find(&distances, &mut matcher, &next().points, None));
    });
    figures.push(Figure {
        name: "exact_no_prior",
        value,
        unit: "ms",
        wanted: "<= 3",
    });
    let value = median_ms(REPEATS, || {
        let frame = next();
        let prior = HeadingPrior {
            heading: frame.compass.heading,
            std: 10f32.to_radians(),
        };
        black_box(search.find(&distances, &mut matcher, &frame.points, Some(prior)));
    });
    figures.push(Figure {
        name: "exact_compass",
        value,
        unit: "ms",
        wanted: "<= 0.5",
    });
    Ok(())
}

fn papers(figures: &mut Vec<Figure>) -> Result<()> {
    let field = Field::load(&home::find("config/fields/msl_18x12.toml")?)?;
    let frames = frames(&field);
    let config = SpineConfig::default().localize;
    let distances = DistanceField::new(&field, &config.distance);
    let mut number = 0;
    let mut next = || {
        number = (number + 7) % frames.len();
        let frame = &frames[number];
        (
            frame,
            HeadingPrior {
                heading: frame.compass.heading,
                std: 10f32.to_radians(),
            },
        )
    };
    let mut hough = Hough::new(&field, config.relocalise.hough.clone());
    let value = median_ms(REPEATS, || {
        let (frame, prior) = next();
        black_box(hough.find(&frame.points, Some(prior)));
    });
    figures.push(Figure {
        name: "hough",
        value,
        unit: "ms",
        wanted: "<= 1",
    });
    let map = ScanMap::new(&field, &distances, config.relocalise.scan_map.clone());
    let value = median_ms(REPEATS, || {
        let (frame, prior) = next();
        black_box(map.find(&frame.points, prior.heading, 6, 0.4));
    });
    figures.push(Figure {
        name: "scan_map_global",
        value,
        unit: "ms",
        wanted: "<= 2",
    });
    let value = median_ms(REPEATS, || {
        let (frame, _) = next();
        black_box(map.find_near(&frame.points, frame.truth));
    });
    figures.push(Figure {
        name: "scan_map_local",
        value,
        unit: "ms",
        wanted: "<= 0.05",
    });
    let mut filter = MonteCarlo::new(&field, &distances, config.relocalise.monte_carlo.clone());
    let value = median_ms(REPEATS, || {
        let (frame, prior) = next();
        filter.restart();
        black_box(filter.cycle(&frame.points, Some(prior)));
    });
    figures.push(Figure {
        name: "monte_carlo_cycle",
        value,
        unit: "ms",
        wanted: "<= 0.3",
    });
    Ok(())
}

/// Nine robots from 1 to 9 m around ours, the ball at 2 m, a goal 5 m ahead.
fn rendering(figures: &mut Vec<Figure>) -> Result<()> {
    let (scenario, robot) = Scenario::load(&home::find("config/scenarios/demo.toml")?)?;
    let field = Field::load(&robot.field)?;
    let camera = robot
        .camera
        .as_ref()
        .context("the demo's robot has no camera")?;
    let mirror = robot
        .mirror
        .as_ref()
        .context("the demo's robot has no mirror")?;
    let mut renderer = Renderer::new(&Setting {
        camera,
        profile: &Profile::load(&mirror.profile)?,
        mount: scenario.mount,
        body: &robot.body.clone().unwrap_or_default(),
        field: &field,
        light: &scenario.light,
        blur_px: scenario.film.blur_px,
        seed: scenario.seed,
    })?;
    let robots: Vec<RobotState> = (0..9u8)
        .map(|index| {
            let (sin, cos) = (0.7 * f32::from(index)).sin_cos();
            let distance = 1.0 + f32::from(index);
            let pose = Pose::new(4.0 - distance * cos, distance * sin * 0.8, f32::from(index));
            let team = if index % 2 == 0 {
                Team::Cyan
            } else {
                Team::Magenta
            };
            RobotState {
                pose,
                velocity: [0.0; 2],
                omega: 0.0,
                team,
            }
        })
        .collect();
    let (mut turn, mut rgb) = (0.0f32, Vec::new());
    let value = median_ms(REPEATS, || {
        turn += 0.1;
        let scene = Scene {
            pose: Pose::new(4.0, 0.3, turn),
            robots: &robots,
            ball: Some((
                At::new(2.5, 1.5),
                scenario.ball.diameter,
                scenario.ball.colour,
            )),
            lamp: [1.0; 3],
            occlusions: &[],
        };
        renderer.render(&scene, &scenario.film, &mut rgb);
        black_box(&rgb);
    });
    figures.push(Figure {
        name: "render_480_nine_robots",
        value,
        unit: "ms",
        wanted: "<= 4",
    });
    Ok(())
}

/// The demo on one core, and the league's game as `sim` runs it: the simulator a step ahead in a thread of its own.
fn simulating(figures: &mut Vec<Figure>) -> Result<()> {
    let load = |name| Simulation::load(&home::find(name)?, None, Some(f64::MAX));
    let demo = load("config/scenarios/demo.toml")?;
    let mut setup = demo.setup()?;
    // Nothing is commanded here.
    setup.robot.exposure = None;
    figures.push(Figure {
        name: "simulation_30_hz",
        value: times_real_time(demo, &setup)?,
        unit: "x real time",
        wanted: ">= 8",
    });
    let game = load("config/scenarios/game_18x12.toml")?;
    let mut setup = game.setup()?;
    setup.robot.exposure = None;
    figures.push(Figure {
        name: "game_all_cores",
        value: times_real_time(game.ahead()?, &setup)?,
        unit: "x real time",
        wanted: ">= 8",
    });
    Ok(())
}

fn times_real_time(mut source: impl Iterator<Item = Sample>, setup: &Setup) -> Result<f64> {
    let mut spine = Spine::new(setup, &SpineConfig::default())?;
    let mut next = || {
        source
            .find_map(|sample| spine.take(sample))
            .context("the scenario ends at once")
    };
    // The first image builds tables and learns colours.
    let first = next()?.stamp;
    let started = Instant::now();
    for _ in 0..300 {
        next()?;
    }
    Ok((next()?.stamp - first) / started.elapsed().as_secs_f64())
}
