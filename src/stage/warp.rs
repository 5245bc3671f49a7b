//! One warp per frame, from the input straight to the output: backward, bilinear, of luma and chroma.
//!
//! The map from output to input pixels is taken exactly at the nodes of a mesh and interpolated linearly between them, along rows
//! first; within a cell a row of output pixels then lies on a straight line through the input.

use crate::geometry::OutputMap;
use crate::image::{PictureMut, PictureRef, PlaneMut, PlaneRef, Sampling, Siting};
use crate::kernel::{Level, warp};

/// Sides of a mesh cell, luma pixels: wide cells are cheap, and rows of the picture may each move on their own.
const CELL: [usize; 2] = [16, 8];

/// Draws frames.
#[derive(Debug)]
pub struct Warper {
    level: Level,
    siting: Siting,
    columns: usize,
    /// Input pixels (x, y) of the nodes, row by row.
    nodes: Vec<[f32; 2]>,
    /// Lines through the input, for the row that is drawn.
    spans: Vec<warp::Span>,
}

impl Warper {
    /// A warper for pictures whose 4:2:0 chroma is sited as given.
    pub fn new(level: Level, siting: Siting) -> Self {
        Self { level, siting, columns: 0, nodes: Vec::new(), spans: Vec::new() }
    }

    /// Draws `input` into `output`, each output pixel from where `map` says. Points outside the input take its nearest edge. Both
    /// must have the same chroma; the sizes may differ. Allocates only where the output's size grew.
    pub fn draw(&mut self, map: &OutputMap, input: PictureRef<'_>, output: &mut PictureMut<'_>) {
        self.take_nodes(map, [output.width(), output.height()]);
        let chroma = (input.sampling == output.sampling).then(|| input.sampling.shift()).flatten();
        for (i, (from, to)) in input.planes.into_iter().zip(&mut output.planes).enumerate() {
            let (scale, offset) = if i == 0 {
                ([1.0, 1.0], [0.0, 0.0])
            } else {
                match chroma {
                    Some((x, y)) => ([(1 << x) as f32, (1 << y) as f32], chroma_offset(output.sampling, self.siting)),
                    None => {
                        to.fill(128);
                        continue;
                    }
                }
            };
            self.draw_plane(from, to, scale, offset);
        }
    }

    fn take_nodes(&mut self, map: &OutputMap, [width, height]: [usize; 2]) {
        self.columns = width.div_ceil(CELL[0]) + 1;
        let rows = height.div_ceil(CELL[1]) + 1;
        self.nodes.resize(self.columns * rows, [0.0; 2]);
        for (j, row) in self.nodes.chunks_exact_mut(self.columns).enumerate() {
            for (i, node) in row.iter_mut().enumerate() {
                *node = map.apply([(i * CELL[0]) as f64, (j * CELL[1]) as f64]).map(|c| c as f32);
            }
        }
    }

    /// Draws a plane whose sample (x, y) lies at luma pixel (x, y) * `scale` + `offset`.
    fn draw_plane(&mut self, from: PlaneRef<'_>, to: &mut PlaneMut<'_>, scale: [f32; 2], offset: [f32; 2]) {
        let mut spans = std::mem::take(&mut self.spans);
        let width = to.width();
        let cell = [CELL[0] as f32, CELL[1] as f32];
        let last_row = self.nodes.len() / self.columns - 2;
        for y in 0..to.height() {
            let luma_y = y as f32 * scale[1] + offset[1];
            let row = ((luma_y / cell[1]) as usize).min(last_row);
            let part = luma_y / cell[1] - row as f32;
            let (above, below) = self.nodes[row * self.columns..(row + 2) * self.columns].split_at(self.columns);
            spans.clear();
            let (mut x, mut left) = (0, between(above[0], below[0], part));
            for (i, (&above, &below)) in above.iter().zip(below).enumerate().skip(1) {
                let right = between(above, below, part);
                // the samples of this cell: those left of its right edge
                let edge = (i as f32 * cell[0] - offset[0]) / scale[0];
                let end =
                    if i + 1 == self.columns { width } else { (edge as usize + usize::from(edge.fract() > 0.0)).min(width) };
                if end > x {
                    let into = x as f32 * scale[0] + offset[0] - (i - 1) as f32 * cell[0];
                    let step = [(right[0] - left[0]) / cell[0], (right[1] - left[1]) / cell[0]];
                    let start = [left[0] + step[0] * into, left[1] + step[1] * into];
                    let line = warp::Line {
                        start: [fixed((start[0] - offset[0]) / scale[0]), fixed((start[1] - offset[1]) / scale[1])],
                        step: [fixed(step[0] * scale[0] / scale[0]), fixed(step[1] * scale[0] / scale[1])],
                    };
                    spans.push(warp::Span { line, end });
                    x = end;
                }
                left = right;
            }
            warp::row(self.level, from, &spans, to.row_mut(y));
        }
        self.spans = spans;
    }
}

/// The point `part` of the way from one node to another.
#[inline]
fn between(from: [f32; 2], to: [f32; 2], part: f32) -> [f32; 2] {
    [from[0] + (to[0] - from[0]) * part, from[1] + (to[1] - from[1]) * part]
}

/// 16.16 fixed point, rounded down; what does not fit goes to the nearest that does, what is no number to 0.
#[inline]
fn fixed(value: f32) -> i32 {
    (value * warp::ONE as f32) as i32
}

/// Luma pixel (x, y) on which the first chroma sample lies.
fn chroma_offset(sampling: Sampling, siting: Siting) -> [f32; 2] {
    match (sampling, siting) {
        (Sampling::S420, Siting::Centre) => [0.5, 0.5],
        (Sampling::S420, Siting::Left) => [0.0, 0.5],
        _ => [0.0, 0.0],
    }
}

#[cfg(test)]
mod tests;
