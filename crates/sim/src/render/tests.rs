use std::path::Path;

use super::*;
use crate::image_sensor::linear_from_srgb;
use crate::world::RobotState;
use localize::frames::{At, Pose};
use localize::robot::RobotConfig;
use localize::world::TeamColour;
use vision::RayTable;

struct RenderFixture {
    renderer: Renderer,
    table: RayTable,
    sensor_config: ImageSensorConfig,
}

/// A full-size camera on a field of 18 × 12 m, without vignetting and nearly without noise.
fn render_fixture(mount: Mount) -> RenderFixture {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config");
    let robot = RobotConfig::load(&folder.join("robots/default.toml")).expect("a robot");
    let field = Field::load(&folder.join("fields/msl_18x12.toml")).expect("a field");
    let camera = robot
        .camera
        .and_then(|camera| camera.camera())
        .expect("a camera");
    let profile = Profile::load(&robot.mirror.expect("a mirror").profile).expect("a profile");
    let sensor_config = ImageSensorConfig::ideal();
    let renderer = Renderer::new(&RendererConfig {
        camera: &camera,
        profile: &profile,
        mount,
        body: &robot.body.unwrap_or_default(),
        field: &field,
        light: &LightConfig::default(),
        environment: &EnvironmentConfig {
            cables: 0,
            ..EnvironmentConfig::default()
        },
        image_sensor: &sensor_config,
        seed: 1,
    })
    .expect("a renderer");
    RenderFixture {
        renderer,
        table: trace_rays(&camera, &profile, &mount).expect("rays"),
        sensor_config,
    }
}

impl RenderFixture {
    fn render(
        &mut self,
        pose: Pose,
        robots: &[RobotState],
        occluded_sectors: &[Sector],
    ) -> Vec<u8> {
        let scene = Scene {
            pose,
            robots,
            occluded_sectors,
            ..Scene::default()
        };
        let mut rgb = Vec::new();
        self.renderer.render(&scene, &self.sensor_config, &mut rgb);
        rgb
    }

    /// Ground point of a pixel.
    fn ground_point(&self, column: usize, row: usize) -> Option<At<localize::RobotFrame>> {
        self.table.rays[row * self.table.width_px + column]?.at_height(0.0)
    }
}

/// Error of the rendered centre of a line along x, by the traced rays, for each crossing of an image row.
fn line_centre_error(fixture: &mut RenderFixture, pose: Pose, row: usize, line_y: f32) -> Vec<f32> {
    let rgb = fixture.render(pose, &[], &[]);
    let red = |column: usize| linear_from_srgb(rgb[3 * (row * fixture.table.width_px + column)]);
    let mut errors = Vec::new();
    // The row crosses the line once on each side of the image; only near pixels are used.
    let field_point = |column: usize| {
        fixture
            .ground_point(column, row)
            .map(|ground| pose * ground)
    };
    let near: Vec<usize> = (0..fixture.table.width_px)
        .filter(|&column| {
            field_point(column).is_some_and(|at| (at.y - line_y).abs() < 0.3 && at.x.abs() < 6.0)
        })
        .collect();
    for crossing in near.chunk_by(|a, b| b - a == 1) {
        let dark = crossing
            .iter()
            .map(|&column| red(column))
            .fold(f32::MAX, f32::min);
        let (mut sum, mut weight) = (0.0, 0.0);
        for &column in crossing {
            let at = field_point(column).expect("ground");
            let white = red(column) - dark;
            sum += white * (at.y - line_y);
            weight += white;
        }
        errors.push(sum / weight);
    }
    errors
}

#[test]
fn touch_line_is_rendered_where_rays_meet_it_also_with_tilted_mirror() {
    let mounts = [
        Mount::default(),
        Mount {
            mirror_tilt_deg: [1.0, -0.7],
            lean_deg: [0.0, 1.0],
            mirror_offset: [0.002, 0.0],
            ..Mount::default()
        },
    ];
    for mount in mounts {
        let mut fixture = render_fixture(mount);
        // The line's centre is half a line width inside the field's 12 m.
        let errors = line_centre_error(&mut fixture, Pose::new(3.0, 4.0, 0.0), 180, 6.0 - 0.0625);
        assert!(!errors.is_empty());
        for error in errors {
            assert!(error.abs() < 0.01, "{error} m");
        }
    }
}

