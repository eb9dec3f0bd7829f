//! What stands at the carpet's end in each direction? One column a ray, rods and cables passed over.

use crate::colours::Class;
use crate::config::ObjectConfig;
use crate::rays::{RaySight, Rays};

/// What ends the carpet of one ray.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Column {
    /// Where its foot is, metres.
    pub(crate) range: f32,
    /// The median of its own and both neighbours' ranges.
    pub(crate) smooth: f32,
    /// The ray's direction, robot frame, unit length.
    pub(crate) towards: [f32; 2],
    /// Dark or coloured from the floor up.
    pub(crate) solid: bool,
    /// No carpet before it: it begins beside the robot itself.
    pub(crate) touching: bool,
    /// Samples of that colour.
    pub(crate) cyan: u32,
    /// Samples of that colour.
    pub(crate) magenta: u32,
    /// Its foot.
    pub(crate) sample: usize,
}

/// A foot is so many samples high at least: its edge is mixed with the carpet.
pub(crate) const FOOT: usize = 5;

/// How far neighbouring columns of one thing lie apart at most, metres: a side seen at a slant, and a sample's step.
pub(crate) fn step_max(range: f32) -> f32 {
    0.15 + 0.1 * range
}

/// The columns of all rays; none where nothing stands within range.
pub(crate) fn columns(
    rays: &Rays,
    sights: &[RaySight],
    config: &ObjectConfig,
) -> Vec<Option<Column>> {
    let mut columns: Vec<Option<Column>> = (0..rays.count())
        .map(|ray| {
            let all = rays.starts[ray]..rays.starts[ray + 1];
            touching(rays, all.clone(), config)
                .or_else(|| standing(rays, &sights[ray], all.end, config))
        })
        .collect();
    pass_rods(&mut columns, config);
    smoothed(&columns)
}

/// What stands beyond the carpet.
fn standing(rays: &Rays, sight: &RaySight, end: usize, config: &ObjectConfig) -> Option<Column> {
    if !(sight.carpet && sight.end <= config.robot_range_max) {
        return None;
    }
    // A line, and what is mixed of it and the carpet, may lie before the foot.
    let before = sight.beyond..behind_lines(rays, sight.beyond, end, config);
    let solid = before.clone().find(|&first| {
        let foot = &rays.classes[first..end.min(first + FOOT)];
        dark(foot[0]) && 2 * foot.iter().filter(|&&class| dark(class)).count() >= foot.len()
    });
    let first = solid.unwrap_or_else(|| {
        let mut samples = before.clone();
        let line = |sample: &usize| rays.classes[*sample] == Class::WHITE;
        samples.find(|sample| !line(sample)).unwrap_or(before.end)
    });
    let foot = &rays.classes[first..end.min(first + FOOT)];
    let whites = foot.iter().filter(|&&class| class == Class::WHITE).count();
    if foot.is_empty() || 2 * whites > foot.len() {
        return None;
    }
    // What is mixed of floor and foot is shared between them.
    let floor = |class: &Class| matches!(*class, Class::CARPET | Class::WHITE);
    let between = &rays.classes[sight.beyond..first];
    let last = between.iter().rposition(floor);
    let last = last.map_or(sight.beyond - 1, |last| sight.beyond + last);
    let range = (rays.samples[last].range + rays.samples[first].range) / 2.0;
    Some(column(rays, first, end, range, solid.is_some()))
}

/// So far on lines may lie, from a sample on.
fn behind_lines(rays: &Rays, from: usize, end: usize, config: &ObjectConfig) -> usize {
    let mut gap = 0.0;
    let within = |sample: &usize| {
        gap += covers(rays, *sample);
        gap < config.gap_max
    };
    from + (from..end).take_while(within).count()
}

/// Ground that a sample covers along its ray, metres: white counts a quarter, as a line may point at the robot.
fn covers(rays: &Rays, sample: usize) -> f32 {
    let step = rays.samples[sample].range - rays.samples[sample - 1].range;
    if rays.classes[sample] == Class::WHITE {
        0.25 * step
    } else {
        step
    }
}

