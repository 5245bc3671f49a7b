//! Pixel loops with any parameters on memory between forbidden pages: every level does the same.

use crate::fenced::{Edge, Fenced};
use gimbald::image::{FromRgb, PictureMut, PictureRef, PixelFormat, PlaneMut, PlaneRef, Range, Sampling};
use gimbald::kernel::{Level, convert, corner, lk, pyramid, warp};
use libfuzzer_sys::arbitrary::{Result, Unstructured};
use std::cell::RefCell;

const LEVELS: fn() -> [Level; 2] = || [Level::SCALAR, Level::best()];

thread_local! {
    static ROOMS: RefCell<[Fenced<u8>; 4]> = RefCell::new(std::array::from_fn(|_| Fenced::new(1 << 16)));
}

/// How a plane lies in memory.
#[derive(Clone, Copy, Debug)]
struct Shape {
    width: usize,
    height: usize,
    stride: usize,
    edge: Edge,
}

impl Shape {
    fn any(bytes: &mut Unstructured<'_>) -> Result<Self> {
        let (width, height) = (bytes.int_in_range(1..=150)?, bytes.int_in_range(1..=60)?);
        let stride = width + bytes.int_in_range(0..=20)?;
        Ok(Self { width, height, stride, edge: *bytes.choose(&[Edge::End, Edge::Start])? })
    }

    fn len(self) -> usize {
        if self.width == 0 || self.height == 0 { 0 } else { (self.height - 1) * self.stride + self.width }
    }

    fn plane(self, room: &mut Fenced<u8>, seed: u32) -> PlaneRef<'_> {
        let noise = |i: usize| (i as u32 ^ seed).wrapping_mul(2_654_435_761).rotate_right(seed % 32) as u8;
        let samples = room.filled(self.edge, self.len(), noise);
        PlaneRef::new(samples, self.width, self.height, self.stride).expect("as long as its shape asks")
    }

    fn canvas(self, room: &mut Fenced<u8>) -> PlaneMut<'_> {
        let samples = room.filled(self.edge, self.len(), |_| 0xaa);
        PlaneMut::new(samples, self.width, self.height, self.stride).expect("as long as its shape asks")
    }
}

/// One kernel, as the first bytes say.
pub fn kernels(data: &[u8]) {
    let mut bytes = Unstructured::new(data);
    ROOMS.with_borrow_mut(|rooms| {
        let _ = match bytes.int_in_range(0..=5) {
            Ok(0 | 1) => rows(&mut bytes, rooms),
            Ok(2) => patches(&mut bytes, rooms),
            Ok(3) => halves(&mut bytes, rooms),
            Ok(4) => corners(&mut bytes, rooms),
            _ => packing(&mut bytes, rooms),
        };
    });
}

fn rows(bytes: &mut Unstructured<'_>, [from, to, other, beside]: &mut [Fenced<u8>; 4]) -> Result<()> {
    let shape = Shape::any(bytes)?;
    let wide = *bytes.choose(&[16, 32, 64, 16, 32, 64, 1, 5, 17])?;
    let filter = *bytes.choose(&[warp::Filter::Bilinear, warp::Filter::Bicubic])?;
    let outside = *bytes.choose(&[warp::Outside::Mirror, warp::Outside::Value(77)])?;
    let short = bytes.int_in_range(0..=wide - 1)?;
    // within the plane, where octets are drawn, unless anything goes
    let tame = bytes.ratio(3, 4)?;
    let seed: u32 = bytes.arbitrary()?;
    let planes = [shape.plane(from, seed), shape.plane(other, !seed)];
    let mut numbers: [Vec<i32>; 4] = Default::default();
    let size = [shape.width as i32, shape.height as i32];
    for _ in 0..bytes.int_in_range(1..=70)? {
        for axis in 0..2 {
            let (start, step): (i32, i32) = if tame {
                let step = if axis == 0 { bytes.int_in_range(0..=115_000)? } else { bytes.int_in_range(-8200..=8200)? };
                (bytes.int_in_range(-1000..=size[axis] << 16)?, step)
            } else {
                (bytes.arbitrary()?, bytes.arbitrary()?)
            };
            numbers[axis].push(start);
            numbers[2 + axis].push(step);
        }
        if bytes.is_empty() {
            break;
        }
    }
    let [xs, ys, dxs, dys] = &numbers;
    let cells = warp::Cells { start: [xs, ys], step: [dxs, dys], wide, outside, filter };
    let [plain, best] = LEVELS().map(|level| {
        let len = xs.len() * wide - short;
        let mut outs = [&mut *to, &mut *beside].map(|room| room.filled(shape.edge, len, |_| 0xaa));
        warp::rows(level, planes, cells, outs.each_mut().map(|out| &mut **out));
        outs.map(|out| out.to_vec())
    });
    assert_eq!(plain, best);
    Ok(())
}

fn coordinate(bytes: &mut Unstructured<'_>) -> Result<f32> {
    if bytes.ratio(1, 4)? { bytes.arbitrary() } else { Ok(bytes.int_in_range(-(40 << 10)..=200 << 10)? as f32 / 1024.0) }
}

