//! Do the tables of a recording betray a wrong unit? Headings beyond a turn, turns that no robot makes, stamps that
//! overlap no other sensor.

use localize::Stamp;
use localize::math;

use crate::recording::{RecordedData, Recording, Table};

/// Fastest turn of a robot, rad/s: a wheel speed of 5 m/s at 0.2 m from the centre.
const TURN_RATE_MAX: f32 = 25.0;
/// Fastest motion of a robot, m/s.
const SPEED_MAX: f32 = 12.0;
/// Share of the rows whose motion no robot makes, and of those that change as positions do, from which they are positions.
const POSITIONS_MIN: f32 = 0.3;
const CONTINUOUS_MIN: f32 = 0.95;
/// Share of the rows that must exceed a limit: a single bad row is no wrong unit.
const ROWS_MIN: f32 = 0.05;
/// Longest time between rows of odometry that connects images, seconds.
const ODOMETRY_GAP_MAX: f64 = 1.0;
/// Images beyond the odometry's time span at a right clock: at most this share.
const COVERED_MIN: f64 = 0.5;

/// What is wrong with a table.
#[derive(Debug, Clone, PartialEq)]
pub struct RangeFinding {
    /// The table that does not fit the others.
    pub table: Table,
    /// Description with the file and figures.
    pub found: String,
    /// The edit to make.
    pub change: String,
    /// Share of the table's rows that fit, before and after the edit.
    pub fit: [f32; 2],
}

/// The units that the tables betray.
pub(super) fn check_ranges(recording: &Recording) -> Vec<RangeFinding> {
    let mut tables = Tables::default();
    for event in recording.remaining_samples() {
        match &event.data {
            RecordedData::Odometry(odometry) => {
                tables.odometry.push((event.stamp, odometry.dtheta));
                tables.paths.push([odometry.dx, odometry.dy]);
            }
            RecordedData::Compass(compass) => tables.compass.push((event.stamp, compass.heading)),
            RecordedData::Image(_) => tables.images.push(event.stamp),
            RecordedData::Points(_) => {
                tables.from_points = true;
                tables.images.push(event.stamp);
            }
            RecordedData::Imu(_) | RecordedData::Truth(_) => {}
        }
    }
    let checks = [
        // Headings look like turns in degrees.
        tables.check_positions().or_else(|| tables.check_turns()),
        tables.check_headings(),
        tables.check_odometry_stamps(),
        tables.check_image_stamps(),
    ];
    checks.into_iter().flatten().collect()
}

#[derive(Default)]
struct Tables {
    odometry: Vec<(Stamp, f32)>,
    /// dx and dy of each row, metres.
    paths: Vec<[f32; 2]>,
    compass: Vec<(Stamp, f32)>,
    images: Vec<Stamp>,
    from_points: bool,
}

