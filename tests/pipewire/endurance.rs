//! Minutes of pictures: none lost, how late, what the companion and the frame path cost, memory level.

use std::fs;
use std::process::Command;
use std::sync::atomic::Ordering::Relaxed;
use std::time::{Duration, Instant};

use gimbald::rt::clock::monotonic_ns;

use super::reader::Reader;
use super::session::Running;
use super::{grow, offered};

/// Processor time of all threads of a process, nanoseconds.
fn processor_ns(process: &Running) -> i64 {
    let tasks = fs::read_dir(format!("/proc/{}/task", process.0.id())).unwrap().flatten();
    let of = |path: std::path::PathBuf| fs::read_to_string(path).ok()?.split(' ').next()?.parse::<i64>().ok();
    tasks.filter_map(|task| of(task.path().join("schedstat"))).sum()
}

/// Memory of a process but for what it shares (the pictures), KiB.
fn own_memory_kib(process: &Running) -> u64 {
    let status = fs::read_to_string(format!("/proc/{}/status", process.0.id())).unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("RssAnon:")).unwrap();
    line.trim().trim_end_matches(" kB").parse().unwrap()
}

/// Two readers at 30 pictures a second for GIMBALD_SECONDS at 720p, then at 1080p. With the release build:
/// `GIMBALD_SECONDS=600 cargo test --release --test pipewire endurance -- --ignored --nocapture`. What a machine must be idle for is
/// printed; what it need not be idle for is checked.
#[test]
#[ignore = "by hand: it takes minutes, and an idle machine"]
fn endurance() {
    let seconds = std::env::var("GIMBALD_SECONDS").ok().and_then(|text| text.parse().ok()).unwrap_or(60);
    let crops = Command::new("gst-inspect-1.0").arg("videocrop").output();
    if !crops.is_ok_and(|output| output.status.success()) {
        println!("SKIPPED: endurance: GStreamer has no videocrop (gstreamer1.0-plugins-good)");
        return;
    }
    for size in [(1280, 720), (1920, 1080)] {
        let Some((session, producer, companion)) = offered("endurance", size) else { return };
        let readers = [Reader::cut(&session, size), Reader::cut(&session, size)];
        readers.iter().for_each(|reader| reader.reaches(60));
        let (from, (_, dropped)) = (producer.number(), producer.companions.counts());
        let (begun, companion_ns, path_ns) = (monotonic_ns(), processor_ns(&companion), producer.cpu_ns.load(Relaxed));
        let mut memory = vec![own_memory_kib(&companion)];
        let end = Instant::now() + Duration::from_secs(seconds);
        while Instant::now() < end {
            std::thread::sleep(Duration::from_secs(1));
            memory.push(own_memory_kib(&companion));
        }
        let to = producer.number();
        let share = |spent: i64| 100.0 * spent as f64 / (monotonic_ns() - begun) as f64;
        let costs = (share(processor_ns(&companion) - companion_ns), share(producer.cpu_ns.load(Relaxed) - path_ns));
        let dropped = producer.companions.counts().1 - dropped;
        println!("{}x{}: {} pictures in {seconds} s, {dropped} dropped before the companion", size.0, size.1, to - from);
        println!("  companion {:.2} % of a core; drawing and sending {:.2} % of the daemon's", costs.0, costs.1);
        println!(
            "  companion's own memory: {} KiB, at most {}, in the end {}",
            memory[0],
            memory.iter().max().unwrap(),
            memory.last().unwrap()
        );
        for reader in &readers {
            reader.reaches(to);
            let arrivals = reader.arrivals();
            let mut late: Vec<f64> = (arrivals.iter())
                .filter_map(|arrival| Some((arrival.number.filter(|n| (from + 1..=to).contains(n))?, arrival.time_ns)))
                .map(|(number, time_ns)| (time_ns - producer.sent_ns[number as usize].load(Relaxed)) as f64 * 1e-6)
                .collect();
            late.sort_by(f64::total_cmp);
            let lost = (to - from) as usize - late.len().min((to - from) as usize);
            println!(
                "  reader: {lost} lost; {:.2} ms after they were drawn in the median, {:.2} at 99 of 100, {:.2} at most",
                late[late.len() / 2],
                late[late.len() * 99 / 100],
                late[late.len() - 1]
            );
            assert!(grow(&reader.numbers()), "in order");
        }
        // The first seconds fill caches.
        let early = memory.iter().take(memory.len() / 4 + 5).max().unwrap();
        assert!(memory.last().unwrap() <= &(early + 1024), "memory grows: {memory:?}");
    }
}
