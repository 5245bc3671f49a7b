//! `gimbald demo`: generates a shaky clip, stabilizes it and measures both.

use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use super::interrupt::stop_on_signal;
use super::measure::{Shake, measure};
use super::place::ReportFile;
use super::print::told;
use super::progress::Progress;
use super::record::positive;
use super::watch::Watch;
use super::{Exit, Failure, SettingsArgs};
use crate::config::Settings;
use crate::device::replay;
use crate::device::synthetic::{self, Motion, Synthetic, View};
use crate::device::video::MjpegSink;
use crate::device::y4m::Y4mSink;
use crate::device::{FrameSink, FrameSource, Lent};
use crate::frame::Frame;
use crate::image::{Picture, PictureRef};
use crate::pipeline::{Observer, run_inline};
use crate::report::{Compare, Report, compare_format};
use crate::rt::stop::Stop;
use crate::stage::shutter::Known;
use crate::stage::unpack::Unpack;

/// Arguments of `demo`.
#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    /// Output directory; created if it does not exist
    #[arg(long, value_name = "DIR", default_value = "demo-out")]
    dir: PathBuf,
    /// Length of the clip in seconds (at most 60)
    #[arg(long, value_name = "S", default_value_t = 5.0, value_parser = positive)]
    seconds: f64,
    /// Camera motion: handheld, walk, desk, horizontal, vertical, pan or still
    #[arg(long, value_name = "MOTION", default_value = "handheld")]
    motion: Motion,
    /// Settings of the stabilization; readout time and field of view are those of the clip unless set
    #[command(flatten)]
    settings: SettingsArgs,
}

/// Runs the command.
///
/// # Errors
/// Errors in the settings, and where the directory or its files cannot be written.
pub fn run(args: &Args) -> Result<(), Failure> {
    let mut settings = args.settings.read()?;
    let stop = stop_on_signal(None)?;
    fs::create_dir_all(&args.dir).map_err(|error| Failure::creating(&args.dir, &error))?;
    let file = |name: &str| args.dir.join(name);
    let files = Files {
        input: file("input.y4m"),
        output: file("stabilized.y4m"),
        beside: file("before-after.avi"),
        report: file("report.html"),
    };

    let camera = synthetic::Params::default();
    let frames = (args.seconds.min(60.0) * camera.fps).round().max(2.0) as u64;
    let camera = synthetic::Params { motion: args.motion, view: View::Room, frames, ..camera };
    film(&camera, &files.input, &stop)?;

    let known = &mut settings.pipeline.camera;
    for (setting, truth) in
        [(&mut known.readout_ms, camera.readout_ms), (&mut known.hfov_deg, camera.hfov_deg), (&mut known.lens_k1, 0.0)]
    {
        if *setting == Known::Nothing {
            *setting = Known::Exactly(truth);
        }
    }
    let before = stabilize(&settings, &files, &stop)?;
    let after = measure(&settings.pipeline, &files.output, &stop)?;
    if stop.is_set() {
        return Err(Failure::new(Exit::Interrupted, format!("interrupted; {} is incomplete", args.dir.display())));
    }
    told(tell(&files, &before, &after))
}

/// What the demo leaves behind.
struct Files {
    input: PathBuf,
    output: PathBuf,
    beside: PathBuf,
    report: PathBuf,
}

/// Writes the synthetic camera's clip.
fn film(camera: &synthetic::Params, path: &Path, stop: &Stop) -> Result<(), Failure> {
    let mut source = Synthetic::new(camera).map_err(|what| Failure::new(Exit::Usage, what))?;
    let mut sink = Y4mSink::create(path, &source.format())?;
    let (mut unpack, mut picture) = (Unpack::default(), Picture::default());
    let progress = Progress::new("filming", Some(camera.frames));
    while let (false, Lent::Frame(frame)) = (stop.is_set(), source.lend()?) {
        let format = frame.format;
        unpack
            .unpack(format.pixel, format.colour.range, (format.width, format.height), format.stride, frame.bytes, &mut picture)
            .map_err(|error| Failure::new(Exit::BadData, format!("the synthetic camera's frame: {error}")))?;
        sink.canvas()?.planes.iter_mut().zip(picture.as_ref().planes).for_each(|(to, from)| to.copy_from(from));
        sink.submit(&frame.stamp)?;
        progress.step();
    }
    progress.finish();
    Ok(sink.finish()?)
}

/// Stabilizes the clip; writes the video, the side-by-side video and the page. Gives back how the input shook.
fn stabilize(settings: &Settings, files: &Files, stop: &Stop) -> Result<Shake, Failure> {
    let mut source = replay::open(&files.input)?;
    let format = source.format();
    let mut sink = Y4mSink::create(&files.output, &format)?;
    let beside = MjpegSink::create(&files.beside, &compare_format(&format))?;
    let mut watch = Watch::new("stabilizing", source.frames(), stop.clone());
    watch.compare = Some(Compare::new(Box::new(beside), stop.clone()));
    let report = Report::new(settings, &format, &files.input.to_string_lossy());
    watch.report = Some((report, ReportFile::create(&files.report)?));
    let mut both = (watch, Shake::default());
    let ran = run_inline(source.as_mut(), &mut sink, &settings.pipeline, stop, &mut both);
    both.0.end(ran)?;
    Ok(both.1)
}

/// Both are shown everything.
impl Observer for (Watch, Shake) {
    fn drawn(&mut self, frame: &Frame, output: PictureRef<'_>) {
        self.0.drawn(frame, output);
        self.1.drawn(frame, output);
    }

    fn sent(&mut self, frame: &Frame) {
        self.0.sent(frame);
    }
}

/// Says where everything is and what came of it.
fn tell(files: &Files, before: &Shake, after: &Shake) -> io::Result<()> {
    let mut out = io::stdout().lock();
    for (path, what) in [
        (&files.beside, "before and after, side by side: plays in every video player"),
        (&files.report, "the same in a browser, with a player and plots"),
        (&files.input, "the shaky clip, uncompressed (mpv, VLC or ffplay)"),
        (&files.output, "the stabilized clip, likewise"),
    ] {
        writeln!(out, "{:<28} {what}", path.display().to_string())?;
    }
    writeln!(
        out,
        "measured: shake {:.2} px -> {:.2} px, slant {:.3} -> {:.3} degrees (RMS change from frame to frame)",
        before.centre_px(),
        after.centre_px(),
        before.slant_deg(),
        after.slant_deg()
    )
}
