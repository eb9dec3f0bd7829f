//! How far did the robot move? Converts the wheels' wrapping counters to odometry and slip.

use localize::Stamp;
use localize::omni::OmniKinematics;
use localize::sample::Odometry;

/// Apparent speed of a wheel, over its top speed, beyond which its counter has jumped.
const WHEEL_SPEED_MARGIN: f32 = 2.0;
/// Lower bound of the time between two readings in the jump check, seconds: delayed messages arrive in bursts.
const INTERVAL_MIN: f64 = 0.05;

/// Result of one reading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum OdometryUpdate {
    /// Some wheel has not reported since the last odometry.
    Incomplete,
    /// Motion since the last reading.
    Motion(Odometry),
    /// The first reading, or the first after a gap or a counter jump: it is the new reference.
    Restarted,
}

/// Integrates readings of the wheels' counters to odometry.
#[derive(Debug, Clone)]
pub(crate) struct Odometer {
    omni: OmniKinematics,
    /// Radians per tick; negative for a reversed motor.
    radians_per_tick: Vec<f32>,
    /// Top speed of a wheel, rad/s.
    wheel_speed_max: f32,
    /// Longest time between two readings of which the difference is odometry, seconds.
    gap_max: f64,
    /// The last count of each wheel with its arrival. A stamp of the device's clock would tell nothing about silence.
    latest_counts: Vec<Option<(u32, Stamp)>>,
    /// Which wheels have reported since the last odometry.
    updated: Vec<bool>,
    previous_counts: Option<(Vec<u32>, Stamp)>,
    /// Counter jumps so far.
    pub(crate) counter_jumps: u64,
}

impl Odometer {
    /// `wheel_speed_max`: top speed of the wheels, rad/s. After a gap of more than `gap_max` seconds odometry restarts.
    pub(crate) fn new(
        omni: OmniKinematics,
        radians_per_tick: Vec<f32>,
        wheel_speed_max: f32,
        gap_max: f32,
    ) -> Self {
        let wheels = omni.wheel_count();
        Odometer {
            omni,
            radians_per_tick,
            wheel_speed_max,
            gap_max: f64::from(gap_max),
            latest_counts: vec![None; wheels],
            updated: vec![false; wheels],
            previous_counts: None,
            counter_jumps: 0,
        }
    }

    /// Adds counters of all wheels, read at the same time.
    pub(crate) fn update_all(
        &mut self,
        counts: &[u32],
        stamp: Stamp,
        arrival: Stamp,
    ) -> OdometryUpdate {
        for (latest, count) in self.latest_counts.iter_mut().zip(counts) {
            *latest = Some((*count, arrival));
        }
        self.updated.fill(true);
        self.integrate(stamp)
    }

    /// Adds the counter of one wheel; its stamp is its arrival.
    ///
    /// Controllers on a bus report one by one, so the wheels' readings are up to one period apart. No motion is lost:
    /// what a late reading misses is in the next odometry.
    pub(crate) fn update_wheel(
        &mut self,
        wheel: usize,
        count: u32,
        stamp: Stamp,
    ) -> OdometryUpdate {
        if wheel < self.latest_counts.len() {
            self.latest_counts[wheel] = Some((count, stamp));
            self.updated[wheel] = true;
        }
        self.integrate(stamp)
    }

    /// The wheels without a report for `timeout` seconds since their last one or since `start`.
    pub(crate) fn silent_wheels(
        &self,
        now: Stamp,
        start: Stamp,
        timeout: f32,
    ) -> impl Iterator<Item = usize> {
        let is_silent = move |latest: &Option<(u32, Stamp)>| {
            let last = latest.map_or(start, |(_, arrival)| arrival.max(start));
            now - last > f64::from(timeout)
        };
        let wheels = self.latest_counts.iter().enumerate();
        wheels.filter_map(move |(wheel, latest)| is_silent(latest).then_some(wheel))
    }

    /// True if every wheel has reported since `start`.
    pub(crate) fn all_updated_since(&self, start: Stamp) -> bool {
        self.latest_counts
            .iter()
            .all(|latest| latest.is_some_and(|(_, arrival)| arrival >= start))
    }