#[test]
fn markings_are_white_and_carpet_is_green() {
    let mut fixture = render_fixture(Mount::default());
    let pose = Pose::new(-2.0, 1.0, 0.7);
    let rgb = fixture.render(pose, &[], &[]);
    let (mut painted, mut bare) = (0, 0);
    for row in 0..480 {
        for column in 0..480 {
            let Some(ground) = fixture.ground_point(column, row) else {
                continue;
            };
            let at = pose * ground;
            if !(0.6..5.0).contains(&ground.distance()) {
                continue;
            }
            let pixel = &rgb[3 * (row * 480 + column)..][..3];
            // The halfway line: 0.125 m wide, along y.
            let from_halfway = at.x.abs();
            if from_halfway < 0.02 && at.y.abs() > 2.3 && at.y.abs() < 5.5 && pixel[0] > 60 {
                painted += 1;
                assert!(
                    pixel[0] > 180 && pixel[2] > 180,
                    "({column}, {row}) {pixel:?} at {at:?}"
                );
            }
            let open = at.x < -2.6 && at.x > -5.0 && at.y > -1.0 && at.y < 5.0;
            if open && pixel[1] > 60 {
                bare += 1;
                assert!(
                    pixel[0] < 110 && pixel[1] > pixel[0] + 25,
                    "({column}, {row}) {pixel:?} at {at:?}"
                );
            }
        }
    }
    assert!(painted > 50 && bare > 2000, "{painted} {bare}");
}

#[test]
fn robot_changes_only_pixels_in_its_direction() {
    let mut fixture = render_fixture(Mount::default());
    let pose = Pose::new(0.0, 0.0, 0.4);
    let other = RobotState {
        pose: Pose::new(2.0, 2.0, 0.0),
        velocity: [0.0; 2],
        yaw_rate: 0.0,
        team: TeamColour::Magenta,
    };
    // Both images have the same, very small noise.
    let without = fixture.render(pose, &[], &[]);
    let with = fixture.render(pose, &[other], &[]);
    let direction = pose.inverse() * other.pose.origin();
    let half = (0.36f32 / direction.distance()).asin();
    let (mut inside, mut magenta) = (0, 0);
    for (pixel, ray) in fixture.table.rays.iter().enumerate() {
        let (a, b) = (&without[3 * pixel..][..3], &with[3 * pixel..][..3]);
        if a.iter().zip(b).all(|(a, b)| a.abs_diff(*b) < 12) {
            continue;
        }
        let ray = ray.expect("a ray where something changed");
        let azimuth = ray.direction[1].atan2(ray.direction[0]);
        let off = localize::frames::wrap_angle(azimuth - direction.bearing()).abs();
        // The shadow on the floor is about twice as wide.
        assert!(off < 2.2 * half, "azimuth off by {off}");
        inside += usize::from(off < half);
        magenta += usize::from(b[0] > 90 && b[1] < 60 && b[2] > 60);
    }
    assert!(inside > 500 && magenta > 50, "{inside} {magenta}");
}

#[test]
fn occlusion_blackens_only_its_sector() {
    let mut fixture = render_fixture(Mount::default());
    let pose = Pose::new(0.0, 0.0, 0.0);
    let clear = fixture.render(pose, &[], &[]);
    let covered = fixture.render(
        pose,
        &[],
        &[Sector {
            centre: 1.0,
            width: 0.8,
        }],
    );
    for (pixel, ray) in fixture.table.rays.iter().enumerate() {
        let Some(ray) = ray else { continue };
        let off =
            localize::frames::wrap_angle(ray.direction[1].atan2(ray.direction[0]) - 1.0).abs();
        let shown = &covered[3 * pixel..][..3];
        if off < 0.39 {
            assert!(shown.iter().all(|&byte| byte < 16), "{shown:?} at {off}");
        } else if off > 0.41 {
            let same = shown
                .iter()
                .zip(&clear[3 * pixel..])
                .all(|(a, b)| a.abs_diff(*b) <= 1);
            assert!(same, "changed at {off}");
        }
    }
}

