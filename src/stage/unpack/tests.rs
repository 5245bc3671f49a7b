//! Every raw format into a picture.

use super::*;
use proptest::prelude::*;

#[test]
fn raw_frames_too_short_or_impossible_are_named() {
    let mut unpack = Unpack::new();
    let mut picture = Picture::default();
    let mut try_it = |format: PixelFormat, size, stride, len| {
        unpack.unpack(format, size, stride, &vec![0; len], &mut picture).map_err(|error| error.to_string())
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
        unpack.unpack(format, (5, 3), stride, &bytes, &mut picture).unwrap();
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

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn any_raw_bytes_are_a_picture_or_an_error(
        format in prop::sample::select(PixelFormat::ALL.to_vec()),
        size in (0u32..20, 0u32..20), stride in 0usize..70, bytes in prop::collection::vec(any::<u8>(), 0..1500),
    ) {
        let _ = Unpack::new().unpack(format, size, stride, &bytes, &mut Picture::default());
    }
}
