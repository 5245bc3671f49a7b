//! `gimbald demo --paper`: the paper's claims hold for gimbald, and the page that says so is whole.

use std::process::Command;

/// The cells of the row of the table that begins with `figure`, without markup.
fn row(page: &str, figure: &str) -> Vec<String> {
    let start = page.find(&format!("<tr><td>{figure}</td><td>")).unwrap_or_else(|| panic!("no row {figure}"));
    let row = page[start..].split("</tr>").next().unwrap();
    let content = |cell: &str| cell.split_once('>').unwrap().1.replace("</td>", "").replace("<br>", " ");
    row.split("<td").skip(1).map(content).collect()
}

/// A page's text without the data of its pictures, in which any three letters may follow each other.
fn without_pictures(page: &str) -> String {
    let is_data = |c: char| c.is_ascii_alphanumeric() || "+/=".contains(c);
    page.split(";base64,").map(|part| part.trim_start_matches(is_data)).collect()
}

/// The first number of a cell.
fn number(cell: &str) -> f64 {
    cell.split(['°', ' ', '%']).next().and_then(|word| word.parse().ok()).unwrap_or_else(|| panic!("no number in {cell:?}"))
}

#[test]
fn what_the_paper_says_is_measured_and_shown() {
    let scratch = tempfile::tempdir().unwrap();
    let directory = scratch.path().to_str().unwrap();
    let ended = Command::new(env!("CARGO_BIN_EXE_gimbald")).args(["demo", "--paper", "--dir", directory]).output().unwrap();
    assert!(ended.status.success() && ended.stderr.is_empty(), "{ended:?}");
    assert!(String::from_utf8_lossy(&ended.stdout).contains("paper.html"));
    let page = std::fs::read_to_string(scratch.path().join("paper.html")).unwrap();
    assert!(page.len() < 2_000_000, "{} bytes", page.len());
    assert!(!without_pictures(&page).contains("NaN"), "a number is none");
    // Columns: figure, claim, what is measured, camera, cho2007, continuous, no rolling shutter.
    let values = |figure: &str| {
        row(&page, figure)[3..].iter().filter(|cell| !cell.is_empty()).map(|cell| number(cell)).collect::<Vec<_>>()
    };
    let slant = values("9, 10 (c)");
    assert!(slant[0] > 1.5 && slant[1] < 0.1 * slant[0] && slant[2] < 0.05 * slant[0] && slant[3] < 0.02, "{slant:?}");
    let height = values("9, 10 (d)");
    assert!(height[0] > 2.0 && height[1] < 0.4 * height[0] && height[2] < 0.15 * height[0], "{height:?}");
    for figure in ["10 (b)", "10 (e)"] {
        assert!(values(figure).iter().all(|value| *value < 0.5), "{figure} is not distorted by this motion");
    }
    let stabilized_only = values("11, middle");
    assert!(stabilized_only.iter().all(|value| (value - slant[0]).abs() < 0.1), "slanted as before: {stabilized_only:?}");
    let complete = values("11, bottom");
    assert!(complete[1] < 0.1 * complete[0] && complete[2] < 0.05 * complete[0], "{complete:?}");
    let walk = row(&page, "12").join(" ");
    for word in ["horizontal shift", "vertical shift", "yaw", "pitch"] {
        let share = number(walk.split(word).nth(1).unwrap().trim_start());
        assert!(share < 20.0, "{word}: {share} % of the shake is left");
    }
    // Fig. 7: eq. (7) by hand.
    for corner in ["20, 240", "340, 240", "267, 200", "0, 200"] {
        assert!(page.contains(&format!(">{corner}</text>")), "{corner}");
    }
    assert_eq!(page.matches("<img").count(), 12 + 16, "Figs. 9 and 11");
    assert!(!page.contains("no rectangle is whole"));
    for figure in ["Fig. 7", "Fig. 9", "(b) height", "(c) slant", "(d) height", "(e) slant", "Fig. 11", "Fig. 12", "a: zoom"] {
        assert!(page.contains(figure), "{figure}");
    }
}

#[test]
fn the_paper_s_experiments_have_settings_of_their_own() {
    for options in [["--motion", "walk"], ["--seconds", "2"], ["--set", "crop.zoom=1.2"]] {
        let arguments = [&["demo", "--paper"], &options[..]].concat();
        let ended = Command::new(env!("CARGO_BIN_EXE_gimbald")).args(&arguments).output().unwrap();
        let said = String::from_utf8_lossy(&ended.stderr);
        assert!(ended.status.code() == Some(64) && said.contains("cannot be used with"), "{said}");
    }
}
