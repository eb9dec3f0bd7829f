//! Is the set-up right? A thread of low priority asks while the robot drives, and the check at the end asks again.

use std::sync::mpsc::{self, Receiver, SyncSender, TryRecvError};

use hw::realtime::lower_priority;
use localize::Stamp;
use localize::map_correction::MapFit;
use nalgebra::Matrix3;
use pipeline::doubted_poses::DoubtedPoses;
use pipeline::recording::Table;
use pipeline::setup::Setup;
use pipeline::setup_check::{self, KeyframeCollector, MeasuredKeyframe, SetupReport};
use pipeline::{Cycle, PipelineConfig};
use vision::calibrate::Rim;

/// Path before the first check, metres (`KeyframeCollector::path`): one place looks like places of other fields.
const PATH_MIN: f32 = 6.0;
/// Keyframes before the first check.
const KEYFRAMES_MIN: usize = 15;
/// Time from the end of a check to the next one, seconds. It doubles each time that the set-up is found right.
const PERIOD: f64 = 10.0;
/// The same after a first doubt, seconds.
const DOUBTED_PERIOD: f64 = 3.0;
const PERIOD_MAX: f64 = 300.0;
/// Checks in a row that have to doubt the set-up before it is reported, and its poses before they are marked.
const DOUBTS_MIN: u32 = 2;
/// What the operator reads when the images' own mount is taken into use.
const MOUNT_KNOWN: &str = "the camera is not mounted as its map says: the mount that the images tell is in use (`mirrorball calibrate lines` keeps it)";

/// Checks the set-up again and again.
pub(super) struct SetupWatch {
    keyframes: KeyframeCollector,
    checker: Option<Checker>,
    is_checking: bool,
    next: Option<Stamp>,
    period: f64,
    /// Checks in a row that doubted the set-up.
    doubts: u32,
    /// Checks in a row that doubted its poses.
    pose_doubts: u32,
    /// Sensors that were found to be useless.
    dropped: Vec<Table>,
    /// True once the mount that the images tell is in use. From then on the localizer learns what is left of its errors.
    knows_mount: bool,
    /// Stamp of the last cycle.
    last_cycle: Option<Stamp>,
    /// What is reported just now, and since when.
    reported: Option<(Stamp, String)>,
    /// What was reported and withdrawn, with its times.
    withdrawn: Vec<String>,
    doubted: DoubtedPoses,
}

/// A change of what is thought of the set-up.
pub(super) struct SetupVerdict {
    /// For the operator, one line.
    pub(super) text: String,
    /// Covariance to be added to the poses. Zero: none.
    pub(super) covariance: Matrix3<f32>,
    /// Sensors that are not to be used any more: inertial unit, compass.
    pub(super) drops: Vec<Table>,
    /// The mount that the images tell, to be used from now on.
    pub(super) map_fit: Option<MapFit>,
}

impl SetupWatch {
    pub(super) fn new(setup: &Setup, config: &PipelineConfig) -> Self {
        SetupWatch {
            keyframes: KeyframeCollector::new(setup, &config.localize.filter),
            checker: None,
            is_checking: false,
            next: None,
            period: PERIOD,
            doubts: 0,
            pose_doubts: 0,
            dropped: Vec::new(),
            knows_mount: false,
            last_cycle: None,
            reported: None,
            withdrawn: Vec::new(),
            doubted: DoubtedPoses::default(),
        }
    }

    /// Adds a cycle.
    pub(super) fn add_cycle(&mut self, cycle: &Cycle) {
        self.keyframes.add_cycle(cycle);
        self.doubted.add(cycle);
        self.last_cycle = Some(cycle.stamp);
    }

