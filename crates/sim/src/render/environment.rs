//! What is around the field? A hall with walls, panels and doors, and clutter.

use std::f32::consts::TAU;

use localize::field::Field;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::solids::{Outline, Solid};
use crate::environment::EnvironmentConfig;
use crate::image_sensor::{linear_from_srgb, srgb_from_linear};

/// Distance between carpet and walls, metres.
const MARGIN: f32 = 3.0;
/// Cell size and height of the walls' texture, metres.
pub(super) const CELL: f32 = 0.08;
const HEIGHT: f32 = 4.0;
/// Height of the darker skirting along the walls, metres.
const SKIRTING: f32 = 0.4;
/// Number of objects between carpet and walls.
const CLUTTER_COUNT: usize = 26;

/// Width of a window, and heights of its lower and upper edge, metres.
const WINDOW: [f32; 3] = [2.2, 0.9, 3.4];
/// Its colour, bluish as the sky; the last byte marks it.
const WINDOW_RGB: [u8; 4] = [235, 245, 255, 1];

/// Hall and clutter, field frame.
pub(super) struct Environment {
    pub(super) half: [f32; 2],
    /// sRGB colours, and 1 where there is a window: columns along the walls from the corner (+x, −y) counter-clockwise, rows upwards.
    wall_texture: Vec<[u8; 4]>,
    /// Their linear light, the last value unused.
    pub(super) wall_light: Vec<[f32; 4]>,
    pub(super) columns: usize,
    pub(super) rows: usize,
    /// Half extent of a field's own walls, and half the width of the goals' mouths in them.
    pub(super) field_walls: Option<([f32; 2], f32)>,
    /// Objects between carpet and walls, field frame.
    pub(super) clutter: Vec<Solid>,
}

impl Environment {
    pub(super) fn new(field: &Field, config: &EnvironmentConfig, rng: &mut ChaCha8Rng) -> Self {
        let (carpet_x, carpet_y) = field.carpet_half_extent();
        let half = [carpet_x + MARGIN, carpet_y + MARGIN];
        let columns = (4.0 * (half[0] + half[1]) / CELL).ceil() as usize;
        let rows = (HEIGHT / CELL) as usize;
        let mut environment = Environment {
            half,
            wall_texture: Vec::new(),
            wall_light: Vec::new(),
            columns,
            rows,
            field_walls: field.config.walls.then_some((
                [field.config.length / 2.0, field.config.width / 2.0],
                field.config.goal.width / 2.0,
            )),
            clutter: make_clutter([carpet_x, carpet_y], rng),
        };
        environment.paint_walls(rng);
        environment.paint_windows(config.windows);
        environment.light_walls([1.0, config.window_light]);
        environment
    }

    /// Paints plaster above a darker skirting, with panels, doors and posters of any colour.
    fn paint_walls(&mut self, rng: &mut ChaCha8Rng) {
        let (columns, rows) = (self.columns, self.rows);
        let plaster = [196, 192, 182, 0];
        let skirting = [150, 155, 168, 0];
        self.wall_texture = (0..columns * rows)
            .map(|index| {
                if (index / columns) as f32 * CELL < SKIRTING {
                    skirting
                } else {
                    plaster
                }
            })
            .collect();
        let panels = (columns as f32 * CELL / 1.4) as usize;
        for _ in 0..panels {
            let [red, green, blue] =
                clutter_colour(rng).map(|part| srgb_from_linear(part * 0.8 + 0.02));
            let colour = [red, green, blue, 0];
            let left = (rng.random::<f32>() * columns as f32) as usize;
            let width = ((0.3 + 1.2 * rng.random::<f32>()) / CELL) as usize;
            let low = ((rng.random::<f32>() * 1.2) / CELL) as usize;
            let high = (low + ((0.4 + rng.random::<f32>()) / CELL) as usize).min(rows);
            for row in low..high {
                for column in left..left + width {
                    self.wall_texture[row * columns + column % columns] = colour;
                }
            }
        }
    }

