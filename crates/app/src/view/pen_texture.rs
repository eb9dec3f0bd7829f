//! The texture of [`super::pen::Pen`]: profiles of lines by their width, and discs by their radius.

use eframe::egui::{
    self, Color32, ColorImage, Pos2, Rect, TextureHandle, TextureId, TextureOptions,
};

/// Line profiles: widths in quarters of a pixel, one row each, and texels across.
const LINE_ROWS: usize = 32;
const LINE_TEXELS: usize = 32;
/// Widths of neighbouring rows differ by this, pixels.
const LINE_WIDTH_STEP: f32 = 0.25;
/// Radii of the discs, pixels. Others are drawn smaller than the next larger one.
pub(super) const DISC_RADII: [f32; 4] = [2.0, 4.0, 8.0, 16.0];
/// Room around a disc for its soft edge, pixels.
pub(super) const DISC_MARGIN: f32 = 1.0;
/// Size of the texture: profiles on the left, discs below one another on the right.
const SIZE: [usize; 2] = [LINE_TEXELS + 34, 6 + 10 + 18 + 34];
/// Where the texture covers fully: the middle of the widest profile.
pub(super) const SOLID_UV: Pos2 = Pos2::new(
    0.5 * LINE_TEXELS as f32 / SIZE[0] as f32,
    (LINE_ROWS as f32 - 0.5) / SIZE[1] as f32,
);
/// End of the profiles across.
pub(super) const LINE_U: f32 = LINE_TEXELS as f32 / SIZE[0] as f32;

/// The texture, which is made when it is first used.
pub(super) fn id(ctx: &egui::Context) -> TextureId {
    loaded(ctx, "pen", render, TextureOptions::LINEAR)
}

/// A texture of one texel, for large areas: a software renderer reads it in less time than a smoothed one.
pub(super) fn solid_id(ctx: &egui::Context) -> TextureId {
    let texel = || ColorImage::filled([1, 1], Color32::WHITE);
    loaded(ctx, "solid", texel, TextureOptions::NEAREST)
}

fn loaded(
    ctx: &egui::Context,
    name: &'static str,
    image: impl FnOnce() -> ColorImage,
    options: TextureOptions,
) -> TextureId {
    let key = egui::Id::unique(("texture of the pen", name));
    if let Some(handle) = ctx.data(|data| data.get_temp::<TextureHandle>(key)) {
        return handle.id();
    }
    let handle = ctx.load_texture(name, image(), options);
    ctx.data_mut(|data| data.insert_temp(key, handle.clone()));
    handle.id()
}

/// Half of the strip that a line of this width (pixels) needs, soft edges included, pixels.
pub(super) fn line_half_extent(width: f32) -> f32 {
    width / 2.0 + 1.0
}

/// Height of the profile for a width in pixels.
pub(super) fn line_v(width: f32) -> f32 {
    let row = (width / LINE_WIDTH_STEP)
        .round()
        .clamp(1.0, LINE_ROWS as f32)
        - 1.0;
    (row + 0.5) / SIZE[1] as f32
}

/// Left, top and side of a disc's part of the texture, texels.
fn disc_place(class: usize) -> [usize; 3] {
    let side = |class: usize| 2 * (DISC_RADII[class] + DISC_MARGIN) as usize;
    [LINE_TEXELS, (0..class).map(side).sum(), side(class)]
}

/// Part of the texture with a disc.
pub(super) fn disc_uv(class: usize) -> Rect {
    let [left, top, side] = disc_place(class);
    let corner =
        |x: usize, y: usize| Pos2::new(x as f32 / SIZE[0] as f32, y as f32 / SIZE[1] as f32);
    Rect::from_min_max(corner(left, top), corner(left + side, top + side))
}

fn render() -> ColorImage {
    let mut image = ColorImage::filled(SIZE, Color32::TRANSPARENT);
    let shade = |coverage: f32| {
        let alpha = (255.0 * coverage.clamp(0.0, 1.0)).round() as u8;
        Color32::from_rgba_premultiplied(alpha, alpha, alpha, alpha)
    };
    for row in 0..LINE_ROWS {
        let width = (row + 1) as f32 * LINE_WIDTH_STEP;
        for texel in 0..LINE_TEXELS {
            let across = (texel as f32 + 0.5) / LINE_TEXELS as f32 * 2.0 - 1.0;
            let distance = across.abs() * line_half_extent(width);
            // A line thinner than a pixel covers a part of it only.
            let coverage = (width / 2.0 + 0.5 - distance).min(width);
            image.pixels[row * SIZE[0] + texel] = shade(coverage);
        }
    }
    for (class, radius) in DISC_RADII.into_iter().enumerate() {
        let [left, top, side] = disc_place(class);
        let middle = side as f32 / 2.0;
        for y in 0..side {
            for x in 0..side {
                let distance = (x as f32 + 0.5 - middle).hypot(y as f32 + 0.5 - middle);
                image.pixels[(top + y) * SIZE[0] + left + x] = shade(radius + 0.5 - distance);
            }
        }
    }
    image
}
