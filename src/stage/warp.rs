//! One warp per frame, from the input straight to the output: backward, of luma (bilinear or bicubic) and chroma (bilinear: the eye
//! sees little of its detail).
//!
//! The map from output to input pixels is taken exactly at the nodes of a mesh and interpolated linearly between them, along columns
//! first; within a cell a row of output pixels then lies on a straight line through the input.

mod mesh;

use super::crop::Border;
use crate::geometry::OutputMap;
use crate::image::{BLACK, PictureMut, PictureRef, PlaneMut, PlaneRef, Sampling, Siting};
pub use crate::kernel::warp::Filter;
use crate::kernel::{Level, warp};
use mesh::mesh;

/// Width of a mesh cell, luma pixels, as a power of two: narrow ones...
const NARROW_BITS: u32 = 4;
/// ...and wider ones in pictures of so many columns, where lines bend less from pixel to pixel, unless they are shrunk by more than
/// this.
const WIDE_PICTURES: [usize; 2] = [600, 1200];
const SHRUNK: f64 = 1.25;
/// Height of a mesh cell, luma pixels, as a power of two: low ones, so that rows of the picture may each move on their own...
const LOW_BITS: u32 = 3;
/// ...and twice as high ones in pictures of this many rows, where a row's time is shorter.
const HIGH_PICTURE: usize = 700;
/// Lines through the input, coordinate by coordinate.
const KINDS: usize = 4;

/// Pictures of at most so many pixels are drawn bicubic unless told otherwise: they will be shown enlarged, and cost little.
const SHARP_PIXELS: usize = 1 << 19;

/// Settings of the warp.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Params {
    /// How pixels between pixels are drawn; `None`: bicubic where the picture is neither large nor shrunk, else bilinear.
    pub filter: Option<Filter>,
}

/// Draws frames.
#[derive(Debug)]
pub struct Warper {
    level: Level,
    siting: Siting,
    params: Params,
    border: Border,
    /// Nodes in a row.
    columns: usize,
    /// Width of a mesh cell, as a power of two.
    wide_bits: u32,
    /// Height of a mesh cell, as a power of two.
    high_bits: u32,
    /// Input pixels (x, then y) of the nodes, row by row, 16.16 fixed point.
    nodes: [Vec<i32>; 2],
    /// Lines through the input for the row that is drawn: starts (x, y), steps (x, y).
    lines: [Vec<i32>; KINDS],
}

/// How a plane's samples lie among luma's pixels, along x and y.
type Lattice = [warp::Axis; 2];

impl Warper {
    /// A warper for pictures whose 4:2:0 chroma is sited as given, with [`Border::Zoom`] for those that hide
    /// their border.
    pub fn new(params: &Params, level: Level, siting: Siting) -> Self {
        Self {
            level,
            siting,
            params: *params,
            border: Border::Zoom,
            columns: 0,
            wide_bits: NARROW_BITS,
            high_bits: LOW_BITS,
            nodes: Default::default(),
            lines: Default::default(),
        }
    }

    /// Takes new settings.
    pub fn set_params(&mut self, params: &Params) {
        self.params = *params;
    }

    /// Shows `border` where there is no picture, from now on.
    pub fn set_border(&mut self, border: Border) {
        self.border = border;
    }

