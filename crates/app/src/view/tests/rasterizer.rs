//! Draws egui's tessellated shapes on the processor: the same pixels on every machine, without a graphics card.
//!
//! Vertices are snapped to 1/256 pixel and edges are exact integers, so neighbouring triangles neither overlap nor leave
//! gaps. Colours are multiplied and blended as egui's own painters do: premultiplied, without linearization.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use eframe::egui::epaint::{ImageData, ImageDelta, Mesh, Primitive, Vertex};
use eframe::egui::{Color32, Context, FullOutput, Pos2, Rect, TextureFilter, TextureId};
use egui_kittest::TestRenderer;
use image::RgbImage;

/// Steps of a vertex's place within a pixel.
const SUBPIXELS: f32 = 256.0;

/// The textures of a harness, from which [`Rasterizer::draw`] draws.
#[derive(Clone, Default)]
pub(super) struct Rasterizer {
    textures: Arc<Mutex<BTreeMap<TextureId, Texture>>>,
}

struct Texture {
    size: [usize; 2],
    pixels: Vec<Color32>,
    filter: TextureFilter,
}

impl TestRenderer for Rasterizer {
    fn handle_delta(&mut self, delta: &mut eframe::egui::TexturesDelta) {
        let mut textures = self.textures.lock().unwrap_or_else(PoisonError::into_inner);
        let mut changed: Vec<TextureId> = delta.set.keys().copied().collect();
        changed.sort();
        for id in changed {
            for patch in delta.set.remove(&id).into_iter().flatten() {
                apply_patch(&mut textures, id, &patch);
            }
        }
        textures.retain(|id, _| !delta.free.contains(id));
        delta.clear();
    }
}

impl Rasterizer {
    /// The picture of a frame: one pixel a point, over a background.
    pub(super) fn draw(
        &self,
        ctx: &Context,
        output: &FullOutput,
        size: [u32; 2],
        background: Color32,
    ) -> RgbImage {
        let textures = self.textures.lock().unwrap_or_else(PoisonError::into_inner);
        let [r, g, b, _] = background.to_array();
        let mut canvas = RgbImage::from_pixel(size[0], size[1], image::Rgb([r, g, b]));
        for primitive in ctx.tessellate(output.shapes.clone(), 1.0) {
            let Primitive::Mesh(mesh) = &primitive.primitive else {
                panic!("the view draws meshes only");
            };
            let texture = &textures[&mesh.texture_id];
            draw_mesh(&mut canvas, mesh, texture, primitive.clip_rect);
        }
        canvas
    }
}

fn apply_patch(textures: &mut BTreeMap<TextureId, Texture>, id: TextureId, patch: &ImageDelta) {
    let ImageData::Color(image) = &patch.image;
    let Some([left, top]) = patch.pos else {
        let texture = Texture {
            size: image.size,
            pixels: image.pixels.clone(),
            filter: patch.options.magnification,
        };
        textures.insert(id, texture);
        return;
    };
    let texture = textures.get_mut(&id).expect("a patch of a known texture");
    for (row, pixels) in image.pixels.chunks(image.size[0]).enumerate() {
        let start = (top + row) * texture.size[0] + left;
        texture.pixels[start..start + pixels.len()].copy_from_slice(pixels);
    }
}

/// A vertex's place in steps of 1/256 pixel.
fn snap(at: Pos2) -> [i64; 2] {
    [at.x, at.y].map(|value| (value * SUBPIXELS).round() as i64)
}

/// Twice the signed area of a triangle.
fn doubled_area(a: [i64; 2], b: [i64; 2], c: [i64; 2]) -> i64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

/// Of a clockwise triangle (on a screen) the edges at its top and left own the pixels whose centres lie on them.
fn is_top_left(from: [i64; 2], to: [i64; 2]) -> bool {
    to[1] < from[1] || (to[1] == from[1] && to[0] > from[0])
}

fn draw_mesh(canvas: &mut RgbImage, mesh: &Mesh, texture: &Texture, clip: Rect) {
    let clamp = |value: f32, end: u32| value.round().clamp(0.0, end as f32) as i64;
    let (width, height) = canvas.dimensions();
    let clip = [
        [clamp(clip.min.x, width), clamp(clip.max.x, width)],
        [clamp(clip.min.y, height), clamp(clip.max.y, height)],
    ];
    for corners in mesh.indices.chunks_exact(3) {
        let corner = |number: usize| &mesh.vertices[corners[number] as usize];
        draw_triangle(canvas, [corner(0), corner(1), corner(2)], texture, clip);
    }
}

