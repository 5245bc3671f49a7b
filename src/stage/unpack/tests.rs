//! Every raw format into a picture.

use super::*;
use proptest::prelude::*;

#[test]
fn raw_frames_too_short_or_impossible_are_named() {
    let mut unpack = Unpack::new();
    let mut picture = Picture::default();
    let mut try_it = |format: PixelFormat, size, stride, len| {
        unpack.unpack(format, Range::Unknown, size, stride, &vec![0; len], &mut picture).map_err(|error| error.to_string())
    };
    assert_eq!(try_it(PixelFormat::Yuyv, (4, 2), 8, 15), Err("the YUYV frame has 15 bytes, 16 were expected".into()));
    assert_eq!(try_it(PixelFormat::Yuyv, (4, 2), 10, 18), Ok(()), "the last row needs no padding");
    assert!(try_it(PixelFormat::Yuyv, (4, 2), 7, 99).unwrap_err().contains("rows of 7 bytes is not possible"));
    assert!(try_it(PixelFormat::Grey, (0, 2), 8, 99).unwrap_err().contains("0x2"));
    assert!(try_it(PixelFormat::Grey, (8193, 1), 8193, 9000).unwrap_err().contains("at most 8192x8192"));
}

#[test]
fn planar_formats_keep_their_samples() {
    let mut unpack = Unpack::new();
    for format in [PixelFormat::Nv12, PixelFormat::I420, PixelFormat::I422, PixelFormat::I444, PixelFormat::Grey] {
        let stride = format.tight_stride(5) + 3;
        let len = format.frame_bytes(3, stride).unwrap();
        let bytes: Vec<u8> = (0..len).map(|n| n as u8).collect();
        let mut picture = Picture::default();
        unpack.unpack(format, Range::Limited, (5, 3), stride, &bytes, &mut picture).unwrap();
        let [y, u, v] = picture.as_ref().planes;
        assert_eq!(y.row(2), &bytes[2 * stride..2 * stride + 5]);
        match format {
            PixelFormat::Nv12 => assert_eq!((u.at(2, 1), v.at(2, 1)), (bytes[3 * stride + 8 + 4], bytes[3 * stride + 8 + 5])),
            PixelFormat::Grey => assert_eq!(u.width(), 0),
            _ => {
                let layout = RawLayout::new(format, 5, 3, stride).unwrap().planes(&bytes).unwrap();
                assert_eq!((u.row(1), v.row(1)), (layout[1].row(1), layout[2].row(1)));
            }
        }
    }
}

