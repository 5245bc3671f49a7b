//! `gimbald view`: the page as programs and as a real browser see it.

mod daemon;
mod report;
mod web;

use std::fs;
use std::io::Write;
use std::process::{Command, Stdio};
use std::time::Duration;

use daemon::TestDaemon;
use web::{Page, until};

const CAR: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/car-mjpeg-400x300.gbr");

/// A picture as the page gets it: what is known of it, and the JPEG (output above input).
struct Preview {
    head: serde_json::Value,
    jpeg: Vec<u8>,
}

fn preview(page: &Page, seen: &str) -> Option<Preview> {
    let answer = page.get(&format!("preview?{seen}"));
    if answer.status == 204 {
        return None;
    }
    assert_eq!(answer.status, 200);
    let (len, rest) = answer.body.split_first_chunk().unwrap();
    let (head, jpeg) = rest.split_at(u32::from_le_bytes(*len) as usize);
    Some(Preview { head: serde_json::from_slice(head).unwrap(), jpeg: jpeg.to_vec() })
}

#[test]
fn a_recording_is_played_paused_and_searched() {
    let page = Page::open(&["view", CAR, "--no-browser"]);
    let about = page.json("about");
    assert_eq!((about["recording"].as_bool(), about["name"].as_str()), (Some(true), Some("car-mjpeg-400x300.gbr")));
    let first = until(|| preview(&page, "seen=0"));
    assert_eq!((first.head["size"][0].as_u64(), first.head["size"][1].as_u64()), (Some(400), Some(300)));
    let mut decoder = jpeg_decoder::Decoder::new(&first.jpeg[..]);
    decoder.decode().unwrap();
    assert_eq!(decoder.info().map(|about| (about.width, about.height)), Some((400, 600)));
    // Played to its end.
    let ended = until(|| Some(page.json("state")).filter(|state| state["state"]["playing"] == false));
    assert!(ended["state"]["position_s"].as_f64().unwrap() > 0.7, "{ended}");
    page.post("play", "seek 0.3");
    let found =
        until(|| Some(page.json("state")).filter(|state| (state["state"]["position_s"].as_f64().unwrap() - 0.3).abs() < 0.05));
    assert_eq!(found["state"]["playing"], false);
    // A setting changes the paused picture.
    let before = until(|| preview(&page, "seen=0"));
    assert_eq!(page.post("set", "crop.zoom=1.6")["ok"], true);
    let corner =
        |preview: &Preview| preview.head["frames"].as_array().unwrap().last().unwrap()["corners"][0][0].as_f64().unwrap();
    until(|| preview(&page, "seen=0").filter(|after| corner(after) > corner(&before) + 30.0));
    assert!(page.post("set", "crop.zoom=9")["error"].as_str().unwrap().contains("1 to 2"));
    assert!(page.post("set", "camera.device=4")["error"].as_str().unwrap().contains("no effect"));
    assert!(page.post("play", "dance")["error"].as_str().unwrap().contains("expected play"));
}

#[test]
fn settings_are_written_into_the_configuration() {
    let scratch = tempfile::tempdir().unwrap();
    let config = scratch.path().join("g.toml");
    fs::write(&config, "# mine\n[crop]\nzoom = 1.2 # wide\n").unwrap();
    let page = Page::open(&["view", CAR, "--no-browser", "--config", config.to_str().unwrap()]);
    assert_eq!(page.json("state")["settings"]["crop.zoom"], "1.2");
    assert_eq!(page.post("set", "crop.zoom=1.3")["ok"], true);
    assert_eq!(page.post("set", "smooth.strength=0.5")["ok"], true);
    let wrote = page.post("write", "crop.zoom=1.3\nsmooth.strength=0.5\nsmooth.lookahead_ms=100\n");
    assert_eq!(wrote["ok"], true, "{wrote}");
    assert_eq!(
        fs::read_to_string(&config).unwrap(),
        "# mine\n[crop]\nzoom = 1.3 # wide\n\n[smooth]\nstrength = 0.5\nlookahead_ms = 100.0\n"
    );
    let without = Page::open(&["view", CAR, "--no-browser"]);
    assert_eq!(without.post("set", "crop.zoom=1.4")["ok"], true);
    let refused = without.post("write", "crop.zoom=1.4");
    assert!(refused["ok"] == false && refused["lines"] == "crop.zoom = 1.4\n", "{refused}");
}

#[test]
fn a_pipe_is_refused_because_it_cannot_be_read_twice() {
    for path in ["-", "/dev/null"] {
        let ended = Command::new(env!("CARGO_BIN_EXE_gimbald")).args(["view", path, "--no-browser"]).output().unwrap();
        let said = String::from_utf8_lossy(&ended.stderr);
        assert!(ended.status.code() == Some(64) && said.contains("not a regular file"), "{said}");
    }
}