fn patches(bytes: &mut Unstructured<'_>, [from, to, ..]: &mut [Fenced<u8>; 4]) -> Result<()> {
    let (first, second) = (Shape::any(bytes)?, Shape::any(bytes)?);
    let at = [coordinate(bytes)?, coordinate(bytes)?];
    let there = [coordinate(bytes)?, coordinate(bytes)?];
    let from = first.plane(from, bytes.arbitrary()?);
    let to = second.plane(to, bytes.arbitrary()?);
    fn compared<const N: usize>(from: PlaneRef<'_>, at: [f32; 2], to: PlaneRef<'_>, there: [f32; 2]) {
        let [plain, best] = LEVELS().map(|level| {
            let mut template = lk::Template::<N>::default();
            lk::expect(from, at, N);
            template.extract(level, from, at);
            let lk::Step { rhs, sum, square } = template.compare(level, to, there);
            let numbers = [rhs[0], rhs[1], sum, square, template.centroid[0], template.centroid[1]];
            (numbers.map(f32::to_bits), template.gauss_newton.map(f32::to_bits))
        });
        assert_eq!(plain, best, "{N}: {at:?} {there:?}");
    }
    match bytes.int_in_range(0..=2)? {
        0 => compared::<8>(from, at, to, there),
        1 => compared::<16>(from, at, to, there),
        _ => compared::<24>(from, at, to, there),
    }
    Ok(())
}

fn halves(bytes: &mut Unstructured<'_>, [from, to, ..]: &mut [Fenced<u8>; 4]) -> Result<()> {
    let shape = Shape::any(bytes)?;
    let shape = Shape { width: shape.width * bytes.int_in_range(1..=6)?, stride: shape.stride * 6, ..shape };
    let half = Shape {
        width: shape.width / 2,
        height: shape.height / 2,
        stride: shape.width / 2 + bytes.int_in_range(0..=9)?,
        ..shape
    };
    let plane = shape.plane(from, bytes.arbitrary()?);
    let [plain, best] = LEVELS().map(|level| {
        let mut canvas = half.canvas(to);
        pyramid::halve(level, plane, canvas.reborrow());
        canvas.as_ref().samples().to_vec()
    });
    assert_eq!(plain, best);
    Ok(())
}

fn corners(bytes: &mut Unstructured<'_>, [from, ..]: &mut [Fenced<u8>; 4]) -> Result<()> {
    let shape = Shape::any(bytes)?;
    let mut place = || if bytes.ratio(1, 8)? { bytes.arbitrary() } else { bytes.int_in_range(0..=100) };
    let (at, size) = ([place()?, place()?], [place()?, place()?]);
    let (plane, step) = (shape.plane(from, bytes.arbitrary()?), bytes.int_in_range(1..=9)?);
    let [plain, best] =
        LEVELS().map(|level| corner::strongest(level, plane, at, size, f32::NEG_INFINITY, |x, y| (x + y) % step == 0));
    assert_eq!(plain, best);
    Ok(())
}

fn packing(bytes: &mut Unstructured<'_>, [y, u, v, out]: &mut [Fenced<u8>; 4]) -> Result<()> {
    let sampling = *bytes.choose(&[Sampling::Mono, Sampling::S420, Sampling::S422, Sampling::S444])?;
    let format = *bytes.choose(&PixelFormat::ALL)?;
    let luma = Shape::any(bytes)?;
    let (width, height) = sampling.chroma_size(luma.width, luma.height);
    let chroma = Shape { width, height, stride: width + (luma.stride - luma.width), ..luma };
    let seed = bytes.arbitrary()?;
    let planes = [luma.plane(y, seed), chroma.plane(u, seed ^ 1), chroma.plane(v, seed ^ 2)];
    let picture = PictureRef { sampling, planes };
    let stride =
        (format.tight_stride(luma.width as u32) + bytes.int_in_range(0..=20)?).saturating_sub(bytes.int_in_range(0..=1)?);
    let len = format.frame_bytes(luma.height as u32, stride).unwrap_or(8).saturating_sub(bytes.int_in_range(0..=1)?);
    let [plain, best] = LEVELS().map(|level| {
        let out = out.filled(luma.edge, len, |_| 0xaa);
        (convert::pack(level, picture, format, stride, out), out.to_vec())
    });
    assert_eq!(plain, best);
    let frame = &*out.filled(luma.edge, plain.1.len(), |i| plain.1[i]);
    unpacking(bytes, luma, frame, [y, u, v])
}

/// What was packed, or anything else, as packed 4:2:2 and RGB.
fn unpacking(bytes: &mut Unstructured<'_>, luma: Shape, frame: &[u8], rooms: [&mut Fenced<u8>; 3]) -> Result<()> {
    let kind = bytes.int_in_range(0..=4)?;
    let width = if kind < 2 { 4 * luma.width.div_ceil(2) } else { 3 * luma.width };
    let stride = width + bytes.int_in_range(0..=20)?;
    let Some(from) = PlaneRef::new(frame, width, luma.height, stride) else { return Ok(()) };
    let (half, rows) = Sampling::S420.chroma_size(luma.width, luma.height);
    let chroma = Shape { width: half, height: rows, stride: half + 1, ..luma };
    let [y, u, v] = rooms;
    let matrix = FromRgb::new(*bytes.choose(&[Range::Limited, Range::Full])?);
    let [plain, best] = LEVELS().map(|level| {
        let planes = [luma.canvas(y), chroma.canvas(u), chroma.canvas(v)];
        let mut picture = PictureMut { sampling: Sampling::S420, planes };
        let into = picture.reborrow();
        match kind {
            0 => convert::packed_422(level, convert::LumaFirst::Yes, from, into),
            1 => convert::packed_422(level, convert::LumaFirst::No, from, into),
            2 => convert::rgb(level, convert::RgbOrder::Rgb, matrix, from, into),
            _ => convert::rgb(level, convert::RgbOrder::Bgr, matrix, from, into),
        }
        picture.as_ref().planes.map(|plane| plane.samples().to_vec())
    });
    assert_eq!(plain, best);
    Ok(())
}
