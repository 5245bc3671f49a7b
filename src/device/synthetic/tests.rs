//! The synthetic camera shows what its truth says.

use super::*;

fn small(motion: Motion) -> Params {
    Params { width: 160, height: 120, motion, noise: 0.0, frames: 3, ..Params::default() }
}

fn frames(params: &Params) -> Vec<Vec<u8>> {
    let mut source = Synthetic::new(params).unwrap();
    let mut frames = Vec::new();
    while let Lent::Frame(frame) = source.lend().unwrap() {
        assert_eq!(Some(frame.bytes.len()), frame.format.frame_bytes());
        frames.push(frame.bytes.to_vec());
    }
    frames
}

#[test]
fn the_same_seed_gives_the_same_frames() {
    let params = Params { noise: 2.0, ..small(Motion::Handheld) };
    let (first, again) = (frames(&params), frames(&params));
    assert_eq!(first.len(), 3);
    assert!(first == again);
    assert!(first != frames(&Params { seed: 2, ..params }));
    assert!(first[0] != first[1]);
}

#[test]
fn a_still_camera_sees_the_same_and_noise_is_as_strong_as_said() {
    let still = frames(&small(Motion::Still));
    assert!(still[0] == still[1]);
    let noisy = frames(&Params { noise: 4.0, ..small(Motion::Still) });
    let luma = 160 * 120;
    let power: f64 = still[0].iter().zip(&noisy[0]).take(luma).map(|(&a, &b)| (f64::from(a) - f64::from(b)).powi(2)).sum();
    assert!(((power / luma as f64).sqrt() - 4.0).abs() < 0.2, "{}", (power / luma as f64).sqrt());
    assert!(still[0][luma..] == noisy[0][luma..], "chroma has none");
    assert!(noisy[0] != noisy[1]);
}

#[test]
fn there_is_something_to_see_everywhere() {
    let frame = &frames(&small(Motion::Still))[0];
    for top in (0..120).step_by(40) {
        for left in (0..160).step_by(40) {
            let block = (0..40).flat_map(|y| (0..40).map(move |x| frame[(top + y) * 160 + left + x]));
            let (low, high) = block.fold((255, 0), |(low, high), v| (v.min(low), v.max(high)));
            assert!(high - low > 60, "block at {left}, {top}: {low} to {high}");
        }
    }
    let chroma = &frame[160 * 120..];
    assert!(chroma.iter().any(|&c| c > 136) && chroma.iter().any(|&c| c < 120));
}

/// Samples a plane bilinearly.
fn at(plane: &[u8], width: usize, [x, y]: [f64; 2]) -> f64 {
    let (column, row) = (x as usize, y as usize);
    let (fx, fy) = (x.fract(), y.fract());
    let p = |c: usize, r: usize| f64::from(plane[(row + r) * width + column + c]);
    (p(0, 0) * (1.0 - fx) + p(1, 0) * fx) * (1.0 - fy) + (p(0, 1) * (1.0 - fx) + p(1, 1) * fx) * fy
}

#[test]
fn frames_show_scene_points_where_the_truth_says() {
    for (motion, readout_ms) in [(Motion::Horizontal, 30.0), (Motion::Vertical, -25.0), (Motion::Handheld, 0.0)] {
        let params = Params { readout_ms, width: 320, height: 240, ..small(motion) };
        let shown = frames(&params);
        let camera = Synthetic::new(&params).unwrap();
        let (mut right, mut wrong, mut count) = (0.0, 0.0, 0);
        for y in (20..220).step_by(5) {
            for x in (20..300).step_by(5) {
                let here = [f64::from(x), f64::from(y)];
                let ray = camera.ray(here, camera.row_time_s(0, here[1]));
                let located = camera.locate(ray, 0).unwrap();
                assert!((located[0] - here[0]).abs() < 1e-6 && (located[1] - here[1]).abs() < 1e-6);
                let there = camera.locate(ray, 2).unwrap();
                if !(1.0..318.0).contains(&there[0]) || !(1.0..238.0).contains(&there[1]) {
                    continue;
                }
                let value = at(&shown[0], 320, here);
                right += (at(&shown[2], 320, there) - value).abs();
                wrong += (at(&shown[2], 320, here) - value).abs();
                count += 1;
            }
        }
        let (right, wrong) = (right / f64::from(count), wrong / f64::from(count));
        assert!(
            count > 1000 && right < 3.0 && wrong > 4.0 * right,
            "{motion:?}: {right} at the right place, {wrong} at the old"
        );
    }
}

#[test]
fn times_follow_rate_and_readout() {
    let camera = Synthetic::new(&Params { fps: 29.97, readout_ms: -12.0, ..small(Motion::Still) }).unwrap();
    assert_eq!(camera.format().interval, (100, 2997));
    assert!((camera.row_time_s(3, 60.0) - (3.0 / 29.97 - 0.006)).abs() < 1e-12);
    assert_eq!(interval(30.0), (1, 30));
    assert_eq!(interval(12.5), (2, 25));
}

#[test]
fn settings_out_of_range_are_named() {
    let refusal = |params: Params| Synthetic::new(&params).unwrap_err();
    assert!(refusal(Params { width: 0, ..Params::default() }).contains("width is 0, expected 16 to 8192"));
    assert!(refusal(Params { fps: f64::NAN, ..Params::default() }).contains("fps is NaN"));
}
