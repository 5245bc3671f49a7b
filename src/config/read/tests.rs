//! The reader of settings against right, wrong and random input.

use proptest::prelude::*;

use crate::config::{Kind, MAX_SHOWN, Origin, Settings, keys, shipped_file};
use crate::stage::paper::homography::Form;
use crate::stage::shutter::Prior;

fn read(text: &str) -> Result<Settings, String> {
    Settings::read(Some(("gimbald.toml", text)), &[]).map_err(|faults| faults.to_string())
}

fn set(arguments: &[&str]) -> Result<Settings, String> {
    let arguments: Vec<String> = arguments.iter().map(|argument| argument.to_string()).collect();
    Settings::read(None, &arguments).map_err(|faults| faults.to_string())
}

#[test]
fn the_shipped_file_is_the_defaults() {
    assert_eq!(
        include_str!("../../../config/gimbald.toml"),
        shipped_file(),
        "run: gimbald check --defaults > config/gimbald.toml"
    );
    assert_eq!(read(&shipped_file()), Ok(Settings::default()));
}

#[test]
fn each_key_of_the_shipped_file_is_read() {
    // The defaults alone would also come out of a reader that reads nothing.
    let text = "[smooth]\ncutoff_hz = 2\n[fit]\nform = 'general'\nseed = 0x10\n[camera]\ndevice = 3\nfps = 29.97";
    let settings = read(text).unwrap();
    assert_eq!(settings.pipeline.smooth.cutoff_hz, 2.0);
    assert_eq!((settings.pipeline.fit.form, settings.pipeline.fit.seed), (Form::General, 16));
    assert_eq!((settings.camera.device.as_str(), settings.camera.fps), ("3", 29.97));
}

#[test]
fn the_command_line_wins_over_the_file() {
    let settings = Settings::read(
        Some(("f", "[crop]\nzoom = 1.2\n[camera]\nreadout_ms = 5")),
        &["crop.zoom=1.3".into(), "fit.form=general".into(), "camera.device=/dev/video2".into()],
    )
    .unwrap();
    assert_eq!((settings.pipeline.crop.zoom, settings.pipeline.camera.readout_ms), (1.3, Prior::Fixed(5.0)));
    assert_eq!((settings.pipeline.fit.form, settings.camera.device.as_str()), (Form::General, "/dev/video2"));
}

#[test]
fn all_faults_are_named_at_once_with_line_value_range_and_unit() {
    let text = "[smooth]\ncutof_hz = 1\ncutoff_hz = 50\n\n[fit]\nform = 3\n[crop]\nzoom = [1]\n[track]\nwindow = 10\n";
    let faults = Settings::read(Some(("g.toml", text)), &["crop.zoom=nan".into(), "nonsense".into()]).unwrap_err();
    let lines: Vec<String> = faults.shown.iter().map(ToString::to_string).collect();
    assert_eq!(
        lines,
        [
            "g.toml:2: smooth.cutof_hz = 1: no such key; did you mean smooth.cutoff_hz?",
            "g.toml:3: smooth.cutoff_hz = 50: expected a number from 0.05 to 10 (Hz), found 50; fix the value, or remove the key to use the \
             default 0.6",
            "g.toml:6: fit.form = 3: expected one of \"constrained\", \"general\", found 3; fix the value, or remove the key to use \
             the default \"constrained\"",
            "g.toml:8: crop.zoom = [1]: expected a number from 1 to 2, or \"auto\" (ratio), found an array; fix the value, or remove \
             the key to use the default 1.1",
            "g.toml:10: track.window = 10: expected a whole number from 8 to 24 in steps of 8 (pixels), found 10; fix the value, or remove \
             the key to use the default 16",
            "--set: crop.zoom = nan: expected a number from 1 to 2, or \"auto\" (ratio), found NaN; fix the value, or remove the \
             key to use the default 1.1",
            "--set: nonsense: no = between key and value; write --set KEY=VALUE, e.g. --set smooth.cutoff_hz=0.5",
        ]
    );
}

