//! The table of every configuration key.

use super::{Control, Key, Kind, Level};
use crate::image::PixelFormat;
use crate::stage::crop::{self, Border};
use crate::stage::fit::Form;
use crate::stage::shutter::{Known, Model, Parameters};
use crate::stage::smooth::Mode;
use crate::stage::warp::Filter;

/// A real number: `number!(path.to.field, least to most)`.
macro_rules! number {
    ($($field:ident).+, $low:literal to $high:literal) => {
        Kind::Number { range: ($low, $high), get: |s| s.$($field).+, set: |s, value| s.$($field).+ = value }
    };
}

/// A constant of the camera, or "auto" where it is to be found out: `known!(path.to.field, least to most)`.
macro_rules! known {
    ($($field:ident).+, $low:literal to $high:literal) => {
        Kind::NumberOrAuto {
            range: ($low, $high),
            get: |s| match s.$($field).+ {
                Known::Exactly(value) => Some(value),
                Known::Nothing | Known::About(..) => None,
            },
            set: |s, value| s.$($field).+ = value.map_or(Known::Nothing, Known::Exactly),
        }
    };
}

/// A whole number, its range within the field's type: `count!(path.to.field: type, least to most, by step)`.
macro_rules! count {
    ($($field:ident).+ : $type:ty, $low:literal to $high:expr) => { count!($($field).+ : $type, $low to $high, by 1) };
    ($($field:ident).+ : $type:ty, $low:literal to $high:expr, by $step:literal) => {
        Kind::Count {
            range: ($low, $high),
            step: $step,
            get: |s| s.$($field).+ as u64,
            set: |s, value| s.$($field).+ = value as $type,
        }
    };
}

/// One word of a few: `choice!(path.to.field, "word" => value, ...)`.
macro_rules! choice {
    ($($field:ident).+, $($word:literal => $value:expr),+ $(,)?) => {
        Kind::Choice {
            words: &[$($word),+],
            get: |s| {
                let value = s.$($field).+;
                $(if value == $value { return $word; })+
                // Reached only where a field's type has more values than words are written here; a test visits them all.
                ""
            },
            set: |s, word| {
                let field = &mut s.$($field).+;
                $(if word == $word { *field = $value; })+
            },
        }
    };
}

/// true or false: `switch!(path.to.field)`.
macro_rules! switch {
    ($($field:ident).+) => { Kind::Switch { get: |s| s.$($field).+, set: |s, value| s.$($field).+ = value } };
}

/// true, false or "auto" (`None`): `switch_or_auto!(path.to.field)`.
macro_rules! switch_or_auto {
    ($($field:ident).+) => { Kind::SwitchOrAuto { get: |s| s.$($field).+, set: |s, value| s.$($field).+ = value } };
}

/// Free text.
macro_rules! text {
    ($($field:ident).+) => { Kind::Text { get: |s| &s.$($field).+, set: |s, value| s.$($field).+ = value } };
}

/// Text of a certain form: `form!(path.to.field, "what it is", the test)`.
macro_rules! form {
    ($($field:ident).+, $expected:literal, $fits:expr) => {
        Kind::Form {
            expected: $expected,
            fits: $fits,
            get: |s| &s.$($field).+,
            set: |s, value| s.$($field).+ = value,
        }
    };
}

