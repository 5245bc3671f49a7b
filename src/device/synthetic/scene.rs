//! What the synthetic camera looks at: a far, painted wall, made up from a seed, a drawn room ([`super::room`]), or printed rectangles
//! ([`super::patterns`]).
//!
//! The wall: clouds of several sizes, and on them thousands of rectangles and discs in all sizes, most of them upright, so that there are
//! corners wherever and from however far one looks. Edges are softened over about two texels, so that the wall may be sampled at a
//! fraction of a texel.

use super::{patterns, room};
use crate::random::{SplitMix, mix};

/// Luma texels in a row.
const WIDTH: usize = 2048;

/// Luma rows.
const HEIGHT: usize = 1536;

/// A plane of the wall, mirrored past its edges.
#[derive(Clone, Debug)]
pub(super) struct Texture {
    texels: Vec<u8>,
    width: usize,
    height: usize,
}

/// The wall: luma, and U and V at half the resolution, a chroma texel in the midst of four luma texels.
#[derive(Clone, Debug)]
pub(super) struct Scene {
    pub(super) luma: Texture,
    pub(super) chroma: [Texture; 2],
}

impl Scene {
    /// Luma coordinates of the middle.
    pub(super) const CENTRE: [f64; 2] = [(WIDTH - 1) as f64 / 2.0, (HEIGHT - 1) as f64 / 2.0];

    /// Paints the wall of `seed`.
    pub(super) fn new(seed: u64) -> Self {
        let mut luma = Canvas::clouds(WIDTH, HEIGHT, seed, &[(420.0, 45.0), (130.0, 25.0), (37.0, 14.0)], 120.0);
        let octaves = [(300.0, 10.0), (90.0, 5.0)];
        let mut u = Canvas::clouds(WIDTH / 2, HEIGHT / 2, seed ^ 1, &octaves, 128.0);
        let mut v = Canvas::clouds(WIDTH / 2, HEIGHT / 2, seed ^ 2, &octaves, 128.0);
        let mut random = SplitMix::new(seed ^ 0x0073_6365_6e65);
        for (count, smallest, largest) in [(140, 40.0, 150.0), (900, 12.0, 45.0), (7000, 3.0, 11.0)] {
            for _ in 0..count {
                let shape = Shape::new(&mut random, smallest, largest);
                luma.paint(&shape, 1.0, random.uniform(24.0, 228.0) as f32);
                // Small things are not coloured: a chroma texel is as large as they are.
                if smallest > 10.0 {
                    u.paint(&shape, 0.5, random.uniform(108.0, 148.0) as f32);
                    v.paint(&shape, 0.5, random.uniform(108.0, 148.0) as f32);
                }
            }
        }
        luma.add_clouds(seed ^ 3, 9.0, 8.0);
        Self { luma: luma.finish(), chroma: [u.finish(), v.finish()] }
    }

    /// Draws the room for a camera of `width` pixels.
    pub(super) fn room(width: u32, seed: u64) -> Self {
        let mut painter = Painter::new(seed);
        room::draw(&mut painter, width, seed);
        let [mut luma, u, v] = painter.0;
        // Nothing real is of one tone.
        luma.add_clouds(seed, 180.0, 5.0);
        luma.add_clouds(seed ^ 1, 7.0, 3.0);
        Self { luma: luma.finish(), chroma: [u.finish(), v.finish()] }
    }

    /// Draws the printed rectangles for a camera of `width` pixels.
    pub(super) fn patterns(width: u32, seed: u64) -> Self {
        let mut painter = Painter::new(seed);
        patterns::draw(&mut painter, width, seed);
        let [luma, u, v] = painter.0;
        Self { luma: luma.finish(), chroma: [u.finish(), v.finish()] }
    }
}

/// Paints shapes in colour: luma, U and V.
pub(super) struct Painter([Canvas; 3]);

impl Painter {
    fn new(seed: u64) -> Self {
        Self([WIDTH, WIDTH / 2, WIDTH / 2].map(|width| Canvas::clouds(width, width / 4 * 3, seed, &[], 128.0)))
    }

