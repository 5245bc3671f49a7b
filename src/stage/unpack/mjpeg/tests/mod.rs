//! JPEG pictures: whole, damaged, of every kind of chroma, as webcams send them.

mod webcams;

use super::super::{Unpack, UnpackError};
use super::*;
use crate::image::{PixelFormat, Range, Sampling};
use proptest::prelude::*;
use turbojpeg::{Colorspace, Compressor, Subsamp, YuvImage};

/// Every kind of chroma a JPEG can have.
const KINDS: [Subsamp; 7] =
    [Subsamp::None, Subsamp::Sub2x1, Subsamp::Sub2x2, Subsamp::Gray, Subsamp::Sub1x2, Subsamp::Sub4x1, Subsamp::Sub1x4];

/// A JPEG of smooth ramps: luma 40 + x + y, U 100 + x, V 150 - y (x, y in luma samples, halved).
fn ramps(width: usize, height: usize, subsamp: Subsamp) -> Vec<u8> {
    let mut image = YuvImage { pixels: Vec::new(), width, align: 1, height, subsamp };
    let (step_x, step_y) = subsamp.size();
    let push = |image: &mut YuvImage<Vec<u8>>, (w, h): (usize, usize), f: &dyn Fn(usize, usize) -> usize| {
        for y in 0..h {
            image.pixels.extend((0..w).map(|x| f(x, y) as u8));
        }
    };
    let size = image.y_size();
    push(&mut image, size, &|x, y| 40 + (x + y) / 2);
    if subsamp != Subsamp::Gray {
        let size = image.uv_size();
        push(&mut image, size, &|x, _| 100 + x * step_x / 2);
        push(&mut image, size, &|_, y| 150 - y * step_y / 2);
    }
    let mut compressor = Compressor::new().unwrap();
    compressor.set_quality(95).unwrap();
    compressor.set_subsamp(subsamp).unwrap();
    compressor.compress_yuv_to_vec(image.as_deref()).unwrap()
}

/// As [`ramps`], 4:2:2, with Huffman tables of its own.
fn optimized(width: usize, height: usize) -> Vec<u8> {
    let pixels: Vec<u8> = (0..width * height * 3).map(|n| (n / 3 % width * 3) as u8).collect();
    let image = turbojpeg::Image { pixels: &pixels[..], width, pitch: 3 * width, height, format: turbojpeg::PixelFormat::RGB };
    let mut compressor = Compressor::new().unwrap();
    compressor.set_optimize(true).unwrap();
    compressor.set_subsamp(Subsamp::Sub2x1).unwrap();
    compressor.compress_to_vec(image).unwrap()
}

/// Its segments up to its first scan.
fn segments(jpeg: &[u8]) -> Vec<&[u8]> {
    let (mut all, mut at) = (Vec::new(), 2);
    while jpeg[at + 1] != 0xda {
        let end = at + 2 + usize::from(u16::from_be_bytes([jpeg[at + 2], jpeg[at + 3]]));
        all.push(&jpeg[at..end]);
        at = end;
    }
    all
}

fn decode(unpack: &mut Unpack, size: (u32, u32), bytes: &[u8]) -> Result<Picture, UnpackError> {
    let mut picture = Picture::default();
    unpack.unpack(PixelFormat::Mjpeg, Range::Limited, size, 0, bytes, &mut picture).map(|()| picture)
}

/// Without its segments of that marker.
fn without(marker: u8, jpeg: &[u8]) -> Vec<u8> {
    let mut out = jpeg[..2].to_vec();
    let mut at = 2;
    while jpeg[at + 1] != 0xda {
        let len = 2 + usize::from(u16::from_be_bytes([jpeg[at + 2], jpeg[at + 3]]));
        if jpeg[at + 1] != marker {
            out.extend_from_slice(&jpeg[at..at + len]);
        }
        at += len;
    }
    out.extend_from_slice(&jpeg[at..]);
    assert!(out.len() < jpeg.len());
    out
}

