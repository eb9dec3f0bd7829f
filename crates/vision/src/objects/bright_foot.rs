//! Bright shoes: they look like a line before a leg, and a foot found above them stands too far away.
//!
//! Where trousers end a hand's breadth above the floor, the view past them meets the floor well behind the shoe: at 4 m by
//! 0.6 m. A line goes on; a shoe has carpet around it and is no higher than an ankle.

use std::collections::HashSet;

use localize::frames::wrap_angle;
use localize::math;

use crate::colour::lookup_table::{ColourClass, ColourLookupTable};
use crate::image::ImageView;
use crate::objects::obstacle_candidates::ObstacleCandidate;
use crate::objects::view_angles::ViewAngles;

/// Highest place at which trousers end, metres.
const ANKLE_HEIGHT: f32 = 0.13;
/// How far toes are before the ankle, metres.
const TOES: f32 = 0.2;
/// Step along the view, pixels of the image.
const STEP_PX: f32 = 0.5;
/// Carpet of so many samples ends a shoe: some pixels, since one alone may be noise.
const CARPET_SAMPLES: usize = 4;
const CARPET_PX: f32 = CARPET_SAMPLES as f32 * STEP_PX;
/// Fewest bright samples of a shoe.
const SHOE_SAMPLES_MIN: usize = 3;
/// How far beside the foot both shoes reach at most, metres.
const ASIDE: f32 = 0.45;

/// A shoe along one direction.
struct Shoe {
    /// Where it begins and where the leg above it does, metres as seen on the ground.
    ends: [f32; 2],
    /// Brightness of the carpet before it, sum of the channels.
    carpet_level: f32,
}

/// Searches shoes in one image.
pub(crate) struct BrightFootSearch<'a> {
    pub(crate) image: &'a ImageView<'a>,
    pub(crate) lookup_table: &'a ColourLookupTable,
    pub(crate) angles: &'a ViewAngles,
}

