//! Files that show people are their owner's alone: recordings, pictures and reports, new or written over older ones.

use std::fs::{self, Permissions};
use std::io::Write;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

const FOOTAGE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/car-mjpeg-400x300.gbr");
const GIMBALD: &str = env!("CARGO_BIN_EXE_gimbald");
/// New files may be read by all, unless their maker says otherwise.
const OPEN_TO_ALL: &str = "umask 022; exec \"$@\"";

fn gimbald(arguments: &[&str]) -> Output {
    Command::new("sh").args(["-c", OPEN_TO_ALL, "sh", GIMBALD]).args(arguments).output().unwrap()
}

fn mode(path: &Path) -> u32 {
    fs::metadata(path).unwrap().permissions().mode() & 0o777
}

/// All that `replay` can write, in `directory`.
fn replay_into(directory: &Path) -> Vec<PathBuf> {
    let names = ["out.gbr", "beside.y4m", "report.html", "trace.csv", "stats.json"];
    let paths: Vec<_> = names.iter().map(|name| directory.join(name)).collect();
    let [out, beside, report, trace, stats] = std::array::from_fn(|index| paths[index].to_str().unwrap());
    let compare = format!("--compare={beside}");
    let output = gimbald(&["replay", FOOTAGE, "-o", out, &compare, "--report", report, "--trace", trace, "--stats", stats]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    paths
}

#[test]
fn what_replay_writes_is_for_its_owner_alone() {
    let scratch = tempfile::tempdir().unwrap();
    let paths = replay_into(scratch.path());
    for path in &paths {
        assert_eq!(mode(path), 0o600, "{}", path.display());
        fs::set_permissions(path, Permissions::from_mode(0o644)).unwrap();
    }
    // As an older gimbald left them.
    for path in replay_into(scratch.path()) {
        assert_eq!(mode(&path), 0o600, "{}, written over", path.display());
    }
}

#[test]
fn what_demo_writes_is_for_its_owner_alone() {
    let scratch = tempfile::tempdir().unwrap();
    let output = gimbald(&["demo", "--dir", scratch.path().to_str().unwrap(), "--seconds", "0.2"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let files: Vec<_> = fs::read_dir(scratch.path()).unwrap().map(|entry| entry.unwrap().path()).collect();
    assert_eq!(files.len(), 9, "{files:?}");
    for path in files {
        assert_eq!(mode(&path), 0o600, "{}", path.display());
    }
}

#[test]
fn another_users_file_is_not_written_over() {
    if !rustix::process::geteuid().is_root() {
        // Past the test harness, which keeps what a test prints to itself unless it fails.
        let _ = writeln!(std::io::stderr(), "SKIPPED: another user's file: only root can make one");
        return;
    }
    let scratch = tempfile::tempdir().unwrap();
    fs::set_permissions(scratch.path(), Permissions::from_mode(0o777)).unwrap();
    let path = scratch.path().join("theirs.y4m");
    fs::write(&path, "theirs").unwrap();
    fs::set_permissions(&path, Permissions::from_mode(0o666)).unwrap();
    // The input comes through a pipe: another user may not be let into the source's folder; nor is its program, which is copied.
    let program = scratch.path().join("gimbald");
    fs::copy(GIMBALD, &program).unwrap();
    let [program, out] = [&program, &path].map(|path| path.to_str().unwrap());
    let line = "cat \"$1\" | setpriv --reuid 65534 --regid 65534 --clear-groups \"$2\" replay - -o \"$3\"";
    let output = Command::new("sh").args(["-c", line, "sh", FOOTAGE, program, out]).current_dir("/").output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(73), "{said}");
    assert!(said.contains("theirs.y4m") && said.contains("belongs to another user"), "{said}");
    assert_eq!(fs::read_to_string(&path).unwrap(), "theirs");
}
