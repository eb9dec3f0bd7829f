//! A curve of a plot, drawn with the view's pen. Everything else is the plot library's line.

use std::ops::RangeInclusive;

use eframe::egui::{Pos2, Shape, Stroke, Ui};
use egui_plot::{
    ClosestElem, Line, PlotBounds, PlotGeometry, PlotItem, PlotItemBase, PlotPoint, PlotTransform,
};

use crate::view::pen::Pen;

/// A line and its points.
pub(super) struct DrawnLine<'a> {
    line: Line<'a>,
    points: &'a [PlotPoint],
    /// Points.
    width: f32,
}

impl<'a> DrawnLine<'a> {
    pub(super) fn new(line: Line<'a>, points: &'a [PlotPoint], width: f32) -> Self {
        DrawnLine {
            line: line.width(width),
            points,
            width,
        }
    }
}

impl PlotItem for DrawnLine<'_> {
    fn shapes(&self, ui: &Ui, transform: &PlotTransform, shapes: &mut Vec<Shape>) {
        let widened = if self.line.highlighted() { 2.0 } else { 1.0 };
        let stroke = Stroke::new(widened * self.width, PlotItem::color(&self.line));
        let pen = Pen::new(ui.painter().clone());
        for part in self.points.split(|point| !point.y.is_finite()) {
            let places = part.iter();
            let places = places.map(|point| transform.position_from_point(point));
            pen.line(places, stroke);
        }
        shapes.extend(pen.take_shape());
    }

    fn initialize(&mut self, x_range: RangeInclusive<f64>) {
        self.line.initialize(x_range);
    }

    fn color(&self) -> eframe::egui::Color32 {
        PlotItem::color(&self.line)
    }

    fn geometry(&self) -> PlotGeometry<'_> {
        self.line.geometry()
    }

    fn bounds(&self) -> PlotBounds {
        self.line.bounds()
    }

    fn base(&self) -> &PlotItemBase {
        self.line.base()
    }

    fn base_mut(&mut self) -> &mut PlotItemBase {
        self.line.base_mut()
    }

    fn find_closest(&self, point: Pos2, transform: &PlotTransform) -> Option<ClosestElem> {
        self.line.find_closest(point, transform)
    }
}
