//! A synthetic camera: it turns in front of a generated scene, and exposes its rows one after the other.
//!
//! Row `v` of frame `k` is exposed at `t = k / fps + readout * v / height`, for an instant (nothing is blurred), in the pose that
//! [`Synthetic::pose_at`] gives for `t`, so that estimates can be compared with the truth.

mod motion;
mod optics;
mod patterns;
mod room;
mod scene;

pub use motion::Motion;

use super::{DeviceError, FrameSource, Lent, RawFrame, StreamFormat};
use crate::frame::{FrameFlags, Stamp};
use crate::geometry::Pose;
use crate::image::{Colour, PixelFormat, Range, Siting};
use crate::random::{SplitMix, mix};
use motion::Path;
use optics::Optics;

use scene::{Scene, Texture};

/// Settings of the synthetic camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Params {
    /// Width (pixels, 16 to 8192).
    pub width: u32,
    /// Height (pixels, 16 to 8192).
    pub height: u32,
    /// Frames a second (1 to 1000, to a thousandth).
    pub fps: f64,
    /// Horizontal field of view (degrees, 10 to 120).
    pub hfov_deg: f64,
    /// Time from the exposure of the first row to that of one row past the last (milliseconds, -100 to 100; negative: bottom to
    /// top).
    pub readout_ms: f64,
    /// How it moves.
    pub motion: Motion,
    /// How much: 1 as [`Motion`] says (0 to 10).
    pub gain: f64,
    /// What it looks at.
    pub view: View,
    /// Of what it looks at, the motion and the noise.
    pub seed: u64,
    /// How many frames there are; 0: without end.
    pub frames: u64,
    /// Deviation of the luma's noise (grey levels, 0 to 50).
    pub noise: f64,
}

impl Default for Params {
    fn default() -> Self {
        Self {
            width: 640,
            height: 480,
            fps: 30.0,
            hfov_deg: 60.0,
            readout_ms: 25.0,
            motion: Motion::Handheld,
            gain: 1.0,
            view: View::Wall,
            seed: 1,
            frames: 150,
            noise: 1.5,
        }
    }
}

/// What the synthetic camera looks at.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum View {
    /// A wall of random shapes, with corners everywhere: for measurements.
    #[default]
    Wall,
    /// A drawn room with a person, for people to look at.
    Room,
    /// Printed rectangles, upright and of one size: what the paper's experiments look at.
    Patterns,
}

/// Normally distributed numbers, drawn once; a power of two.
const NOISES: usize = 1 << 15;

/// The camera. Gives planar 4:2:0, limited range, chroma in the midst of its four luma samples.
#[derive(Clone, Debug)]
pub struct Synthetic {
    params: Params,
    format: StreamFormat,
    optics: Optics,
    path: Path,
    scene: Scene,
    noises: Vec<f32>,
    next: u64,
    bytes: Vec<u8>,
    row: Row,
}

/// Memory for one row: where in the texture its pixels look, and what they see there.
#[derive(Clone, Debug, Default)]
struct Row {
    x: Vec<f32>,
    y: Vec<f32>,
    seen: Vec<f32>,
}

