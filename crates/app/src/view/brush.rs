//! What does the pointer paint on the camera's image? Labels of colour classes, or what of the robot itself is in view.

use std::collections::BTreeMap;
use std::sync::Arc;

use eframe::egui;
use localize::Stamp;
use vision::colour::colour_table::{ColourTable, Label, TableKind};
use vision::image::Image;

/// What a stroke paints.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) enum Tool {
    /// Nothing: dragging pans.
    #[default]
    Pan,
    /// Labels of this class, by its place in [`vision::colour::lookup_table::CLASS_NAMES`].
    Class(usize),
    /// The mask: the robot's own parts.
    Mask,
    /// Away with the mask.
    EraseMask,
}

/// A labelled pixel.
#[derive(Debug, Clone)]
pub(crate) struct PixelLabel {
    /// By its place in [`vision::colour::lookup_table::CLASS_NAMES`].
    pub(crate) class: usize,
    /// Red, green, blue there.
    pub(crate) rgb: [u8; 3],
}

/// The brush, and what it has painted.
#[derive(Debug, Clone, Default)]
pub(crate) struct Brush {
    /// What it paints.
    pub(crate) tool: Tool,
    /// Half its width, pixels.
    pub(crate) radius_px: u16,
    /// Labels by their image, column and row.
    pub(crate) labels: BTreeMap<(Stamp, [u16; 2]), PixelLabel>,
    /// The images they are in.
    pub(crate) labelled_images: Vec<(Stamp, Arc<Image>)>,
    /// One entry a pixel; false where the robot sees itself.
    pub(crate) mask: Option<Vec<bool>>,
    /// Something was painted since the table was learned.
    pub(crate) dirty: bool,
}

impl Brush {
    /// A brush with which nothing was painted.
    pub(crate) fn new() -> Self {
        Brush {
            radius_px: 3,
            ..Brush::default()
        }
    }

    /// Paints around a pixel of an image.
    pub(crate) fn paint(&mut self, stamp: Stamp, image: &Arc<Image>, at: egui::Vec2) {
        let (width, height) = (image.width_px as i32, image.height_px as i32);
        let reach = i32::from(self.radius_px);
        let (column, row) = (at.x.floor() as i32, at.y.floor() as i32);
        for v in (row - reach).max(0)..(row + reach + 1).min(height) {
            for u in (column - reach).max(0)..(column + reach + 1).min(width) {
                if (u - column).pow(2) + (v - row).pow(2) <= reach * reach {
                    self.paint_pixel(stamp, image, u as usize, v as usize);
                }
            }
        }
        self.dirty = true;
    }

    fn paint_pixel(&mut self, stamp: Stamp, image: &Arc<Image>, u: usize, v: usize) {
        let at = v * image.width_px + u;
        match self.tool {
            Tool::Pan => {}
            Tool::Mask | Tool::EraseMask => {
                let size = image.width_px * image.height_px;
                let mask = self.mask.get_or_insert_with(|| vec![true; size]);
                if let Some(pixel) = mask.get_mut(at) {
                    *pixel = self.tool == Tool::EraseMask;
                }
            }
            Tool::Class(class) => {
                let rgb = &image.rgb[3 * at..3 * at + 3];
                let rgb = [rgb[0], rgb[1], rgb[2]];
                let place = (stamp, [u as u16, v as u16]);
                self.labels.insert(place, PixelLabel { class, rgb });
                if self
                    .labelled_images
                    .iter()
                    .all(|(known, _)| *known != stamp)
                {
                    self.labelled_images.push((stamp, image.clone()));
                }
            }
        }
    }

    /// Forgets the labels.
    pub(crate) fn clear_labels(&mut self) {
        self.labels.clear();
        self.labelled_images.clear();
        self.dirty = true;
    }

    /// The table that the labels make; none without labels.
    pub(crate) fn learn_colour_table(&self) -> Option<ColourTable> {
        let label = |stroke: &PixelLabel| Label {
            rgb: stroke.rgb,
            class: vision::colour::lookup_table::CLASS_NAMES[stroke.class].to_owned(),
        };
        let labels: Vec<Label> = self.labels.values().map(label).collect();
        ColourTable::learn(&labels, TableKind::Yuv)
    }
}
