//! Where the nodes of the mesh come from: a homography, then the motion of the row that saw each.

use super::{FURTHEST, ONE};
use crate::geometry::ROW_ROUNDS;
use crate::kernel::{Level, dispatch};

/// Entries of the tables of poses; one more than there can be stretches between samples, so that no index is ever outside.
pub const TABLE: usize = 32;
/// Nodes found at a time.
const CHUNK: usize = 16;

/// The map of a mesh: a homography (row by row), and how rows move.
#[derive(Clone, Debug)]
pub struct Mesh {
    /// Takes output pixels to the frame at its reference time; with a lens, what a pinhole would show of the one to what it would show of
    /// the other.
    pub view: [f64; 9],
    /// The lens; `None` where it bends nothing.
    pub lens: Option<Lens>,
    /// Rows' motion; `None` where they have none.
    pub rows: Option<RowTable>,
}

/// A lens that bends: what is seen at p from its centre, a pinhole would show at p / (1 + bend |p|^2).
#[derive(Clone, Debug)]
pub struct Lens {
    /// Takes output pixels to a picture of a lens that bends by `kept` (row by row).
    pub window: [f64; 9],
    /// Its centre, pixels.
    pub centre: [f64; 2],
    /// 1 / pixels^2.
    pub bend: f64,
    /// The bend that the output keeps, 1 / pixels^2: as much as the lens's, unless straight lines are drawn straight.
    pub kept: f64,
}

/// Motion of rows: yaw, pitch, roll and log zoom of a pinhole camera, on straight lines from sample to sample.
#[derive(Clone, Debug)]
pub struct RowTable {
    /// Each stretch's first value, by channel.
    pub base: [[f32; TABLE]; 4],
    /// What it grows by over the stretch.
    pub growth: [[f32; TABLE]; 4],
    /// Stretches there are, at most [`TABLE`].
    pub stretches: usize,
    /// Stretches to a row of the picture.
    pub per_row: f32,
    /// Focal length, pixels.
    pub focal: f32,
    /// Principal point, pixels.
    pub centre: [f32; 2],
    /// What the lens bends ([`Lens::bend`]).
    pub bend: f32,
}

/// Finds the nodes of the mesh's row at output row `y`: every 2^`wide_bits` pixels one, input pixels in 16.16 fixed point, rounded
/// towards 0, within [`FURTHEST`]; what is no number becomes 0.
pub fn nodes(level: Level, mesh: &Mesh, y: f64, wide_bits: u32, xs: &mut [i32], ys: &mut [i32]) {
    dispatch!(level, nodes_body(mesh: &Mesh, y: f64, wide_bits: u32, xs: &mut [i32], ys: &mut [i32]))
}

#[inline(always)]
fn nodes_body(mesh: &Mesh, y: f64, wide_bits: u32, xs: &mut [i32], ys: &mut [i32]) {
    let wide = f64::from(1u32 << wide_bits);
    for (n, (xs, ys)) in xs.chunks_mut(CHUNK).zip(ys.chunks_mut(CHUNK)).enumerate() {
        let (mut at_x, mut at_y) = ([0.0f64; CHUNK], [y; CHUNK]);
        for k in 0..CHUNK {
            at_x[k] = (n * CHUNK + k) as f64 * wide;
        }
        if let Some(lens) = &mesh.lens {
            project(&lens.window, &mut at_x, &mut at_y);
            straighten(lens, &mut at_x, &mut at_y);
        }
        project(&mesh.view, &mut at_x, &mut at_y);
        if let Some(lens) = &mesh.lens {
            bend(lens, &mut at_x, &mut at_y);
        }
        let (mut moved_x, mut moved_y) = ([0.0f32; CHUNK], [0.0f32; CHUNK]);
        if let Some(rows) = &mesh.rows {
            for _ in 0..ROW_ROUNDS {
                round(rows, &at_x, &at_y, &mut moved_x, &mut moved_y);
            }
        }
        for k in 0..CHUNK {
            at_x[k] += f64::from(moved_x[k]);
            at_y[k] += f64::from(moved_y[k]);
        }
        xs.iter_mut().zip(at_x).for_each(|(to, x)| *to = fixed(x));
        ys.iter_mut().zip(at_y).for_each(|(to, y)| *to = fixed(y));
    }
}

/// Applies a homography.
#[inline(always)]
fn project(&[a, b, c, d, e, f, g, h, i]: &[f64; 9], at_x: &mut [f64; CHUNK], at_y: &mut [f64; CHUNK]) {
    for k in 0..CHUNK {
        let (x, y) = (at_x[k], at_y[k]);
        let w = g * x + h * y + i;
        at_x[k] = (a * x + b * y + c) / w;
        at_y[k] = (d * x + e * y + f) / w;
    }
}

/// From what the output shows of the lens to what a pinhole would show.
#[inline(always)]
fn straighten(lens: &Lens, at_x: &mut [f64; CHUNK], at_y: &mut [f64; CHUNK]) {
    let [cx, cy] = lens.centre;
    for k in 0..CHUNK {
        let (u, v) = (at_x[k] - cx, at_y[k] - cy);
        let scale = 1.0 / (1.0 + lens.kept * (u * u + v * v));
        at_x[k] = cx + scale * u;
        at_y[k] = cy + scale * v;
    }
}

