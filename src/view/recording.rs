//! A recording as a [`Backend`]: play, pause, seek, and settings that take effect at once.
//!
//! A thread runs the pipeline over the recording at its own frame rate. A search, or a setting that cannot change within a stream, starts
//! the pipeline again: frames are skipped up to a little before the position, and processed from there, so that the path has settled
//! when the position is reached.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use super::backend::{Backend, is_offered};
use super::preview::{self, Cursor, INTERVAL, Preview, PreviewFeed};
use crate::config::{Key, Settings};
use crate::device::null::NullSink;
use crate::device::{DeviceError, Lent, replay};
use crate::frame::Frame;
use crate::geometry::{Calibration, Estimate};
use crate::image::PictureRef;
use crate::pipeline::{Decoder, Observer, Params, Stabilizer};
use crate::report::PairEncoder;
use crate::rt::stop::Stop;
use crate::share::FrameInfo;
use crate::stage::shutter::Prior;

/// Frames of this many seconds are processed before the first one that is shown.
const RUN_IN_S: f64 = 2.0;
/// Interval at which a paused thread checks the stop flag.
const CHECK_STOP: Duration = Duration::from_millis(200);
/// Longer pauses between frames (seconds) are cut to this.
const MAX_PAUSE_S: f64 = 1.0;
/// An estimated calibration is kept for the next run if its deviation is less than this share of the field of view.
const MAX_DEVIATION: f64 = 0.1;

/// A recording.
#[derive(Debug)]
pub struct RecordingBackend {
    path: PathBuf,
    configuration: Option<PathBuf>,
    preview: PreviewFeed,
    player: Mutex<PlayerState>,
    /// Notified when a page changes the state.
    changed: Condvar,
}

/// What the pages want, and where the thread is.
#[derive(Debug)]
struct PlayerState {
    settings: Settings,
    playing: bool,
    looping: bool,
    /// The pipeline is to be started again at this position; taken by the thread.
    restart: Option<Restart>,
    /// The settings have changed in a way that a running pipeline can follow.
    settings_changed: bool,
    position_s: f64,
    length_s: f64,
    error: Option<String>,
    /// As the last run has estimated it.
    calibration: Option<Calibration>,
}

#[derive(Clone, Copy, Debug)]
struct Restart {
    position_s: f64,
    /// A restart for new settings lets the thread reach the position first: a slider that is moved shows pictures all the time.
    is_seek: bool,
}

impl RecordingBackend {
    /// The recording at `path`. `configuration` is the file that settings are written to.
    ///
    /// # Errors
    /// A file that cannot be read as a recording.
    pub fn open(path: &Path, settings: Settings, configuration: Option<PathBuf>) -> Result<Self, DeviceError> {
        let source = replay::open(path)?;
        let rate = source.format().rate();
        let length_s = source.frames().filter(|_| rate > 0.0).map_or(0.0, |frames| frames as f64 / rate);
        let player = PlayerState {
            settings,
            playing: true,
            looping: false,
            restart: Some(Restart { position_s: 0.0, is_seek: true }),
            settings_changed: false,
            position_s: 0.0,
            length_s,
            error: None,
            calibration: None,
        };
        let (preview, player) = (PreviewFeed::default(), Mutex::new(player));
        Ok(Self { path: path.into(), configuration, preview, player, changed: Condvar::new() })
    }

    fn player(&self) -> MutexGuard<'_, PlayerState> {
        self.player.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Plays until `stop` is set.
    pub fn run(&self, stop: &Stop) {
        while !stop.is_set() {
            let Some(restart) = self.await_restart(stop) else { continue };
            if let Err(error) = self.play_from(restart.position_s, stop) {
                let mut player = self.player();
                (player.error, player.playing) = (Some(error), false);
            }
        }
    }

    fn await_restart(&self, stop: &Stop) -> Option<Restart> {
        let mut player = self.player();
        while player.restart.is_none() && !stop.is_set() {
            player = self.changed.wait_timeout(player, CHECK_STOP).unwrap_or_else(PoisonError::into_inner).0;
        }
        player.restart.take()
    }

