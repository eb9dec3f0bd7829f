//! What a block is not asked for must not change it.

use std::path::Path;

use localize::field::Field;
use localize::frames::Pose;
use localize::robot::RobotConfig;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use vision::optics::ray_tracing::trace_rays;
use vision::{Mount, Profile};

use super::blocks::Blocks;
use super::culling::{Culling, ReachMargins};
use super::environment::Environment;
use super::field_from_robot::FieldFromRobot;
use super::floor::{Floor, FloorView};
use super::lanes::{BlockLight, LANES};
use super::lattice::Lattice;
use super::moving_rays::MovedBlock;
use super::row_transform::{CameraMotion, RowTransform};
use super::solids::{Outline, Primitive, Solid};
use crate::environment::EnvironmentConfig;
use crate::image_sensor::ImageSensorConfig;

/// The default camera's blocks with the default blur.
struct BlockFixture {
    blocks: Blocks,
    lattice: Lattice,
    field: Field,
    height_px: usize,
}

fn block_fixture() -> BlockFixture {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config");
    let robot = RobotConfig::load(&folder.join("robots/default.toml")).expect("a robot");
    let camera = (robot.camera.and_then(|camera| camera.camera())).expect("a camera");
    let profile = Profile::load(&robot.mirror.expect("a mirror").profile).expect("a profile");
    let mount = Mount {
        mirror_tilt_deg: [0.6, -0.4],
        mirror_offset: [0.002, 0.001],
        ..Mount::default()
    };
    let table = trace_rays(&camera, &profile, &mount).expect("rays");
    let [centre_u, centre_v] = camera.centre_px;
    let lattice = Lattice::new(&table);
    let view = |column: usize, row: usize| lattice.rest_view(column, row);
    let blocks = Blocks::new(&table, view, |pixel| {
        let (column, row) = (pixel % camera.width_px, pixel / camera.width_px);
        let radius = (column as f32 - centre_u).hypot(row as f32 - centre_v);
        ImageSensorConfig::default().blur_at(radius / camera.outer_radius_px.unwrap_or(234.0))
    });
    BlockFixture {
        blocks,
        lattice,
        field: Field::load(&folder.join("fields/msl_18x12.toml")).expect("a field"),
        height_px: camera.height_px,
    }
}

impl BlockFixture {
    /// Moves the lattice for a pose and a motion.
    fn update(&mut self, pose: Pose, motion: &CameraMotion) -> (RowTransform, ReachMargins) {
        let transform = RowTransform::new(motion, self.blocks.origins.height_max);
        let light = super::floor_light::FloorLight::new(
            &self.field,
            &crate::light::LightConfig::default(),
            &EnvironmentConfig::default(),
        );
        let pose = FieldFromRobot::new(pose);
        self.lattice.update(&transform, pose, &light);
        let margins = ReachMargins::new(&self.blocks.origins, &transform);
        (transform, margins)
    }
}

/// Tilt, its rate and readout: at rest, tilted, rocking.
fn motions() -> [CameraMotion; 3] {
    [
        ([0.0, 0.0], [0.0, 0.0], 0.0),
        ([0.03, -0.02], [0.0, 0.0], 0.0),
        ([-0.01, 0.02], [1.5, -2.0], 0.015),
    ]
    .map(|(tilt, tilt_rate, readout)| CameraMotion {
        velocity: [1.5, -1.0],
        yaw_rate: 2.0,
        tilt,
        tilt_rate,
        readout,
        ..CameraMotion::default()
    })
}

/// Largest light of a block.
fn brightest(light: &BlockLight) -> f32 {
    light[0].as_flattened().iter().copied().fold(0.0, f32::max)
}

#[test]
fn object_reaches_no_block_that_does_not_find_it_when_the_robot_tilts_and_rocks() {
    let mut fixture = block_fixture();
    for motion in motions() {
        let (transform, margins) = fixture.update(Pose::new(0.0, 0.0, 0.0), &motion);
        let (mut met, mut asked) = (0, 0);
        for (x, y, bottom, top) in [
            (1.5, 0.4, 0.0, 0.8),
            (-2.5, 3.0, 0.03, 0.22),
            (0.5, -6.0, 0.72, 0.8),
            (-9.0, -1.0, 0.0, 1.0),
            (11.0, 4.0, 0.4, 0.6),
        ] {
            let solid = Primitive::Solid(Solid {
                x,
                y,
                bottom,
                top,
                outline: Outline::Circle { radius: 0.25 },
                side: [1.0; 3],
                cap: [1.0; 3],
            });
            let reach = solid.reach(&margins);
            let culling = Culling::new([reach].into_iter());
            let (mut moved, mut found) = (MovedBlock::new(), Vec::new());
            for (block, rays) in fixture.blocks.blocks.iter().zip(&fixture.blocks.rays) {
                culling.find(&fixture.lattice.view(block), &mut found);
                moved.clear();
                let of_block = moved.of(block, rays, &transform, fixture.height_px);
                let draw = |rows: u32| {
                    let mut light = [[[0.0; LANES]; LANES]; 3];
                    solid.draw(of_block, rows, [0.0, 1.0], &mut light);
                    light
                };
                let light = draw(u32::from(u8::MAX));
                // The rows between its slopes are all that it covers.
                let of_rows = draw(of_block.rows_between(reach.slope));
                let pairs = light.as_flattened().iter().zip(of_rows.as_flattened());
                for (all, some) in pairs.flat_map(|(all, some)| all.iter().zip(some)) {
                    assert!(all - some < 0.01, "{x} {y}: {all} {some}");
                }
                let most = brightest(&light);
                assert!(most < 0.01 || !found.is_empty(), "{x} {y}: {most}");
                met += usize::from(most > 0.01);
                asked += found.len();
            }
        }
        // Few blocks are asked in vain.
        assert!(met > 100 && asked < 3 * met, "{asked} for {met}");
    }
}

