//! What several tests need: sources that follow a script, a wall to look at, and an observer that remembers what it was shown.
#![allow(dead_code, reason = "each test takes what it needs of it")]

pub mod paced;
pub mod stamps;

use gimbald::device::synthetic::{self, Synthetic};
use gimbald::device::{DeviceError, FrameSource, Lent, RawFrame, StreamFormat};
use gimbald::frame::{Fit, Frame, FrameFlags, Outcome, PathParameters, Stamp, Track};
use gimbald::geometry::{OutputMap, RowMotion};
use gimbald::image::{Picture, PictureRef, PixelFormat};
use gimbald::kernel::Level;
use gimbald::random::{Congruential, SplitMix};
use gimbald::stage::pyramid;
use gimbald::stage::unpack::Unpack;

/// A frame to be given.
#[derive(Clone, Debug)]
pub struct Shot {
    pub format: StreamFormat,
    pub bytes: Vec<u8>,
    pub stamp: Stamp,
}

impl Shot {
    /// A planar or grey picture of noise, or of one colour where `contrast` is 0.
    pub fn noise(pixel: PixelFormat, [width, height]: [u32; 2], mean: u8, contrast: u8, seed: u64) -> Self {
        let format = StreamFormat::tight(width, height, pixel, (1, 30));
        let mut random = Congruential::scattered(seed);
        let bytes = (0..format.frame_bytes().unwrap()).map(|_| {
            let part = (random.bits() >> 40) as f64 / f64::from(1 << 24) - 0.5;
            (f64::from(mean) + part * f64::from(contrast)).clamp(0.0, 255.0) as u8
        });
        Self { format, bytes: bytes.collect(), stamp: Stamp::default() }
    }

    /// The top-left part of a 4:2:0 picture, in another form; chroma is repeated where the form has more of it.
    pub fn cut(&self, pixel: PixelFormat, [width, height]: [u32; 2]) -> Self {
        assert_eq!(self.format.pixel, PixelFormat::I420);
        let (from_width, from_height) = (self.format.width as usize, self.format.height as usize);
        let chroma_width = from_width.div_ceil(2);
        let luma = from_width * from_height;
        let chroma = chroma_width * from_height.div_ceil(2);
        let format =
            StreamFormat { colour: self.format.colour, ..StreamFormat::tight(width, height, pixel, self.format.interval) };
        let (w, h) = (width as usize, height as usize);
        let mut bytes = Vec::with_capacity(format.frame_bytes().unwrap());
        for y in 0..h {
            bytes.extend_from_slice(&self.bytes[y * from_width..][..w]);
        }
        let shift = match pixel {
            PixelFormat::I420 => Some((1, 1)),
            PixelFormat::I422 => Some((1, 0)),
            PixelFormat::I444 => Some((0, 0)),
            _ => None,
        };
        if let Some((sx, sy)) = shift {
            for plane in 0..2 {
                let from = &self.bytes[luma + plane * chroma..][..chroma];
                for y in 0..h.div_ceil(1 << sy) {
                    for x in 0..w.div_ceil(1 << sx) {
                        bytes.push(from[((y << sy) / 2) * chroma_width + (x << sx) / 2]);
                    }
                }
            }
        }
        assert_eq!(Some(bytes.len()), format.frame_bytes());
        Self { format, bytes, stamp: self.stamp }
    }

    /// The same picture as the camera's driver marks a damaged one.
    pub fn damaged(mut self) -> Self {
        self.stamp.flags = FrameFlags::ERROR;
        self
    }

    /// The first `part` of the picture's bytes.
    pub fn truncated(mut self, part: f64) -> Self {
        self.bytes.truncate((self.bytes.len() as f64 * part) as usize);
        self
    }
}

/// Every frame of a synthetic camera.
pub fn film(params: &synthetic::Params) -> Vec<Shot> {
    filmed(&mut Synthetic::new(params).unwrap())
}

/// The frames that a synthetic camera still has to give.
pub fn filmed(camera: &mut Synthetic) -> Vec<Shot> {
    let mut shots = Vec::new();
    while let Lent::Frame(RawFrame { format, bytes, stamp }) = camera.lend().unwrap() {
        shots.push(Shot { format, bytes: bytes.to_vec(), stamp });
    }
    shots
}

/// Numbers the frames and gives them the times of a steady camera.
pub fn in_time(shots: &mut [Shot], fps: f64) {
    for (n, shot) in shots.iter_mut().enumerate() {
        shot.stamp.time_ns = (n as f64 * 1e9 / fps) as i64;
        shot.stamp.sequence = n as u64;
    }
}

