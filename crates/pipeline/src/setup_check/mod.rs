//! Is the set-up right? Tries other fields, camera mounts, compass turns and units on the same measurements.
//!
//! `ranges` reads what the tables betray, `measurements` selects keyframes, `assess` compares variants of the set-up
//! (`variant`, `change`) by `localize::setup_check`, `origin_offset` where the wheels turn, `rim_centre` where the mirror's rim is, `dead_sensors`, `compass_faults` and `inertial` find
//! sensors that say nothing or lie, `late_turns` those whose stamps are late, `image_scan` images that show no field. The report has warnings for every run and suggestions for the
//! doctor.

mod assess;
mod camera_search;
mod change;
mod collector;
mod compass_faults;
mod compass_noise;
mod compass_turn;
mod dead_sensors;
mod doubts;
mod effort;
mod expected_mount;
mod field_search;
mod field_sizes;
mod image_age;
mod image_scan;
mod inertial;
mod inertial_motion;
mod late_turns;
mod latency;
mod map_mount;
mod measurements;
mod motion_search;
mod odometry_coverage;
mod origin_offset;
mod pose_covariance;
mod ranges;
mod report;
mod rim_centre;
#[cfg(test)]
mod tests;
mod variant;

use std::path::Path;

use anyhow::Result;
use localize::setup_check::compare;
use vision::calibrate::Rim;

pub use collector::KeyframeCollector;
pub use effort::Effort;
pub use inertial_motion::InertialMotion;
pub use map_mount::{LINES_ORIGIN_STD, MapMount, find_map_mount};
pub use measurements::MeasuredKeyframe;
pub use ranges::RangeFinding;
pub use report::{FitFigures, HALF_HINT, SetupReport, Suggestion};

use crate::config::PipelineConfig;
use crate::doubted_poses::DoubtedPoses;
use crate::image_faults::ImageFaults;
use crate::log::{LogReader, UnpackedSetup};
use crate::pose_leaps::PoseLeaps;
use crate::recording::{Recording, Table};
use crate::setup::Setup;
use assess::{Assessment, Improvement, Trial, assess, compass_agreement_in_degrees};
use change::Change;
use compass_faults::CompassFault;
use compass_turn::constant_deviation_deg;
use dead_sensors::FIT_FINE;
use expected_mount::ExpectedMount;
use image_age::ImageAge;
use latency::OtherLatency;
use odometry_coverage::OdometryGaps;
use origin_offset::{OriginOffset, compare_with_offsets};
use pose_covariance::added_pose_covariance;
use variant::SetupVariant;

/// Share of compass readings that agree although the range of the column looks like degrees.
const COMPASS_FINE: f32 = 0.8;

/// Checks the set-up of a recording.
pub fn check_recording(
    recording: &Recording,
    setup: &Setup,
    config: &PipelineConfig,
    effort: Effort,
) -> Result<SetupReport> {
    let ranges = ranges::check_ranges(recording);
    let measured = measurements::measure(recording, setup, config, effort)?;
    let noise = compass_noise::recording_noise(recording);
    let findings = RecordingFindings {
        ranges,
        noise,
        rim: measured.rim,
    };
    // Stamps of another unit or clock have no gaps of their own.
    let is_other_clock = findings
        .ranges
        .iter()
        .any(|found| found.table == Table::Images);
    let gaps = if is_other_clock {
        OdometryGaps::default()
    } else {
        odometry_coverage::find_gaps(recording)
    };
    let age = (!is_other_clock && !gaps.clock_jumps)
        .then(|| find_image_age(recording, setup, config, &measured.keyframes))
        .flatten();
    let latency = setup.camera_latency(&config.localize.filter);
    let check = |keyframes: &[MeasuredKeyframe]| {
        check_findings(setup, config, keyframes, &findings, effort)
    };
    let mut report = match age {
        None => check(&measured.keyframes),
        Some(ImageAge {
            seconds,
            from: None,
        }) => {
            let age = latency + seconds as f32;
            let keyframes = measured.at_age(recording, setup, latency.into(), seconds);
            let mut report = check(&keyframes);
            let wheels = SetupVariant::configured(setup).wheels(setup);
            report.doubt_latency(&OtherLatency::new(age, latency, &keyframes, &wheels));
            report
        }
        Some(ImageAge {
            seconds,
            from: Some(first),
        }) => {
            let (before, after) = measured.keyframes.split_at(first);
            let mut report = check(before);
            let has_pixels = measured
                .keyframes
                .iter()
                .any(|keyframe| !keyframe.pixels.is_empty());
            let images = if has_pixels {
                "frames.csv"
            } else {
                "points.csv"
            };
            report.doubt_clock(seconds, after[0].stamp, images, setup);
            report
        }
    }
    .with_image_faults(measured.image_faults);
    gaps.found.into_iter().for_each(|gap| report.doubt(gap));
    if gaps.clock_jumps {
        report.unusable.push(Table::Odometry);
    }
    Ok(report)
}