/// From what a pinhole would show to what the lens does.
#[inline(always)]
fn bend(lens: &Lens, at_x: &mut [f64; CHUNK], at_y: &mut [f64; CHUNK]) {
    let [cx, cy] = lens.centre;
    for k in 0..CHUNK {
        let (u, v) = (at_x[k] - cx, at_y[k] - cy);
        let scale = 2.0 / (1.0 + (1.0 - 4.0 * lens.bend * (u * u + v * v)).max(0.0).sqrt());
        at_x[k] = cx + scale * u;
        at_y[k] = cy + scale * v;
    }
}

/// One round: the pose of the row that was found last, and how far it moves each point.
#[inline(always)]
fn round(rows: &RowTable, x: &[f64; CHUNK], y: &[f64; CHUNK], moved_x: &mut [f32; CHUNK], moved_y: &mut [f32; CHUNK]) {
    let last = rows.stretches.clamp(1, TABLE) as f32;
    let per_focal = 1.0 / rows.focal;
    let mut stretch = [0usize; CHUNK];
    let mut part = [0.0f32; CHUNK];
    for k in 0..CHUNK {
        // what is no number becomes 0 here
        let place = ((y[k] as f32 + moved_y[k]) * rows.per_row).max(0.0).min(last);
        // SAFETY: `place` is a number from 0 to `TABLE`.
        let whole = unsafe { place.min(last - 1.0).to_int_unchecked::<i32>() };
        stretch[k] = whole as usize & (TABLE - 1);
        part[k] = place - whole as f32;
    }
    let mut pose = [[0.0f32; CHUNK]; 4];
    for c in 0..4 {
        for k in 0..CHUNK {
            pose[c][k] = rows.base[c][stretch[k]] + rows.growth[c][stretch[k]] * part[k];
        }
    }
    for k in 0..CHUNK {
        // the derivative of a pixel by the pose, half way: of what a pinhole would show, then through the lens
        let bent_u = x[k] as f32 + 0.5 * moved_x[k] - rows.centre[0];
        let bent_v = y[k] as f32 + 0.5 * moved_y[k] - rows.centre[1];
        let square = bent_u * bent_u + bent_v * bent_v;
        let inverse = 1.0 + rows.bend * square;
        let scale = 1.0 / inverse;
        let (u, v) = (bent_u * scale, bent_v * scale);
        let (a, b) = (u * per_focal, v * per_focal);
        let [yaw, pitch, roll, zoom] = [pose[0][k], pose[1][k], pose[2][k], pose[3][k]];
        let straight_x = u * b * pitch - (rows.focal + u * a) * yaw + v * roll + u * zoom;
        let straight_y = (rows.focal + v * b) * pitch - u * b * yaw - u * roll + v * zoom;
        let slope = 2.0 * rows.bend * scale;
        let along = slope / (1.0 - slope * square) * (bent_u * straight_x + bent_v * straight_y);
        moved_x[k] = (straight_x + bent_u * along) * inverse;
        moved_y[k] = (straight_y + bent_v * along) * inverse;
    }
}

/// 16.16 fixed point.
#[inline(always)]
fn fixed(value: f64) -> i32 {
    ((value * f64::from(ONE)) as i32).clamp(-FURTHEST, FURTHEST)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_level_finds_the_same_nodes_even_of_nonsense() {
        let table = |value: f32| std::array::from_fn(|c| std::array::from_fn(|i| value * ((i * 7 + c * 3) as f32 % 5.0 - 2.0)));
        let rows = |value: f32, per_row: f32| RowTable {
            base: table(value),
            growth: table(0.1 * value),
            stretches: 24,
            per_row,
            focal: 500.0,
            centre: [320.0, 240.0],
            bend: -1e-6 * value,
        };
        let lens = |bend: f64| {
            Some(Lens { window: [0.9, 0.0, 30.0, 0.0, 0.9, 20.0, 0.0, 0.0, 1.0], centre: [320.0, 240.0], bend, kept: bend })
        };
        let views = [
            [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
            [0.9, 0.01, 30.0, -0.01, 0.9, 20.0, 1e-5, -1e-5, 1.0],
            [f64::NAN; 9],
            [1e300, 0.0, 0.0, 0.0, -1e300, 0.0, 0.0, 0.0, 0.0],
        ];
        for (view, rows) in views.into_iter().flat_map(|view| {
            [None, Some(rows(0.01, 0.05)), Some(rows(f32::NAN, 0.05)), Some(rows(1e30, f32::INFINITY))].map(|rows| (view, rows))
        }) {
            for (lens, columns) in [None, lens(-1e-6), lens(1e-4), lens(f64::NAN)]
                .into_iter()
                .flat_map(|lens| [1, 15, 41].map(|n| (lens.clone(), n)))
            {
                let mesh = Mesh { view, lens, rows: rows.clone() };
                let found: Vec<_> = Level::all()
                    .map(|level| {
                        let (mut xs, mut ys) = (vec![7; columns], vec![7; columns]);
                        nodes(level, &mesh, 24.0, 4, &mut xs, &mut ys);
                        (xs, ys)
                    })
                    .collect();
                assert!(found.windows(2).all(|pair| pair[0] == pair[1]));
                assert!(found[0].0.iter().chain(&found[0].1).all(|value| value.abs() <= FURTHEST));
            }
        }
    }
}