#[test]
fn of_many_faults_the_first_are_described_and_the_rest_counted() {
    let unknown: String = (0..80_000).map(|n| format!("k{n}.x = 1\n")).collect();
    let syntax = "= =\n".repeat(80_000);
    let twice = "[crop]\n".repeat(80_000);
    let refused = format!("[crop]\nzoom = {}\n", "[".repeat(200_000));
    for (text, count) in [(&unknown, Some(80_000)), (&syntax, None), (&twice, Some(79_999)), (&refused, None)] {
        let faults = Settings::read(Some(("g.toml", text)), &[]).unwrap_err();
        let message = faults.to_string();
        assert!(faults.shown.len() <= MAX_SHOWN && message.len() < 20_000, "{}: {}", faults.shown.len(), message.len());
        if let Some(count) = count {
            assert_eq!((faults.shown.len(), faults.more), (MAX_SHOWN, count - MAX_SHOWN), "{}", &message[..400]);
            assert!(message.starts_with(&format!("{count} errors in the configuration, showing the first 50:\n")));
            assert!(message.ends_with(&format!("\n  and {} more", count - 50)));
        }
        let lines: Vec<usize> = faults.shown.iter().map(|fault| line(&fault.origin)).collect();
        assert!(lines.is_sorted(), "{lines:?}");
    }
    let faults = Settings::read(Some(("g.toml", &unknown)), &["also=1".to_owned()]).unwrap_err();
    assert_eq!(faults.more, 79_951, "--set is counted too");
    let first = "g.toml:1: k0.x = 1: no such key; the sections are ";
    assert!(faults.shown[0].to_string().starts_with(first), "{}", faults.shown[0]);
    let sets: Vec<String> = (0..20_000).map(|n| format!("smooth.cutof{n}=1")).collect();
    assert_eq!(Settings::read(None, &sets).unwrap_err().more, 19_950);
}

fn line(origin: &Origin) -> usize {
    match origin {
        Origin::File { line, .. } => *line,
        Origin::Set => usize::MAX,
    }
}

#[test]
fn broken_toml_is_named_with_its_line() {
    let message = read("[crop]\nzoom = = 3\n[smooth]\ncutoff_hz = 99\n").unwrap_err();
    assert!(message.contains("gimbald.toml:2: not valid TOML"), "{message}");
    assert!(message.contains("gimbald.toml:4: smooth.cutoff_hz = 99"), "what can still be read is judged too: {message}");
    assert!(read("crop = 3").unwrap_err().contains("crop is a section"));
    assert!(read("[crop]\nzoom = 1.2\nzoom = 1.3\n").unwrap_err().contains("gimbald.toml:3"), "a key twice");
}

#[test]
fn values_of_the_command_line_may_be_words_numbers_or_quoted() {
    assert_eq!(set(&["output.device=7"]).unwrap().output.device, "7");
    assert_eq!(set(&["output.device=\"My Cam\""]).unwrap().output.device, "My Cam");
    assert_eq!(set(&["output.device=My Cam"]).unwrap().output.device, "My Cam");
    assert_eq!(set(&[" crop.zoom = 1 "]).unwrap().pipeline.crop.zoom, 1.0);
    for wrong in [
        "output.device=",
        "crop.zoom=",
        "=1",
        "crop.zoom=wide",
        "crop.zoom=1\nb=2",
        "fit.seed=-1",
        "fit.seed=99999999999999999999",
    ] {
        assert!(set(&[wrong]).is_err(), "{wrong:?}");
    }
}

#[test]
fn strength_is_a_word_or_a_number() {
    let strength = |text: &str| set(&[text]).map(|settings| settings.pipeline.smooth.strength);
    for (text, number) in
        [("follow", 0.3), ("gentle", 0.6), ("steady", 1.0), ("\"tripod\"", 2.0), ("0", 0.0), ("0.45", 0.45), ("1.5", 1.5)]
    {
        assert_eq!(strength(&format!("smooth.strength={text}")).unwrap(), number, "{text}");
    }
    assert_eq!(read("[smooth]\nstrength = \"tripod\"\n").unwrap().pipeline.smooth.strength, 2.0);
    let key = keys::find("smooth.strength").unwrap();
    let shown = |text: &str| key.value_text(&set(&[text]).unwrap());
    assert_eq!([shown("smooth.strength=1"), shown("smooth.strength=0.5")], ["\"steady\"", "0.5"]);
    for wrong in ["smooth.strength=2.1", "smooth.strength=-0.1", "smooth.strength=Tripod", "smooth.strength=strong"] {
        let message = strength(wrong).unwrap_err();
        let told = ["0 to 2", "\"follow\" (0.3)", "\"gentle\" (0.6)", "\"steady\" (1)", "\"tripod\" (2)"];
        assert!(told.iter().all(|word| message.contains(word)), "{wrong}: {message}");
    }
}

/// A key's name or something like it.
fn names() -> impl Strategy<Value = String> {
    prop_oneof![
        (0..keys::KEYS.len()).prop_map(|index| keys::KEYS[index].name.to_owned()),
        "[a-z_]{1,12}(\\.[a-z_]{1,12}){0,3}",
        any::<String>(),
    ]
}

/// A TOML value or something like it.
fn values() -> impl Strategy<Value = String> {
    prop_oneof![
        any::<f64>().prop_map(|number| number.to_string()),
        any::<i64>().prop_map(|number| number.to_string()),
        any::<String>().prop_map(|text| format!("{text:?}")),
        "[0-9eE+._xa-f-]{0,12}",
        any::<String>(),
        Just("[[[{a = 1}]]]".to_owned()),
    ]
}

