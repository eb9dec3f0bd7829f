//! Layouts as files: which panels are open where, and what they show. For `--layout FILE` and for colleagues.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use egui_tiles::Tree;
use localize::input_file;
use serde::{Deserialize, Serialize};
use vision::output_file::write_file;

use super::layout::{PanelLayout, open_panels};
use super::panels::camera_layers::CameraLayers;
use super::panels::field_layers::FieldLayers;
use super::panels::plots::PlotsPanel;
use super::panels::{PanelId, Panels};

/// Version of the file; others are refused.
const FORMAT: u32 = 1;

/// Open panels and what they show. The view's own memory and layout files hold the same.
#[derive(Clone, Serialize, Deserialize)]
pub(crate) struct SavedLayout {
    format: u32,
    layout: PanelLayout,
    tree: Tree<PanelId>,
    /// Of the first panels, and of their copies by number.
    panels: BTreeMap<u32, SavedPanels>,
}

#[derive(Clone, Default, Serialize, Deserialize)]
#[serde(default)]
struct SavedPanels {
    camera: CameraLayers,
    birds_eye: bool,
    field: FieldLayers,
    plots: PlotsPanel,
}

impl SavedLayout {
    /// The layout as it is now.
    pub(crate) fn of(layout: PanelLayout, tree: &Tree<PanelId>, panels: &Panels) -> Self {
        let saved = |panels: &Panels| SavedPanels {
            camera: panels.camera.layers,
            birds_eye: panels.camera.birds_eye,
            field: panels.field.layers,
            plots: panels.plots.clone(),
        };
        let copies = panels.copies.iter();
        let copies = copies.map(|(copy, panels)| (*copy, saved(panels)));
        SavedLayout {
            format: FORMAT,
            layout,
            tree: tree.clone(),
            panels: std::iter::once((0, saved(panels))).chain(copies).collect(),
        }
    }

    /// Shows what the panels showed, and returns the tiles.
    pub(crate) fn restore(self, panels: &mut Panels) -> (PanelLayout, Tree<PanelId>) {
        for (copy, saved) in self.panels {
            let panels = panels.of_copy(copy);
            panels.camera.layers = saved.camera;
            panels.camera.birds_eye = saved.birds_eye;
            panels.field.layers = saved.field;
            panels.plots = saved.plots;
        }
        (self.layout, self.tree)
    }

    /// Reads a layout file.
    pub(crate) fn load(path: &Path) -> Result<Self> {
        let text = input_file::read_text(path)
            .with_context(|| format!("cannot read {}", path.display()))?;
        let saved: SavedLayout = serde_json::from_str(&text)
            .with_context(|| format!("{}: not a layout of this version", path.display()))?;
        ensure!(
            saved.format == FORMAT,
            "{}: unknown format: {} (expected {FORMAT})",
            path.display(),
            saved.format
        );
        ensure!(
            !open_panels(&saved.tree).is_empty(),
            "{}: the layout has no panel",
            path.display()
        );
        Ok(saved)
    }

    /// Writes a layout file.
    pub(crate) fn save(&self, path: &Path) -> Result<()> {
        let text = serde_json::to_string_pretty(self).context("cannot encode the layout")?;
        write_file(path, text).with_context(|| format!("cannot write {}", path.display()))
    }
}
