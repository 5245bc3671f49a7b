//! Saved calibrations: estimates of cameras, kept across restarts in a small file that users can read and delete.

mod file;

use std::path::Path;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};

use self::file::{StateFile, Unusable};
use super::devices::LiveCamera;
use crate::geometry::Calibration;
use crate::pipeline::Camera;
use crate::stage::shutter::{Prior, certainty};

/// The file's name in the state directory.
const NAME: &str = "cameras.toml";
/// It is written no oftener than this while a stream runs.
const EVERY: Duration = Duration::from_secs(60);
/// Most cameras that are kept; the one used longest ago is forgotten first.
const MAX_CAMERAS: usize = 32;
/// Standard deviations in an uncertainty, where it becomes a start: what is known begins doubted, since lenses are exchanged.
const DOUBT: f64 = 2.0;
/// Least standard deviation of a start (ms; degrees; k1).
const FLOOR: (f64, f64, f64) = (0.3, 0.5, 0.01);
/// The values that the settings accept too (ms; degrees; k1).
const RANGES: [(f64, f64); 3] = [(-100.0, 100.0), (10.0, 170.0), (-0.35, 0.35)];
const HEAD: &str = "# Camera calibrations estimated by gimbald, by camera and mode; used where the configuration says \"auto\".\n\
                    # To estimate a camera again, delete its [[camera]] entry or this file.\n\n";

/// A camera in one of its modes.
#[derive(Clone, Debug, Default, Deserialize, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CameraMode {
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
    mode: CameraMode,
    #[serde(skip_serializing_if = "Option::is_none")]
    readout_ms: Option<Value>,
    #[serde(skip_serializing_if = "Option::is_none")]
    hfov_deg: Option<Value>,
    #[serde(skip_serializing_if = "Option::is_none")]
    lens_k1: Option<Value>,
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

/// An entry as it is held here, and whether it must be written.
#[derive(Clone, Debug)]
struct Held {
    entry: Entry,
    /// Since the file was written last: a stream in this mode began, or its values changed.
    used: bool,
    changed: bool,
}

/// Saved calibrations; without a state directory nothing is saved.
#[derive(Debug)]
pub(super) struct CalibrationStore {
    file: Option<StateFile>,
    state: Mutex<State>,
}

#[derive(Debug)]
struct State {
    /// Last used last.
    entries: Vec<Held>,
    current: Option<CameraMode>,
    /// When it was written or read.
    since: Instant,
    failed: bool,
}

impl CameraMode {
    /// The mode that a camera streams in.
    pub(super) fn of(camera: &dyn LiveCamera) -> Self {
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
    fn new(estimate: certainty::Stated, scale: f64) -> Self {
        // Four digits after the point are for people; more would be noise.
        let rounded = |value: f64| (1e4 * scale * value).round() / 1e4;
        Self { value: rounded(estimate.value), uncertainty: rounded(estimate.uncertainty) }
    }

    fn fits(&self, (low, high): (f64, f64)) -> bool {
        (low..=high).contains(&self.value) && self.uncertainty > 0.0 && self.uncertainty <= high - low
    }

    fn start(&self, floor: f64) -> Prior {
        Prior::Gaussian(self.value, (self.uncertainty / DOUBT).max(floor))
    }

    /// Whether `new` says something that this does not.
    fn told_by(&self, new: &Self) -> bool {
        (new.value - self.value).abs() > 0.25 * self.uncertainty || !(0.7..1.5).contains(&(new.uncertainty / self.uncertainty))
    }
}

impl CalibrationStore {
    /// Reads what is kept in `directory`. A file that cannot be used is named in the log; one that is only damaged is replaced as soon as
    /// there is something to write.
    pub(super) fn open(directory: Option<&Path>) -> Self {
        let file = directory.map(|directory| StateFile::new(directory, NAME));
        let mut entries = Vec::new();
        if let Some(file) = &file {
            match file.read().and_then(entries_of) {
                Ok(found) => entries = found,
                Err(what @ Unusable::Damaged(_)) => {
                    tracing::warn!("{}: {what}; ignored, it will be overwritten", file.path().display());
                }
                Err(what) => tracing::warn!("{}: {what}", file.path().display()),
            }
        }
        let entries = entries.into_iter().map(Held::as_read).collect();
        let state = State { entries, current: None, since: Instant::now(), failed: false };
        Self { file, state: Mutex::new(state) }
    }