/// What hides the carpet from the robot itself on, farther than a passed-over gap would.
fn touching(rays: &Rays, all: std::ops::Range<usize>, config: &ObjectConfig) -> Option<Column> {
    let classes = &rays.classes[all.clone()];
    let clear = |pair: &[Class; 2]| *pair == [Class::CARPET; 2];
    let covered = classes.array_windows().take_while(|pair| !clear(pair));
    let covered = all.start + covered.count();
    if covered == all.start {
        return None;
    }
    let nearest = rays.samples[all.start].range;
    let gap: f32 = (all.start + 1..covered)
        .map(|sample| covers(rays, sample))
        .sum();
    let hides = gap > config.gap_max + config.gap_share * nearest;
    hides.then(|| Column {
        touching: true,
        ..column(rays, all.start, all.end, nearest, true)
    })
}

fn column(rays: &Rays, first: usize, end: usize, range: f32, solid: bool) -> Column {
    let of = |wanted: Class| {
        let same = rays.classes[first..end].iter().filter(|&&c| c == wanted);
        same.count() as u32
    };
    let [x, y] = rays.samples[first].ground;
    let length = x.hypot(y);
    Column {
        range,
        smooth: range,
        towards: [x / length, y / length],
        solid,
        touching: false,
        cyan: of(Class::CYAN),
        magenta: of(Class::MAGENTA),
        sample: first,
    }
}

fn dark(class: Class) -> bool {
    matches!(class, Class::BLACK | Class::CYAN | Class::MAGENTA)
}

/// Rays whose end is nearer than both its neighbours' and too narrow for a robot see a rod or a cable: what stands beside
/// it stands behind it too.
///
/// The robot's own rods look so in every direction that has one.
fn pass_rods(columns: &mut [Option<Column>], config: &ObjectConfig) {
    let count = columns.len();
    let ray_angle = std::f32::consts::TAU / count as f32;
    for first in 0..count {
        let range = |columns: &[Option<Column>], ray: usize| {
            columns[ray % count].map_or(f32::INFINITY, |column| column.range)
        };
        let own = range(columns, first);
        let before = range(columns, first + count - 1);
        if !own.is_finite() || before - own <= step_max(own) {
            continue;
        }
        let widest = (config.robot_width_min / (ray_angle * own)) as usize;
        let farther = |ray: &usize| range(columns, *ray) - own > step_max(own);
        let Some(after) = (first + 1..=first + widest).find(farther) else {
            continue;
        };
        let beside = if before <= range(columns, after) {
            columns[(first + count - 1) % count]
        } else {
            columns[after % count]
        };
        for ray in first..after {
            // Behind a rod things are seen in the rod's own direction.
            let towards = columns[ray % count].map(|column| column.towards);
            columns[ray % count] = beside.map(|beside| Column {
                towards: towards.unwrap_or(beside.towards),
                ..beside
            });
        }
    }
}

/// With the median of three neighbouring rays' ranges: a robot is as wide as several, noise ends a single one early.
fn smoothed(columns: &[Option<Column>]) -> Vec<Option<Column>> {
    let count = columns.len();
    let median = |ray: usize| {
        let own = columns[ray]?;
        let beside = [ray + count - 1, ray + 1].map(|ray| columns[ray % count]);
        let [before, after] = beside.map(|other| other.map_or(own.range, |other| other.range));
        let solid = |other: Option<Column>| {
            let near = other.filter(|o| (o.range - own.range).abs() < step_max(own.range));
            near.map_or(own.solid, |other| other.solid)
        };
        let [one, other] = beside.map(solid);
        Some(Column {
            smooth: own.range.clamp(before.min(after), before.max(after)),
            solid: if one == other { one } else { own.solid },
            ..own
        })
    };
    (0..count).map(median).collect()
}
