//! Where do two rows of an image not continue each other? There parts of two images meet, or pixels were lost.
//!
//! Optics and the interpolation of colours spread each edge over several rows. Where parts of two images meet, many
//! columns change from one row to the next and not beside it. Where pixels were lost, the lower row continues the
//! upper one after a displacement.

use super::rows::{SampledRow, SampledRows};
use super::samples::COLUMN_STEP;
use crate::image::ImageView;

/// Pairs of rows above and below with which the step of a column is compared.
const ROWS_BESIDE: usize = 6;
/// A step is sharp if it is larger than this, brightness levels, and more than twice as large as each of those beside it.
const STEP_MIN: u8 = 8;
/// Most columns that count of an edge along the row.
const EDGE_MAX: usize = 4;
/// Difference of two rows over those of their neighbours from which a displacement is sought, largest displacement in
/// pixels, and share of the difference that it leaves at most.
const DISPLACED_RATIO: f32 = 1.35;
const DISPLACEMENT_MAX: usize = 100;
const DISPLACED_SHARE: f32 = 0.5;
/// Share of the difference that remains at most if the middle of the lower row is compared with the upper one, displaced back as far. An
/// even wall fits any part of the lower row, but an edge along the lower row fits no part of the wall.
const DISPLACED_BACK_SHARE: f32 = 0.75;
/// Mean difference below which two rows show nothing that could be displaced, brightness levels.
const DISPLACED_LEVEL: f32 = 6.0;
/// Differences below this are noise or compression, brightness levels.
const DIFFERENCE_FLOOR: f32 = 3.0;

/// Finds the seam of an image. Keeps its memory from image to image.
#[derive(Debug, Clone, Default)]
pub(super) struct SeamFinder {
    /// Columns of a row.
    columns: usize,
    /// Brightness difference of each pair of rows, column by column.
    steps: Vec<u8>,
    /// The largest of two, four and six steps below each other.
    two: Vec<u8>,
    four: Vec<u8>,
    six: Vec<u8>,
    /// Mean difference of each pair where both show ground; not a number where the rows do not follow each other.
    differences: Vec<f32>,
    /// Columns with a sharp step, of each pair.
    sharp: Vec<usize>,
}

impl SeamFinder {
    /// The row that does not continue the one above. `share_min`: columns with a sharp step by which the seam exceeds
    /// twice those of any other pair of rows, as a share of the image's width.
    pub(super) fn find(
        &mut self,
        rows: &SampledRows,
        image: &ImageView<'_>,
        share_min: f32,
    ) -> Option<usize> {
        let read: Vec<&SampledRow> = rows.read_rows().collect();
        self.read_steps(rows, &read);
        let joined = self.joined(rows, &read, share_min);
        joined.or_else(|| self.displaced(rows, image, &read))
    }

    fn read_steps(&mut self, rows: &SampledRows, read: &[&SampledRow]) {
        self.columns = read.first().map_or(0, |row| row.ground.len());
        self.steps.clear();
        self.differences.clear();
        for pair in read.windows(2) {
            let [above, below] = [pair[0], pair[1]];
            let levels = rows.levels_of(above).iter().zip(rows.levels_of(below));
            let from = self.steps.len();
            self.steps
                .extend(levels.map(|(upper, lower)| upper.abs_diff(*lower)));
            if below.row != above.row + rows.row_step() {
                self.steps[from..].fill(0);
                self.differences.push(f32::NAN);
                continue;
            }
            let shown = above.ground.iter().zip(&below.ground);
            let (mut sum, mut count) = (0u32, 0u32);
            for (&step, (&above, &below)) in self.steps[from..].iter().zip(shown) {
                let both = u32::from(above & below);
                sum += both * u32::from(step);
                count += both;
            }
            self.differences.push(sum as f32 / count.max(1) as f32);
        }
    }

