//! What people and programs write: configuration, `--set`, requests to a daemon, the file in which it keeps what it knows of cameras.

use gimbald::config::{MAX_SHOWN, Settings, keys::KEYS};
use gimbald::control::{DaemonState, LONGEST_REQUEST, Reply, Request};
use gimbald::fuzzing::{fuzz_calibration_store, fuzz_reply};
use gimbald::systemd::Systemd;
use std::sync::OnceLock;

/// Bytes that a message takes for each fault, at most.
const LONGEST_FAULT: usize = 1000;

/// A configuration file.
pub fn configuration(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else { return };
    match Settings::read(Some(("gimbald.toml", text)), &[]) {
        Ok(settings) => can_be_written(&settings),
        Err(faults) => {
            let (shown, said) = (faults.shown.len(), faults.to_string());
            assert!((1..=MAX_SHOWN).contains(&shown) && said.len() < LONGEST_FAULT * (shown + 1), "{} bytes", said.len());
        }
    }
}

/// Arguments of `--set`, one a line.
pub fn assignments(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else { return };
    let mut settings = Settings::default();
    for line in text.split('\n') {
        let before = settings.clone();
        if let Err(faults) = settings.set(line) {
            assert!(faults.to_string().len() < 2 * LONGEST_FAULT);
            assert_eq!(settings, before, "a setting that was refused changed something");
        }
    }
    can_be_written(&settings);
}

/// What is shown of settings can be read again, and means the same.
fn can_be_written(settings: &Settings) {
    let _ = (settings.camera.params(), settings.control.mode_bits());
    let written: String = KEYS.iter().map(|key| format!("{} = {}\n", key.name, key.value_text(settings))).collect();
    let read = Settings::read(Some(("written", &written)), &[]).unwrap_or_else(|faults| panic!("{faults}\n{written}"));
    assert!(read.differing(settings).next().is_none(), "{written}");
}

/// Requests to a daemon, one a line. Each gets one line of JSON that is not much longer than it.
pub fn request(data: &[u8]) {
    static STATE: OnceLock<DaemonState> = OnceLock::new();
    let state = STATE.get_or_init(|| {
        let file = "[crop]\nzoom = 1.2\n[camera]\ndevice = 3\n";
        let reread = || Settings::read(Some(("gimbald.toml", file)), &[]).map_err(|faults| faults.to_string());
        DaemonState::new(Settings::default(), Systemd::disconnected(), Box::new(reread))
    });
    for line in data.split(|&byte| byte == b'\n') {
        let reply = match Request::read(line) {
            Ok(request) => {
                assert_eq!(Request::read(request.line().as_bytes()).as_ref(), Ok(&request));
                assert_eq!(Request::read(request.json().as_bytes()).as_ref(), Ok(&request));
                fuzz_reply(&request, state)
            }
            Err(error) => Reply::Refused(error.into()),
        };
        let written = reply.line();
        assert!(!written.trim_end().contains('\n') && written.len() < 5 * LONGEST_REQUEST, "{written}");
        // numbers may come back with another last digit
        let read = Reply::read(&written).unwrap_or_else(|error| panic!("{error}: {written}"));
        assert_eq!(std::mem::discriminant(&read), std::mem::discriminant(&reply), "{written}");
    }
}

/// The file in which a daemon keeps what it knows of cameras.
pub fn state(data: &[u8]) {
    if let Ok(text) = std::str::from_utf8(data) {
        fuzz_calibration_store(text);
    }
}
