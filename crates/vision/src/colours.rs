//! What does a colour mean? Classes, and the small table by which scan lines are classified.

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
#[derive(Clone, PartialEq, Eq)]
pub struct NativeTable {
    classes: Box<[Class; 1 << 18]>,
}

impl std::fmt::Debug for NativeTable {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("NativeTable").finish_non_exhaustive()
    }
}

impl NativeTable {
    /// Asks for the class at the middle of every cell.
    pub fn new(class: impl Fn([u8; 3]) -> Class) -> Self {
        let mut classes = Box::new([Class::OTHER; 1 << 18]);
        for (index, slot) in classes.iter_mut().enumerate() {
            let middle = |shift: usize| ((index >> shift & 63) << 2 | 2) as u8;
            *slot = class([middle(12), middle(6), middle(0)]);
        }
        NativeTable { classes }
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
        self.classes[cell as usize & ((1 << 18) - 1)]
    }
}