    /// Paints windows at equal distances, of the same share of the wall's length each.
    fn paint_windows(&mut self, count: usize) {
        let (low, high) = ((WINDOW[1] / CELL) as usize, (WINDOW[2] / CELL) as usize);
        for window in 0..count {
            let left = (window * self.columns + self.columns / 3) / count;
            for row in low..high.min(self.rows) {
                for column in left..left + (WINDOW[0] / CELL) as usize {
                    self.wall_texture[row * self.columns + column % self.columns] = WINDOW_RGB;
                }
            }
        }
    }

    /// Computes the light of the texture; `brightness`: of walls and of windows.
    fn light_walls(&mut self, brightness: [f32; 2]) {
        let linear: [f32; 256] = std::array::from_fn(|byte| linear_from_srgb(byte as u8));
        let light = |&[red, green, blue, window]: &[u8; 4]| {
            let bright = brightness[usize::from(window & 1)];
            let [red, green, blue] =
                [red, green, blue].map(|byte| bright * linear[usize::from(byte)]);
            [red, green, blue, 0.0]
        };
        self.wall_light = self.wall_texture.iter().map(light).collect();
    }
}

/// Random people, boxes and poles between carpet and walls.
fn make_clutter(carpet: [f32; 2], rng: &mut ChaCha8Rng) -> Vec<Solid> {
    let mut solids = Vec::new();
    for _ in 0..CLUTTER_COUNT {
        let out = 0.5 + (MARGIN - 1.0) * rng.random::<f32>();
        let part = 2.2 * rng.random::<f32>() - 1.1;
        let side = if rng.random::<bool>() { 1.0 } else { -1.0 };
        let (x, y) = if rng.random::<f32>() < carpet[0] / (carpet[0] + carpet[1]) {
            (carpet[0] * part, side * (carpet[1] + out))
        } else {
            (side * (carpet[0] + out), carpet[1] * part)
        };
        let colour = clutter_colour(rng);
        let mut stack = |bottom: f32, top: f32, outline: Outline, colour: [f32; 3]| {
            solids.push(Solid {
                x,
                y,
                bottom,
                top,
                outline,
                side: colour,
                cap: colour,
            });
        };
        let round = |radius: f32| Outline::Circle { radius };
        match rng.random_range(0..4) {
            0 => {
                stack(0.0, 0.85, round(0.14), [40, 42, 58].map(linear_from_srgb));
                stack(0.85, 1.5, round(0.2), colour);
                stack(1.5, 1.75, round(0.1), [190, 150, 125].map(linear_from_srgb));
            }
            1 => stack(0.0, 1.5 + rng.random::<f32>(), round(0.05), colour),
            _ => {
                let (sin, cos) = (rng.random::<f32>() * TAU).sin_cos();
                let half = [
                    0.15 + 0.4 * rng.random::<f32>(),
                    0.1 + 0.3 * rng.random::<f32>(),
                ];
                stack(
                    0.0,
                    0.3 + 0.8 * rng.random::<f32>(),
                    Outline::Box { half, cos, sin },
                    colour,
                );
            }
        }
    }
    solids
}

/// A random colour: half of them greys, the others as bright as a ball or a marker.
fn clutter_colour(rng: &mut ChaCha8Rng) -> [f32; 3] {
    const BRIGHT: [[u8; 3]; 7] = [
        [200, 50, 45],
        [40, 80, 190],
        [225, 190, 40],
        [30, 140, 75],
        [230, 120, 40],
        [235, 235, 230],
        [40, 150, 190],
    ];
    if rng.random::<f32>() < 0.5 {
        let grey = 0.03 + 0.5 * rng.random::<f32>();
        return [grey, grey, grey * 1.05];
    }
    BRIGHT[rng.random_range(0..BRIGHT.len())].map(linear_from_srgb)
}
