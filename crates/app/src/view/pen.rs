//! Draws lines, discs and rectangles with few triangles: a software renderer pays for each one, and the usual soft-edged
//! line has nine times as many. Soft edges come from a small texture instead.

use std::cell::RefCell;
use std::f32::consts::TAU;
use std::sync::Arc;

use eframe::egui::epaint::{Mesh, Vertex};
use eframe::egui::layers::ShapeIdx;
use eframe::egui::{
    Align2, Color32, FontId, Galley, Painter, Pos2, Rect, Shape, Stroke, TextureId, Vec2,
};

use super::line_simplification::simplify;
use super::pen_texture::{self as texture, DISC_RADII};

/// Cosine of half the turn up to which the parts of a line share a mitred corner.
const MITRE_COSINE_MIN: f32 = 0.5;
/// Deviation of a drawn circle from a circle, pixels.
const CIRCLE_TOLERANCE: f32 = 0.1;
/// Turn of an arrow's barbs against its shaft, radians, and their length as a share of the shaft.
const BARB_ANGLE: f32 = TAU / 10.0;
const BARB_SHARE: f32 = 0.25;
/// Longest barb, points.
const BARB_MAX: f32 = 9.0;

/// Area from which a rectangle is drawn with a texture of its own, square points.
const LARGE_AREA: f32 = 4096.0;

/// A painter that collects what it can in one mesh, and keeps the order of everything drawn.
pub(crate) struct Pen {
    painter: Painter,
    texture: TextureId,
    /// Points per pixel.
    pixel: f32,
    pending: RefCell<Option<(ShapeIdx, Mesh)>>,
}

impl Pen {
    /// Draws with a painter.
    pub(crate) fn new(painter: Painter) -> Self {
        Pen {
            texture: texture::id(painter.ctx()),
            pixel: 1.0 / painter.pixels_per_point(),
            painter,
            pending: RefCell::default(),
        }
    }

    /// The same with a smaller visible area.
    pub(crate) fn clipped_to(&self, area: Rect) -> Pen {
        self.flush();
        Pen::new(
            self.painter
                .with_clip_rect(area.intersect(self.clip_rect())),
        )
    }

    /// The visible area.
    pub(crate) fn clip_rect(&self) -> Rect {
        self.painter.clip_rect()
    }

    /// The painter, for everything else. What was drawn so far lies below.
    pub(crate) fn painter(&self) -> &Painter {
        self.flush();
        &self.painter
    }

    /// Draws a line between two places.
    pub(crate) fn segment(&self, ends: [Pos2; 2], stroke: impl Into<Stroke>) {
        self.line(ends, stroke);
    }

    /// Draws a line through places.
    pub(crate) fn line(&self, points: impl IntoIterator<Item = Pos2>, stroke: impl Into<Stroke>) {
        let stroke = stroke.into();
        let mut strip = Strip::new(self, stroke);
        simplify(points.into_iter(), self.pixel, |at| strip.push(at));
        let quads = strip.finish();
        self.with_mesh(|mesh| mesh.append(quads));
    }

    /// Draws a closed line through places.
    pub(crate) fn ring(&self, points: &[Pos2], stroke: impl Into<Stroke>) {
        self.line(points.iter().chain(points.first()).copied(), stroke);
    }

    /// Draws the rim of a circle.
    pub(crate) fn circle(&self, centre: Pos2, radius: f32, stroke: impl Into<Stroke>) {
        let deviation = (CIRCLE_TOLERANCE * self.pixel / radius).clamp(1e-5, 0.5);
        let steps = (TAU / 2.0 / (1.0 - deviation).acos()).ceil().max(8.0) as usize;
        let corner = |step: usize| centre + Vec2::angled(TAU * step as f32 / steps as f32) * radius;
        self.line((0..=steps).map(corner), stroke);
    }

    /// Draws a filled circle.
    pub(crate) fn disc(&self, centre: Pos2, radius: f32, colour: Color32) {
        let pixels = radius / self.pixel;
        let Some(class) = DISC_RADII.iter().position(|known| *known >= pixels) else {
            self.painter().circle_filled(centre, radius, colour);
            return;
        };
        // The texture has a margin for the soft edge.
        let half = radius * (DISC_RADII[class] + texture::DISC_MARGIN) / DISC_RADII[class];
        let area = Rect::from_center_size(centre, Vec2::splat(2.0 * half));
        if self.clip_rect().intersects(area) {
            self.with_mesh(|mesh| mesh.add_rect_with_uv(area, texture::disc_uv(class), colour));
        }
    }

    /// Fills a rectangle.
    pub(crate) fn rect(&self, area: Rect, colour: Color32) {
        let visible = self.clip_rect().intersect(area);
        if !visible.is_positive() {
            return;
        }
        let uv = Rect::from_min_max(texture::SOLID_UV, texture::SOLID_UV);
        if visible.area() < LARGE_AREA {
            return self.with_mesh(|mesh| mesh.add_rect_with_uv(area, uv, colour));
        }
        // Its own mesh, above what was drawn so far.
        let mut mesh = Mesh::with_texture(texture::solid_id(self.painter().ctx()));
        mesh.add_rect_with_uv(visible, uv, colour);
        self.painter.add(Shape::mesh(mesh));
    }

    /// Draws the rim of a rectangle.
    pub(crate) fn rect_rim(&self, area: Rect, stroke: impl Into<Stroke>) {
        let corners = [
            area.left_top(),
            area.right_top(),
            area.right_bottom(),
            area.left_bottom(),
        ];
        self.ring(&corners, stroke);
    }

