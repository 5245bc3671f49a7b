//! Unpacking and packing at the edges of memory.

use super::{Edge, Fenced, MAX, Random, Shape};
use crate::image::{FromRgb, PictureMut, PictureRef, PixelFormat, PlaneMut, Range, Sampling, ToLimited};
use crate::kernel::Level;
use crate::kernel::convert::{
    LumaFirst, PackError, RgbOrder, interleaved, pack, packed_422, rgb, thin, to_420, to_limited, to_limited_in_place,
};

const SAMPLINGS: [Sampling; 4] = [Sampling::Mono, Sampling::S420, Sampling::S422, Sampling::S444];

/// Room for the largest plane: three bytes a pixel, padding.
fn room() -> Fenced<u8> {
    Fenced::new((3 * MAX + 8) * (MAX + 1))
}

/// Rooms for the planes of a picture.
struct Rooms([Fenced<u8>; 3]);

impl Rooms {
    fn new() -> Self {
        Self([room(), room(), room()])
    }

    /// The planes' shapes in a picture whose luma has `shape`.
    fn shapes(shape: Shape, sampling: Sampling) -> [Shape; 3] {
        let (width, height) = sampling.chroma_size(shape.width, shape.height);
        let chroma = Shape { width, height, stride: width + (shape.stride - shape.width), ..shape };
        [shape, chroma, chroma]
    }

    fn noise<'a>(&'a mut self, shape: Shape, sampling: Sampling, random: &mut Random) -> PictureRef<'a> {
        let mut shapes = Self::shapes(shape, sampling).into_iter();
        let planes = self.0.each_mut().map(|room| shapes.next().expect("three").plane(room, random));
        PictureRef { sampling, planes }
    }

    /// What `draw` makes of a picture.
    fn drawn(&mut self, shape: Shape, sampling: Sampling, draw: impl FnOnce(PictureMut<'_>)) -> Vec<u8> {
        let mut shapes = Self::shapes(shape, sampling).into_iter();
        let planes = self.0.each_mut().map(|room| {
            let Shape { width, height, stride, edge } = shapes.next().expect("three");
            let len = Shape { width, height, stride, edge }.len();
            PlaneMut::new(room.filled(edge, len, |_| 0xaa), width, height, stride).expect("as long as its shape asks")
        });
        let mut picture = PictureMut { sampling, planes };
        draw(picture.reborrow());
        picture.as_ref().planes.map(|plane| plane.samples().to_vec()).concat()
    }
}

/// Every level finds the same.
fn levels_agree(shape: Shape, what: &str, mut found: impl FnMut(Level) -> Vec<u8>) {
    let first = found(Level::SCALAR);
    Level::all().for_each(|level| assert_eq!(first, found(level), "{what} {shape:?}"));
}

#[test]
fn unpacking_stays_in_its_planes() {
    let mut random = Random::new(8);
    let (mut bytes, mut rooms) = (room(), Rooms::new());
    for shape in Shape::all() {
        // a plane of bytes, so many to a row
        let raw = |width: usize| Shape { width, stride: width + (shape.stride - shape.width), ..shape };
        let packed = raw(4 * shape.width.div_ceil(2)).plane(&mut bytes, &mut random);
        for order in [LumaFirst::Yes, LumaFirst::No] {
            levels_agree(shape, "4:2:2", |level| {
                rooms.drawn(shape, Sampling::S420, |into| packed_422(level, order, packed, into))
            });
        }
        let colours = raw(3 * shape.width).plane(&mut bytes, &mut random);
        for order in [RgbOrder::Rgb, RgbOrder::Bgr] {
            for range in [Range::Full, Range::Limited] {
                let matrix = FromRgb::new(range);
                levels_agree(shape, "RGB", |level| {
                    rooms.drawn(shape, Sampling::S420, |into| rgb(level, order, matrix, colours, into))
                });
            }
        }
        let pairs = raw(2 * shape.width).plane(&mut bytes, &mut random);
        levels_agree(shape, "pairs", |level| {
            rooms.drawn(shape, Sampling::S444, |into| {
                let [_, u, v] = into.planes;
                interleaved(level, pairs, u, v);
            })
        });
    }
}

#[test]
fn thinning_stays_in_its_planes() {
    let mut random = Random::new(9);
    let (mut from, mut into) = (room(), room());
    for shape in Shape::all() {
        let plane = shape.plane(&mut from, &mut random);
        for (x, y) in [(1, 1), (1, 2), (2, 1), (2, 2), (4, 1), (1, 4)] {
            // as many samples as the luma samples that these stand for ask of 4:2:0
            let (width, height) = ((shape.width * x).div_ceil(2), (shape.height * y).div_ceil(2));
            let half = Shape { width, height, stride: width + 1, ..shape };
            let mut drawn = |draw: &dyn Fn(PlaneMut<'_>)| {
                let samples = into.filled(shape.edge, half.len(), |_| 0xaa);
                draw(PlaneMut::new(samples, width, height, width + 1).expect("as long as its shape asks"));
                samples.to_vec()
            };
            levels_agree(shape, "4:2:0", |level| drawn(&|into| to_420(level, (x, y), plane, into)));
            levels_agree(shape, "thin", |level| drawn(&|into| thin(level, x == 1, y == 1, plane, into)));
        }
    }
}

#[test]
fn the_change_of_range_stays_in_its_planes() {
    let mut random = Random::new(11);
    let (mut from, mut into) = (room(), room());
    for shape in Shape::all() {
        let plane = shape.plane(&mut from, &mut random);
        let Shape { width, height, stride, .. } = shape;
        for map in [ToLimited::LUMA, ToLimited::CHROMA] {
            let mut drawn = |draw: &dyn Fn(PlaneMut<'_>)| {
                let samples = into.filled(shape.edge, shape.len(), |_| 0xaa);
                draw(PlaneMut::new(samples, width, height, stride).expect("as long as its shape asks"));
                samples.to_vec()
            };
            levels_agree(shape, "range", |level| drawn(&|into| to_limited(level, map, plane, into)));
            levels_agree(shape, "range in place", |level| drawn(&|into| to_limited_in_place(level, map, into)));
        }
    }
}

#[test]
fn packing_stays_in_its_bytes() {
    let mut random = Random::new(10);
    let (mut rooms, mut bytes) = (Rooms::new(), room());
    for (n, shape) in Shape::all().enumerate() {
        let sampling = SAMPLINGS[n / 4 % 4];
        let picture = rooms.noise(shape, sampling, &mut random);
        for format in PixelFormat::ALL {
            let stride = format.tight_stride(shape.width as u32) + random.below(4);
            let Some(len) = format.frame_bytes(shape.height as u32, stride) else { continue };
            let mut outcome = None;
            levels_agree(shape, &format.to_string(), |level| {
                let out = bytes.filled(shape.edge, len, |_| 0xaa);
                let packed = pack(level, picture, format, stride, out);
                assert_eq!(packed, *outcome.get_or_insert(packed));
                assert!(!matches!(packed, Err(PackError::TooSmall { .. })), "{format} {shape:?}");
                out.to_vec()
            });
            // a byte too few is none too many for the guard to notice
            let short = bytes.filled(Edge::End, len.saturating_sub(1), |_| 0xaa);
            let _ = pack(Level::best(), picture, format, stride, short);
        }
    }
}
