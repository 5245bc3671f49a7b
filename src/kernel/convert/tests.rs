//! Every conversion against a naive one, on odd sizes, with padding and canaries, at every level of this processor.

use super::*;
use crate::image::{
    FromRgb, Picture, PictureRef, PixelFormat, Plane, PlaneMut, PlaneRef, Range, RawLayout, Sampling, ToLimited,
};
use crate::kernel::Level;
use crate::random::Congruential;
use proptest::prelude::*;

const CANARY: u8 = 0xa5;

/// Samples with no pattern, extremes among them.
fn noise(seed: u64, len: usize) -> Vec<u8> {
    let mut generator = Congruential::new(seed | 1);
    let mut next = || generator.byte();
    (0..len).map(|_| [0, 255, next(), next()][usize::from(next()) & 3]).collect()
}

fn picture(sampling: Sampling, width: usize, height: usize, seed: u64) -> Picture {
    let mut picture = Picture::new(sampling, width, height);
    for (n, mut plane) in picture.as_mut().planes.into_iter().enumerate() {
        for row in 0..plane.height() {
            let samples = noise(seed + (n * 1000 + row) as u64 * 77, plane.width());
            plane.row_mut(row).copy_from_slice(&samples);
        }
    }
    picture
}

/// Mean of what lies at the given columns and rows of a plane, halves up, places past the edge left out.
fn naive_mean(plane: PlaneRef<'_>, columns: &[usize], rows: &[usize]) -> u8 {
    let mut sum = 0;
    let mut count = 0;
    for &row in rows.iter().filter(|&&r| r < plane.height()) {
        for &column in columns.iter().filter(|&&c| c < plane.width()) {
            sum += u32::from(plane.at(column, row));
            count += 1;
        }
    }
    ((2 * sum + count) / (2 * count)) as u8
}

/// Chroma of 2 x `rows` luma samples at chroma place (x, y).
fn naive_chroma(picture: PictureRef<'_>, plane: usize, (x, y): (usize, usize), rows: usize) -> u8 {
    let pair = |n: usize| [2 * n, 2 * n + 1];
    let plane = picture.planes[plane];
    match (picture.sampling, rows) {
        (Sampling::Mono, _) => 128,
        (Sampling::S420, 2) => plane.at(x, y),
        (Sampling::S420, _) => plane.at(x, y / 2),
        (Sampling::S422, 2) => naive_mean(plane, &[x], &pair(y)),
        (Sampling::S422, _) => plane.at(x, y),
        (Sampling::S444, 2) => naive_mean(plane, &pair(x), &pair(y)),
        (Sampling::S444, _) => naive_mean(plane, &pair(x), &[y]),
    }
}

