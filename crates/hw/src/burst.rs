//! When were readings taken that arrived together? A sensor without a clock sends evenly, whenever its reader has time.

use localize::Stamp;

use crate::event_queue::DeviceEvent;

/// Spreads the readings of each kind evenly over the time since the previous arrival; the last one is as old as `arrival`.
///
/// A single reading keeps its time. Without `previous` all do: nothing tells for how long they waited.
pub(crate) fn spread_stamps(readings: &mut [DeviceEvent], previous: Option<Stamp>, arrival: Stamp) {
    let Some(previous) = previous else { return };
    let waited_ns = (arrival.0 - previous.0).max(0);
    let mut imu: Vec<&mut Stamp> = Vec::new();
    let mut compass: Vec<&mut Stamp> = Vec::new();
    for reading in readings {
        match reading {
            DeviceEvent::Imu(reading) => imu.push(&mut reading.stamp),
            DeviceEvent::Compass(reading) => compass.push(&mut reading.stamp),
            _ => {}
        }
    }
    for mut stamps in [imu, compass] {
        let count = stamps.len() as i64;
        for (number, stamp) in (1..).zip(&mut stamps) {
            **stamp = Stamp(arrival.0 - waited_ns * (count - number) / count);
        }
    }
}