fn draw_triangle(
    canvas: &mut RgbImage,
    mut corners: [&Vertex; 3],
    texture: &Texture,
    clip: [[i64; 2]; 2],
) {
    let area = doubled_area(
        snap(corners[0].pos),
        snap(corners[1].pos),
        snap(corners[2].pos),
    );
    if area == 0 {
        return;
    }
    if area < 0 {
        corners.swap(1, 2);
    }
    let places = corners.map(|corner| snap(corner.pos));
    // Columns and rows whose pixels the triangle may cover.
    let range = |axis: usize| {
        let values = places.map(|place| place[axis]);
        let (low, high) = (values.iter().min(), values.iter().max());
        let low = low.map_or(0, |low| low.div_euclid(SUBPIXELS as i64));
        let high = high.map_or(0, |high| high.div_euclid(SUBPIXELS as i64) + 1);
        low.max(clip[axis][0])..high.min(clip[axis][1])
    };
    for row in range(1) {
        for column in range(0) {
            let centre = [column, row].map(|cell| cell * SUBPIXELS as i64 + SUBPIXELS as i64 / 2);
            // The share of a corner is the area that the opposite edge spans with the pixel.
            let shares = [0, 1, 2].map(|corner| {
                let (from, to) = (places[(corner + 1) % 3], places[(corner + 2) % 3]);
                let share = doubled_area(from, to, centre);
                let is_inside = share > 0 || (share == 0 && is_top_left(from, to));
                is_inside.then_some(share as f32 / area.abs() as f32)
            });
            if let [Some(a), Some(b), Some(c)] = shares {
                let source = shade(corners, [a, b, c], texture);
                blend(canvas, [column as u32, row as u32], source);
            }
        }
    }
}

/// Colour of a triangle at a pixel, premultiplied, 0 to 1.
fn shade(corners: [&Vertex; 3], shares: [f32; 3], texture: &Texture) -> [f32; 4] {
    let mut colour = [0.0; 4];
    let mut uv = [0.0; 2];
    for (corner, share) in corners.into_iter().zip(shares) {
        for (sum, part) in colour.iter_mut().zip(corner.color.to_array()) {
            *sum += share * f32::from(part) / 255.0;
        }
        uv[0] += share * corner.uv.x;
        uv[1] += share * corner.uv.y;
    }
    let texel = texture.sample(uv);
    [0, 1, 2, 3].map(|channel| colour[channel] * texel[channel])
}

fn blend(canvas: &mut RgbImage, [column, row]: [u32; 2], source: [f32; 4]) {
    let pixel = canvas.get_pixel_mut(column, row);
    for (channel, value) in pixel.0.iter_mut().enumerate() {
        let blended = source[channel] + (1.0 - source[3]) * f32::from(*value) / 255.0;
        *value = (255.0 * blended).round().clamp(0.0, 255.0) as u8;
    }
}

impl Texture {
    fn texel(&self, column: i64, row: i64) -> [f32; 4] {
        let column = column.clamp(0, self.size[0] as i64 - 1) as usize;
        let row = row.clamp(0, self.size[1] as i64 - 1) as usize;
        let texel = self.pixels[row * self.size[0] + column];
        texel.to_array().map(|value| f32::from(value) / 255.0)
    }

    /// Colour at a place in 0 to 1; the border's beyond the border.
    fn sample(&self, uv: [f32; 2]) -> [f32; 4] {
        let at = [uv[0] * self.size[0] as f32, uv[1] * self.size[1] as f32];
        if self.filter == TextureFilter::Nearest {
            return self.texel(at[0].floor() as i64, at[1].floor() as i64);
        }
        let [x, y] = at.map(|value| value - 0.5);
        let (column, row) = (x.floor(), y.floor());
        let (right, down) = (x - column, y - row);
        let mut sum = [0.0; 4];
        for (dx, share_x) in [(0, 1.0 - right), (1, right)] {
            for (dy, share_y) in [(0, 1.0 - down), (1, down)] {
                let texel = self.texel(column as i64 + dx, row as i64 + dy);
                for (sum, value) in sum.iter_mut().zip(texel) {
                    *sum += share_x * share_y * value;
                }
            }
        }
        sum
    }
}

#[test]
fn triangles_share_no_pixel_and_leave_none_out() {
    let texture = Texture {
        size: [1, 1],
        pixels: vec![Color32::WHITE],
        filter: TextureFilter::Linear,
    };
    // Four triangles around an odd place, half transparent: a pixel drawn twice or not at all has another colour.
    let corners = [[0.3, 0.2], [20.0, 1.7], [17.4, 19.0], [1.0, 16.5]];
    let mut mesh = Mesh::default();
    for [x, y] in corners.into_iter().chain([[9.1, 7.7]]) {
        mesh.colored_vertex(
            Pos2::new(x, y),
            Color32::from_rgba_premultiplied(100, 0, 0, 128),
        );
    }
    for corner in 0..4 {
        mesh.add_triangle(corner, (corner + 1) % 4, 4);
    }
    let mut canvas = RgbImage::new(20, 20);
    let clip = Rect::from_min_max(Pos2::ZERO, Pos2::new(20.0, 20.0));
    draw_mesh(&mut canvas, &mesh, &texture, clip);
    assert!(canvas.pixels().all(|pixel| [0, 100].contains(&pixel.0[0])));
    for (x, y, pixel) in canvas.enumerate_pixels() {
        if (3..16).contains(&x) && (3..15).contains(&y) {
            assert_eq!(pixel.0[0], 100, "at {x}, {y}");
        }
    }
}

#[test]
fn texels_are_blended_between_their_centres() {
    let texture = Texture {
        size: [2, 1],
        pixels: vec![Color32::BLACK, Color32::WHITE],
        filter: TextureFilter::Linear,
    };
    assert_eq!(texture.sample([0.25, 0.5])[0], 0.0);
    assert_eq!(texture.sample([0.5, 0.5])[0], 0.5);
    assert_eq!(texture.sample([0.75, 0.5])[0], 1.0);
}