#[test]
fn every_kind_of_chroma_becomes_420() {
    let mut unpack = Unpack::new();
    for (width, height) in [(64, 48), (33, 17), (1, 1), (50, 8), (16, 8)] {
        for kind in KINDS {
            let jpeg = ramps(width, height, kind);
            let picture = decode(&mut unpack, (width as u32, height as u32), &jpeg).unwrap();
            assert_eq!((picture.sampling(), picture.width(), picture.height()), (Sampling::S420, width, height));
            let [y, u, v] = picture.as_ref().planes;
            for row in 0..height {
                for column in 0..width {
                    let error = i32::from(y.at(column, row)) - (40 + (column + row) / 2) as i32;
                    assert!(error.abs() <= 3, "{kind:?} {width}x{height} luma {column},{row}: {error}");
                }
            }
            for row in 0..v.height() {
                for column in 0..u.width() {
                    let (want_u, want_v) = if kind == Subsamp::Gray { (128, 128) } else { (100 + column, 150 - row) };
                    let errors = (i32::from(u.at(column, row)) - want_u as i32, i32::from(v.at(column, row)) - want_v as i32);
                    assert!(errors.0.abs() <= 3 && errors.1.abs() <= 3, "{kind:?} {width}x{height} {column},{row}: {errors:?}");
                }
            }
        }
    }
}

#[test]
fn a_picture_without_huffman_tables_has_the_standard_ones_whatever_came_before() {
    let jpeg = ramps(64, 48, Subsamp::Sub2x1);
    let mut unpack = Unpack::new();
    let whole = decode(&mut unpack, (64, 48), &jpeg).unwrap();
    assert_eq!(decode(&mut unpack, (64, 48), &without(0xc4, &jpeg)).as_ref(), Ok(&whole));
    let optimized = optimized(64, 48);
    assert_ne!(without(0xc4, &optimized).len(), without(0xc4, &jpeg).len(), "its tables are others");
    decode(&mut unpack, (64, 48), &optimized).unwrap();
    assert_eq!(decode(&mut unpack, (64, 48), &without(0xc4, &jpeg)).as_ref(), Ok(&whole));
}

#[test]
fn the_standard_huffman_tables_are_those_of_other_encoders() {
    let jpeg = ramps(64, 48, Subsamp::Sub2x1);
    let own: Vec<u8> = segments(&jpeg).into_iter().filter(|segment| segment[1] == 0xc4).flatten().copied().collect();
    assert_eq!(own, standard::HUFFMAN_TABLES);
}

#[test]
fn a_picture_without_a_quantization_table_is_damaged_whatever_came_before() {
    for kind in KINDS {
        let jpeg = ramps(64, 48, kind);
        let mut unpack = Unpack::new();
        for _ in 0..2 {
            let error = decode(&mut unpack, (64, 48), &without(0xdb, &jpeg)).unwrap_err();
            assert!(error.to_string().contains("no quantization table"), "{error}");
            decode(&mut unpack, (64, 48), &jpeg).unwrap();
        }
        if kind == Subsamp::Gray {
            continue;
        }
        // One of its two.
        let chroma_alone = jpeg.windows(5).position(|w| w[..2] == [0xff, 0xdb] && w[4] == 1).unwrap();
        let mut renumbered = jpeg.clone();
        renumbered[chroma_alone + 4] = 3;
        let error = decode(&mut unpack, (64, 48), &renumbered).unwrap_err();
        assert!(error.to_string().contains("no quantization table"), "{error}");
    }
}

#[test]
fn many_stray_bytes_before_the_end_are_damage() {
    let mut jpeg = ramps(64, 48, Subsamp::Sub2x1);
    let end = jpeg.len() - 2;
    jpeg.splice(end..end, [0x56; 100]);
    let error = decode(&mut Unpack::new(), (64, 48), &jpeg).unwrap_err();
    assert!(error.to_string().contains("extraneous bytes"), "{error}");
}