    /// Starts a check when it is due, and takes the result of a finished one. `find_rim`: the mirror's rim in the last images. Some: the
    /// poses' mark is to be changed.
    pub(super) fn update(
        &mut self,
        setup: &Setup,
        config: &PipelineConfig,
        find_rim: impl FnOnce() -> Option<Rim>,
        now: Stamp,
    ) -> Option<SetupVerdict> {
        if self.is_checking {
            let report = self.checker.as_ref()?.take_report()?;
            self.is_checking = false;
            let verdict = self.judge(&report);
            self.next = Some(now + self.period);
            return verdict;
        }
        let is_early = self.next.is_some_and(|next| now < next);
        if !is_early && self.keyframes.path() >= PATH_MIN {
            let keyframes = self.keyframes.keyframes();
            if keyframes.len() >= KEYFRAMES_MIN {
                let job = (config.clone(), keyframes, find_rim());
                self.is_checking = self.start_check(setup, job);
            }
        }
        None
    }

    /// False if there is no thread for it: the next cycle tries again.
    fn start_check(&mut self, setup: &Setup, job: CheckJob) -> bool {
        if self.checker.is_none() {
            self.checker = Checker::start(setup);
        }
        let checker = self.checker.as_ref();
        let is_started = checker.is_some_and(|checker| checker.jobs.send(job).is_ok());
        if !is_started {
            self.checker = None;
        }
        is_started
    }

    fn judge(&mut self, report: &SetupReport) -> Option<SetupVerdict> {
        let before = (self.is_reported(), self.is_marked());
        let count = |doubts: u32, is_doubtful: bool| if is_doubtful { doubts + 1 } else { 0 };
        self.doubts = count(self.doubts, !report.warnings.is_empty());
        self.pose_doubts = count(self.pose_doubts, report.added_pose_covariance.is_some());
        self.period = match self.doubts {
            0 => (2.0 * self.period).clamp(PERIOD, PERIOD_MAX),
            1..DOUBTS_MIN => DOUBTED_PERIOD,
            _ => PERIOD,
        };
        // Keyframes keep the readings of a dropped sensor, so later checks name it again.
        let is_new = |table: &Table| {
            matches!(table, Table::Imu | Table::Compass) && !self.dropped.contains(table)
        };
        let unusable = report.unusable.iter().copied();
        let drops: Vec<Table> = unusable
            .filter(|it| self.is_reported() && is_new(it))
            .collect();
        self.dropped.extend(&drops);
        let map_fit = report.map_fit.as_ref().filter(|_| !self.knows_mount);
        self.knows_mount |= map_fit.is_some();
        self.keep_report(report);
        let is_doubt_changed =
            before != (self.is_reported(), self.is_marked()) || !drops.is_empty();
        if !is_doubt_changed && map_fit.is_none() {
            return None;
        }
        let mut texts = Vec::new();
        if map_fit.is_some() {
            texts.push(MOUNT_KNOWN.to_owned());
        }
        if is_doubt_changed {
            texts.push(if self.is_reported() {
                format!("warning: {}", report.warnings.join("; "))
            } else {
                "the set-up is no longer doubtful".to_owned()
            });
        }
        let covariance = report.added_pose_covariance.filter(|_| self.is_marked());
        Some(SetupVerdict {
            text: texts.join("; "),
            covariance: covariance.unwrap_or_default(),
            drops,
            map_fit: map_fit.map(|fit| fit.map_fit()),
        })
    }

    /// Keeps what is reported for the end of the run, which may find the set-up right.
    fn keep_report(&mut self, report: &SetupReport) {
        let Some(now) = self.last_cycle else { return };
        if self.is_reported() {
            let since = self.reported.take().map_or(now, |(since, _)| since);
            self.reported = Some((since, report.warnings.join("; ")));
        } else if let Some((since, text)) = self.reported.take() {
            let (since, now) = (since.seconds(), now.seconds());
            self.withdrawn
                .push(format!("from {since:.1} to {now:.1} s: {text}"));
        }
    }

    fn is_reported(&self) -> bool {
        self.doubts >= DOUBTS_MIN
    }

    fn is_marked(&self) -> bool {
        self.pose_doubts >= DOUBTS_MIN
    }