    /// Processes frames from a little before `begin_s`, until the end or a restart.
    fn play_from(&self, begin_s: f64, stop: &Stop) -> Result<(), String> {
        let text = |error: DeviceError| error.to_string();
        let mut source = replay::open(&self.path).map_err(text)?;
        let format = source.format();
        let mut sink = NullSink::new(&format);
        let mut stabilizer = Stabilizer::new(&self.begin_run(), &format, &format.planar());
        let mut publisher = Publisher::new(self, begin_s)?;
        let (mut decoder, mut pool) = (Decoder::default(), Vec::new());
        let (mut first_ns, mut index) = (None, 0);
        self.preview.restart();
        loop {
            let raw = match source.lend().map_err(text)? {
                Lent::Frame(raw) => raw,
                Lent::Idle => continue,
                Lent::End => break,
            };
            let time_ns = raw.stamp.time_ns.saturating_sub(*first_ns.get_or_insert(raw.stamp.time_ns));
            if time_ns as f64 * 1e-9 >= begin_s - RUN_IN_S {
                let mut frame: Box<Frame> = pool.pop().unwrap_or_else(|| stabilizer.empty_frame());
                frame.stamp = raw.stamp;
                (frame.stamp.time_ns, frame.stamp.sequence) = (time_ns, index);
                frame.intact = decoder.decode(&raw, &mut frame.picture).is_ok();
                frame.cut = frame.intact && decoder.is_cut();
                stabilizer.push(frame);
                while stabilizer.emit(&mut sink, &mut publisher).map_err(text)?.is_some() {}
                pool.extend(std::iter::from_fn(|| stabilizer.give_back()));
            }
            index += 1;
            match self.await_next(&mut publisher, stop) {
                Step::Continue => {}
                Step::SetParams(params) => stabilizer.set_params(&params),
                Step::End => return publisher.failed.map_or(Ok(()), Err),
            }
        }
        stabilizer.end();
        while stabilizer.emit(&mut sink, &mut publisher).map_err(text)?.is_some() {}
        self.end_run(&publisher);
        publisher.failed.map_or(Ok(()), Err)
    }

    /// The parameters of a new run. What the last run has estimated of the camera is where this one starts.
    fn begin_run(&self) -> Params {
        let mut player = self.player();
        (player.error, player.settings_changed) = (None, false);
        let (mut params, estimated) = (player.settings.pipeline, player.calibration);
        let is_useful = |camera: &Calibration| camera.hfov_deg.sigma < MAX_DEVIATION * camera.hfov_deg.value;
        if let Some(Calibration { readout_s, hfov_deg, lens_k1 }) = estimated.filter(is_useful) {
            let known = |configured: Prior, Estimate { value, sigma }: Estimate| {
                if configured == Prior::Unknown { Prior::Gaussian(value, sigma) } else { configured }
            };
            let camera = &mut params.camera;
            camera.hfov_deg = known(camera.hfov_deg, hfov_deg);
            camera.readout_ms = known(camera.readout_ms, readout_s.scaled(1e3));
            camera.lens_k1 = known(camera.lens_k1, lens_k1);
        }
        params
    }

    /// The recording has ended.
    fn end_run(&self, publisher: &Publisher<'_>) {
        let mut player = self.player();
        if publisher.last_s.is_finite() {
            (player.length_s, player.position_s) = (publisher.last_s, publisher.last_s);
        }
        if player.looping && player.playing && player.length_s > 0.0 {
            player.restart.get_or_insert(Restart { position_s: 0.0, is_seek: true });
        } else {
            player.playing = false;
        }
    }

    /// Waits until the next frame is due, or while the recording is paused until something changes.
    fn await_next(&self, publisher: &mut Publisher<'_>, stop: &Stop) -> Step {
        let mut player = self.player();
        loop {
            let reached = publisher.has_reached_begin();
            let restarts = player.restart.is_some_and(|restart| restart.is_seek || reached);
            if stop.is_set() || restarts || publisher.failed.is_some() {
                return Step::End;
            }
            if std::mem::take(&mut player.settings_changed) {
                return Step::SetParams(Box::new(player.settings.pipeline));
            }
            if !reached {
                return Step::Continue;
            }
            let wait = match player.playing {
                true => publisher.due.saturating_duration_since(Instant::now()),
                false => CHECK_STOP,
            };
            if wait.is_zero() {
                return Step::Continue;
            }
            let was_playing = player.playing;
            player = self.changed.wait_timeout(player, wait).unwrap_or_else(PoisonError::into_inner).0;
            if player.playing && !was_playing {
                publisher.due = Instant::now();
            }
        }
    }
}

/// What follows a frame.
enum Step {
    Continue,
    SetParams(Box<Params>),
    End,
}

/// Publishes the frames of a run.
struct Publisher<'a> {
    backend: &'a RecordingBackend,
    encoder: PairEncoder,
    begin_s: f64,
    /// Time of the last frame.
    last_s: f64,
    /// When the next frame is due.
    due: Instant,
    /// When a picture was published last.
    published: Option<Instant>,
    failed: Option<String>,
}

impl<'a> Publisher<'a> {
    fn new(backend: &'a RecordingBackend, begin_s: f64) -> Result<Self, String> {
        let encoder = preview::encoder(preview::WIDEST)?;
        let (due, last_s) = (Instant::now(), f64::NEG_INFINITY);
        Ok(Self { backend, encoder, begin_s, last_s, due, published: None, failed: None })
    }

