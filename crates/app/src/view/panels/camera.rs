//! What does the robot see, and what does it make of it? The image with everything that was found or refused in it.

use std::sync::Arc;

use eframe::egui::{
    self, Align2, Color32, ColorImage, FontId, Pos2, Rect, RichText, Sense, TextureHandle,
    TextureOptions, Ui, Vec2,
};
use localize::Stamp;
use serde::{Deserialize, Serialize};
use vision::colours::{CLASS_NAMES, ColourClass};
use vision::image::{Image, rgb_to_yuv};

use super::camera_marks::{self, Drawing};
use crate::view::brush::{Brush, Tool};
use crate::view::ink;
use crate::view::layers::{BIRD_REACH, BIRD_SIDE, Wanted};
use crate::view::panzoom::{PanZoom, Placed, paint_around};
use crate::view::session::Session;
use crate::view::source::image_of;
use crate::view::stage::Stage;
use pipeline::cycle::Cycle;

/// What is drawn over the image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct Shows {
    /// The image itself.
    pub(crate) image: bool,
    /// The class of every pixel.
    pub(crate) classes: bool,
    /// The pixels that vision reads, in their classes' colours.
    pub(crate) scan: bool,
    /// Line points.
    pub(crate) points: bool,
    /// Runs that were refused.
    pub(crate) refused: bool,
    /// The ball.
    pub(crate) ball: bool,
    /// Robots.
    pub(crate) robots: bool,
    /// Goals and posts.
    pub(crate) goals: bool,
    /// Where the carpet ends.
    pub(crate) carpet_end: bool,
    /// Virtual sensor windows.
    pub(crate) windows: bool,
    /// What is masked, and what shows no ground.
    pub(crate) mask: bool,
    /// The field's lines at the estimated pose.
    pub(crate) lines: bool,
    /// Rings and rays on the ground.
    pub(crate) grid: bool,
}

impl Default for Shows {
    fn default() -> Self {
        Shows {
            image: true,
            classes: false,
            scan: false,
            points: true,
            refused: true,
            ball: true,
            robots: true,
            goals: true,
            carpet_end: false,
            windows: false,
            mask: false,
            lines: true,
            grid: false,
        }
    }
}

/// The panel's memory.
#[derive(Default)]
pub(crate) struct Camera {
    /// What is drawn.
    pub(crate) shows: Shows,
    /// The floor from above in place of the camera's image.
    pub(crate) bird: bool,
    view: PanZoom,
    image: Option<(Stamp, TextureHandle)>,
    classes: Texture,
    scan: Texture,
    floor: Texture,
    mask: Texture,
    /// The mask as a picture, and what it was made of.
    masked: Option<(MaskKey, Arc<ColorImage>)>,
}

type MaskKey = (u64, Option<*const Stage>);

/// A painted layer on its way to the screen.
#[derive(Default)]
struct Texture {
    of: Option<Arc<ColorImage>>,
    handle: Option<TextureHandle>,
}

impl Texture {
    fn set(&mut self, ui: &Ui, name: &str, image: &Arc<ColorImage>) -> egui::TextureId {
        let known = self.of.as_ref().is_some_and(|of| Arc::ptr_eq(of, image));
        let handle = self
            .handle
            .get_or_insert_with(|| ui.load_texture(name, image.clone(), TextureOptions::NEAREST));
        if !known {
            handle.set(image.clone(), TextureOptions::NEAREST);
            self.of = Some(image.clone());
        }
        handle.id()
    }
}

impl Camera {
    /// Which layers are to be painted.
    pub(crate) fn wanted(&self) -> Wanted {
        Wanted {
            classes: self.shows.classes && !self.bird,
            windows: self.shows.windows && !self.bird,
            scan: self.shows.scan && !self.bird,
            bird: self.bird,
            ..Wanted::default()
        }
    }

