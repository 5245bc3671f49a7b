//! What was found out about cameras, kept across restarts in one small file that people can read and delete.

use std::fs::{self, File};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};

use crate::device::FrameSource;
use crate::device::v4l2::Capture;
use crate::geometry::Calibration;
use crate::pipeline::Camera;
use crate::stage::shutter::{Known, certainty};

/// The file's name in the state directory.
const NAME: &str = "cameras.toml";
/// It is written no oftener than this while a stream runs.
const EVERY: Duration = Duration::from_secs(60);
/// Bytes that are read of it, and cameras that are kept, at most; the one used longest ago is forgotten first.
const LARGEST: u64 = 1 << 16;
const MOST_CAMERAS: usize = 32;
/// Standard deviations in an uncertainty, where it becomes a start: what is known begins doubted, since lenses are exchanged.
const DOUBT: f64 = 2.0;
/// Least standard deviation of a start (ms; degrees).
const FLOOR: (f64, f64) = (0.3, 0.5);
/// The values that the settings accept too (ms; degrees).
const RANGES: ((f64, f64), (f64, f64)) = ((-100.0, 100.0), (10.0, 170.0));
const HEAD: &str = "# What gimbald found out about cameras, by camera and mode. It is read where the configuration says \"auto\".\n\
                    # Delete the file, or a [[camera]], and it is found out anew.\n\n";

/// A camera in one of its modes.
#[derive(Clone, Debug, Default, Deserialize, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Mode {
    name: String,
    bus: String,
    format: String,
    width: u32,
    height: u32,
    /// Frames a second, rounded to hundredths; 0 where the camera does not say.
    fps: f64,
}

/// What is known of one of them.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
struct Entry {
    #[serde(flatten)]
    mode: Mode,
    #[serde(skip_serializing_if = "Option::is_none")]
    readout_ms: Option<Value>,
    #[serde(skip_serializing_if = "Option::is_none")]
    hfov_deg: Option<Value>,
}

/// A value, and how far the truth may be from it.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
struct Value {
    value: f64,
    uncertainty: f64,
}

#[derive(Debug, Default, Deserialize, Serialize)]
struct Content {
    #[serde(default)]
    camera: Vec<Entry>,
}

/// The memory; without a state directory it remembers nothing.
#[derive(Debug)]
pub(super) struct Memory {
    path: Option<PathBuf>,
    state: Mutex<State>,
}

#[derive(Debug)]
struct State {
    /// Last used last.
    entries: Vec<Entry>,
    current: Option<Mode>,
    /// When it was written or read.
    since: Instant,
    changed: bool,
    failed: bool,
}

impl Mode {
    /// The mode that a camera streams in.
    pub(super) fn of(camera: &Capture) -> Self {
        let (name, bus) = camera.name_and_bus();
        let format = camera.format();
        let fps = (100.0 * format.rate()).round() / 100.0;
        Self { name, bus, format: format.pixel.to_string(), width: format.width, height: format.height, fps }
    }

    fn interval_s(&self) -> f64 {
        if self.fps > 0.0 { 1.0 / self.fps } else { 1.0 / 30.0 }
    }
}

impl Value {
    fn new(estimate: certainty::Estimate, scale: f64) -> Self {
        // Four digits after the point are for people; more would be noise.
        let rounded = |value: f64| (1e4 * scale * value).round() / 1e4;
        Self { value: rounded(estimate.value), uncertainty: rounded(estimate.uncertainty) }
    }

    fn fits(&self, (low, high): (f64, f64)) -> bool {
        (low..=high).contains(&self.value) && self.uncertainty > 0.0 && self.uncertainty <= high - low
    }

    fn start(&self, floor: f64) -> Known {
        Known::About(self.value, (self.uncertainty / DOUBT).max(floor))
    }

    /// Whether `new` says something that this does not.
    fn told_by(&self, new: &Self) -> bool {
        (new.value - self.value).abs() > 0.25 * self.uncertainty || !(0.7..1.5).contains(&(new.uncertainty / self.uncertainty))
    }
}

