//! The mirror's rim is found where it is seen, not where the set-up says; and a hall without a dark border has none.

use localize::math;
use localize::robot::CameraConfig;
use vision::Image;
use vision::image_check::VisibleRim;

const SIZE: [usize; 2] = [320, 240];
const RADIUS: f32 = 110.0;

/// What a mirror with its centre here shows: greys that differ from picture to picture, dark parts among them, and a halo of stray
/// light beyond its rim.
fn picture(centre: [f32; 2], seed: usize, halo: f32) -> Image {
    let pixels = (0..SIZE[1]).flat_map(|v| (0..SIZE[0]).map(move |u| (u, v)));
    let level = |(u, v): (usize, usize)| {
        let beyond = math::hypot(u as f32 - centre[0], v as f32 - centre[1]) - RADIUS;
        let noise = ((u * 7 + v * 13 + seed * 31) % 17) as f32;
        match beyond < 0.0 {
            true if (u / 40 + v / 30 + seed).is_multiple_of(3) => 10.0 + noise / 4.0,
            true => 90.0 + noise,
            false => 8.0 + noise / 4.0 + halo * math::exp(-beyond / 6.0),
        }
    };
    Image {
        width_px: SIZE[0],
        height_px: SIZE[1],
        rgb: pixels.flat_map(|at| [level(at) as u8; 3]).collect(),
    }
}

/// A camera whose set-up says this centre.
fn camera(stated: [f32; 2]) -> CameraConfig {
    CameraConfig {
        width_px: SIZE[0],
        height_px: SIZE[1],
        centre_px: stated,
        focal_px: None,
        height: None,
        forward_deg: 90.0,
        flipped: true,
        outer_radius_px: Some(RADIUS),
    }
}

/// The rim in pictures about a centre, for a set-up that says another one.
fn find(stated: [f32; 2], centre: [f32; 2], halo: f32) -> Option<[f32; 3]> {
    let mut rim = VisibleRim::new(&camera(stated), SIZE)?;
    for seed in 0..6 {
        rim.add(&picture(centre, seed, halo).view());
    }
    let found = rim.find()?;
    Some([found.centre_px[0], found.centre_px[1], found.radius_px])
}

#[test]
fn rim_is_found_where_it_is_seen() {
    for (centre, halo) in [
        ([160.0, 120.0], 0.0),
        ([165.5, 116.2], 0.0),
        ([154.3, 123.0], 25.0),
    ] {
        let [u, v, radius] = find([160.0, 120.0], centre, halo).expect("a rim");
        let off = math::hypot(u - centre[0], v - centre[1]);
        assert!(off < 0.4, "{off} px off for {centre:?}");
        assert!((radius - RADIUS).abs() < 1.0, "{radius}");
    }
}

#[test]
fn pictures_without_a_dark_border_have_no_rim() {
    assert_eq!(find([160.0, 120.0], [160.0, 120.0], 400.0), None);
}

#[test]
fn no_picture_or_a_dark_one_has_no_rim() {
    let mut rim = VisibleRim::new(&camera([160.0, 120.0]), SIZE).expect("a stated rim");
    assert!(rim.find().is_none());
    let dark = Image {
        width_px: SIZE[0],
        height_px: SIZE[1],
        rgb: vec![3; 3 * SIZE[0] * SIZE[1]],
    };
    rim.add(&dark.view());
    assert!(rim.find().is_none());
}