#[test]
fn doubled_light_at_half_exposure_gives_the_same_image() {
    let mut fixture = render_fixture(Mount::default());
    let pose = Pose::new(1.0, 1.0, 0.0);
    let usual = fixture.render(pose, &[], &[]);
    fixture.sensor_config.exposure = 0.5;
    let scene = Scene {
        pose,
        light_colour: [2.0; 3],
        ..Scene::default()
    };
    let mut bright = Vec::new();
    fixture
        .renderer
        .render(&scene, &fixture.sensor_config, &mut bright);
    assert!(usual.iter().zip(&bright).all(|(a, b)| a.abs_diff(*b) <= 1));
}

/// Ground point of a tilted robot's pixel, by nalgebra's rotations: independent of the renderer's.
fn tilted_ground_point(
    fixture: &RenderFixture,
    (column, row): (usize, usize),
    tilt: [f32; 2],
) -> Option<At<localize::RobotFrame>> {
    let ray = fixture.table.rays[row * fixture.table.width_px + column]?;
    let up = nalgebra::Vector3::new(
        tilt[0],
        tilt[1],
        (1.0 - tilt[0].powi(2) - tilt[1].powi(2)).sqrt(),
    );
    let rotation = nalgebra::Rotation3::rotation_between(&up, &nalgebra::Vector3::z())?;
    let origin = rotation * nalgebra::Vector3::from(ray.origin);
    let direction = rotation * nalgebra::Vector3::from(ray.direction);
    let distance = -origin.z / direction.z;
    (distance > 0.0).then(|| {
        At::new(
            origin.x + distance * direction.x,
            origin.y + distance * direction.y,
        )
    })
}

#[test]
fn touch_line_is_rendered_where_the_rays_of_a_tilted_robot_meet_it() {
    let mut fixture = render_fixture(Mount::default());
    let (tilt, pose, row) = ([0.02, 0.03], Pose::new(3.0, 4.0, 0.3), 180);
    let motion = CameraMotion {
        tilt,
        ..CameraMotion::default()
    };
    let scene = Scene {
        pose,
        motion,
        ..Scene::default()
    };
    let mut rgb = Vec::new();
    let image_sensor = fixture.sensor_config;
    fixture.renderer.render(&scene, &image_sensor, &mut rgb);
    let (mut sum, mut weight) = (0.0, 0.0);
    let mut upright_sum = 0.0;
    for column in 0..480 {
        let Some(ground) = tilted_ground_point(&fixture, (column, row), tilt) else {
            continue;
        };
        let at = pose * ground;
        if (at.y - 5.9375).abs() > 0.3 || ground.distance() > 5.0 {
            continue;
        }
        let red = linear_from_srgb(rgb[3 * (row * 480 + column)]) - 0.065;
        let upright = fixture.ground_point(column, row).map_or(at, |at| pose * at);
        sum += red.max(0.0) * (at.y - 5.9375);
        upright_sum += red.max(0.0) * (upright.y - 5.9375);
        weight += red.max(0.0);
    }
    assert!(weight > 0.5, "{weight}");
    assert!((sum / weight).abs() < 0.012, "{}", sum / weight);
    assert!(
        (upright_sum / weight).abs() > 0.02,
        "{}",
        upright_sum / weight
    );
}

