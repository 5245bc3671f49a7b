//! The PipeWire node with real PipeWire, WirePlumber and GStreamer, in a session without a desktop; the companion is the real program.
//!
//! What is not installed is `SKIPPED`. The daemon's side is the library's server with numbered pictures instead of a camera's.

mod endurance;
mod faults;
mod feed;
mod producer;
mod reader;
mod session;

use std::sync::atomic::Ordering::Relaxed;
use std::time::Duration;

use producer::{Producer, node_name};
use reader::Reader;
use session::{Running, Session, session, silent_session, until};

const SIZE: (u32, u32) = (320, 240);

/// A session, a daemon's side, a companion, and a reader that gets pictures.
struct Stage {
    session: Session,
    producer: Producer,
    companion: Running,
    reader: Reader,
}

/// The same without a reader; `None` where the machine lacks something, which is said.
fn offered(name: &str, size: (u32, u32)) -> Option<(Session, Producer, Running)> {
    let session = session(name)?;
    let producer = Producer::start(&session.folder, size, 0);
    let companion = session.companion();
    until("the node", || session.node(&node_name()).is_some());
    Some((session, producer, companion))
}

fn staged(name: &str, size: (u32, u32)) -> Option<Stage> {
    let (session, producer, companion) = offered(name, size)?;
    let reader = Reader::start(&session, size);
    reader.reaches(10);
    Some(Stage { session, producer, companion, reader })
}

/// Whether the numbers only grow.
fn grow(numbers: &[u32]) -> bool {
    numbers.windows(2).all(|two| two[0] < two[1])
}

#[test]
fn the_node_is_a_camera_of_one_format_and_listing_it_does_not_open_the_camera() {
    let Some((session, producer, _companion)) = offered("properties", (1280, 720)) else { return };
    until("the node", || session.node(&node_name()).is_some_and(|node| !node["params"]["EnumFormat"].is_null()));
    let node = session.node(&node_name()).unwrap();
    let of = |key: &str| node["props"][key].as_str().unwrap_or_default().to_owned();
    assert_eq!(of("media.class"), "Video/Source");
    assert_eq!(of("media.role"), "Camera");
    assert_eq!(of("media.type"), "Video");
    assert_eq!(of("media.category"), "Capture");
    assert!(of("node.description").starts_with("gimbald"), "{node:#}");
    assert_eq!(node["props"]["node.driver"], true, "{node:#}");
    let formats = node["params"]["EnumFormat"].as_array().unwrap();
    let one = serde_json::json!({"mediaType": "video", "mediaSubtype": "raw", "format": "YUY2",
        "size": {"width": 1280, "height": 720}, "framerate": {"num": 30, "denom": 1}});
    assert_eq!(formats, &[one], "one format without a choice: browsers do not see others");
    for _ in 0..3 {
        let status = session.command("wpctl").arg("status").output().unwrap();
        let status = String::from_utf8_lossy(&status.stdout).into_owned();
        assert!(status.contains("gimbald"), "{status}");
        let _ = session.command("gst-launch-1.0").args(["-q", "fakesrc", "num-buffers=1", "!", "fakesink"]).status();
        assert_ne!(session.node(&node_name()).unwrap()["state"], "running");
    }
    assert_eq!((producer.companions.connected(), producer.companions.watching(), producer.number()), (1, 0, 0));
}

#[test]
fn two_readers_get_every_picture_in_order_and_the_camera_rests_when_they_have_left() {
    let Some((session, producer, _companion)) = offered("readers", SIZE) else { return };
    let first = Reader::start(&session, SIZE);
    first.reaches(10);
    let second = Reader::start(&session, SIZE);
    second.reaches(30);
    let from = producer.number();
    first.reaches(from + 90);
    second.reaches(from + 90);
    assert_eq!(producer.companions.watching(), 1, "one node, however many watch it");
    for (name, reader) in [("first", &first), ("second", &second)] {
        let numbers: Vec<u32> = reader.numbers().into_iter().filter(|n| (from..from + 90).contains(n)).collect();
        println!("{name}: {} of 90 pictures", numbers.len());
        assert!(grow(&numbers), "{name}: {numbers:?}");
        let mut late: Vec<f64> = (reader.arrivals().into_iter())
            .filter_map(|arrival| Some((arrival.number.filter(|n| numbers.contains(n))?, arrival.time_ns)))
            .map(|(number, time_ns)| (time_ns - producer.sent_ns[number as usize].load(Relaxed)) as f64 * 1e-6)
            .collect();
        late.sort_by(f64::total_cmp);
        println!("{name}: {:.2} ms from drawing to the reader's end, in the median", late[late.len() / 2]);
        // A machine that others share loses some.
        assert!(numbers.len() > 45, "{name}: {} of 90", numbers.len());
    }
    drop(first);
    let from = producer.number();
    second.reaches(from + 30);
    assert_eq!(producer.companions.watching(), 1);
    drop(second);
    until("no program watches", || producer.companions.watching() == 0);
    let resting = producer.number();
    std::thread::sleep(Duration::from_millis(300));
    assert_eq!(producer.number(), resting);
    // And again, with each reader that comes.
    let third = Reader::start(&session, SIZE);
    third.reaches(resting + 10);
}