/// Checks the set-up that a log holds by the line points, wheels and compass that it recorded.
pub fn check_log(path: &Path, effort: Effort) -> Result<SetupReport> {
    let log = LogReader::open(path)?;
    let unpacked = UnpackedSetup::load(log.header())?;
    let config = unpacked.config()?;
    let mut keyframes = KeyframeCollector::new(&unpacked.setup, &config.localize.filter);
    let mut faults = ImageFaults::default();
    let mut leaps = PoseLeaps::new(unpacked.setup.robot.odometry);
    let mut doubted = DoubtedPoses::default();
    for logged in log {
        let cycle = logged?.cycle;
        keyframes.add_cycle(&cycle);
        faults.add_cycle(&cycle, None);
        leaps.add(&cycle);
        doubted.add(&cycle);
    }
    let report = check_findings(
        &unpacked.setup,
        &config,
        &keyframes.keyframes(),
        &RecordingFindings::default(),
        effort,
    );
    let report = report.with_image_faults(Some(faults));
    let path_warnings = [leaps.warning(), doubted.warning()];
    Ok(report.with_path_warnings(path_warnings.into_iter().flatten()))
}

/// What a recording says beside its keyframes.
#[derive(Default)]
struct RecordingFindings {
    ranges: Vec<RangeFinding>,
    /// Standard deviation of the compass from one reading to the next, radians.
    noise: Option<f32>,
    /// The mirror's rim in the images. None where it is not seen.
    rim: Option<Rim>,
}

/// Checks a set-up by keyframes of a run.
///
/// The map counts as given: poses of a run that does not check itself do not know the mount that its images tell afterwards.
pub fn check(
    setup: &Setup,
    config: &PipelineConfig,
    measured: &[MeasuredKeyframe],
    effort: Effort,
) -> SetupReport {
    check_points(
        setup,
        config,
        measured,
        &RecordingFindings::default(),
        effort,
    )
    .0
}

/// As [`check`], by the mount that the images tell ([`SetupReport::map_fit`]) where the map as given does not explain them. `rim`: the
/// mirror's in the images, where it is known.
pub fn check_drive(
    setup: &Setup,
    config: &PipelineConfig,
    measured: &[MeasuredKeyframe],
    rim: Option<Rim>,
) -> SetupReport {
    let findings = RecordingFindings {
        rim,
        ..RecordingFindings::default()
    };
    check_findings(setup, config, measured, &findings, Effort::Brief)
}

/// The images of a drive tell the mount of an uncalibrated camera, such as localization expects it. What looks wrong without it is
/// looked at again.
fn check_findings(
    setup: &Setup,
    config: &PipelineConfig,
    measured: &[MeasuredKeyframe],
    findings: &RecordingFindings,
    effort: Effort,
) -> SetupReport {
    let (given, assessment) = check_points(setup, config, measured, findings, effort);
    let mount = expected_mount::find(setup, &config.localize, measured, &assessment.configured);
    let (map_fit, by_mount) = match mount {
        None => return given,
        Some(ExpectedMount::Learned(map_fit, by_mount)) => (map_fit, by_mount),
        Some(ExpectedMount::MovedBefore(first)) => {
            let (before, after) = measured.split_at(first);
            let (mut report, _) = check_points(setup, config, before, findings, effort);
            report.doubt_mount_after(after.first().map(|keyframe| keyframe.stamp));
            return report;
        }
    };
    let (mut report, with_mount) = check_points(setup, config, &by_mount, findings, effort);
    let centre = centre_beside_mount(&assessment, &with_mount);
    let is_better = |centre: &Improvement| {
        compare_with_offsets(&with_mount.configured, &centre.explanation).is_better()
    };
    if field_is_better_than_mount(&assessment, &with_mount)
        || lines_are_better_than_mount(&assessment, &with_mount)
        || centre.as_ref().is_some_and(is_better)
    {
        return given;
    }
    if let Some(figures) = &mut report.figures {
        figures.mount_learned = true;
    }
    report.map_fit = Some(map_fit);
    let is_as_good = |centre: &Improvement| {
        centre.explanation.on_markings() > with_mount.configured.on_markings() - EQUAL_SHARE
    };
    if let Some(centre) = centre.filter(is_as_good) {
        let improvements = vec![vec![centre]];
        report.add_improvements(
            setup,
            &Assessment {
                improvements,
                ..assessment
            },
        );
    }
    report
}

/// A smaller difference of two shares of points on markings is none.
const EQUAL_SHARE: f32 = 0.01;

