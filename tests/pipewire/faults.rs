//! What goes wrong: processes that are killed or restarted, readers that are slow, keep everything or ask for other formats.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use gimbald::random::Congruential;
use gimbald::rt::clock::monotonic_ns;
use rustix::process::Signal;

use super::SIZE;
use super::producer::{Producer, node_name};
use super::reader::Reader;
use super::session::{Running, Session, until};
use super::{Stage, staged};

#[test]
fn a_companion_that_was_killed_comes_back_and_the_daemon_goes_on() {
    let Some(Stage { session, producer, companion, reader }) = staged("companion", SIZE) else { return };
    drop(companion);
    until("it is gone", || producer.companions.connected() == 0 && producer.companions.watching() == 0);
    until("its node too", || session.node(&node_name()).is_none());
    drop(reader);
    let _companion = session.companion();
    until("the node", || session.node(&node_name()).is_some());
    let from = producer.number();
    Reader::start(&session, SIZE).reaches(from + 10);
}

#[test]
fn pipewire_and_wireplumber_may_be_restarted() {
    let Some(Stage { mut session, producer, companion: _companion, reader }) = staged("pipewire", SIZE) else { return };
    session.kill_wireplumber();
    // Links are WirePlumber's, and go with it. (GStreamer's reader of 0.3.65 is linked again and gets nothing: a new one does.)
    until("no program watches", || producer.companions.watching() == 0);
    drop(reader);
    session.start_wireplumber();
    let from = producer.number();
    let reader = Reader::start(&session, SIZE);
    reader.reaches(from + 10);
    session.kill_pipewire();
    until("no program watches", || producer.companions.watching() == 0);
    drop(reader);
    session.start_pipewire();
    until("the node", || session.node(&node_name()).is_some());
    let from = producer.number();
    Reader::start(&session, SIZE).reaches(from + 10);
}

#[test]
fn a_reader_that_keeps_every_picture_or_is_killed_with_them_starves_no_other() {
    let Some(Stage { session, producer, companion: _companion, reader }) = staged("hoard", SIZE) else { return };
    for round in 0..4 {
        let hoarder = Reader::start(&session, SIZE);
        hoarder.reaches(producer.number());
        // It holds what it has, and takes no more.
        hoarder.process.signal(Signal::STOP);
        let from = producer.number();
        reader.reaches(from + 60);
        drop(hoarder);
        let from = producer.number();
        reader.reaches(from + 20);
        println!("round {round}: picture {}", producer.number());
    }
    let fresh = Reader::start(&session, SIZE);
    fresh.reaches(producer.number() + 20);
}

/// Rounds of [`every_fault_in_any_order`], and where its numbers begin.
fn variable(name: &str, default: u64) -> u64 {
    std::env::var(name).ok().and_then(|text| text.parse().ok()).unwrap_or(default)
}

/// What a round does to the session.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Fault {
    /// None but that the reader is a new one: what the others that need a new reader compare with.
    NewReader,
    DaemonRestarts,
    CompanionRestarts,
    PipewireRestarts,
    WireplumberRestarts,
    CameraHasAnotherSize,
    ReaderIsSlow,
    ReaderKeepsAll,
    ReaderIsKilledWithPictures,
    ReaderAsksForOtherFormats,
}

const FAULTS: [Fault; 10] = [
    Fault::NewReader,
    Fault::DaemonRestarts,
    Fault::CompanionRestarts,
    Fault::PipewireRestarts,
    Fault::WireplumberRestarts,
    Fault::CameraHasAnotherSize,
    Fault::ReaderIsSlow,
    Fault::ReaderKeepsAll,
    Fault::ReaderIsKilledWithPictures,
    Fault::ReaderAsksForOtherFormats,
];

/// A session that faults happen to. A part is `None` while it is being replaced.
struct Setup {
    session: Session,
    size: (u32, u32),
    producer: Option<Producer>,
    companion: Option<Running>,
    reader: Option<Reader>,
}

impl Setup {
    fn producer(&self) -> &Producer {
        self.producer.as_ref().expect("put back after each fault")
    }

    /// Makes the fault happen; says after how many seconds a reader had a new picture.
    fn inject(&mut self, fault: Fault) -> f64 {
        match fault {
            Fault::NewReader => self.new_reader(monotonic_ns()),
            Fault::DaemonRestarts => {
                let from = self.restart_daemon();
                let number = self.producer().number();
                let reader = self.reader.as_ref().expect("put back after each fault");
                seconds(reader.newer_than(number) - from)
            }
            Fault::CompanionRestarts => {
                self.companion = None;
                until("the node goes", || self.session.node(&node_name()).is_none());
                let from = monotonic_ns();
                self.companion = Some(self.session.companion());
                self.new_reader(from)
            }
            Fault::PipewireRestarts => {
                self.session.kill_pipewire();
                self.session.start_pipewire();
                self.new_reader(monotonic_ns())
            }
            Fault::WireplumberRestarts => {
                self.session.kill_wireplumber();
                self.session.start_wireplumber();
                self.new_reader(monotonic_ns())
            }
            Fault::CameraHasAnotherSize => {
                self.size = if self.size == SIZE { (640, 480) } else { SIZE };
                // While the reader watches, the node keeps its size; programs that come later find the new one.
                self.restart_daemon();
                self.new_reader(monotonic_ns())
            }
            Fault::ReaderIsSlow => {
                let slow = Reader::slow(&self.session, self.size);
                let gap = self.longest_gap(Duration::from_secs(3));
                drop(slow);
                gap
            }
            Fault::ReaderKeepsAll => {
                let hoarder = self.hoard();
                let gap = self.longest_gap(Duration::from_secs(3));
                drop(hoarder);
                gap
            }
            Fault::ReaderIsKilledWithPictures => {
                drop(self.hoard());
                self.longest_gap(Duration::from_secs(2))
            }
            Fault::ReaderAsksForOtherFormats => {
                let others = ["video/x-raw,format=RGB", "video/x-raw,width=1000,height=500", "image/jpeg"];
                let others = others.map(|wants| Reader::with(&self.session, self.size, wants));
                let gap = self.longest_gap(Duration::from_secs(2));
                drop(others);
                gap
            }
        }
    }