fn samplings() -> impl Strategy<Value = Sampling> {
    prop::sample::select(vec![Sampling::Mono, Sampling::S420, Sampling::S422, Sampling::S444])
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn packed_422_is_the_naive_one(w in 1u32..70, h in 1usize..9, pad in 0usize..9, seed: u64, uyvy: bool) {
        let (format, order) = if uyvy { (PixelFormat::Uyvy, LumaFirst::No) } else { (PixelFormat::Yuyv, LumaFirst::Yes) };
        let stride = format.tight_stride(w) + pad;
        let bytes = noise(seed, stride * h);
        let from = RawLayout::new(format, w, h as u32, stride).unwrap().planes(&bytes).unwrap()[0];
        let (luma, chroma) = if uyvy { (1, 0) } else { (0, 1) };
        for level in Level::all() {
            let mut into = Picture::new(Sampling::S420, w as usize, h);
            packed_422(level, order, from, into.as_mut());
            let into = into.as_ref();
            for y in 0..h {
                for x in 0..w as usize {
                    prop_assert_eq!(into.planes[0].at(x, y), from.at(2 * x + luma, y));
                    let at = 4 * (x / 2) + chroma;
                    let rows = [y / 2 * 2, y / 2 * 2 + 1];
                    prop_assert_eq!(into.planes[1].at(x / 2, y / 2), naive_mean(from, &[at], &rows));
                    prop_assert_eq!(into.planes[2].at(x / 2, y / 2), naive_mean(from, &[at + 2], &rows));
                }
            }
        }
    }

    #[test]
    fn thinning_is_the_naive_one(w in 1usize..70, h in 1usize..9, seed: u64, columns: bool, rows: bool) {
        let bytes = noise(seed, w * h);
        let from = PlaneRef::new(&bytes, w, h, w).unwrap();
        let step = |on: bool| if on { 2 } else { 1 };
        let (cw, ch) = (w.div_ceil(step(columns)), h.div_ceil(step(rows)));
        let list = |n: usize, on: bool| if on { vec![2 * n, 2 * n + 1] } else { vec![n] };
        for level in Level::all() {
            let mut into = Plane::new(cw, ch);
            thin(level, columns, rows, from, into.as_mut());
            for y in 0..ch {
                for x in 0..cw {
                    prop_assert_eq!(into.row(y)[x], naive_mean(from, &list(x, columns), &list(y, rows)));
                }
            }
        }
    }

    #[test]
    fn rgb_follows_bt601(w in 1u32..40, h in 1usize..7, pad in 0usize..5, seed: u64, bgr: bool) {
        let (format, order) = if bgr { (PixelFormat::Bgr24, RgbOrder::Bgr) } else { (PixelFormat::Rgb24, RgbOrder::Rgb) };
        let stride = format.tight_stride(w) + pad;
        let bytes = noise(seed, stride * h);
        let from = RawLayout::new(format, w, h as u32, stride).unwrap().planes(&bytes).unwrap()[0];
        let mut first: Option<Picture> = None;
        for level in Level::all() {
            let mut into = Picture::new(Sampling::S420, w as usize, h);
            rgb(level, order, FromRgb::new(Range::Full), from, into.as_mut());
            let w = w as usize;
            let at = |x: usize, y: usize, c: usize| f64::from(from.at(3 * x + if bgr { 2 - c } else { c }, y)) / 255.0;
            for y in 0..h {
                for x in 0..w {
                    let luma = 16.0 + 219.0 * (0.299 * at(x, y, 0) + 0.587 * at(x, y, 1) + 0.114 * at(x, y, 2));
                    prop_assert!((f64::from(into.luma().at(x, y)) - luma).abs() < 1.5);
                }
            }
            for y in 0..h.div_ceil(2) {
                for x in 0..w.div_ceil(2) {
                    let (x1, y1) = ((2 * x + 1).min(w - 1), (2 * y + 1).min(h - 1));
                    let m = |c| [(2 * x, 2 * y), (x1, 2 * y), (2 * x, y1), (x1, y1)].map(|(x, y)| at(x, y, c)).iter().sum::<f64>() / 4.0;
                    let (r, g, b) = (m(0), m(1), m(2));
                    let luma = 0.299 * r + 0.587 * g + 0.114 * b;
                    let planes = into.as_ref().planes;
                    prop_assert!((f64::from(planes[1].at(x, y)) - 128.0 - 224.0 * (b - luma) / 1.772).abs() < 1.5);
                    prop_assert!((f64::from(planes[2].at(x, y)) - 128.0 - 224.0 * (r - luma) / 1.402).abs() < 1.5);
                }
            }
            prop_assert_eq!(first.get_or_insert_with(|| into.clone()), &into);
        }
    }

    #[test]
    fn packing_is_the_naive_one(w in 1usize..40, h in 1usize..9, pad in 0usize..6, sampling in samplings(), seed in 0u64..1 << 40) {
        let picture = picture(sampling, w, h, seed);
        let p = picture.as_ref();
        for format in [PixelFormat::Yuyv, PixelFormat::Uyvy, PixelFormat::Nv12, PixelFormat::I420, PixelFormat::Grey] {
            let stride = format.tight_stride(w as u32) + pad;
            let len = format.frame_bytes(h as u32, stride).unwrap();
            let mut outcomes = Vec::new();
            for level in Level::all() {
                let mut bytes = vec![CANARY; len + 9];
                pack(level, p, format, stride, &mut bytes[..len]).unwrap();
                prop_assert!(bytes[len..].iter().all(|&b| b == CANARY));
                let layout = RawLayout::new(format, w as u32, h as u32, stride).unwrap();
                let [first, second, third] = layout.planes(&bytes[..len]).unwrap();
                if pad > 0 {
                    prop_assert_eq!(first.samples()[first.width()], CANARY, "padding is left alone");
                }
                for y in 0..h {
                    for x in 0..w {
                        let luma = p.planes[0].at(x, y);
                        let c = (x / 2, y);
                        let half = (x / 2, y / 2);
                        match format {
                            PixelFormat::Yuyv | PixelFormat::Uyvy => {
                                let (l, c0) = if format == PixelFormat::Yuyv { (0, 1) } else { (1, 0) };
                                prop_assert_eq!(first.at(2 * x + l, y), luma);
                                prop_assert_eq!(first.at(4 * (x / 2) + c0, y), naive_chroma(p, 1, c, 1));
                                prop_assert_eq!(first.at(4 * (x / 2) + c0 + 2, y), naive_chroma(p, 2, c, 1));
                                if w % 2 == 1 && x == w - 1 {
                                    prop_assert_eq!(first.at(2 * (x + 1) + l, y), luma);
                                }
                            }
                            PixelFormat::Nv12 => {
                                prop_assert_eq!(first.at(x, y), luma);
                                prop_assert_eq!(second.at(x / 2 * 2, y / 2), naive_chroma(p, 1, half, 2));
                                prop_assert_eq!(second.at(x / 2 * 2 + 1, y / 2), naive_chroma(p, 2, half, 2));
                            }
                            PixelFormat::I420 => {
                                prop_assert_eq!(first.at(x, y), luma);
                                prop_assert_eq!(second.at(x / 2, y / 2), naive_chroma(p, 1, half, 2));
                                prop_assert_eq!(third.at(x / 2, y / 2), naive_chroma(p, 2, half, 2));
                            }
                            _ => prop_assert_eq!(first.at(x, y), luma),
                        }
                    }
                }
                outcomes.push(bytes);
            }
            prop_assert!(outcomes.windows(2).all(|o| o[0] == o[1]), "levels agree");
        }
    }
}