#[test]
fn a_retired_key_is_noted_and_takes_nothing_else_along() {
    let text = "[metrics]\nlisten = \"127.0.0.1:9464\"\n[crop]\nzoom = 1.2\n";
    let settings = Settings::read(Some(("g.toml", text)), &[]).unwrap();
    assert_eq!(settings.pipeline.crop.zoom, 1.2);
    let [retired] = settings.retired.as_slice() else { panic!("{:?}", settings.retired) };
    let said = retired.to_string();
    for part in ["g.toml:2: metrics.listen = \"127.0.0.1:9464\"", "no effect", "gimbald status --prometheus"] {
        assert!(said.contains(part), "{part} in {said}");
    }
    let settings = Settings::read(None, &["metrics.listen=[::1]:9464".to_owned()]).unwrap();
    assert!(settings.retired[0].to_string().starts_with("--set: metrics.listen"), "{settings:?}");
    // as every file has it that began as the shipped one
    let settings = Settings::read(Some(("g.toml", "[metrics]\nlisten = \"off\"\n")), &[]).unwrap();
    assert_eq!(settings, Settings::default());
    // no other key of that section ever was one
    assert!(Settings::read(Some(("g.toml", "[metrics]\nport = 1\n")), &[]).is_err());
}

proptest! {
    #[test]
    fn random_bytes_are_settings_or_faults(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
        let text = String::from_utf8_lossy(&bytes);
        if let Err(faults) = Settings::read(Some(("f", &text)), &[text.to_string()]) {
            prop_assert!(!faults.shown.is_empty() && !faults.to_string().is_empty());
        }
    }

    #[test]
    fn random_keys_and_values_are_settings_within_range_or_faults(
        pairs in proptest::collection::vec((names(), values()), 0..6),
    ) {
        let text: String = pairs.iter().map(|(name, value)| format!("{name} = {value}\n")).collect();
        let sets: Vec<String> = pairs.iter().map(|(name, value)| format!("{name}={value}")).collect();
        for settings in [Settings::read(Some(("f", &text)), &[]), Settings::read(None, &sets)].into_iter().flatten() {
            for key in keys::KEYS {
                match key.kind {
                    Kind::Number { range, get, .. } | Kind::NamedNumber { range, get, .. } => prop_assert!((range.0..=range.1).contains(&get(&settings))),
                    Kind::NumberOrAuto { range, get, .. } => {
                        prop_assert!(get(&settings).is_none_or(|number| (range.0..=range.1).contains(&number)))
                    }
                    Kind::Count { range, get, .. } => prop_assert!((range.0..=range.1).contains(&get(&settings))),
                    Kind::Choice { words, get, .. } => prop_assert!(words.contains(&get(&settings))),
                    Kind::Switch { .. } | Kind::SwitchOrAuto { .. } => {}
                    Kind::Text { get, .. } => prop_assert!(!get(&settings).is_empty()),
                    Kind::Form { fits, get, .. } => prop_assert!(fits(get(&settings))),
                }
            }
        }
    }

    #[test]
    fn what_a_key_shows_it_reads_again(index in 0..keys::KEYS.len(), number in 0.0f64..1.0, count in any::<u64>()) {
        let key = &keys::KEYS[index];
        let mut settings = Settings::default();
        match key.kind {
            Kind::Number { range: (low, high), set, .. } => set(&mut settings, low + (high - low) * number),
            Kind::NumberOrAuto { range: (low, high), set, .. } => {
                set(&mut settings, (count % 3 != 0).then_some(low + (high - low) * number));
            }
            Kind::NamedNumber { range: (low, high), names, set, .. } => {
                let named = names[(count % names.len() as u64) as usize].1;
                set(&mut settings, if count % 2 == 0 { named } else { low + (high - low) * number });
            }
            Kind::Count { range: (low, high), step, set, .. } => {
                set(&mut settings, low + count % ((high - low) / step + 1) * step);
            }
            Kind::Choice { words, set, .. } => set(&mut settings, words[(count % words.len() as u64) as usize]),
            Kind::Switch { set, .. } => set(&mut settings, count % 2 == 1),
            Kind::SwitchOrAuto { set, .. } => set(&mut settings, (count % 3 != 0).then_some(count % 3 == 1)),
            Kind::Form { .. } => {}
            Kind::Text { set, .. } => set(&mut settings, format!("\"{count}'\n\t\\{number}")),
        }
        let file = format!("[{}]\n{} = {}\n", key.section(), key.short_name(), key.value_text(&settings));
        prop_assert_eq!(Settings::read(Some(("f", &file)), &[]).unwrap(), settings.clone());
        prop_assert_eq!(settings.differing(&Settings::default()).count(), usize::from(settings != Settings::default()));
    }
}
