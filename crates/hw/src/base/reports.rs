//! What does the base report besides motion? Battery and motors, kicker, bumpers and emergency stop.

use localize::Stamp;

/// Battery and motors.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PowerReport {
    /// When it was measured.
    pub stamp: Stamp,
    /// Battery, volts.
    pub battery_voltage: f32,
    /// Hottest motor driver, °C.
    pub temperature_c: f32,
    /// Current of each motor, amperes.
    pub motor_current: [f32; 4],
    /// Fault code of each motor's driver, 0 for none (VESC).
    pub motor_fault: [u8; 4],
}

impl PowerReport {
    /// Updates the maximum with one driver's temperature, 0.1 °C; wheel 0 restarts the maximum.
    pub(super) fn update_temperature(&mut self, wheel: usize, temperature_ddeg: i16) {
        let temperature_c = f32::from(temperature_ddeg) * 0.1;
        self.temperature_c = if wheel == 0 {
            temperature_c
        } else {
            self.temperature_c.max(temperature_c)
        };
    }
}

/// State of the kicker.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct KickerReport {
    /// When it was measured.
    pub stamp: Stamp,
    /// Voltage of the capacitor, volts.
    pub capacitor_voltage: f32,
    /// True if it can kick now.
    pub ready: bool,
    /// True while it charges.
    pub charging: bool,
    /// True if it cannot charge.
    pub charge_fault: bool,
    /// True if the ball is in front of it.
    pub ball_present: bool,
    /// Sequence number of the last kick that was carried out.
    pub last_kick: u16,
}

/// Bumpers, and what stops the robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SwitchReport {
    /// When it was read.
    pub stamp: Stamp,
    /// One bit per pressed bumper, counter-clockwise from the front.
    pub bumpers: u8,
    /// True while the emergency stop is pressed.
    pub emergency_stop: bool,
    /// True while the wheels are stopped because the last command expired.
    pub command_stale: bool,
}
