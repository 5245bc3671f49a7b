//! One JPEG picture among a camera's bytes, written out again as the decoder is to see it.
//!
//! What webcams send is rarely what ITU-T T.81 (its annex B) asks for: bytes before the picture and behind it, pictures without content,
//! no Huffman tables, no end, segments of metadata whose length is wrong. Programs that show such pictures skip over all of that, and so
//! does [`extract`]. What remains has one form: start, colour transform, the standard Huffman tables, the picture's own tables and
//! headers, its samples as they came, end. Nothing that the decoder is told then depends on a picture that came before.

use std::borrow::Cow;

use super::super::UnpackError;
use super::standard::HUFFMAN_TABLES;
use memchr::memchr;

/// Components that a frame header may have here: luma and two of chroma.
const MAX_COMPONENTS: usize = 3;

/// A component's line in the frame header.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Component {
    id: u8,
    /// Sampling factors (across, down), 1 to 4.
    pub(super) factors: (usize, usize),
    /// Its quantization table.
    table: u8,
}

/// Every other row of an interlaced picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Field {
    /// The first row, the third and so on.
    Top,
    /// The second row, the fourth and so on.
    Bottom,
}

/// What a picture says of itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Header {
    /// Luma samples across and down.
    pub(super) size: (usize, usize),
    components: [Component; MAX_COMPONENTS],
    count: usize,
    /// Whether its scans are sequential: each has all of a block's frequencies.
    pub(super) sequential: bool,
    /// Whether its first scan has all components, unit by unit; else each has as many blocks as its own samples need.
    by_units: bool,
    /// Which rows of an interlaced picture it has, where it says so.
    pub(super) field: Option<Field>,
    /// Where the bytes behind it begin.
    pub(super) next: usize,
    /// Whether it ends with an end marker.
    pub(super) ended: bool,
    /// Where in the extracted bytes its height stands, and behind it its width.
    size_at: usize,
}

impl Header {
    /// Its components: luma alone, or luma and two of chroma.
    pub(super) fn components(&self) -> &[Component] {
        &self.components[..self.count]
    }

    /// Luma samples (across, down) of a minimum coded unit, the block in which samples are coded.
    fn unit(&self) -> (usize, usize) {
        match self.components() {
            // Factors of a single component mean nothing.
            [_] => (8, 8),
            all => all.iter().fold((8, 8), |(x, y), c| (x.max(8 * c.factors.0), y.max(8 * c.factors.1))),
        }
    }

    /// Where the picture is coded as one of `size` would be, both having as many units across and down: makes it one, here and in the
    /// extracted bytes `jpeg`. The samples between the two sizes are there either way.
    pub(super) fn resize_within_units(&mut self, size: (usize, usize), jpeg: &mut [u8]) {
        let (x, y) = self.unit();
        let units = |size: (usize, usize)| (size.0.div_ceil(x), size.1.div_ceil(y));
        let (Ok(width), Ok(height)) = (u16::try_from(size.0), u16::try_from(size.1)) else { return };
        if self.by_units
            && units(size) == units(self.size)
            && let Some(bytes) = jpeg.get_mut(self.size_at..self.size_at + 4)
        {
            bytes[..2].copy_from_slice(&height.to_be_bytes());
            bytes[2..].copy_from_slice(&width.to_be_bytes());
            self.size = size;
        }
    }
}

/// Markers, by the byte behind 0xff.
mod marker {
    pub(super) const SOF0: u8 = 0xc0;
    pub(super) const SOF1: u8 = 0xc1;
    pub(super) const SOF2: u8 = 0xc2;
    pub(super) const DHT: u8 = 0xc4;
    pub(super) const JPG: u8 = 0xc8;
    pub(super) const DAC: u8 = 0xcc;
    pub(super) const SOF15: u8 = 0xcf;
    pub(super) const SOI: u8 = 0xd8;
    pub(super) const EOI: u8 = 0xd9;
    pub(super) const SOS: u8 = 0xda;
    pub(super) const DQT: u8 = 0xdb;
    pub(super) const DRI: u8 = 0xdd;
    pub(super) const APP0: u8 = 0xe0;
    pub(super) const APP14: u8 = 0xee;
    pub(super) const APP15: u8 = 0xef;
    pub(super) const COM: u8 = 0xfe;
}