impl Memory {
    /// Reads what is kept in `directory`. A file that cannot be read as such is told of and left aside, until there is something to
    /// write.
    pub(super) fn open(directory: Option<&Path>) -> Self {
        let path = directory.map(|directory| directory.join(NAME));
        let mut entries = Vec::new();
        if let Some(path) = &path {
            match read(path) {
                Ok(found) => entries = found,
                Err(what) => tracing::warn!("{}: {what}; it is left aside and will be written anew", path.display()),
            }
        }
        let state = State { entries, current: None, since: Instant::now(), changed: false, failed: false };
        Self { path, state: Mutex::new(state) }
    }

    /// Whether anything is kept.
    pub(super) fn keeps(&self) -> bool {
        self.path.is_some()
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Size and frames a second of the camera that was used last, of those that are known.
    pub(super) fn latest(&self) -> Option<(u32, u32, f64)> {
        self.state().entries.last().map(|Entry { mode, .. }| (mode.width, mode.height, mode.fps))
    }

    /// A stream in `mode` begins, for which the settings say `camera`: what they leave open begins where it was left.
    pub(super) fn begin(&self, mode: Mode, camera: Camera) -> Camera {
        let mut state = self.state();
        let mut start = camera;
        if let Some(at) = state.entries.iter().position(|entry| entry.mode == mode) {
            let entry = state.entries.remove(at);
            if let (Known::Nothing, Some(readout)) = (camera.readout_ms, entry.readout_ms) {
                start.readout_ms = readout.start(FLOOR.0);
            }
            if let (Known::Nothing, Some(hfov)) = (camera.hfov_deg, entry.hfov_deg) {
                start.hfov_deg = hfov.start(FLOOR.1);
            }
            state.entries.push(entry);
        }
        if start != camera {
            tracing::info!(readout_ms = ?start.readout_ms, hfov_deg = ?start.hfov_deg, "this camera is known from before");
        }
        state.current = Some(mode);
        start
    }

    /// Takes over what is believed of the camera now; from time to time, it is written.
    pub(super) fn learn(&self, found: &Calibration) {
        let mut state = self.state();
        state.learn(found);
        if state.since.elapsed() >= EVERY {
            self.write(&mut state);
        }
    }

    /// The stream ends; what was learned is written.
    pub(super) fn end(&self, found: &Calibration) {
        let mut state = self.state();
        state.learn(found);
        state.current = None;
        self.write(&mut state);
    }

    fn write(&self, state: &mut State) {
        let Some(path) = self.path.as_ref().filter(|_| state.changed) else { return };
        state.since = Instant::now();
        let written = replace(path, &state.entries);
        match written {
            Ok(()) => (state.changed, state.failed) = (false, false),
            // Once: it will be tried again, and nothing depends on it.
            Err(error) if !state.failed => {
                tracing::warn!("{}: cannot keep what was found out about the camera: {error}", path.display());
                state.failed = true;
            }
            Err(_) => {}
        }
    }
}

impl State {
    fn learn(&mut self, found: &Calibration) {
        let Some(mode) = self.current.clone() else { return };
        let readout = certainty::known_readout(found, mode.interval_s()).map(|estimate| Value::new(estimate, 1e3));
        let hfov = certainty::known_hfov(found).map(|estimate| Value::new(estimate, 1.0));
        if readout.is_none() && hfov.is_none() {
            return;
        }
        let at = self.entries.iter().position(|entry| entry.mode == mode).unwrap_or_else(|| {
            if self.entries.len() >= MOST_CAMERAS {
                self.entries.remove(0);
            }
            self.entries.push(Entry { mode, readout_ms: None, hfov_deg: None });
            self.entries.len() - 1
        });
        let entry = &mut self.entries[at];
        for (kept, new) in [(&mut entry.readout_ms, readout), (&mut entry.hfov_deg, hfov)] {
            let Some(new) = new else { continue };
            if kept.is_none_or(|kept| kept.told_by(&new)) {
                *kept = Some(new);
                self.changed = true;
            }
        }
    }
}

/// The entries of the file; none where there is no file.
fn read(path: &Path) -> Result<Vec<Entry>, String> {
    let mut text = String::new();
    match File::open(path).and_then(|file| file.take(LARGEST + 1).read_to_string(&mut text)) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(error) => return Err(format!("cannot read what is known of cameras: {error}")),
        Ok(_) if text.len() as u64 > LARGEST => return Err(format!("more than {LARGEST} bytes, not written by gimbald")),
        Ok(_) => {}
    }
    let content: Content = toml::from_str(&text).map_err(|error| format!("not as gimbald writes it: {}", error.message()))?;
    for entry in &content.camera {
        let fits = entry.readout_ms.is_none_or(|value| value.fits(RANGES.0))
            && entry.hfov_deg.is_none_or(|value| value.fits(RANGES.1));
        if !fits {
            return Err(format!("what it says of {:?} cannot be", entry.mode.name));
        }
    }
    Ok(content.camera.into_iter().rev().take(MOST_CAMERAS).rev().collect())
}

