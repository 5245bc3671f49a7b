//! What goes wrong: processes that are killed, readers that keep everything.

use std::time::{Duration, Instant};

use rustix::process::Signal;

use super::SIZE;
use super::producer::{Producer, node_name};
use super::reader::Reader;
use super::session::{Session, session, until};

#[test]
fn a_companion_that_was_killed_comes_back_and_the_daemon_goes_on() {
    let Some(session) = session("companion") else { return };
    let producer = Producer::start(&session.folder, SIZE, 0);
    let companion = session.companion();
    until("the node", || session.node(&node_name()).is_some());
    let reader = Reader::start(&session, SIZE);
    reader.reaches(10);
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
    let Some(mut session) = session("pipewire") else { return };
    let producer = Producer::start(&session.folder, SIZE, 0);
    let _companion = session.companion();
    until("the node", || session.node(&node_name()).is_some());
    let reader = Reader::start(&session, SIZE);
    reader.reaches(10);
    session.kill_wireplumber();
    // Links are WirePlumber's, and go with it. (GStreamer's reader of 0.3.65 is linked again and gets nothing: a new one does.)
    until("nobody watches", || producer.companions.watching() == 0);
    drop(reader);
    session.start_wireplumber();
    let from = producer.number();
    let reader = Reader::start(&session, SIZE);
    reader.reaches(from + 10);
    session.kill_pipewire();
    until("nobody watches", || producer.companions.watching() == 0);
    drop(reader);
    session.start_pipewire();
    until("the node", || session.node(&node_name()).is_some());
    let from = producer.number();
    Reader::start(&session, SIZE).reaches(from + 10);
}

#[test]
fn a_reader_that_keeps_every_picture_or_is_killed_with_them_starves_nobody() {
    let Some(session) = session("hoard") else { return };
    let producer = Producer::start(&session.folder, SIZE, 0);
    let _companion = session.companion();
    until("the node", || session.node(&node_name()).is_some());
    let reader = Reader::start(&session, SIZE);
    reader.reaches(10);
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

/// Faults in an order that a seed chooses; after each, a reader gets new pictures. `GIMBALD_FAULTS=100` is what was asked for.
#[test]
fn every_fault_in_any_order() {
    let Some(mut session) = session("faults") else { return };
    let (rounds, mut state) = (variable("GIMBALD_FAULTS", 12), variable("GIMBALD_SEED", 1) * 2 + 1);
    let mut number = 0;
    let mut producer = Some(Producer::start(&session.folder, SIZE, number));
    let mut companion = session.companion();
    until("the node", || session.node(&node_name()).is_some());
    let mut reader = Some(Reader::start(&session, SIZE));
    let mut times = Vec::new();
    for round in 0..rounds {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let fault = state >> 33;
        let after = |producer: &Producer| producer.number() + 2;
        let name = match fault % 6 {
            0 => {
                number = producer.take().map_or(0, |producer| producer.number()) + 1000;
                producer = Some(Producer::start(&session.folder, SIZE, number % 60_000));
                "the daemon was restarted"
            }
            1 => {
                drop(companion);
                companion = session.companion();
                reader = None;
                "the companion was killed"
            }
            2 => {
                session.kill_pipewire();
                session.start_pipewire();
                reader = None;
                "PipeWire was restarted"
            }
            3 => {
                session.kill_wireplumber();
                session.start_wireplumber();
                reader = None;
                "WirePlumber was restarted"
            }
            4 => {
                reader = None;
                "the reader was killed"
            }
            _ => {
                hoard(&session);
                "a reader was killed that kept all it got"
            }
        };
        let before = Instant::now();
        if reader.is_none() {
            until("the node", || session.node(&node_name()).is_some());
            reader = Some(Reader::start(&session, SIZE));
        }
        let (reader, producer) = (reader.as_ref().unwrap(), producer.as_ref().unwrap());
        reader.reaches(after(producer));
        times.push(before.elapsed());
        println!("round {round}: {name}; a new picture {:.2} s after", before.elapsed().as_secs_f64());
    }
    times.sort();
    println!("{rounds} rounds: median {:?}, longest {:?}", times[times.len() / 2], times.last().unwrap());
}

fn hoard(session: &Session) {
    let hoarder = Reader::start(session, SIZE);
    until("it has some", || hoarder.arrivals().len() > 2);
    hoarder.process.signal(Signal::STOP);
    std::thread::sleep(Duration::from_millis(400));
}
