//! Several robots give equal bits, replay bit for bit, and correct one another only where markings do not.

use localize::localizer::SightingOutcome;
use localize::{Estimate, Pose};

use super::*;
use crate::log::{LogReader, UnpackedSetup, verify};
use crate::run::{RunScores, ScenarioOptions, ScenarioRun};
use crate::simulation::load_scenario_with_overrides;

fn scenario() -> (PathBuf, Scenario) {
    let config = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/scenarios/squad.toml");
    let mut scenario = load_scenario_with_overrides(&config, &toml::Table::new(), None)
        .expect("a scenario")
        .0;
    scenario.squad.truncate(2);
    (config, scenario)
}

fn run_robots(threads: usize, seconds: f64, log: &Path) -> Vec<RobotSummary> {
    let (path, scenario) = scenario();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    pool.expect("threads").install(|| {
        let log_config = LogConfig::default();
        let record = Some((log, &log_config));
        let simulation = MultiRobotSimulation::new(
            (&path, &scenario),
            &PipelineConfig::default(),
            seconds,
            record,
        );
        simulation
            .expect("a simulation")
            .run(|_| Ok(ControlFlow::Continue(())))
            .expect("completed")
    })
}

#[test]
fn multi_robot_run_is_deterministic_and_replays_bit_for_bit() {
    let folder = tempfile::tempdir().expect("a folder");
    let log = folder.path().join("game.mcap");
    let summaries = run_robots(2, 1.0, &log);
    assert_eq!(summaries.len(), 3);
    for robot in &summaries {
        assert!(
            robot.messages > 10,
            "robot {} received {}",
            robot.robot,
            robot.messages
        );
        let error = robot.summary.position_error_m.as_ref().expect("scored");
        assert!(error.median < 0.3, "{} m", error.median);
    }
    let again = folder.path().join("again.mcap");
    run_robots(1, 1.0, &again);
    for index in 0..3 {
        let cycles = |log: &Path| {
            let log = LogReader::open(&log_path(log, index)).expect("a log");
            log.map(|logged| {
                let cycle = logged.expect("a cycle").cycle;
                format!("{:?} {:?} {:?}", cycle.estimate, cycle.world, cycle.team)
            })
            .collect::<Vec<_>>()
        };
        assert_eq!(cycles(&log), cycles(&again));
    }
    let log = LogReader::open(&log_path(&log, 1)).expect("a log");
    let unpacked = UnpackedSetup::load(log.header()).expect("a setup");
    let config = unpacked.config().expect("settings");
    let mut pipeline = Pipeline::new(&unpacked.setup, &config).expect("a pipeline");
    let verdict = verify(log, |sample| pipeline.process_sample(sample)).expect("verified");
    assert_eq!((verdict.different, verdict.first_difference), (0, None));
    assert!(verdict.cycles >= 29 && verdict.vision_cycles == verdict.cycles);
}

fn place_mates_nearby(scenario: &mut Scenario) {
    for (mate, at) in scenario.squad.iter_mut().zip([[-2.6, 0.8], [-3.0, -1.6]]) {
        (mate.start.x, mate.start.y) = (at[0], at[1]);
        mate.path.waypoints.clear();
    }
}

#[test]
fn robots_that_see_markings_are_not_moved_by_mates() {
    let (path, mut scenario) = scenario();
    place_mates_nearby(&mut scenario);
    let estimates = |enabled: bool| {
        let mut config = PipelineConfig::default();
        config.team.cooperative.enabled = enabled;
        let mut estimates = Vec::new();
        MultiRobotSimulation::new((&path, &scenario), &config, 1.5, None)
            .expect("a simulation")
            .run_observed(
                |_| Ok(ControlFlow::Continue(())),
                |robot, cycle| estimates.push((robot, cycle.estimate.clone())),
            )
            .expect("completed");
        estimates
    };
    let corrected = estimates(true);
    assert_eq!(corrected, estimates(false));
    // In the first images the stated error is large, and mates see all robots.
    let uncertain = |(_, estimate): &&(usize, Estimate)| estimate.covariance[(0, 0)] > 0.05 * 0.05;
    assert!(corrected.iter().filter(uncertain).count() > 15);
}