impl Synthetic {
    /// A camera; paints its wall (some tenths of a second).
    ///
    /// # Errors
    /// A sentence that names the setting out of its range.
    pub fn new(params: &Params) -> Result<Self, String> {
        let p = *params;
        for (name, value, low, high) in [
            ("width", f64::from(p.width), 16.0, 8192.0),
            ("height", f64::from(p.height), 16.0, 8192.0),
            ("fps", p.fps, 1.0, 1000.0),
            ("hfov_deg", p.hfov_deg, 10.0, 120.0),
            ("readout_ms", p.readout_ms, -100.0, 100.0),
            ("gain", p.gain, 0.0, 10.0),
            ("noise", p.noise, 0.0, 50.0),
        ] {
            if !(low..=high).contains(&value) {
                return Err(format!("synthetic camera: {name} is {value}, expected {low} to {high}"));
            }
        }
        let mut format = StreamFormat::tight(p.width, p.height, PixelFormat::I420, interval(p.fps));
        format.colour = Colour { range: Range::Limited, siting: Siting::Centre };
        let mut random = SplitMix::new(p.seed ^ 0x006e_6f69_7365);
        let noises = if p.noise > 0.0 { NOISES } else { 0 };
        let luma = p.width as usize * p.height as usize;
        let chroma = p.width.div_ceil(2) as usize * p.height.div_ceil(2) as usize;
        let duration = if p.frames == 0 { f64::MAX } else { p.frames as f64 / p.fps };
        let width = p.width as usize;
        Ok(Self {
            params: p,
            format,
            optics: Optics::new(p.width, p.height, p.hfov_deg),
            path: Path::new(p.motion, p.gain, p.seed, duration),
            scene: match p.view {
                View::Wall => Scene::new(p.seed),
                View::Room => Scene::room(p.width, p.seed),
                View::Patterns => Scene::patterns(p.width, p.seed),
            },
            noises: (0..noises).map(|_| (random.normal() * p.noise) as f32).collect(),
            next: 0,
            bytes: vec![0; luma + 2 * chroma],
            row: Row { x: vec![0.0; width], y: vec![0.0; width], seen: vec![0.0; width] },
        })
    }

    /// The settings it was made with.
    pub fn params(&self) -> &Params {
        &self.params
    }

    /// Focal length at a log zoom of 0, pixels.
    pub fn focal_px(&self) -> f64 {
        self.optics.focal
    }

    /// Yaw, pitch and roll in radians and log zoom, `t_s` seconds after the first row of the first frame. `Rz(roll) Rx(pitch)
    /// Ry(yaw)` takes rays of the camera (x right, y down, z ahead) to rays of the scene.
    pub fn pose_at(&self, t_s: f64) -> Pose {
        self.path.at(t_s)
    }

    /// When row `row` (0 is the centre of the first) of frame `frame` is exposed, seconds.
    pub fn row_time_s(&self, frame: u64, row: f64) -> f64 {
        let (numerator, denominator) = self.format.interval;
        frame as f64 * f64::from(numerator) / f64::from(denominator)
            + self.params.readout_ms * 1e-3 * row / f64::from(self.params.height)
    }

    /// The scene ray that pixel `(x, y)` sees at `t_s` (not normalized).
    pub fn ray(&self, [x, y]: [f64; 2], t_s: f64) -> [f64; 3] {
        let [origin, right, down] = self.optics.rays(self.pose_at(t_s));
        [0, 1, 2].map(|n: usize| origin[n] + x * right[n] + y * down[n])
    }

    /// The pixel at which a camera without rolling shutter would see scene ray `ray` at `t_s`; `None` behind it.
    pub fn project(&self, ray: [f64; 3], t_s: f64) -> Option<[f64; 2]> {
        self.optics.project(ray, self.pose_at(t_s))
    }

    /// The pixel at which frame `frame` shows scene ray `ray`, each row in its own time; `None` behind the camera and where the
    /// camera turns so fast that no row settles. May lie outside the picture.
    pub fn locate(&self, ray: [f64; 3], frame: u64) -> Option<[f64; 2]> {
        let mut row = f64::from(self.params.height) / 2.0;
        for _ in 0..64 {
            let seen = self.project(ray, self.row_time_s(frame, row))?;
            if (seen[1] - row).abs() < 1e-10 {
                return Some(seen);
            }
            row = seen[1];
        }
        None
    }

