//! The table of every configuration key.

use super::{Control, Key, Kind, Level};
use crate::image::{MAX_SIDE, PixelFormat};
use crate::stage::crop::{self, Border};
use crate::stage::paper::homography::Form;
use crate::stage::shutter::{Model, Parameters, Prior};
use crate::stage::smooth::{self, Mode};
use crate::stage::warp::Filter;

/// A real number: `number!(path.to.field, least to most)`.
macro_rules! number {
    ($($field:ident).+, $low:literal to $high:literal) => {
        Kind::Number { range: ($low, $high), get: |s| s.$($field).+, set: |s, value| s.$($field).+ = value }
    };
}

/// A constant of the camera, or "auto" where it is to be estimated: `known!(path.to.field, least to most)`.
macro_rules! known {
    ($($field:ident).+, $low:literal to $high:literal) => {
        Kind::NumberOrAuto {
            range: ($low, $high),
            get: |s| match s.$($field).+ {
                Prior::Fixed(value) => Some(value),
                Prior::Unknown | Prior::Gaussian(..) => None,
            },
            set: |s, value| s.$($field).+ = value.map_or(Prior::Unknown, Prior::Fixed),
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
        doc: "The camera: a path (a link in /dev/v4l/by-id always names the same camera), a number, or part of its name. \"auto\" uses the first camera found.",
        live: false,
        kind: text!(camera.device),
    },
    Key {
        name: "camera.format",
        unit: "",
        doc: "Pixel format to request from the camera. \"auto\" picks the cheapest one to decode at the requested size and rate, and falls back to the next if its frames are unusable.",
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
        doc: "Width to request from the camera. 0 picks the best it offers.",
        live: false,
        kind: count!(camera.width: u32, 0 to MAX_SIDE as u64),
    },
    Key {
        name: "camera.height",
        unit: "pixels",
        doc: "Height to request from the camera. 0 picks the best it offers.",
        live: false,
        kind: count!(camera.height: u32, 0 to MAX_SIDE as u64),
    },
    Key {
        name: "camera.fps",
        unit: "frames per second",
        doc: "Frame rate to request from the camera. 0 picks the best it offers.",
        live: false,
        kind: number!(camera.fps, 0.0 to 240.0),
    },
    Key {
        name: "camera.readout_ms",
        unit: "ms",
        doc: "Sensor readout time: from the exposure of the first row to that of the last. Negative if the sensor is read from bottom to top. \"auto\" estimates it.",
        live: false,
        kind: known!(pipeline.camera.readout_ms, -100.0 to 100.0),
    },
    Key {
        name: "camera.hfov_deg",
        unit: "degrees",
        doc: "Horizontal field of view, by the focal length. \"auto\" estimates it; a given value is refined as long as camera.lens_k1 is \"auto\".",
        live: false,
        kind: known!(pipeline.camera.hfov_deg, 10.0 to 170.0),
    },
    Key {
        name: "camera.lens_k1",
        unit: "",
        doc: "Radial distortion of the lens: negative for barrel distortion, 0 for none (division model, radius in half picture widths). The output keeps the look of the lens. \"auto\" estimates it.",
        live: false,
        kind: known!(pipeline.camera.lens_k1, -0.35 to 0.35),
    },
    Key {
        name: "track.points",
        unit: "count",
        doc: "Number of points to track, spread over the picture.",
        live: false,
        kind: count!(pipeline.detect.points: u32, 50 to 2000),
    },
    Key {
        name: "track.min_contrast",
        unit: "grey levels per pixel",
        doc: "Minimum contrast of a corner: the root mean square gradient along its weaker direction.",
        live: true,
        kind: number!(pipeline.detect.min_contrast, 0.5 to 50.0),
    },
    Key {
        name: "track.window",
        unit: "pixels",
        doc: "Side of the square window that is matched around each point.",
        live: false,
        kind: count!(pipeline.track.window: u32, 8 to 24, by 8),
    },
    Key {
        name: "track.max_round_trip_px",
        unit: "pixels",
        doc: "Maximum forward-backward error: how far a point may land from where it started when it is tracked to the next frame and back. Points with a larger error are dropped.",
        live: true,
        kind: number!(pipeline.track.max_round_trip_px, 0.05 to 5.0),
    },
    Key {
        name: "fit.form",
        unit: "",
        doc: "For cho2007: the homography has the six parameters of a camera without roll (\"constrained\"), or all eight (\"general\").",
        live: true,
        kind: choice!(pipeline.fit.form, "constrained" => Form::Constrained, "general" => Form::General),
    },
    Key {
        name: "fit.threshold_px",
        unit: "pixels",
        doc: "For cho2007: maximum distance of an inlier from the fitted homography.",
        live: true,
        kind: number!(pipeline.fit.threshold_px, 0.2 to 10.0),
    },
    Key {
        name: "fit.seed",
        unit: "",
        doc: "Seed for random sampling. The same input, settings and seed give the same output, byte for byte.",
        live: false,
        kind: count!(pipeline.fit.seed: u64, 0 to i64::MAX as u64),
    },
    Key {
        name: "shutter.model",
        unit: "",
        doc: "Rolling-shutter model: \"continuous\" (a camera pose for each row) or \"cho2007\" (zoom and shift, constant within a frame).",
        live: false,
        kind: choice!(pipeline.shutter.model, "cho2007" => Model::Cho2007, "continuous" => Model::Continuous),
    },
    Key {
        name: "shutter.parameters",
        unit: "",
        doc: "For cho2007: \"time-t\" uses the next frame (steadier, one frame of latency), \"time-t+1\" the previous one (no latency).",
        live: false,
        kind: choice!(pipeline.shutter.parameters, "time-t" => Parameters::TimeT, "time-t+1" => Parameters::TimeT1),
    },
    Key {
        name: "stabilize.enabled",
        unit: "",
        doc: "Enable stabilization. If false, the camera's picture is only cropped.",
        live: true,
        kind: switch!(pipeline.enabled),
    },
    Key {
        name: "smooth.mode",
        unit: "",
        doc: "How the virtual camera moves: \"adaptive\" is as steady as the crop allows, \"iir\" is a fixed low-pass filter.",
        live: true,
        kind: choice!(pipeline.smooth.mode, "adaptive" => Mode::Adaptive, "iir" => Mode::Iir),
    },
    Key {
        name: "smooth.strength",
        unit: "ratio",
        doc: "Strength of the stabilization: \"follow\" and \"gentle\" stay closer to the camera, \"steady\" uses the whole crop margin, \"tripod\" also holds one view for as long as the margin lasts (adaptive). 0 follows the camera exactly.",
        live: true,
        kind: Kind::NamedNumber {
            range: (0.0, smooth::TRIPOD),
            names: &[("follow", 0.3), ("gentle", 0.6), ("steady", 1.0), ("tripod", smooth::TRIPOD)],
            get: |s| s.pipeline.smooth.strength,
            set: |s, value| s.pipeline.smooth.strength = value,
        },
    },
    Key {
        name: "smooth.lookahead_ms",
        unit: "ms",
        doc: "For adaptive: how far to look ahead. The picture is delayed by this much and is steadier. 0 adds no latency.",
        live: false,
        kind: number!(pipeline.smooth.lookahead_ms, 0.0 to 500.0),
    },
    Key {
        name: "smooth.cutoff_hz",
        unit: "Hz",
        doc: "For iir: cutoff frequency. Slower camera motion is followed, faster motion is removed.",
        live: true,
        kind: number!(pipeline.smooth.cutoff_hz, 0.05 to 10.0),
    },
    Key {
        name: "crop.zoom",
        unit: "ratio",
        doc: "Magnification that hides the moving border: 1.1 enlarges the picture by a tenth. \"auto\" slowly adapts it to the shake, down to 1.02 at rest: the first movement after a minute of rest is then held less.",
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
        doc: "Maximum magnification with zoom = \"auto\". With border = \"mirror\" or \"black\": how much of the border may show.",
        live: true,
        kind: number!(pipeline.crop.max_zoom, 1.0 to 2.0),
    },
    Key {
        name: "crop.border",
        unit: "",
        doc: "What to do at the picture's edge: \"zoom\" never shows it. \"mirror\" and \"black\" fill it in and allow larger corrections, up to what max_zoom would hide.",
        live: true,
        kind: choice!(pipeline.crop.border, "zoom" => Border::Zoom, "mirror" => Border::Mirror, "black" => Border::Black),
    },
    Key {
        name: "warp.filter",
        unit: "",
        doc: "Interpolation: \"bicubic\" is sharper, \"bilinear\" is cheaper. \"auto\" uses bicubic for output of up to half a megapixel.",
        live: true,
        kind: choice!(pipeline.warp.filter, "auto" => None, "bicubic" => Some(Filter::Bicubic), "bilinear" => Some(Filter::Bilinear)),
    },
    Key {
        name: "warp.straighten",
        unit: "",
        doc: "Draw lines straight that the lens bends (camera.lens_k1; continuous model). The picture loses some of its sides. Off, the picture keeps the look of the lens.",
        live: true,
        kind: switch!(pipeline.straighten),
    },
    Key {
        name: "output.device",
        unit: "",
        doc: "The v4l2loopback device: a path, a number, or its label. \"auto\" uses the first one that is free.",
        live: false,
        kind: text!(output.device),
    },
    Key {
        name: "output.format",
        unit: "",
        doc: "Pixel format of the virtual camera.",
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
        doc: "Create the loopback device if it does not exist. Requires v4l2loopback 0.13 or newer and access to /dev/v4l2loopback.",
        live: false,
        kind: switch!(output.create),
    },
    Key {
        name: "output.pipewire",
        unit: "",
        doc: "Offer the picture as a PipeWire camera through `gimbald pipewire`, which runs in a user's session. \"auto\": wait for the loopback or a companion, whichever comes first; true: do not wait for a loopback; false: refuse companions.",
        live: false,
        kind: switch_or_auto!(output.pipewire),
    },
    Key {
        name: "output.on_demand",
        unit: "",
        doc: "Open the camera (and turn on its light) only while a program uses the virtual camera. If false, it stays open.",
        live: false,
        kind: switch!(output.on_demand),
    },
    Key {
        name: "output.linger_s",
        unit: "s",
        doc: "With on_demand: how long the camera stays open after the last viewer has left.",
        live: false,
        kind: number!(output.linger_s, 0.0 to 3600.0),
    },
    Key {
        name: "log.level",
        unit: "",
        doc: "Minimum severity of log messages.",
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
        doc: "Unix socket for `gimbald status`, `on`, `off`, `set` and `reload`. \"auto\" is control.sock in the runtime directory.",
        live: false,
        kind: form!(control.socket, "\"auto\", \"off\" or an absolute path", Control::is_place),
    },
    Key {
        name: "control.mode",
        unit: "",
        doc: "Permissions of the socket: \"0660\" for its owner and group, \"0600\" for its owner, \"0666\" for everyone.",
        live: false,
        kind: form!(control.mode, "permissions in octal digits, as \"0660\"", Control::is_mode),
    },
    Key {
        name: "control.group",
        unit: "",
        doc: "Group of the socket, by name or number. \"own\" is the group that the daemon runs with (video, as shipped).",
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
    advice: "remove it; gimbald status --prometheus gives the same metrics, and docs/service.md, under Metrics, describes how Prometheus collects them",
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