/// Every key, section by section, in the order in which the shipped file has them.
pub const KEYS: &[Key] = &[
    Key {
        name: "camera.device",
        unit: "",
        doc: "The camera: a path (/dev/v4l/by-id/... is always the same camera), a number, or a part of its name; \"auto\" takes the first camera found.",
        live: false,
        kind: text!(camera.device),
    },
    Key {
        name: "camera.format",
        unit: "",
        doc: "Pixel format asked of the camera; \"auto\" takes the cheapest to read at the wanted size and rate, and the next where its frames are unusable.",
        live: false,
        kind: choice!(camera.format,
            "auto" => None,
            "yuyv" => Some(PixelFormat::Yuyv),
            "uyvy" => Some(PixelFormat::Uyvy),
            "nv12" => Some(PixelFormat::Nv12),
            "i420" => Some(PixelFormat::I420),
            "i422" => Some(PixelFormat::I422),
            "i444" => Some(PixelFormat::I444),
            "grey" => Some(PixelFormat::Grey),
            "rgb24" => Some(PixelFormat::Rgb24),
            "bgr24" => Some(PixelFormat::Bgr24),
            "mjpeg" => Some(PixelFormat::Mjpeg),
        ),
    },
    Key {
        name: "camera.width",
        unit: "pixels",
        doc: "Width asked of the camera; 0 takes the camera's best.",
        live: false,
        kind: count!(camera.width: u32, 0 to 8192),
    },
    Key {
        name: "camera.height",
        unit: "pixels",
        doc: "Height asked of the camera; 0 takes the camera's best.",
        live: false,
        kind: count!(camera.height: u32, 0 to 8192),
    },
    Key {
        name: "camera.fps",
        unit: "frames a second",
        doc: "Frame rate asked of the camera; 0 takes the camera's best.",
        live: false,
        kind: number!(camera.fps, 0.0 to 240.0),
    },
    Key {
        name: "camera.readout_ms",
        unit: "ms",
        doc: "Time from the exposure of the first row to that of the last, negative from bottom to top; \"auto\" finds it out.",
        live: false,
        kind: known!(pipeline.camera.readout_ms, -100.0 to 100.0),
    },
    Key {
        name: "camera.hfov_deg",
        unit: "degrees",
        doc: "Horizontal field of view; \"auto\" finds it out.",
        live: false,
        kind: known!(pipeline.camera.hfov_deg, 10.0 to 170.0),
    },
    Key {
        name: "track.points",
        unit: "count",
        doc: "Points followed at a time, spread over the picture.",
        live: false,
        kind: count!(pipeline.detect.points: u32, 50 to 2000),
    },
    Key {
        name: "track.min_contrast",
        unit: "grey levels a pixel",
        doc: "Least contrast of a corner: the root mean square slope across its weaker direction.",
        live: true,
        kind: number!(pipeline.detect.min_contrast, 0.5 to 50.0),
    },
    Key {
        name: "track.window",
        unit: "pixels",
        doc: "Side of the square window that is compared around a point.",
        live: false,
        kind: count!(pipeline.track.window: u32, 8 to 24, by 8),
    },
    Key {
        name: "track.max_round_trip_px",
        unit: "pixels",
        doc: "Largest distance between a point and where it lands when followed forth and back; farther ones are dropped.",
        live: true,
        kind: number!(pipeline.track.max_round_trip_px, 0.05 to 5.0),
    },
    Key {
        name: "fit.form",
        unit: "",
        doc: "Entries of the homography that are free: the six that a camera without roll has, or all eight.",
        live: true,
        kind: choice!(pipeline.fit.form, "constrained" => Form::Constrained, "general" => Form::General),
    },
    Key {
        name: "fit.threshold_px",
        unit: "pixels",
        doc: "Distance at which a track stops being an inlier.",
        live: true,
        kind: number!(pipeline.fit.threshold_px, 0.2 to 10.0),
    },
    Key {
        name: "fit.seed",
        unit: "",
        doc: "Seed of the random choice of hypotheses; the same input and seed give the same bytes.",
        live: false,
        kind: count!(pipeline.fit.seed: u64, 0 to i64::MAX as u64),
    },
    Key {
        name: "shutter.model",
        unit: "",
        doc: "Motion inside a frame: \"cho2007\" (zoom and shift, constant in a frame) or \"continuous\" (a pose for each row).",
        live: false,
        kind: choice!(pipeline.shutter.model, "cho2007" => Model::Cho2007, "continuous" => Model::Continuous),
    },
    Key {
        name: "shutter.parameters",
        unit: "",
        doc: "cho2007: \"time-t\" looks at the next frame (one frame late, steadier), \"time-t+1\" at the one before (no latency).",
        live: false,
        kind: choice!(pipeline.shutter.parameters, "time-t" => Parameters::TimeT, "time-t+1" => Parameters::TimeT1),
    },
    Key {
        name: "stabilize.enabled",
        unit: "",
        doc: "Whether shake is taken out; false shows the camera's picture with nothing but the crop.",
        live: true,
        kind: switch!(pipeline.enabled),
    },
    Key {
        name: "smooth.mode",
        unit: "",
        doc: "Path of the virtual camera: \"adaptive\" is as steady as the crop allows, \"iir\" is a fixed low-pass.",
        live: true,
        kind: choice!(pipeline.smooth.mode, "adaptive" => Mode::Adaptive, "iir" => Mode::Iir),
    },
    Key {
        name: "smooth.strength",
        unit: "ratio",
        doc: "How steady: 1 uses all of the crop to stand still, less follows the camera more closely, 0 follows it at once.",
        live: true,
        kind: number!(pipeline.smooth.strength, 0.0 to 1.0),
    },
    Key {
        name: "smooth.lookahead_ms",
        unit: "ms",
        doc: "adaptive: how late the picture may be so that the path is planned with what comes; 0 adds no latency, 500 is much steadier.",
        live: false,
        kind: number!(pipeline.smooth.lookahead_ms, 0.0 to 500.0),
    },
    Key {
        name: "smooth.cutoff_hz",
        unit: "Hz",
        doc: "iir: camera motion slower than this is followed, faster is taken out.",
        live: true,
        kind: number!(pipeline.smooth.cutoff_hz, 0.05 to 10.0),
    },
    Key {
        name: "crop.zoom",
        unit: "ratio",
        doc: "Magnification that hides the moving border; 1.1 shows the picture a tenth larger. \"auto\" is as much as the shake needs, slowly.",
        live: true,
        kind: Kind::NumberOrAuto {
            range: (1.0, 2.0),
            get: |s| (!s.pipeline.crop.auto).then_some(s.pipeline.crop.zoom),
            set: |s, value| {
                let crop = &mut s.pipeline.crop;
                (crop.auto, crop.zoom) = (value.is_none(), value.unwrap_or(crop::Params::default().zoom));
            },
        },
    },
    Key {
        name: "crop.max_zoom",
        unit: "ratio",
        doc: "zoom \"auto\": most magnification that shake is given. border \"mirror\", \"black\": how far it may show.",
        live: true,
        kind: number!(pipeline.crop.max_zoom, 1.0 to 2.0),
    },
    Key {
        name: "crop.border",
        unit: "",
        doc: "Beyond the picture's edge: \"zoom\" never shows it; \"mirror\" and \"black\" do, and leave more room: as much as max_zoom hides.",
        live: true,
        kind: choice!(pipeline.crop.border, "zoom" => Border::Zoom, "mirror" => Border::Mirror, "black" => Border::Black),
    },
    Key {
        name: "warp.filter",
        unit: "",
        doc: "Between pixels: \"bicubic\" is sharper, \"bilinear\" is cheaper; \"auto\" is bicubic up to half a megapixel.",
        live: true,
        kind: choice!(pipeline.warp.filter, "auto" => None, "bicubic" => Some(Filter::Bicubic), "bilinear" => Some(Filter::Bilinear)),
    },
    Key {
        name: "output.device",
        unit: "",
        doc: "The v4l2loopback device: a path, a number, or its label; \"auto\" takes the first one that is free.",
        live: false,
        kind: text!(output.device),
    },
    Key {
        name: "output.format",
        unit: "",
        doc: "Pixel format that applications get.",
        live: false,
        kind: choice!(output.format,
            "yuyv" => PixelFormat::Yuyv,
            "i420" => PixelFormat::I420,
            "nv12" => PixelFormat::Nv12,
        ),
    },
    Key {
        name: "output.create",
        unit: "",
        doc: "Whether to make the device where none answers; needs v4l2loopback 0.13 loaded and the right to /dev/v4l2loopback.",
        live: false,
        kind: switch!(output.create),
    },
    Key {
        name: "output.pipewire",
        unit: "",
        doc: "The picture as a PipeWire camera, offered by gimbald pipewire in a user's session: \"auto\" when that connects; true also starts without a loopback before it does; false never.",
        live: false,
        kind: switch_or_auto!(output.pipewire),
    },
    Key {
        name: "output.on_demand",
        unit: "",
        doc: "Whether the camera is open, and its light on, only while a program watches; false keeps it running.",
        live: false,
        kind: switch!(output.on_demand),
    },
    Key {
        name: "output.linger_s",
        unit: "s",
        doc: "On demand: how long the camera stays open when nobody watches any more.",
        live: false,
        kind: number!(output.linger_s, 0.0 to 3600.0),
    },
    Key {
        name: "log.level",
        unit: "",
        doc: "Least important messages that are still written.",
        live: true,
        kind: choice!(log.level,
            "error" => Level::Error,
            "warn" => Level::Warn,
            "info" => Level::Info,
            "debug" => Level::Debug,
            "trace" => Level::Trace,
        ),
    },
    Key {
        name: "control.socket",
        unit: "",
        doc: "Unix socket for gimbald status, on, off, set, reload; \"auto\" is control.sock in the runtime directory.",
        live: false,
        kind: form!(control.socket, "\"auto\", \"off\" or an absolute path", Control::is_place),
    },
    Key {
        name: "control.mode",
        unit: "",
        doc: "Who may use the socket, as permissions: \"0660\" its owner and group, \"0600\" its owner, \"0666\" everybody.",
        live: false,
        kind: form!(control.mode, "permissions in octal digits, as \"0660\"", Control::is_mode),
    },
    Key {
        name: "control.group",
        unit: "",
        doc: "Group of the socket, by name or number; \"own\" is the daemon's (as shipped, video).",
        live: false,
        kind: text!(control.group),
    },
];

