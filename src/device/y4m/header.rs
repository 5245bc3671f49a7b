//! The y4m header line, from words to a format and back.

use super::{LARGEST, MAGIC};
use crate::device::StreamFormat;
use crate::image::{Colour, PixelFormat, Range, Siting};
use std::fmt::Write as _;

/// Reads a header line without its newline.
///
/// # Errors
/// A sentence that names the parameter, its value and what was expected.
pub(super) fn parse(line: &[u8]) -> Result<StreamFormat, String> {
    let line = std::str::from_utf8(line).map_err(|_| "its header line is no text".to_string())?;
    let mut words = line.split([' ', '\t', '\r']).filter(|word| !word.is_empty());
    if words.next().map(str::as_bytes) != Some(MAGIC) {
        return Err("it does not begin with YUV4MPEG2".into());
    }
    let (mut width, mut height) = (None, None);
    let mut format = StreamFormat::tight(0, 0, PixelFormat::I420, (1, 25));
    format.aspect = (0, 0);
    for word in words {
        let Some((kind, value)) = word.split_at_checked(1) else {
            return Err(format!("its header has the unknown parameter {word}"));
        };
        match kind {
            "W" => width = Some(size("width W", value)?),
            "H" => height = Some(size("height H", value)?),
            "F" => {
                let (frames, seconds) = ratio("rate F", value)?;
                if frames != 0 && seconds != 0 {
                    format.interval = (seconds, frames);
                }
            }
            "A" => format.aspect = ratio("sample shape A", value)?,
            "I" if matches!(value, "p" | "?") => {}
            "I" => {
                return Err(format!(
                    "it is interlaced (I{value}); gimbald reads progressive video: ffmpeg -i IN -vf bwdif OUT.y4m converts it"
                ));
            }
            "C" => (format.pixel, format.colour.siting) = chroma(value)?,
            // Comments and extensions: what is not known is not needed.
            "X" => match value {
                "COLORRANGE=FULL" => format.colour.range = Range::Full,
                "COLORRANGE=LIMITED" => format.colour.range = Range::Limited,
                _ => {}
            },
            _ => {}
        }
    }
    format.width = width.ok_or("its header names no width (W)")?;
    format.height = height.ok_or("its header names no height (H)")?;
    format.stride = format.pixel.tight_stride(format.width);
    Ok(format)
}

fn size(name: &str, value: &str) -> Result<u32, String> {
    let number = value.parse().ok().filter(|n| (1..=LARGEST).contains(n));
    number.ok_or_else(|| format!("its {name} is {value:?}, expected 1 to {LARGEST}"))
}

fn ratio(name: &str, value: &str) -> Result<(u32, u32), String> {
    let parts = value.split_once(':').and_then(|(a, b)| Some((a.parse().ok()?, b.parse().ok()?)));
    parts.ok_or_else(|| format!("its {name} is {value:?}, expected two whole numbers as 30:1"))
}

fn chroma(value: &str) -> Result<(PixelFormat, Siting), String> {
    Ok(match value {
        "420jpeg" | "420" => (PixelFormat::I420, Siting::Centre),
        "420mpeg2" => (PixelFormat::I420, Siting::Left),
        "420paldv" => (PixelFormat::I420, Siting::TopLeft),
        "422" => (PixelFormat::I422, Siting::Centre),
        "444" => (PixelFormat::I444, Siting::Centre),
        "mono" => (PixelFormat::Grey, Siting::Centre),
        _ => {
            return Err(format!(
                "its chroma is C{value}; gimbald reads 8-bit 420jpeg, 420mpeg2, 420paldv, 422, 444 and mono: \
                 ffmpeg -i IN -pix_fmt yuv420p OUT.y4m converts it"
            ));
        }
    })
}

/// The header line of a stream of planar `format`, newline included.
pub(super) fn line(format: &StreamFormat) -> String {
    let StreamFormat { width, height, interval: (seconds, frames), aspect, colour: Colour { range, siting }, .. } = format;
    let chroma = match (format.pixel, siting) {
        (PixelFormat::Grey, _) => "mono",
        (PixelFormat::I422, _) => "422",
        (PixelFormat::I444, _) => "444",
        (_, Siting::Centre) => "420jpeg",
        (_, Siting::Left) => "420mpeg2",
        (_, Siting::TopLeft) => "420paldv",
    };
    let mut line = format!("YUV4MPEG2 W{width} H{height} F{frames}:{seconds} Ip A{}:{} C{chroma}", aspect.0, aspect.1);
    match range {
        Range::Unknown => {}
        Range::Limited => line += " XCOLORRANGE=LIMITED",
        Range::Full => line += " XCOLORRANGE=FULL",
    }
    let _ = writeln!(line);
    line
}