#[test]
fn interleaved_chroma_comes_apart_and_rare_chroma_is_brought_to_420() {
    let bytes = [1, 2, 3, 4, 5, 6, 7, 8];
    for level in Level::all() {
        let (mut u, mut v) = (Plane::new(2, 2), Plane::new(2, 2));
        interleaved(level, PlaneRef::new(&bytes, 4, 2, 4).unwrap(), u.as_mut(), v.as_mut());
        assert_eq!((u.samples(), v.samples()), (&[1, 3, 5, 7][..], &[2, 4, 6, 8][..]));

        // 4:1:1 of 8 x 4: two samples a row, four rows.
        let mut into = Plane::new(4, 2);
        to_420(level, (4, 1), PlaneRef::new(&bytes, 2, 4, 2).unwrap(), into.as_mut());
        assert_eq!(into.samples(), &[2, 2, 3, 3, 6, 6, 7, 7]);
        // 4:4:1 of 4 x 8: four samples a row, two rows.
        let mut into = Plane::new(2, 4);
        to_420(level, (1, 4), PlaneRef::new(&bytes, 4, 2, 4).unwrap(), into.as_mut());
        assert_eq!(into.samples(), &[2, 4, 2, 4, 6, 8, 6, 8]);
    }
}

#[test]
fn a_widened_row_lies_where_its_samples_lay() {
    let from = [0, 100, 200, 40];
    let row = |width: usize, into: &mut [u8]| {
        widen(PlaneRef::new(&from, width, 1, 4).unwrap(), PlaneMut::new(into, into.len(), 1, 8).unwrap())
    };
    let mut into = [CANARY; 8];
    row(4, &mut into);
    assert_eq!(into, [0, 25, 75, 125, 175, 160, 80, 40]);
    for (width, columns) in [(4, 7), (1, 2), (1, 1), (0, 3)] {
        let mut odd = [CANARY; 8];
        row(width, &mut odd[..columns]);
        let expected: &[u8] = if width == 4 { &into[..7] } else { &[from[0]; 2][..columns.min(2)] };
        assert_eq!(&odd[..columns], if width == 0 { &[CANARY; 3][..] } else { expected });
        assert!(odd[columns..].iter().all(|&sample| sample == CANARY));
    }
}

#[test]
fn what_cannot_be_packed_says_why() {
    let picture = Picture::new(Sampling::S420, 4, 4);
    let mut bytes = [0; 23];
    let small = pack(Level::SCALAR, picture.as_ref(), PixelFormat::I420, 4, &mut bytes);
    assert!(matches!(small, Err(PackError::TooSmall { bytes: 23, .. })), "{small:?}");
    let narrow = pack(Level::SCALAR, picture.as_ref(), PixelFormat::Grey, 3, &mut bytes);
    assert!(matches!(narrow, Err(PackError::TooSmall { stride: 3, .. })));
    let never = pack(Level::SCALAR, picture.as_ref(), PixelFormat::Mjpeg, 0, &mut bytes).unwrap_err();
    assert_eq!(never.to_string(), "a S420 picture cannot be written as MJPG");
}

#[test]
fn every_sample_of_full_range_comes_to_its_place() {
    for (map, exact) in [(ToLimited::LUMA, [16.0, 219.0, 0.0]), (ToLimited::CHROMA, [128.0, 224.0, 128.0])] {
        for level in Level::all() {
            // Lines of every length, so that all values fall into whole vectors and into what is left of them.
            for width in (1..=40).chain([256, 300]) {
                let mut from = Plane::new(width, 256);
                for row in 0..256 {
                    from.as_mut().row_mut(row).iter_mut().enumerate().for_each(|(x, sample)| *sample = (row + x) as u8);
                }
                let (mut into, mut in_place) = (Plane::new(width, 256), from.clone());
                to_limited(level, map, from.as_ref(), into.as_mut());
                to_limited_in_place(level, map, in_place.as_mut());
                for row in 0..256 {
                    assert_eq!(into.row(row), in_place.row(row));
                    for (&got, &sample) in into.row(row).iter().zip(from.row(row)) {
                        let want = exact[0] + exact[1] / 255.0 * (f64::from(sample) - exact[2]);
                        assert!((f64::from(got) - want).abs() < 0.51, "{map:?} {sample}: {got}, {want} expected");
                    }
                }
            }
        }
    }
}
