//! A producer for programs that are no tests of Rust's: browsers.

use std::path::PathBuf;
use std::time::Duration;

use super::producer::Producer;

/// Pictures of 1280x720 for the companion of the session in XDG_RUNTIME_DIR, until it is killed or ten minutes are over.
#[test]
#[ignore = "for tests/pipewire/browsers"]
fn feed() {
    let runtime = PathBuf::from(std::env::var_os("XDG_RUNTIME_DIR").expect("XDG_RUNTIME_DIR"));
    let producer = Producer::start(&runtime, (1280, 720), 0);
    for second in 0..600 {
        println!(
            "second {second}: {} connected, {} watching, picture {}",
            producer.companions.connected(),
            producer.companions.watching(),
            producer.number()
        );
        std::thread::sleep(Duration::from_secs(1));
    }
}