/// How the decoder is to read three components, as libjpeg finds it: by a JFIF or Adobe segment, else by the components' names.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Transform {
    Unsaid,
    YCbCr,
    Rgb,
}

fn damaged(what: &'static str) -> UnpackError {
    UnpackError::Damaged { what: Cow::Borrowed(what) }
}

/// Writes the first picture that has content among `raw`, from byte `from` on, to `into` and says what its header says.
///
/// # Errors
/// [`UnpackError::Damaged`] where there is none, where a segment that matters is not whole, and where a table is used that the picture
/// does not have; [`UnpackError::Unsupported`] for four colours. The samples themselves are not looked at.
pub(super) fn extract(raw: &[u8], from: usize, into: &mut Vec<u8>) -> Result<Header, UnpackError> {
    let at = start(raw, from).ok_or(damaged("it has no start marker"))?;
    let (tables, transform) = (Tables::default(), Transform::Unsaid);
    Extraction { raw, at, into, tables, transform, field: None, header: None }.run()
}

/// Behind the first start marker from `at` on.
fn start(raw: &[u8], mut at: usize) -> Option<usize> {
    loop {
        at += memchr(0xff, raw.get(at..)?)? + 1;
        if raw.get(at) == Some(&marker::SOI) {
            return Some(at + 1);
        }
    }
}

/// The tables that a picture has defined so far, a bit each.
#[derive(Default)]
struct Tables {
    quantization: u8,
    /// DC, AC. Those that every picture is given are there from the beginning.
    huffman: [u8; 2],
}

struct Extraction<'a> {
    raw: &'a [u8],
    at: usize,
    into: &'a mut Vec<u8>,
    tables: Tables,
    transform: Transform,
    field: Option<Field>,
    header: Option<Header>,
}

impl<'a> Extraction<'a> {
    fn run(&mut self) -> Result<Header, UnpackError> {
        self.begin();
        let mut scans = 0;
        let ended = loop {
            let Some(marker) = self.next_marker() else { break false };
            match marker {
                // A picture without content is no picture; the tables in it hold for the next.
                marker::EOI | marker::SOI if scans == 0 => self.forget_header(),
                marker::EOI => break true,
                marker::SOI => break false,
                0x01 | 0xd0..=0xd7 => {}
                marker::SOS => {
                    self.scan()?;
                    scans += 1;
                }
                marker => self.segment(marker)?,
            }
        };
        let mut header = self.header.ok_or(damaged("it has no frame header"))?;
        if scans == 0 {
            return Err(damaged("it has no samples"));
        }
        (header.ended, header.field) = (ended, self.field);
        // A start marker that ended it is the next one's.
        header.next = if ended { self.at } else { self.at.saturating_sub(2) };
        self.into.extend_from_slice(&[0xff, marker::EOI]);
        Ok(header)
    }

    /// Begins with nothing but what every picture is given.
    fn begin(&mut self) {
        (self.header, self.transform, self.field) = (None, Transform::Unsaid, None);
        self.into.clear();
        self.into.extend_from_slice(&[0xff, marker::SOI]);
        // Version 100, flags, and the transform, which is set once it is known.
        self.into.extend_from_slice(b"\xff\xee\x00\x0eAdobe\x00\x64\x00\x00\x00\x00\x01");
        self.into.extend_from_slice(HUFFMAN_TABLES);
        self.tables.huffman = [0b11, 0b11];
    }

    /// A picture ended that had no samples: a frame header that it had is not the next one's.
    fn forget_header(&mut self) {
        if self.header.is_some() {
            self.tables = Tables::default();
            self.begin();
        }
    }

    /// Where in the extracted bytes the colour transform stands.
    const TRANSFORM_AT: usize = 17;

    /// The next marker, whatever stands before it.
    fn next_marker(&mut self) -> Option<u8> {
        loop {
            self.at += memchr(0xff, self.raw.get(self.at..)?)? + 1;
            match *self.raw.get(self.at)? {
                0x00 => {}
                // A byte that fills up before a marker.
                0xff => continue,
                marker => {
                    self.at += 1;
                    return Some(marker);
                }
            }
        }
    }