    /// Whether anything is kept.
    pub(super) fn is_enabled(&self) -> bool {
        self.file.is_some()
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Size and frames a second of the camera that was used last, of those that are known.
    pub(super) fn latest(&self) -> Option<(u32, u32, f64)> {
        self.state().entries.last().map(|Held { entry: Entry { mode, .. }, .. }| (mode.width, mode.height, mode.fps))
    }

    /// A stream in `mode` begins, for which the settings say `camera`: what they leave open begins where it was left.
    pub(super) fn begin(&self, mode: CameraMode, camera: Camera) -> Camera {
        let mut state = self.state();
        let mut start = camera;
        if let Some(at) = state.entries.iter().position(|held| held.entry.mode == mode) {
            let held = state.entries.remove(at);
            let Entry { readout_ms, hfov_deg, lens_k1, .. } = held.entry;
            if let (Prior::Unknown, Some(readout)) = (camera.readout_ms, readout_ms) {
                start.readout_ms = readout.start(FLOOR.0);
            }
            if let (Prior::Unknown, Some(hfov)) = (camera.hfov_deg, hfov_deg) {
                start.hfov_deg = hfov.start(FLOOR.1);
            }
            if let (Prior::Unknown, Some(lens)) = (camera.lens_k1, lens_k1) {
                start.lens_k1 = lens.start(FLOOR.2);
            }
            state.entries.push(Held { used: true, ..held });
        }
        if start != camera {
            let lens_k1 = format_args!("{:.3}", start.lens_k1);
            tracing::info!(readout_ms = %start.readout_ms, hfov_deg = %start.hfov_deg, %lens_k1, "loaded saved calibration");
        }
        state.current = Some(mode);
        start
    }

    /// Takes over what is believed of the camera now; from time to time, it is written.
    pub(super) fn record(&self, found: &Calibration) {
        let mut state = self.state();
        state.record(found);
        if state.since.elapsed() >= EVERY {
            self.write(&mut state);
        }
    }

    /// The stream ends; what was learned of the camera, if anything was, is written.
    pub(super) fn end(&self, found: Option<&Calibration>) {
        let mut state = self.state();
        found.inspect(|found| state.record(found));
        state.current = None;
        self.write(&mut state);
    }

    fn write(&self, state: &mut State) {
        let Some(file) = self.file.as_ref().filter(|_| state.changed()) else { return };
        state.since = Instant::now();
        let mut written = Vec::new();
        let updated = file.update(|before| {
            written = match before.and_then(entries_of) {
                Ok(kept) => merge(kept, &state.entries),
                Err(Unusable::Damaged(_)) => state.entries.iter().map(|held| held.entry.clone()).collect(),
                Err(refused) => return Err(refused),
            };
            text_of(&written)
        });
        match updated {
            Ok(()) => {
                state.entries = written.into_iter().map(Held::as_read).collect();
                state.failed = false;
            }
            // Once: it will be tried again, and nothing depends on it.
            Err(error) if !state.failed => {
                tracing::warn!("{}: cannot save the calibration: {error}", file.path().display());
                state.failed = true;
            }
            Err(_) => {}
        }
    }
}

impl Held {
    fn as_read(entry: Entry) -> Self {
        Self { entry, used: false, changed: false }
    }
}

impl State {
    /// Whether there is anything to write.
    fn changed(&self) -> bool {
        self.entries.iter().any(|held| held.changed)
    }

