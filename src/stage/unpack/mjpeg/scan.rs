//! Parses a picture's Huffman codes without decoding samples: whether they are complete, where they end, what else is among them.
//!
//! The decoder says only that something is wrong, not whether it matters: bytes that a camera puts before a restart marker or the end
//! are one complaint, lost samples another, and it tells only of the last. So where it complains of a sequential picture, the codes are
//! followed once more (ITU-T T.81, annex F.2). A picture whose every block has its codes is whole, whatever stands between them.

use memchr::memchr;

/// What the codes of a picture's samples are found to be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Codes {
    /// Each block has its own; all else that stands among them has no meaning.
    Whole,
    /// They end before the picture does; so many rows of luma have theirs.
    Cut {
        /// Rows from the top, a multiple of those in a unit.
        rows: usize,
    },
    /// Some cannot be, or are missing within the picture; or this kind of picture is not followed.
    Broken,
}

/// Bytes of any value before the end that are passed over; what is left of a picture that lost its way is more.
const MAX_STRAY: usize = 16;

/// Where bytes without meaning stand (from, to), in order.
pub(super) type Strays = Vec<(usize, usize)>;

/// Follows the codes of `jpeg`, as [`super::markers::extract`] wrote it; `ended` says whether it had an end of its own. Notes in
/// `strays` the bytes that the decoder would complain of.
pub(super) fn follow(jpeg: &[u8], ended: bool, strays: &mut Strays) -> Codes {
    strays.clear();
    let end = jpeg.len() - 2;
    if !ended {
        // A buffer that is filled up with zeros behind the picture, or where it was cut: they are no codes, though they would be some.
        let content = jpeg[..end].iter().rposition(|&byte| byte != 0).map_or(0, |at| at + 1 + usize::from(jpeg[at] == 0xff));
        if content + MAX_STRAY <= end {
            let codes = Follower::new(&jpeg[..content]).run(ended, strays);
            if codes != Codes::Broken {
                strays.push((content, end));
            }
            return codes;
        }
    }
    Follower::new(jpeg).run(ended, strays)
}

/// Takes the bytes in `strays` out of `jpeg`.
pub(super) fn remove(jpeg: &mut Vec<u8>, strays: &Strays) {
    let Some(&(mut end, _)) = strays.first() else { return };
    let nexts = strays.iter().skip(1).map(|stray| stray.0).chain([jpeg.len()]);
    for (&(_, from), to) in strays.iter().zip(nexts) {
        jpeg.copy_within(from..to, end);
        end += to - from;
    }
    jpeg.truncate(end);
}

/// Bits looked up at once; longer codes are rare and found one bit at a time.
const LOOKUP: u32 = 9;

/// A Huffman table.
#[derive(Clone)]
struct Table {
    /// By the next [`LOOKUP`] bits: length of the code that they begin with (0 where it is longer), and its value.
    short: [(u8, u8); 1 << LOOKUP],
    /// By length: the first code that is greater than all of that length, left-aligned in 16 bits.
    limit: [u32; 17],
    /// By length: index of the first value, less the first code.
    first: [i32; 17],
    values: [u8; 256],
}

impl Table {
    /// A table as a DHT segment has it; `None` where there are more codes than bits can tell apart.
    fn new(counts: &[u8], values: &[u8]) -> Option<Self> {
        let mut table = Self { short: [(0, 0); 1 << LOOKUP], limit: [0; 17], first: [0; 17], values: [0; 256] };
        table.values.get_mut(..values.len())?.copy_from_slice(values);
        let (mut code, mut index) = (0u32, 0usize);
        for length in 1..=16u32 {
            let count = u32::from(*counts.get(length as usize - 1)?);
            table.first[length as usize] = index as i32 - code as i32;
            for n in 0..count {
                let value = table.values[index + n as usize];
                if length <= LOOKUP {
                    let from = ((code + n) << (LOOKUP - length)) as usize;
                    table.short.get_mut(from..from + (1 << (LOOKUP - length)))?.fill((length as u8, value));
                }
            }
            code += count;
            index += count as usize;
            if code > 1 << length {
                return None;
            }
            table.limit[length as usize] = code << (16 - length);
            code <<= 1;
        }
        Some(table)
    }
}

