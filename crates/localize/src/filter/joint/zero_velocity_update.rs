//! Zero-velocity update of the joint filter (docs/methods.md 8.6).

use super::JointFilter;
use super::state::TWIST;

/// Random motion of a robot at rest: m and rad per square root of a second.
const STATIONARY_NOISE: [f32; 2] = [0.002, 0.0005];

impl JointFilter {
    /// Updates by v = 0 and ω = 0, measured over an interval of `seconds`.
    pub(in crate::filter) fn zero_velocity_update(&mut self, seconds: f32) {
        for k in 0..3 {
            let noise = STATIONARY_NOISE[k / 2];
            let jacobian = [(TWIST + k, 1.0)];
            let innovation = -self.state[TWIST + k];
            self.update_scalar(&jacobian, innovation, noise * noise / seconds.max(1e-4));
        }
    }
}
