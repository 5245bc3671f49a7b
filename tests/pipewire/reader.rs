//! Readers of a node: GStreamer's, as programs use it.

use std::io::Read;
use std::process::Stdio;
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;

use gimbald::rt::clock::monotonic_ns;

use super::producer::{node_name, read_number};
use super::session::{Running, Session, until};

/// What is left of a picture that is cut to its number.
const CUT: (u32, u32) = (16, 2);

/// A picture as it arrived: its number, where it has one, and when.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Arrival {
    pub number: Option<u32>,
    pub time_ns: i64,
}

pub struct Reader {
    pub process: Running,
    arrivals: Arc<Mutex<Vec<Arrival>>>,
    _thread: JoinHandle<()>,
}

impl Reader {
    /// Reads the test's node of that size.
    pub fn start(session: &Session, (width, height): (u32, u32)) -> Self {
        Self::with(session, (width, height), "video/x-raw")
    }

    /// The same of another node.
    pub fn of(session: &Session, node: &str, size: (u32, u32)) -> Self {
        Self::of_through(session, node, size, &["video/x-raw"])
    }

    /// The same, with GStreamer's words for what it wants.
    pub fn with(session: &Session, size: (u32, u32), wants: &str) -> Self {
        Self::through(session, size, &[wants])
    }

    /// The same, five pictures a second.
    pub fn slow(session: &Session, size: (u32, u32)) -> Self {
        Self::through(session, size, &["video/x-raw", "!", "identity", "sleep-time=200000"])
    }

    /// The same of a node of that size, cut to the number: with less to carry to this process. Needs GStreamer's good plugins.
    pub fn cut(session: &Session, (width, height): (u32, u32)) -> Self {
        let (right, bottom) = (format!("right={}", width - CUT.0), format!("bottom={}", height - CUT.1));
        Self::through(session, CUT, &["video/x-raw", "!", "videocrop", &right, &bottom])
    }

    fn through(session: &Session, size: (u32, u32), elements: &[&str]) -> Self {
        Self::of_through(session, &node_name(), size, elements)
    }

    fn of_through(session: &Session, node: &str, (width, height): (u32, u32), elements: &[&str]) -> Self {
        let mut command = session.command("gst-launch-1.0");
        let target = format!("target-object={node}");
        command.args(["-q", "pipewiresrc", &target, "!"]).args(elements).args(["!", "fdsink", "fd=1", "sync=false"]);
        let log = std::fs::File::options().append(true).create(true).open(session.folder.join("reader.log")).unwrap();
        let mut child = command.stdout(Stdio::piped()).stderr(log).spawn().unwrap();
        let mut stdout = child.stdout.take().unwrap();
        let arrivals = Arc::new(Mutex::new(Vec::new()));
        let seen = arrivals.clone();
        let thread = std::thread::spawn(move || {
            let mut bytes = vec![0; 2 * width as usize * height as usize];
            while stdout.read_exact(&mut bytes).is_ok() {
                seen.lock().unwrap().push(Arrival { number: read_number(&bytes), time_ns: monotonic_ns() });
            }
        });
        Self { process: Running(child), arrivals, _thread: thread }
    }

    pub fn arrivals(&self) -> Vec<Arrival> {
        self.arrivals.lock().unwrap().clone()
    }

    /// The numbers that arrived, each once, as they came.
    pub fn numbers(&self) -> Vec<u32> {
        let mut numbers: Vec<u32> = self.arrivals().iter().filter_map(|arrival| arrival.number).collect();
        numbers.dedup();
        numbers
    }

    /// Waits for a picture with a number above `number`; says when it arrived (CLOCK_MONOTONIC, nanoseconds).
    pub fn newer_than(&self, number: u32) -> i64 {
        let first = || self.arrivals().into_iter().find(|arrival| arrival.number.is_some_and(|arrived| arrived > number));
        until(&format!("a picture after {number}"), || first().is_some());
        first().map_or(0, |arrival| arrival.time_ns)
    }

    /// Waits until a picture with a number above `number` arrived.
    pub fn reaches(&self, number: u32) {
        until(&format!("picture {number}"), || self.numbers().last().is_some_and(|last| *last > number));
    }
}