/// Why a segment of codes ends before its blocks do.
enum End {
    /// There are no more bytes.
    OutOfBytes,
    /// No such code, or more coefficients than a block has.
    Impossible,
}

/// Bits of a segment of codes, up to a marker.
struct Bits<'a> {
    bytes: &'a [u8],
    at: usize,
    /// The next `count` bits, at its lower end.
    buffer: u64,
    count: u32,
}

impl Bits<'_> {
    fn fill(&mut self) {
        while self.count <= 48 {
            let Some(&byte) = self.bytes.get(self.at) else { return };
            self.at += 1;
            if byte == 0xff {
                if self.bytes.get(self.at) != Some(&0) {
                    // A byte that fills up, or a marker: no bits of a picture.
                    self.at -= 1;
                    return;
                }
                self.at += 1;
            }
            self.buffer = self.buffer << 8 | u64::from(byte);
            self.count += 8;
        }
    }

    /// The next `count` bits, at most 16; zeros behind the end.
    fn peek(&self, count: u32) -> u32 {
        let bits = if self.count >= count { self.buffer >> (self.count - count) } else { self.buffer << (count - self.count) };
        bits as u32 & ((1 << count) - 1)
    }

    fn skip(&mut self, count: u32) -> Result<(), End> {
        self.count = self.count.checked_sub(count).ok_or(End::OutOfBytes)?;
        self.buffer &= (1u64 << self.count) - 1;
        Ok(())
    }

    /// The value of the next code.
    fn code(&mut self, table: &Table) -> Result<u8, End> {
        if self.count < 32 {
            self.fill();
        }
        let (length, value) = table.short[self.peek(LOOKUP) as usize];
        if length != 0 {
            self.skip(u32::from(length))?;
            return Ok(value);
        }
        let sixteen = self.peek(16);
        let length = (LOOKUP + 1..=16).find(|&length| sixteen < table.limit[length as usize]);
        let Some(length) = length else { return Err(if self.count < 16 { End::OutOfBytes } else { End::Impossible }) };
        self.skip(length)?;
        let index = (sixteen >> (16 - length)) as i32 + table.first[length as usize];
        Ok(table.values[index as usize & 255])
    }

    /// Passes over one block: its DC difference, then its AC coefficients.
    fn block(&mut self, dc: &Table, ac: &Table) -> Result<(), End> {
        let bits = self.code(dc)?;
        if bits > 11 {
            return Err(End::Impossible);
        }
        self.skip(u32::from(bits))?;
        let mut coefficient = 1;
        while coefficient < 64 {
            let (run, bits) = match self.code(ac)? {
                0 => return Ok(()),
                value => (value >> 4, value & 15),
            };
            coefficient += u32::from(run) + 1;
            // No bits are sixteen zeros and nothing else.
            if coefficient > 64 || bits > 10 || (bits == 0 && run != 15) {
                return Err(End::Impossible);
            }
            self.skip(u32::from(bits))?;
        }
        Ok(())
    }

    /// Whether the bits left of a byte that was begun are all alike, as they are behind a picture's last code.
    fn is_padded(&self) -> bool {
        let left = self.count % 8;
        let bits = self.buffer >> (self.count - left);
        bits == 0 || bits == (1 << left) - 1
    }

    /// Where the first byte stands of which no bit was used.
    fn used(&self) -> usize {
        let mut at = self.at;
        for _ in 0..self.count / 8 {
            at -= if at >= 2 && self.bytes[at - 2..at] == [0xff, 0] { 2 } else { 1 };
        }
        at
    }
}

/// A component of a scan.
#[derive(Clone, Copy, Default)]
struct Part {
    /// Blocks in a unit.
    blocks: usize,
    /// Numbers of its DC and AC tables.
    tables: [usize; 2],
}

/// What a scan's codes stand for.
#[derive(Clone, Copy, Default)]
struct Units {
    across: usize,
    down: usize,
    /// Luma rows of a unit; 0 where the scan is not all of the picture.
    rows: usize,
}

/// What the frame header says.
#[derive(Clone, Copy)]
struct Frame<'a> {
    size: (usize, usize),
    /// Name, factors (across and down, four bits each), quantization table.
    components: &'a [[u8; 3]],
}