#[test]
fn rolling_shutter_turns_rows_by_the_yaw_of_their_time() {
    let mut fixture = render_fixture(Mount::default());
    let pose = Pose::new(0.0, 0.0, 0.2);
    let image_sensor = fixture.sensor_config;
    let mut render = |theta: f32, motion: CameraMotion| {
        let scene = Scene {
            pose: Pose::new(pose.x, pose.y, theta),
            motion,
            ..Scene::default()
        };
        let mut rgb = Vec::new();
        fixture.renderer.render(&scene, &image_sensor, &mut rgb);
        rgb
    };
    let motion = CameraMotion {
        yaw_rate: 4.0,
        readout: 0.02,
        ..CameraMotion::default()
    };
    let rolled = render(pose.theta, motion);
    // Row 120 is exposed a quarter of the readout before the middle, row 360 a quarter after it.
    for (row, turn) in [(120, -0.02), (240, 0.0), (360, 0.02)] {
        let same = render(pose.theta + turn, CameraMotion::default());
        let other = render(pose.theta - turn, CameraMotion::default());
        let difference = |image: &[u8]| -> u32 {
            let at = 3 * 480 * row..3 * 480 * (row + 1);
            let pairs = rolled[at.clone()].iter().zip(&image[at]);
            pairs.map(|(a, b)| u32::from(a.abs_diff(*b))).sum()
        };
        let (same, other) = (difference(&same), difference(&other));
        assert!(same < 1500, "row {row}: {same}");
        assert!(turn == 0.0 || other > 4 * same, "row {row}: {same} {other}");
    }
}

#[test]
fn motion_blur_smears_edges_across_the_flow() {
    let mut fixture = render_fixture(Mount::default());
    let image_sensor = fixture.sensor_config;
    let mut render = |motion: CameraMotion| {
        let scene = Scene {
            pose: Pose::new(0.5, 4.0, 0.0),
            motion,
            ..Scene::default()
        };
        let mut rgb = Vec::new();
        fixture.renderer.render(&scene, &image_sensor, &mut rgb);
        rgb
    };
    let sharp = render(CameraMotion::default());
    // 5 px at the place of the test.
    let turning = render(CameraMotion {
        yaw_rate: 8.0,
        shutter: 0.01,
        ..CameraMotion::default()
    });
    // The halfway line lies behind the robot and runs from image left to right; column 180 crosses it at right angles to
    // the flow.
    let steepest_edge = |rgb: &[u8]| {
        let at = |row: usize| linear_from_srgb(rgb[3 * (row * 480 + 180)]);
        (245..285)
            .map(|row| (at(row + 1) - at(row)).abs())
            .fold(0.0, f32::max)
    };
    let (sharp_edge, smeared_edge) = (steepest_edge(&sharp), steepest_edge(&turning));
    assert!(
        smeared_edge < 0.8 * sharp_edge,
        "{sharp_edge} {smeared_edge}"
    );
}

#[test]
fn scattered_light_brightens_the_dark_and_mosaic_noise_is_correlated() {
    let mut fixture = render_fixture(Mount::default());
    let mut render = |image_sensor: ImageSensorConfig| {
        let mut rgb = Vec::new();
        fixture
            .renderer
            .render(&Scene::default(), &image_sensor, &mut rgb);
        rgb
    };
    let ideal = ImageSensorConfig::ideal();
    let dark = |rgb: &[u8]| rgb[1];
    let clear = render(ideal);
    let glare = render(ImageSensorConfig {
        glare: 0.2,
        bloom: 0.2,
        ..ideal
    });
    assert!(
        dark(&glare) > dark(&clear) + 10,
        "{} {}",
        dark(&glare),
        dark(&clear)
    );
    let noise = |bayer: bool, render: &mut dyn FnMut(ImageSensorConfig) -> Vec<u8>| {
        let rgb = render(ImageSensorConfig {
            bayer,
            full_well: 1000.0,
            ..ideal
        });
        let smooth: Vec<f32> = rgb
            .iter()
            .zip(&clear)
            .map(|(noisy, clear)| f32::from(*noisy) - f32::from(*clear))
            .collect();
        let (mut product, mut square) = (0.0, 0.0);
        for row in 100..140 {
            for column in 150..190 {
                let at = 3 * (row * 480 + column) + 1;
                product += smooth[at] * smooth[at + 3];
                square += smooth[at] * smooth[at];
            }
        }
        product / square
    };
    let correlation = [false, true].map(|bayer| noise(bayer, &mut render));
    assert!(correlation[0].abs() < 0.15, "{correlation:?}");
    assert!(correlation[1] > 0.2, "{correlation:?}");
}

