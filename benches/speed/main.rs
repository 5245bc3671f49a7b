//! `cargo bench`: every kernel at every level beside a copy of the same bytes, then whole frames through the pipeline, then live.
//!
//! Words on the command line pick what is measured by name (`cargo bench -- warp frames`). What is printed is also kept, as text and
//! as JSON, in `target/bench/`; the run before is kept as `*.before`, to compare with. Medians; ratios count, machines differ.

mod clip;
mod frames;
mod kernels;
mod paced;

use serde_json::{Map, Value, json};
use std::fs;
use std::path::Path;

/// What was measured so far, for the eye and for programs.
struct Record {
    text: String,
    values: Map<String, Value>,
    wanted: Vec<String>,
    /// Whether to measure, or only to see that everything runs (`cargo test --benches`).
    measuring: bool,
}

impl Record {
    /// Whether something of this name is asked for.
    fn wants(&self, name: &str) -> bool {
        self.wanted.is_empty() || self.wanted.iter().any(|word| name.contains(word.as_str()))
    }

    fn say(&mut self, line: &str) {
        println!("{line}");
        self.text.push_str(line);
        self.text.push('\n');
    }
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let mut record = Record {
        text: String::new(),
        values: Map::new(),
        wanted: arguments.iter().filter(|word| !word.starts_with('-')).cloned().collect(),
        measuring: arguments.iter().any(|word| word == "--bench"),
    };
    kernels::measure(&mut record);
    frames::measure(&mut record);
    paced::measure(&mut record);
    if record.measuring {
        keep("speed.txt", &record.text);
        keep("speed.json", &format!("{:#}\n", json!(record.values)));
    }
}

/// Writes a result to `target/bench/`, the one before it beside it.
fn keep(name: &str, text: &str) {
    let directory = Path::new(env!("CARGO_MANIFEST_DIR")).join("target/bench");
    let file = directory.join(name);
    let kept = fs::create_dir_all(&directory).and_then(|()| {
        if file.exists() {
            fs::rename(&file, directory.join(format!("{name}.before")))?;
        }
        fs::write(&file, text)
    });
    match kept {
        Ok(()) => println!("kept in {}", file.display()),
        Err(error) => println!("could not keep {}: {error}", file.display()),
    }
}
