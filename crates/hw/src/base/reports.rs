//! What does the base say besides motion? Battery and motors, kicker, bumpers and emergency stop.

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
    /// One driver's temperature, 0.1 °C; the first wheel's begins a new round.
    pub(super) fn update_temperature(&mut self, wheel: usize, temperature_ddeg: i16) {
        let temperature_c = f32::from(temperature_ddeg) * 0.1;
        self.temperature_c = if wheel == 0 {
            temperature_c
        } else {
            self.temperature_c.max(temperature_c)
        };
    }
}

/// The kicker.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct KickerReport {
    /// When it was measured.
    pub stamp: Stamp,
    /// Voltage of its capacitor, volts.
    pub capacitor_voltage: f32,
    /// It can kick now.
    pub ready: bool,
    /// It is charging.
    pub charging: bool,
    /// It cannot charge.
    pub charge_fault: bool,
    /// The ball is before it.
    pub ball_present: bool,
    /// Sequence number of the last kick that was carried out.
    pub last_kick: u16,
}

/// What keeps the robot from moving.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SwitchReport {
    /// When it was read.
    pub stamp: Stamp,
    /// One bit for each pressed bumper, from the front counter-clockwise.
    pub bumpers: u8,
    /// The emergency stop is pressed.
    pub emergency_stop: bool,
    /// The board has stopped the wheels for want of a fresh command.
    pub command_stale: bool,
}
