//! Which panels stand where? Arrangements for the usual tasks, as starting points: every tile can be dragged and closed.

use eframe::egui;
use egui_tiles::{Linear, LinearDir, Tile, TileId, Tiles, Tree};
use serde::{Deserialize, Serialize};

use super::panels::Pane;

/// The tree's name; what is remembered of dragging goes by it.
const TREE_ID: &str = "panels";

/// An arrangement.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) enum PanelLayout {
    /// Beside the field: camera, field, how it goes.
    Watch,
    /// The camera large, with its settings.
    Vision,
    /// The field large, with errors.
    Localization,
    /// A simulation and what is done to it.
    Simulate,
    /// Colours, mask, map.
    Calibrate,
    /// Every device.
    Health,
}

/// All of them, with their names and their keys.
pub(crate) const LAYOUTS: [(PanelLayout, &str); 6] = [
    (PanelLayout::Watch, "Watch"),
    (PanelLayout::Vision, "Eyes"),
    (PanelLayout::Localization, "Place"),
    (PanelLayout::Simulate, "Simulate"),
    (PanelLayout::Calibrate, "Calibrate"),
    (PanelLayout::Health, "Health"),
];

/// The tiles of an arrangement.
pub(crate) fn build_tree(preset: PanelLayout) -> Tree<Pane> {
    let mut tiles = Tiles::default();
    let mut tabs = |panes: &[Pane]| {
        let panes = panes.iter().map(|pane| tiles.insert_pane(*pane)).collect();
        tiles.insert_tab_tile(panes)
    };
    let root = match preset {
        PanelLayout::Watch => {
            let (camera, field) = (tabs(&[Pane::Camera]), tabs(&[Pane::Field]));
            let (plots, time) = (tabs(&[Pane::Plots, Pane::Health]), tabs(&[Pane::Timeline]));
            let above = split(&mut tiles, LinearDir::Horizontal, [camera, field], 0.42);
            let below = split(&mut tiles, LinearDir::Horizontal, [time, plots], 0.42);
            split(&mut tiles, LinearDir::Vertical, [above, below], 0.66)
        }
        PanelLayout::Vision => {
            let (camera, time) = (tabs(&[Pane::Camera]), tabs(&[Pane::Timeline]));
            let side = tabs(&[Pane::Parameters, Pane::Calibration, Pane::Field]);
            let left = split(&mut tiles, LinearDir::Vertical, [camera, time], 0.8);
            split(&mut tiles, LinearDir::Horizontal, [left, side], 0.55)
        }
        PanelLayout::Localization => {
            let (field, time) = (tabs(&[Pane::Field]), tabs(&[Pane::Timeline]));
            let side = tabs(&[Pane::Plots, Pane::Parameters]);
            let camera = tabs(&[Pane::Camera]);
            let left = split(&mut tiles, LinearDir::Vertical, [field, time], 0.78);
            let right = split(&mut tiles, LinearDir::Vertical, [side, camera], 0.6);
            split(&mut tiles, LinearDir::Horizontal, [left, right], 0.6)
        }
        PanelLayout::Simulate => {
            let (field, camera) = (tabs(&[Pane::Field]), tabs(&[Pane::Camera]));
            let controls = tabs(&[Pane::Simulator, Pane::Parameters]);
            let time = tabs(&[Pane::Timeline, Pane::Plots]);
            let left = split(&mut tiles, LinearDir::Vertical, [field, time], 0.75);
            let right = split(&mut tiles, LinearDir::Vertical, [controls, camera], 0.5);
            split(&mut tiles, LinearDir::Horizontal, [left, right], 0.62)
        }
        PanelLayout::Calibrate => {
            let (camera, time) = (tabs(&[Pane::Camera]), tabs(&[Pane::Timeline]));
            let side = tabs(&[Pane::Calibration, Pane::Parameters]);
            let left = split(&mut tiles, LinearDir::Vertical, [camera, time], 0.82);
            split(&mut tiles, LinearDir::Horizontal, [left, side], 0.58)
        }
        PanelLayout::Health => {
            let (health, plots) = (tabs(&[Pane::Health]), tabs(&[Pane::Plots]));
            let (time, camera) = (tabs(&[Pane::Timeline]), tabs(&[Pane::Camera, Pane::Field]));
            let left = split(&mut tiles, LinearDir::Vertical, [health, time], 0.6);
            let right = split(&mut tiles, LinearDir::Vertical, [plots, camera], 0.6);
            split(&mut tiles, LinearDir::Horizontal, [left, right], 0.55)
        }
    };
    Tree::new(egui::Id::unique(TREE_ID), root, tiles)
}

fn split(tiles: &mut Tiles<Pane>, way: LinearDir, children: [TileId; 2], share: f32) -> TileId {
    tiles.insert_container(Linear::new_binary(way, children, share))
}

/// True if the panel is somewhere in the tree.
pub(crate) fn contains_pane(tree: &Tree<Pane>, pane: Pane) -> bool {
    tree.tiles.find_pane(&pane).is_some()
}

/// Opens a panel beside all others, or closes it.
pub(crate) fn toggle_pane(tree: &mut Tree<Pane>, pane: Pane) {
    if let Some(tile) = tree.tiles.find_pane(&pane) {
        tree.remove_recursively(tile);
        return;
    }
    let tile = tree.tiles.insert_pane(pane);
    let root = tree.root();
    let Some(root) = root else {
        let tabs = tree.tiles.insert_tab_tile(vec![tile]);
        *tree = Tree::new(
            egui::Id::unique(TREE_ID),
            tabs,
            std::mem::take(&mut tree.tiles),
        );
        return;
    };
    if let Some(Tile::Container(egui_tiles::Container::Linear(linear))) = tree.tiles.get_mut(root) {
        linear.add_child(tile);
    } else {
        let beside = tree.tiles.insert_horizontal_tile(vec![root, tile]);
        *tree = Tree::new(
            egui::Id::unique(TREE_ID),
            beside,
            std::mem::take(&mut tree.tiles),
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::view::panels::PANES;

    #[test]
    fn every_pane_is_in_a_layout_and_can_be_closed_and_reopened() {
        for pane in PANES {
            let home = LAYOUTS
                .iter()
                .find(|(preset, _)| contains_pane(&build_tree(*preset), pane));
            let (preset, _) = home.expect("an arrangement with it");
            let mut tree = build_tree(*preset);
            toggle_pane(&mut tree, pane);
            assert!(!contains_pane(&tree, pane), "{pane:?} is closed");
            toggle_pane(&mut tree, pane);
            assert!(contains_pane(&tree, pane), "{pane:?} is open");
        }
    }
}