    /// Checks once more, by all that was seen. Returns a sentence per doubt, those that were withdrawn with their times.
    pub(super) fn finish(
        mut self,
        setup: &Setup,
        config: &PipelineConfig,
        rim: Option<Rim>,
    ) -> Vec<String> {
        let keyframes = self.keyframes.keyframes();
        let report = setup_check::check_drive(setup, config, &keyframes, rim);
        if report.warnings.is_empty() {
            self.doubts = 0;
            self.keep_report(&report);
        }
        let mut warnings = report.warnings;
        warnings.append(&mut self.withdrawn);
        warnings.extend(self.doubted.warning());
        warnings
    }
}

/// Settings, which may be tuned while the robot runs, keyframes, and the mirror's rim in the last images.
type CheckJob = (PipelineConfig, Vec<MeasuredKeyframe>, Option<Rim>);

/// The thread of the checks. One for all of them: each new thread would take memory of its own for the same work.
struct Checker {
    jobs: SyncSender<CheckJob>,
    reports: Receiver<SetupReport>,
}

impl Checker {
    fn start(setup: &Setup) -> Option<Self> {
        let setup = setup.clone();
        let (jobs, waiting) = mpsc::sync_channel::<CheckJob>(1);
        let (report, reports) = mpsc::sync_channel(1);
        let check_all = move || {
            lower_priority();
            // The threads of the process's own pool belong to the pipeline.
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(1)
                .start_handler(|_| lower_priority())
                .build();
            while let Ok((config, keyframes, rim)) = waiting.recv() {
                let check = || setup_check::check_drive(&setup, &config, &keyframes, rim);
                let found = match &pool {
                    Ok(pool) => pool.install(check),
                    Err(_) => SetupReport::default(),
                };
                if report.send(found).is_err() {
                    return;
                }
            }
        };
        let thread = std::thread::Builder::new().name("setup-check".to_owned());
        thread.spawn(check_all).ok()?;
        Some(Checker { jobs, reports })
    }

    /// None while the check goes on.
    fn take_report(&self) -> Option<SetupReport> {
        match self.reports.try_recv() {
            Ok(report) => Some(report),
            Err(TryRecvError::Empty) => None,
            // A panic has been reported by its thread: it says nothing about the set-up.
            Err(TryRecvError::Disconnected) => Some(SetupReport::default()),
        }
    }
}

#[cfg(test)]
mod tests {
    use localize::map_correction::DriveFit;
    use localize::matching::distance_field::DistanceField;

    use super::*;

    fn setup() -> Setup {
        let folder = pipeline::paths::find_resource("config/robots").expect("robots");
        Setup::load(&folder.join("default.toml"), None).expect("a set-up")
    }

    fn doubt() -> SetupReport {
        SetupReport {
            warnings: vec!["the field file is of another field".to_owned()],
            added_pose_covariance: Some(Matrix3::identity()),
            ..SetupReport::default()
        }
    }

    #[test]
    fn poses_are_marked_after_two_doubts_in_a_row_and_unmarked_by_a_right_check() {
        let mut watch = SetupWatch::new(&setup(), &PipelineConfig::default());
        assert!(watch.judge(&doubt()).is_none());
        assert!(watch.judge(&SetupReport::default()).is_none());
        assert!(watch.judge(&doubt()).is_none());
        let verdict = watch.judge(&doubt()).expect("a mark");
        assert_eq!(verdict.covariance, Matrix3::identity());
        assert!(verdict.text.contains("another field"), "{}", verdict.text);
        assert!(watch.judge(&doubt()).is_none(), "said once");
        let verdict = watch.judge(&SetupReport::default()).expect("unmarked");
        assert_eq!(verdict.covariance, Matrix3::zeros());
    }

