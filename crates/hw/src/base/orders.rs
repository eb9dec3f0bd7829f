//! What are the wheels to do now? The last command while it is fresh, else stop: the watchdog.

use localize::Stamp;
use localize::omni::Twist;

/// How the robot is driven.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Drive {
    /// By its velocity, robot frame.
    Twist(Twist),
    /// By the speed of each wheel, rad/s, in the order of robot.toml's wheels; a fourth that is not there is ignored.
    Wheels([f32; 4]),
}

/// Standing still.
impl Default for Drive {
    fn default() -> Self {
        Drive::Twist(Twist::default())
    }
}

/// A kick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Kick {
    /// Speed of the ball, m/s.
    pub speed: f32,
    /// Lofted, or along the ground.
    pub lofted: bool,
}

/// What the bus is to tell the wheels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Order {
    /// Drive like this; the command holds for so many seconds more.
    Drive(Drive, f64),
    /// Stand: speed zero, held.
    Brake,
    /// Let go: no current.
    Release,
}

/// The commands of those who drive, and whether they still count.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Orders {
    drive: Option<(Drive, Stamp)>,
    stale_since: Option<Stamp>,
    kick: Option<(Kick, Stamp)>,
    dribble: Option<([f32; 2], Stamp)>,
    /// True after a command that the bus has not been told.
    pub(crate) news: bool,
    /// Orders to brake or release that went out.
    pub(crate) stops_sent: u64,
    /// No command is taken any more.
    pub(crate) closed: bool,
}

impl Orders {
    /// Drive like this until the deadline.
    pub(crate) fn drive(&mut self, drive: Drive, deadline: Stamp) {
        self.drive = Some((drive, deadline));
        self.stale_since = None;
        self.news = true;
    }

    /// Stop, whatever was commanded.
    pub(crate) fn halt(&mut self, now: Stamp) {
        *self = Orders {
            stale_since: self.drive.map(|_| now).or(self.stale_since),
            stops_sent: self.stops_sent,
            closed: self.closed,
            news: true,
            ..Orders::default()
        };
    }

    pub(crate) fn kick(&mut self, kick: Kick, deadline: Stamp) {
        self.kick = Some((kick, deadline));
        self.news = true;
    }

    pub(crate) fn dribble(&mut self, speeds: [f32; 2], deadline: Stamp) {
        self.dribble = Some((speeds, deadline));
        self.news = true;
    }

    /// What the wheels are to do; stopped ones are braked for `brake_time` seconds, then let go.
    pub(crate) fn order(&mut self, now: Stamp, brake_time: f32) -> Order {
        if let Some((drive, deadline)) = self.drive {
            let left = deadline - now;
            if left > 0.0 {
                return Order::Drive(drive, left);
            }
            self.drive = None;
            self.stale_since = Some(now);
        }
        match self.stale_since {
            Some(since) if now - since < f64::from(brake_time) => Order::Brake,
            _ => Order::Release,
        }
    }

    /// The kick that is wanted, once; one whose time has passed is forgotten.
    pub(crate) fn take_kick(&mut self, now: Stamp) -> Option<(Kick, f64)> {
        let (kick, deadline) = self.kick.take()?;
        (deadline > now).then_some((kick, deadline - now))
    }

    /// Speeds of the left and right dribbling wheel, rad/s, while they are wanted.
    pub(crate) fn dribbling(&self, now: Stamp) -> Option<([f32; 2], f64)> {
        let (speeds, deadline) = self.dribble?;
        (deadline > now).then_some((speeds, deadline - now))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: i64 = 1_000_000;

    #[test]
    fn wheels_brake_when_a_command_grows_stale_and_are_let_go_later() {
        let mut orders = Orders::default();
        assert_eq!(orders.order(Stamp(0), 0.5), Order::Release);
        let drive = Drive::Wheels([1.0; 4]);
        orders.drive(drive, Stamp(100 * MS));
        assert_eq!(orders.order(Stamp(50 * MS), 0.5), Order::Drive(drive, 0.05));
        assert_eq!(orders.order(Stamp(100 * MS), 0.5), Order::Brake);
        assert_eq!(orders.order(Stamp(599 * MS), 0.5), Order::Brake);
        assert_eq!(orders.order(Stamp(600 * MS), 0.5), Order::Release);
        orders.drive(drive, Stamp(800 * MS));
        assert!(matches!(
            orders.order(Stamp(700 * MS), 0.5),
            Order::Drive(..)
        ));
        orders.halt(Stamp(710 * MS));
        assert_eq!(orders.order(Stamp(720 * MS), 0.5), Order::Brake);
    }

    #[test]
    fn a_kick_happens_once_and_never_late() {
        let mut orders = Orders::default();
        let kick = Kick {
            speed: 8.0,
            lofted: false,
        };
        orders.kick(kick, Stamp(50 * MS));
        assert_eq!(orders.take_kick(Stamp(30 * MS)), Some((kick, 0.02)));
        assert_eq!(orders.take_kick(Stamp(31 * MS)), None);
        orders.kick(kick, Stamp(50 * MS));
        assert_eq!(orders.take_kick(Stamp(60 * MS)), None);
    }
}