    /// Says when the new one was started (CLOCK_MONOTONIC, nanoseconds).
    fn restart_daemon(&mut self) -> i64 {
        let number = (self.producer().number() + 1000) % 60_000;
        self.producer = None;
        let from = monotonic_ns();
        self.producer = Some(Producer::start(&self.session.folder, self.size, number));
        from
    }

    /// Replaces the reader; says how many seconds after `from` it had a picture that was made meanwhile.
    fn new_reader(&mut self, from: i64) -> f64 {
        self.reader = None;
        // Programs choose a camera that they see, in the size that it has.
        let (width, height) = self.size;
        let size = serde_json::json!({"width": width, "height": height});
        until("the node", || {
            self.session.node(&node_name()).is_some_and(|node| node["params"]["EnumFormat"][0]["size"] == size)
        });
        let (number, there) = (self.producer().number(), monotonic_ns());
        self.reader = Some(Reader::start(&self.session, self.size));
        let linked = self.until_watched();
        let reader = self.reader.as_ref().expect("just started");
        let shown = reader.newer_than(number);
        let parts = [there - from, linked - there, shown - linked].map(|part| format!("{:.2}", seconds(part)));
        println!("    seconds: {} to the node, {} to the reader's link, {} to its picture", parts[0], parts[1], parts[2]);
        seconds(shown - from)
    }

    /// When the daemon knew that the reader watches (CLOCK_MONOTONIC, nanoseconds).
    fn until_watched(&self) -> i64 {
        while self.producer().companions.watching() == 0 {
            std::thread::sleep(Duration::from_millis(1));
        }
        monotonic_ns()
    }

    /// A reader that got some pictures and then keeps them.
    fn hoard(&self) -> Reader {
        let hoarder = Reader::start(&self.session, self.size);
        until("it has some", || hoarder.arrivals().len() > 2);
        hoarder.process.signal(Signal::STOP);
        std::thread::sleep(Duration::from_millis(400));
        hoarder
    }

    /// The longest time without a new picture for the reader from a second ago until `patience` is over, and a picture came after that
    /// (seconds).
    fn longest_gap(&self, patience: Duration) -> f64 {
        let from = monotonic_ns() - 1_000_000_000;
        std::thread::sleep(patience);
        let reader = self.reader.as_ref().expect("put back after each fault");
        reader.newer_than(self.producer().number());
        let mut last = None;
        let fresh = reader
            .arrivals()
            .into_iter()
            .filter(|arrival| arrival.number.is_some() && last.replace(arrival.number) != Some(arrival.number));
        let times: Vec<i64> = fresh.map(|arrival| arrival.time_ns).filter(|time_ns| *time_ns >= from).collect();
        seconds(times.windows(2).map(|two| two[1] - two[0]).max().unwrap_or(0))
    }
}

fn seconds(nanoseconds: i64) -> f64 {
    nanoseconds as f64 * 1e-9
}

/// Faults in an order that a seed chooses; after each, a reader gets new pictures. By hand: `GIMBALD_FAULTS=100 GIMBALD_SEED=2`, and
/// `GIMBALD_FAULT=NewReader` for one kind of them.
///
/// What is printed at the end are times from when the restarted process was started to when a reader had a picture made later. Where a
/// fault costs readers their camera, or a new reader is the point, that includes the start of a new one (as in `NewReader`, for comparison).
/// Where another reader does something, it is the longest time without a new picture.
#[test]
fn every_fault_in_any_order() {
    let (rounds, mut random) = (variable("GIMBALD_FAULTS", 12), Congruential::new(variable("GIMBALD_SEED", 1) * 2 + 1));
    let Some(Stage { session, producer, companion, reader }) = staged("faults", SIZE) else { return };
    let (producer, companion, reader) = (Some(producer), Some(companion), Some(reader));
    let only = std::env::var("GIMBALD_FAULT").ok();
    let chosen: Vec<Fault> =
        FAULTS.into_iter().filter(|fault| only.as_ref().is_none_or(|only| *only == format!("{fault:?}"))).collect();
    assert!(!chosen.is_empty(), "GIMBALD_FAULT={only:?}: it may be one of {FAULTS:?}");
    let mut setup = Setup { session, size: SIZE, producer, companion, reader };
    let mut times: BTreeMap<Fault, Vec<f64>> = BTreeMap::new();
    for round in 0..rounds {
        let fault = chosen[random.below(chosen.len())];
        let begun = Instant::now();
        let seconds = setup.inject(fault);
        println!(
            "round {round}: {fault:?}: a new picture {seconds:.2} s after ({:.1} s in all)",
            begun.elapsed().as_secs_f64()
        );
        times.entry(fault).or_default().push(seconds);
    }
    println!("{:<28} rounds  median  longest  above 1 s", format!("{rounds} rounds"));
    for (fault, mut seconds) in times {
        seconds.sort_by(f64::total_cmp);
        let (median, longest) = (seconds[seconds.len() / 2], seconds[seconds.len() - 1]);
        let late = seconds.iter().filter(|seconds| **seconds > 1.0).count();
        println!("{:<28} {:>6}  {median:>5.2}s  {longest:>6.2}s  {late:>9}", format!("{fault:?}"), seconds.len());
    }
}
