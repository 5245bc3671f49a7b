//! JPEG as webcams send it: each kind of oddity, over kinds of chroma and restart intervals, against a second decoder.

use super::super::super::{Unpack, UnpackError};
use crate::image::{Picture, PixelFormat, Range};
use jpeg_encoder::{ColorType, Encoder, SamplingFactor};

const WIDTH: usize = 96;
const HEIGHT: usize = 80;

/// Every kind of chroma that the encoder has, and the grey of one component.
const KINDS: [Option<SamplingFactor>; 9] = [
    Some(SamplingFactor::F_1_1),
    Some(SamplingFactor::F_2_1),
    Some(SamplingFactor::F_1_2),
    Some(SamplingFactor::F_2_2),
    Some(SamplingFactor::F_4_1),
    Some(SamplingFactor::F_4_2),
    Some(SamplingFactor::F_1_4),
    Some(SamplingFactor::F_2_4),
    None,
];
const RESTARTS: [u16; 3] = [0, 1, 5];

/// A JPEG with something to see in every block; `shift` moves it.
fn jpeg(size: (usize, usize), kind: Option<SamplingFactor>, restart: u16, shift: usize) -> Vec<u8> {
    let pixel = |x: usize, y: usize| {
        let stripes = if (x + shift) / 6 % 2 == y / 10 % 2 { 50 } else { 0 };
        [40 + x + stripes, 60 + y + stripes, 150 - (x + y) / 2 + stripes].map(|n| n.min(255) as u8)
    };
    let (width, height) = size;
    let colours = (0..height).flat_map(|y| (0..width).map(move |x| pixel(x, y)));
    let mut bytes = Vec::new();
    let mut encoder = Encoder::new(&mut bytes, 90);
    if let Some(kind) = kind {
        encoder.set_sampling_factor(kind);
    }
    if restart > 0 {
        encoder.set_restart_interval(restart);
    }
    let (samples, colour): (Vec<u8>, _) = match kind {
        Some(_) => (colours.flatten().collect(), ColorType::Rgb),
        None => (colours.map(|colour| colour[0]).collect(), ColorType::Luma),
    };
    encoder.encode(&samples, width as u16, height as u16, colour).unwrap();
    bytes
}

fn try_to_decode(unpack: &mut Unpack, size: (usize, usize), bytes: &[u8]) -> Result<Picture, UnpackError> {
    let mut picture = Picture::default();
    unpack.unpack(PixelFormat::Mjpeg, Range::Limited, (size.0 as u32, size.1 as u32), 0, bytes, &mut picture).map(|()| picture)
}

/// Decodes with nothing known of the stream.
fn decode(bytes: &[u8]) -> Picture {
    try_to_decode(&mut Unpack::new(), (WIDTH, HEIGHT), bytes).unwrap()
}

/// Compares a picture with what the second decoder makes of `jpeg`: luma sample by sample, chroma by the mean of what it covers.
fn assert_as_second_decoder(picture: &Picture, jpeg: &[u8], what: &str) {
    let mut decoder = jpeg_decoder::Decoder::new(jpeg);
    decoder.read_info().unwrap();
    if decoder.info().is_some_and(|info| info.pixel_format != jpeg_decoder::PixelFormat::L8) {
        // As if they were R, G and B already: untransformed.
        decoder.set_color_transform(jpeg_decoder::ColorTransform::RGB);
    }
    let samples = decoder.decode().unwrap();
    let info = decoder.info().unwrap();
    let (width, step) = (usize::from(info.width), info.pixel_format.pixel_bytes());
    let at = |x: usize, y: usize, n: usize| i32::from(samples[(y * width + x) * step + n]);
    let [luma, u, v] = picture.as_ref().planes;
    for y in 0..picture.height() {
        for x in 0..picture.width() {
            let error = i32::from(luma.at(x, y)) - at(x, y, 0);
            assert!(error.abs() <= 2, "{what}: luma at {x},{y} is off by {error}");
        }
    }
    for (n, plane) in [(1, u), (2, v)].into_iter().filter(|(n, _)| *n < step) {
        // At the edges decoders spread chroma in different ways.
        for y in 4..plane.height() - 4 {
            for x in 4..plane.width() - 4 {
                let four = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(dx, dy)| at(2 * x + dx, 2 * y + dy, n)).iter().sum::<i32>();
                let error = i32::from(plane.at(x, y)) - four / 4;
                assert!(error.abs() <= 6, "{what}: chroma {n} at {x},{y} is off by {error}");
            }
        }
    }
}

#[test]
fn every_kind_is_decoded_as_by_another_decoder() {
    for kind in KINDS {
        for restart in RESTARTS {
            let jpeg = jpeg((WIDTH, HEIGHT), kind, restart, 0);
            assert_as_second_decoder(&decode(&jpeg), &jpeg, &format!("{kind:?}, restart {restart}"));
        }
    }
}

