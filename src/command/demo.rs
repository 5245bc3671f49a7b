//! `gimbald demo`: stabilizes a generated clip and a recorded one, and measures before and after.

mod paper;
mod repeated;

use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use super::destination::ReportFile;
use super::interrupt::stop_on_signal;
use super::measure::{Shake, measure};
use super::print::written_or_closed;
use super::progress::Progress;
use super::record::positive;
use super::watch::Watch;
use super::{Exit, Failure, SettingsArgs};
use crate::config::Settings;
use crate::device::replay;
use crate::device::synthetic::{self, Motion, Synthetic, View};
use crate::device::video::MjpegSink;
use crate::device::y4m::Y4mSink;
use crate::device::{FrameSink, FrameSource, Lent, private};
use crate::frame::Frame;
use crate::image::{Picture, PictureRef};
use crate::pipeline::{Observer, run_inline};
use crate::report::{Compare, Report, compare_format};
use crate::rt::stop::Stop;
use crate::stage::shutter::Prior;
use crate::stage::unpack::Unpack;
use repeated::Repeated;

/// A phone behind a car's windscreen, 24 frames; see fixtures/README.md.
const RECORDING: &[u8] = include_bytes!("../../fixtures/car-mjpeg-400x300.gbr");
const RECORDING_LICENSE: &str = include_str!("../../fixtures/LICENSE-car");
/// The recording lasts .8 s: its video shows it so many times.
const TIMES: u32 = 6;

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
    /// Instead repeat the experiments of the paper that gimbald is based on: writes a page with its figures and claims beside what is measured
    #[arg(long, conflicts_with_all = ["seconds", "motion", "config", "set"])]
    paper: bool,
    /// Settings of the stabilization; readout time and field of view are those of the clip unless set
    #[command(flatten)]
    settings: SettingsArgs,
}

/// Runs the command.
///
/// # Errors
/// Errors in the settings, and where the directory or its files cannot be written.
pub fn run(args: &Args) -> Result<(), Failure> {
    let stop = stop_on_signal(None)?;
    if args.paper {
        return paper::run(&args.dir, &stop);
    }
    let mut settings = args.settings.read()?;
    fs::create_dir_all(&args.dir).map_err(|error| Failure::creating(&args.dir, &error))?;
    let generated = Files::in_directory(&args.dir, "", "input.y4m");
    let recorded = Files::in_directory(&args.dir, "real-", "input.gbr");

    let camera = synthetic::Params::default();
    let frames = (args.seconds.min(60.0) * camera.fps).round().max(2.0) as u64;
    let camera = synthetic::Params { motion: args.motion, view: View::Room, frames, ..camera };
    film(&camera, &generated.input, &stop)?;
    write(&recorded.input, RECORDING)?;
    write(&args.dir.join("real-LICENSE.txt"), RECORDING_LICENSE.as_bytes())?;

    // Of the recording, gimbald has to estimate them.
    let recorded_shake = both(&settings, &recorded, TIMES, &stop)?;
    let known = &mut settings.pipeline.camera;
    for (setting, truth) in
        [(&mut known.readout_ms, camera.readout_ms), (&mut known.hfov_deg, camera.hfov_deg), (&mut known.lens_k1, 0.0)]
    {
        if *setting == Prior::Unknown {
            *setting = Prior::Fixed(truth);
        }
    }
    let generated_shake = both(&settings, &generated, 1, &stop)?;
    if stop.is_set() {
        return Err(Failure::new(Exit::Interrupted, format!("interrupted; {} is incomplete", args.dir.display())));
    }
    written_or_closed(tell(&[
        ("generated clip: a drawn room", &generated, generated_shake),
        ("recorded clip: a phone in a car", &recorded, recorded_shake),
    ]))
}

/// The files of a clip.
struct Files {
    input: PathBuf,
    output: PathBuf,
    beside: PathBuf,
    report: PathBuf,
}

impl Files {
    /// Files in `directory` whose names begin with `prefix`.
    fn in_directory(directory: &Path, prefix: &str, input: &str) -> Self {
        let file = |name: &str| directory.join(format!("{prefix}{name}"));
        Self {
            input: file(input),
            output: file("stabilized.y4m"),
            beside: file("before-after.avi"),
            report: file("report.html"),
        }
    }
}

fn write(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    let mut file = private::create(path).map_err(|error| Failure::creating(path, &error))?;
    file.write_all(bytes).map_err(|error| Failure::writing(path, &error))
}

/// Stabilizes a clip; gives back how it shakes before and after.
fn both(settings: &Settings, files: &Files, times: u32, stop: &Stop) -> Result<[Shake; 2], Failure> {
    let before = stabilize(settings, files, times, stop)?;
    Ok([before, measure(&settings.pipeline, &files.output, stop)?])
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

/// Stabilizes the clip; writes the video, the side-by-side video that shows it `times` times, and the page. Gives back how the input shook.
fn stabilize(settings: &Settings, files: &Files, times: u32, stop: &Stop) -> Result<Shake, Failure> {
    let mut source = replay::open(&files.input)?;
    let format = source.format();
    let mut sink = Y4mSink::create(&files.output, &format)?;
    let beside = Repeated::new(MjpegSink::create(&files.beside, &compare_format(&format))?, times);
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
fn tell(clips: &[(&str, &Files, [Shake; 2])]) -> io::Result<()> {
    let mut out = io::stdout().lock();
    let paths = clips.iter().flat_map(|(_, files, _)| [&files.beside, &files.report, &files.input, &files.output]);
    let width = paths.map(|path| path.display().to_string().len()).max().unwrap_or(0);
    for (name, files, [before, after]) in clips {
        writeln!(out, "{name}")?;
        for (path, what) in [
            (&files.beside, "before and after, side by side: plays in every video player"),
            (&files.report, "the same in a browser, with a player and plots"),
            (&files.input, "the shaky clip (gimbald view; .y4m also in mpv, VLC or ffplay)"),
            (&files.output, "the stabilized clip, uncompressed"),
        ] {
            writeln!(out, "  {:<width$}  {what}", path.display().to_string())?;
        }
        writeln!(
            out,
            "  measured: shake {:.2} px -> {:.2} px, slant {:.3} -> {:.3} degrees (RMS change from frame to frame), bend {:.3} -> {:.3} px \
             (RMS of the rows)",
            before.centre_px(),
            after.centre_px(),
            before.slant_deg(),
            after.slant_deg(),
            before.bend_px(),
            after.bend_px()
        )?;
    }
    Ok(())
}
