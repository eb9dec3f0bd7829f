//! How much of the scene does a pixel see? The angles between neighbouring pixels' rays.

use vision::{Ray, RayTable};

/// Largest slope (height over horizontal distance): steeper rays count as vertical.
const SLOPE_MAX: f32 = 1e4;

/// Direction of a ray in the ground plane, radians.
pub(super) fn azimuth(ray: &Ray) -> f32 {
    ray.direction[1].atan2(ray.direction[0])
}

/// Height of a ray per horizontal metre.
pub(super) fn slope(ray: &Ray) -> f32 {
    let across = ray.direction[0].hypot(ray.direction[1]);
    (ray.direction[2] / across.max(1e-9)).clamp(-SLOPE_MAX, SLOPE_MAX)
}

/// Change of azimuth and slope from a pixel to the next, root sum square over rows and columns.
pub(super) fn pixel_spacing(table: &RayTable, pixel: usize, ray: &Ray) -> [f32; 2] {
    let (column, row) = (pixel % table.width_px, pixel / table.width_px);
    let (mut turn2, mut rise2) = (0.0, 0.0);
    for (from, to) in [
        (
            (column > 0).then(|| pixel - 1),
            (column + 1 < table.width_px).then_some(pixel + 1),
        ),
        (
            (row > 0).then(|| pixel - table.width_px),
            (row + 1 < table.height_px).then_some(pixel + table.width_px),
        ),
    ] {
        let neighbour = |at: Option<usize>| at.and_then(|at| table.rays[at]);
        let (before, after) = (neighbour(from), neighbour(to));
        let steps = f32::from(u8::from(before.is_some()) + u8::from(after.is_some())).max(1.0);
        let (before, after) = (before.unwrap_or(*ray), after.unwrap_or(*ray));
        let turn = localize::frames::wrap_angle(azimuth(&after) - azimuth(&before)) / steps;
        let rise = (slope(&after) - slope(&before)) / steps;
        turn2 += turn * turn;
        rise2 += rise * rise;
    }
    [turn2.sqrt().clamp(1e-4, 1.0), rise2.sqrt().max(1e-5)]
}