    /// The middle, in luma texels.
    pub(super) fn middle(&self) -> [f64; 2] {
        Scene::CENTRE
    }

    /// Paints a shape about `centre` (luma texels), turned by `angle` (radians, clockwise), in red, green and blue (0 to 255).
    pub(super) fn paint(&mut self, outline: Outline, centre: [f64; 2], half: [f64; 2], angle: f64, [r, g, b]: [f64; 3]) {
        let (sin, cos) = angle.sin_cos();
        let [centre, half, direction] = [centre, half, [cos, sin]].map(|pair| pair.map(|value| value as f32));
        let shape = Shape { centre, half, direction, outline };
        // BT.601 with limited range.
        let y = 16.0 + (65.481 * r + 128.553 * g + 24.966 * b) / 255.0;
        let u = 128.0 + (-37.797 * r - 74.203 * g + 112.0 * b) / 255.0;
        let v = 128.0 + (112.0 * r - 93.786 * g - 18.214 * b) / 255.0;
        for ((canvas, scale), value) in self.0.iter_mut().zip([1.0, 0.5, 0.5]).zip([y, u, v]) {
            canvas.paint(&shape, scale, value as f32);
        }
    }
}

impl Texture {
    /// Samples a row of points bilinearly: point `n` lies at `(x[n], y[n])`, texel centres at whole numbers.
    pub(super) fn sample(&self, x: &[f32], y: &[f32], out: &mut [f32]) {
        let inside = |v: f32, size: usize| v >= 0.0 && v < (size - 1) as f32;
        for ((&x, &y), out) in x.iter().zip(y).zip(out) {
            let (column, row) = (x.floor(), y.floor());
            let (fx, fy) = (x - column, y - row);
            let four = if inside(x, self.width) && inside(y, self.height) {
                let at = row as usize * self.width + column as usize;
                let (above, below) = (&self.texels[at..at + 2], &self.texels[at + self.width..at + self.width + 2]);
                [above[0], above[1], below[0], below[1]]
            } else {
                let (c, r) = (column as i64, row as i64);
                [self.mirrored(c, r), self.mirrored(c + 1, r), self.mirrored(c, r + 1), self.mirrored(c + 1, r + 1)]
            };
            let [a, b, c, d] = four.map(f32::from);
            let (above, below) = (a + fx * (b - a), c + fx * (d - c));
            *out = above + fy * (below - above);
        }
    }

    fn mirrored(&self, column: i64, row: i64) -> u8 {
        let fold = |n: i64, size: usize| {
            let period = 2 * size as i64 - 2;
            let n = n.rem_euclid(period);
            n.min(period - n) as usize
        };
        self.texels[fold(row, self.height) * self.width + fold(column, self.width)]
    }
}

/// The form of a shape.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Outline {
    Rectangle,
    /// As wide as high.
    Disc,
    Oval,
}

/// A shape, in luma texels.
struct Shape {
    centre: [f32; 2],
    half: [f32; 2],
    direction: [f32; 2],
    outline: Outline,
}

impl Shape {
    fn new(random: &mut SplitMix, smallest: f64, largest: f64) -> Self {
        // Most stand upright, as what people build does: so one sees a picture lean.
        let upright = !random.bits().is_multiple_of(4);
        let (sin, cos) = if upright { (0.0, 1.0) } else { random.uniform(0.0, std::f64::consts::TAU).sin_cos() };
        let size = |random: &mut SplitMix| random.uniform(smallest, largest) as f32;
        Self {
            centre: [random.uniform(0.0, WIDTH as f64) as f32, random.uniform(0.0, HEIGHT as f64) as f32],
            half: [size(random), size(random)],
            direction: [cos as f32, sin as f32],
            outline: if random.bits().is_multiple_of(4) { Outline::Disc } else { Outline::Rectangle },
        }
    }
}

/// A plane while it is painted.
struct Canvas {
    texels: Vec<f32>,
    width: usize,
    height: usize,
}

impl Canvas {
    fn clouds(width: usize, height: usize, seed: u64, octaves: &[(f32, f32)], mean: f32) -> Self {
        let mut canvas = Self { texels: vec![mean; width * height], width, height };
        for (n, &(cell, amplitude)) in octaves.iter().enumerate() {
            canvas.add_clouds(seed.wrapping_add(100 * n as u64), cell, amplitude);
        }
        canvas
    }