#[test]
fn other_sites_and_users_are_refused() {
    let page = Page::open(&["view", CAR, "--no-browser"]);
    let host = format!("127.0.0.1:{}", page.port);
    let status = |path: &str, headers: &[(&str, &str)]| page.raw("GET", path, headers, "").status;
    let good = format!("/{}/state", page.token);
    assert_eq!(status(&good, &[("Host", &host)]), 200);
    assert_eq!(status("/state", &[("Host", &host)]), 404);
    assert_eq!(status(&format!("/{}/state", "0".repeat(32)), &[("Host", &host)]), 404);
    assert_eq!(status(&good, &[("Host", "evil.example")]), 403);
    assert_eq!(status(&good, &[("Host", &host), ("Origin", "https://evil.example")]), 403);
    assert_eq!(status(&good, &[("Host", &host), ("Sec-Fetch-Site", "cross-site")]), 403);
    let set = format!("/{}/set", page.token);
    let change = |headers: &[(&str, &str)]| page.raw("POST", &set, headers, "crop.zoom=1.5").status;
    assert_eq!(change(&[("Host", &host)]), 403, "no origin");
    assert_eq!(change(&[("Host", &host), ("Origin", "null")]), 403);
    assert_eq!(page.raw("DELETE", &good, &[("Host", &host)], "").status, 405);
    assert_eq!(page.json("state")["settings"]["crop.zoom"], "1.1", "nothing has changed");
    let answer = page.raw("GET", &format!("/{}/", page.token), &[("Host", &host)], "");
    for words in ["frame-ancestors 'none'", "no-store", "no-referrer", "nosniff"] {
        assert!(answer.head.contains(words), "{words} in {}", answer.head);
    }
    assert!(!answer.head.to_ascii_lowercase().contains("access-control"), "{}", answer.head);
}

#[test]
fn a_daemon_is_shown_and_tuned_and_its_camera_is_on_only_while_a_page_is_open() {
    let running = TestDaemon::start("daemon");
    let socket = running.socket();
    let page = Page::open(&["view", "--no-browser", "--socket", &socket]);
    std::thread::sleep(Duration::from_millis(300));
    assert_eq!(running.companions().watching(), 0, "no page is open");
    let first = until(|| preview(&page, "seen=0"));
    assert_eq!(running.companions().watching(), 1, "a page counts as a viewer");
    assert_eq!((first.head["size"][0].as_u64(), first.head["input"][0].as_u64()), (Some(320), Some(320)));
    let number = first.head["number"].as_u64().unwrap();
    let second = until(|| preview(&page, &format!("seen={number}&since=0")));
    let frames = second.head["frames"].as_array().unwrap();
    assert!(frames.len() >= 2, "the frames between two pictures are reported as well");
    assert!(frames.iter().all(|frame| frame["path"][0].is_f64() && frame["corners"][2][0].as_f64().unwrap() > 200.0));
    // Twelve a second, not thirty.
    let counted = |page: &Page| until(|| preview(page, "seen=0")).head["number"].as_u64().unwrap();
    let before = counted(&page);
    std::thread::sleep(Duration::from_secs(2));
    let rate = (counted(&page) - before) as f64 / 2.0;
    assert!(rate < 16.0, "{rate} pictures a second");
    assert_eq!(page.post("set", "smooth.strength=0.25")["ok"], true);
    assert_eq!(running.state.live.params().smooth.strength, 0.25, "it reached the daemon");
    assert!(page.post("set", "camera.device=4")["error"].as_str().unwrap().contains("restart"));
    until(|| (running.companions().watching() == 0).then_some(()));
}

#[test]
fn a_real_browser_shows_it() {
    let skipped = |what: &str| {
        // Past the test harness, which keeps what a test prints to itself unless it fails.
        let _ = writeln!(std::io::stderr(), "SKIPPED: the page in a browser: {what}");
    };
    let is = |name: &str| Command::new(name).arg("--version").stdout(Stdio::null()).stderr(Stdio::null()).status().is_ok();
    let Some(chromium) = ["chromium", "chromium-browser", "google-chrome"].into_iter().find(|name| is(name)) else {
        return skipped("Chromium is not installed");
    };
    if !is("python3") {
        return skipped("python3 is not installed");
    }
    let running = TestDaemon::start("browser");
    let daemon = Page::open(&["view", "--no-browser", "--socket", &running.socket()]);
    let recording = Page::open(&["view", CAR, "--no-browser"]);
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/view/browser.py");
    let scratch = tempfile::tempdir().unwrap();
    let report = scratch.path().join("report.html").to_str().unwrap().to_owned();
    let replay = Command::new(env!("CARGO_BIN_EXE_gimbald")).args(["replay", CAR, "-o", "null:", "--report", &report]).status();
    assert!(replay.unwrap().success());
    let service = scratch.path().join("service.html").to_str().unwrap().to_owned();
    let told = report::gimbald(&["report", "--pictures", "--socket", &running.socket(), "-o", &service]);
    assert!(told.status.success(), "{told:?}");
    // PICTURES=DIR leaves screenshots there.
    let pictures = std::env::var("PICTURES").ok();
    let arguments = [script, chromium, &daemon.address(), &recording.address(), &report, &service];
    let output = Command::new("python3").args(arguments).args(pictures).output().unwrap();
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{said}{}", String::from_utf8_lossy(&output.stderr));
    assert!(said.lines().filter(|line| line.starts_with("ok ")).count() >= 10, "{said}");
    assert_ne!(running.state.live.params().smooth.strength, 1.0, "the slider reached the daemon");
}
