//! Frames' bytes to pictures, compressed and raw: the same at every level of this processor.

use crate::fenced::{Edge, Fenced};
use gimbald::image::{Picture, PixelFormat, Range};
use gimbald::kernel::Level;
use gimbald::stage::unpack::Unpack;
use libfuzzer_sys::arbitrary::Unstructured;
use std::cell::RefCell;

/// Pixels of a JPEG that is decoded, at most: larger ones only take longer.
const MAX_PIXELS: u32 = 1 << 15;

thread_local! {
    /// Kept from input to input, as from frame to frame: nothing of a picture may show in the next.
    static KEPT: RefCell<Unpack> = RefCell::new(Unpack::new());
    static ROOM: RefCell<Fenced<u8>> = RefCell::new(Fenced::new(1 << 17));
}

/// A JPEG, taken for a frame of the size that its own header says, or for one of two fields.
pub fn jpeg(data: &[u8]) {
    let Some((width, height)) = size_of(data) else { return };
    if width * height > MAX_PIXELS {
        return;
    }
    let size = if data.len() % 4 == 0 { (width, 2 * height) } else { (width, height) };
    // the picture, where it is whole; what is missing of another may be the picture's before
    let whole = |unpack: &mut Unpack| {
        let mut picture = Picture::default();
        let unpacked = unpack.unpack(PixelFormat::Mjpeg, Range::Unknown, size, 0, data, &mut picture);
        (unpacked.is_ok() && unpack.shortfall().is_none()).then_some(picture)
    };
    let fresh = whole(&mut Unpack::with_level(Level::SCALAR));
    let kept = KEPT.with_borrow_mut(whole);
    assert!(fresh == kept, "a picture depends on those before it, or on the level: {} {}", fresh.is_some(), kept.is_some());
}

/// Width and height in a JPEG's first frame header.
fn size_of(data: &[u8]) -> Option<(u32, u32)> {
    let number = |at: usize| Some(u32::from(u16::from_be_bytes([*data.get(at)?, *data.get(at + 1)?])));
    let mut at = 0;
    loop {
        at += data.get(at..)?.iter().position(|&byte| byte == 0xff)?;
        match *data.get(at + 1)? {
            0xff => at += 1,
            0 | 1 | 0xd0..=0xd9 => at += 2,
            0xc0..=0xc3 | 0xc5..=0xc7 | 0xc9..=0xcb | 0xcd..=0xcf => return Some((number(at + 7)?, number(at + 5)?)),
            _ => at += 2 + number(at + 2)? as usize,
        }
    }
}

/// A raw frame in memory that ends at a forbidden page: any format, size, stride and length.
pub fn raw(data: &[u8]) {
    let mut bytes = Unstructured::new(data);
    let mut number = |most: usize| bytes.int_in_range(0..=most).unwrap_or(0);
    let format = PixelFormat::ALL[number(PixelFormat::ALL.len() - 1)];
    let size = (number(130) as u32, number(66) as u32);
    let stride = [0, usize::MAX, format.tight_stride(size.0) - format.tight_stride(size.0).min(1)].get(number(30)).copied();
    let stride = stride.unwrap_or(format.tight_stride(size.0) + number(40));
    // as many bytes as there should be, now and then a few more or fewer
    let needed = format.frame_bytes(size.1, stride).unwrap_or(0).min(1 << 16);
    let len = (needed + [0, 0, 1, 15][number(3)]).saturating_sub([0, 0, 1, 70][number(3)]);
    if format.is_compressed() {
        return;
    }
    let range = [Range::Unknown, Range::Limited, Range::Full][usize::from(bytes.arbitrary::<u8>().unwrap_or(0) % 3)];
    let pattern = bytes.take_rest();
    ROOM.with_borrow_mut(|room| {
        let frame =
            &*room.filled(Edge::End, len, |i| pattern.get(i % pattern.len().max(1)).map_or(i as u8, |byte| byte ^ i as u8));
        let [plain, best] = [Level::SCALAR, Level::best()].map(|level| {
            let mut picture = Picture::default();
            Unpack::with_level(level).unpack(format, range, size, stride, frame, &mut picture).map(|()| picture)
        });
        assert_eq!(plain, best, "{format} {size:?} {stride} {len}");
    });
}
