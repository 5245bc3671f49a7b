//! The fuzz targets: one program, so that one build serves all. The environment variable `GIMBALD_FUZZ` names the target; the rest is
//! libFuzzer's. `fuzz/run` builds and starts it.

#![no_main]

#[path = "../../src/kernel/tests/fenced.rs"]
mod fenced;
mod kernels;
mod picture;
mod pipeline;
mod planted;
mod stream;
mod text;

use libfuzzer_sys::fuzz_target;
use std::sync::OnceLock;

/// Takes any bytes; panics, or does what AddressSanitizer or a forbidden page notices, where gimbald is wrong.
type Target = fn(&[u8]);

const TARGETS: &[(&str, Target)] = &[
    ("gbr", stream::recording),
    ("gbr-mended", stream::mended_recording),
    ("y4m", stream::y4m),
    ("jpeg", picture::jpeg),
    ("raw", picture::raw),
    ("toml", text::configuration),
    ("set", text::assignments),
    ("request", text::request),
    ("state", text::state),
    ("kernels", kernels::kernels),
    ("pipeline", pipeline::pipeline),
    ("planted", planted::over_read),
];

fn target() -> Target {
    static TARGET: OnceLock<Target> = OnceLock::new();
    *TARGET.get_or_init(|| {
        let name = std::env::var("GIMBALD_FUZZ").unwrap_or_default();
        let found = TARGETS.iter().find(|(other, _)| *other == name);
        found.unwrap_or_else(|| panic!("GIMBALD_FUZZ={name:?} is no target; there are {:?}", TARGETS.iter().map(|t| t.0))).1
    })
}

fuzz_target!(|data: &[u8]| target()(data));