    /// The first row of the lower of two joined parts.
    fn joined(
        &mut self,
        rows: &SampledRows,
        read: &[&SampledRow],
        share_min: f32,
    ) -> Option<usize> {
        let pairs = self.differences.len();
        self.find_largest_beside();
        self.sharp.clear();
        let mut is_sharp = vec![false; self.columns];
        for number in 0..pairs {
            if number < ROWS_BESIDE || number + ROWS_BESIDE >= pairs {
                self.sharp.push(0);
                continue;
            }
            let [upper, lower] = [read[number], read[number + 1]];
            let shown = upper.ground.iter().zip(&lower.ground);
            let before = self.largest_of_six(number - ROWS_BESIDE);
            let beside = before.iter().zip(self.largest_of_six(number + 1));
            let steps = self.steps_of(number).iter().zip(beside).zip(shown);
            for (is_sharp, ((step, (before, after)), (above, below))) in
                is_sharp.iter_mut().zip(steps)
            {
                let beside = *before.max(after);
                *is_sharp = above & below & (*step > STEP_MIN) & (*step / 2 > beside);
            }
            // Most pairs of rows have no sharp step: only the others are counted by their edges.
            let any = is_sharp.iter().fold(false, |any, is_sharp| any | is_sharp);
            let levels = rows.levels_of(upper).iter().zip(rows.levels_of(lower));
            let brighter = levels.map(|(above, below)| below > above);
            let steps = is_sharp.iter().copied().zip(brighter);
            self.sharp.push(if any { count_by_edge(steps) } else { 0 });
        }
        let (seam, &most) = (self.sharp.iter().enumerate()).max_by_key(|(_, count)| **count)?;
        let others = self.sharp.iter().enumerate();
        let next = others
            .filter(|(number, _)| number.abs_diff(seam) > 1)
            .map(|(_, count)| *count)
            .max()?;
        let excess = most as f32 - 2.0 * next as f32;
        (excess > share_min * self.columns as f32).then(|| read[seam + 1].row)
    }

    /// The largest step of each column over six pairs of rows, from each pair on.
    fn find_largest_beside(&mut self) {
        const { assert!(ROWS_BESIDE == 6) };
        let row = self.columns;
        max_of_shifted(&self.steps, &self.steps, row, &mut self.two);
        max_of_shifted(&self.two, &self.two, 2 * row, &mut self.four);
        max_of_shifted(&self.four, &self.two, 4 * row, &mut self.six);
    }

    fn steps_of(&self, pair: usize) -> &[u8] {
        &self.steps[pair * self.columns..][..self.columns]
    }

    /// The largest step of each column over [`ROWS_BESIDE`] pairs from this one on.
    fn largest_of_six(&self, pair: usize) -> &[u8] {
        &self.six[pair * self.columns..][..self.columns]
    }

    /// The first row from which pixels are lost.
    fn displaced(
        &self,
        rows: &SampledRows,
        image: &ImageView<'_>,
        read: &[&SampledRow],
    ) -> Option<usize> {
        let mut around = self.differences.windows(5).enumerate();
        let seam = around.find(|(number, around)| {
            let beside = around[0].max(around[1]).max(around[3]).max(around[4]);
            let displaced = |above: usize| displaced_difference(rows, image, read[above]);
            around[2] > DISPLACED_RATIO * beside.max(DIFFERENCE_FLOOR)
                && displaced(number + 2).is_some_and(|seam| {
                    seam.in_place > DISPLACED_LEVEL
                        && seam.away < DISPLACED_SHARE * seam.in_place
                        && seam.back < DISPLACED_BACK_SHARE * seam.in_place
                })
                // An edge that lies nearly along the rows is displaced from each row to the next.
                && [number + 1, number + 3].into_iter().all(|above| {
                    displaced(above).is_none_or(|beside| beside.away >= beside.in_place)
                })
        });
        seam.map(|(number, _)| read[number + 3].row)
    }
}

/// The larger of each value of `first` and the one of `second` that is `shift` further on.
fn max_of_shifted(first: &[u8], second: &[u8], shift: usize, largest: &mut Vec<u8>) {
    let shifted = second.get(shift..).unwrap_or_default();
    largest.clear();
    largest.extend(first.iter().zip(shifted).map(|(a, b)| *a.max(b)));
}