#[test]
fn corrections_by_mates_replay_bit_for_bit() {
    let folder = tempfile::tempdir().expect("a folder");
    let log = folder.path().join("game.mcap");
    let (path, mut scenario) = scenario();
    place_mates_nearby(&mut scenario);
    // The mirror of the first robot is covered after a second.
    scenario.occlusions.push(sim::scenario::Occlusion {
        start: 1.0,
        stop: 9.0,
        direction_deg: 0.0,
        width_deg: 360.0,
    });
    let mut config = PipelineConfig::default();
    config.team.cooperative.own_std_min = 0.0;
    let log_config = LogConfig::default();
    let record = Some((log.as_path(), &log_config));
    MultiRobotSimulation::new((&path, &scenario), &config, 3.0, record)
        .expect("a simulation")
        .run(|_| Ok(ControlFlow::Continue(())))
        .expect("completed");
    let cycles: Vec<Cycle> = LogReader::open(&log)
        .expect("a log")
        .map(|logged| logged.expect("a cycle").cycle)
        .collect();
    let used = |cycle: &Cycle| {
        let mut sightings = cycle.team.sightings.iter();
        sightings.any(|sighting| sighting.outcome == SightingOutcome::Used)
    };
    let is_covered = |cycle: &&Cycle| cycle.stamp.seconds() > 1.2;
    let covered = || cycles.iter().filter(is_covered);
    assert!(covered().all(|cycle| cycle.estimate.line_points == 0));
    // Mates correct the robot for as long as it is covered, and never before.
    let needs_mates = |cycle: &Cycle| cycle.stamp.seconds() > 2.2;
    assert!(
        !cycles
            .iter()
            .any(|cycle| cycle.stamp.seconds() < 1.9 && used(cycle))
    );
    let last_second = || cycles.iter().filter(|cycle| needs_mates(cycle));
    let corrected = last_second().filter(|cycle| used(cycle)).count();
    assert!(3 * corrected > last_second().count(), "{corrected}");
    // Whom mates correct corrects nobody.
    let last = cycles.last().expect("a cycle");
    assert!(!last.team.pose_by_markings);
    assert!(cycles.iter().any(|cycle| cycle.team.pose_by_markings));
    let log = LogReader::open(&log).expect("a log");
    let unpacked = UnpackedSetup::load(log.header()).expect("a setup");
    let config = unpacked.config().expect("settings");
    let mut pipeline = Pipeline::new(&unpacked.setup, &config).expect("a pipeline");
    let verdict = verify(log, |sample| pipeline.process_sample(sample)).expect("verified");
    assert_eq!((verdict.different, verdict.first_difference), (0, None));
}

/// Runs 0.2 s of the scenario with changed values; the stamps and true poses of the cycles that progress shows, and the scores.
fn run_briefly(changes: toml::Table) -> (Vec<(Stamp, Pose)>, RunScores) {
    let run = ScenarioRun::load(ScenarioOptions {
        scenario: scenario().0,
        changes,
        seed: None,
        duration: Some(0.2),
        config: PipelineConfig::default(),
        record: None,
    });
    let mut shown = Vec::new();
    let summary = run.expect("a scenario").run(|progress| {
        shown.extend(progress.cycle.map(|cycle| {
            let truth = cycle.inputs.truth.as_ref().expect("simulated");
            (cycle.stamp, truth.pose)
        }));
        Ok(ControlFlow::Continue(()))
    });
    (shown, summary.expect("completed").scores)
}

fn robots_of(scores: RunScores) -> Vec<RobotSummary> {
    let RunScores::MultiRobot { robots } = scores else {
        panic!("a single robot");
    };
    robots
}

#[test]
fn each_of_several_robots_has_as_many_images_as_a_single_robot() {
    let (_, scores) = run_briefly(toml::Table::new());
    for robot in robots_of(scores) {
        assert_eq!(robot.summary.frames, 6, "robot {}", robot.robot);
    }
    let (_, scores) = run_briefly(toml::toml! { squad = [] });
    let RunScores::SingleRobot(summary) = scores else {
        panic!("several robots");
    };
    assert_eq!(summary.frames, 6);
}

#[test]
fn progress_of_several_robots_shows_the_first_one() {
    let (shown, _) = run_briefly(toml::Table::new());
    let (alone, _) = run_briefly(toml::toml! { squad = [] });
    assert_eq!(shown.len(), 6);
    assert_eq!(shown, alone);
}

#[test]
fn ball_is_scored_at_all_distances_and_far_ones_on_their_own() {
    let near = toml::toml! { ball = { position = [-3.0, 0.0] } };
    let robots = robots_of(run_briefly(near).1);
    let first = &robots[0];
    assert!(first.own_ball_m.is_some() && first.own_far_ball_m.is_none());
    let far = robots_of(run_briefly(toml::Table::new()).1);
    let first = &far[0];
    assert!(first.own_ball_m.is_some() && first.own_ball_m == first.own_far_ball_m);
    for (robots, absent) in [(&robots, true), (&far, false)] {
        let table = table(robots);
        assert!(table.contains("more than 4 m from every robot"), "{table}");
        let row = table.lines().nth(1).expect("a robot");
        assert_eq!(row.contains('–'), absent, "{table}");
    }
}