/// Writes the file beside its place and moves it there: at every moment there is a whole one.
fn replace(path: &Path, entries: &[Entry]) -> io::Result<()> {
    let content = Content { camera: entries.to_vec() };
    let text = toml::to_string(&content).map_err(io::Error::other)?;
    let beside = path.with_extension("toml.new");
    let mut file = File::create(&beside)?;
    file.write_all(HEAD.as_bytes())?;
    file.write_all(text.as_bytes())?;
    file.sync_all()?;
    fs::rename(&beside, path)
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Scratch(PathBuf);

    impl Scratch {
        fn new(name: &str) -> Self {
            let path = std::env::temp_dir().join(format!("gimbald-memory-{}-{name}", std::process::id()));
            fs::create_dir_all(&path).unwrap();
            Self(path)
        }

        fn text(&self) -> String {
            fs::read_to_string(self.0.join(NAME)).unwrap_or_default()
        }
    }

    impl Drop for Scratch {
        fn drop(&mut self) {
            let _ = fs::remove_dir_all(&self.0);
        }
    }

    fn mode(name: &str) -> Mode {
        Mode { name: name.into(), bus: "usb-1".into(), format: "MJPEG".into(), width: 640, height: 480, fps: 30.0 }
    }

    const SURE: Calibration =
        Calibration { readout_s: -0.0251, readout_deviation_s: 8e-5, hfov_deg: 61.2, hfov_deviation_deg: 0.1 };
    const VAGUE: Calibration =
        Calibration { readout_s: 0.025, readout_deviation_s: 8e-3, hfov_deg: 60.0, hfov_deviation_deg: 15.0 };

    #[test]
    fn what_was_found_is_known_after_a_restart_for_the_same_camera_and_mode() {
        let scratch = Scratch::new("restart");
        let memory = Memory::open(Some(&scratch.0));
        assert_eq!(memory.begin(mode("A \"quoted\" name"), Camera::default()), Camera::default());
        memory.learn(&SURE);
        assert_eq!(scratch.text(), "", "not before its time");
        memory.end(&SURE);
        assert!(scratch.text().starts_with("# What gimbald"), "{}", scratch.text());

        let memory = Memory::open(Some(&scratch.0));
        let start = memory.begin(mode("A \"quoted\" name"), Camera::default());
        let (Known::About(readout_ms, readout_off), Known::About(hfov_deg, hfov_off)) = (start.readout_ms, start.hfov_deg)
        else {
            panic!("{start:?}");
        };
        assert_eq!((readout_ms, hfov_deg), (-25.1, 61.2));
        // wider than the filter's own, but still worth something
        assert!((0.3..1.0).contains(&readout_off) && (0.5..1.0).contains(&hfov_off), "{start:?}");
        let given = Camera { readout_ms: Known::Exactly(20.0), hfov_deg: Known::Nothing };
        let mixed = memory.begin(mode("A \"quoted\" name"), given);
        assert_eq!((mixed.readout_ms, mixed.hfov_deg), (Known::Exactly(20.0), start.hfov_deg));
        for other in
            [mode("B"), Mode { fps: 15.0, ..mode("A \"quoted\" name") }, Mode { width: 1280, ..mode("A \"quoted\" name") }]
        {
            assert_eq!(memory.begin(other, Camera::default()), Camera::default());
        }
    }

    #[test]
    fn what_is_vague_or_was_given_is_not_kept_and_does_not_overwrite() {
        let scratch = Scratch::new("vague");
        let given = Calibration { readout_deviation_s: 0.0, hfov_deviation_deg: 0.0, ..SURE };
        let memory = Memory::open(Some(&scratch.0));
        for nothing in [VAGUE, given, Calibration::default()] {
            memory.begin(mode("A"), Camera::default());
            memory.end(&nothing);
            assert_eq!(scratch.text(), "", "{nothing:?}");
        }
        memory.begin(mode("A"), Camera::default());
        memory.end(&SURE);
        let text = scratch.text();
        memory.begin(mode("A"), Camera::default());
        memory.end(&VAGUE);
        // nearly the same is not written again
        memory.begin(mode("A"), Camera::default());
        memory.end(&Calibration { readout_s: SURE.readout_s + 1e-5, ..SURE });
        assert!(!memory.state().changed);
        assert_eq!(scratch.text(), text);
        memory.begin(mode("A"), Camera::default());
        memory.end(&Calibration { readout_s: -0.02, ..SURE });
        assert!(scratch.text().contains("-20.0"), "{}", scratch.text());
    }

    #[test]
    fn damaged_and_foreign_files_are_left_aside_and_replaced() {
        let scratch = Scratch::new("damaged");
        for content in [
            &b"\xff\xfe not text"[..],
            b"[[camera",
            b"[[camera]]\nname = \"A\"\n",
            b"[[camera]]\nname = 3\n",
            b"camera = \"all\"\n",
            b"[[camera]]\nname=\"A\"\nbus=\"usb-1\"\nformat=\"MJPEG\"\nwidth=640\nheight=480\nfps=30.0\nreadout_ms={value=nan,uncertainty=1.0}\n",
            b"[[camera]]\nname=\"A\"\nbus=\"usb-1\"\nformat=\"MJPEG\"\nwidth=640\nheight=480\nfps=30.0\nhfov_deg={value=400.0,uncertainty=1.0}\n",
            &[b'#'; 1 << 17],
        ] {
            fs::write(scratch.0.join(NAME), content).unwrap();
            let memory = Memory::open(Some(&scratch.0));
            assert_eq!(memory.begin(mode("A"), Camera::default()), Camera::default());
            memory.end(&SURE);
            assert_ne!(Memory::open(Some(&scratch.0)).begin(mode("A"), Camera::default()), Camera::default());
        }
        let memory = Memory::open(Some(&scratch.0.join("no-such-directory")));
        memory.begin(mode("A"), Camera::default());
        memory.end(&SURE);
        assert!(memory.state().failed);
    }

    #[test]
    fn many_cameras_are_kept_and_the_one_used_longest_ago_goes() {
        let scratch = Scratch::new("many");
        let memory = Memory::open(Some(&scratch.0));
        for n in 0..MOST_CAMERAS {
            memory.begin(mode(&format!("camera {n}")), Camera::default());
            memory.end(&SURE);
        }
        memory.begin(mode("camera 0"), Camera::default());
        memory.begin(mode("one more"), Camera::default());
        memory.end(&SURE);
        let known = |name: &str| Memory::open(Some(&scratch.0)).begin(mode(name), Camera::default()) != Camera::default();
        assert!(known("one more") && known("camera 0") && !known("camera 1") && known("camera 2"));
    }

    #[test]
    fn without_a_state_directory_nothing_is_kept() {
        let memory = Memory::open(None);
        assert!(!memory.keeps());
        memory.begin(mode("A"), Camera::default());
        memory.end(&SURE);
    }
}
