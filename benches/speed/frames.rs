//! Whole frames through the pipeline on one thread: YUYV, NV12 and MJPEG in, YUYV out.

use std::hint::black_box;
use std::time::Instant;

use gimbald::command::bench::{Measured, json, measure as measure_case, table};
use gimbald::device::rehearsal::Rehearsal;
use gimbald::device::synthetic;
use gimbald::device::{FrameSource, Lent};
use gimbald::image::PixelFormat;
use gimbald::pipeline::Params;
use gimbald::rt::stop::Stop;

use crate::Record;

/// Sizes, and how many frames each is measured over.
const SIZES: [([u32; 2], u64); 3] = [([640, 480], 600), ([1280, 720], 600), ([1920, 1080], 600)];
const FORMATS: [PixelFormat; 3] = [PixelFormat::Yuyv, PixelFormat::Nv12, PixelFormat::Mjpeg];

/// Measures what is asked for.
pub fn measure(record: &mut Record) {
    let mut done: Vec<Measured> = Vec::new();
    for (size, frames) in SIZES {
        for pixel in FORMATS {
            let name = format!("frames {}x{} {pixel}", size[0], size[1]);
            if !record.wants(&name) || (!record.measuring && size[0] > 640) {
                continue;
            }
            let frames = if record.measuring { frames } else { 5 };
            match measure_case(&Params::default(), size, pixel, frames, None, &Stop::default()) {
                Ok(measured) => done.push(measured),
                Err(failure) => record.say(&format!("{name}: {}", failure.message)),
            }
        }
    }
    if done.is_empty() {
        return;
    }
    let mut text = Vec::new();
    if table(&mut text, &done).is_ok() {
        String::from_utf8_lossy(&text).lines().for_each(|line| record.say(line));
    }
    for measured in done.iter().filter(|measured| measured.pixel == PixelFormat::Mjpeg) {
        decoder(record, measured);
    }
    record.values.insert("frames".into(), json(&done));
}

/// What the decoder takes by itself, beside what unpacking took.
fn decoder(record: &mut Record, measured: &Measured) {
    let [width, height] = measured.size;
    let camera = synthetic::Params { width, height, frames: 40, ..synthetic::Params::default() };
    let Ok(mut source) = Rehearsal::new(&camera, PixelFormat::Mjpeg) else { return };
    let Ok(mut decoder) = turbojpeg::Decompressor::new() else { return };
    let mut planes = vec![0u8; 2 * width as usize * height as usize];
    let mut times = Vec::new();
    while let Ok(Lent::Frame(frame)) = source.lend() {
        let started = Instant::now();
        let image = turbojpeg::YuvImage {
            pixels: &mut planes[..],
            width: width as usize,
            align: 1,
            height: height as usize,
            subsamp: turbojpeg::Subsamp::Sub2x1,
        };
        let decoded = decoder.decompress_to_yuv(frame.bytes, image);
        black_box(&mut planes);
        if decoded.is_ok() {
            times.push(started.elapsed().as_nanos() as u64);
        }
    }
    times.sort_unstable();
    let alone = times.get(times.len() / 2).copied().unwrap_or(0) as f64 * 1e-6;
    let unpack = measured.stats.stage(gimbald::frame::Stage::Unpack).median_ms;
    let ratio = unpack / alone.max(1e-9);
    record.say(&format!("{width}x{height} MJPG: the decoder alone {alone:.3} ms, unpacking {unpack:.3} ms ({ratio:.2} x)"));
    let values = serde_json::json!({ "alone_ms": alone, "unpack_ms": unpack });
    record.values.insert(format!("decoder {width}x{height}"), values);
}
