//! Prints the table of `sim::fusion_experiment`: `cargo run --release -p sim --example fusion [SEEDS] [SECONDS] [COURSE|all]
//! [LOCALIZE.toml]`. The last argument is an overlay of localization settings.

use std::path::Path;

use localize::Field;
use localize::robot::RobotConfig;
use sim::fusion_experiment::FusionExperiment;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let seeds: u64 = arguments.next().map_or(Ok(3), |text| text.parse())?;
    let duration: f64 = arguments.next().map_or(Ok(90.0), |text| text.parse())?;
    let only = arguments.next();
    let config = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config");
    let robot = RobotConfig::load(&config.join("robots/default.toml"))?;
    let field = Field::load(&robot.field)?;
    let mut experiment = FusionExperiment {
        seeds: 1..1 + seeds,
        duration,
        ..FusionExperiment::default()
    };
    if let Some(path) = arguments.next() {
        experiment.localize = toml::from_str(&std::fs::read_to_string(path)?)?;
    }
    if let Some(only) = only.filter(|only| only != "all") {
        let name = only.to_lowercase();
        experiment
            .disturbances
            .retain(|course| format!("{course:?}").to_lowercase() == name);
    }
    println!(
        "{:<15} {:<14} {:>6} {:>6} {:>6} {:>7} {:>7} {:>7} {:>6} {:>6} {:>5} {:>6} {:>6} {:>6}",
        "course",
        "estimator",
        "cm",
        "max",
        "deg",
        "blind",
        "max",
        "hit",
        "along",
        "nees",
        "in",
        "search",
        "scale%",
        "lat ms"
    );
    for row in experiment.run(&robot, &field)? {
        let cm = |value: Option<f32>| {
            value.map_or_else(|| "-".to_owned(), |value| format!("{:.2}", 100.0 * value))
        };
        println!(
            "{:<15} {:<14} {:>6.2} {:>6.1} {:>6.3} {:>7} {:>7} {:>7} {:>6.2} {:>6.2} {:>5.2} {:>6} {:>6} {:>6.1}",
            format!("{:?}", row.disturbance),
            format!("{:?}", row.estimator),
            100.0 * row.position,
            100.0 * row.position_max,
            row.heading_deg,
            cm(row.blind),
            cm(row.blind_max),
            cm(row.after_hit),
            100.0 * row.along,
            row.nees,
            row.nees_inside,
            row.searched,
            cm(row.scale_off),
            1e3 * row.latency,
        );
    }
    Ok(())
}