/// Where the codes of the only scan begin.
fn codes_at(jpeg: &[u8]) -> usize {
    let scan = jpeg.windows(2).position(|pair| pair == [0xff, 0xda]).unwrap();
    scan + 2 + usize::from(u16::from_be_bytes([jpeg[scan + 2], jpeg[scan + 3]]))
}

/// With `pad` before every `each`th restart marker.
fn with_pads(jpeg: &[u8], each: usize, pad: &[u8]) -> Vec<u8> {
    let (mut out, mut count) = (jpeg[..codes_at(jpeg)].to_vec(), 0);
    for (n, &byte) in jpeg.iter().enumerate().skip(codes_at(jpeg)) {
        if byte == 0xff && matches!(jpeg.get(n + 1), Some(0xd0..=0xd7)) {
            count += 1;
            if count % each == 0 {
                out.extend_from_slice(pad);
            }
        }
        out.push(byte);
    }
    out
}

fn with_segment(jpeg: &[u8], marker: u8, length: u16, payload: &[u8]) -> Vec<u8> {
    [&jpeg[..2], &[0xff, marker], &length.to_be_bytes(), payload, &jpeg[2..]].concat()
}

fn without_huffman_tables(jpeg: &[u8]) -> Vec<u8> {
    let mut out = jpeg[..2].to_vec();
    let mut at = 2;
    while jpeg[at + 1] != 0xda {
        let end = at + 2 + usize::from(u16::from_be_bytes([jpeg[at + 2], jpeg[at + 3]]));
        if jpeg[at + 1] != 0xc4 {
            out.extend_from_slice(&jpeg[at..end]);
        }
        at = end;
    }
    [&out[..], &jpeg[at..]].concat()
}

/// The same picture as webcams and capture cards send it.
fn oddities(jpeg: &[u8]) -> Vec<(&'static str, Vec<u8>)> {
    let (before_end, end) = jpeg.split_at(jpeg.len() - 2);
    let insert = |stray: &[u8], behind: &[u8]| [before_end, stray, end, behind].concat();
    let thumbnail = [b"Exif\0\0", jpeg].concat();
    let mut with_odd_scan = jpeg.to_vec();
    let scan_header = codes_at(jpeg) - 3;
    let tables_end = jpeg.windows(2).position(|pair| pair == [0xff, 0xc0]).unwrap();
    let scan_at = jpeg.windows(2).position(|pair| pair == [0xff, 0xda]).unwrap();
    with_odd_scan[scan_header..scan_header + 3].copy_from_slice(&[0, 0, 0]);
    vec![
        ("as it is", jpeg.to_vec()),
        ("empty pictures before it", [&[0xff, 0xd8, 0xff, 0xd9].repeat(3), jpeg].concat()),
        ("tables alone before it", [&jpeg[..tables_end], &[0xff, 0xd9], jpeg].concat()),
        ("a header without samples before it", [&jpeg[..scan_at], &[0xff, 0xd9], jpeg].concat()),
        ("FF before it", [&[0xff], jpeg].concat()),
        ("several FF before it", [&[0xff; 5], jpeg].concat()),
        ("zeros before it", [&[0; 100], jpeg].concat()),
        ("junk before it", [b"junk \xff\x00\xff\xe1 junk", jpeg].concat()),
        ("stray bytes before its end", insert(&[0x12, 0x34, 0x9a], &[])),
        ("a zero before its end", insert(&[0], &[])),
        ("many zeros before its end", insert(&[0; 700], &[])),
        ("FF before its end", insert(&[0xff; 3], &[])),
        ("a pad byte before its end", insert(&[0xff, 0], &[])),
        ("zeros behind it", insert(&[], &[0; 5000])),
        ("junk behind it", insert(&[], &b"\xff\xda\x00 junk \xff\xc0".repeat(50))),
        ("the same picture behind it", insert(&[], jpeg)),
        ("stray bytes before and junk behind its end", insert(&[1, 2, 3, 4, 5], &[0x55; 999])),
        ("no end", before_end.to_vec()),
        ("no end, zeros", [before_end, &[0; 2000]].concat()),
        ("no end, FF", [before_end, &[0xff]].concat()),
        ("no end, a few stray bytes", [before_end, &[7, 8, 9]].concat()),
        ("no end, the next picture's start", [before_end, &jpeg[..300]].concat()),
        ("no Huffman tables", without_huffman_tables(jpeg)),
        ("a scan header that names no frequencies", with_odd_scan),
        ("a comment", with_segment(jpeg, 0xfe, 9, b"comment")),
        ("EXIF with a thumbnail", with_segment(jpeg, 0xe1, 2 + thumbnail.len() as u16, &thumbnail)),
        ("an EXIF segment longer than the picture", with_segment(jpeg, 0xe1, 0xffff, b"Exif\0\0II*\0")),
        (
            "an ICC segment that is too short",
            with_segment(jpeg, 0xe2, 40, &[b"ICC_PROFILE\0\x01\x01", &[0x11; 90][..]].concat()),
        ),
        ("an ICC segment without length", with_segment(jpeg, 0xe2, 0, b"ICC_PROFILE\0\x01\x01 and what not")),
        ("a pad byte before each restart", with_pads(jpeg, 1, &[0xff, 0])),
        ("a pad byte before some restarts", with_pads(jpeg, 3, &[0xff, 0])),
        ("several pad bytes before restarts", with_pads(jpeg, 2, &[0xff, 0, 0xff, 0])),
        ("zeros before restarts", with_pads(jpeg, 2, &[0, 0, 0])),
        ("FF before restarts", with_pads(jpeg, 2, &[0xff, 0xff])),
        ("pad bytes before restarts, stray ones before the end", {
            let padded = with_pads(jpeg, 1, &[0xff, 0]);
            [&padded[..padded.len() - 2], &[1, 2, 3, 0xff, 0xd9, 4, 5, 6]].concat()
        }),
    ]
}