#[test]
fn merged_pieces_of_cables_change_an_image_by_less_than_60_db() {
    let mut fixture = render_fixture(Mount::default());
    let environment = EnvironmentConfig {
        cables: 3,
        ..EnvironmentConfig::default()
    };
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/fields/msl_18x12.toml");
    let field = Field::load(&path).expect("a field");
    let footprint = fixture.renderer.blocks.footprint();
    let mut image = |cables: usize, footprint: f32| {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let half: [f32; 2] = field.carpet_half_extent().into();
        let cables = &cables::lay_cables(&environment, half, &mut rng)[..cables];
        fixture.renderer.floor = Floor::new(&field, environment.floor_rgb, cables, footprint);
        fixture.render(Pose::new(1.0, -0.5, 0.3), &[], &[])
    };
    let [none, pieces, merged] = [(0, 0.0), (3, 0.0), (3, footprint)].map(|(n, f)| image(n, f));
    let psnr = |a: &[u8], b: &[u8]| {
        let squares = a
            .iter()
            .zip(b)
            .map(|(a, b)| f64::from(a.abs_diff(*b)).powi(2));
        10.0 * (255.0f64.powi(2) * a.len() as f64 / squares.sum::<f64>()).log10()
    };
    let [shown, changed] = [psnr(&none, &pieces), psnr(&merged, &pieces)];
    assert!(
        changed > 60.0 && changed > shown + 15.0,
        "{shown} dB, {changed} dB"
    );
}

#[test]
fn ball_in_the_air_is_rendered_on_its_rays_and_shades_the_floor_below() {
    let ball = |height: f32| SceneBall {
        at: At::new(2.0, 0.6),
        height,
        diameter: 0.22,
        colour: [245, 125, 20],
    };
    let mut fixture = render_fixture(Mount::default());
    let mut image = |ball: Option<SceneBall>| {
        let mut rgb = Vec::new();
        let scene = Scene {
            ball,
            ..Scene::default()
        };
        fixture
            .renderer
            .render(&scene, &fixture.sensor_config, &mut rgb);
        rgb
    };
    let empty = image(None);
    let views = [0.0, 0.3].map(|height| (height, image(Some(ball(height)))));
    for (height, rgb) in &views {
        let (mut inside, mut missing, mut stray, mut shaded) = (0, 0, 0, [0.0, 0.0]);
        for (pixel, (now, before)) in rgb.chunks(3).zip(empty.chunks(3)).enumerate() {
            let Some(ray) = fixture.table.rays[pixel] else {
                continue;
            };
            let redness = |rgb: &[u8]| f32::from(rgb[0]) - f32::from(rgb[2]);
            let orange = redness(now) - redness(before) > 25.0;
            // Distance of the sphere's centre from the ray, radii.
            let centre = [2.0, 0.6, height + 0.11];
            let to: [f32; 3] = std::array::from_fn(|axis| centre[axis] - ray.origin[axis]);
            let dot = |a: [f32; 3], b: [f32; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
            let along = dot(to, ray.direction) / dot(ray.direction, ray.direction).sqrt();
            let miss = (dot(to, to) - along * along).max(0.0).sqrt() / 0.11;
            inside += usize::from(miss < 0.85);
            missing += usize::from(miss < 0.85 && !orange);
            stray += usize::from(miss > 1.3 && orange);
            let Some(ground) = ray.at_height(0.0) else {
                continue;
            };
            // The floor under the ball, as far as the ball does not hide it.
            if miss > 1.5 && ground.distance_to(At::new(2.0, 0.6)) < 0.06 {
                shaded[0] += f32::from(before[1]);
                shaded[1] += f32::from(now[1]);
            }
        }
        assert!(inside > 20, "{height}: {inside}");
        // A rod of the robot hides some pixels.
        assert!(
            50 * missing <= inside && stray == 0,
            "{height}: {missing} of {inside}, {stray}"
        );
        if *height > 0.0 {
            let share = shaded[1] / shaded[0];
            assert!((0.6..0.995).contains(&share), "{height}: {share}");
        }
    }
}