    fn record(&mut self, found: &Calibration) {
        let Some(mode) = self.current.clone() else { return };
        let readout = certainty::known_readout(found, mode.interval_s()).map(|estimate| Value::new(estimate, 1e3));
        // what would be refused when it is read is not kept
        let readout = readout.filter(|value| value.fits(RANGES[0]));
        let hfov = certainty::known_hfov(found).map(|estimate| Value::new(estimate, 1.0));
        let hfov = hfov.filter(|value| value.fits(RANGES[1]));
        let lens = certainty::known_lens(found).map(|estimate| Value::new(estimate, 1.0));
        let lens = lens.filter(|value| value.fits(RANGES[2]));
        let news = [readout, hfov, lens];
        if news == [None; 3] {
            return;
        }
        let at = self.entries.iter().position(|held| held.entry.mode == mode).unwrap_or_else(|| {
            if self.entries.len() >= MAX_CAMERAS {
                self.entries.remove(0);
            }
            self.entries.push(Held::as_read(Entry { mode, readout_ms: None, hfov_deg: None, lens_k1: None }));
            self.entries.len() - 1
        });
        let Held { entry, used, changed } = &mut self.entries[at];
        for (kept, new) in [&mut entry.readout_ms, &mut entry.hfov_deg, &mut entry.lens_k1].into_iter().zip(news) {
            let Some(new) = new else { continue };
            if kept.is_none_or(|kept| kept.told_by(&new)) {
                *kept = Some(new);
                (*used, *changed) = (true, true);
            }
        }
    }
}

/// What the file is to hold: what it holds now, be it another daemon's, with the order of use and the changes of this one. An entry that
/// was deleted from it stays deleted unless it changed here.
fn merge(mut kept: Vec<Entry>, learned: &[Held]) -> Vec<Entry> {
    for held in learned.iter().filter(|held| held.used) {
        let there = kept.iter().position(|entry| entry.mode == held.entry.mode).map(|at| kept.remove(at));
        kept.extend(if held.changed { Some(held.entry.clone()) } else { there });
    }
    kept.drain(..kept.len().saturating_sub(MAX_CAMERAS));
    kept
}

/// The entries in the file's text; none where there is no file.
fn entries_of(text: Option<String>) -> Result<Vec<Entry>, Unusable> {
    let Some(text) = text else { return Ok(Vec::new()) };
    let damaged = |what: String| Unusable::Damaged(what);
    let mut content: Content = toml::from_str(&text).map_err(|error| damaged(format!("invalid: {}", error.message())))?;
    for entry in &content.camera {
        let values = [entry.readout_ms, entry.hfov_deg, entry.lens_k1];
        if !values.iter().zip(RANGES).all(|(value, range)| value.is_none_or(|value| value.fits(range))) {
            return Err(damaged(format!("a value of {:?} is out of range", entry.mode.name)));
        }
    }
    content.camera.drain(..content.camera.len().saturating_sub(MAX_CAMERAS));
    Ok(content.camera)
}

/// The file's text.
fn text_of(entries: &[Entry]) -> Result<String, Unusable> {
    let text = toml::to_string(&Content { camera: entries.to_vec() });
    text.map(|text| HEAD.to_owned() + &text).map_err(|error| Unusable::Refused(format!("cannot be written as TOML: {error}")))
}

/// Reads a state file's text, does with what it says all that a daemon does, and checks that what is then written is read as the same.
#[cfg(feature = "fuzzing")]
pub fn fuzz(text: &str) {
    let Ok(entries) = entries_of(Some(text.to_owned())) else { return };
    let state = State { entries: Vec::new(), current: None, since: Instant::now(), failed: false };
    let store = CalibrationStore { file: None, state: Mutex::new(state) };
    store.state().entries = entries.iter().cloned().map(Held::as_read).collect();
    for entry in &entries {
        let _ = (store.latest(), store.begin(entry.mode.clone(), Camera::default()));
        let [readout_s, hfov_deg, lens_k1] =
            [(-0.0251, 8e-5), (61.2, 0.1), (-0.08, 0.004)].map(|(value, sigma)| crate::geometry::Estimate { value, sigma });
        let found = Calibration { readout_s, hfov_deg, lens_k1 };
        store.end(Some(&found));
    }
    let merged = merge(entries, &store.state().entries);
    assert!(merged.len() <= MAX_CAMERAS);
    let written = text_of(&merged).expect("what was read can be written");
    let read = entries_of(Some(written)).expect("what was written can be read");
    assert_eq!(format!("{read:?}"), format!("{merged:?}"));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Estimate;

    use std::fs;

    struct Scratch(tempfile::TempDir);

    impl Scratch {
        fn new() -> Self {
            Self(tempfile::tempdir().unwrap())
        }

        fn path(&self) -> &Path {
            self.0.path()
        }

        fn text(&self) -> String {
            fs::read_to_string(self.path().join(NAME)).unwrap_or_default()
        }
    }

    fn mode(name: &str) -> CameraMode {
        CameraMode { name: name.into(), bus: "usb-1".into(), format: "MJPEG".into(), width: 640, height: 480, fps: 30.0 }
    }

    const SURE: Calibration = Calibration {
        readout_s: Estimate { value: -0.0251, sigma: 8e-5 },
        hfov_deg: Estimate { value: 61.2, sigma: 0.1 },
        lens_k1: Estimate { value: -0.08, sigma: 0.004 },
    };
    const VAGUE: Calibration = Calibration {
        readout_s: Estimate { value: 0.025, sigma: 8e-3 },
        hfov_deg: Estimate { value: 60.0, sigma: 15.0 },
        lens_k1: Estimate { value: 0.0, sigma: 0.1 },
    };

    #[test]
    fn what_was_found_is_known_after_a_restart_for_the_same_camera_and_mode() {
        let scratch = Scratch::new();
        let store = CalibrationStore::open(Some(scratch.path()));
        assert_eq!(store.begin(mode("A \"quoted\" name"), Camera::default()), Camera::default());
        store.record(&SURE);
        assert_eq!(scratch.text(), "", "not before its time");
        store.end(Some(&SURE));
        assert!(scratch.text().starts_with("# Camera calibrations"), "{}", scratch.text());

        let store = CalibrationStore::open(Some(scratch.path()));
        let start = store.begin(mode("A \"quoted\" name"), Camera::default());
        let (Prior::Gaussian(readout_ms, readout_off), Prior::Gaussian(hfov_deg, hfov_off)) =
            (start.readout_ms, start.hfov_deg)
        else {
            panic!("{start:?}");
        };
        assert_eq!((readout_ms, hfov_deg), (-25.1, 61.2));
        // wider than the filter's own, but still worth something
        assert!((0.3..1.0).contains(&readout_off) && (0.5..1.0).contains(&hfov_off), "{start:?}");
        assert!(matches!(start.lens_k1, Prior::Gaussian(k1, off) if k1 == -0.08 && off >= 0.01), "{start:?}");
        let given = Camera { readout_ms: Prior::Fixed(20.0), ..Camera::default() };
        let mixed = store.begin(mode("A \"quoted\" name"), given);
        assert_eq!((mixed.readout_ms, mixed.hfov_deg), (Prior::Fixed(20.0), start.hfov_deg));
        for other in [
            mode("B"),
            CameraMode { fps: 15.0, ..mode("A \"quoted\" name") },
            CameraMode { width: 1280, ..mode("A \"quoted\" name") },
        ] {
            assert_eq!(store.begin(other, Camera::default()), Camera::default());
        }
    }

    #[test]
    fn what_is_vague_or_was_given_is_not_kept_and_does_not_overwrite() {
        let scratch = Scratch::new();
        let [readout_s, hfov_deg, lens_k1] = [-0.0251, 61.2, -0.08].map(Estimate::exact);
        let given = Calibration { readout_s, hfov_deg, lens_k1 };
        let store = CalibrationStore::open(Some(scratch.path()));
        for nothing in [Some(VAGUE), Some(given), Some(Calibration::default()), None] {
            store.begin(mode("A"), Camera::default());
            store.end(nothing.as_ref());
            assert_eq!(scratch.text(), "", "{nothing:?}");
        }
        store.begin(mode("A"), Camera::default());
        store.end(Some(&SURE));
        let text = scratch.text();
        store.begin(mode("A"), Camera::default());
        store.end(Some(&VAGUE));
        // nearly the same is not written again
        store.begin(mode("A"), Camera::default());
        store.end(Some(&Calibration { readout_s: Estimate { value: SURE.readout_s.value + 1e-5, ..SURE.readout_s }, ..SURE }));
        assert!(!store.state().changed());
        assert_eq!(scratch.text(), text);
        store.begin(mode("A"), Camera::default());
        store.end(Some(&Calibration { readout_s: Estimate { value: -0.02, ..SURE.readout_s }, ..SURE }));
        assert!(scratch.text().contains("-20.0"), "{}", scratch.text());
    }

    /// A camera of ten frames a second may read for longer than a setting can say.
    #[test]
    fn what_would_be_refused_is_not_kept() {
        let scratch = Scratch::new();
        let slow = CameraMode { fps: 9.6, ..mode("slow") };
        for (readout_s, is_kept) in [(0.0999, true), (0.1001, false), (-0.102, false)] {
            let store = CalibrationStore::open(Some(scratch.path()));
            store.begin(slow.clone(), Camera::default());
            store.end(Some(&Calibration { readout_s: Estimate { value: readout_s, sigma: 1e-3 }, ..SURE }));
            let known = CalibrationStore::open(Some(scratch.path())).begin(slow.clone(), Camera::default());
            assert!(known.hfov_deg != Prior::Unknown, "{readout_s}: the rest is kept, and read");
            let kept =
                matches!(known.readout_ms, Prior::Gaussian(readout_ms, _) if (readout_ms - 1e3 * readout_s).abs() < 1e-6);
            assert_eq!(kept, is_kept, "{readout_s}: {known:?}");
        }
    }

    #[test]
    fn damaged_and_foreign_files_are_left_aside_and_replaced() {
        let scratch = Scratch::new();
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
            fs::write(scratch.path().join(NAME), content).unwrap();
            let store = CalibrationStore::open(Some(scratch.path()));
            assert_eq!(store.begin(mode("A"), Camera::default()), Camera::default());
            store.end(Some(&SURE));
            assert_ne!(CalibrationStore::open(Some(scratch.path())).begin(mode("A"), Camera::default()), Camera::default());
        }
        let store = CalibrationStore::open(Some(&scratch.path().join("no-such-directory")));
        store.begin(mode("A"), Camera::default());
        store.end(Some(&SURE));
        assert!(store.state().failed);
    }