    /// Adds value noise: a random value within `-amplitude` to `amplitude` in each cell's corner, smoothly between them.
    fn add_clouds(&mut self, seed: u64, cell: f32, amplitude: f32) {
        let corner = |x: usize, y: usize| {
            let bits = mix(mix(seed ^ 0x636c_6f75_6473).wrapping_add((y as u64) << 32 | x as u64));
            ((bits >> 40) as f32 / (1 << 23) as f32 - 1.0) * amplitude
        };
        let smooth = |t: f32| t * t * (3.0 - 2.0 * t);
        let cells = (self.width as f32 / cell) as usize + 2;
        let (mut above, mut below) = (vec![0.0; cells], vec![0.0; cells]);
        let mut known = usize::MAX;
        for (y, row) in self.texels.chunks_exact_mut(self.width).enumerate() {
            let cell_row = (y as f32 / cell) as usize;
            if cell_row != known {
                known = cell_row;
                above = (0..cells).map(|x| corner(x, cell_row)).collect();
                below = (0..cells).map(|x| corner(x, cell_row + 1)).collect();
            }
            let fy = smooth(y as f32 / cell - cell_row as f32);
            for (x, texel) in row.iter_mut().enumerate() {
                let place = x as f32 / cell;
                let (left, fx) = (place as usize, smooth(place.fract()));
                let (a, b) =
                    (above[left] + fx * (above[left + 1] - above[left]), below[left] + fx * (below[left + 1] - below[left]));
                *texel += a + fy * (b - a);
            }
        }
    }

    /// Paints a shape, `scale` texels of this plane to one of luma.
    fn paint(&mut self, shape: &Shape, scale: f32, value: f32) {
        let [half_x, half_y] = shape.half.map(|h| h * scale);
        // A chroma texel's centre lies half a luma texel further on.
        let [cx, cy] = shape.centre.map(|c| (c + 0.5) * scale - 0.5);
        let [cos, sin] = shape.direction;
        let reach = half_x.hypot(half_y) + 2.0;
        let span = |c: f32, size: usize| (c - reach).max(0.0) as usize..((c + reach + 1.0).max(0.0) as usize).min(size);
        for y in span(cy, self.height) {
            for x in span(cx, self.width) {
                let (dx, dy) = (x as f32 - cx, y as f32 - cy);
                let (along, across) = ((cos * dx + sin * dy).abs(), (cos * dy - sin * dx).abs());
                let distance = match shape.outline {
                    Outline::Disc => dx.hypot(dy) - half_x,
                    Outline::Rectangle => (along - half_x).max(across - half_y),
                    // Near enough at the edge.
                    Outline::Oval => ((along / half_x).hypot(across / half_y) - 1.0) * half_x.min(half_y),
                };
                let cover = (0.5 - distance / 1.5).clamp(0.0, 1.0);
                let texel = &mut self.texels[y * self.width + x];
                *texel += cover * (value - *texel);
            }
        }
    }

    /// Softens by (1 2 1) / 4 in both directions and rounds.
    fn finish(self) -> Texture {
        let (w, h) = (self.width, self.height);
        let soft = |a: f32, b: f32, c: f32| (a + 2.0 * b + c) / 4.0;
        let mut texels = Vec::with_capacity(w * h);
        let mut columns = vec![0.0; w];
        for y in 0..h {
            let row = |y: usize| &self.texels[y * w..][..w];
            let (above, here, below) = (row(y.saturating_sub(1)), row(y), row((y + 1).min(h - 1)));
            for (x, out) in columns.iter_mut().enumerate() {
                *out = soft(above[x], here[x], below[x]);
            }
            for x in 0..w {
                let value = soft(columns[x.saturating_sub(1)], columns[x], columns[(x + 1).min(w - 1)]);
                texels.push((value + 0.5).clamp(16.0, 240.0) as u8);
            }
        }
        Texture { texels, width: w, height: h }
    }
}