/// Does another field explain clearly more points `given` by the map than the mount does? A mount within what is expected absorbs
/// a part of a field that is a few decimetres too short.
fn field_is_better_than_mount(given: &Assessment, with_mount: &Assessment) -> bool {
    let by_mount = with_mount.configured.on_markings();
    given.edits().any(|found| {
        matches!(found.change, Change::Sizes { .. } | Change::Field(..))
            && found.explanation.on_markings() > by_mount + EQUAL_SHARE
    })
}

/// Do sizes to other edges of the lines explain the points `given` by the map clearly better than the mount does?
fn lines_are_better_than_mount(given: &Assessment, with_mount: &Assessment) -> bool {
    given.edits().any(|found| {
        matches!(found.change, Change::MeasuredTo(_))
            && compare(&with_mount.configured, &found.explanation).is_better()
    })
}

/// Another centre of the mirror's image beside the map as `given`, which the mount hides. A tilted mount moves the ground much as the
/// centre does, but not the point that the wheels turn about.
fn centre_beside_mount(given: &Assessment, with_mount: &Assessment) -> Option<Improvement> {
    let centre = |assessment: &Assessment| {
        let mut changes = assessment.improvements.iter().flatten();
        changes
            .find(|found| matches!(found.change, Change::Centre(_)))
            .cloned()
    };
    centre(given).filter(|_| centre(with_mount).is_none())
}

/// Checks a set-up by keyframes with the points of one map. Second: what the trials found.
fn check_points(
    setup: &Setup,
    config: &PipelineConfig,
    measured: &[MeasuredKeyframe],
    findings: &RecordingFindings,
    effort: Effort,
) -> (SetupReport, Assessment) {
    let usable: Vec<MeasuredKeyframe> = measured
        .iter()
        .filter(|keyframe| keyframe.points.len() >= config.localize.mode.points_min)
        .cloned()
        .collect();
    if usable.len() < KEYFRAMES_MIN {
        return (
            SetupReport::default().with_ranges(&findings.ranges),
            Assessment::default(),
        );
    }
    let trial = Trial::new(setup, &config.localize, measured).with_rim(findings.rim);
    let mut assessment = assess(&trial, effort);
    let compass_fault = find_compass_fault(config, measured, &assessment, findings);
    let mut ranges = findings.ranges.clone();
    if let Some(without) = compass_fault
        .as_ref()
        .and_then(|fault| fault.without_ignored(measured))
    {
        let trial = Trial::new(setup, &config.localize, &without).with_rim(findings.rim);
        assessment = assess(&trial, effort);
    }
    let latency = find_latency(setup, config, measured, &assessment);
    if latency.is_some() {
        assessment.improvements.clear();
    }
    let configured = &assessment.configured;
    let path_of_poses =
        dead_sensors::wheels_stand_still(measured).then(|| dead_sensors::path_of_poses(configured));
    if path_of_poses == Some(None) {
        // The robot stands: images of one place say little about a set-up.
        return (SetupReport::default().with_ranges(&ranges), assessment);
    }
    // A continuous heading in radians may exceed a turn: the poses decide. Few of them agree with any heading by chance.
    let agreement = configured.compass_agrees().unwrap_or(0.0);
    if agreement >= COMPASS_FINE && ranges.iter().any(|each| each.table == Table::Compass) {
        let degrees = compass_agreement_in_degrees(setup, &config.localize, measured);
        if degrees.is_none_or(|degrees| degrees < agreement) {
            ranges.retain(|finding| finding.table != Table::Compass);
        }
    }
    let mut report = SetupReport {
        figures: Some(FitFigures::of(configured)),
        sensors: setup.sensors,
        ..SetupReport::default()
    };
    report.add_improvements(setup, &assessment);
    if assessment.fits_no_better_than_random {
        report.doubt(format!(
            "the line points fit this field no better than other fields ({:.0} % on markings): check the field file, and the map or mirror profile",
            100.0 * configured.on_markings()
        ));
    }
    let explained = assessment.explained();
    report.add_doubts(&assessment, explained, path_of_poses.flatten(), &ranges);
    if let Some(turn) = dead_sensors::turns_without_wheels(measured, explained) {
        report.doubt(format!(
            "{}: the wheels report a path, but never a turn (dtheta_rad), and the images show turns of {turn:.1} radians",
            setup.sensors.place(Table::Odometry)
        ));
    }
    report.added_pose_covariance = added_pose_covariance(setup, &assessment);
    report.doubt_markings(setup, &assessment);
    // A matrix of the wheels says about which point they turn.
    if explained.on_markings() > FIT_FINE
        && !assessment.has_edit(|change| matches!(change, Change::WheelMatrix(_)))
        && let Some(offset) = OriginOffset::find(explained)
    {
        report.doubt_origin(&offset);
    }
    // Late images or wheels would look like early sensors.
    let in_time = latency
        .is_none()
        .then(|| SetupVariant::configured(setup).wheels(setup));
    if let Some(latency) = latency {
        report.doubt_latency(&latency);
    }
    if let Some(fault) = compass_fault {
        if fault.is_useless {
            report.unusable.push(Table::Compass);
        }
        let place = setup.sensors.place(Table::Compass);
        report.doubt(format!("{place}: {}", fault.text));
    } else if let Some(late) = in_time.and_then(|wheels| late_turns::of_compass(measured, &wheels))
    {
        report.doubt_stamps(Table::Compass, "headings", late);
    } else if assessment.improvements.is_empty()
        && let keyframes = SetupVariant::configured(setup).apply(setup, measured)
        && let Some(degrees) = constant_deviation_deg(&assessment.configured, &keyframes)
    {
        report.doubt(format!(
            "{}: the headings of the poses are {degrees:.0}° from its own on average, more than iron explains. Add that to its heading",
            setup.sensors.place(Table::Compass)
        ));
    }
    let late = in_time.and_then(|wheels| late_turns::of_inertial_unit(measured, &wheels));
    report.doubt_inertial_unit(measured, &assessment, late);
    leave_out_wrong_tables(&mut report, &assessment, &mut ranges);
    (report.with_ranges(&ranges), assessment)
}