    /// Draws the panel.
    pub(crate) fn show(&mut self, ui: &mut Ui, session: &Session, brush: &mut Brush) {
        self.switches(ui);
        let Some(now) = &session.now else {
            ui.weak("No cycle yet.");
            return;
        };
        // A picture and what is painted of it are of one cycle, though the painter may be a little behind.
        let painted = session.painted.cycle.as_ref();
        let painted = painted.filter(|_| self.wanted() != Wanted::default());
        let cycle = painted.unwrap_or(&now.cycle);
        let image = image_of(cycle).cloned();
        let size = match (&image, &session.stage) {
            _ if self.bird => Vec2::splat(BIRD_SIDE as f32),
            (Some(image), _) => Vec2::new(image.width_px as f32, image.height_px as f32),
            (None, Some(stage)) => match &stage.eye {
                Some(eye) => Vec2::new(eye.map.width_px as f32, eye.map.height_px as f32),
                None => {
                    ui.weak("This source has no camera: its line points come from elsewhere.");
                    return;
                }
            },
            (None, None) => {
                ui.weak("No image, and no camera to draw into.");
                return;
            }
        };
        let line = ui.text_style_height(&egui::TextStyle::Body) + 6.0;
        let area = Vec2::new(
            ui.available_width().max(1.0),
            (ui.available_height() - line).max(1.0),
        );
        let (response, painter) = ui.allocate_painter(area, Sense::click_and_drag());
        let painting = brush.tool != Tool::None && !self.bird;
        let placed = self.view.follow(ui, &response, size, !painting);
        let painter = painter.with_clip_rect(response.rect);
        let covered = if image.is_some() && self.shows.image && !self.bird {
            placed.rect(size)
        } else {
            Rect::NOTHING
        };
        paint_around(&painter, response.rect, covered, Color32::BLACK);
        self.pixels(ui, &painter, session, cycle, (&placed, size));
        if let Some(stage) = &session.stage {
            let drawing = Drawing {
                painter: &painter,
                placed,
                stage,
                cycle,
                shows: &self.shows,
                windows: session
                    .painted
                    .windows
                    .as_deref()
                    .map_or(&[], Vec::as_slice),
            };
            if self.bird {
                camera_marks::draw_bird(&drawing);
            } else {
                camera_marks::draw(&drawing);
            }
        }
        if image.is_none() {
            painter.text(
                response.rect.center_top() + Vec2::new(0.0, 8.0),
                Align2::CENTER_TOP,
                no_image(cycle),
                FontId::proportional(15.0),
                Color32::WHITE,
            );
        }
        if painting
            && (response.dragged() || response.clicked())
            && let (Some(pointer), Some(image)) = (response.interact_pointer_pos(), &image)
        {
            brush.paint(cycle.stamp, image, placed.to_picture(pointer));
        }
        if let Some(pointer) = response.hover_pos() {
            if painting {
                let radius = (f32::from(brush.radius_px) + 0.5) * placed.scale;
                painter.circle_stroke(pointer, radius, (1.0, Color32::WHITE));
            }
            self.probe(ui, session, image.as_deref(), placed.to_picture(pointer));
        } else {
            ui.weak(
                "Point at a pixel to read it. Scroll zooms, drag pans, double-click shows all.",
            );
        }
    }

    fn switches(&mut self, ui: &mut Ui) {
        let shows = &mut self.shows;
        ui.horizontal_wrapped(|ui| {
            ui.menu_button("Layers", |ui| {
                for (name, shown) in [
                    ("Image", &mut shows.image),
                    ("Classes", &mut shows.classes),
                    ("Scan lines", &mut shows.scan),
                    ("Line points", &mut shows.points),
                    ("Refused points", &mut shows.refused),
                    ("Ball", &mut shows.ball),
                    ("Robots", &mut shows.robots),
                    ("Goals", &mut shows.goals),
                    ("Carpet's end", &mut shows.carpet_end),
                    ("Windows", &mut shows.windows),
                    ("Mask", &mut shows.mask),
                    ("Field lines", &mut shows.lines),
                    ("Ground grid", &mut shows.grid),
                ] {
                    ui.checkbox(shown, name);
                }
            });
            ui.toggle_value(&mut self.bird, "Bird's-eye");
            ui.toggle_value(&mut shows.classes, "Classes");
            ui.toggle_value(&mut shows.scan, "Scan lines");
            ui.toggle_value(&mut shows.windows, "Windows");
            ui.toggle_value(&mut shows.lines, "Field lines");
            ui.menu_button("Key", camera_marks::key);
        });
    }

    fn pixels(
        &mut self,
        ui: &Ui,
        painter: &egui::Painter,
        session: &Session,
        cycle: &Cycle,
        (placed, size): (&Placed, Vec2),
    ) {
        let rect = placed.rect(size);
        let uv = Rect::from_min_max(Pos2::ZERO, Pos2::new(1.0, 1.0));
        let painted = &session.painted;
        if self.bird {
            if let Some(floor) = &painted.bird {
                let id = self.floor.set(ui, "floor", floor);
                painter.image(id, rect, uv, Color32::WHITE);
            }
            return;
        }
        if let (true, Some(image)) = (self.shows.image, image_of(cycle)) {
            let id = self.upload(ui, cycle.stamp, image);
            painter.image(id, rect, uv, Color32::WHITE);
        }
        if let (true, Some(classes)) = (self.shows.classes, &painted.classes) {
            let id = self.classes.set(ui, "classes", classes);
            let tint = if self.shows.image { 190 } else { 255 };
            painter.image(id, rect, uv, Color32::from_white_alpha(tint));
        }
        if let (true, Some(scan)) = (self.shows.scan, &painted.scan) {
            let id = self.scan.set(ui, "scan", scan);
            painter.image(id, rect, uv, Color32::WHITE);
        }
        if self.shows.mask {
            let key = (session.version, session.stage.as_ref().map(Arc::as_ptr));
            if self.masked.as_ref().is_none_or(|(of, _)| *of != key) {
                let mask = mask_image(session).map(Arc::new);
                self.masked = mask.map(|mask| (key, mask));
            }
            if let Some((_, mask)) = &self.masked {
                let id = self.mask.set(ui, "mask", mask);
                painter.image(id, rect, uv, Color32::WHITE);
            }
        }
    }

