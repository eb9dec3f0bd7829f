//! Prints the consistency table: `cargo run --release -p localize --example noise_table -- [SEEDS] [SECONDS] [PART]`.

use localize::synthetic::consistency::{ConsistencyScore, evaluate_consistency};
use localize::synthetic::rough_drive::RoughDriveConfig;
use localize::synthetic::starts::evaluate_starts;
use localize::{Field, LocalizeConfig, Localizer};

#[expect(clippy::too_many_lines, reason = "one table, condition by condition")]
fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number = |k: usize, default: f64| {
        arguments
            .get(k)
            .and_then(|text| text.parse().ok())
            .unwrap_or(default)
    };
    let (seeds, seconds) = (number(0, 3.0) as u64, number(1, 30.0));
    let part = arguments.get(2).map_or("", String::as_str);
    let path = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../config/fields/msl_18x12.toml"
    );
    let field = Field::load(std::path::Path::new(path)).expect("a field");
    let mut config = LocalizeConfig::default();
    for setting in &arguments[arguments.len().min(3)..] {
        let (key, value) = setting.split_once('=').expect("KEY=VALUE");
        let mut text = format!(
            "[{}]\n",
            key.rsplit_once('.').map_or("", |(table, _)| table)
        );
        text += &format!(
            "{} = {value}\n",
            key.rsplit_once('.').map_or(key, |(_, name)| name)
        );
        let overlay: toml::Table = toml::from_str(&text).expect("a setting");
        let mut table = toml::Table::try_from(&config).expect("a table");
        merge(&mut table, overlay);
        config = table.try_into().expect("a configuration");
    }
    let run =
        |drive: &RoughDriveConfig| evaluate_consistency(&field, &config, drive, 0..seeds, seconds);
    if part.is_empty() || part.contains("grid") {
        println!(
            "NEES (1 is consistent) [95 % interval]: odometry noise x tilt / deg x points sigma; mean error / cm"
        );
        let (mut low, mut high) = (f64::INFINITY, 0.0_f64);
        let mut outside = 0;
        for odometry in [0.25, 1.0, 4.0] {
            for tilt in [0.0, 0.45, 1.0] {
                let mut line = format!("odo {odometry:4} tilt {tilt:4}:");
                for points in [0.5, 1.0, 2.0] {
                    let score = run(&RoughDriveConfig::with_scaled_errors(
                        odometry, tilt, points,
                    ));
                    low = low.min(score.nees);
                    high = high.max(score.nees);
                    outside += usize::from(!(0.7..=1.4).contains(&score.nees));
                    line += &format!(
                        "  x{points}: {:5.2} [{:.2}, {:.2}] ({:.2} cm, {:.2} deg, lost {})",
                        score.nees,
                        score.nees_interval[0],
                        score.nees_interval[1],
                        50.0 * (score.mean_error[0] + score.mean_error[1]),
                        score.mean_error[2],
                        score.lost
                    );
                }
                println!("{line}");
            }
        }
        println!("range {low:.2} to {high:.2}, {outside} of 27 outside 0.7 to 1.4");
    }
    if part == "starts" {
        print_starts(&field, &config, seeds, seconds);
    }
    let print = |name: &str, score: ConsistencyScore| {
        println!(
            "    marginal {:.2?}, over time {:.2?}",
            score.marginal_nees, score.nees_over_time
        );
        println!(
            "{name:28} x {:.2} y {:.2} cm {:.3} deg max {:.1} cm nees {:.2} lost {} of {}",
            100.0 * score.mean_error[0],
            100.0 * score.mean_error[1],
            score.mean_error[2],
            100.0 * score.max_error,
            score.nees,
            score.lost,
            score.images
        );
        if score.blind_nees > 0.0 {
            println!(
                "    blind: nees {:.2}, within 3 sigma {:.1} %, end {:.2} cm rms, {:.2} mean, leap {:.1} cm",
                score.blind_nees,
                100.0 * score.blind_within_3_sigma,
                100.0 * score.blind_end_error,
                100.0 * score.blind_end_mean,
                100.0 * score.reacquisition_error_max
            );
        }
    };
    let base = RoughDriveConfig::default();
    if part.is_empty() || part.contains("base") {
        print("113 points", run(&base));
        let with = |edit: &dyn Fn(&mut RoughDriveConfig)| {
            let mut drive = base.clone();
            edit(&mut drive);
            drive
        };
        print(
            "50 % outliers",
            run(&with(&|drive| drive.points.outlier_share = 0.5)),
        );
        print("40 rays", run(&with(&|drive| drive.points.rays = 40)));
        print(
            "3 m range",
            run(&with(&|drive| drive.points.range_max = 3.0)),
        );
        print(
            "tilting 0.45 deg",
            run(&with(&|drive| drive.points.tilt_std_deg = 0.45)),
        );
    }
    if part.is_empty() || part.contains("hard") {
        let mut drive = base.clone();
        drive.wheels.slow_share = 0.05;
        print("slow wheel errors", run(&drive));
        drive = base.clone();
        drive.points.slow_tilt_std_deg = 0.3;
        drive.points.constant_tilt_deg = [0.5, -0.3];
        print("slow and constant tilt", run(&drive));
        drive = base.clone();
        drive.points.wide_share = 0.2;
        drive.points.body_share = 0.2;
        print("heavy tails, bodies", run(&drive));
        drive = base.clone();
        drive.points.map_error = 0.02;
        print("map error 2 cm at 5 m", run(&drive));
    }
    if part.is_empty() || part.contains("blind") {
        let mut drive = RoughDriveConfig::blind_with_unequal_wheels();
        print("blind 2 s of 8, 2 % noise", run(&drive));
        drive.wheels.white_share = 0.08;
        print("the same, 8 % noise", run(&drive));
        drive = RoughDriveConfig::blind_with_unequal_wheels();
        drive.wheels.known = true;
        print("2 %, known base", run(&drive));
        drive = base.clone();
        drive.blind = Some((40.0, 30.0));
        for preset in ["default", "minho2016", "nubot2013"] {
            let config = if preset == "default" {
                config.clone()
            } else {
                LocalizeConfig::preset(preset).expect("a preset")
            };
            let seeds = if preset == "minho2016" {
                seeds.min(3)
            } else {
                seeds
            };
            let score = evaluate_consistency(&field, &config, &drive, 0..seeds, 90.0);
            print(&format!("blind 30 s, {preset}"), score);
        }
    }
    if part.is_empty() || part.contains("time") {
        times(&field, &config, &base);
    }
}

