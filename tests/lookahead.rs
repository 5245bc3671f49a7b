//! Look-ahead: frames come out as late as was allowed, no later, whatever the rate does; and the path is steadier for it.

mod common;

use common::{Memory, Seen, Shot, film, frame_of, in_time};
use gimbald::device::FrameSink;
use gimbald::device::null::NullSink;
use gimbald::device::synthetic::{self, Motion};
use gimbald::pipeline::{Params, Stabilizer};
use gimbald::stage::smooth;

fn shaken(frames: u64, gain: f64) -> Vec<Shot> {
    film(&synthetic::Params { width: 240, height: 180, frames, motion: Motion::Handheld, gain, ..synthetic::Params::default() })
}

fn allowed(lookahead_ms: f64) -> Params {
    Params { smooth: smooth::Params { lookahead_ms, ..smooth::Params::default() }, ..Params::default() }
}

/// What came out after each frame went in, at the end, and the most frames that were under way.
fn carried(shots: &[Shot], params: &Params) -> (Vec<Vec<Seen>>, usize) {
    let format = shots[0].format;
    let mut sink = NullSink::new(&format);
    let mut stabilizer = Stabilizer::new(params, &format, &sink.format());
    let (mut all, mut under_way, mut most) = (Vec::new(), 0usize, 0);
    for shot in shots.iter().map(Some).chain([None]) {
        let mut memory = Memory::default();
        match shot {
            Some(shot) => {
                let mut frame = Box::new(frame_of(shot));
                frame.intact = !shot.stamp.flags.contains(gimbald::frame::FrameFlags::ERROR);
                under_way += 1;
                stabilizer.push(frame);
            }
            None => stabilizer.end(),
        }
        while stabilizer.emit(&mut sink, &mut memory).unwrap().is_some() {}
        most = most.max(under_way);
        while stabilizer.give_back().is_some() {
            under_way -= 1;
        }
        all.push(memory.seen);
    }
    assert!(most <= stabilizer.frames(), "{most} frames under way of {}", stabilizer.frames());
    (all, most)
}

#[test]
fn frames_are_as_late_as_allowed_and_all_come_out_in_order() {
    for (fps, lookahead_ms) in [(30.0, 100.0), (30.0, 0.0), (15.0, 200.0), (60.0, 250.0), (30.0, 20.0)] {
        let mut shots = shaken(90, 0.5);
        in_time(&mut shots, fps);
        shots.iter_mut().for_each(|shot| shot.format.interval = (1, fps as u32));
        for damaged in [17, 18, 40] {
            shots[damaged] = shots[damaged].clone().damaged();
        }
        let (out, _) = carried(&shots, &allowed(lookahead_ms));
        let order: Vec<u64> = out.iter().flatten().map(|seen| seen.stamp.sequence).collect();
        assert_eq!(order, (0..90).collect::<Vec<_>>(), "{fps} fps, {lookahead_ms} ms");
        let frames = (lookahead_ms * 1e-3 * fps + 1e-6) as usize;
        for (n, out) in out.iter().enumerate().take(90) {
            for seen in out {
                // a damaged frame tells nothing, so that those before it wait on
                let late = n - seen.stamp.sequence as usize;
                let near = if [17, 18, 40].iter().any(|damaged| n.abs_diff(*damaged) < 20) { 2 } else { 0 };
                let right = (frames.saturating_sub(near)..=frames + near).contains(&late) || !seen.intact;
                assert!(right, "{fps} fps, {lookahead_ms} ms: at frame {n} one is {late} late");
            }
        }
    }
}

#[test]
fn a_rate_that_changes_changes_the_count_not_the_time() {
    let mut shots = shaken(90, 0.5);
    let mut time_ns = 0;
    for (n, shot) in shots.iter_mut().enumerate() {
        time_ns += if n < 45 { 33_333_333 } else { 66_666_667 };
        (shot.stamp.time_ns, shot.stamp.sequence) = (time_ns, n as u64);
    }
    let times: Vec<i64> = shots.iter().map(|shot| shot.stamp.time_ns).collect();
    let (out, _) = carried(&shots, &allowed(200.0));
    for (n, out) in out.iter().enumerate().take(90) {
        for seen in out {
            let late_ms = (times[n] - seen.stamp.time_ns) as f64 * 1e-6;
            // at the change one more is behind than there need be
            assert!((133.0..=234.0).contains(&late_ms), "frame {n}: {late_ms} ms");
        }
    }
}

#[test]
fn what_is_known_makes_the_path_steadier_and_stays_inside() {
    let shots = shaken(240, 1.5);
    let shake = |lookahead_ms| {
        let (out, _) = carried(&shots, &allowed(lookahead_ms));
        let seen: Vec<Seen> = out.into_iter().flatten().collect();
        assert!(seen.iter().all(|seen| seen.crop_use <= 1.0 + 1e-6));
        let place = |n: usize, c: usize| seen[n].smoothed[c];
        let square = |n: usize| (0..2).map(|c| (place(n - 1, c) - 2.0 * place(n, c) + place(n + 1, c)).powi(2)).sum::<f64>();
        (31..seen.len() - 1).map(square).sum::<f64>().sqrt()
    };
    let (none, some, much) = (shake(0.0), shake(100.0), shake(300.0));
    println!("acceleration with no look-ahead, 100 ms, 300 ms: {none:.6}, {some:.6}, {much:.6}");
    assert!(some < none && much < 0.7 * none, "{none} {some} {much}");
}
