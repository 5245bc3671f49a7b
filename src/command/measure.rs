//! `gimbald measure`: the shake of a clip as numbers.

use std::path::{Path, PathBuf};

use serde_json::json;

use super::interrupt::stop_on_signal;
use super::print::print;
use super::watch::Watch;
use super::{Exit, Failure, SettingsArgs};
use crate::device::null::NullSink;
use crate::device::replay;
use crate::frame::Frame;
use crate::image::PictureRef;
use crate::pipeline::{Observer, Params, run_inline};
use crate::rt::stop::Stop;

/// Arguments of `measure`.
#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    /// Clips to measure (y4m, .gbr), e.g. before and after stabilization
    #[arg(value_name = "CLIP", required = true)]
    clips: Vec<PathBuf>,
    /// Settings of the tracker
    #[command(flatten)]
    settings: SettingsArgs,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// Errors in the settings, a clip that cannot be read, and one in which no motion can be measured.
pub fn run(args: &Args) -> Result<(), Failure> {
    let settings = args.settings.read()?;
    let stop = stop_on_signal(None)?;
    let mut measured = Vec::new();
    for path in &args.clips {
        let shake = measure(&settings.pipeline, path, &stop)?;
        if stop.is_set() {
            return Err(Failure::new(Exit::Interrupted, "interrupted; no result"));
        }
        if shake.count == 0 {
            let what = format!("{}: no motion can be measured: fewer than 3 frames, or nothing to track", path.display());
            return Err(Failure::new(Exit::Inconclusive, what));
        }
        measured.push((path, shake));
    }
    let text = if args.json {
        let clips: Vec<_> = measured.iter().map(|(path, shake)| shake.json(path)).collect();
        format!("{:#}\n", json!({ "clips": clips }))
    } else {
        measured.iter().map(|(path, shake)| format!("{}: {}\n", path.display(), shake.text())).collect()
    };
    print(&text)
}

/// Tracks a clip's frames as an input's are, without drawing anything.
///
/// # Errors
/// Where the clip cannot be read.
pub(super) fn measure(params: &Params, path: &Path, stop: &Stop) -> Result<Shake, Failure> {
    let mut source = replay::open(path)?;
    let mut sink = NullSink::new(&source.format());
    let mut both = (Watch::new("measuring", source.frames(), stop.clone()), Shake::default());
    let ran = run_inline(source.as_mut(), &mut sink, params, stop, &mut both);
    both.0.end(ran)?;
    Ok(both.1)
}

/// How a clip shakes, from the homographies between its frames: by how much the motion of the picture's centre, and its slant, change
/// from one frame to the next. A steady pan has no shake.
#[derive(Debug, Default)]
pub(super) struct Shake {
    /// Motion of the centre (x, y, pixels) and slant (radians) against the previous frame.
    last: Option<[f64; 3]>,
    /// Sums of squares of their changes.
    sums: [f64; 3],
    /// Number of changes.
    count: u64,
}

impl Shake {
    /// Root mean square of the change of the centre's motion, pixels per frame per frame.
    pub(super) fn centre_px(&self) -> f64 {
        ((self.sums[0] + self.sums[1]) / self.count.max(1) as f64).sqrt()
    }

    /// Root mean square of the change of the slant, degrees.
    pub(super) fn slant_deg(&self) -> f64 {
        (self.sums[2] / self.count.max(1) as f64).sqrt().to_degrees()
    }

    fn text(&self) -> String {
        let (shake, slant) = (self.centre_px(), self.slant_deg());
        format!("shake {shake:.2} px, slant {slant:.3} degrees (RMS change from frame to frame, {} changes)", self.count)
    }

    fn json(&self, path: &Path) -> serde_json::Value {
        json!({
            "clip": path.to_string_lossy(),
            "shake_px": self.centre_px(),
            "slant_deg": self.slant_deg(),
            "changes": self.count,
        })
    }
}

impl Observer for Shake {
    fn drawn(&mut self, frame: &Frame, _: PictureRef<'_>) {
        let fit = &frame.context.fit;
        if fit.inliers == 0 {
            self.last = None;
            return;
        }
        let centre = [frame.picture.width() as f64 / 2.0, frame.picture.height() as f64 / 2.0];
        let moved = fit.homography.apply(centre);
        let h = &fit.homography.0;
        let now = [moved[0] - centre[0], moved[1] - centre[1], (h[(0, 1)] / h[(1, 1)]).atan()];
        if let Some(last) = self.last.replace(now) {
            (0..3).for_each(|i| self.sums[i] += (now[i] - last[i]).powi(2));
            self.count += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Homography;

    #[test]
    fn a_steady_pan_has_no_shake_and_a_jump_has() {
        let frame = |shift: f64| {
            let mut frame = Frame::default();
            frame.context.fit.inliers = 50;
            frame.context.fit.homography = Homography(nalgebra::Matrix3::new(1.0, 0.0, shift, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0));
            frame
        };
        let picture = crate::image::Picture::default();
        let shake = |shifts: &[f64]| {
            let mut shake = Shake::default();
            shifts.iter().for_each(|shift| shake.drawn(&frame(*shift), picture.as_ref()));
            shake
        };
        assert_eq!((shake(&[3.0; 5]).centre_px(), shake(&[3.0; 5]).count), (0.0, 4));
        assert_eq!((shake(&[0.0, 2.0, 0.0]).centre_px(), shake(&[0.0]).count), (2.0, 0));
    }
}