/// Leaves out the tables that an edit changes by more than any filter learns. What their values betray is then known.
fn leave_out_wrong_tables(
    report: &mut SetupReport,
    assessment: &Assessment,
    ranges: &mut Vec<RangeFinding>,
) {
    let all = assessment.improvements.iter().flatten();
    let compass = all
        .clone()
        .any(|found| found.change == Change::CompassInDegrees);
    let wheels = all
        .clone()
        .any(|found| found.change.is_unit_or_axis_of_wheels())
        || assessment.has_edit(Change::exceeds_learned_wheels);
    if compass {
        report.unusable.push(Table::Compass);
        ranges.retain(|finding| finding.table != Table::Compass);
    }
    if wheels {
        report.unusable.push(Table::Odometry);
        ranges.retain(|finding| finding.table != Table::Odometry);
    }
}

/// An age of the images tenths of a second from the configured one, which looks like many another mistake.
fn find_image_age(
    recording: &Recording,
    setup: &Setup,
    config: &PipelineConfig,
    measured: &[MeasuredKeyframe],
) -> Option<ImageAge> {
    let trial = Trial::new(setup, &config.localize, measured);
    let variant = SetupVariant::configured(setup);
    let explanation = trial.explain(&variant, measured)?;
    let latency = setup.camera_latency(&config.localize.filter);
    let wheels = variant.wheels(setup);
    image_age::find(recording, measured, &explanation, &wheels, latency.into())
}

/// A latency that differs from the configured one. A delay passes for a camera turned by degrees, which delays no turn of the robot, and
/// where the robot hardly changes its speed for other wheels, beside which it is fitted. Any other mistake contradicts the wheels' steps,
/// too. A latency that is estimated while driving needs no edit.
fn find_latency(
    setup: &Setup,
    config: &PipelineConfig,
    measured: &[MeasuredKeyframe],
    assessment: &Assessment,
) -> Option<OtherLatency> {
    let filter = &config.localize.filter;
    let is_other =
        |change: &Change| !matches!(change, Change::CameraTurn(_) | Change::WheelMatrix(_));
    if filter.camera_latency_std != 0.0 || assessment.has_edit(is_other) {
        return None;
    }
    let wheels = SetupVariant::configured(setup).wheels(setup);
    let configured = setup.camera_latency(filter);
    latency::other_latency(measured, &assessment.configured, &wheels, configured)
}

/// The compass's fault. None if a known mistake explains its readings, since it is useful once that is mended.
fn find_compass_fault(
    config: &PipelineConfig,
    measured: &[MeasuredKeyframe],
    assessment: &Assessment,
    findings: &RecordingFindings,
) -> Option<CompassFault> {
    let is_known = |change: &Change| {
        matches!(
            change,
            Change::CompassInDegrees | Change::CompassMirrored(_) | Change::CompassTurn(_)
        )
    };
    let mut changes = assessment.improvements.iter().flatten();
    let is_wrong = |table| findings.ranges.iter().any(|found| found.table == table);
    // Images of another clock have the readings of other times.
    if is_wrong(Table::Images) || changes.any(|found| is_known(&found.change)) {
        return None;
    }
    let stated = config.localize.compass.std_deg.to_radians();
    let noise = findings.noise.filter(|_| !is_wrong(Table::Compass));
    compass_faults::find_compass_fault(
        measured,
        assessment.explained(),
        noise.map(|noise| [noise, stated]),
    )
}

/// Fewer keyframes say nothing about a set-up.
const KEYFRAMES_MIN: usize = 4;