    #[test]
    fn withdrawn_doubts_stay_with_their_times() {
        let mut watch = SetupWatch::new(&setup(), &PipelineConfig::default());
        for (seconds, report) in [
            (20.0, doubt()),
            (24.0, doubt()),
            (36.0, doubt()),
            (48.0, SetupReport::default()),
        ] {
            watch.last_cycle = Some(Stamp::from_seconds(seconds));
            watch.judge(&report);
        }
        let warnings = watch.finish(&setup(), &PipelineConfig::default(), None);
        let expected = "from 24.0 to 48.0 s: the field file is of another field";
        assert_eq!(warnings, [expected]);
    }

    #[test]
    fn right_set_ups_are_checked_less_and_less_often() {
        let mut watch = SetupWatch::new(&setup(), &PipelineConfig::default());
        for _ in 0..9 {
            watch.judge(&SetupReport::default());
        }
        assert!((watch.period - PERIOD_MAX).abs() < 1e-9);
        watch.judge(&doubt());
        assert!((watch.period - DOUBTED_PERIOD).abs() < 1e-9);
    }

    #[test]
    fn doubts_without_a_covariance_are_reported_once_and_useless_sensors_are_dropped() {
        let mut watch = SetupWatch::new(&setup(), &PipelineConfig::default());
        let mut wheels = SetupReport {
            warnings: vec!["the wheels disagree".to_owned()],
            ..SetupReport::default()
        };
        assert!(watch.judge(&wheels).is_none());
        let verdict = watch.judge(&wheels).expect("a report");
        assert!(verdict.text.contains("wheels") && verdict.drops.is_empty());
        assert_eq!(verdict.covariance, Matrix3::zeros());
        assert!(watch.judge(&wheels).is_none(), "reported once");
        wheels
            .warnings
            .push("the inertial unit is upside down".to_owned());
        wheels.unusable.push(Table::Imu);
        assert!(
            watch
                .judge(&wheels)
                .is_some_and(|verdict| verdict.drops == [Table::Imu])
        );
        assert!(watch.judge(&wheels).is_none(), "dropped once");
    }

    #[test]
    fn mount_that_images_tell_is_taken_into_use_once_and_ends_doubts_at_the_next_right_check() {
        let setup = setup();
        let config = PipelineConfig::default().localize;
        let basis = setup.map_basis(&config).expect("a map").expect("a camera");
        let field = localize::Field::new(setup.field.config.clone()).expect("a field");
        let distances = DistanceField::new(&field, &config.distance_field);
        let map = &config.map_correction;
        let told = || SetupReport {
            map_fit: DriveFit::find(&basis, map, &[], &distances, &config.matching).map(Box::new),
            ..SetupReport::default()
        };
        let mut watch = SetupWatch::new(&setup, &PipelineConfig::default());
        let verdict = watch.judge(&told()).expect("a mount");
        assert!(verdict.map_fit.is_some() && verdict.text == MOUNT_KNOWN);
        assert_eq!(verdict.covariance, Matrix3::zeros());
        assert!(watch.judge(&told()).is_none(), "said once");
        assert!(watch.judge(&doubt()).is_none());
        let verdict = watch.judge(&doubt()).expect("a mark");
        assert!(verdict.map_fit.is_none() && verdict.covariance == Matrix3::identity());
        let verdict = watch.judge(&told()).expect("unmarked");
        assert!(verdict.map_fit.is_none() && verdict.covariance == Matrix3::zeros());
    }

    #[test]
    fn poses_are_unmarked_when_only_doubts_without_a_covariance_remain() {
        let mut watch = SetupWatch::new(&setup(), &PipelineConfig::default());
        watch.judge(&doubt());
        assert!(
            watch
                .judge(&doubt())
                .is_some_and(|verdict| verdict.covariance != Matrix3::zeros())
        );
        let wheels = SetupReport {
            added_pose_covariance: None,
            ..doubt()
        };
        let verdict = watch.judge(&wheels).expect("unmarked");
        assert_eq!(verdict.covariance, Matrix3::zeros());
        assert!(watch.judge(&wheels).is_none());
    }
}