    /// Draws an arrow.
    pub(crate) fn arrow(&self, from: Pos2, along: Vec2, stroke: impl Into<Stroke>) {
        let (tip, stroke) = (from + along, stroke.into());
        self.segment([from, tip], stroke);
        let share = BARB_SHARE.min(BARB_MAX / along.length().max(1.0));
        let barbs = [BARB_ANGLE, -BARB_ANGLE].map(|angle| {
            let (sin, cos) = angle.sin_cos();
            let turned = Vec2::new(cos * along.x - sin * along.y, sin * along.x + cos * along.y);
            tip - share * turned
        });
        self.line([barbs[0], tip, barbs[1]], stroke);
    }

    /// Draws an upright cross, its arms `arm` long.
    pub(crate) fn plus(&self, at: Pos2, arm: f32, stroke: Stroke) {
        let (right, down) = (Vec2::new(arm, 0.0), Vec2::new(0.0, arm));
        self.segment([at - right, at + right], stroke);
        self.segment([at - down, at + down], stroke);
    }

    /// Draws a diagonal cross within a square of half side `arm`.
    pub(crate) fn diagonal_cross(&self, at: Pos2, arm: f32, stroke: Stroke) {
        for diagonal in [Vec2::new(arm, arm), Vec2::new(arm, -arm)] {
            self.segment([at - diagonal, at + diagonal], stroke);
        }
    }

    /// Sets a text.
    pub(crate) fn layout(&self, text: String, font: FontId, colour: Color32) -> Arc<Galley> {
        self.painter.layout_no_wrap(text, font, colour)
    }

    /// Draws a text.
    pub(crate) fn text(
        &self,
        at: Pos2,
        anchor: Align2,
        text: impl ToString,
        font: FontId,
        colour: Color32,
    ) {
        self.painter().text(at, anchor, text, font, colour);
    }

    /// What was collected, for a library that draws shapes in an order of its own.
    pub(crate) fn take_shape(&self) -> Option<Shape> {
        let (_, mesh) = self.pending.take()?;
        Some(Shape::mesh(mesh))
    }

    fn with_mesh(&self, change: impl FnOnce(&mut Mesh)) {
        let mut pending = self.pending.borrow_mut();
        let (_, mesh) = pending.get_or_insert_with(|| {
            let place = self.painter.add(Shape::Noop);
            (place, Mesh::with_texture(self.texture))
        });
        change(mesh);
    }

    /// Hands over what was collected: later shapes lie above it.
    fn flush(&self) {
        if let Some((place, mesh)) = self.pending.take() {
            self.painter.set(place, Shape::mesh(mesh));
        }
    }
}

impl Drop for Pen {
    fn drop(&mut self) {
        self.flush();
    }
}

/// A line as a strip of quads: each place of it is a pair of vertices.
struct Strip<'a> {
    pen: &'a Pen,
    mesh: Mesh,
    colour: Color32,
    /// Half of the strip's width, soft edges included, points.
    half: f32,
    /// Height of the line's profile in the texture.
    v: f32,
    /// The place before the last one, and the last one.
    tail: Option<Pos2>,
    head: Option<Pos2>,
    /// Direction in which the strip arrives at the last place.
    arrival: Option<Vec2>,
}

impl<'a> Strip<'a> {
    fn new(pen: &'a Pen, stroke: Stroke) -> Self {
        let width = stroke.width / pen.pixel;
        Strip {
            pen,
            mesh: Mesh::with_texture(pen.texture),
            colour: stroke.color,
            half: texture::line_half_extent(width) * pen.pixel,
            v: texture::line_v(width),
            tail: None,
            head: None,
            arrival: None,
        }
    }

    fn push(&mut self, at: Pos2) {
        let Some(head) = self.head else {
            self.head = Some(at);
            return;
        };
        let along = (at - head).normalized();
        match self.arrival {
            None => self.pair(head, along.rot90()),
            Some(arrival) => self.corner(head, arrival, along),
        }
        (self.tail, self.head, self.arrival) = (Some(head), Some(at), Some(along));
    }

    /// A pair of vertices on either side of a place, which closes the quad from the pair before.
    fn pair(&mut self, at: Pos2, side: Vec2) {
        for (u, sign) in [(0.0, -1.0), (texture::LINE_U, 1.0)] {
            self.mesh.vertices.push(Vertex {
                pos: at + sign * self.half * side,
                uv: Pos2::new(u, self.v),
                color: self.colour,
            });
        }
    }

    /// Joins the quad before `at` and the one after it.
    fn corner(&mut self, at: Pos2, arrival: Vec2, along: Vec2) {
        let middle = (arrival + along).normalized();
        let cosine = middle.dot(along);
        if cosine > MITRE_COSINE_MIN {
            self.pair(at, middle.rot90() / cosine);
            self.quad(at);
        } else {
            // A sharp turn: both parts end square.
            self.pair(at, arrival.rot90());
            self.quad(at);
            self.pair(at, along.rot90());
        }
    }

    /// Fills between the last two pairs, if anything of it is in sight.
    fn quad(&mut self, at: Pos2) {
        let reach = self.tail.map_or(Rect::NOTHING, |tail| {
            Rect::from_two_pos(tail, at).expand(self.half)
        });
        if self.pen.clip_rect().intersects(reach) {
            let last = self.mesh.vertices.len() as u32;
            self.mesh.add_triangle(last - 4, last - 3, last - 2);
            self.mesh.add_triangle(last - 3, last - 2, last - 1);
        }
    }

    fn finish(mut self) -> Mesh {
        if let (Some(head), Some(arrival)) = (self.head, self.arrival) {
            self.pair(head, arrival.rot90());
            self.quad(head);
        }
        self.mesh
    }
}
