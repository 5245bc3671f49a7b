//! The first step: decodes a source's bytes to a picture, or returns the reason why it cannot.

use std::fmt::Write as _;

use crate::device::RawFrame;
use crate::frame::FrameFlags;
use crate::image::Picture;
use crate::kernel::Level;
use crate::stage::unpack::{Unpack, UnpackError};

/// Turns a source's frames into pictures. Its memory is made with the first frame and kept.
#[derive(Debug, Default)]
pub struct Decoder(Unpack);

impl Decoder {
    /// A decoder at a SIMD level; the pictures do not depend on it.
    pub fn with_level(level: Level) -> Self {
        Self(Unpack::with_level(level))
    }

    /// The picture of `raw`, into `into`.
    ///
    /// # Errors
    /// Why there is none; `into` is unspecified then.
    pub fn decode(&mut self, raw: &RawFrame<'_>, into: &mut Picture) -> Result<(), Unusable> {
        let RawFrame { format, bytes, stamp } = *raw;
        if stamp.flags.contains(FrameFlags::ERROR) {
            return Err(Unusable::Marked);
        }
        if bytes.is_empty() {
            return Err(Unusable::Empty);
        }
        Ok(self.0.unpack(format.pixel, format.colour.range, (format.width, format.height), format.stride, bytes, into)?)
    }

    /// Whether the last picture is part of its frame only, the rest being the picture's before (see [`Unpack::shortfall`]).
    pub fn is_cut(&self) -> bool {
        self.0.shortfall().is_some()
    }
}

/// Why a frame cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Unusable {
    /// [`FrameFlags::ERROR`].
    #[error("the frame is marked as damaged, by the camera's driver or for a wrong checksum in its recording")]
    Marked,
    /// It holds nothing.
    #[error("the frame has no bytes")]
    Empty,
    /// What it holds is no picture of the stream's format.
    #[error(transparent)]
    Undecodable(#[from] UnpackError),
}

impl Unusable {
    /// What it is counted under.
    pub fn reason(&self) -> Reason {
        match self {
            Self::Marked => Reason::Marked,
            Self::Empty => Reason::Empty,
            Self::Undecodable(UnpackError::Truncated { .. } | UnpackError::Cut { .. }) => Reason::Truncated,
            Self::Undecodable(UnpackError::SizeMismatch { .. }) => Reason::Size,
            Self::Undecodable(UnpackError::Impossible { .. } | UnpackError::Unsupported { .. }) => Reason::Unsupported,
            Self::Undecodable(UnpackError::Damaged { .. }) => Reason::Damaged,
        }
    }
}

/// Kinds of [`Unusable`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(usize)]
pub enum Reason {
    /// The frame is marked as damaged.
    Marked,
    /// It has no bytes.
    Empty,
    /// It is shorter than its format needs.
    Truncated,
    /// The compressed picture has another size than the stream.
    Size,
    /// It is of a kind that is not decoded.
    Unsupported,
    /// The compressed picture is damaged.
    Damaged,
}

impl Reason {
    /// How many there are.
    pub const COUNT: usize = Self::ALL.len();

    /// Every reason.
    pub const ALL: [Self; 6] = [Self::Marked, Self::Empty, Self::Truncated, Self::Size, Self::Unsupported, Self::Damaged];

    /// Its name in counters.
    pub fn name(self) -> &'static str {
        ["marked", "empty", "truncated", "wrong_size", "unsupported", "damaged"][self as usize]
    }

    /// What cannot be done with such frames.
    fn verb(self) -> &'static str {
        match self {
            Self::Marked | Self::Empty => "used",
            _ => "decoded",
        }
    }
}

/// Longest text that is kept of a reason, in bytes: some decoders quote what they read.
const LONGEST: usize = 200;

/// The frames of a stream that could not be used: how many for each reason, and the first such frame's own words.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Reasons {
    counts: [u64; Reason::COUNT],
    first: [Option<Box<str>>; Reason::COUNT],
}

impl Reasons {
    pub(super) fn of(counts: [u64; Reason::COUNT], first: [Option<Box<str>>; Reason::COUNT]) -> Self {
        Self { counts, first }
    }

    /// Counts one more. Takes memory with the first of a kind only.
    pub fn add(&mut self, why: &Unusable) {
        let kind = why.reason() as usize;
        self.counts[kind] += 1;
        self.first[kind].get_or_insert_with(|| reason_text(why));
    }

    /// Frames in all.
    pub fn total(&self) -> u64 {
        self.counts.iter().sum()
    }

