//! Panel layouts for the usual tasks. They are starting points: every tile can be dragged and closed.

use eframe::egui;
use egui_tiles::{Linear, LinearDir, Tile, TileId, Tiles, Tree};
use serde::{Deserialize, Serialize};

use super::panels::{Pane, PanelId};

/// Id of the tile tree; egui stores drag state under it.
const TREE_ID: &str = "panels";

/// A panel layout.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) enum PanelLayout {
    /// Overview: camera, field, timeline and plots.
    Watch,
    /// Large camera image with the vision settings.
    Vision,
    /// Large field with localization errors.
    Localization,
    /// Simulation and its disturbances.
    Simulate,
    /// Colours, mask and ground map.
    Calibrate,
    /// State of every device.
    Health,
}

/// All layouts with their names, in the order of their number keys.
pub(crate) const LAYOUTS: [(PanelLayout, &str); 6] = [
    (PanelLayout::Watch, "Watch"),
    (PanelLayout::Vision, "Eyes"),
    (PanelLayout::Localization, "Place"),
    (PanelLayout::Simulate, "Simulate"),
    (PanelLayout::Calibrate, "Calibrate"),
    (PanelLayout::Health, "Health"),
];

/// Builds the tile tree of a layout.
pub(crate) fn build_tree(layout: PanelLayout) -> Tree<PanelId> {
    let mut tiles = Tiles::default();
    let mut tabs = |panes: &[Pane]| {
        let panes = panes
            .iter()
            .map(|pane| tiles.insert_pane(PanelId::from(*pane)))
            .collect();
        tiles.insert_tab_tile(panes)
    };
    let root = match layout {
        PanelLayout::Watch => {
            let (camera, field) = (tabs(&[Pane::Camera]), tabs(&[Pane::Field]));
            let (plots, time) = (
                tabs(&[Pane::Plots, Pane::Findings, Pane::Details, Pane::Health]),
                tabs(&[Pane::Timeline]),
            );
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
            let (field, time) = (tabs(&[Pane::Field, Pane::Scene]), tabs(&[Pane::Timeline]));
            let side = tabs(&[Pane::Plots, Pane::Findings, Pane::Details, Pane::Parameters]);
            let camera = tabs(&[Pane::Camera]);
            let left = split(&mut tiles, LinearDir::Vertical, [field, time], 0.78);
            let right = split(&mut tiles, LinearDir::Vertical, [side, camera], 0.6);
            split(&mut tiles, LinearDir::Horizontal, [left, right], 0.6)
        }
        PanelLayout::Simulate => {
            let (field, camera) = (tabs(&[Pane::Field, Pane::Scene]), tabs(&[Pane::Camera]));
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

/// A tree with one panel.
#[cfg(test)]
pub(crate) fn build_single(pane: Pane) -> Tree<PanelId> {
    let mut tiles = Tiles::default();
    let tile = tiles.insert_pane(PanelId::from(pane));
    let root = tiles.insert_tab_tile(vec![tile]);
    Tree::new(egui::Id::unique(TREE_ID), root, tiles)
}

fn split(
    tiles: &mut Tiles<PanelId>,
    direction: LinearDir,
    children: [TileId; 2],
    share: f32,
) -> TileId {
    tiles.insert_container(Linear::new_binary(direction, children, share))
}

/// The open panels, in order.
pub(crate) fn open_panels(tree: &Tree<PanelId>) -> Vec<PanelId> {
    let tiles = tree.tiles.tiles();
    let mut open: Vec<PanelId> = tiles
        .filter_map(|tile| match tile {
            Tile::Pane(id) => Some(*id),
            Tile::Container(_) => None,
        })
        .collect();
    open.sort();
    open
}

/// The open panels from left to right and from top to bottom, tab by tab.
pub(crate) fn panels_in_order(tree: &Tree<PanelId>) -> Vec<PanelId> {
    let mut panels = Vec::new();
    let mut waiting: Vec<TileId> = tree.root().into_iter().collect();
    while let Some(tile) = waiting.pop() {
        match tree.tiles.get(tile) {
            Some(Tile::Pane(id)) => panels.push(*id),
            Some(Tile::Container(container)) => {
                let mut children: Vec<TileId> = container.children().copied().collect();
                children.reverse();
                waiting.extend(children);
            }
            None => {}
        }
    }
    panels
}

/// Brings a panel to the front of its tabs.
pub(crate) fn show_panel(tree: &mut Tree<PanelId>, id: PanelId) {
    tree.make_active(|_, tile| matches!(tile, Tile::Pane(pane) if *pane == id));
}

/// Closes a panel.
pub(crate) fn close_panel(tree: &mut Tree<PanelId>, id: PanelId) {
    if let Some(tile) = tree.tiles.find_pane(&id) {
        tree.remove_recursively(tile);
    }
}

/// True if the tree contains a panel of the kind.
pub(crate) fn contains_pane(tree: &Tree<PanelId>, pane: Pane) -> bool {
    open_panels(tree).iter().any(|id| id.pane == pane)
}

/// Opens another panel of a kind, to the right of all others.
pub(crate) fn open_pane(tree: &mut Tree<PanelId>, pane: Pane) {
    let open = open_panels(tree);
    let copy = (0..).find(|copy| !open.contains(&PanelId { pane, copy: *copy }));
    let id = PanelId {
        pane,
        copy: copy.unwrap_or_default(),
    };
    let tile = tree.tiles.insert_pane(id);
    let Some(root) = tree.root() else {
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
        let row = tree.tiles.insert_horizontal_tile(vec![root, tile]);
        *tree = Tree::new(
            egui::Id::unique(TREE_ID),
            row,
            std::mem::take(&mut tree.tiles),
        );
    }
}

/// Closes all panels of a kind, or opens one.
pub(crate) fn toggle_pane(tree: &mut Tree<PanelId>, pane: Pane) {
    if !contains_pane(tree, pane) {
        return open_pane(tree, pane);
    }
    for id in open_panels(tree) {
        if id.pane == pane {
            close_panel(tree, id);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::view::panels::PANES;

    #[test]
    fn every_pane_is_in_a_layout_and_can_be_closed_and_reopened() {
        for pane in PANES {
            let containing = LAYOUTS
                .iter()
                .find(|(layout, _)| contains_pane(&build_tree(*layout), pane));
            let (layout, _) = containing.expect("a layout with this pane");
            let mut tree = build_tree(*layout);
            toggle_pane(&mut tree, pane);
            assert!(!contains_pane(&tree, pane), "{pane:?} is closed");
            toggle_pane(&mut tree, pane);
            assert!(contains_pane(&tree, pane), "{pane:?} is open");
            open_pane(&mut tree, pane);
            let copies = open_panels(&tree).into_iter().filter(|id| id.pane == pane);
            assert_eq!(copies.map(|id| id.copy).collect::<Vec<_>>(), [0, 1]);
        }
    }
}