impl Tables {
    fn images_name(&self) -> &'static str {
        if self.from_points {
            "points.csv"
        } else {
            "frames.csv"
        }
    }

    /// Rows that no robot moves by, and which change as little as a position does.
    fn check_positions(&self) -> Option<RangeFinding> {
        let rows = self.odometry.windows(2).zip(self.paths.windows(2));
        let timed = rows.filter_map(|(stamps, paths)| {
            let seconds = (stamps[1].0 - stamps[0].0) as f32;
            (seconds > 0.0).then_some((seconds, paths[0], paths[1]))
        });
        let speeds: Vec<[f32; 2]> = timed
            .map(|(seconds, before, after)| {
                let change = [after[0] - before[0], after[1] - before[1]];
                [after, change].map(|[x, y]| math::hypot(x, y) / seconds)
            })
            .collect();
        let count = speeds.len();
        let fast = speeds.iter().filter(|[row, _]| *row > SPEED_MAX).count();
        let continuous = speeds
            .iter()
            .filter(|[_, change]| *change < SPEED_MAX)
            .count();
        (share(fast, count) > POSITIONS_MIN && share(continuous, count) > CONTINUOUS_MIN)
            .then(|| {
                let far = self.paths.iter().map(|[x, y]| math::hypot(*x, *y));
                RangeFinding {
                    table: Table::Odometry,
                    found: format!(
                        "odometry.csv: dx_m and dy_m reach {:.1} m in a row and change little from row to row: positions, not the motion since the row before?",
                        far.fold(0.0, f32::max)
                    ),
                    change: "odometry.csv: in each row the motion since the previous one, dx_m and dy_m in the robot frame of that row"
                        .to_owned(),
                    fit: [share(count - fast, count), 1.0],
                }
            })
    }

    /// Turns per row that no robot makes.
    fn check_turns(&self) -> Option<RangeFinding> {
        let rates = self.odometry.windows(2).filter_map(|rows| {
            let seconds = rows[1].0 - rows[0].0;
            (seconds > 0.0).then(|| rows[1].1.abs() / seconds as f32)
        });
        let (fast, fastest, count) = count_beyond(rates, TURN_RATE_MAX);
        (fast as f32 >= (ROWS_MIN * count as f32).max(2.0)).then(|| RangeFinding {
            table: Table::Odometry,
            found: format!(
                "odometry.csv: dtheta_rad turns by up to {fastest:.0} rad/s (expected at most {TURN_RATE_MAX:.0}): degrees?"
            ),
            change: "odometry.csv: convert dtheta_rad from degrees to radians (divide by 57.29578)"
                .to_owned(),
            fit: [share(count - fast, count), 1.0],
        })
    }

    /// Headings beyond a turn that a continuous angle does not explain: it starts within a turn and never jumps.
    fn check_headings(&self) -> Option<RangeFinding> {
        use std::f32::consts::TAU;
        let headings = self.compass.iter().map(|(_, heading)| heading.abs());
        let (beyond, largest, count) = count_beyond(headings, TAU);
        if beyond == 0 {
            return None;
        }
        let starts_beyond = self
            .compass
            .first()
            .is_some_and(|(_, first)| first.abs() > TAU);
        let rates = self.compass.windows(2).filter_map(|rows| {
            let seconds = rows[1].0 - rows[0].0;
            (seconds > 0.0).then(|| (rows[1].1 - rows[0].1).abs() / seconds as f32)
        });
        let (fast, _, pairs) = count_beyond(rates, TURN_RATE_MAX);
        let jumps = fast as f32 >= (ROWS_MIN * pairs as f32).max(2.0);
        (starts_beyond || jumps).then(|| RangeFinding {
            table: Table::Compass,
            found: format!(
                "compass.csv: heading_rad reaches {largest:.1} (expected radians, at most {TAU:.2}): degrees?"
            ),
            change: "compass.csv: convert heading_rad from degrees to radians (divide by 57.29578)"
                .to_owned(),
            fit: [share(count - beyond, count), 1.0],
        })
    }

    /// Rows of odometry so far apart that no image is connected to the next.
    fn check_odometry_stamps(&self) -> Option<RangeFinding> {
        let mut gaps: Vec<f64> = self
            .odometry
            .windows(2)
            .map(|rows| rows[1].0 - rows[0].0)
            .collect();
        gaps.sort_by(f64::total_cmp);
        let median = *gaps.get(gaps.len() / 2)?;
        if median <= ODOMETRY_GAP_MAX || gaps.len() < 4 {
            return None;
        }
        let unit = unit_of(median);
        let connected = gaps.iter().filter(|gap| **gap <= ODOMETRY_GAP_MAX).count();
        Some(RangeFinding {
            table: Table::Odometry,
            found: format!(
                "odometry.csv: its rows are {median:.1} s apart (expected at most {ODOMETRY_GAP_MAX}): stamp_s in {}?",
                unit.name
            ),
            change: format!(
                "odometry.csv and the tables of the same clock: convert stamp_s from {} to seconds (divide by {})",
                unit.name, unit.per_second
            ),
            fit: [share(connected, gaps.len()), 1.0],
        })
    }

    /// Images at times of which the wheels know nothing.
    fn check_image_stamps(&self) -> Option<RangeFinding> {
        let others = if self.odometry.len() >= 2 {
            ("odometry.csv", &self.odometry)
        } else {
            ("compass.csv", &self.compass)
        };
        let (name, rows) = others;
        let (first, last) = (rows.first()?.0, rows.last()?.0);
        if self.images.len() < 4 || rows.len() < 4 {
            return None;
        }
        let inside =
            |stamp: &f64| *stamp >= first.seconds() - 1.0 && *stamp <= last.seconds() + 1.0;
        let seconds: Vec<f64> = self.images.iter().map(|stamp| stamp.seconds()).collect();
        let covered = |factor: f64| {
            let scaled = seconds.iter().map(|stamp| stamp * factor);
            scaled.filter(inside).count() as f64 / seconds.len() as f64
        };
        let (first_image, last_image) = (*seconds.first()?, *seconds.last()?);
        let now = covered(1.0);
        if now >= COVERED_MIN {
            return None;
        }
        let images = self.images_name();
        let factors = UNITS.iter().flat_map(|unit| {
            let (per_second, text) = (unit.per_second, unit.name);
            [
                (1.0 / per_second, images, text, per_second),
                (per_second, name, text, per_second),
            ]
        });
        let best = factors
            .map(|unit| (covered(unit.0), unit))
            .filter(|(share, (factor, ..))| {
                // Both must last about as long, or images divided by a thousand would fit any table.
                let ratio = (last_image - first_image) * factor / (last - first).max(1e-9);
                *share >= COVERED_MIN.max(2.0 * now) && (0.5..=2.0).contains(&ratio)
            })
            .max_by(|a, b| a.0.total_cmp(&b.0));
        let span = format!(
            "{images}: {:.0} % of its stamps ({:.1} to {:.1} s) lie within those of {name} ({:.1} to {:.1} s)",
            100.0 * now,
            first_image,
            last_image,
            first.seconds(),
            last.seconds()
        );
        // Without a matching unit, only tables with nothing in common are certainly wrong: a recording may end early.
        let (found, change, after) = match best {
            Some((after, (_, table, unit, per_second))) => (
                format!("{span}: stamp_s of {table} in {unit}?"),
                format!("{table}: convert stamp_s from {unit} to seconds (divide by {per_second})"),
                after,
            ),
            None if now == 0.0 => (
                format!("{span}: two clocks?"),
                format!("{images} or {name}: give both the stamps of one clock"),
                1.0,
            ),
            None => return None,
        };
        Some(RangeFinding {
            table: Table::Images,
            found,
            change,
            fit: [now as f32, after as f32],
        })
    }
}

struct Unit {
    name: &'static str,
    per_second: f64,
}

const UNITS: [Unit; 3] = [
    Unit {
        name: "milliseconds",
        per_second: 1e3,
    },
    Unit {
        name: "microseconds",
        per_second: 1e6,
    },
    Unit {
        name: "nanoseconds",
        per_second: 1e9,
    },
];

/// The unit in which an interval of odometry is between a millisecond and a second.
fn unit_of(interval: f64) -> &'static Unit {
    let fitting = UNITS.iter().find(|unit| interval / unit.per_second <= 1.0);
    fitting.unwrap_or(&UNITS[2])
}

/// How many values exceed a limit, the largest value, and how many there are.
fn count_beyond(values: impl Iterator<Item = f32>, limit: f32) -> (usize, f32, usize) {
    values.fold((0, 0.0, 0), |(beyond, largest, count), value| {
        let more = usize::from(value > limit);
        (beyond + more, f32::max(largest, value), count + 1)
    })
}

fn share(part: usize, whole: usize) -> f32 {
    part as f32 / whole.max(1) as f32
}
