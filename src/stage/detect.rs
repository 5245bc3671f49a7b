//! Corner detection on a grid: cells that lost their points get new ones.
//!
//! The picture is cut into square cells, as many as points are wanted. A cell without a point gets the place of the largest
//! smaller eigenvalue of the gradient matrix (Shi and Tomasi 1994), searched at half resolution: a track needs no exact corner,
//! only texture in two directions. A cell that has nothing to follow is left alone for a while.

use crate::frame::Frame;
use crate::image::PlaneRef;
use crate::kernel::{Level, corner};

use super::track::Feature;

/// Settings of the detector.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Params {
    /// Points to follow at a time, spread over the picture (count, 50 to 2000).
    pub points: u32,
    /// Least contrast of a corner: smaller eigenvalue of the gradient matrix, as root mean square slope (grey levels a pixel,
    /// 0.5 to 50).
    pub min_contrast: f64,
}

impl Default for Params {
    fn default() -> Self {
        Self { points: 400, min_contrast: 1.5 }
    }
}

/// Frames for which a cell that had nothing to follow is not searched again.
const REST: u8 = 6;
/// With fewer points than this part of what is wanted no cell rests: the picture was black for a moment, or there was a cut.
const FEW: usize = 8;

/// How surely a point is background of which nothing is known.
const UNKNOWN: f32 = 0.6;

/// Finds new points where old ones were lost.
#[derive(Debug)]
pub struct Detector {
    params: Params,
    level: Level,
    next_id: u32,
    grid: Grid,
}

/// The cells of a picture: the point that each holds, and how long it still rests.
#[derive(Debug, Default)]
struct Grid {
    size: (usize, usize),
    cell: usize,
    columns: usize,
    rows: usize,
    /// Its place and how surely it is background.
    holder: Vec<Option<([f32; 2], f32)>>,
    rest: Vec<u8>,
}

impl Grid {
    fn fit(&mut self, size: (usize, usize), points: u32) {
        if self.size == size {
            return;
        }
        let area = (size.0 * size.1) as f64 / f64::from(points.max(1));
        // an even side, so that cells are whole at half resolution, and no larger than a search
        self.cell = (area.sqrt() as usize & !1).clamp(8, 2 * corner::MAX);
        self.columns = size.0.div_ceil(self.cell);
        self.rows = size.1.div_ceil(self.cell);
        self.holder = vec![None; self.columns * self.rows];
        self.rest = vec![0; self.columns * self.rows];
        self.size = size;
    }

    /// The point held by the cell in which (x, y) lies.
    fn holder_mut(&mut self, [x, y]: [f32; 2]) -> &mut Option<([f32; 2], f32)> {
        let column = (x.max(0.0) as usize / self.cell).min(self.columns - 1);
        let row = (y.max(0.0) as usize / self.cell).min(self.rows - 1);
        &mut self.holder[row * self.columns + column]
    }

    /// The points held by the cells at most `reach` from a cell.
    fn neighbours(&self, column: usize, row: usize, reach: usize) -> impl Iterator<Item = &([f32; 2], f32)> {
        let rows = row.saturating_sub(reach)..(row + reach + 1).min(self.rows);
        let columns = column.saturating_sub(reach)..(column + reach + 1).min(self.columns);
        rows.flat_map(move |r| &self.holder[r * self.columns..][columns.clone()]).flatten()
    }

    /// How surely a new point there is background: as surely as those around it.
    fn background(&self, column: usize, row: usize) -> f32 {
        let (sum, count) = self.neighbours(column, row, 2).fold((UNKNOWN, 1.0), |(sum, count), (_, b)| (sum + b, count + 1.0));
        sum / count
    }
}

impl Detector {
    /// A detector that has seen nothing, at this processor's best level.
    pub fn new(params: Params) -> Self {
        Self::with_level(params, Level::detected())
    }

    /// A detector that has seen nothing, at `level`.
    pub fn with_level(params: Params, level: Level) -> Self {
        Self { params, level, next_id: 0, grid: Grid::default() }
    }

    /// Takes the least contrast from `params`. The count of points stays: there is room for so many.
    pub fn set_params(&mut self, params: &Params) {
        self.params.min_contrast = params.min_contrast;
    }

    /// Thins `features` to one a cell (the oldest stays) and adds one to each empty cell of `frame`'s picture that has
    /// something to follow. A flat picture gets none. Allocates only where the picture's size changed.
    pub fn replenish(&mut self, frame: &Frame, features: &mut Vec<Feature>) {
        let luma = frame.picture.luma();
        self.grid.fit((luma.width(), luma.height()), self.params.points);
        let grid = &mut self.grid;
        grid.holder.fill(None);
        // the oldest first: among those of one cell the first stays
        features.sort_unstable_by_key(|feature| (std::cmp::Reverse(feature.age), feature.id));
        features.retain(|feature| {
            let holder = grid.holder_mut(feature.at);
            let first = holder.is_none();
            if first {
                *holder = Some((feature.at, feature.background));
            }
            first
        });
        if features.len() * FEW < self.params.points as usize {
            grid.rest.fill(0);
        }
        let (plane, scale) = match frame.pyramid.levels.first() {
            Some(half) => (half.as_ref(), 2),
            None => (luma, 1),
        };
        let least = (self.params.min_contrast * self.params.min_contrast) as f32;
        for row in 0..grid.rows {
            for column in 0..grid.columns {
                let index = row * grid.columns + column;
                if grid.holder[index].is_some() {
                    continue;
                }
                if grid.rest[index] > 0 {
                    grid.rest[index] -= 1;
                    continue;
                }
                match search(self.level, grid, plane, scale, (column, row), least) {
                    Some(at) => {
                        let background = grid.background(column, row);
                        grid.holder[index] = Some((at, background));
                        features.push(Feature { at, id: self.next_id, age: 0, background });
                        self.next_id = self.next_id.wrapping_add(1);
                    }
                    None => grid.rest[index] = REST,
                }
            }
        }
    }
}

/// The best free place of a cell, in pixels of the picture.
fn search(
    level: Level,
    grid: &Grid,
    plane: PlaneRef<'_>,
    scale: usize,
    (column, row): (usize, usize),
    least: f32,
) -> Option<[f32; 2]> {
    let side = grid.cell / scale;
    let offset = (scale as f32 - 1.0) / 2.0;
    let place = |x: usize, y: usize| [(x * scale) as f32 + offset, (y * scale) as f32 + offset];
    let distance = grid.cell as f32 * 0.5;
    // the points of the neighbouring cells; those of a missing one are far away
    let mut near = [[f32::INFINITY; 2]; 9];
    near.iter_mut().zip(grid.neighbours(column, row, 1)).for_each(|(near, (at, _))| *near = *at);
    let found = corner::strongest(level, plane, [column * side, row * side], [side, side], least, |x, y| {
        let at = place(x, y);
        near.iter().all(|p| (p[0] - at[0]).abs().max((p[1] - at[1]).abs()) >= distance)
    })?;
    Some(place(found.x, found.y))
}