    /// Frames for one reason.
    pub fn count(&self, reason: Reason) -> u64 {
        self.counts[reason as usize]
    }

    /// The most frequent reason; `None` where every frame could be used.
    pub fn main(&self) -> Option<Reason> {
        Reason::ALL.into_iter().filter(|&reason| self.count(reason) > 0).max_by_key(|&reason| self.count(reason))
    }

    /// The sentence for people, as "3 of 40 frames cannot be decoded: ..."; `None` where every frame could be used. It states the
    /// most frequent reason in the words of the first frame that had it.
    pub fn in_words(&self, of: u64) -> Option<String> {
        let main = self.main()?;
        let (total, count) = (self.total(), self.count(main));
        let mut words = format!("{total} of {of} frames cannot be {}", main.verb());
        if count < total {
            let _ = write!(words, ", {count} of them for this reason");
        }
        if let Some(first) = &self.first[main as usize] {
            let _ = write!(words, ": {first}");
        }
        Some(words)
    }
}

/// A reason's words, cut where they are too long.
pub(super) fn reason_text(why: &Unusable) -> Box<str> {
    let mut text: String = why.to_string().chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
    if text.len() > LONGEST {
        let end = (0..=LONGEST).rev().find(|&end| text.is_char_boundary(end)).unwrap_or(0);
        text.truncate(end);
        text += "...";
    }
    text.into_boxed_str()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::StreamFormat;
    use crate::frame::Stamp;
    use crate::image::PixelFormat;

    fn why(pixel: PixelFormat, bytes: &[u8], flags: FrameFlags) -> Result<(), Unusable> {
        let stamp = Stamp { flags, ..Stamp::default() };
        let raw = RawFrame { format: StreamFormat::tight(16, 16, pixel, (1, 30)), bytes, stamp };
        Decoder::default().decode(&raw, &mut Picture::default())
    }

    #[test]
    fn each_fault_has_its_reason() {
        let none = FrameFlags::default();
        let whole = [128; 512];
        assert_eq!(why(PixelFormat::Yuyv, &whole, none), Ok(()));
        for (pixel, bytes, flags, reason, words) in [
            (PixelFormat::Yuyv, &whole[..], FrameFlags::ERROR, Reason::Marked, "marked as damaged"),
            (PixelFormat::Mjpeg, &[][..], none, Reason::Empty, "no bytes"),
            (PixelFormat::Yuyv, &whole[..500], none, Reason::Truncated, "500 bytes, 512 were expected"),
            (PixelFormat::Mjpeg, &whole[..], none, Reason::Damaged, "the JPEG picture is damaged: "),
        ] {
            let error = why(pixel, bytes, flags).unwrap_err();
            assert_eq!(error.reason(), reason, "{error}");
            assert!(error.to_string().contains(words), "{words} in {error}");
        }
    }

    #[test]
    fn the_most_frequent_reason_is_said_in_the_words_of_its_first_frame() {
        let damaged = |what: &'static str| Unusable::Undecodable(UnpackError::Damaged { what: what.into() });
        let mut reasons = Reasons::default();
        assert_eq!((reasons.in_words(7), reasons.main()), (None, None));
        reasons.add(&damaged("no marker"));
        reasons.add(&damaged("another marker"));
        assert_eq!(reasons.in_words(2).unwrap(), "2 of 2 frames cannot be decoded: the JPEG picture is damaged: no marker");
        (0..3).for_each(|_| reasons.add(&Unusable::Empty));
        assert_eq!(
            reasons.in_words(230).unwrap(),
            "5 of 230 frames cannot be used, 3 of them for this reason: the frame has no bytes"
        );
        assert_eq!((reasons.total(), reasons.count(Reason::Damaged), reasons.main()), (5, 2, Some(Reason::Empty)));
    }

    #[test]
    fn what_a_decoder_quotes_is_cut_and_plain() {
        let why = Unusable::Undecodable(UnpackError::Damaged { what: format!("a\u{1b}b{}", "\u{e9}".repeat(500)).into() });
        let text = reason_text(&why);
        assert!(text.len() <= LONGEST + 3 && text.ends_with("...") && !text.contains('\u{1b}'), "{text}");
    }

    #[test]
    fn every_reason_has_a_name_of_its_own() {
        let mut names = Reason::ALL.map(Reason::name).to_vec();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), Reason::COUNT);
        assert!(Reason::ALL.iter().enumerate().all(|(n, &reason)| reason as usize == n));
    }
}
