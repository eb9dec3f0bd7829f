//! Which parts of the robot itself are in the view? Body, camera box and rods, which move with the camera.

use localize::robot::BodyConfig;

use super::blocks::Blocks;
use super::culling::{Culling, Reach, ReachMargins};
use super::draw_list::linear;
use super::lanes::LANES;
use super::lattice::Lattice;
use super::moving_rays::MovedBlock;
use super::row_transform::RowTransform;
use super::scatter::{CELL, CellOverlay};
use super::solids::{Outline, Primitive, Solid};
use crate::image_sensor::TONES;

/// The robot's own parts in the view: equal in every image, so they are drawn once,
/// and never smeared by motion.
pub(super) struct OwnBody {
    /// Pixels that show it, by row.
    overlay: Vec<Vec<PixelOverlay>>,
    /// Cells of scattered light that show it.
    pub(super) cells: Vec<CellOverlay>,
}

/// The visible share of the scene in a pixel, and the added light.
#[derive(Debug, Clone, Copy)]
struct PixelOverlay {
    column: usize,
    left: f32,
    adds: [f32; 3],
}

/// Height of the rods, metres: more than any mirror's.
const ROD_HEIGHT: f32 = 3.0;

impl OwnBody {
    /// `height_px`: rows of the image.
    pub(super) fn new(
        body: &BodyConfig,
        camera_height: f32,
        blocks: &Blocks,
        lattice: &Lattice,
        height_px: usize,
    ) -> Self {
        let transform = RowTransform::default();
        let margins = ReachMargins::new(&blocks.origins, &transform);
        let primitives: Vec<Primitive> = own_solids(body, camera_height)
            .into_iter()
            .map(Primitive::Solid)
            .collect();
        let reaches: Vec<Reach> = (primitives.iter())
            .map(|primitive| primitive.reach(&margins))
            .collect();
        let culling = Culling::new(reaches.iter().copied());
        let mut own = OwnBody {
            overlay: vec![Vec::new(); height_px.next_multiple_of(LANES)],
            cells: Vec::new(),
        };
        let (mut moved, mut found) = (MovedBlock::new(), Vec::new());
        for (block, rays) in blocks.blocks.iter().zip(&blocks.rays) {
            culling.find(&lattice.view(block), &mut found);
            if found.is_empty() {
                continue;
            }
            moved.clear();
            let moved = moved.of(block, rays, &transform, height_px);
            // The difference between drawing over white and over black is the visible share of the scene.
            let [black, white] = [0.0, 1.0].map(|level| {
                let mut light = [[[level; LANES]; LANES]; 3];
                for index in &found {
                    let index = *index as usize;
                    let rows = moved.rows_between(reaches[index].slope);
                    primitives[index].draw(moved, rows, [0.0, 1.0], &mut light);
                }
                light
            });
            for row in 0..LANES {
                for lane in 0..LANES {
                    let left = white[0][row][lane] - black[0][row][lane];
                    if left < 0.999 {
                        let overlay = PixelOverlay {
                            column: block.column * LANES + lane,
                            left,
                            adds: [0, 1, 2].map(|k| black[k][row][lane] * TONES as f32),
                        };
                        own.overlay[block.row * LANES + row].push(overlay);
                    }
                }
            }
        }
        own.average_cells();
        own
    }

    /// Computes the overlays of cells.
    fn average_cells(&mut self) {
        let per = 1.0 / (CELL * CELL) as f32;
        for (row, rows) in self.overlay.chunks(CELL).enumerate() {
            let mut overlays: Vec<&PixelOverlay> = rows.iter().flatten().collect();
            overlays.sort_by_key(|overlay| overlay.column);
            for cell in overlays.chunk_by(|a, b| a.column / CELL == b.column / CELL) {
                let hidden: f32 = cell.iter().map(|overlay| 1.0 - overlay.left).sum();
                let add = |k: usize| cell.iter().map(|overlay| overlay.adds[k]).sum::<f32>();
                self.cells.push(CellOverlay {
                    column: cell[0].column / CELL,
                    row,
                    left: 1.0 - per * hidden,
                    adds: [0, 1, 2].map(|k| per * add(k)),
                });
            }
        }
    }

    /// Draws it over a row of pixels that measure two colours in even and odd columns.
    pub(super) fn draw(&self, row: usize, colours: [usize; 2], light: &mut [u16]) {
        for PixelOverlay { column, left, adds } in &self.overlay[row] {
            let (light, adds) = (&mut light[*column], adds[colours[column % 2]]);
            *light = f32::from(*light).mul_add(*left, adds) as u16;
        }
    }
}

fn own_solids(body: &BodyConfig, camera_height: f32) -> Vec<Solid> {
    let solid = |x: f32, y: f32, top: f32, outline: Outline, colour: [u8; 3], cap: [u8; 3]| Solid {
        x,
        y,
        bottom: 0.0,
        top,
        outline,
        side: linear(colour),
        cap: linear(cap),
    };
    let square = |half: f32| Outline::Box {
        half: [half; 2],
        cos: 1.0,
        sin: 0.0,
    };
    let round = |radius: f32| Outline::Circle { radius };
    let mut solids = Vec::new();
    if body.radius > 0.0 && body.height > 0.0 {
        solids.push(solid(
            0.0,
            0.0,
            body.height,
            round(body.radius),
            [30, 30, 33],
            [52, 53, 58],
        ));
    }
    if body.camera_side > 0.0 {
        let half = body.camera_side / 2.0;
        solids.push(solid(
            0.0,
            0.0,
            camera_height,
            square(half),
            [70, 70, 74],
            [120, 118, 122],
        ));
        solids.push(solid(
            0.0,
            0.0,
            camera_height + 0.002,
            round(half * 0.45),
            [40, 40, 44],
            [28, 26, 30],
        ));
    }
    if body.rod_radius > 0.0 {
        for angle_deg in &body.rod_angles_deg {
            let (sin, cos) = angle_deg.to_radians().sin_cos();
            let (x, y) = (body.rod_distance * cos, body.rod_distance * sin);
            solids.push(solid(
                x,
                y,
                ROD_HEIGHT,
                round(body.rod_radius),
                [22, 22, 24],
                [22, 22, 24],
            ));
        }
    }
    solids
}
