//! Images in two groups by the displacements of their static edges: two means, and a variance that both share.

/// Displacement of each cell in one image; None where it is hidden.
pub(super) type Row = Vec<Option<f64>>;

/// Accuracy of one edge in other light, pixels.
const EDGE_STD: f64 = 0.3;

/// Rounds until the groups are stable.
const ROUNDS_MAX: usize = 20;

/// Fewest images of a group while groups are sought.
const MEMBERS_MIN: usize = 2;

pub(super) struct TwoGroups {
    cells: Vec<CellGroups>,
}

/// Of one cell: the images that show it, mean displacement of each group, and variance within them.
#[derive(Clone, Copy, Default)]
struct CellGroups {
    count: [f64; 2],
    mean: [f64; 2],
    variance: f64,
}

impl CellGroups {
    fn is_shown_by(&self, count: f64) -> bool {
        self.count[0] >= count && self.count[1] >= count
    }

    fn distance(&self) -> f64 {
        self.mean[1] - self.mean[0]
    }

    fn weight(&self) -> f64 {
        1.0 / (self.variance + EDGE_STD * EDGE_STD)
    }
}

impl TwoGroups {
    /// `labels`: the group of each image. `without`: an image that does not count.
    pub(super) fn new(rows: &[Row], labels: &[bool], without: Option<usize>) -> Self {
        let mut cells = vec![CellGroups::default(); rows[0].len()];
        let counted = || {
            let all = rows.iter().zip(labels).enumerate();
            all.filter(|(index, _)| Some(*index) != without)
        };
        for (_, (row, &label)) in counted() {
            let group = usize::from(label);
            for (cell, displacement) in cells.iter_mut().zip(row) {
                if let Some(displacement) = displacement {
                    cell.count[group] += 1.0;
                    cell.mean[group] += displacement;
                }
            }
        }
        for cell in &mut cells {
            for (mean, count) in cell.mean.iter_mut().zip(cell.count) {
                *mean /= count.max(1.0);
            }
        }
        for (_, (row, &label)) in counted() {
            for (cell, displacement) in cells.iter_mut().zip(row) {
                if let Some(displacement) = displacement {
                    cell.variance += (displacement - cell.mean[usize::from(label)]).powi(2);
                }
            }
        }
        for cell in &mut cells {
            cell.variance /= (cell.count[0] + cell.count[1] - 2.0).max(1.0);
        }
        TwoGroups { cells }
    }

    /// Where an image lies between the groups: -0.5 at the first mean, 0.5 at the second; 0 if it shows nothing.
    pub(super) fn score(&self, row: &Row) -> f64 {
        let (mut product, mut squares) = (0.0, 0.0);
        for (cell, displacement) in self.shown(row) {
            let middle = 0.5 * (cell.mean[0] + cell.mean[1]);
            product += (displacement - middle) * cell.distance() * cell.weight();
            squares += cell.distance() * cell.distance() * cell.weight();
        }
        if squares > 0.0 {
            product / squares
        } else {
            0.0
        }
    }

    /// Cells that both groups and an image show, with the displacement in it.
    fn shown<'a>(&'a self, row: &'a Row) -> impl Iterator<Item = (&'a CellGroups, f64)> {
        let cells = self.cells.iter().zip(row);
        cells
            .filter_map(|(cell, displacement)| Some((cell, (*displacement)?)))
            .filter(|(cell, _)| cell.is_shown_by(1.0))
    }

    /// Distance of the groups as the standard deviation of the cells, from their median.
    pub(super) fn typical_distance(&self) -> f64 {
        let mut distances: Vec<f64> = self
            .cells
            .iter()
            .filter(|cell| cell.is_shown_by(2.0))
            .map(|cell| cell.distance().abs())
            .collect();
        distances.sort_by(f64::total_cmp);
        // The median of the absolute value of a normal variable is 0.6745 standard deviations.
        distances
            .get(distances.len() / 2)
            .map_or(0.0, |median| median / 0.6745)
    }

    /// How much the groups explain: the sum of squares between them over the variance.
    fn explained(&self) -> f64 {
        self.cells
            .iter()
            .filter(|cell| cell.is_shown_by(2.0))
            .map(|cell| {
                let [a, b] = cell.count;
                cell.distance().powi(2) * cell.weight() * a * b / (a + b)
            })
            .sum()
    }

    /// The groups of the images by the nearer mean.
    fn assign(&self, rows: &[Row]) -> Vec<bool> {
        rows.iter().map(|row| self.score(row) > 0.0).collect()
    }
}

/// The group of each image, so that groups explain as much as possible. None if none are found.
///
/// Groups start from each image and the one that differs most from it.
pub(super) fn best_groups(rows: &[Row]) -> Option<Vec<bool>> {
    let one = vec![false; rows.len()];
    let weights: Vec<f64> = TwoGroups::new(rows, &one, None)
        .cells
        .iter()
        .map(CellGroups::weight)
        .collect();
    let distance = |a: &Row, b: &Row| {
        let (mut sum, mut count) = (0.0, 0.0);
        for ((a, b), weight) in a.iter().zip(b).zip(&weights) {
            if let (Some(a), Some(b)) = (a, b) {
                sum += (a - b).powi(2) * weight;
                count += 1.0;
            }
        }
        if count > 0.0 { sum / count } else { 0.0 }
    };
    let mut best: Option<(f64, Vec<bool>)> = None;
    for seed in rows {
        let from_seed: Vec<f64> = rows.iter().map(|row| distance(seed, row)).collect();
        let farthest = (0..rows.len()).max_by(|&a, &b| from_seed[a].total_cmp(&from_seed[b]))?;
        let start = rows
            .iter()
            .zip(&from_seed)
            .map(|(row, from_seed)| distance(&rows[farthest], row) < *from_seed)
            .collect();
        let Some((groups, labels)) = settle(rows, start) else {
            continue;
        };
        let explained = groups.explained();
        if best.as_ref().is_none_or(|(most, _)| explained > *most) {
            best = Some((explained, labels));
        }
    }
    best.map(|(_, labels)| labels)
}

/// Moves images to the nearer mean until none moves. None if a group becomes too small.
fn settle(rows: &[Row], mut labels: Vec<bool>) -> Option<(TwoGroups, Vec<bool>)> {
    for _ in 0..ROUNDS_MAX {
        let members = labels.iter().filter(|&&label| label).count();
        if members.min(rows.len() - members) < MEMBERS_MIN {
            return None;
        }
        let groups = TwoGroups::new(rows, &labels, None);
        let nearer = groups.assign(rows);
        if nearer == labels {
            return Some((groups, labels));
        }
        labels = nearer;
    }
    Some((TwoGroups::new(rows, &labels, None), labels))
}