    /// The payload of the segment that begins here, where it lies within the bytes.
    fn payload(&self) -> Option<&'a [u8]> {
        let length = self.raw.get(self.at..self.at + 2)?;
        let end = self.at + usize::from(u16::from_be_bytes([length[0], length[1]]));
        self.raw.get(self.at + 2..end)
    }

    /// Takes a segment over, or leaves it out.
    fn segment(&mut self, marker: u8) -> Result<(), UnpackError> {
        if matches!(marker, marker::APP0..=marker::APP15 | marker::COM) {
            self.metadata(marker);
            return Ok(());
        }
        let payload = self.payload().ok_or(damaged("a segment is cut off"))?;
        let (whole, length) = match marker {
            marker::DQT => (self.tables.take_quantization(payload), payload.len()),
            marker::DHT => (self.tables.take_huffman(payload), payload.len()),
            marker::DRI => (payload.len() == 2, payload.len()),
            marker::JPG | marker::DAC => (true, payload.len()),
            marker::SOF0..=marker::SOF15 => {
                let header = frame_header(payload)?;
                // A second one is for the decoder to refuse.
                let sequential = matches!(marker, marker::SOF0 | marker::SOF1);
                self.header = Some(Header { size_at: self.into.len() + 5, sequential, ..header });
                (true, payload.len())
            }
            _ => (true, payload.len()),
        };
        if !whole {
            return Err(damaged("a table is not as long as it says"));
        }
        self.copy_segment(length);
        self.set_transform();
        Ok(())
    }

    /// Copies the segment whose marker was just read and whose payload has `length` bytes.
    fn copy_segment(&mut self, length: usize) {
        let end = self.at + 2 + length;
        self.into.push(0xff);
        self.into.extend_from_slice(&self.raw[self.at - 1..end]);
        self.at = end;
    }

    /// Passes over a segment of metadata; where its length is wrong, up to a marker that can follow it.
    fn metadata(&mut self, marker: u8) {
        let payload = self.payload();
        match payload {
            Some(payload) if marker == marker::APP0 && payload.starts_with(b"JFIF\0") => self.transform = Transform::YCbCr,
            Some(payload)
                if marker == marker::APP14 && payload.starts_with(b"Adobe") && self.transform == Transform::Unsaid =>
            {
                self.transform = match payload.get(11) {
                    Some(0) => Transform::Rgb,
                    _ => Transform::YCbCr,
                };
            }
            // "AVI1", then 0 (not interlaced), 1 or 2.
            Some(&[b'A', b'V', b'I', b'1', 1, ..]) if marker == marker::APP0 => self.field = Some(Field::Top),
            Some(&[b'A', b'V', b'I', b'1', 2, ..]) if marker == marker::APP0 => self.field = Some(Field::Bottom),
            _ => {}
        }
        let end = payload.map(|payload| self.at + 2 + payload.len());
        if let Some(end) = end.filter(|&end| self.raw.get(end) == Some(&0xff)) {
            self.at = end;
            return;
        }
        // In metadata any two bytes may look like a marker; a segment that ends where another begins is no accident.
        let follows = |at: &usize| {
            let Some(&[0xff, marker, high, low]) = self.raw.get(*at..*at + 4) else { return false };
            let end = *at + 2 + usize::from(u16::from_be_bytes([high, low]));
            matches!(marker, marker::SOF0..=marker::SOF2 | marker::DHT | marker::DQT | marker::DRI | marker::APP0..=marker::APP15 | marker::COM)
                && self.raw.get(end) == Some(&0xff)
                || marker == marker::SOS
        };
        self.at = (self.at..self.raw.len()).find(follows).unwrap_or(self.raw.len());
    }

    /// Tells the decoder how to read the colours, whatever the segments say that were left out.
    fn set_transform(&mut self) {
        let Some(header) = &self.header else { return };
        let rgb = match self.transform {
            Transform::Rgb => true,
            Transform::YCbCr => false,
            Transform::Unsaid => header.components().iter().map(|component| component.id).eq(*b"RGB"),
        };
        self.into[Self::TRANSFORM_AT] = u8::from(!rgb);
    }

    /// Takes a scan over: its header, and all bytes up to a marker that ends it.
    fn scan(&mut self) -> Result<(), UnpackError> {
        let header = self.header.ok_or(damaged("its samples come before its frame header"))?;
        let payload = self.payload().ok_or(damaged("a segment is cut off"))?;
        let length = payload.len();
        let count = usize::from(*payload.first().unwrap_or(&0));
        if length != 4 + 2 * count || !(1..=header.count).contains(&count) {
            return Err(damaged("a scan's header is not as long as it says"));
        }
        self.header = Some(Header { by_units: header.by_units || count == header.count, ..header });
        self.tables.check(&header, &payload[1..1 + 2 * count])?;
        self.copy_segment(length);
        if header.sequential {
            // Some cameras leave other numbers there, which the decoder complains of and ignores.
            let end = self.into.len();
            self.into[end - 3..].copy_from_slice(&[0, 63, 0]);
        }
        let from = self.at;
        loop {
            let Some(found) = memchr(0xff, &self.raw[self.at..]) else {
                self.at = self.raw.len();
                break;
            };
            let at = self.at + found;
            match self.raw.get(at + 1) {
                Some(0x00 | 0xd0..=0xd7) => self.at = at + 2,
                Some(0xff) => self.at = at + 1,
                _ => {
                    self.at = at;
                    break;
                }
            }
        }
        self.into.extend_from_slice(&self.raw[from..self.at]);
        Ok(())
    }
}

