//! Each kernel at each level, beside a copy of the bytes that it goes over.

use std::hint::black_box;
use std::time::Instant;

use gimbald::command::bench::{Copies, CopyTimes};
use gimbald::frame::Frame;
use gimbald::geometry::{Homography, OutputMap, Pinhole, Pose, RowPoses};
use gimbald::image::{Picture, PixelFormat, RawLayout, Sampling, Siting};
use gimbald::kernel::convert::{self, LumaFirst};
use gimbald::kernel::{Level, lk, pyramid};
use gimbald::stage::{detect, track, warp};
use serde_json::json;

use crate::{Record, clip};

/// Sizes that are measured.
const SIZES: [[u32; 2]; 3] = [[640, 480], [1280, 720], [1920, 1080]];
/// Time for one number, nanoseconds.
const PATIENCE_NS: u128 = 150_000_000;

/// This thread's time on a processor, nanoseconds: what others take of a busy machine does not count.
fn spent_ns() -> u64 {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}

/// Median nanoseconds of `step`.
fn median_ns(measuring: bool, mut step: impl FnMut()) -> f64 {
    step();
    let (mut times, begun) = (Vec::new(), Instant::now());
    loop {
        let started = spent_ns();
        step();
        times.push(spent_ns() - started);
        if !measuring || begun.elapsed().as_nanos() > PATIENCE_NS || times.len() > 20_000 {
            break;
        }
    }
    times.sort_unstable();
    times[times.len() / 2] as f64
}

/// Measures what is asked for.
pub fn measure(record: &mut Record) {
    let sizes = if record.measuring { &SIZES[..] } else { &SIZES[..1] };
    for &size in sizes {
        let name = format!("{}x{}", size[0], size[1]);
        if ["copy", "halve", "unpack", "pack", "warp", "detect", "track"].iter().any(|kernel| record.wants(kernel)) {
            let frames = clip::neighbours(size);
            one_size(record, &name, &frames);
        }
    }
    if record.wants("patch") {
        patches(record);
    }
}

fn one_size(record: &mut Record, name: &str, frames: &[Frame; 2]) {
    let luma = frames[1].picture.luma();
    let [width, height] = [luma.width(), luma.height()];
    let copy = |bytes: usize| {
        let (mut copies, begun) = (Copies::new(bytes), Instant::now());
        loop {
            copies.measure();
            if !record.measuring || begun.elapsed().as_nanos() > PATIENCE_NS {
                break;
            }
        }
        copies.times()
    };
    let (plane, picture) = (copy(width * height), copy(width * height * 3 / 2));
    if record.wants("copy") {
        for (way, of) in
            [("in cache", (|times| times.cache_ns) as fn(CopyTimes) -> u64), ("through memory", |times| times.memory_ns)]
        {
            let [luma_ms, picture_ms] = [plane, picture].map(|times| 1e-6 * of(times) as f64);
            record.say(&format!("{name:>10}  copy     {way:<14} of luma {luma_ms:8.3} ms, of 4:2:0 {picture_ms:8.3} ms"));
            record.values.insert(format!("copy {way} {name}"), json!({ "luma_ms": luma_ms, "picture_ms": picture_ms }));
        }
    }
    // the loops below work on the same pictures again and again, too
    let (plane, picture) = (plane.cache_ns as f64, picture.cache_ns as f64);
    let mut tell = |kernel: &str, against: f64, step: &mut dyn FnMut(Level)| {
        if !record.wants(kernel) {
            return;
        }
        for level in Level::all() {
            let ns = median_ns(record.measuring, || step(level));
            let (ms, ratio) = (ns * 1e-6, ns / against);
            record.say(&format!("{name:>10}  {kernel:<8} {:<8} {ms:8.3} ms {ratio:8.2} x cached copy", level.name()));
            record
                .values
                .insert(format!("{kernel} {name} {}", level.name()), json!({ "median_ms": ms, "cached_copies": ratio }));
        }
    };
    let mut half = Picture::new(Sampling::Mono, width / 2, height / 2);
    tell("halve", plane, &mut |level| pyramid::halve(level, luma, half.as_mut().planes[0].reborrow()));
    formats(&mut tell, picture, &frames[1].picture);
    warps(&mut tell, picture, &frames[1].picture);
    let mut tracked = frames[1].clone_of();
    tell("detect", plane, &mut |level| {
        let mut features = Vec::with_capacity(1000);
        detect::Detector::with_level(detect::Params::default(), level).replenish(&frames[0], &mut features);
        black_box(&mut features);
    });
    let mut corners = Vec::new();
    detect::Detector::new(detect::Params::default()).replenish(&frames[0], &mut corners);
    let mut features = corners.clone();
    tell("track", plane, &mut |level| {
        features.clone_from(&corners);
        track::Tracker::new(track::Params::default(), level).follow(&frames[0], &mut tracked, &mut features);
        black_box(&mut features);
    });
}

