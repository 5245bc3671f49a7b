//! `gimbald demo --paper`: repeats the paper's experiments with the synthetic camera and writes a page with its figures.

use std::fs;
use std::path::Path;

use super::{Exit, Failure, Progress, ReportFile};
use crate::command::print::print;
use crate::config::Settings;
use crate::device::FrameSource;
use crate::device::null::NullSink;
use crate::device::synthetic::{Motion, Params, Synthetic, View};
use crate::frame::Frame;
use crate::image::PictureRef;
use crate::pipeline::{Observer, run_inline};
use crate::report::{Both, Paper, PatternWatch, Report};
use crate::rt::stop::Stop;

/// Seconds of each clip.
const SECONDS: f64 = 4.0;
/// The frames of Fig. 11: spread over a period of the motion.
const SEQUENCE: [u64; 4] = [32, 35, 38, 41];
/// Settings of every run. Where the picture does not reach, the output is black, as in the paper's figures; it is not enlarged.
const ALWAYS: [&str; 5] = ["crop.zoom=1", "crop.border=black", "crop.max_zoom=1.4", "camera.hfov_deg=60", "camera.lens_k1=0"];
const MODELS: Both<&str> = ["shutter.model=cho2007", "shutter.model=continuous"];
/// The camera's path is followed: the rows are set right, and nothing else.
const UNDISTORT: &str = "smooth.strength=0";
const LOW_PASS: &str = "smooth.mode=iir";

/// A camera as the paper's web camera: VGA at 15 fps, its rows read in nearly all of the time between two frames.
fn web_camera(motion: Motion) -> Params {
    let fps = 15.0;
    Params { fps, readout_ms: 60.0, motion, view: View::Patterns, frames: (SECONDS * fps) as u64, ..Params::default() }
}

/// Runs the experiments and writes `paper.html` into the directory.
///
/// # Errors
/// Where the directory or the page cannot be written.
pub(super) fn run(directory: &Path, stop: &Stop) -> Result<(), Failure> {
    fs::create_dir_all(directory).map_err(|error| Failure::creating(directory, &error))?;
    let file = ReportFile::create(&directory.join("paper.html"))?;
    let experiments = Experiments { stop, progress: Progress::new("measuring", None) };
    let paper = experiments.all()?;
    experiments.progress.finish();
    if stop.is_set() {
        return Err(Failure::new(Exit::Interrupted, format!("interrupted; {} is empty", file.path.display())));
    }
    let path = file.path.display().to_string();
    file.fill(&paper.html())?;
    print(&format!("{path:<28} the paper's figures with gimbald's pictures, and its claims beside what was measured\n"))
}

struct Experiments<'a> {
    stop: &'a Stop,
    progress: Progress,
}

/// Shows every frame to an observer, and counts it.
struct Counted<'a, O>(O, &'a Progress);

impl<O: Observer> Observer for Counted<'_, O> {
    fn drawn(&mut self, frame: &Frame, output: PictureRef<'_>) {
        self.0.drawn(frame, output);
    }

    fn sent(&mut self, frame: &Frame) {
        self.0.sent(frame);
        self.1.step();
    }
}

impl Experiments<'_> {
    fn all(&self) -> Result<Paper, Failure> {
        let [sideways, upwards] = [made(&web_camera(Motion::Horizontal))?, made(&web_camera(Motion::Vertical))?];
        let [right, left] = [1.0, -1.0].map(|sign| fastest(&sideways, 0, sign));
        let [up, down] = [1.0, -1.0].map(|sign| fastest(&upwards, 1, sign));
        let fastest = [right, left, down, up];
        let web = *sideways.params();
        let known = format!("camera.readout_ms={}", web.readout_ms);
        let both = |camera: &Synthetic, settings: &[&str]| -> Result<Both<PatternWatch>, Failure> {
            let wanted = [&fastest[..], &SEQUENCE].concat();
            let one = |model: &str| self.run(camera, &[&[model], settings].concat(), |_| PatternWatch::new(&wanted));
            Ok([one(MODELS[0])?, one(MODELS[1])?])
        };
        let undistort = [known.as_str(), UNDISTORT];
        let no_shutter = ["camera.readout_ms=0", UNDISTORT];
        let global = |motion| {
            let camera = made(&Params { readout_ms: 0.0, ..web_camera(motion) })?;
            self.run(&camera, &no_shutter, |_| PatternWatch::default())
        };
        let walk = made(&Params { motion: Motion::Walk, view: View::Room, ..Params::default() })?;
        let known_walk = format!("camera.readout_ms={}", walk.params().readout_ms);
        let report =
            |model| self.run(&walk, &[model, &known_walk, LOW_PASS], |settings| Report::new(settings, &walk.format(), "walk"));
        Ok(Paper {
            camera: format!(
                "Figs. 9 to 11 are of a synthetic camera of {}x{} at {} fps with a readout of {} ms and a field of view of {} degrees, which turns by ±4.5° \
                 sideways or ±3.5° up and down, 1.3 times per second; both models are told readout and field of view. Fig. 12 is of one at {} fps with a \
                 readout of {} ms that is carried by a walking person.",
                web.width,
                web.height,
                web.fps,
                web.readout_ms,
                web.hfov_deg,
                walk.params().fps,
                walk.params().readout_ms
            ),
            undistorted: [both(&sideways, &undistort)?, both(&upwards, &undistort)?],
            global: [global(Motion::Horizontal)?, global(Motion::Vertical)?],
            stabilized_only: both(&sideways, &["camera.readout_ms=0", LOW_PASS])?,
            complete: both(&sideways, &[&known, LOW_PASS])?,
            walk: [report(MODELS[0])?, report(MODELS[1])?],
            fastest,
            sequence: SEQUENCE.to_vec(),
        })
    }

    /// Sends a camera's clip through the pipeline with these settings; gives back its observer.
    fn run<O: Observer>(&self, camera: &Synthetic, sets: &[&str], observer: impl FnOnce(&Settings) -> O) -> Result<O, Failure> {
        let sets: Vec<String> = ALWAYS.iter().chain(sets).map(|set| (*set).to_owned()).collect();
        let settings = Settings::read(None, &sets)?;
        let mut source = camera.clone();
        let mut sink = NullSink::new(&source.format());
        let mut counted = Counted(observer(&settings), &self.progress);
        run_inline(&mut source, &mut sink, &settings.pipeline, self.stop, &mut counted)?;
        Ok(counted.0)
    }
}

/// A camera before its first frame.
fn made(params: &Params) -> Result<Synthetic, Failure> {
    Synthetic::new(params).map_err(|what| Failure::new(Exit::Usage, what))
}

/// The frame in which the camera turns fastest about an axis of [`Synthetic::pose_at`], in the direction of `sign`; after the first second.
fn fastest(camera: &Synthetic, axis: usize, sign: f64) -> u64 {
    let Params { fps, frames, height, .. } = *camera.params();
    let speed = |frame: u64| {
        let [first, last] = [0.0, f64::from(height)].map(|row| camera.pose_at(camera.row_time_s(frame, row))[axis]);
        sign * (last - first)
    };
    (fps as u64..frames.saturating_sub(1)).max_by(|a, b| speed(*a).total_cmp(&speed(*b))).unwrap_or(0)
}