    fn integrate(&mut self, stamp: Stamp) -> OdometryUpdate {
        if !self.updated.iter().all(|updated| *updated) {
            return OdometryUpdate::Incomplete;
        }
        self.updated.fill(false);
        let counts: Vec<u32> = self
            .latest_counts
            .iter()
            .flatten()
            .map(|(count, _)| *count)
            .collect();
        let Some((previous, previous_stamp)) =
            self.previous_counts.replace((counts.clone(), stamp))
        else {
            return OdometryUpdate::Restarted;
        };
        let elapsed = stamp - previous_stamp;
        if elapsed > self.gap_max {
            return OdometryUpdate::Restarted;
        }
        let increments: Vec<f32> = counts
            .iter()
            .zip(&previous)
            .zip(&self.radians_per_tick)
            .map(|((now, before), radians)| now.wrapping_sub(*before) as i32 as f32 * radians)
            .collect();
        let increment_max =
            WHEEL_SPEED_MARGIN * self.wheel_speed_max * elapsed.max(INTERVAL_MIN) as f32;
        if increments.iter().any(|turn| turn.abs() > increment_max) {
            self.counter_jumps += 1;
            return OdometryUpdate::Restarted;
        }
        let (motion, slip) = self.omni.twist(&increments);
        OdometryUpdate::Motion(motion.integrate(stamp, slip))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f32::consts::TAU;

    fn odometer(angles_deg: &[f32]) -> Odometer {
        let angles: Vec<_> = angles_deg.iter().map(|angle| angle.to_radians()).collect();
        let omni = OmniKinematics::new(&angles, 0.05, 0.2).expect("a base");
        Odometer::new(omni, vec![TAU / 4096.0; angles.len()], 90.0, 0.5)
    }

    #[test]
    fn counter_wraparound_does_not_affect_odometry() {
        let mut odometer = odometer(&[0.0, 90.0, 180.0, 270.0]);
        // Each wheel makes half a turn: 0.05·π metres of its rim, on a circle of radius 0.2 m.
        let start = [u32::MAX - 100, 5, u32::MAX, i32::MAX as u32];
        let end = start.map(|count| count.wrapping_add(2048));
        assert_eq!(
            odometer.update_all(&start, Stamp(0), Stamp(0)),
            OdometryUpdate::Restarted
        );
        let OdometryUpdate::Motion(odometry) =
            odometer.update_all(&end, Stamp(100_000_000), Stamp(100_000_000))
        else {
            panic!("no motion");
        };
        assert!((odometry.dtheta - 0.05 * TAU / 2.0 / 0.2).abs() < 1e-5);
        assert!(odometry.dx.abs() + odometry.dy.abs() + odometry.slip < 1e-5);
    }

    #[test]
    fn counter_jump_restarts_odometry_without_motion() {
        let mut odometer = odometer(&[60.0, 180.0, 300.0]);
        odometer.update_all(&[1_000_000; 3], Stamp(0), Stamp(0));
        assert_eq!(
            odometer.update_all(&[3; 3], Stamp(10_000_000), Stamp(10_000_000)),
            OdometryUpdate::Restarted
        );
        assert_eq!(odometer.counter_jumps, 1);
        let OdometryUpdate::Motion(odometry) =
            odometer.update_all(&[13; 3], Stamp(20_000_000), Stamp(20_000_000))
        else {
            panic!("no motion");
        };
        assert!(odometry.dtheta > 0.0 && odometry.dtheta < 0.01);
    }

    #[test]
    fn per_wheel_counts_yield_odometry_once_complete_and_silent_wheel_is_identified() {
        let mut odometer = odometer(&[60.0, 180.0, 300.0]);
        for wheel in 0..3 {
            odometer.update_wheel(wheel, 7, Stamp(0));
        }
        assert_eq!(
            odometer.update_wheel(2, 17, Stamp(5_000_000)),
            OdometryUpdate::Incomplete
        );
        assert_eq!(
            odometer.update_wheel(0, 17, Stamp(9_000_000)),
            OdometryUpdate::Incomplete
        );
        assert_eq!(
            odometer.update_wheel(9, 17, Stamp(9_000_000)),
            OdometryUpdate::Incomplete
        );
        assert!(matches!(
            odometer.update_wheel(1, 17, Stamp(10_000_000)),
            OdometryUpdate::Motion(..)
        ));
        odometer.update_wheel(0, 18, Stamp(900_000_000));
        odometer.update_wheel(2, 18, Stamp(900_000_000));
        let now = Stamp(900_000_000);
        let silent = |now, start| {
            odometer
                .silent_wheels(now, Stamp(start), 0.5)
                .collect::<Vec<_>>()
        };
        assert_eq!(silent(now, 0), [1]);
        assert_eq!(silent(now, 600_000_000), [0; 0]);
        let later = Stamp(1_450_000_000);
        assert_eq!(silent(later, 0), [0, 1, 2]);
    }
}