/// A decoder that expects bytes without meaning removes them before it decodes, any other after a complaint: both must remove the same.
#[test]
fn stray_bytes_are_removed_alike_whatever_came_before() {
    let size = (48, 32);
    let whole = ramps(48, 32, Subsamp::Sub2x2);
    let with = |strays: &[u8]| [&whole[..whole.len() - 2], strays, &[0xff, 0xd9]].concat();
    let fresh = |bytes: &[u8]| decode(&mut Unpack::new(), size, bytes);
    let shown = decode(&mut Unpack::new(), size, &whole);
    for strays in [
        &[0xff, 0xff, 0][..],
        &[0xff, 0xff, 0xff, 0, 0, 7, 8],
        &[0xff, 0, 0xff, 0xff, 0, 9],
        &[0xff, 0xff, 0, 0xff, 0xd0, 5],
        &[3, 0xff, 0xff],
    ] {
        let mut expecting = Unpack::new();
        for _ in 0..2 {
            decode(&mut expecting, size, &with(&[1, 2, 3])).unwrap();
        }
        let bytes = with(strays);
        assert_eq!(decode(&mut expecting, size, &bytes), fresh(&bytes), "{strays:x?}");
        assert_eq!(fresh(&bytes), shown, "{strays:x?}");
    }
    // what a fuzzer found: a scan of one component that ends in 0xff ff ff ff 00, and two components with one identifier
    let found: [(_, &[u8]); 2] =
        [((17, 11), include_bytes!("strays-behind-fill.jpg")), ((3, 2), include_bytes!("duplicate-components.jpg"))];
    for (size_of_it, bytes) in found {
        let mut expecting = Unpack::new();
        for _ in 0..2 {
            decode(&mut expecting, size, &with(&[1, 2, 3])).unwrap();
        }
        let [expecting, fresh] = [expecting, Unpack::new()].map(|mut unpack| decode(&mut unpack, size_of_it, bytes));
        assert_eq!(expecting, fresh, "{size_of_it:?}");
    }
}

#[test]
fn a_header_that_is_a_little_larger_is_cropped() {
    let mut unpack = Unpack::new();
    for kind in KINDS {
        // 40 and 48 rows are as many blocks of 16, or are not; 33 columns are cut from within a block.
        for size in [(64, 40), (64, 48), (50, 33), (49, 48), (64, 47)] {
            let picture = decode(&mut unpack, (size.0 as u32, size.1 as u32), &ramps(64, 48, kind)).unwrap();
            assert_eq!((picture.width(), picture.height()), size, "{kind:?}");
            for (row, column) in [(0, 0), (size.1 - 1, size.0 - 1), (size.1 / 2, size.0 / 3)] {
                let error = i32::from(picture.luma().at(column, row)) - (40 + (column + row) / 2) as i32;
                assert!(error.abs() <= 3, "{kind:?} {size:?} at {column},{row}: {error}");
            }
        }
    }
}

#[test]
fn pictures_of_another_size_keep_theirs() {
    let mut unpack = Unpack::new();
    for (stream, own) in [((64, 48), (128, 96)), ((128, 96), (64, 48)), ((64, 48), (64, 64)), ((64, 48), (48, 64))] {
        let picture = decode(&mut unpack, stream, &ramps(own.0, own.1, Subsamp::Sub2x1)).unwrap();
        assert_eq!((picture.width(), picture.height()), own, "in a stream of {stream:?}");
    }
}

#[test]
fn pictures_much_larger_than_the_stream_are_refused_before_memory_is_taken() {
    let mut jpeg = ramps(64, 48, Subsamp::Sub2x1);
    let mut unpack = Unpack::new();
    let error = decode(&mut unpack, (32, 23), &jpeg).unwrap_err();
    assert_eq!(error, UnpackError::SizeMismatch { found: (64, 48), expected: (32, 23) });
    // The frame header (SOF0) claims 65500 x 65500.
    let sof = jpeg.windows(2).position(|w| w == [0xff, 0xc0]).unwrap();
    jpeg[sof + 5..sof + 9].copy_from_slice(&[0xff, 0xdc, 0xff, 0xdc]);
    let error = decode(&mut unpack, (64, 48), &jpeg).unwrap_err();
    assert_eq!(error, UnpackError::SizeMismatch { found: (65500, 65500), expected: (64, 48) });
    assert_eq!(unpack.mjpeg.room(), 0);
    let error = decode(&mut unpack, (7681, 4320), &jpeg).unwrap_err();
    assert!(error.to_string().contains("compressed 7680x4320"), "{error}");
}

