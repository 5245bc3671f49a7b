//! A few pictures of a running daemon, as a page would show them.

use std::time::{Duration, Instant};

use super::backend::Backend;
use super::daemon::DaemonBackend;
use super::preview::Cursor;
use crate::report::EncodedPair;
use crate::rt::stop::Stop;

/// The first picture must be there within this time; the camera may have to be opened.
const FIRST: Duration = Duration::from_secs(15);
/// Time between two pictures.
const APART: Duration = Duration::from_secs(1);
/// How long to wait for a picture before `stop` is checked again.
const WAIT: Duration = Duration::from_millis(250);

/// Takes `count` pictures of input and output, a second apart; `taken` is called after each. The daemon's camera is on meanwhile, as for
/// every viewer. Fewer where the picture ends, or `stop` is set.
///
/// # Errors
/// Why there are none, for users.
pub fn take_pictures(daemon: &DaemonBackend, count: usize, stop: &Stop, taken: impl Fn()) -> Result<Vec<EncodedPair>, String> {
    let done = Stop::default();
    let pictures = std::thread::scope(|scope| {
        scope.spawn(|| daemon.run(&done));
        let mut pictures = Vec::new();
        let (mut cursor, mut end) = (Cursor::default(), Instant::now() + FIRST);
        while pictures.len() < count && Instant::now() < end && !stop.is_set() {
            let Some(preview) = daemon.preview(cursor, WAIT) else { continue };
            cursor.picture = preview.number;
            pictures.push(EncodedPair { size: preview.size, input: preview.input, jpeg: preview.jpeg.clone() });
            taken();
            if pictures.len() < count {
                std::thread::sleep(APART);
            }
            end = Instant::now() + FIRST;
        }
        done.set();
        pictures
    });
    match pictures.is_empty() {
        true if stop.is_set() => Err("interrupted".into()),
        true => Err(Some(daemon.problem()).filter(|problem| !problem.is_empty()).unwrap_or_else(|| "no pictures".into())),
        false => Ok(pictures),
    }
}