/// How do unknown starts end? Not among the parts that run without a name.
fn print_starts(field: &Field, config: &LocalizeConfig, seeds: u64, seconds: f64) {
    println!(
        "starts that claimed a wrong place (images), that end there, that track nothing; time to a tracked pose: median, 95 %, largest"
    );
    for odometry in [0.25, 1.0, 4.0] {
        for tilt in [0.0, 0.45, 1.0] {
            for points in [0.5, 1.0, 2.0] {
                let drive = RoughDriveConfig::with_scaled_errors(odometry, tilt, points);
                let score = evaluate_starts(field, config, &drive, 0..seeds, seconds);
                let [median, most] = score.time_to_pose;
                println!(
                    "odo {odometry:4} tilt {tilt:4} x{points}: {} ({}), {}, {} of {}; {median:.2}, {most:.2}, {:.2} s",
                    score.wrong,
                    score.wrong_images,
                    score.wrong_at_end,
                    score.undecided,
                    score.starts,
                    score.time_to_pose_max
                );
            }
        }
    }
}

fn merge(into: &mut toml::Table, from: toml::Table) {
    for (key, value) in from {
        match (into.get_mut(&key), value) {
            (Some(toml::Value::Table(into)), toml::Value::Table(from)) => merge(into, from),
            (_, value) => {
                into.insert(key, value);
            }
        }
    }
}

#[expect(clippy::disallowed_methods, reason = "an experiment measures time")]
fn times(field: &Field, config: &LocalizeConfig, drive: &RoughDriveConfig) {
    use rand::SeedableRng;
    let rng = rand::rngs::Xoshiro256PlusPlus::seed_from_u64(5);
    let samples: Vec<_> =
        localize::synthetic::rough_drive::RoughDrive::new(field, drive.clone(), rng)
            .take(3000)
            .collect();
    // Other processes interrupt this one: the minimum of several runs counts for each image.
    let mut times = vec![f64::INFINITY; samples.len()];
    for _ in 0..9 {
        let mut localizer = Localizer::new(field, config.clone());
        for (sample, time) in samples.iter().zip(&mut times) {
            let start = std::time::Instant::now();
            localizer.add_odometry(&sample.odometry);
            localizer.add_compass(&sample.compass);
            std::hint::black_box(localizer.process_points(sample.stamp, &sample.points));
            *time = time.min(start.elapsed().as_secs_f64() * 1e3);
        }
    }
    let mut times = times[90..].to_vec();
    times.sort_by(f64::total_cmp);
    let at = |share: f64| times[(share * (times.len() - 1) as f64) as usize];
    println!(
        "time of a tracked image: median {:.4} ms, 90 % {:.4}, 99 % {:.4} ({:.1} x), max {:.4}",
        at(0.5),
        at(0.9),
        at(0.99),
        at(0.99) / at(0.5),
        at(1.0)
    );
}
