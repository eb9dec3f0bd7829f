//! Trajectory of a ball in the air by the classical Runge-Kutta method: gravity, drag, lift by spin, and impacts.
//!
//! It shares no formula with `flight`: the estimators know neither the lift nor the impacts, and another drag.

/// Start of a flight: position of the centre and velocity, and what acts on the ball.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Flight {
    /// x, y, z of the centre, metres.
    pub at: [f64; 3],
    /// m/s.
    pub velocity: [f64; 3],
    /// Drag over the squared speed, 1/m.
    pub drag: f64,
    /// Lift by backspin over the squared speed, 1/m, perpendicular to the velocity.
    pub lift: f64,
    /// Coefficient of restitution of the ground.
    pub restitution: f64,
    /// Share of the horizontal speed that an impact takes.
    pub grip: f64,
    /// Radius of the ball, metres.
    pub radius: f64,
}

impl Default for Flight {
    fn default() -> Self {
        Flight {
            at: [0.0, 0.0, 0.11],
            velocity: [0.0; 3],
            drag: 0.013,
            lift: 0.0,
            restitution: 0.6,
            grip: 0.25,
            radius: 0.11,
        }
    }
}

/// Step of the integration, seconds.
const STEP: f64 = 0.0005;
/// Standard gravity, m/s².
const GRAVITY: f64 = 9.806_65;

fn acceleration(flight: &Flight, [vx, vy, vz]: [f64; 3]) -> [f64; 3] {
    let level = (vx * vx + vy * vy).sqrt();
    let speed = (level * level + vz * vz).sqrt();
    // Perpendicular to the velocity in its vertical plane.
    let (ux, uy) = if level > 1e-9 {
        (vx / level, vy / level)
    } else {
        (0.0, 0.0)
    };
    let lift = flight.lift * speed;
    let drag = flight.drag * speed;
    [
        -drag * vx - lift * vz * ux,
        -drag * vy - lift * vz * uy,
        -drag * vz + lift * level - GRAVITY,
    ]
}

/// Positions of the centre at `rate` per second, the first one at the start.
pub fn trajectory(flight: &Flight, images: usize, rate: f64) -> Vec<[f64; 3]> {
    let (mut at, mut velocity) = (flight.at, flight.velocity);
    let mut positions = Vec::with_capacity(images);
    let (mut time, mut rolls) = (0.0, false);
    for image in 0..images {
        let due = image as f64 / rate;
        while time < due {
            let step = STEP.min(due - time).max(1e-12);
            time += step;
            if rolls {
                at = [
                    at[0] + velocity[0] * step,
                    at[1] + velocity[1] * step,
                    flight.radius,
                ];
                continue;
            }
            (at, velocity) = runge_kutta(flight, at, velocity, step);
            if at[2] < flight.radius && velocity[2] < 0.0 {
                at[2] = flight.radius;
                let kept = 1.0 - flight.grip;
                velocity = [
                    kept * velocity[0],
                    kept * velocity[1],
                    -flight.restitution * velocity[2],
                ];
                rolls = velocity[2] < 0.2;
            }
        }
        positions.push(at);
    }
    positions
}

/// One step of fourth order.
fn runge_kutta(
    flight: &Flight,
    at: [f64; 3],
    velocity: [f64; 3],
    step: f64,
) -> ([f64; 3], [f64; 3]) {
    let after = |slope: [f64; 3], part: f64| -> [f64; 3] {
        std::array::from_fn(|axis| velocity[axis] + part * step * slope[axis])
    };
    let k1 = acceleration(flight, velocity);
    let v2 = after(k1, 0.5);
    let k2 = acceleration(flight, v2);
    let v3 = after(k2, 0.5);
    let k3 = acceleration(flight, v3);
    let v4 = after(k3, 1.0);
    let k4 = acceleration(flight, v4);
    let mean = |a: f64, b: f64, c: f64, d: f64| (a + 2.0 * b + 2.0 * c + d) / 6.0;
    (
        std::array::from_fn(|axis| {
            at[axis] + step * mean(velocity[axis], v2[axis], v3[axis], v4[axis])
        }),
        std::array::from_fn(|axis| {
            velocity[axis] + step * mean(k1[axis], k2[axis], k3[axis], k4[axis])
        }),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_drag_it_is_a_parabola() {
        let flight = Flight {
            velocity: [3.0, 0.0, 5.0],
            drag: 0.0,
            ..Flight::default()
        };
        for (image, at) in trajectory(&flight, 25, 30.0).iter().enumerate() {
            let t = image as f64 / 30.0;
            assert!((at[0] - 3.0 * t).abs() < 1e-6);
            assert!((at[2] - (0.11 + 5.0 * t - 0.5 * GRAVITY * t * t)).abs() < 1e-6);
        }
    }
}
