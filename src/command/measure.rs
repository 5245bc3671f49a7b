//! `gimbald measure`: the shake of a clip as numbers.

use std::path::{Path, PathBuf};

use serde_json::json;

use super::interrupt::stop_on_signal;
use super::print::print;
use super::watch::Watch;
use super::{Exit, Failure, SettingsArgs};
use crate::device::null::NullSink;
use crate::device::replay;
use crate::frame::{Frame, Track};
use crate::geometry::Homography;
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

/// Bands of rows in which a frame's bend is measured.
const BANDS: usize = 8;
/// Tracks that a band needs.
const MIN_TRACKS: usize = 5;

/// How a clip shakes. From the homographies between its frames: by how much the motion of the picture's centre, and its slant, change
/// from one frame to the next; a steady pan has no shake. From the tracks: by how much the rows of a frame bend.
#[derive(Debug, Default)]
pub(super) struct Shake {
    /// Motion of the centre (x, y, pixels) and slant (radians) against the previous frame.
    last: Option<[f64; 3]>,
    /// Sums of squares of their changes.
    sums: [f64; 3],
    /// Number of changes.
    count: u64,
    /// Sum of the frames' mean squares of [`bend`], and the number of these frames.
    bends: f64,
    bent: u64,
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

    /// Root mean square of what a band of rows moves beside the homography, pixels.
    pub(super) fn bend_px(&self) -> f64 {
        (self.bends / self.bent.max(1) as f64).sqrt()
    }

    fn text(&self) -> String {
        let (shake, slant, bend) = (self.centre_px(), self.slant_deg(), self.bend_px());
        format!(
            "shake {shake:.2} px, slant {slant:.3} degrees (RMS change from frame to frame, {} changes), bend {bend:.3} px (RMS of the rows)",
            self.count
        )
    }

    fn json(&self, path: &Path) -> serde_json::Value {
        json!({
            "clip": path.to_string_lossy(),
            "shake_px": self.centre_px(),
            "slant_deg": self.slant_deg(),
            "bend_px": self.bend_px(),
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
        if let Some(square) = bend(&fit.homography, &frame.context.tracks, frame.picture.height() as f64) {
            self.bends += square;
            self.bent += 1;
        }
        if let Some(last) = self.last.replace(now) {
            (0..3).for_each(|i| self.sums[i] += (now[i] - last[i]).powi(2));
            self.count += 1;
        }
    }
}

/// How the rows of a frame bend: the mean square, over bands of rows, of the median motion of the band's tracks less the homography's
/// (pixels^2). A homography keeps straight lines straight; what rows do beside it is rolling shutter, or a scene that is not flat. `None`
/// where fewer than half of the bands have tracks enough.
fn bend(homography: &Homography, tracks: &[Track], height: f64) -> Option<f64> {
    let mut bands: [[Vec<f64>; 2]; BANDS] = Default::default();
    for track in tracks {
        let band = ((track.to[1] / height * BANDS as f64).max(0.0) as usize).min(BANDS - 1);
        let expected = homography.apply(track.from);
        (0..2).for_each(|axis| bands[band][axis].push(track.to[axis] - expected[axis]));
    }
    let median = |values: &mut Vec<f64>| {
        values.sort_unstable_by(f64::total_cmp);
        values[values.len() / 2]
    };
    let enough = bands.iter_mut().filter(|[x, _]| x.len() >= MIN_TRACKS);
    let squares: Vec<f64> = enough.map(|[x, y]| median(x).powi(2) + median(y).powi(2)).collect();
    (squares.len() >= BANDS / 2).then(|| squares.iter().sum::<f64>() / squares.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

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

    #[test]
    fn rows_that_move_beside_the_homography_bend() {
        let tracks = |shift: &dyn Fn(f64) -> f64| -> Vec<Track> {
            let place = |i: usize| [f64::from(i as u32 % 40) * 16.0, f64::from(i as u32 / 40) * 24.0];
            let track = |from: [f64; 2]| Track { from, to: [from[0] + shift(from[1]), from[1]], ..Track::default() };
            (0..800).map(place).map(track).collect()
        };
        let pan = Homography(nalgebra::Matrix3::new(1.0, 0.0, 3.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0));
        assert_eq!(bend(&pan, &tracks(&|_| 3.0), 480.0), Some(0.0));
        // half of the rows a pixel to one side, half to the other
        let bent = bend(&pan, &tracks(&|y| if y < 240.0 { 4.0 } else { 2.0 }), 480.0).unwrap();
        assert!((bent - 1.0).abs() < 1e-9, "{bent}");
        // a person who moves across a third of each band changes no median
        let crowd: Vec<Track> = tracks(&|_| 3.0)
            .into_iter()
            .map(|track| match track.from[0] < 200.0 {
                true => Track { to: [track.to[0] + 9.0, track.to[1]], ..track },
                false => track,
            })
            .collect();
        assert_eq!(bend(&pan, &crowd, 480.0), Some(0.0));
        assert_eq!(bend(&pan, &tracks(&|_| 3.0)[..100], 480.0), None, "tracks in three of twenty rows");
    }
}
