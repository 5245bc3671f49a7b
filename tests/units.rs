//! The service's two units are alike but for the instance's name, and name what the program has.

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
        .replace(" (%i)", "");
    assert_eq!(said(&each), said(ONE));
    assert!(!each.contains("%i"), "a name that is not accounted for");
}

#[test]
fn the_commands_of_the_units_are_commands_of_the_program() {
    let commands: Vec<String> = said(ONE).into_iter().filter(|line| line.starts_with("Exec")).collect();
    assert_eq!(commands.len(), 2);
    for command in commands {
        let words: Vec<&str> = command.split(' ').collect();
        assert!(words[0].ends_with("=/usr/bin/gimbald"), "{command}");
        let output = Command::new(env!("CARGO_BIN_EXE_gimbald")).args([words[1], "--help"]).output().unwrap();
        let help = String::from_utf8_lossy(&output.stdout);
        assert!(output.status.success() && help.contains(words[2]), "{command}: {help}");
    }
}