    #[test]
    fn many_cameras_are_kept_and_the_one_used_longest_ago_goes() {
        let scratch = Scratch::new();
        let store = CalibrationStore::open(Some(scratch.path()));
        for n in 0..MAX_CAMERAS {
            store.begin(mode(&format!("camera {n}")), Camera::default());
            store.end(Some(&SURE));
        }
        store.begin(mode("camera 0"), Camera::default());
        store.begin(mode("one more"), Camera::default());
        store.end(Some(&SURE));
        let known =
            |name: &str| CalibrationStore::open(Some(scratch.path())).begin(mode(name), Camera::default()) != Camera::default();
        assert!(known("one more") && known("camera 0") && !known("camera 1") && known("camera 2"));
    }

    #[test]
    fn two_daemons_keep_what_each_learned() {
        let scratch = Scratch::new();
        let (one, other) = (CalibrationStore::open(Some(scratch.path())), CalibrationStore::open(Some(scratch.path())));
        for (store, name) in [(&one, "A"), (&other, "B")] {
            store.begin(mode(name), Camera::default());
            store.end(Some(&SURE));
        }
        let known =
            |name: &str| CalibrationStore::open(Some(scratch.path())).begin(mode(name), Camera::default()) != Camera::default();
        assert!(known("A") && known("B") && !known("C"));
        // What was deleted from the file is not brought back by a daemon that had read it.
        fs::remove_file(scratch.path().join(NAME)).unwrap();
        one.begin(mode("A"), Camera::default());
        one.begin(mode("C"), Camera::default());
        one.end(Some(&SURE));
        assert!(known("C") && !known("A") && !known("B"));
    }

    #[test]
    fn what_stands_in_the_files_place_is_left_there() {
        let scratch = Scratch::new();
        let elsewhere = scratch.path().join("elsewhere");
        fs::write(&elsewhere, "another's").unwrap();
        std::os::unix::fs::symlink(&elsewhere, scratch.path().join(NAME)).unwrap();
        let store = CalibrationStore::open(Some(scratch.path()));
        store.begin(mode("A"), Camera::default());
        store.end(Some(&SURE));
        assert!(store.state().failed && store.state().changed());
        assert_eq!(scratch.text(), "another's");
        fs::remove_file(scratch.path().join(NAME)).unwrap();
        store.end(Some(&SURE));
        assert!(!store.state().failed && scratch.text().starts_with("# Camera calibrations"), "tried again at the next end");
    }

    #[test]
    fn without_a_state_directory_nothing_is_kept() {
        let store = CalibrationStore::open(None);
        assert!(!store.is_enabled());
        store.begin(mode("A"), Camera::default());
        store.end(Some(&SURE));
    }
}
