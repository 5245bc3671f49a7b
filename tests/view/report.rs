//! `gimbald report`: the page about a running daemon, and what is not in it.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Output};
use std::time::Duration;

use gimbald::control::{CameraInfo, OutputInfo};

use crate::daemon::TestDaemon;
use crate::web::until;

pub fn gimbald(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_gimbald")).args(arguments).output().unwrap()
}

/// Runs `gimbald report` and gives back the page.
fn report(running: &TestDaemon, path: &Path, options: &[&str]) -> String {
    let fixed = ["report", "--socket", &running.socket(), "-o", path.to_str().unwrap()];
    let ended = gimbald(&[&fixed, options].concat());
    assert!(ended.status.success() && ended.stderr.is_empty(), "{ended:?}");
    fs::read_to_string(path).unwrap()
}

#[test]
fn the_report_of_a_daemon_says_nothing_of_its_user_and_has_pictures_only_when_asked() {
    let running = TestDaemon::start("report");
    let camera = CameraInfo {
        path: "/dev/v4l/by-id/usb-Maker_Model_SN12345".into(),
        name: "Anna's camera".into(),
        bus: "usb-0000:00:14.0-3".into(),
        format: "MJPG".into(),
        width: 320,
        height: 240,
        fps: 30.0,
    };
    running.state.metrics.set_camera(camera);
    let output = OutputInfo { path: "/dev/anna".into(), format: "YU12".into(), width: 320, height: 240 };
    running.state.metrics.set_output(output, None);
    until(|| (running.state.metrics.frames_sent().0 > 60).then_some(()));
    let scratch = tempfile::tempdir().unwrap();
    let path = scratch.path().join("report.html");
    let host = fs::read_to_string("/proc/sys/kernel/hostname").unwrap().trim().to_owned();
    let plain = report(&running, &path, &[]);
    assert_eq!(fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
    assert_eq!(running.companions().watching(), 0, "the camera was left alone");
    let secrets = ["SN12345", "by-id", "nna", "0000:00", "/control.sock", &running.socket(), scratch.path().to_str().unwrap()];
    for secret in secrets.iter().chain([&host.as_str()]).filter(|secret| !secret.is_empty()) {
        assert!(!plain.contains(*secret), "{secret} is in the page");
    }
    for words in ["MJPG 320x240 at 30.000 fps", "loopback, YU12 320x240", "<h2>Path</h2>", "Age of frames", "smooth.strength"] {
        assert!(plain.contains(words), "{words} is not in the page");
    }
    assert!(!plain.contains("<image") && !plain.contains("NaN") && plain.contains("and no pictures"), "{plain}");
    assert!(!plain.replace("http-equiv", "").contains("http"), "nothing is loaded from elsewhere");
    let named = report(&running, &path, &["--names"]);
    assert!(named.contains("SN12345") && named.contains("/dev/anna") && !named.contains("<image"));
    let pictured = report(&running, &path, &["--pictures"]);
    assert_eq!(pictured.matches("<image ").count(), 4);
    assert!(pictured.len() < 500_000 && !pictured.contains("SN12345"), "{} bytes", pictured.len());
    until(|| (running.companions().watching() == 0).then_some(()));
}

#[test]
fn without_a_daemon_the_report_fails_as_status_does_and_leaves_no_file() {
    let scratch = tempfile::tempdir().unwrap();
    let file = |name: &str| scratch.path().join(name).to_str().unwrap().to_owned();
    let (socket, page) = (file("control.sock"), file("report.html"));
    let told = gimbald(&["report", "--socket", &socket, "-o", &page]);
    let status = gimbald(&["status", "--socket", &socket]);
    assert_eq!((told.status.code(), &told.stderr), (Some(69), &status.stderr));
    assert!(!Path::new(&page).exists());
    let running = TestDaemon::start("report-wrong");
    let told = gimbald(&["report", "--socket", &running.socket(), "-o", &file("no/where.html")]);
    assert!(told.status.code() == Some(73) && String::from_utf8_lossy(&told.stderr).contains("no/where.html"), "{told:?}");
}

#[test]
fn a_daemon_that_gives_no_pictures_still_has_a_report() {
    let running = TestDaemon::start("report-blind");
    let _ = fs::remove_file(Path::new(&running.socket()).with_file_name("pictures.sock"));
    std::thread::sleep(Duration::from_millis(300));
    let scratch = tempfile::tempdir().unwrap();
    let path = scratch.path().join("report.html");
    let told = gimbald(&["report", "--socket", &running.socket(), "--pictures", "-o", path.to_str().unwrap()]);
    let said = String::from_utf8_lossy(&told.stderr);
    assert!(told.status.success() && said.contains("output.pipewire") && said.contains("has no pictures"), "{said}");
    assert!(fs::read_to_string(&path).unwrap().contains("and no pictures"));
}
