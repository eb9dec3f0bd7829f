//! Which colour does a pixel measure behind a Bayer mosaic, and how are the others interpolated?

/// Values of all pixels with a border of one pixel, which repeats the pixels of the same colour.
pub(crate) struct Raw {
    width_px: usize,
    height_px: usize,
    values: Vec<u16>,
}

/// Colours of the even and odd columns of a row: red and green, or green and blue.
pub(crate) fn site_colours(row: usize) -> [usize; 2] {
    if row.is_multiple_of(2) {
        [0, 1]
    } else {
        [1, 2]
    }
}

impl Raw {
    pub(crate) fn new(width_px: usize, height_px: usize) -> Self {
        Raw {
            width_px,
            height_px,
            values: vec![0; (width_px + 2) * (height_px + 2)],
        }
    }

    fn start(&self, row: usize) -> usize {
        (row + 1) * (self.width_px + 2)
    }

    /// The pixels of a row, to write.
    pub(crate) fn row_mut(&mut self, row: usize) -> &mut [u16] {
        let start = self.start(row) + 1;
        &mut self.values[start..start + self.width_px]
    }

    /// Fills the border from the pixels next to the outermost ones.
    pub(crate) fn fill_border(&mut self) {
        let (width, stride) = (self.width_px, self.width_px + 2);
        for row in 0..self.height_px {
            let start = self.start(row);
            self.values[start] = self.values[start + 2.min(width)];
            self.values[start + width + 1] = self.values[start + width.max(2) - 1];
        }
        let inner = self.start(1.min(self.height_px - 1));
        self.values.copy_within(inner..inner + stride, 0);
        let inner = self.start(self.height_px.max(2) - 2);
        let last = self.start(self.height_px);
        self.values.copy_within(inner..inner + stride, last);
    }

    /// A row with those above and below, each with its border.
    pub(crate) fn neighbourhood(&self, row: usize) -> [&[u16]; 3] {
        let stride = self.width_px + 2;
        [0, 1, 2].map(|down| &self.values[(row + down) * stride..][..stride])
    }
}

/// Interpolates a row bilinearly. `even`: all bits set in even columns, none in odd ones.
pub(crate) fn demosaic_row(
    row: usize,
    [above, here, below]: [&[u16]; 3],
    even: &[u16],
    [red, green, blue]: [&mut [u16]; 3],
) {
    let count = even.len();
    let (above, here, below) = (&above[..count + 2], &here[..count + 2], &below[..count + 2]);
    let (red, green, blue) = (&mut red[..count], &mut green[..count], &mut blue[..count]);
    let red_row = row.is_multiple_of(2);
    let (from_red, from_blue) = if red_row { (red, blue) } else { (blue, red) };
    // In a row of red and green, red is in even columns; in a row of green and blue, blue is in odd ones.
    let flip = if red_row { 0 } else { u16::MAX };
    for i in 0..count {
        let own = even[i] ^ flip;
        let centre = here[i + 1];
        let across = (here[i] + here[i + 2]) / 2;
        let upright = (above[i + 1] + below[i + 1]) / 2;
        let diagonal = (above[i] + above[i + 2] + below[i] + below[i + 2]) / 4;
        from_red[i] = (centre & own) | (across & !own);
        green[i] = (((across + upright) / 2) & own) | (centre & !own);
        from_blue[i] = (diagonal & own) | (upright & !own);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn even_colours_survive_mosaic_and_interpolation() {
        let (width, height, colour) = (7, 6, [900u16, 2000, 300]);
        let mut raw = Raw::new(width, height);
        for row in 0..height {
            for (column, value) in raw.row_mut(row).iter_mut().enumerate() {
                *value = colour[site_colours(row)[column & 1]];
            }
        }
        raw.fill_border();
        let even: Vec<u16> = (0..width)
            .map(|column| if column % 2 == 0 { u16::MAX } else { 0 })
            .collect();
        for row in 0..height {
            let mut planes = [0; 3].map(|_| vec![0u16; width]);
            demosaic_row(
                row,
                raw.neighbourhood(row),
                &even,
                planes.each_mut().map(|plane| &mut plane[..]),
            );
            for (plane, wanted) in planes.iter().zip(colour) {
                assert!(
                    plane.iter().all(|&value| value == wanted),
                    "row {row}: {planes:?}"
                );
            }
        }
    }
}