/// Counts sharp steps, of those of one edge along the row at most [`EDGE_MAX`]: a marking that lies along the rows of
/// the image is no seam. One column between two steps does not end an edge: noise hides a step, and a rod crosses it.
/// `steps`: is the column's step sharp, and is the lower row brighter?
fn count_by_edge(steps: impl Iterator<Item = (bool, bool)>) -> usize {
    let (mut count, mut run, mut last) = (0, 0, false);
    let mut since_last = usize::MAX;
    for (is_sharp, brighter) in steps {
        since_last = since_last.saturating_add(1);
        if !is_sharp {
            continue;
        }
        if since_last > 2 || brighter != last {
            run = 0;
        }
        run += 1;
        count += usize::from(run <= EDGE_MAX);
        (last, since_last) = (brighter, 0);
    }
    count
}

/// Mean differences of two rows, brightness levels.
#[derive(Debug, Clone, Copy)]
struct RowDifference {
    in_place: f32,
    /// The least of those with the lower row displaced by three pixels or more.
    away: f32,
    /// With the upper row displaced back as far.
    back: f32,
}

/// How well the row below one continues it, in place and displaced. None where too little of the row shows ground.
fn displaced_difference(
    rows: &SampledRows,
    image: &ImageView<'_>,
    above: &SampledRow,
) -> Option<RowDifference> {
    let first = above.ground.iter().position(|shown| *shown)?;
    let last = above.ground.iter().rposition(|shown| *shown)?;
    let columns = first * COLUMN_STEP..last * COLUMN_STEP;
    // A short row at the edge of the ground may show one object alone.
    if 2 * columns.len() < rows.size_px().0 {
        return None;
    }
    let [upper, lower]: [Vec<u8>; 2] = [above.row, above.row + rows.row_step()].map(|row| {
        let level = |column| rows.level_at(image, column, row);
        columns.clone().map(level).collect()
    });
    let most = DISPLACEMENT_MAX.min(upper.len() / 3);
    let compared = (upper.len() - 2 * most).div_ceil(2);
    // The difference over the same middle part of one row, for each displacement of the other.
    let difference = |fixed: &[u8], displaced: &[u8], shift: usize| -> f32 {
        let middle = &fixed[most..fixed.len() - most];
        let pairs = middle.iter().zip(&displaced[shift..]).step_by(2);
        let sum: u32 = pairs.map(|(a, b)| u32::from(a.abs_diff(*b))).sum();
        sum as f32 / compared as f32
    };
    let shifts = (0..=2 * most).filter(|shift| shift.abs_diff(most) >= 3);
    let away = shifts.map(|shift| (shift, difference(&upper, &lower, shift)));
    let (shift, away) = away.min_by(|(_, a), (_, b)| a.total_cmp(b))?;
    Some(RowDifference {
        in_place: difference(&upper, &lower, most),
        away,
        back: difference(&lower, &upper, 2 * most - shift),
    })
}

#[cfg(test)]
mod tests {
    use super::{EDGE_MAX, ROWS_BESIDE, SeamFinder, count_by_edge};

    #[test]
    fn largest_steps_beside_a_pair_are_those_of_six_pairs() {
        const COLUMNS: usize = 3;
        let steps: Vec<u8> = (0..20 * COLUMNS)
            .map(|index| (index * index * 37 % 251) as u8)
            .collect();
        let mut finder = SeamFinder {
            columns: COLUMNS,
            steps: steps.clone(),
            ..SeamFinder::default()
        };
        finder.find_largest_beside();
        for pair in 0..=20 - ROWS_BESIDE {
            for column in 0..COLUMNS {
                let here = (pair..pair + ROWS_BESIDE).map(|pair| steps[pair * COLUMNS + column]);
                assert_eq!(finder.largest_of_six(pair)[column], here.max().unwrap_or(0));
            }
        }
    }

    #[test]
    fn marking_along_the_rows_counts_as_one_edge() {
        let marking = [(true, true); 30];
        assert_eq!(count_by_edge(marking.into_iter()), EDGE_MAX);
        let crossed = marking.map(|step| [step, step, (false, false)]);
        assert_eq!(count_by_edge(crossed.into_iter().flatten()), EDGE_MAX);
        let apart = marking.map(|step| [step, step, (false, false), (false, false)]);
        assert_eq!(count_by_edge(apart.into_iter().flatten()), 60);
        let of_two_pictures = marking.into_iter().zip([(true, false); 30]);
        let steps = of_two_pictures.flat_map(|(up, down)| [up, down]);
        assert_eq!(count_by_edge(steps), 60);
    }
}