/// A source that gives the frames it was given, and then ends, or fails.
pub struct Script {
    pub format: StreamFormat,
    pub shots: Vec<Shot>,
    pub next: usize,
    pub error: Option<DeviceError>,
}

impl Script {
    pub fn new(shots: Vec<Shot>) -> Self {
        Self { format: shots[0].format, shots, next: 0, error: None }
    }
}

impl FrameSource for Script {
    fn format(&self) -> StreamFormat {
        self.format
    }

    fn lend(&mut self) -> Result<Lent<'_>, DeviceError> {
        let Some(Shot { format, bytes, stamp }) = self.shots.get(self.next) else {
            return self.error.take().map_or(Ok(Lent::End), Err);
        };
        self.next += 1;
        Ok(Lent::Frame(RawFrame { format: *format, bytes, stamp: *stamp }))
    }
}

/// What an observer saw of a frame.
#[derive(Clone, Debug)]
pub struct Seen {
    pub stamp: Stamp,
    pub size: [usize; 2],
    pub output: [usize; 2],
    pub outcome: Outcome,
    pub repeat: bool,
    pub intact: bool,
    pub interval_s: f64,
    pub map: OutputMap,
    pub rows: RowMotion,
    pub motion: PathParameters,
    pub path: PathParameters,
    pub smoothed: PathParameters,
    pub trust: f64,
    pub crop_use: f64,
    pub fit: Fit,
    pub tracks: Vec<Track>,
    pub digest: u64,
}

impl Seen {
    /// Where the output's corners and its centre come from.
    pub fn corners(&self) -> [[f64; 2]; 5] {
        let [right, bottom] = self.output.map(|n| n as f64 - 1.0);
        [[0.0, 0.0], [right, 0.0], [0.0, bottom], [right, bottom], [0.5 * right, 0.5 * bottom]].map(|at| self.map.apply(at))
    }
}

/// Remembers every frame.
#[derive(Debug, Default)]
pub struct Memory {
    pub seen: Vec<Seen>,
}

impl gimbald::pipeline::Observer for Memory {
    fn drawn(&mut self, frame: &Frame, output: PictureRef<'_>) {
        let context = &frame.context;
        let mut digest = gimbald::device::digest::Hash::default();
        digest.picture(output);
        self.seen.push(Seen {
            stamp: frame.stamp,
            size: [frame.picture.width(), frame.picture.height()],
            output: [output.width(), output.height()],
            outcome: context.outcome,
            repeat: context.repeat,
            intact: frame.intact,
            interval_s: context.interval_s,
            map: context.map,
            rows: context.rows,
            motion: context.motion,
            path: context.path,
            smoothed: context.smoothed,
            trust: context.trust,
            crop_use: context.crop_use,
            fit: context.fit,
            tracks: context.tracks.clone(),
            digest: digest.value(),
        });
    }
}

/// A frame with its pyramid, as the tracker wants it.
pub fn frame_of(shot: &Shot) -> Frame {
    let mut frame = Frame { stamp: shot.stamp, intact: true, ..Frame::default() };
    let format = shot.format;
    Unpack::new()
        .unpack(
            format.pixel,
            format.colour.range,
            (format.width, format.height),
            format.stride,
            &shot.bytes,
            &mut frame.picture,
        )
        .unwrap();
    pyramid::build(Level::detected(), frame.picture.luma(), &mut frame.pyramid);
    frame
}

/// A grey picture of `brightness` (x, y), as a frame with its pyramid.
pub fn drawn_frame(width: usize, height: usize, brightness: impl Fn(f64, f64) -> f64) -> Frame {
    let mut picture = Picture::new(gimbald::image::Sampling::Mono, width, height);
    let [luma, ..] = &mut picture.as_mut().planes;
    for y in 0..height {
        for (x, out) in luma.row_mut(y).iter_mut().enumerate() {
            *out = (brightness(x as f64, y as f64) + 0.5).clamp(0.0, 255.0) as u8;
        }
    }
    let mut frame = Frame { picture, intact: true, ..Frame::default() };
    pyramid::build(Level::detected(), frame.picture.luma(), &mut frame.pyramid);
    frame
}

/// About normally distributed, standard deviation 1: the sum of twelve.
pub fn normal(random: &mut SplitMix) -> f64 {
    0.5 * (0..12).map(|_| random.signed()).sum::<f64>()
}

/// The value below which the part `share` of `values` lies.
pub fn quantile(values: &mut [f64], share: f64) -> f64 {
    assert!(!values.is_empty());
    values.sort_unstable_by(f64::total_cmp);
    values[((values.len() - 1) as f64 * share).round() as usize]
}
