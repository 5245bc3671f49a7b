//! What is shown in place of frames that cannot be used.

use super::*;
use crate::device::null::WithPlaceholder;
use crate::frame::Stamp;
use crate::image::PixelFormat;

const SIZE: (u32, u32) = (64, 48);
const PERIOD_NS: i64 = 33_333_333;
/// Usable frames before the unusable ones.
const USABLE: u64 = 20;

/// Frames at 30 a second: twenty usable ones, `count` unusable ones, a usable one. `stamp_ns` is what an unusable one is stamped, given
/// its number from 0 and when it was taken. Returns in place of which of the unusable ones the sink showed its own picture.
fn replaced(count: usize, stamp_ns: impl Fn(usize, i64) -> i64) -> Vec<usize> {
    let format = StreamFormat::tight(SIZE.0, SIZE.1, PixelFormat::Yuyv, (1, 30));
    let mut stabilizer = Stabilizer::new(&Params::default(), &format, &format);
    let mut sink = WithPlaceholder::new(&format);
    let mut replaced = Vec::new();
    let last = USABLE + count as u64;
    for sequence in 0..=last {
        let taken_ns = 1_000_000_000 + sequence as i64 * PERIOD_NS;
        let unusable = (USABLE..last).contains(&sequence).then(|| (sequence - USABLE) as usize);
        let mut frame = stabilizer.give_back().unwrap_or_else(|| stabilizer.empty_frame());
        let time_ns = unusable.map_or(taken_ns, |n| stamp_ns(n, taken_ns));
        frame.stamp = Stamp { time_ns, sequence, ..Stamp::default() };
        frame.intact = unusable.is_none();
        stabilizer.push(frame);
        if sequence == last {
            stabilizer.end();
        }
        let before = sink.placeholders;
        while stabilizer.emit(&mut sink, &mut ()).unwrap().is_some() {}
        match unusable {
            Some(n) if sink.placeholders > before => replaced.push(n),
            Some(_) => {}
            None => assert_eq!(sink.placeholders, before, "in place of the usable frame {sequence}"),
        }
    }
    replaced
}

/// Of unusable frames at 30 a second, the first one that is more than two seconds after the last usable one.
const FIRST_REPLACED: usize = 60;
const NEVER: [usize; 0] = [];

#[test]
fn the_last_picture_is_held_for_two_seconds() {
    assert_eq!(replaced(80, |_, taken_ns| taken_ns), (FIRST_REPLACED..80).collect::<Vec<_>>());
    assert_eq!(replaced(50, |_, taken_ns| taken_ns), NEVER);
}

#[test]
fn one_stamp_of_another_clock_replaces_no_picture() {
    for off_ns in [9_000_000_000, -9_000_000_000, 3_600_000_000_000, -900_000_000] {
        assert_eq!(replaced(8, |n, taken_ns| if n == 3 { taken_ns + off_ns } else { taken_ns }), NEVER, "{off_ns}");
    }
}

#[test]
fn stamps_that_stand_still_hold_no_picture_for_ever() {
    let stamps: [fn(usize, i64) -> i64; 3] =
        [|_, _| 0, |_, _| 1_000_000_000 + 19 * PERIOD_NS, |n, _| 77_000_000_000 - n as i64 * 1_000_000];
    for (kind, stamp_ns) in stamps.into_iter().enumerate() {
        let first = replaced(80, stamp_ns).first().copied();
        // a jump of the clock counts as a second at most
        assert!(first.is_some_and(|first| (28..=FIRST_REPLACED + 1).contains(&first)), "{kind}: {first:?}");
    }
}

#[test]
fn a_rate_that_no_camera_has_takes_no_memory_for_look_ahead() {
    let params = Params { smooth: smooth::Params { lookahead_ms: 500.0, ..Default::default() }, ..Params::default() };
    let frames = |fps| {
        let format = StreamFormat::tight(SIZE.0, SIZE.1, PixelFormat::I420, (1, fps));
        Stabilizer::new(&params, &format, &format).frames()
    };
    assert_eq!(frames(30), FRAMES + 15);
    assert_eq!(frames(1_000_000_000), FRAMES + MAX_AHEAD);
}
