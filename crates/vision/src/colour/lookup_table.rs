//! Colour classes, and the lookup table that classifies pixels.

use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};

/// Class of a pixel by its colour.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ColourClass(pub u8);

impl ColourClass {
    /// None of the other classes: grey floors, clutter.
    pub const OTHER: ColourClass = ColourClass(0);
    /// Robots, shadows, rods.
    pub const BLACK: ColourClass = ColourClass(1);
    /// Lines, goal posts, glare.
    pub const WHITE: ColourClass = ColourClass(2);
    /// The carpet, of any colour.
    pub const CARPET: ColourClass = ColourClass(3);
    /// Red.
    pub const RED: ColourClass = ColourClass(4);
    /// Blue: one of the goals of 2001.
    pub const BLUE: ColourClass = ColourClass(5);
    /// Cyan: a team marker.
    pub const CYAN: ColourClass = ColourClass(6);
    /// Magenta: a team marker.
    pub const MAGENTA: ColourClass = ColourClass(7);
    /// Yellow: the other goal of 2001.
    pub const YELLOW: ColourClass = ColourClass(8);
    /// The ball's colour.
    pub const BALL: ColourClass = ColourClass(9);
}

/// Names of the built-in classes; a table of labels may add more.
pub const CLASS_NAMES: [&str; 10] = [
    "other", "black", "white", "carpet", "red", "blue", "cyan", "magenta", "yellow", "ball",
];

/// Classes by the upper six bits of the camera's own three channels.
///
/// 256 KiB fit a core's cache, unlike the 16 MiB of a 24-bit table; steps of 4 levels are finer than a camera's noise.
/// Cells are filled lazily: an image contains a few thousand of them, so a new colour model delays no image.
pub struct ColourLookupTable {
    /// Relaxed ordering suffices: every thread fills a cell with the same class.
    classes: Box<[AtomicU8; CELLS]>,
    classify: Arc<ClassifyFn>,
}

/// Class of a cell's centre.
type ClassifyFn = dyn Fn([u8; 3]) -> ColourClass + Send + Sync;

const CELLS: usize = 1 << 18;

/// Width of a cell in each channel, levels.
pub(crate) const CELL_LEVELS: f32 = 4.0;

/// Marks an unfilled cell; tables of labels have fewer classes.
const UNFILLED: u8 = u8::MAX;

impl std::fmt::Debug for ColourLookupTable {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("ColourLookupTable").finish_non_exhaustive()
    }
}

impl Clone for ColourLookupTable {
    fn clone(&self) -> Self {
        ColourLookupTable {
            classes: unfilled_cells(),
            classify: Arc::clone(&self.classify),
        }
    }
}

impl ColourLookupTable {
    /// `meaning` returns the class of a cell's centre; it must be a pure function.
    pub fn new(meaning: impl Fn([u8; 3]) -> ColourClass + Send + Sync + 'static) -> Self {
        ColourLookupTable {
            classes: unfilled_cells(),
            classify: Arc::new(meaning),
        }
    }

    /// The class of a pixel by its three channels.
    #[inline]
    pub fn class(&self, [a, b, c]: [u8; 3]) -> ColourClass {
        self.cell_class(ColourLookupTable::cell_index(u32::from_le_bytes([
            a, b, c, 0,
        ])))
    }

    /// Cell of a pixel whose first channel is in the lowest byte; the highest byte is ignored.
    #[inline]
    pub(crate) fn cell_index(pixel: u32) -> u32 {
        (pixel & 0xfc) << 10 | (pixel & 0xfc00) >> 4 | pixel >> 18 & 0x3f
    }

    /// The class of a cell.
    #[inline]
    pub(crate) fn cell_class(&self, cell: u32) -> ColourClass {
        let cell = cell as usize % CELLS;
        match self.classes[cell].load(Ordering::Relaxed) {
            UNFILLED => self.fill(cell),
            class => ColourClass(class),
        }
    }

    /// Writes the classes of cells in their order.
    #[inline]
    pub(crate) fn classify(&self, cells: &[u32], classes: &mut [ColourClass]) {
        let mut any = 0;
        for (class, &cell) in classes.iter_mut().zip(cells) {
            *class = ColourClass(self.classes[cell as usize % CELLS].load(Ordering::Relaxed));
            any |= class.0;
        }
        // One branch for all of them, as in `scatter`.
        if any >= UNFILLED / 2 {
            for (class, &cell) in classes.iter_mut().zip(cells) {
                *class = self.cell_class(cell);
            }
        }
    }

    /// Writes the classes of cells to the slots with these indices.
    pub(crate) fn scatter(&self, cells: &[u32], numbers: &[u32], slots: &mut [ColourClass]) {
        let mut any = 0;
        let mut write = |cell: u32, number: u32| {
            let class = self.classes[cell as usize % CELLS].load(Ordering::Relaxed);
            any |= class;
            slots[number as usize] = ColourClass(class);
        };
        // Eight at a time, to amortise the loop overhead.
        let (blocks, rest) = cells.as_chunks::<8>();
        let (number_blocks, number_rest) = numbers.as_chunks::<8>();
        for (cells, numbers) in blocks.iter().zip(number_blocks) {
            for (&cell, &number) in cells.iter().zip(numbers) {
                write(cell, number);
            }
        }
        for (&cell, &number) in rest.iter().zip(number_rest) {
            write(cell, number);
        }
        // One branch for all of them: unfilled cells are rare, so everything is repeated.
        if any >= UNFILLED / 2 {
            self.scatter_unfilled(cells, numbers, slots);
        }
    }

    #[cold]
    #[inline(never)]
    fn scatter_unfilled(&self, cells: &[u32], numbers: &[u32], slots: &mut [ColourClass]) {
        for (&cell, &number) in cells.iter().zip(numbers) {
            slots[number as usize] = self.cell_class(cell);
        }
    }

    #[cold]
    #[inline(never)]
    fn fill(&self, cell: usize) -> ColourClass {
        let middle = |shift: usize| ((cell >> shift & 63) << 2 | 2) as u8;
        let class = (self.classify)([middle(12), middle(6), middle(0)]);
        self.classes[cell].store(class.0, Ordering::Relaxed);
        class
    }
}

/// An empty table.
fn unfilled_cells() -> Box<[AtomicU8; CELLS]> {
    Box::new([const { AtomicU8::new(UNFILLED) }; CELLS])
}
