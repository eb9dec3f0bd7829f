//! What can be plotted: each quantity's name, unit, and the factor from its stored value.

use crate::view::time_series::{CycleMetrics, Quantity};

/// A quantity as it is plotted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct PlottedQuantity {
    pub(crate) name: &'static str,
    pub(crate) unit: &'static str,
    pub(crate) quantity: Quantity,
    scale: f32,
}

impl PlottedQuantity {
    const fn new(name: &'static str, unit: &'static str, quantity: Quantity, scale: f32) -> Self {
        PlottedQuantity {
            name,
            unit,
            quantity,
            scale,
        }
    }

    /// Its value in its unit; NaN if not available.
    pub(crate) fn of(&self, metrics: &CycleMetrics) -> f64 {
        f64::from(metrics.value(self.quantity) * self.scale)
    }

    /// The quantity of a name.
    pub(crate) fn named(name: &str) -> Option<&'static PlottedQuantity> {
        CATALOGUE.iter().find(|quantity| quantity.name == name)
    }
}

/// All quantities, in menu order.
pub(crate) const CATALOGUE: [PlottedQuantity; 37] = [
    PlottedQuantity::new("position error", "cm", Quantity::PositionError, 100.0),
    PlottedQuantity::new("heading error", "°", Quantity::HeadingError, 1.0),
    PlottedQuantity::new("std x", "cm", Quantity::StdX, 100.0),
    PlottedQuantity::new("std y", "cm", Quantity::StdY, 100.0),
    PlottedQuantity::new("std heading", "°", Quantity::StdHeading, 1.0),
    PlottedQuantity::new("x", "m", Quantity::PoseX, 1.0),
    PlottedQuantity::new("y", "m", Quantity::PoseY, 1.0),
    PlottedQuantity::new("heading", "°", Quantity::PoseHeading, 1.0),
    PlottedQuantity::new("speed", "m/s", Quantity::Speed, 1.0),
    PlottedQuantity::new("turn rate", "°/s", Quantity::TurnRate, 1.0),
    PlottedQuantity::new("residual", "cm", Quantity::Residual, 100.0),
    PlottedQuantity::new("line points", "points", Quantity::LinePoints, 1.0),
    PlottedQuantity::new(
        "rejected points",
        "points",
        Quantity::RejectedCandidates,
        1.0,
    ),
    PlottedQuantity::new("inliers", "%", Quantity::InlierShare, 100.0),
    PlottedQuantity::new("points on markings", "%", Quantity::OnMarkings, 100.0),
    PlottedQuantity::new("markings seen", "%", Quantity::MarkingsSeen, 100.0),
    PlottedQuantity::new("map displacement", "cm", Quantity::MapDisplacement, 100.0),
    PlottedQuantity::new("latency of images", "ms", Quantity::Latency, 1.0),
    PlottedQuantity::new("gyro bias", "°/s", Quantity::GyroBias, 1.0),
    PlottedQuantity::new("compass heading", "°", Quantity::CompassHeading, 1.0),
    PlottedQuantity::new("ball distance", "m", Quantity::BallDistance, 1.0),
    PlottedQuantity::new("robots seen", "robots", Quantity::RobotCount, 1.0),
    PlottedQuantity::new("entropy", "bit", Quantity::Entropy, 1.0),
    PlottedQuantity::new("brightness", "of 255", Quantity::Brightness, 1.0),
    PlottedQuantity::new("exposure", "camera units", Quantity::ExposureTime, 1.0),
    PlottedQuantity::new("gain", "camera units", Quantity::Gain, 1.0),
    PlottedQuantity::new("time of vision", "ms", Quantity::VisionTime, 1.0),
    PlottedQuantity::new(
        "time of localization",
        "ms",
        Quantity::LocalizationTime,
        1.0,
    ),
    PlottedQuantity::new("cycle period", "ms", Quantity::CyclePeriod, 1.0),
    PlottedQuantity::new("dropped cycles", "cycles", Quantity::Dropped, 1.0),
    PlottedQuantity::new("wheel 0", "m/s", Quantity::Wheel0, 1.0),
    PlottedQuantity::new("wheel 1", "m/s", Quantity::Wheel1, 1.0),
    PlottedQuantity::new("wheel 2", "m/s", Quantity::Wheel2, 1.0),
    PlottedQuantity::new("wheel 3", "m/s", Quantity::Wheel3, 1.0),
    PlottedQuantity::new("acceleration x", "m/s²", Quantity::AccelerationX, 1.0),
    PlottedQuantity::new("acceleration y", "m/s²", Quantity::AccelerationY, 1.0),
    PlottedQuantity::new("yaw rate", "°/s", Quantity::YawRate, 1.0),
];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::view::time_series::QUANTITY_COUNT;

    #[test]
    fn every_quantity_can_be_plotted_under_a_name_of_its_own() {
        assert_eq!(CATALOGUE.len(), QUANTITY_COUNT);
        for (number, one) in CATALOGUE.iter().enumerate() {
            for other in &CATALOGUE[number + 1..] {
                assert_ne!(one.name, other.name);
                assert_ne!(one.quantity, other.quantity);
            }
        }
    }
}
