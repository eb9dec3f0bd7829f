//! How fast does the robot drive for a deflection of stick or keys?

use localize::omni::Twist;

/// Yaw rate over speed, rad/s per m/s.
const YAW_RATE_PER_SPEED: f32 = 2.0;

/// The velocity for deflections forward, left and counter-clockwise (−1 to 1) at a top speed (m/s).
pub(super) fn twist_from_axes([x, y, turn]: [f32; 3], speed: f32) -> Twist {
    Twist {
        x: x * speed,
        y: y * speed,
        theta: turn * speed * YAW_RATE_PER_SPEED,
    }
}