#[test]
fn each_oddity_gives_the_same_picture() {
    for kind in KINDS {
        for restart in RESTARTS {
            let plain = jpeg((WIDTH, HEIGHT), kind, restart, 0);
            let whole = decode(&plain);
            let mut unpack = Unpack::new();
            for (name, bytes) in oddities(&plain) {
                // Twice in one stream: the first may teach the decoder something of the second.
                for round in 0..2 {
                    let picture = try_to_decode(&mut unpack, (WIDTH, HEIGHT), &bytes);
                    let what = format!("{name}, {kind:?}, restart {restart}, round {round}");
                    let is_same = picture.as_ref() == Ok(&whole);
                    assert!(
                        is_same,
                        "{what}: {}",
                        picture.map_or_else(|error| error.to_string(), |_| "another picture".into())
                    );
                    assert_eq!(unpack.shortfall(), None, "{what}");
                }
            }
        }
    }
}

#[test]
fn headers_up_to_15_larger_are_cropped() {
    for kind in KINDS {
        for (own, stream) in [((96, 88), (96, 80)), ((96, 80), (96, 65)), ((96, 80), (81, 80)), ((111, 95), (96, 80))] {
            let bytes = jpeg(own, kind, 0, 0);
            let picture = try_to_decode(&mut Unpack::new(), stream, &bytes).unwrap();
            assert_eq!((picture.width(), picture.height()), stream, "{kind:?} {own:?}");
            assert_as_second_decoder(&picture, &bytes, &format!("{kind:?} {own:?} in {stream:?}"));
        }
    }
}

#[test]
fn a_cut_picture_is_held_where_most_are_whole_and_shown_where_most_are_cut() {
    for kind in KINDS {
        for restart in RESTARTS {
            if jpeg((WIDTH, HEIGHT), kind, restart, 0).windows(2).filter(|pair| pair == &[0xff, 0xda]).count() > 1 {
                // Components one after the other: where its end is cut off, colours are missing, not rows.
                continue;
            }
            let (first, second) = (jpeg((WIDTH, HEIGHT), kind, restart, 0), jpeg((WIDTH, HEIGHT), kind, restart, 3));
            let (whole_first, whole_second) = (decode(&first), decode(&second));
            let codes = codes_at(&second);
            let cut = &second[..codes + (second.len() - codes) * 6 / 10];
            let what = format!("{kind:?}, restart {restart}");
            for bytes in [cut.to_vec(), [cut, &[0; 3000]].concat()] {
                // Nothing came before: what is there is shown, and the rest is not made of nothing.
                let mut unpack = Unpack::new();
                let alone = try_to_decode(&mut unpack, (WIDTH, HEIGHT), &bytes).unwrap();
                let &UnpackError::Cut { rows, of } = unpack.shortfall().unwrap() else {
                    panic!("{what}: {:?}", unpack.shortfall())
                };
                assert!(rows > HEIGHT / 4 && rows < HEIGHT && of == HEIGHT, "{what}: {rows} of {of}");
                // The last row pair's chroma may be made of a row that is missing.
                let shown = |picture: &Picture, row: usize| picture.luma().row(row).to_vec();
                assert!((0..rows).all(|row| shown(&alone, row) == shown(&whole_second, row)), "{what}");
                assert!((rows..HEIGHT).all(|row| shown(&alone, row) == shown(&alone, rows - 1)), "{what}");
                // One whole picture before: its rows stand where others are missing.
                let mut unpack = Unpack::new();
                try_to_decode(&mut unpack, (WIDTH, HEIGHT), &first).unwrap();
                let seamed = try_to_decode(&mut unpack, (WIDTH, HEIGHT), &bytes).unwrap();
                for row in 0..HEIGHT {
                    let from = if row < rows { &whole_second } else { &whole_first };
                    assert_eq!(shown(&seamed, row), shown(from, row), "{what}: row {row}, {rows} are there");
                }
                // A row of whole ones: the cut one is an exception, until there are too many of them.
                for _ in 0..20 {
                    try_to_decode(&mut unpack, (WIDTH, HEIGHT), &first).unwrap();
                }
                let held = (0..20).take_while(|_| try_to_decode(&mut unpack, (WIDTH, HEIGHT), &bytes).is_err()).count();
                assert_eq!(held, 8, "{what}");
                assert!(matches!(unpack.shortfall(), Some(UnpackError::Cut { .. })));
                try_to_decode(&mut unpack, (WIDTH, HEIGHT), &first).unwrap();
                assert_eq!(unpack.shortfall(), None);
            }
        }
    }
}