/// Eight colours as a camera of `format` and `range` gives them, each 8 x 8 pixels large, in a row.
fn bars(format: PixelFormat, range: Range) -> (Vec<u8>, usize) {
    let (width, height) = (64, 8);
    let full = range.of(format) == Range::Full;
    let colour = |x: usize| [0, 1, 2].map(|bit| if (x / 8) >> bit & 1 == 1 { 1.0 } else { 0.0 });
    let yuv = |x: usize| {
        let [r, g, b] = colour(x);
        let luma = 0.299 * r + 0.587 * g + 0.114 * b;
        let (black, span, chroma) = if full { (0.0, 255.0, 255.0) } else { (16.0, 219.0, 224.0) };
        [black + span * luma, 128.0 + chroma * (b - luma) / 1.772, 128.0 + chroma * (r - luma) / 1.402]
            .map(|n: f64| n.round() as u8)
    };
    let rgb = |x: usize| colour(x).map(|part| if full { 255.0 * part } else { 16.0 + 219.0 * part } as u8);
    let plane = |n: usize, step: usize| (0..width / step).map(move |x| yuv(x * step)[n]);
    let rows = |row: Vec<u8>, rows: usize| row.repeat(rows);
    let bytes = match format {
        PixelFormat::Yuyv => rows((0..width).flat_map(|x| [yuv(x)[0], yuv(x)[1 + x % 2]]).collect(), height),
        PixelFormat::Uyvy => rows((0..width).flat_map(|x| [yuv(x)[1 + x % 2], yuv(x)[0]]).collect(), height),
        PixelFormat::Rgb24 => rows((0..width).flat_map(rgb).collect(), height),
        PixelFormat::Bgr24 => rows(
            (0..width)
                .flat_map(|x| {
                    let [r, g, b] = rgb(x);
                    [b, g, r]
                })
                .collect(),
            height,
        ),
        PixelFormat::Nv12 => {
            let chroma = plane(1, 2).zip(plane(2, 2)).flat_map(|(u, v)| [u, v]).collect();
            [rows(plane(0, 1).collect(), height), rows(chroma, height / 2)].concat()
        }
        PixelFormat::I420 | PixelFormat::I422 | PixelFormat::I444 => {
            let (x, y) = if format == PixelFormat::I420 {
                (2, 2)
            } else if format == PixelFormat::I422 {
                (2, 1)
            } else {
                (1, 1)
            };
            [
                rows(plane(0, 1).collect(), height),
                rows(plane(1, x).collect(), height / y),
                rows(plane(2, x).collect(), height / y),
            ]
            .concat()
        }
        PixelFormat::Grey => rows(plane(0, 1).collect(), height),
        PixelFormat::Mjpeg => {
            let pixels = rows((0..width).flat_map(|x| colour(x).map(|part| (255.0 * part) as u8)).collect(), height);
            let image =
                turbojpeg::Image { pixels: &pixels[..], width, pitch: 3 * width, height, format: turbojpeg::PixelFormat::RGB };
            turbojpeg::compress(image, 100, turbojpeg::Subsamp::None).unwrap().to_vec()
        }
    };
    (bytes, format.tight_stride(width as u32))
}

/// What readers make of a picture, who take it for BT.601 of limited range: from any format and range the colours that were filmed.
#[test]
fn colours_are_right_from_every_format_and_range() {
    let mut unpack = Unpack::new();
    for format in PixelFormat::ALL {
        for range in [Range::Unknown, Range::Limited, Range::Full] {
            if format == PixelFormat::Mjpeg && range == Range::Limited {
                continue;
            }
            let (bytes, stride) = bars(format, range);
            let mut picture = Picture::default();
            unpack.unpack(format, range, (64, 8), stride, &bytes, &mut picture).unwrap();
            for bar in 0..8usize {
                let (x, y) = (8 * bar + 3, 4);
                let [luma, u, v] = picture.as_ref().planes;
                let want = [0, 1, 2].map(|bit| if bar >> bit & 1 == 1 { 255i32 } else { 0 });
                let got = match picture.sampling().shift() {
                    Some((right, down)) => {
                        crate::image::rgb([luma.at(x, y), u.at(x >> right, y >> down), v.at(x >> right, y >> down)])
                    }
                    None => {
                        let grey = crate::image::rgb([luma.at(x, y), 128, 128])[0];
                        let exact = 0.299 * f64::from(want[0]) + 0.587 * f64::from(want[1]) + 0.114 * f64::from(want[2]);
                        assert!(
                            (f64::from(grey) - exact).abs() <= 3.0,
                            "{format} {range:?} bar {bar}: {grey}, {exact:.0} expected"
                        );
                        continue;
                    }
                };
                let worst = got.iter().zip(want).map(|(&got, want)| (i32::from(got) - want).abs()).max().unwrap();
                assert!(worst <= 3, "{format} {range:?} bar {bar}: {got:?}, {want:?} expected");
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn any_raw_bytes_are_a_picture_or_an_error(
        format in prop::sample::select(PixelFormat::ALL.to_vec()),
        size in (0u32..20, 0u32..20), stride in 0usize..70, bytes in prop::collection::vec(any::<u8>(), 0..1500),
    ) {
        let _ = Unpack::new().unpack(format, Range::Full, size, stride, &bytes, &mut Picture::default());
    }
}