#[test]
fn floor_of_a_block_is_that_of_all_strokes_and_of_the_carpets_edge() {
    let mut fixture = block_fixture();
    let (half_x, half_y) = fixture.field.carpet_half_extent();
    let environment = EnvironmentConfig {
        cables: 8,
        ..EnvironmentConfig::default()
    };
    // They end beyond the carpet.
    let cables = super::cables::lay_cables(
        &environment,
        [half_x + 0.5, half_y + 0.5],
        &mut ChaCha8Rng::seed_from_u64(3),
    );
    let mut floor = Floor::new(&fixture.field, [150, 112, 82], &cables, 0.0);
    let pose = Pose::new(3.0, -2.0, 0.7);
    for motion in motions() {
        let (transform, _) = fixture.update(pose, &motion);
        let lit = [[[1.0; LANES]; LANES], [[0.0; LANES]; LANES]];
        let (mut moved, mut bare) = (MovedBlock::new(), 0);
        for (block, rays) in fixture.blocks.blocks.iter().zip(&fixture.blocks.rays) {
            let view = floor.view(FieldFromRobot::new(pose), &fixture.lattice.view(block));
            moved.clear();
            let of_block = moved.of(block, rays, &transform, fixture.height_px);
            let [mut one, mut all] = [[[[0.0; LANES]; LANES]; 3]; 2];
            match view {
                FloorView::Bare { on_carpet } => {
                    floor.shade_bare(on_carpet, &lit, &mut one);
                    bare += 1;
                }
                FloorView::Edges { on_carpet } => {
                    floor.shade_edges(
                        FieldFromRobot::new(pose),
                        on_carpet,
                        of_block,
                        &lit,
                        &mut one,
                    );
                }
            }
            floor.find_all();
            floor.shade_edges(FieldFromRobot::new(pose), false, of_block, &lit, &mut all);
            for (one, all) in std::iter::zip(one[0].as_flattened(), all[0].as_flattened()) {
                let change = (one - all).abs();
                let [column, row] = [block.column, block.row];
                // A footprint as long as its distance reaches a little beyond the bounds.
                assert!(change < 0.04, "{change} in block {column} {row}: {view:?}");
            }
        }
        assert!(bare > 700, "{bare}");
    }
}

#[test]
fn walls_reach_no_block_that_does_not_see_them() {
    let mut fixture = block_fixture();
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let hall = Environment::new(&fixture.field, &EnvironmentConfig::default(), &mut rng);
    let pose = Pose::new(8.0, -3.0, 2.0);
    for motion in motions() {
        let (transform, margins) = fixture.update(pose, &motion);
        let (mut moved, mut unseen) = (MovedBlock::new(), 0);
        for (block, rays) in fixture.blocks.blocks.iter().zip(&fixture.blocks.rays) {
            let view = fixture.lattice.view(block);
            if hall.visible_walls(FieldFromRobot::new(pose), &view, &margins)[0] {
                continue;
            }
            unseen += 1;
            moved.clear();
            let of_block = moved.of(block, rays, &transform, fixture.height_px);
            let mut light = [[[0.0; LANES]; LANES]; 3];
            hall.draw_walls(FieldFromRobot::new(pose), of_block, &mut light);
            let most = brightest(&light);
            assert!(
                most < 0.01,
                "{most} in block {} {}",
                block.column,
                block.row
            );
        }
        assert!(unseen > 1000, "{unseen}");
    }
}

#[test]
fn moved_rays_start_on_the_mirror() {
    let mut fixture = block_fixture();
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config");
    let robot = RobotConfig::load(&folder.join("robots/default.toml")).expect("a robot");
    let camera = (robot.camera.and_then(|camera| camera.camera())).expect("a camera");
    let profile = Profile::load(&robot.mirror.expect("a mirror").profile).expect("a profile");
    let mount = Mount {
        mirror_tilt_deg: [0.6, -0.4],
        mirror_offset: [0.002, 0.001],
        ..Mount::default()
    };
    let table = trace_rays(&camera, &profile, &mount).expect("rays");
    let (transform, _) = fixture.update(Pose::new(0.0, 0.0, 0.0), &CameraMotion::default());
    let mut moved = MovedBlock::new();
    for (block, rays) in fixture.blocks.blocks.iter().zip(&fixture.blocks.rays) {
        moved.clear();
        let of_block = moved.of(block, rays, &transform, fixture.height_px);
        for row in 0..LANES {
            for lane in 0..LANES {
                let pixel =
                    (block.row * LANES + row) * table.width_px + block.column * LANES + lane;
                let Some(ray) = table.rays[pixel] else {
                    continue;
                };
                for k in 0..3 {
                    let off = of_block.rows[row].origin[k][lane] - ray.origin[k];
                    // Where parts of the mirror meet it is largest, a twentieth of a pixel on the floor.
                    assert!(off.abs() < 6e-4, "{off} m at pixel {pixel}");
                }
            }
        }
    }
}