#[test]
fn two_daemons_are_two_cameras_and_who_watches_one_wakes_no_other() {
    const OTHER: (u32, u32) = (160, 120);
    let Some((session, producer, _companion)) = offered("two", SIZE) else { return };
    let instance = format!("{}-other", producer::instance());
    let node = format!("gimbald.{instance}");
    let other = Producer::named(&session.folder, &instance, OTHER, 20_000);
    until("the second node", || session.node(&node).is_some());
    let descriptions =
        [node_name(), node.clone()].map(|name| session.node(&name).unwrap()["props"]["node.description"].clone());
    assert_ne!(descriptions[0], descriptions[1], "programs list them by these");

    let reader = Reader::of(&session, &node, OTHER);
    reader.reaches(20_010);
    assert_eq!((producer.companions.watching(), producer.number()), (0, 0));
    let first = Reader::start(&session, SIZE);
    first.reaches(10);
    let at = producer.number();
    drop(reader);
    until("no program watches the second", || other.companions.watching() == 0);
    first.reaches(at + 30);
    assert!(first.numbers().iter().all(|&number| number < 20_000), "each has its own camera's pictures");

    drop(other);
    first.reaches(at + 60);
}

#[test]
fn readers_keep_their_camera_while_the_daemon_is_away() {
    let Some(Stage { session, producer, companion: _companion, reader }) = staged("restart", SIZE) else { return };
    drop(producer);
    let last = *reader.numbers().last().unwrap();
    let before = reader.arrivals().len();
    // Its last picture goes on, four times a second.
    until("the last picture goes on", || reader.arrivals().len() >= before + 8);
    let meanwhile = reader.arrivals();
    assert!(meanwhile.iter().rev().take(5).all(|arrival| arrival.number.is_some_and(|number| number >= last)), "{meanwhile:?}");
    assert_eq!(session.node(&node_name()).unwrap()["state"], "running");
    let _producer = Producer::start(&session.folder, SIZE, 10_000);
    reader.reaches(10_030);
    assert!(grow(&reader.numbers()));
}

#[test]
fn without_a_daemon_watchers_see_the_dark_picture_and_then_the_camera() {
    // It was there once, so its node is known, and went before any program watched.
    let Some((session, producer, _companion)) = offered("dark", SIZE) else { return };
    until("it is connected", || producer.companions.connected() == 1);
    drop(producer);
    let reader = Reader::start(&session, SIZE);
    until("dark pictures", || reader.arrivals().len() >= 5);
    assert!(reader.numbers().is_empty());
    let _producer = Producer::start(&session.folder, SIZE, 500);
    reader.reaches(510);
}

#[test]
fn the_node_has_the_daemon_s_size_unless_readers_hold_another() {
    let Some(session) = session("size") else { return };
    let _companion = session.companion();
    let size_is = |size: (u32, u32)| {
        let wanted = serde_json::json!({"width": size.0, "height": size.1});
        until("the node's size", || {
            session.node(&node_name()).is_some_and(|node| node["params"]["EnumFormat"][0]["size"] == wanted)
        });
    };
    let producer = Producer::start(&session.folder, SIZE, 0);
    size_is(SIZE);
    let reader = Reader::start(&session, SIZE);
    reader.reaches(5);
    drop(producer);
    // Another camera: programs that watch hold the size, which the daemon is told.
    let other = Producer::start(&session.folder, (640, 480), 2000);
    until("it is told", || other.companions.held_size() == Some(SIZE));
    std::thread::sleep(Duration::from_millis(600));
    assert_eq!(session.node(&node_name()).unwrap()["state"], "running");
    assert_eq!(other.number(), 2000, "pictures of another size do not fit");
    drop(reader);
    size_is((640, 480));
    let reader = Reader::start(&session, (640, 480));
    reader.reaches(2010);
}

#[test]
fn readers_that_ask_for_formats_that_the_node_has_not_disturb_no_other() {
    let Some(Stage { session, producer, companion: _companion, reader }) = staged("formats", SIZE) else { return };
    for wants in ["video/x-raw,format=RGB", "video/x-raw,width=1000,height=500", "image/jpeg"] {
        let stranger = Reader::with(&session, SIZE, wants);
        std::thread::sleep(Duration::from_millis(700));
        assert!(stranger.arrivals().is_empty(), "{wants}");
        let from = producer.number();
        reader.reaches(from + 5);
    }
    // Alone as well, it leaves a node that others can use.
    drop(reader);
    until("no program watches", || producer.companions.watching() == 0);
    let stranger = Reader::with(&session, SIZE, "video/x-raw,format=RGB");
    std::thread::sleep(Duration::from_millis(700));
    assert_eq!(producer.companions.watching(), 0);
    drop(stranger);
    let from = producer.number();
    Reader::start(&session, SIZE).reaches(from + 10);
}

#[test]
fn it_waits_for_a_pipewire_that_does_not_run_yet() {
    let Some(mut session) = silent_session("late") else { return };
    let producer = Producer::start(&session.folder, SIZE, 0);
    let mut companion = session.companion();
    until("it is connected", || producer.companions.connected() == 1);
    assert!(companion.0.try_wait().unwrap().is_none(), "it does not give up");
    session.start_pipewire();
    until("the node", || session.node(&node_name()).is_some());
    Reader::start(&session, SIZE).reaches(10);
    let said = std::fs::read_to_string(session.folder.join("companion.log")).unwrap();
    assert!(said.contains("systemctl --user status pipewire"), "{said}");
}

#[test]
fn without_pipewire_s_plugins_it_says_what_to_install() {
    let Some(session) = silent_session("plugins") else { return };
    let mut command = session.command(env!("CARGO_BIN_EXE_gimbald"));
    let output = command.arg("pipewire").env("SPA_PLUGIN_DIR", "/no/such/folder").output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(69), "{said}");
    assert!(said.contains("/no/such/folder/support/libspa-support.so") && said.contains("apt-get install"), "{said}");
}