#[test]
fn a_picture_cut_anywhere_is_an_error_where_most_are_whole_and_the_next_is_well() {
    let jpeg = ramps(64, 48, Subsamp::Sub2x2);
    let mut unpack = Unpack::new();
    let mut whole = decode(&mut unpack, (64, 48), &jpeg).unwrap();
    for _ in 0..20 {
        whole = decode(&mut unpack, (64, 48), &jpeg).unwrap();
    }
    // In the header, in the samples; the end marker alone, or half of it, is no loss.
    for cut in 0..jpeg.len() - 2 {
        let outcome = decode(&mut unpack, (64, 48), &jpeg[..cut]);
        let is_named = matches!(outcome, Err(UnpackError::Damaged { .. } | UnpackError::Cut { .. }));
        assert!(is_named, "cut at {cut} of {}: {outcome:?}", jpeg.len());
        assert_eq!(decode(&mut unpack, (64, 48), &jpeg).as_ref(), Ok(&whole), "after a cut at {cut}");
    }
    assert!(decode(&mut unpack, (64, 48), &jpeg[..jpeg.len() - 1]).as_ref() == Ok(&whole));
}

#[test]
fn chroma_may_change_from_picture_to_picture() {
    // What the decoder alone does not survive: 4:4:4 where 4:2:0 came before.
    let mut unpack = Unpack::new();
    for kind in [Subsamp::Sub2x2, Subsamp::None, Subsamp::Gray, Subsamp::Sub4x1, Subsamp::Sub1x4, Subsamp::Sub2x2] {
        let jpeg = ramps(200, 100, kind);
        assert_eq!(decode(&mut unpack, (200, 100), &jpeg), decode(&mut Unpack::new(), (200, 100), &jpeg), "{kind:?}");
    }
}

#[test]
fn pictures_that_are_stored_as_rgb_are_decoded_too() {
    let pixels: Vec<u8> = (0..32 * 32).flat_map(|n| [200, 90, n as u8 / 4]).collect();
    let image = turbojpeg::Image { pixels: &pixels[..], width: 32, pitch: 96, height: 32, format: turbojpeg::PixelFormat::RGB };
    let mut compressor = Compressor::new().unwrap();
    compressor.set_colorspace(Colorspace::RGB).unwrap();
    compressor.set_quality(95).unwrap();
    compressor.set_subsamp(Subsamp::None).unwrap();
    let jpeg = compressor.compress_to_vec(image).unwrap();
    let mut picture = Picture::default();
    Unpack::new().unpack(PixelFormat::Mjpeg, Range::Unknown, (32, 32), 0, &jpeg, &mut picture).unwrap();
    let [y, u, v] = picture.as_ref().planes.map(|plane| plane.at(0, 0));
    let [r, g, b] = crate::image::rgb([y, u, v]).map(i32::from);
    assert!((r - 200).abs() <= 4 && (g - 90).abs() <= 4 && b <= 6, "{r} {g} {b}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn a_jpeg_with_changed_bytes_never_panics(
        kind in prop::sample::select(KINDS.to_vec()),
        changes in prop::collection::vec((0usize..4000, any::<u8>()), 1..8),
        cut in 0usize..8000,
    ) {
        let mut jpeg = ramps(40, 24, kind);
        for (at, value) in changes {
            let at = at % jpeg.len();
            jpeg[at] = value;
        }
        jpeg.truncate(cut.max(1));
        let mut unpack = Unpack::new();
        // A picture or an error; the memory is what a picture four times as large needs.
        let _ = decode(&mut unpack, (40, 24), &jpeg);
        prop_assert!(unpack.mjpeg.room() <= 4 * 3 * 40 * 24);
        let good = ramps(40, 24, Subsamp::Sub2x1);
        prop_assert!(decode(&mut unpack, (40, 24), &good).is_ok());
    }

    #[test]
    fn random_bytes_are_no_picture(bytes in prop::collection::vec(any::<u8>(), 0..200), begin: bool) {
        let bytes = if begin { [&[0xff, 0xd8, 0xff][..], &bytes].concat() } else { bytes };
        prop_assert!(decode(&mut Unpack::new(), (16, 16), &bytes).is_err());
    }
}
