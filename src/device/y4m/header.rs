//! The y4m header line, from words to a format and back.

use super::MAGIC;
use crate::device::StreamFormat;
use crate::image::{Colour, MAX_SIDE, PixelFormat, Range, Siting};
use std::fmt::Write as _;

/// What a header line says.
#[derive(Clone, Copy, Debug)]
pub(super) struct Header {
    /// The frames as they are given: those of 4:1:1 become 4:2:2.
    pub(super) format: StreamFormat,
    /// Whether the stream's own chroma is 4:1:1, one sample to four columns.
    pub(super) is_411: bool,
    /// Whether it says how its chroma is laid out; otherwise 4:2:0 is assumed.
    pub(super) names_chroma: bool,
}

/// How a stream's chroma is laid out.
#[derive(Clone, Copy, Debug)]
struct Chroma {
    pixel: PixelFormat,
    siting: Siting,
    is_411: bool,
}

/// Reads a header line without its newline.
///
/// # Errors
/// A sentence that names the parameter, its value and what was expected.
pub(super) fn parse(line: &[u8]) -> Result<Header, String> {
    let line = std::str::from_utf8(line).map_err(|_| "its header line is not text".to_string())?;
    let mut words = line.split([' ', '\t', '\r']).filter(|word| !word.is_empty());
    if words.next().map(str::as_bytes) != Some(MAGIC) {
        return Err("it does not begin with YUV4MPEG2".into());
    }
    let (mut width, mut height) = (None, None);
    // `C` is the standard's word for chroma; `XYSCSS=` is what older mjpegtools and ffmpeg write, and counts where there is no `C`.
    let (mut named, mut extension) = (None, None);
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
            "C" => named = Some(chroma(word, value)?),
            // Comments and extensions: what is not known is not needed.
            "X" => match value.split_once('=') {
                Some(("YSCSS", value)) => extension = Some((word, value)),
                Some(("COLORRANGE", "FULL")) => format.colour.range = Range::Full,
                Some(("COLORRANGE", "LIMITED")) => format.colour.range = Range::Limited,
                _ => {}
            },
            _ => {}
        }
    }
    let named = match (named, extension) {
        (None, Some((word, value))) => Some(chroma(word, value)?),
        (named, _) => named,
    };
    let Chroma { pixel, siting, is_411 } =
        named.unwrap_or(Chroma { pixel: PixelFormat::I420, siting: Siting::Centre, is_411: false });
    (format.pixel, format.colour.siting) = (pixel, siting);
    format.width = width.ok_or("its header has no width (W)")?;
    format.height = height.ok_or("its header has no height (H)")?;
    format.stride = format.pixel.tight_stride(format.width);
    Ok(Header { format, is_411, names_chroma: named.is_some() })
}

fn size(name: &str, value: &str) -> Result<u32, String> {
    let number = value.parse().ok().filter(|n| (1..=MAX_SIDE).contains(n));
    number.ok_or_else(|| format!("its {name} is {value:?}, expected 1 to {MAX_SIDE}"))
}

fn ratio(name: &str, value: &str) -> Result<(u32, u32), String> {
    let parts = value.split_once(':').and_then(|(a, b)| Some((a.parse().ok()?, b.parse().ok()?)));
    parts.ok_or_else(|| format!("its {name} is {value:?}, expected two whole numbers as 30:1"))
}

/// The chroma that `value` names in the parameter `word`, `C` or `XYSCSS=`. Beyond the family only the depth and the siting count, in
/// either case, as in ffmpeg: the place of a 4:2:2 or 4:4:4 sample is not told apart.
fn chroma(word: &str, value: &str) -> Result<Chroma, String> {
    let value = value.to_ascii_lowercase();
    let families = [
        ("420", PixelFormat::I420),
        ("422", PixelFormat::I422),
        ("444", PixelFormat::I444),
        ("411", PixelFormat::I422),
        ("mono", PixelFormat::Grey),
    ];
    let known = families.into_iter().find_map(|(family, pixel)| Some((family, pixel, value.strip_prefix(family)?)));
    // 420p10, mono16; 444alpha has a fourth plane
    let is_8_bit = |kind: &str| !kind.trim_start_matches('p').starts_with(|c: char| c.is_ascii_digit()) && kind != "alpha";
    let Some((family, pixel, kind)) = known.filter(|(_, _, kind)| is_8_bit(kind)) else {
        return Err(format!(
            "its chroma is {word}; gimbald reads 8-bit 420jpeg, 420mpeg2, 420paldv, 422, 444, 411 and mono: \
             ffmpeg -i IN -pix_fmt yuv420p OUT.y4m converts what it can read"
        ));
    };
    let siting = match (family, kind) {
        ("420", "mpeg2") => Siting::Left,
        ("420", "paldv") => Siting::TopLeft,
        _ => Siting::Centre,
    };
    Ok(Chroma { pixel, siting, is_411: family == "411" })
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
