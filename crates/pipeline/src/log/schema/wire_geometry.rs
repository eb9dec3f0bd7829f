//! How are poses and line points encoded? As parts of several other messages.

use foxglove::Encode;

/// A pose, metres and radians, field_from_robot.
#[derive(Clone, PartialEq, prost::Message, Encode)]
pub(crate) struct Pose {
    #[prost(float, required)]
    pub(crate) x: f32,
    #[prost(float, required)]
    pub(crate) y: f32,
    #[prost(float, required)]
    pub(crate) theta: f32,
}

/// Estimated minus true pose: metres in the field frame, radians.
#[derive(Clone, PartialEq, prost::Message, Encode)]
pub(crate) struct PoseError {
    #[prost(float, required)]
    pub(crate) x: f32,
    #[prost(float, required)]
    pub(crate) y: f32,
    #[prost(float, required)]
    pub(crate) theta: f32,
    /// Of the position, metres.
    #[prost(float, required)]
    pub(crate) distance: f32,
    /// Squared normalised error (3 on average if the covariance is right); not a number without a covariance.
    #[prost(float, required)]
    pub(crate) nees: f32,
}

/// Line points in the robot frame, metres; each list has one entry per point.
#[derive(Clone, PartialEq, prost::Message, Encode)]
pub(crate) struct LinePoints {
    #[prost(float, repeated)]
    pub(crate) x: Vec<f32>,
    #[prost(float, repeated)]
    pub(crate) y: Vec<f32>,
    #[prost(float, repeated)]
    pub(crate) std_radial: Vec<f32>,
    #[prost(float, repeated)]
    pub(crate) std_tangential: Vec<f32>,
}