    fn has_reached_begin(&self) -> bool {
        self.last_s >= self.begin_s
    }

    /// Sets when the frame of `time_s` ends. After a delay, playback continues from now.
    fn set_due(&mut self, time_s: f64) {
        let now = Instant::now();
        self.due = match self.published {
            None => now,
            Some(_) => {
                let step = Duration::from_secs_f64((time_s - self.last_s).clamp(0.0, MAX_PAUSE_S));
                (self.due + step).max(now.checked_sub(CHECK_STOP).unwrap_or(now))
            }
        };
    }
}

impl Observer for Publisher<'_> {
    fn drawn(&mut self, frame: &Frame, output: PictureRef<'_>) {
        let time_s = frame.stamp.time_ns as f64 * 1e-9;
        let info = FrameInfo::of(frame, frame.stamp.sequence, (output.width(), output.height()));
        self.backend.preview.add_frames(&[info]);
        self.set_due(time_s);
        self.last_s = time_s;
        let mut player = self.backend.player();
        player.calibration = frame.context.calibration;
        let playing = player.playing;
        if !self.has_reached_begin() {
            return;
        }
        player.position_s = time_s;
        player.length_s = player.length_s.max(time_s);
        drop(player);
        if playing && self.published.is_some_and(|published| published.elapsed() < INTERVAL) {
            return;
        }
        match self.encoder.encode(output, frame.picture.as_ref()) {
            Ok(encoded) => self.backend.preview.publish(info, encoded),
            Err(error) => self.failed = Some(error),
        }
        self.published = Some(Instant::now());
    }
}

impl Backend for RecordingBackend {
    fn name(&self) -> String {
        self.path.file_name().unwrap_or(self.path.as_os_str()).to_string_lossy().into_owned()
    }

    fn is_recording(&self) -> bool {
        true
    }

    fn is_live(&self, key: &Key) -> bool {
        is_offered(key)
    }

    fn preview(&self, seen: Cursor, timeout: Duration) -> Option<Arc<Preview>> {
        self.preview.next(seen, timeout)
    }

    fn state(&self) -> Value {
        let PlayerState { playing, looping, position_s, length_s, error, .. } = &*self.player();
        json!({"playing": playing, "looping": looping, "position_s": position_s, "length_s": length_s, "error": error})
    }

    fn settings(&self) -> Result<Settings, String> {
        Ok(self.player().settings.clone())
    }

    fn set(&self, assignment: &str) -> Result<(), String> {
        let mut player = self.player();
        let mut wanted = player.settings.clone();
        wanted
            .set(assignment)
            .map_err(|faults| faults.shown.iter().map(|fault| fault.bare()).collect::<Vec<_>>().join("; "))?;
        let changed: Vec<&Key> = wanted.differing(&player.settings).collect();
        if let Some(key) = changed.iter().find(|key| !is_offered(key)) {
            return Err(format!("{}: has no effect on a recording", key.name));
        }
        if changed.is_empty() {
            return Ok(());
        }
        let follows = player.playing && changed.iter().all(|key| key.live);
        player.settings = wanted;
        if follows {
            player.settings_changed = true;
        } else {
            let position_s = player.position_s;
            player.restart.get_or_insert(Restart { position_s, is_seek: false });
        }
        drop(player);
        self.changed.notify_all();
        Ok(())
    }

    fn play(&self, command: &str) -> Result<(), String> {
        let mut player = self.player();
        match command.split_once(' ').unwrap_or((command, "")) {
            ("play", "") => {
                // At the end there is nothing left to play.
                if !player.playing && player.position_s + 0.05 >= player.length_s {
                    player.restart = Some(Restart { position_s: 0.0, is_seek: true });
                }
                player.playing = true;
            }
            ("pause", "") => player.playing = false,
            ("loop", "") => player.looping = true,
            ("once", "") => player.looping = false,
            ("seek", seconds) => match seconds.parse::<f64>() {
                Ok(seconds) if seconds.is_finite() => {
                    let position_s = seconds.clamp(0.0, player.length_s.max(0.0));
                    (player.restart, player.position_s) = (Some(Restart { position_s, is_seek: true }), position_s);
                }
                _ => return Err(format!("{seconds:?}: expected seconds from the start")),
            },
            _ => return Err(format!("{command:?}: expected play, pause, seek SECONDS, loop or once")),
        }
        drop(player);
        self.changed.notify_all();
        Ok(())
    }

    fn configuration(&self) -> Option<PathBuf> {
        self.configuration.clone()
    }
}