type Tell<'a> = dyn FnMut(&str, f64, &mut dyn FnMut(Level)) + 'a;

/// Unpacking and packing.
fn formats(tell: &mut Tell<'_>, against: f64, picture: &Picture) {
    let (width, height) = (picture.width() as u32, picture.height() as u32);
    let stride = PixelFormat::Yuyv.tight_stride(width);
    let mut bytes = vec![0u8; stride * height as usize];
    tell("pack", against, &mut |level| {
        convert::pack(level, picture.as_ref(), PixelFormat::Yuyv, stride, &mut bytes).expect("the bytes suffice");
        black_box(&mut bytes);
    });
    let mut into = Picture::new(Sampling::S420, picture.width(), picture.height());
    let layout = RawLayout::new(PixelFormat::Yuyv, width, height, stride).expect("a usual size");
    let from = layout.planes(&bytes).expect("the bytes suffice")[0];
    tell("unpack", against, &mut |level| {
        convert::packed_422(level, LumaFirst::Yes, black_box(from), into.as_mut());
        black_box(&mut into);
    });
}

/// The warp with a still view, and with rows that move.
fn warps(tell: &mut Tell<'_>, against: f64, picture: &Picture) {
    let size = [picture.width(), picture.height()];
    let camera = Pinhole::new(size, 60.0);
    let [cx, cy] = camera.centre;
    let zoom = 1.0 / 1.1;
    let zoomed = nalgebra::Matrix3::new(zoom, 0.0, cx - zoom * cx, 0.0, zoom, cy - zoom * cy, 0.0, 0.0, 1.0);
    let spacing = (size[1] as f64 - 1.0) / (RowPoses::SAMPLES - 1) as f64;
    let rows = |degrees: f64| RowPoses {
        samples: std::array::from_fn(|i| {
            let t = i as f64 / (RowPoses::SAMPLES - 1) as f64 - 0.5;
            Pose([t * degrees.to_radians(), 0.7 * t * degrees.to_radians(), 0.3 * t * degrees.to_radians(), 0.0])
        }),
        spacing,
    };
    let mut drawn = Picture::new(Sampling::S420, size[0], size[1]);
    for (name, roll, turn) in [("warp", 0.3, 0.7), ("warp0", 0.0, 0.0), ("warp3", 3.0, 2.0)] {
        let view = Homography(camera.turned(Pose([0.005, -0.004, f64::to_radians(roll), 0.0])).0 * zoomed);
        let map = OutputMap::Rows { window: Homography::IDENTITY, view, camera, kept: camera.bend, rows: rows(turn) };
        tell(name, against, &mut |level| {
            warp::Warper::new(&warp::Params::default(), level, Siting::Left).draw(&map, picture.as_ref(), &mut drawn.as_mut());
            black_box(&mut drawn);
        });
    }
}

/// One patch: a template, and one comparison.
fn patches(record: &mut Record) {
    let [before, now] = clip::neighbours([640, 480]);
    for level in Level::all() {
        let (from, to) = (before.picture.luma(), now.picture.luma());
        let mut template = lk::Template::<16>::default();
        let places: Vec<[f32; 2]> = (0..400).map(|i| [40.3 + (i % 20) as f32 * 27.7, 40.6 + (i / 20) as f32 * 19.3]).collect();
        let take = median_ns(record.measuring, || {
            for &place in &places {
                template.extract(level, from, place);
                black_box(&mut template);
            }
        });
        let compare = median_ns(record.measuring, || {
            for &place in &places {
                black_box(template.compare(level, to, place));
            }
        });
        let [take, compare] = [take, compare].map(|ns| ns / places.len() as f64);
        record.say(&format!(
            "{:>10}  patch    {:<8} template {take:6.0} ns, comparison {compare:6.0} ns",
            "16x16",
            level.name()
        ));
        let values = json!({ "template_ns": take, "comparison_ns": compare });
        record.values.insert(format!("patch 16 {}", level.name()), values);
    }
}

trait CloneOf {
    fn clone_of(&self) -> Frame;
}

impl CloneOf for Frame {
    /// Another frame with the same picture.
    fn clone_of(&self) -> Frame {
        Frame {
            picture: self.picture.clone(),
            pyramid: self.pyramid.clone(),
            intact: true,
            stamp: self.stamp,
            ..Frame::default()
        }
    }
}
