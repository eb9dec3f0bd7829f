//! What does a colour mean? Classes, and the small table by which scan lines are classified.

use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};

/// What a pixel's colour says it belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Class(pub u8);

impl Class {
    /// None of the others: grey floors, clutter.
    pub const OTHER: Class = Class(0);
    /// Robots, shadows, rods.
    pub const BLACK: Class = Class(1);
    /// Lines, goal posts, glare.
    pub const WHITE: Class = Class(2);
    /// The carpet, whatever its colour.
    pub const CARPET: Class = Class(3);
    /// Red.
    pub const RED: Class = Class(4);
    /// Blue: one of the goals of 2001.
    pub const BLUE: Class = Class(5);
    /// Cyan: a team marker.
    pub const CYAN: Class = Class(6);
    /// Magenta: a team marker.
    pub const MAGENTA: Class = Class(7);
    /// Yellow: the other goal of 2001.
    pub const YELLOW: Class = Class(8);
    /// The ball's colour.
    pub const BALL: Class = Class(9);
}

/// Names of the classes that vision itself knows; a table of labels may add more.
pub const CLASS_NAMES: [&str; 10] = [
    "other", "black", "white", "carpet", "red", "blue", "cyan", "magenta", "yellow", "ball",
];

/// Classes by the upper six bits of the camera's own three channels.
///
/// 256 KiB stay in a core's cache, where the 24-bit table's 16 MiB do not; a level of 4 is finer than a camera's noise.
/// A cell is filled when it is first asked for: a frame shows a few thousand of all colours, so a new light holds up
/// no frame.
pub struct NativeTable {
    /// Relaxed: whoever fills a cell puts the same class there.
    classes: Box<[AtomicU8; CELLS]>,
    meaning: Arc<Meaning>,
}

/// What a cell's middle means.
type Meaning = dyn Fn([u8; 3]) -> Class + Send + Sync;

const CELLS: usize = 1 << 18;

/// Not asked for yet; tables of labels have fewer classes.
const UNKNOWN: u8 = u8::MAX;

impl std::fmt::Debug for NativeTable {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("NativeTable").finish_non_exhaustive()
    }
}

impl Clone for NativeTable {
    fn clone(&self) -> Self {
        NativeTable {
            classes: unknown(),
            meaning: Arc::clone(&self.meaning),
        }
    }
}

impl NativeTable {
    /// `meaning` is asked for the class at the middle of a cell; it always answers the same to the same colour.
    pub fn new(meaning: impl Fn([u8; 3]) -> Class + Send + Sync + 'static) -> Self {
        NativeTable {
            classes: unknown(),
            meaning: Arc::new(meaning),
        }
    }

    /// The class of a pixel by its three channels.
    #[inline]
    pub fn class(&self, [a, b, c]: [u8; 3]) -> Class {
        self.at(NativeTable::cell(u32::from_le_bytes([a, b, c, 0])))
    }

    /// Cell of a pixel whose first channel is in the lowest byte; the highest byte does not matter.
    #[inline]
    pub(crate) fn cell(pixel: u32) -> u32 {
        (pixel & 0xfc) << 10 | (pixel & 0xfc00) >> 4 | pixel >> 18 & 0x3f
    }

    /// The class of a cell.
    #[inline]
    pub(crate) fn at(&self, cell: u32) -> Class {
        let cell = cell as usize % CELLS;
        match self.classes[cell].load(Ordering::Relaxed) {
            UNKNOWN => self.fill(cell),
            class => Class(class),
        }
    }

    /// Puts the classes of several cells into the slots of these numbers.
    #[inline]
    pub(crate) fn strew(&self, cells: &[u32], numbers: &[u32], slots: &mut [Class]) {
        let mut any = 0;
        for (&cell, &number) in cells.iter().zip(numbers) {
            let class = self.classes[cell as usize % CELLS].load(Ordering::Relaxed);
            any |= class;
            slots[number as usize] = Class(class);
        }
        // Without a branch for each; classes of so high a number are rare enough to be looked at once more.
        if any >= UNKNOWN / 2 {
            for (&cell, &number) in cells.iter().zip(numbers) {
                slots[number as usize] = self.at(cell);
            }
        }
    }

    #[cold]
    #[inline(never)]
    fn fill(&self, cell: usize) -> Class {
        let middle = |shift: usize| ((cell >> shift & 63) << 2 | 2) as u8;
        let class = (self.meaning)([middle(12), middle(6), middle(0)]);
        self.classes[cell].store(class.0, Ordering::Relaxed);
        class
    }
}

/// A table that nothing was asked of.
fn unknown() -> Box<[AtomicU8; CELLS]> {
    Box::new([const { AtomicU8::new(UNKNOWN) }; CELLS])
}