impl<'a> Frame<'a> {
    fn new(payload: &'a [u8]) -> Option<Self> {
        let &[_, y1, y0, x1, x0, _, ref components @ ..] = payload else { return None };
        let number = |high, low| usize::from(u16::from_be_bytes([high, low]));
        let components: &[[u8; 3]] = components.as_chunks().0;
        // Identifiers have to be unique (B.2.2); where they are not, decoders differ in which component a scan means.
        let is_duplicate = |(n, component): (usize, &[u8; 3])| components[..n].iter().any(|other| other[0] == component[0]);
        (!components.iter().enumerate().any(is_duplicate))
            .then_some(Self { size: (number(x1, x0), number(y1, y0)), components })
    }

    fn factors(component: &[u8; 3]) -> (usize, usize) {
        (usize::from(component[1] >> 4).max(1), usize::from(component[1] & 15).max(1))
    }

    /// The parts and units of a scan with the (component, tables) pairs `scan`.
    fn scan(&self, scan: &[[u8; 2]]) -> Option<([Part; 3], Units)> {
        let most = self.components.iter().map(Self::factors).fold((1, 1), |most, own| (most.0.max(own.0), most.1.max(own.1)));
        let mut parts = [Part::default(); 3];
        for (part, [id, tables]) in parts.iter_mut().zip(scan) {
            let component = self.components.iter().find(|component| component[0] == *id)?;
            let (across, down) = Self::factors(component);
            *part = Part { blocks: across * down, tables: [usize::from(tables >> 4), usize::from(tables & 15)] };
        }
        if let [[id, _]] = scan {
            // A component alone comes block by block, and has no more of them than its samples need.
            let own = Self::factors(self.components.iter().find(|component| component[0] == *id)?);
            parts[0].blocks = 1;
            let blocks = |size: usize, own: usize, most: usize| (size * own).div_ceil(most).div_ceil(8);
            let rows = if self.components.len() == 1 { 8 } else { 0 };
            return Some((
                parts,
                Units { across: blocks(self.size.0, own.0, most.0), down: blocks(self.size.1, own.1, most.1), rows },
            ));
        }
        let rows = if scan.len() == self.components.len() { 8 * most.1 } else { 0 };
        let (across, down) = (self.size.0.div_ceil(8 * most.0), self.size.1.div_ceil(8 * most.1));
        Some((parts, Units { across, down, rows }))
    }
}

struct Follower<'a> {
    jpeg: &'a [u8],
    at: usize,
    /// DC, AC.
    tables: [[Option<Table>; 4]; 2],
    frame: Option<Frame<'a>>,
    /// Units from one restart marker to the next; 0 where there are none.
    interval: usize,
}

impl<'a> Follower<'a> {
    fn new(jpeg: &'a [u8]) -> Self {
        Self { jpeg, at: 2, tables: Default::default(), frame: None, interval: 0 }
    }

    fn run(mut self, ended: bool, strays: &mut Strays) -> Codes {
        let mut codes = Codes::Broken;
        while let Some(&[0xff, marker, high, low]) = self.jpeg.get(self.at..self.at + 4) {
            let end = self.at + 2 + usize::from(u16::from_be_bytes([high, low]));
            let Some(payload) = self.jpeg.get(self.at + 4..end) else { return Codes::Broken };
            self.at = end;
            match marker {
                0xc0 | 0xc1 => self.frame = Frame::new(payload),
                0xc4 if self.take_tables(payload).is_some() => {}
                // Tables that are none; progressive, lossless or arithmetic: not followed.
                0xc2..=0xcf => return Codes::Broken,
                0xdd => self.interval = payload.first_chunk().map_or(0, |&number| usize::from(u16::from_be_bytes(number))),
                0xda => {
                    codes = self.scan(payload, ended, strays).unwrap_or(Codes::Broken);
                    if codes != Codes::Whole {
                        return codes;
                    }
                }
                _ => {}
            }
        }
        codes
    }

    fn take_tables(&mut self, mut payload: &[u8]) -> Option<()> {
        while let [head, rest @ ..] = payload {
            let counts = rest.get(..16)?;
            let count: usize = counts.iter().map(|&count| usize::from(count)).sum();
            let table = Table::new(counts, rest.get(16..16 + count)?)?;
            *self.tables[usize::from(head >> 4 & 1)].get_mut(usize::from(head & 15))? = Some(table);
            payload = &rest[16 + count..];
        }
        Some(())
    }

