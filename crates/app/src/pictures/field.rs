//! Where was the robot, and where was it estimated? The field from above with paths, as a picture.

use localize::field::{Field, GoalColour, Marking};
use localize::frames::{At, FieldFrame};
use tiny_skia::{
    Color, FillRule, Paint, PathBuilder, Pixmap, PremultipliedColorU8, Rect, Stroke, Transform,
};

use vision::image::Image;

use super::text::glyph;

/// A field drawn from above, x to the right, y up.
pub(crate) struct FieldDrawing {
    pixmap: Pixmap,
    scale: f32,
    half_extent: (f32, f32),
}

/// Colours of what is drawn; distinguishable with any colour vision.
pub(crate) mod ink {
    use tiny_skia::Color;

    /// The floor around the carpet.
    pub(crate) fn surround() -> Color {
        Color::from_rgba8(58, 60, 64, 255)
    }
    /// The carpet.
    pub(crate) fn carpet() -> Color {
        Color::from_rgba8(38, 106, 64, 255)
    }
    /// Markings.
    pub(crate) fn line() -> Color {
        Color::from_rgba8(232, 236, 232, 255)
    }
    /// The true path.
    pub(crate) fn truth() -> Color {
        Color::from_rgba8(20, 22, 26, 255)
    }
    /// The estimated path while tracking.
    pub(crate) fn estimate() -> Color {
        Color::from_rgba8(255, 176, 0, 255)
    }
    /// Pose found by the global search.
    pub(crate) fn global() -> Color {
        Color::from_rgba8(80, 200, 255, 255)
    }
    /// The ball.
    pub(crate) fn ball() -> Color {
        Color::from_rgba8(255, 96, 32, 255)
    }
}

impl FieldDrawing {
    /// Draws the empty field to a width in pixels.
    pub(crate) fn new(field: &Field, width_px: u32) -> Option<Self> {
        let (half_x, half_y) = field.carpet_half_extent();
        // A margin of floor around the carpet, so that goals and robots outside it are visible.
        let half_extent = (half_x + 0.6, half_y + 0.6);
        let scale = width_px as f32 / (2.0 * half_extent.0);
        let height_px = (2.0 * half_extent.1 * scale).ceil() as u32;
        let mut picture = FieldDrawing {
            pixmap: Pixmap::new(width_px, height_px)?,
            scale,
            half_extent,
        };
        picture.pixmap.fill(ink::surround());
        picture.rectangle(-half_x, -half_y, half_x, half_y, ink::carpet());
        for marking in &field.markings {
            picture.marking(marking, field.config.line_width);
        }
        let sides = [1.0, -1.0].into_iter().filter(|_| field.has_goals());
        for (side, colour) in sides.zip(field.config.goal.colours) {
            picture.goal(field, side, colour);
        }
        Some(picture)
    }

    /// Joins points by a line of a width in pixels.
    pub(crate) fn path(
        &mut self,
        points: impl IntoIterator<Item = At<FieldFrame>>,
        colour: Color,
        width_px: f32,
    ) {
        let mut builder = PathBuilder::new();
        for point in points {
            let (x, y) = self.to_pixel(point.x, point.y);
            if builder.is_empty() {
                builder.move_to(x, y)
            } else {
                builder.line_to(x, y)
            }
        }
        self.stroke(builder, colour, width_px);
    }

    /// A filled dot of a radius in pixels.
    pub(crate) fn dot(&mut self, point: At<FieldFrame>, colour: Color, radius_px: f32) {
        let (x, y) = self.to_pixel(point.x, point.y);
        if let Some(path) = PathBuilder::from_circle(x, y, radius_px) {
            self.pixmap.fill_path(
                &path,
                &paint(colour),
                FillRule::Winding,
                Transform::identity(),
                None,
            );
        }
    }

    /// One line of text with its left top corner at pixels.
    pub(crate) fn text(&mut self, left_px: u32, top_px: u32, text: &str, colour: Color) {
        let pixel = colour.premultiply().to_color_u8();
        let (width, height) = (self.pixmap.width(), self.pixmap.height());
        for (index, letter) in text.chars().enumerate() {
            let Some(rows) = glyph(letter) else { continue };
            for (row, bits) in rows.into_iter().enumerate() {
                for column in (0..8).filter(|column| bits >> column & 1 == 1) {
                    let x = left_px + 8 * index as u32 + column;
                    // Each font row is drawn twice: 8 × 16 letters read better than 8 × 8.
                    for y in [top_px + 2 * row as u32, top_px + 2 * row as u32 + 1] {
                        if x < width && y < height {
                            self.pixmap.pixels_mut()[(y * width + x) as usize] = pixel;
                        }
                    }
                }
            }
        }
    }