#[test]
fn a_cut_with_an_end_marker_behind_it_is_damage() {
    for restart in RESTARTS {
        let bytes = jpeg((WIDTH, HEIGHT), KINDS[1], restart, 0);
        let cut = [&bytes[..bytes.len() * 3 / 4], &[0xff, 0xd9]].concat();
        let error = try_to_decode(&mut Unpack::new(), (WIDTH, HEIGHT), &cut).unwrap_err();
        assert!(matches!(error, UnpackError::Damaged { .. }), "{error}");
    }
}

/// One field's JPEG, with the segment that says which it is.
fn field(top: bool, shift: usize, kind: Option<SamplingFactor>, polarity: Option<u8>) -> Vec<u8> {
    let bytes = jpeg((WIDTH, HEIGHT / 2), kind, 0, shift);
    let polarity = polarity.map(|polarity| if top { polarity } else { 3 - polarity });
    polarity.map_or(bytes.clone(), |polarity| {
        with_segment(&bytes, 0xe0, 16, &[b"AVI1", &[polarity, 0, 0, 0, 0, 0, 0, 0, 0, 0][..]].concat())
    })
}

#[test]
fn two_fields_in_one_buffer_are_woven() {
    for kind in KINDS {
        let fields = [0, 3].map(|shift| {
            try_to_decode(&mut Unpack::new(), (WIDTH, HEIGHT / 2), &jpeg((WIDTH, HEIGHT / 2), kind, 0, shift)).unwrap()
        });
        // Said to be the top field first, the bottom field first, or nothing said.
        for (polarity, first_row) in [(Some(1), 0), (Some(2), 1), (None, 0)] {
            for between in [&[][..], &[0; 40]] {
                let bytes = [&field(true, 0, kind, polarity), between, &field(false, 3, kind, polarity)].concat();
                let picture = try_to_decode(&mut Unpack::new(), (WIDTH, HEIGHT), &bytes).unwrap();
                assert_eq!((picture.width(), picture.height()), (WIDTH, HEIGHT));
                for row in 0..HEIGHT {
                    let from = &fields[(row + first_row) % 2];
                    assert_eq!(picture.luma().row(row), from.luma().row(row / 2), "{kind:?} {polarity:?} row {row}");
                }
            }
        }
        // A field alone, and a field with half of another.
        let alone = field(true, 0, kind, Some(1));
        assert_eq!(try_to_decode(&mut Unpack::new(), (WIDTH, HEIGHT), &alone).unwrap().height(), HEIGHT / 2);
        let half = [&alone[..], &alone[..alone.len() * 3 / 4]].concat();
        assert!(try_to_decode(&mut Unpack::new(), (WIDTH, HEIGHT), &half).is_err());
    }
}

#[test]
fn progressive_pictures_are_decoded_and_their_damage_is_noticed() {
    let mut bytes = Vec::new();
    let mut encoder = Encoder::new(&mut bytes, 90);
    encoder.set_progressive(true);
    let samples: Vec<u8> = (0..WIDTH * HEIGHT * 3).map(|n| (n / 3 % WIDTH * 2) as u8).collect();
    encoder.encode(&samples, WIDTH as u16, HEIGHT as u16, ColorType::Rgb).unwrap();
    assert_as_second_decoder(&decode(&bytes), &bytes, "progressive");
    assert!(try_to_decode(&mut Unpack::new(), (WIDTH, HEIGHT), &bytes[..bytes.len() * 3 / 4]).is_err());
}
