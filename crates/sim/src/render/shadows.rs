//! How do objects shade the floor? Softly around them, and darker below them.

use super::culling::{Cylinder, Reach, ReachMargins};
use super::lanes::{BlockLight, LANES, Lanes, larger};
use super::moving_rays::MovedBlock;

/// A shadow on the floor: darkest at its centre, full light at twice its radius.
#[derive(Debug, Clone, Copy)]
pub(super) struct Shadow {
    pub(super) x: f32,
    pub(super) y: f32,
    pub(super) radius: f32,
    /// Share of the light that it takes at its centre.
    pub(super) depth: f32,
    /// The object's underside, which shades the floor below it.
    pub(super) underbody: Underbody,
}

/// A square above the floor: half side, direction, and height, metres.
#[derive(Debug, Clone, Copy)]
pub(super) struct Underbody {
    pub(super) half: f32,
    pub(super) cos: f32,
    pub(super) sin: f32,
    pub(super) height: f32,
}

impl Underbody {
    /// No underside, for a ball.
    pub(super) const NONE: Underbody = Underbody {
        half: 0.0,
        cos: 1.0,
        sin: 0.0,
        height: 1.0,
    };
}

impl Shadow {
    /// Share of the light that an object on the floor takes.
    pub(super) const DEPTH: f32 = 0.5;

    /// The rays that may meet it.
    pub(super) fn reach(&self, margins: &ReachMargins) -> Reach {
        let cylinder = Cylinder {
            x: self.x,
            y: self.y,
            radius: 2.0 * self.radius,
            bottom: 0.0,
            top: 0.0,
        };
        Reach::new(&cylinder, margins)
    }

    /// Darkens the floor.
    pub(super) fn draw(&self, rays: &MovedBlock, light: &mut BlockLight) {
        let per_square = 0.25 / (self.radius * self.radius);
        let under = self.underbody;
        let height2 = under.height * under.height;
        for (row, of_row) in rays.rows.iter().enumerate() {
            let [at_x, at_y] = of_row.ground();
            let mut left: Lanes = [0.0; LANES];
            for i in 0..LANES {
                let (dx, dy) = (at_x[i] - self.x, at_y[i] - self.y);
                let inside = (1.0 - dx.mul_add(dx, dy * dy) * per_square).max(0.0);
                // Below the body, light enters only through the gap at its edge: form factor at this depth.
                let (across, along) = (
                    under.cos.mul_add(dx, under.sin * dy).abs(),
                    under.cos.mul_add(dy, -under.sin * dx).abs(),
                );
                let deep = (under.half - larger(across, along)).max(0.0);
                let slit = 1.0 - deep / deep.mul_add(deep, height2).sqrt();
                left[i] = (1.0 - self.depth * inside * inside) * slit;
            }
            for plane in &mut *light {
                for (light, left) in plane[row].iter_mut().zip(&left) {
                    *light *= left;
                }
            }
        }
    }
}
