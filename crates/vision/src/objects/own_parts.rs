//! Which edges are the robot's own? Body, rods and rim stay in place in the image while everything else moves.
//!
//! Learned during operation and kept for the whole run, so that no mask must be calibrated.

/// Views after which parts are known.
const VIEWS_MIN: u32 = 8;
/// Share of the views in which an own part shows its edge.
const OWN_SHARE: f32 = 0.8;
/// A view is new if at least this share of its edges differ from those of the last one. A robot that stands still
/// would otherwise take its neighbours for parts of itself.
const NEW_VIEW_SHARE: f32 = 0.5;

/// Counts of edges by place over the views so far.
#[derive(Debug, Clone)]
pub(crate) struct OwnParts {
    counts: Vec<u32>,
    views: u32,
    last_view: Vec<bool>,
}

impl OwnParts {
    pub(crate) fn new(places: usize) -> Self {
        OwnParts {
            counts: vec![0; places],
            views: 0,
            last_view: vec![false; places],
        }
    }

    /// Takes the edges of an image, one entry per place; ignores an image that shows what the last view showed, and
    /// returns false for it.
    pub(crate) fn add_image(&mut self, edges: impl Iterator<Item = bool> + Clone) -> bool {
        let (mut either, mut differ) = (0u32, 0u32);
        for (now, &before) in edges.clone().zip(&self.last_view) {
            either += u32::from(now | before);
            differ += u32::from(now ^ before);
        }
        if (differ as f32) < NEW_VIEW_SHARE * either.max(1) as f32 {
            return false;
        }
        self.views += 1;
        for ((now, count), last) in edges.zip(&mut self.counts).zip(&mut self.last_view) {
            *count += u32::from(now);
            *last = now;
        }
        true
    }

    /// True if the edge at a place belongs to the robot itself.
    pub(crate) fn is_own(&self, place: usize) -> bool {
        self.views >= VIEWS_MIN && self.counts[place] as f32 >= OWN_SHARE * self.views as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Edges of a robot with a rod at place 3 of twenty, while the scene moves by `shift` places.
    fn edges(shift: usize) -> Vec<bool> {
        (0..20)
            .map(|place| place == 3 || (place + 20 - shift) % 20 < 3)
            .collect()
    }

    #[test]
    fn a_rod_is_learned_while_the_robot_moves() {
        let mut parts = OwnParts::new(20);
        for view in 0..12 {
            parts.add_image(edges(4 + 4 * view % 16).iter().copied());
        }
        let own: Vec<usize> = (0..20).filter(|&place| parts.is_own(place)).collect();
        assert_eq!(own, [3]);
    }

    #[test]
    fn a_robot_that_stands_still_learns_nothing() {
        let mut parts = OwnParts::new(20);
        for _ in 0..100 {
            parts.add_image(edges(8).iter().copied());
        }
        assert!((0..20).all(|place| !parts.is_own(place)));
    }
}