    /// Follows a scan with the header `payload`; `None` where it makes no sense.
    fn scan(&mut self, payload: &[u8], ended: bool, strays: &mut Strays) -> Option<Codes> {
        let components = payload.get(1..1 + 2 * usize::from(*payload.first()?))?.as_chunks::<2>().0;
        let (parts, units) = self.frame?.scan(components)?;
        let parts = &parts[..components.len()];
        let total = units.across * units.down;
        let (mut done, mut restart) = (0, 0);
        while done < total {
            let end = codes_end(self.jpeg, self.at);
            let marker = self.jpeg[end..].iter().position(|&byte| byte != 0xff).map(|fill| end + fill);
            let next = marker.and_then(|at| self.jpeg.get(at)).copied().unwrap_or(0);
            let is_last = next & 0xf8 != 0xd0;
            let mut bits = Bits { bytes: &self.jpeg[self.at..end], at: 0, buffer: 0, count: 0 };
            let count = if self.interval == 0 { total } else { self.interval.min(total - done) };
            let (followed, stopped) = self.follow_units(&mut bits, parts, count)?;
            done += followed;
            let missing = matches!(stopped, Some(End::OutOfBytes)) || (stopped.is_none() && is_last && done < total);
            if missing && is_last && !ended && units.rows > 0 {
                return Some(Codes::Cut { rows: done / units.across * units.rows });
            }
            if stopped.is_some() || missing || !(is_last || next == 0xd0 + restart || done == total) {
                return Some(Codes::Broken);
            }
            restart = (restart + 1) % 8;
            let from = self.at + bits.used();
            // Behind the last code, all up to the next marker goes at once: restart markers, and bytes of 0xff before a zero, which are none.
            let to = if done == total { scan_end(self.jpeg, self.at) } else { marker.map_or(end, |at| at - 1) };
            if !are_meaningless(&self.jpeg[from..to], done == total && bits.is_padded()) {
                return Some(Codes::Broken);
            }
            if from < to {
                strays.push((from, to));
            }
            self.at = if done == total { to } else { to + 2 };
        }
        Some(Codes::Whole)
    }

    /// Passes over `count` units; says how many there were, and what ended them before. `None` where a table is missing.
    fn follow_units(&self, bits: &mut Bits<'_>, parts: &[Part], count: usize) -> Option<(usize, Option<End>)> {
        let mut tables = [None; 3];
        for (tables, part) in tables.iter_mut().zip(parts) {
            *tables = Some((self.tables[0].get(part.tables[0])?.as_ref()?, self.tables[1].get(part.tables[1])?.as_ref()?));
        }
        for unit in 0..count {
            for (part, tables) in parts.iter().zip(tables) {
                let (dc, ac) = tables?;
                for _ in 0..part.blocks {
                    if let Err(end) = bits.block(dc, ac) {
                        return Some((unit, Some(end)));
                    }
                }
            }
        }
        Some((count, None))
    }
}

/// Where the codes end that begin at `at`: the next marker, with the bytes that fill up before it.
fn codes_end(jpeg: &[u8], mut at: usize) -> usize {
    while let Some(found) = jpeg.get(at..).and_then(|rest| memchr(0xff, rest)) {
        if jpeg.get(at + found + 1) != Some(&0) {
            return at + found;
        }
        at += found + 2;
    }
    jpeg.len()
}

/// Where a scan ends whose codes begin at `at`: the next marker that is no restart marker.
fn scan_end(jpeg: &[u8], mut at: usize) -> usize {
    loop {
        at = codes_end(jpeg, at);
        match jpeg.get(at + 1) {
            Some(0xd0..=0xd7) => at += 2,
            Some(0xff) => at += 1,
            _ => return at,
        }
    }
}

/// Whether bytes that stand behind a segment's codes can be passed over: those that fill up, of any number; before the end, a few others.
fn are_meaningless(bytes: &[u8], before_end: bool) -> bool {
    let fill = bytes.iter().all(|byte| matches!(byte, 0x00 | 0xff));
    fill || (before_end && bytes.len() <= MAX_STRAY)
}
