//! Where do robots stand? What ends the carpet in neighbouring directions at like distance, with its team marker.
//!
//! lima2001 section 3: the first obstacle in each direction; a robot's foot is where its column leaves the carpet.

use localize::frame::{At, RobotFrame};

use crate::colours::Class;
use crate::config::ObjectConfig;
use crate::rays::{RaySight, Rays, stands_on_carpet};

/// The colour that a robot wears.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Marker {
    /// Cyan.
    Cyan,
    /// Magenta.
    Magenta,
}

/// A robot, or somebody's legs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Robot {
    /// Its middle: `robot_radius` behind its nearest edge; metres.
    pub at: At<RobotFrame>,
    /// The nearest point of the ground that it covers, metres.
    pub edge: At<RobotFrame>,
    /// Covariance of its middle: xx, xy, yy, m².
    pub covariance: [f32; 3],
    /// How wide it is seen, metres.
    pub width: f32,
    /// Its team's colour, where one is seen.
    pub marker: Option<Marker>,
    /// How sure it is one: thirds for standing before what is beside it, for its marker and for its dark foot.
    pub score: f32,
    /// Its nearest edge in the image: column, row, pixels.
    pub at_px: [f32; 2],
}

/// What ends the carpet of one ray.
#[derive(Debug, Clone, Copy)]
struct Column {
    range: f32,
    /// The median of its own and both neighbours' ranges.
    smooth: f32,
    /// Dark or coloured from the floor up.
    solid: bool,
    cyan: u32,
    magenta: u32,
    sample: usize,
}

/// Groups the rays' ends into robots.
pub(crate) fn robots(rays: &Rays, sights: &[RaySight], config: &ObjectConfig) -> Vec<Robot> {
    let columns: Vec<Option<Column>> = (0..rays.count())
        .map(|ray| column(rays, &sights[ray], rays.starts[ray + 1], config))
        .collect();
    let columns = smoothed(&columns);
    let count = columns.len();
    let joined = |a: usize, b: usize| match (columns[a], columns[b]) {
        (Some(a), Some(b)) => (a.smooth - b.smooth).abs() < 0.15 + 0.1 * a.smooth.min(b.smooth),
        _ => false,
    };
    // Start at a gap, so that no group is cut where the circle is.
    let Some(first) = (0..count).find(|&ray| !joined((ray + count - 1) % count, ray)) else {
        return Vec::new();
    };
    let mut found = Vec::new();
    let mut group: Vec<usize> = Vec::new();
    for step in 0..=count {
        let ray = (first + step) % count;
        let follows = group.last().is_some_and(|&last| joined(last, ray)) && step < count;
        if !follows {
            split(rays, sights, &columns, &group, config, &mut found);
            group.clear();
        }
        if columns[ray].is_some() {
            group.push(ray);
        }
    }
    found
}

/// With the median of three neighbouring rays' ranges: a robot is as wide as several, noise ends a single one early.
fn smoothed(columns: &[Option<Column>]) -> Vec<Option<Column>> {
    let count = columns.len();
    let median = |ray: usize| {
        let own = columns[ray]?;
        let range = |ray: usize| columns[ray % count].map_or(own.range, |column| column.range);
        let (before, after) = (range(ray + count - 1), range(ray + 1));
        let smooth = own.range.clamp(before.min(after), before.max(after));
        Some(Column { smooth, ..own })
    };
    (0..count).map(median).collect()
}

/// A group wider than a robot is cut where it recedes between two nearer parts: robots side by side.
fn split(
    rays: &Rays,
    sights: &[RaySight],
    columns: &[Option<Column>],
    group: &[usize],
    config: &ObjectConfig,
    found: &mut Vec<Robot>,
) {
    let range = |place: usize| columns[group[place]].map_or(f32::INFINITY, |c| c.smooth);
    let nearest = (0..group.len()).map(range).fold(f32::INFINITY, f32::min);
    let ray_angle = std::f32::consts::TAU / columns.len() as f32;
    // Seen corner on, the league's square robot is √2 wider than its side.
    let robot_width = 2.0 * config.robot_radius * std::f32::consts::SQRT_2;
    if group.len() as f32 * ray_angle * nearest > robot_width {
        // The nearest part before each place, and from each place on.
        let running = |nearest: &mut f32, place| {
            *nearest = range(place).min(*nearest);
            Some(*nearest)
        };
        let before: Vec<f32> = (0..group.len()).scan(f32::INFINITY, running).collect();
        let mut after: Vec<f32> = (0..group.len())
            .rev()
            .scan(f32::INFINITY, running)
            .collect();
        after.reverse();
        // Asked for inner places only.
        let dip = |place: usize| range(place) - before[place - 1].max(after[place + 1]);
        let cut = (1..group.len().saturating_sub(1)).max_by(|&a, &b| dip(a).total_cmp(&dip(b)));
        if let Some(cut) = cut.filter(|&cut| dip(cut) > 0.1) {
            split(rays, sights, columns, &group[..cut], config, found);
            split(rays, sights, columns, &group[cut + 1..], config, found);
            return;
        }
    }
    found.extend(robot(rays, sights, columns, group, config));
}