/// Reads a frame header's payload.
fn frame_header(payload: &[u8]) -> Result<Header, UnpackError> {
    let &[precision, y1, y0, x1, x0, count, ref rest @ ..] = payload else {
        return Err(damaged("its frame header is too short"));
    };
    let count = usize::from(count);
    if rest.len() != 3 * count {
        return Err(damaged("its frame header is not as long as it says"));
    }
    if precision != 8 {
        return Err(UnpackError::Unsupported { what: "of other than 8 bits a sample" });
    }
    if count != 1 && count != MAX_COMPONENTS {
        return Err(UnpackError::Unsupported { what: "of other than one or three colour components" });
    }
    let mut components = [Component::default(); MAX_COMPONENTS];
    for (component, bytes) in components.iter_mut().zip(rest.as_chunks::<3>().0) {
        let factors = (usize::from(bytes[1] >> 4), usize::from(bytes[1] & 15));
        if !(1..=4).contains(&factors.0) || !(1..=4).contains(&factors.1) {
            return Err(damaged("its sampling factors are none"));
        }
        *component = Component { id: bytes[0], factors, table: bytes[2] };
    }
    let size = (usize::from(u16::from_be_bytes([x1, x0])), usize::from(u16::from_be_bytes([y1, y0])));
    if size.0 == 0 || size.1 == 0 {
        return Err(damaged("its frame header says that it has no rows or columns"));
    }
    Ok(Header { size, components, count, sequential: false, by_units: false, field: None, next: 0, ended: false, size_at: 0 })
}

impl Tables {
    /// Notes the quantization tables in a segment; false where it is not exactly as long as they are.
    fn take_quantization(&mut self, mut payload: &[u8]) -> bool {
        while let [head, rest @ ..] = payload {
            let length = if head >> 4 == 0 { 64 } else { 128 };
            let Some(rest) = rest.get(length..) else { return false };
            self.quantization |= 1u8.checked_shl(u32::from(head & 15)).unwrap_or(0);
            payload = rest;
        }
        true
    }

    /// As [`Self::take_quantization`], of Huffman tables.
    fn take_huffman(&mut self, mut payload: &[u8]) -> bool {
        while let [head, rest @ ..] = payload {
            let Some(counts) = rest.get(..16) else { return false };
            let values: usize = counts.iter().map(|&count| usize::from(count)).sum();
            let Some(rest) = rest.get(16 + values..) else { return false };
            self.huffman[usize::from(head >> 4 & 1)] |= 1u8.checked_shl(u32::from(head & 15)).unwrap_or(0);
            payload = rest;
        }
        true
    }

    /// Whether all tables are there that a scan uses, whose header has the (component, tables) pairs `scan`. What a decoder finds in
    /// their place is what another picture left behind.
    fn check(&self, header: &Header, scan: &[u8]) -> Result<(), UnpackError> {
        let has = |tables: u8, table: u8| tables.checked_shr(u32::from(table)).is_some_and(|bits| bits & 1 == 1);
        for &[id, huffman] in scan.as_chunks::<2>().0 {
            let component = header.components().iter().find(|component| component.id == id);
            let component = component.ok_or(damaged("a scan has a component that the frame header does not have"))?;
            if !has(self.quantization, component.table) {
                return Err(damaged("it has no quantization table"));
            }
            if !has(self.huffman[0], huffman >> 4) || !has(self.huffman[1], huffman & 15) {
                return Err(damaged("it has no Huffman table of that number, and no standard gives one"));
            }
        }
        Ok(())
    }
}