/// A key of earlier versions that has no effect any more. Files that have it are read all the same.
#[derive(Clone, Copy, Debug)]
pub struct Retired {
    /// Section and name.
    pub name: &'static str,
    /// The value, as TOML text, with which it had no effect in earlier versions either.
    pub harmless: &'static str,
    /// What to do in its place.
    pub advice: &'static str,
}

/// Every such key.
pub const RETIRED: &[Retired] = &[Retired {
    name: "metrics.listen",
    harmless: "off",
    advice: "remove it; gimbald status --prometheus gives the same metrics, and the README, under Metrics, says how Prometheus gets them",
}];

/// The retired key of that name.
pub fn retired(name: &str) -> Option<&'static Retired> {
    RETIRED.iter().find(|key| key.name == name)
}

/// The key of that name.
pub fn find(name: &str) -> Option<&'static Key> {
    KEYS.iter().find(|key| key.name == name)
}

/// The key whose name is most like `name`, where one is like it at all: a slip of a few letters, or the right name in the
/// wrong section.
pub fn nearest(name: &str) -> Option<&'static Key> {
    let short = name.rsplit('.').next().unwrap_or(name);
    let same_short = || KEYS.iter().find(|key| key.short_name() == short && name != key.name);
    // A name many times longer than any key is no slip; it is also the one thing here whose cost the input decides.
    if name.len() > 80 {
        return None;
    }
    let (distance, key) =
        KEYS.iter().map(|key| (strsim::levenshtein(name, key.name), key)).min_by_key(|(distance, _)| *distance)?;
    if distance <= key.name.len() / 3 { Some(key) } else { same_short() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Settings;

    #[test]
    fn slips_find_their_key() {
        for (slip, key) in [
            ("smooth.cutof_hz", "smooth.cutoff_hz"),
            ("smooth.cutoff", "smooth.cutoff_hz"),
            ("crop.zooom", "crop.zoom"),
            ("zoom", "crop.zoom"),
            ("camera.readout", "camera.readout_ms"),
            ("fit.window", "track.window"),
        ] {
            assert_eq!(nearest(slip).map(|key| key.name), Some(key), "{slip}");
        }
        assert!(nearest("volume").is_none());
        assert!(nearest(&"x".repeat(100_000)).is_none());
    }

    #[test]
    fn every_word_is_taken_and_shown_again() {
        for key in KEYS {
            if let Kind::Choice { words, get, set } = key.kind {
                for word in words {
                    let mut settings = Settings::default();
                    set(&mut settings, word);
                    assert_eq!(get(&settings), *word, "{}", key.name);
                }
            }
        }
    }

    #[test]
    fn names_are_unique_and_sections_together() {
        let mut seen: Vec<&str> = Vec::new();
        for (index, key) in KEYS.iter().enumerate() {
            assert!(KEYS[..index].iter().all(|other| other.name != key.name), "{} twice", key.name);
            assert!(key.name.matches('.').count() == 1 && key.doc.ends_with('.'), "{}", key.name);
            if seen.last() != Some(&key.section()) {
                assert!(!seen.contains(&key.section()), "section {} is split", key.section());
                seen.push(key.section());
            }
        }
    }
}