fn column(rays: &Rays, sight: &RaySight, end: usize, config: &ObjectConfig) -> Option<Column> {
    if !(sight.carpet && sight.end <= config.robot_range_max) {
        return None;
    }
    // A line may lie before the foot.
    let mut first = sight.beyond;
    while first < end
        && rays.classes[first] == Class::WHITE
        && rays.samples[first].range - sight.end < config.gap_max
    {
        first += 1;
    }
    let beyond = &rays.classes[first..end];
    let dark = |class: &&Class| matches!(**class, Class::BLACK | Class::CYAN | Class::MAGENTA);
    // The edge itself is mixed with the carpet; a foot is dark from the floor up.
    let foot = &beyond[..beyond.len().min(5)];
    let of = |wanted: Class| beyond.iter().filter(|&&class| class == wanted).count() as u32;
    if beyond.is_empty() || 2 * foot.iter().filter(|&&c| c == Class::WHITE).count() > foot.len() {
        return None;
    }
    let range = (rays.samples[first - 1].range + rays.samples[first].range) / 2.0;
    Some(Column {
        range,
        smooth: range,
        solid: 2 * foot.iter().filter(dark).count() >= foot.len(),
        cyan: of(Class::CYAN),
        magenta: of(Class::MAGENTA),
        sample: first,
    })
}

fn robot(
    rays: &Rays,
    sights: &[RaySight],
    columns: &[Option<Column>],
    group: &[usize],
    config: &ObjectConfig,
) -> Option<Robot> {
    let members: Vec<Column> = group.iter().filter_map(|&ray| columns[ray]).collect();
    let nearest = *members.iter().min_by(|a, b| a.range.total_cmp(&b.range))?;
    let ray_angle = std::f32::consts::TAU / columns.len() as f32;
    let width = members.len() as f32 * ray_angle * nearest.range;
    if width < config.robot_width_min || width > config.robot_width_max {
        return None;
    }
    let stands_out = stands_on_carpet(sights, group, nearest.range, config.robot_before_min);
    let solid = members.iter().filter(|column| column.solid).count() as f32 / members.len() as f32;
    let [mut x, mut y] = [0.0, 0.0];
    for member in &members {
        let [gx, gy] = rays.samples[member.sample].ground;
        x += gx / gx.hypot(gy);
        y += gy / gx.hypot(gy);
    }
    let length = x.hypot(y);
    let [x, y] = [x / length, y / length];
    let (cyan, magenta) = members.iter().fold((0, 0), |(c, m), column| {
        (c + column.cyan, m + column.magenta)
    });
    let marker = match (cyan, magenta) {
        (c, m) if c.max(m) < 3 => None,
        (c, m) if c > 2 * m => Some(Marker::Cyan),
        (c, m) if m > 2 * c => Some(Marker::Magenta),
        _ => None,
    };
    // A dark floor behind the carpet, a coloured thing on it, clutter: each shows one sign of a robot, not two.
    let signs = [stands_out, marker.is_some(), solid >= 0.5];
    let signs = signs.iter().filter(|&&sign| sign).count();
    if signs < 2 {
        return None;
    }
    let middle = nearest.range + config.robot_radius;
    let sample = rays.samples[nearest.sample];
    // Along the ray: a sample's step and an unknown radius; across: half a ray's spacing and half the unknown width.
    let next = rays.samples[(nearest.sample + 1).min(rays.samples.len() - 1)].range;
    let step = (next - nearest.range).abs().min(1.0);
    let (along, across) = (step + 0.05, ray_angle * middle + 0.05);
    let (a2, c2) = (along * along, across * across);
    Some(Robot {
        at: At::new(middle * x, middle * y),
        edge: At::new(nearest.range * x, nearest.range * y),
        covariance: [
            a2 * x * x + c2 * y * y,
            (a2 - c2) * x * y,
            a2 * y * y + c2 * x * x,
        ],
        width,
        marker,
        score: signs as f32 / 3.0,
        at_px: [f32::from(sample.u), f32::from(sample.v)],
    })
}
