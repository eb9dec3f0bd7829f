//! Painting on the camera image: colour class labels, or the mask of the robot's own parts.

use std::collections::BTreeMap;
use std::sync::Arc;

use eframe::egui;
use localize::Stamp;
use vision::colour::colour_table::{ColourTable, Label, TableKind};
use vision::image::Image;

/// What the brush paints.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) enum Tool {
    /// Nothing; dragging pans the image.
    #[default]
    Pan,
    /// Labels of this class, an index into [`vision::colour::lookup_table::CLASS_NAMES`].
    Class(usize),
    /// The mask: the robot's own parts.
    Mask,
    /// Erases the mask.
    EraseMask,
}

/// A labelled pixel.
#[derive(Debug, Clone)]
pub(crate) struct PixelLabel {
    /// Index into [`vision::colour::lookup_table::CLASS_NAMES`].
    pub(crate) class: usize,
    /// RGB value of the pixel.
    pub(crate) rgb: [u8; 3],
}

/// The brush, its labels and its mask.
#[derive(Debug, Clone)]
pub(crate) struct Brush {
    /// Selected tool.
    pub(crate) tool: Tool,
    /// Radius, pixels.
    pub(crate) radius_px: u16,
    /// Labels by image stamp, column and row.
    pub(crate) labels: BTreeMap<(Stamp, [u16; 2]), PixelLabel>,
    /// Images that contain labels.
    pub(crate) labelled_images: Vec<(Stamp, Arc<Image>)>,
    /// One entry per pixel; false where the robot sees itself.
    pub(crate) mask: Option<Vec<bool>>,
    /// Labels or mask changed since the session last took them over.
    pub(crate) dirty: bool,
    /// A stroke is being painted.
    pub(crate) painting: bool,
}

impl Default for Brush {
    fn default() -> Self {
        Brush {
            tool: Tool::default(),
            radius_px: 3,
            labels: BTreeMap::new(),
            labelled_images: Vec::new(),
            mask: None,
            dirty: false,
            painting: false,
        }
    }
}

impl Brush {
    /// Paints a disc around a pixel of the image.
    pub(crate) fn paint(&mut self, stamp: Stamp, image: &Arc<Image>, at: egui::Vec2) {
        let (width, height) = (image.width_px as i32, image.height_px as i32);
        let radius = i32::from(self.radius_px);
        let (column, row) = (at.x.floor() as i32, at.y.floor() as i32);
        for v in (row - radius).max(0)..(row + radius + 1).min(height) {
            for u in (column - radius).max(0)..(column + radius + 1).min(width) {
                if (u - column).pow(2) + (v - row).pow(2) <= radius * radius {
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
                let key = (stamp, [u as u16, v as u16]);
                self.labels.insert(key, PixelLabel { class, rgb });
                if self
                    .labelled_images
                    .iter()
                    .all(|(labelled, _)| *labelled != stamp)
                {
                    self.labelled_images.push((stamp, image.clone()));
                }
            }
        }
    }

    /// Deletes all labels.
    pub(crate) fn clear_labels(&mut self) {
        self.labels.clear();
        self.labelled_images.clear();
        self.dirty = true;
    }

    /// The colour table learned from the labels; None without labels.
    pub(crate) fn learn_colour_table(&self) -> Option<ColourTable> {
        let to_label = |label: &PixelLabel| Label {
            rgb: label.rgb,
            class: vision::colour::lookup_table::CLASS_NAMES[label.class].to_owned(),
        };
        let labels: Vec<Label> = self.labels.values().map(to_label).collect();
        ColourTable::learn(&labels, TableKind::Yuv)
    }
}