impl BrightFootSearch<'_> {
    /// Distance at which the shoe before a foot begins, metres. None if nothing bright is before it, or what is there may be a
    /// line.
    pub(crate) fn nearer_foot(&self, foot: &ObstacleCandidate) -> Option<f32> {
        let nearest = foot.range * (1.0 - ANKLE_HEIGHT / self.angles.height) - TOES;
        if !(nearest > 0.0) {
            return None;
        }
        let Shoe { ends, carpet_level } = self.shoe_before(foot.azimuth, [nearest, foot.range])?;
        self.ends_beside(foot.azimuth, ends, nearest, carpet_level)
            .then_some(ends[0])
    }

    /// Does what is bright in the middle of a shoe end before `nearest` (metres) and beside the shoe?
    fn ends_beside(&self, azimuth: f32, ends: [f32; 2], nearest: f32, carpet_level: f32) -> bool {
        let middle = 0.5 * (ends[0] + ends[1]);
        let widest = math::atan2(ASIDE, middle);
        let radius_at = |range: f32, aside: f32| {
            let angle = self.angles.ground_angle(range);
            self.angles.radius_px(angle, azimuth + aside)
        };
        let start = self.position_px(azimuth, radius_at(middle, 0.0));
        let mut reached = HashSet::from([start]);
        let mut open = vec![start];
        while let Some([u, v]) = open.pop() {
            for next in [[u + 1, v], [u - 1, v], [u, v + 1], [u, v - 1]] {
                if reached.contains(&next) {
                    continue;
                }
                let bright = self.class_and_level(next).is_some_and(|(class, level)| {
                    class != ColourClass::CARPET && level > carpet_level
                });
                if !bright {
                    continue;
                }
                let across = next[0] as f32 - self.angles.centre_px[0];
                let up = self.angles.centre_px[1] - next[1] as f32;
                let aside = wrap_angle(math::atan2(up, across) - azimuth);
                let radius = math::hypot(across, up);
                if aside.abs() > widest || radius < radius_at(nearest, aside) {
                    return false;
                }
                // What is behind the shoe is seen past the leg.
                if radius <= radius_at(ends[1], aside) {
                    reached.insert(next);
                    open.push(next);
                }
            }
        }
        true
    }

    /// What is no carpet and brighter than it, between the far end of a stretch of ground and the carpet that begins before the
    /// near one.
    fn shoe_before(&self, azimuth: f32, [near, far]: [f32; 2]) -> Option<Shoe> {
        let ray = self.angles.ray(azimuth);
        let radius = |range: f32| ray.radius_px(self.angles.ground_angle(range));
        let (first, last) = (radius(far), radius(near) - CARPET_PX);
        let steps = ((first - last) / STEP_PX) as usize;
        let mut others: Vec<(f32, f32)> = Vec::new();
        let mut carpet: Vec<f32> = Vec::new();
        for step in 0..=steps {
            let here = first - step as f32 * STEP_PX;
            let (class, level) = self.class_and_level(self.position_px(azimuth, here))?;
            match class {
                ColourClass::CARPET => carpet.push(level),
                _ => {
                    others.push((here, level));
                    carpet.clear();
                }
            }
            if carpet.len() == CARPET_SAMPLES {
                break;
            }
        }
        if carpet.len() < CARPET_SAMPLES {
            return None;
        }
        let carpet_level = carpet.iter().sum::<f32>() / CARPET_SAMPLES as f32;
        let is_bright = |&&(_, level): &&(f32, f32)| level > carpet_level;
        let shoe: Vec<f32> = (others.iter().rev().take_while(is_bright))
            .map(|&(radius, _)| radius)
            .collect();
        let (&begins, &ends) = (shoe.first()?, shoe.last()?);
        let range = |radius| self.range_at(azimuth, radius, [near, far]);
        (shoe.len() >= SHOE_SAMPLES_MIN).then(|| Shoe {
            ends: [begins - 0.5 * STEP_PX, ends].map(range),
            carpet_level,
        })
    }

    /// Column and row at a place of the image in polar coordinates.
    fn position_px(&self, azimuth: f32, radius_px: f32) -> [i32; 2] {
        let (sin, cos) = math::sin_cos(azimuth);
        let [u, v] = self.angles.centre_px;
        [u + radius_px * cos, v - radius_px * sin].map(|at| at.round() as i32)
    }

    /// Class and brightness (sum of the channels) of a pixel.
    fn class_and_level(&self, [u, v]: [i32; 2]) -> Option<(ColourClass, f32)> {
        let [width, height] = [self.image.width_px, self.image.height_px].map(|side| side as i32);
        let inside = (0..width).contains(&u) && (0..height).contains(&v);
        inside.then(|| {
            let (u, v) = (u as usize, v as usize);
            let class = self.lookup_table.class(self.image.native_channels(u, v));
            (class, self.image.rgb(u, v).map(f32::from).iter().sum())
        })
    }

    /// Distance of the ground at an image radius, metres, within a stretch.
    fn range_at(&self, azimuth: f32, radius_px: f32, [near, far]: [f32; 2]) -> f32 {
        let ray = self.angles.ray(azimuth);
        let radius = |range: f32| ray.radius_px(self.angles.ground_angle(range));
        let [a, b] = [radius(near), radius(far)];
        let share = (radius_px - a) / (b - a).max(1e-3);
        // The ends are exact; the radius is nearly linear in the angle between them.
        let angles = [near, far].map(|range| self.angles.ground_angle(range));
        let angle = angles[0] + share * (angles[1] - angles[0]);
        self.angles.ground_range(angle)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::PixelFormat;
    use crate::optics::ground_map::GroundMap;

    const SIDE_PX: usize = 480;
    const HEIGHT: f32 = 0.7;
    /// Where the shoe begins, and the trousers as they are seen, metres; the trousers end 0.1 m above the shoe's middle.
    const SHOE: [f32; 2] = [3.0, 3.2 / (1.0 - 0.1 / HEIGHT)];

    /// A hyperbolic mirror, as others have one: the radius grows with the view angle.
    fn map() -> GroundMap {
        let middle = SIDE_PX as f32 / 2.0;
        let ground: Vec<[f32; 2]> = (0..SIDE_PX * SIDE_PX)
            .map(|index| {
                let (u, v) = ((index % SIDE_PX) as f32, (index / SIDE_PX) as f32);
                let (x, y) = (u - middle, middle - v);
                let radius = math::hypot(x, y);
                let angle = 2.0 * math::atan2(radius, 240.0);
                let range = HEIGHT * math::tan(angle);
                match radius > 1.0 && angle < 1.52 {
                    true => [range * x / radius, range * y / radius],
                    false => [f32::NAN; 2],
                }
            })
            .collect();
        GroundMap {
            width_px: SIDE_PX,
            height_px: SIDE_PX,
            x: ground.iter().map(|at| at[0]).collect(),
            y: ground.iter().map(|at| at[1]).collect(),
        }
    }

    /// Shows a scene on the ground and asks for the shoe before a foot that was found where the trousers begin, in a direction.
    fn shoe_before_trousers(is_white: impl Fn(f32, f32) -> bool) -> Option<f32> {
        let map = map();
        let mut data = vec![0u8; 3 * SIDE_PX * SIDE_PX];
        for (index, pixel) in data.chunks_mut(3).enumerate() {
            let Some(at) = map.at(index % SIDE_PX, index / SIDE_PX) else {
                continue;
            };
            let is_trousers = at.x > SHOE[1] && at.y.abs() < 0.1 * at.x / SHOE[0];
            let colour: [u8; 3] = match (is_trousers, is_white(at.x, at.y)) {
                (true, _) => [20, 20, 30],
                (_, true) => [210, 210, 205],
                _ => [40, 130, 60],
            };
            pixel.copy_from_slice(&colour);
        }
        let table = ColourLookupTable::new(|[r, g, _]| match [r > 150, g > 100] {
            [true, _] => ColourClass::WHITE,
            [_, true] => ColourClass::CARPET,
            _ => ColourClass::OTHER,
        });
        let middle = SIDE_PX as f32 / 2.0;
        let angles = ViewAngles::new(&map, [middle; 2], HEIGHT);
        let image = ImageView::packed(SIDE_PX, SIDE_PX, PixelFormat::Rgb8, &data);
        let search = BrightFootSearch {
            image: &image,
            lookup_table: &table,
            angles: &angles,
        };
        search.nearer_foot(&ObstacleCandidate {
            range: SHOE[1],
            azimuth: 0.0,
            robot: 0.0,
            person: 1.0,
        })
    }

    fn is_shoe(x: f32, y: f32) -> bool {
        (SHOE[0]..=SHOE[1]).contains(&x) && y.abs() < 0.15
    }

    #[test]
    fn foot_is_where_a_white_shoe_begins() {
        let foot = shoe_before_trousers(is_shoe).expect("a shoe");
        assert!((foot - SHOE[0]).abs() < 0.1, "{foot}");
        // The other shoe is beside it.
        let both = |x: f32, y: f32| is_shoe(x, y) || is_shoe(x, y - 0.35);
        assert!(shoe_before_trousers(both).is_some());
    }

    #[test]
    fn line_before_black_shoes_is_none() {
        let across = |x: f32, _: f32| (x - SHOE[1] + 0.06).abs() < 0.07;
        assert_eq!(shoe_before_trousers(across), None);
        let slanted = |x: f32, y: f32| (x - SHOE[1] + 0.1 + 0.7 * y).abs() < 0.1;
        assert_eq!(shoe_before_trousers(slanted), None);
        let curved =
            |x: f32, y: f32| (math::hypot(x - SHOE[1] + 0.2, y - 0.75) - 0.75).abs() < 0.06;
        assert_eq!(shoe_before_trousers(curved), None);
        let along = |_: f32, y: f32| y.abs() < 0.06;
        assert_eq!(shoe_before_trousers(along), None);
        assert_eq!(shoe_before_trousers(|_, _| false), None);
    }
}