    fn upload(&mut self, ui: &Ui, stamp: Stamp, image: &Image) -> egui::TextureId {
        if let Some((of, handle)) = &mut self.image {
            if *of != stamp {
                handle.set(colours(image), TextureOptions::NEAREST);
                *of = stamp;
            }
            return handle.id();
        }
        let handle = ui.load_texture("camera", colours(image), TextureOptions::NEAREST);
        let id = handle.id();
        self.image = Some((stamp, handle));
        id
    }

    /// What is there: colour, class, ground.
    fn probe(&self, ui: &mut Ui, session: &Session, image: Option<&Image>, at: Vec2) {
        let (Some(stage), Some(now)) = (&session.stage, &session.now) else {
            return;
        };
        let mut words = Vec::new();
        let ground = if self.bird {
            let step = 2.0 * BIRD_REACH / BIRD_SIDE as f32;
            Some(localize::At::new(
                BIRD_REACH - at.y * step,
                BIRD_REACH - at.x * step,
            ))
        } else {
            let (column, row) = (at.x.floor(), at.y.floor());
            let inside = column >= 0.0 && row >= 0.0;
            if let Some(image) = image.filter(|_| inside)
                && (column as usize) < image.width_px
                && (row as usize) < image.height_px
            {
                let (u, v) = (column as usize, row as usize);
                let rgb = image.view().rgb(u, v);
                let [y, cb, cr] = rgb_to_yuv(rgb);
                words.push(format!("({u}, {v})  YUV {y} {cb} {cr}  RGB {rgb:?}"));
                if let Some(class) = self.class_at(session, u, v) {
                    words.push(class.to_owned());
                }
            }
            let eye = stage.eye.as_ref();
            eye.and_then(|eye| inside.then(|| eye.map.at(column as usize, row as usize))?)
        };
        match ground {
            Some(ground) => {
                words.push(format!(
                    "ground {:.2}, {:.2} m, {:.2} m away at {:.0}°",
                    ground.x,
                    ground.y,
                    ground.distance(),
                    ground.bearing().to_degrees()
                ));
                if let Some(pose) = now.cycle.estimate.pose {
                    let at = pose * ground;
                    words.push(format!("field {:.2}, {:.2} m", at.x, at.y));
                }
            }
            None => words.push("no ground".to_owned()),
        }
        ui.label(RichText::new(words.join("   ")).monospace());
    }

    fn class_at(&self, session: &Session, u: usize, v: usize) -> Option<&'static str> {
        let painted = session.painted.classes.as_ref()?;
        let colour = *painted.pixels.get(v * painted.size[0] + u)?;
        let found = (0..CLASS_NAMES.len()).find(|&c| ink::class(ColourClass(c as u8)) == colour);
        found.map(|class| CLASS_NAMES[class])
    }
}

fn colours(image: &Image) -> ColorImage {
    ColorImage::from_rgb([image.width_px, image.height_px], &image.rgb)
}

fn no_image(cycle: &Cycle) -> String {
    match &cycle.fault {
        Some(fault) => format!("no image: {fault}"),
        None => "no image in this cycle".to_owned(),
    }
}

/// What is masked (crossed out in purple) and what shows no ground (darkened).
fn mask_image(session: &Session) -> Option<ColorImage> {
    let stage = session.stage.as_ref()?;
    let eye = stage.eye.as_ref()?;
    let (width, height) = (eye.map.width_px, eye.map.height_px);
    let mask = session.mask.as_ref().or(stage.mask.as_ref());
    let pixel = |at: usize| {
        let masked = mask.is_some_and(|mask| mask.get(at) == Some(&false));
        if masked {
            Color32::from_rgba_unmultiplied(204, 121, 167, 170)
        } else if !eye.map.x[at].is_finite() {
            Color32::from_black_alpha(150)
        } else {
            Color32::TRANSPARENT
        }
    };
    Some(ColorImage::new(
        [width, height],
        (0..width * height).map(pixel).collect(),
    ))
}