    /// The finished picture.
    pub(crate) fn finish(self) -> Image {
        let (width_px, height_px) = (self.pixmap.width() as usize, self.pixmap.height() as usize);
        let rgb = self
            .pixmap
            .pixels()
            .iter()
            .flat_map(|pixel: &PremultipliedColorU8| [pixel.red(), pixel.green(), pixel.blue()])
            .collect();
        Image {
            width_px,
            height_px,
            rgb,
        }
    }

    fn to_pixel(&self, x: f32, y: f32) -> (f32, f32) {
        (
            (x + self.half_extent.0) * self.scale,
            (self.half_extent.1 - y) * self.scale,
        )
    }

    fn rectangle(&mut self, x0: f32, y0: f32, x1: f32, y1: f32, colour: Color) {
        let ((left, bottom), (right, top)) = (self.to_pixel(x0, y0), self.to_pixel(x1, y1));
        if let Some(rect) = Rect::from_ltrb(left, top, right, bottom) {
            self.pixmap
                .fill_rect(rect, &paint(colour), Transform::identity(), None);
        }
    }

    fn stroke(&mut self, builder: PathBuilder, colour: Color, width_px: f32) {
        let stroke = Stroke {
            width: width_px,
            ..Stroke::default()
        };
        if let Some(path) = builder.finish() {
            self.pixmap
                .stroke_path(&path, &paint(colour), &stroke, Transform::identity(), None);
        }
    }

    fn marking(&mut self, marking: &Marking, line_width: f32) {
        let width_px = (line_width * self.scale).max(1.0);
        match *marking {
            Marking::Line { from, to } => self.path([from, to], ink::line(), width_px),
            Marking::Arc {
                centre,
                radius,
                start,
                sweep,
            } => {
                let steps = 48;
                let points = (0..=steps).map(|step| {
                    let angle = start + sweep * step as f32 / steps as f32;
                    At::new(
                        centre.x + radius * angle.cos(),
                        centre.y + radius * angle.sin(),
                    )
                });
                self.path(points, ink::line(), width_px);
            }
            Marking::Spot { centre, radius } => {
                self.dot(centre, ink::line(), (radius * self.scale).max(1.0))
            }
        }
    }

    fn goal(&mut self, field: &Field, side: f32, colour: GoalColour) {
        let (front, half) = (
            side * field.config.length / 2.0,
            field.config.goal.width / 2.0,
        );
        let back = front + side * field.config.goal.depth;
        let colour = match colour {
            GoalColour::White => ink::line(),
            GoalColour::Blue => Color::from_rgba8(70, 110, 230, 255),
            GoalColour::Yellow => Color::from_rgba8(240, 220, 60, 255),
        };
        let corners = [(front, half), (back, half), (back, -half), (front, -half)];
        self.path(
            corners.map(|(x, y)| At::new(x, y)),
            colour,
            (field.config.goal.post * self.scale).max(2.0),
        );
    }
}

fn paint(colour: Color) -> Paint<'static> {
    let mut paint = Paint {
        anti_alias: true,
        ..Paint::default()
    };
    paint.set_color(colour);
    paint
}

/// Two pictures side by side, the smaller one centred vertically on black.
pub(crate) fn side_by_side(left: &Image, right: &Image) -> Image {
    let width_px = left.width_px + right.width_px;
    let height_px = left.height_px.max(right.height_px);
    let mut rgb = vec![0; 3 * width_px * height_px];
    for (picture, column) in [(left, 0), (right, left.width_px)] {
        let top = (height_px - picture.height_px) / 2;
        for row in 0..picture.height_px {
            let from = 3 * row * picture.width_px;
            let to = 3 * ((top + row) * width_px + column);
            rgb[to..to + 3 * picture.width_px]
                .copy_from_slice(&picture.rgb[from..from + 3 * picture.width_px]);
        }
    }
    Image {
        width_px,
        height_px,
        rgb,
    }
}
