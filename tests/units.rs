//! The service's two units are alike but for the instance's name, and name what the program has.

use std::io::Write as _;
use std::process::Command;

const ONE: &str = include_str!("../systemd/gimbald.service");
const EACH: &str = include_str!("../systemd/gimbald@.service");

/// Lines that say something.
fn said(unit: &str) -> Vec<String> {
    unit.lines().filter(|line| !line.is_empty() && !line.starts_with('#')).map(str::to_owned).collect()
}

#[test]
fn both_units_say_the_same() {
    let each = EACH
        .replace("/etc/gimbald/%i.toml", "/etc/gimbald.toml")
        .replace("Directory=gimbald-%i", "Directory=gimbald")
        .replace("/gimbald-%i", "/gimbald")
        .replace(" (%i)", "");
    assert_eq!(said(&each), said(ONE));
    assert!(!each.contains("%i"), "a name that is not accounted for");
}

#[test]
fn the_commands_of_the_units_are_commands_of_the_program() {
    let is_command = |line: &String| line.starts_with("ExecStart=") || line.starts_with("ExecReload=");
    let commands: Vec<String> = said(ONE).into_iter().filter(is_command).collect();
    assert_eq!(commands.len(), 2);
    for command in commands {
        let words: Vec<&str> = command.split(' ').collect();
        assert!(words[0].ends_with("=/usr/bin/gimbald"), "{command}");
        let output = Command::new(env!("CARGO_BIN_EXE_gimbald")).args([words[1], "--help"]).output().unwrap();
        let help = String::from_utf8_lossy(&output.stdout);
        assert!(output.status.success() && help.contains(words[2]), "{command}: {help}");
    }
}

/// `systemd-analyze security` judges what a unit leaves a service, from 0 (nothing) to 10 (all); its threshold is in tenths.
#[test]
fn what_the_units_leave_the_service_is_little() {
    for unit in ["systemd/gimbald.service", "systemd/gimbald@.service"] {
        let arguments = ["security", "--offline=true", "--no-pager", "--threshold=6", unit];
        let judged = Command::new("systemd-analyze").args(arguments).current_dir(env!("CARGO_MANIFEST_DIR")).output();
        // Past the test harness, which keeps what a test prints to itself.
        let skipped = |why: &str| drop(writeln!(std::io::stderr(), "SKIPPED: the units' exposure: {why}"));
        let judged = match judged {
            Ok(judged) => judged,
            Err(error) => return skipped(&format!("systemd-analyze: {error}")),
        };
        let success = judged.status.success();
        let said = [judged.stdout, judged.stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned()).concat();
        if said.contains("unrecognized option") {
            return skipped("this systemd-analyze (before 250) looks at no files");
        }
        assert!(success && said.contains("Overall exposure level"), "{unit}: {said}");
    }
}