    /// Draws frame `frame` into `self.bytes`.
    fn draw(&mut self, frame: u64) {
        let (width, height) = (self.params.width as usize, self.params.height as usize);
        let (chroma_width, chroma_height) = (width.div_ceil(2), height.div_ceil(2));
        let mut bytes = std::mem::take(&mut self.bytes);
        let (luma, chroma) = bytes.split_at_mut(width * height);
        let (u, v) = chroma.split_at_mut(chroma_width * chroma_height);
        for (y, out) in luma.chunks_exact_mut(width).enumerate() {
            self.aim(frame, [0.0, y as f64], 1.0, width);
            sample(&self.scene.luma, &mut self.row, out.len());
            if !self.noises.is_empty() {
                let from = mix(self.params.seed ^ mix(frame << 20 | y as u64)) as usize;
                for (n, seen) in self.row.seen[..width].iter_mut().enumerate() {
                    *seen += self.noises[from.wrapping_add(n) & (NOISES - 1)];
                }
            }
            round(&self.row.seen, out);
        }
        for (y, (u, v)) in u.chunks_exact_mut(chroma_width).zip(v.chunks_exact_mut(chroma_width)).enumerate() {
            self.aim(frame, [0.5, 2.0 * y as f64 + 0.5], 2.0, chroma_width);
            for (texture, out) in self.scene.chroma.iter().zip([u, v]) {
                sample(texture, &mut self.row, out.len());
                round(&self.row.seen, out);
            }
        }
        self.bytes = bytes;
    }

    /// Sets `self.row` to where `count` pixels, `step` apart, beginning at `(x, y)`, look; in texels `step` luma texels large.
    fn aim(&mut self, frame: u64, [x, y]: [f64; 2], step: f64, count: usize) {
        let pose = self.pose_at(self.row_time_s(frame, y));
        let [origin, right, down] = self.optics.rays(pose);
        // One texel to one pixel, in the middle of the wall.
        let scale = self.optics.focal / step;
        let middle = Scene::CENTRE.map(|c| ((c - (step - 1.0) / 2.0) / step) as f32);
        let start = [0, 1, 2].map(|n: usize| origin[n] + x * right[n] + y * down[n]);
        let [sx, sy, sz] = [(start[0] * scale) as f32, (start[1] * scale) as f32, start[2] as f32];
        let [dx, dy, dz] = [(right[0] * step * scale) as f32, (right[1] * step * scale) as f32, (right[2] * step) as f32];
        for (n, (x, y)) in self.row.x[..count].iter_mut().zip(&mut self.row.y[..count]).enumerate() {
            let n = n as f32;
            let near = 1.0 / (sz + n * dz).max(1e-3);
            *x = (sx + n * dx) * near + middle[0];
            *y = (sy + n * dy) * near + middle[1];
        }
    }
}

fn sample(texture: &Texture, row: &mut Row, count: usize) {
    texture.sample(&row.x[..count], &row.y[..count], &mut row.seen[..count]);
}

fn round(seen: &[f32], out: &mut [u8]) {
    for (out, seen) in out.iter_mut().zip(seen) {
        *out = (seen + 0.5) as u8;
    }
}

/// A rate as the time between frames, a fraction of whole numbers.
fn interval(fps: f64) -> (u32, u32) {
    let (mut a, mut b) = (1000, (fps * 1000.0).round() as u32);
    let (numerator, denominator) = (a, b);
    while b != 0 {
        (a, b) = (b, a % b);
    }
    (numerator / a, denominator / a)
}

impl FrameSource for Synthetic {
    fn format(&self) -> StreamFormat {
        self.format
    }

    fn frames(&self) -> Option<u64> {
        (self.params.frames > 0).then_some(self.params.frames)
    }

    fn lend(&mut self) -> Result<Lent<'_>, DeviceError> {
        if self.params.frames > 0 && self.next >= self.params.frames {
            return Ok(Lent::End);
        }
        self.draw(self.next);
        let stamp =
            Stamp { time_ns: self.format.nominal_time_ns(self.next), sequence: self.next, flags: FrameFlags::default() };
        self.next += 1;
        Ok(Lent::Frame(RawFrame { format: self.format, bytes: &self.bytes, stamp }))
    }
}

#[cfg(test)]
mod tests;