    /// Draws `input` into `output`, each output pixel from where `map` says. Both must have the same chroma; the sizes may differ.
    /// Where the shapes differ, too, the bars beside the picture are black. Allocates only where the output's size grew.
    pub fn draw(&mut self, map: &OutputMap, input: PictureRef<'_>, output: &mut PictureMut<'_>) {
        let (width, height) = (output.width(), output.height());
        if width == 0 || height == 0 {
            return;
        }
        let shrunk = input.width() as f64 > SHRUNK * width as f64;
        let wider = WIDE_PICTURES.iter().filter(|&&least| width >= least && !shrunk).count();
        self.wide_bits = NARROW_BITS + wider as u32;
        self.high_bits = LOW_BITS + u32::from(height >= HIGH_PICTURE);
        self.map_nodes(map, [width, height]);
        let chroma = lattice(output.sampling, self.siting).filter(|_| input.sampling == output.sampling);
        let barred = width * input.height() != height * input.width();
        let outside = |black: u8| match self.border {
            // on its way from a border that showed
            Border::Zoom if !barred => warp::Outside::Mirror,
            Border::Mirror => warp::Outside::Mirror,
            Border::Zoom | Border::Black => warp::Outside::Value(black),
        };
        let (luma, colour) = (outside(BLACK[0]), outside(BLACK[1]));
        let [y, u, v] = &mut output.planes;
        let [from_y, from_u, from_v] = input.planes;
        let sharp = width * height <= SHARP_PIXELS && !shrunk;
        let filter = self.params.filter.unwrap_or(if sharp { Filter::Bicubic } else { Filter::Bilinear });
        self.draw_planes(Lattice::default(), (luma, filter), [(from_y, y)]);
        match chroma {
            Some(chroma) => self.draw_planes(chroma, (colour, Filter::Bilinear), [(from_u, u), (from_v, v)]),
            None => [u, v].into_iter().for_each(|plane| plane.fill(BLACK[1])),
        }
    }

    /// Asks `map` where the nodes come from.
    fn map_nodes(&mut self, map: &OutputMap, [width, height]: [usize; 2]) {
        self.columns = width.div_ceil(1 << self.wide_bits) + 1;
        let rows = height.div_ceil(1 << self.high_bits) + 1;
        self.nodes.iter_mut().for_each(|nodes| nodes.resize(self.columns * rows, 0));
        self.lines.iter_mut().for_each(|lines| lines.resize(self.columns - 1, 0));
        let [xs, ys] = &mut self.nodes;
        let rows = xs.chunks_exact_mut(self.columns).zip(ys.chunks_exact_mut(self.columns));
        let mesh = mesh(map);
        for (j, (xs, ys)) in rows.enumerate() {
            warp::nodes(self.level, &mesh, (j << self.high_bits) as f64, self.wide_bits, xs, ys);
        }
    }

    /// Draws planes whose samples lie as `lattice` says.
    fn draw_planes<const N: usize>(
        &mut self,
        lattice: Lattice,
        (outside, filter): (warp::Outside, Filter),
        mut planes: [(PlaneRef<'_>, &mut PlaneMut<'_>); N],
    ) {
        let [along, down] = lattice;
        let rows = planes.iter().map(|(_, to)| to.height()).max().unwrap_or(0);
        let wide = 1 << (self.wide_bits - u32::from(along.halved));
        let last = self.nodes[0].len() / self.columns - 2;
        for y in 0..rows {
            // in half pixels of luma
            let twice = (y << (1 + u32::from(down.halved))) + usize::from(down.between);
            let row = (twice >> (self.high_bits + 1)).min(last);
            let part = (twice - (row << (self.high_bits + 1))) as i32;
            let [start_x, start_y, step_x, step_y] = &mut self.lines;
            for (axis, start, step) in [(0, &mut *start_x, &mut *step_x), (1, &mut *start_y, &mut *step_y)] {
                let (above, below) = self.nodes[axis][row * self.columns..(row + 2) * self.columns].split_at(self.columns);
                let between = warp::Between { above, below, part, part_bits: self.high_bits + 1, wide_bits: self.wide_bits };
                warp::lines(self.level, between, lattice[axis], along, start, step);
            }
            let cells = warp::Cells { start: [start_x, start_y], step: [step_x, step_y], wide, outside, filter };
            let from = planes.each_ref().map(|(from, _)| *from);
            let to = planes.each_mut().map(|(_, to)| if y < to.height() { to.row_mut(y) } else { &mut [] });
            warp::rows(self.level, from, cells, to);
        }
    }
}

/// How chroma's samples lie; `None` where there are none.
fn lattice(sampling: Sampling, siting: Siting) -> Option<Lattice> {
    let shift = sampling.shift()?;
    let between = match (sampling, siting) {
        (Sampling::S420, Siting::Centre) => [true, true],
        (Sampling::S420, Siting::Left) => [false, true],
        _ => [false, false],
    };
    Some([warp::Axis { halved: shift.0 > 0, between: between[0] }, warp::Axis { halved: shift.1 > 0, between: between[1] }])
}

#[cfg(test)]
mod tests;
