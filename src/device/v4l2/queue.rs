//! A queue of memory-mapped buffers shared with a driver: which side owns which buffer, and how the stream is stopped cleanly.

use std::ptr::NonNull;

use rustix::io::Errno;
use rustix::mm::{MapFlags, ProtFlags, mmap, munmap};
use v4l::v4l_sys::V4L2_BUF_FLAG_ERROR;

use super::super::DeviceError;
use super::node::{Direction, Node};

/// A buffer that came back from the driver, and what the driver says of it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Returned {
    /// Which; its bytes are ours until it is queued again.
    pub(super) index: usize,
    /// How many bytes the driver filled.
    pub(super) bytes: usize,
    /// The driver's 32-bit count of frames.
    pub(super) sequence: u32,
    /// The driver's time (seconds, microseconds).
    pub(super) time: (i64, i64),
    /// Whether the driver calls the data damaged.
    pub(super) error: bool,
}

/// The buffers of one node. A buffer is either the driver's (queued) or ours; its bytes can be reached only while it is ours, and
/// since queueing takes `&mut self`, no borrow of them outlives that.
///
/// That is what keeps *us* from reading a frame that is being overwritten. It does not keep others from writing: every process that
/// may open the node can map the same buffers, a loopback's readers all do, and a driver that was not asked ([`Queue::reclaim`]) may
/// still use a buffer. Bytes of a mapping can therefore change at any time, between two reads of one byte as well. A reader of them
/// must need nothing of them: either samples, which decide no address and no length, or one copy into private memory, which is then
/// looked at in the mapping's place.
#[derive(Debug)]
pub(super) struct Queue {
    // Unmapped and freed in Drop, before the node's own Drop closes the descriptor.
    mappings: Vec<Mapping>,
    streaming: bool,
    direction: Direction,
    node: Node,
}

#[derive(Debug)]
struct Mapping {
    start: NonNull<u8>,
    length: usize,
    /// What the driver knows it by.
    offset: u64,
    /// The driver has it.
    queued: bool,
}

// SAFETY: a mapping is memory of the whole process, not of a thread; it is reached only through `Queue`, whose methods follow
// Rust's borrowing.
unsafe impl Send for Mapping {}

impl Queue {
    /// Asks the driver for `count` buffers (it may give fewer or more) and maps them. All are ours at first.
    pub(super) fn new(node: Node, direction: Direction, count: u32) -> Result<Self, DeviceError> {
        let given = node.request_buffers(direction, count).map_err(|errno| node.error("get buffers from", errno))?;
        // From here on Drop gives back what was got so far.
        let mut queue = Self { mappings: Vec::with_capacity(given as usize), streaming: false, direction, node };
        for index in 0..given {
            let (offset, length) =
                queue.node.query_buffer(direction, index).map_err(|errno| queue.node.error("ask for the buffers of", errno))?;
            // Some drivers refuse to map what is not also writable.
            let access = ProtFlags::READ | ProtFlags::WRITE;
            // SAFETY: a new mapping at an address of the kernel's choice touches no memory of ours; offset and length are the
            // driver's own.
            let start = unsafe { mmap(std::ptr::null_mut(), length, access, MapFlags::SHARED, queue.node.fd(), offset) }
                .map_err(|errno| queue.node.error("map a buffer of", errno))?;
            let Some(start) = NonNull::new(start.cast::<u8>()) else {
                return Err(queue.node.error("map a buffer of", Errno::NOMEM));
            };
            queue.mappings.push(Mapping { start, length, offset, queued: false });
        }
        Ok(queue)
    }

    /// The node.
    pub(super) fn node(&self) -> &Node {
        &self.node
    }

    /// How many buffers there are.
    pub(super) fn len(&self) -> usize {
        self.mappings.len()
    }

    /// Bytes of the smallest buffer; 0 where there is none.
    pub(super) fn capacity(&self) -> usize {
        self.mappings.iter().map(|mapping| mapping.length).min().unwrap_or(0)
    }

    /// A buffer that is ours, if any is.
    pub(super) fn free(&self) -> Option<usize> {
        self.mappings.iter().position(|mapping| !mapping.queued)
    }

    /// The bytes of buffer `index`; none while it is the driver's.
    pub(super) fn bytes(&self, index: usize) -> &[u8] {
        match self.mappings.get(index) {
            // SAFETY: mapped by `new` with this length until Drop, and readable. No reference of this process writes it while the
            // borrow of `self` lasts: `bytes_mut` and `enqueue` need `&mut self`. Other processes, and after `reclaim` the driver, may
            // write it all the same. The compiler cannot know, and that is why nothing may be concluded from these bytes before they
            // are copied (see `Queue`): the frame path copies compressed frames before it looks at them (stage/unpack/mjpeg) and of raw
            // ones reads samples, whose values no address depends on.
            Some(mapping) if !mapping.queued => unsafe { std::slice::from_raw_parts(mapping.start.as_ptr(), mapping.length) },
            _ => &[],
        }
    }

    /// The bytes of buffer `index`, to write; none while it is the driver's.
    pub(super) fn bytes_mut(&mut self, index: usize) -> &mut [u8] {
        match self.mappings.get_mut(index) {
            // SAFETY: as for `bytes`; mapped writable, and `&mut self` makes this the only reference of this process. After `reclaim`
            // the driver may still be handing the buffer to readers, who then see it change: they are other processes with mappings
            // of their own, and what they read is up to them. Nothing here depends on what is read back.
            Some(mapping) if !mapping.queued => unsafe {
                std::slice::from_raw_parts_mut(mapping.start.as_ptr(), mapping.length)
            },
            _ => &mut [],
        }
    }

    /// Gives buffer `index` to the driver; for output with `bytes` of it filled with a picture taken at `time_ns`.
    pub(super) fn enqueue(&mut self, index: usize, bytes: usize, time_ns: i64) -> Result<(), Errno> {
        let mapping = self.mappings.get_mut(index).filter(|mapping| !mapping.queued).ok_or(Errno::INVAL)?;
        let bytes = u32::try_from(bytes.min(mapping.length)).map_err(|_| Errno::INVAL)?;
        // An index that came from a Vec whose length the driver gave as a u32.
        self.node.queue_buffer(self.direction, u32::try_from(index).map_err(|_| Errno::INVAL)?, bytes, time_ns)?;
        mapping.queued = true;
        Ok(())
    }

    /// Takes back the buffer that the driver was done with first; `None` where it is done with none.
    pub(super) fn dequeue(&mut self) -> Result<Option<Returned>, Errno> {
        let Some(buffer) = self.node.dequeue_buffer(self.direction)? else { return Ok(None) };
        let index = buffer.index as usize;
        let mapping = self.mappings.get_mut(index).ok_or(Errno::INVAL)?;
        mapping.queued = false;
        Ok(Some(Returned {
            index,
            bytes: (buffer.bytesused as usize).min(mapping.length),
            sequence: buffer.sequence,
            time: (buffer.timestamp.tv_sec, buffer.timestamp.tv_usec),
            error: buffer.flags & V4L2_BUF_FLAG_ERROR != 0,
        }))
    }

    /// The buffer whose turn it is after `last`, taken back though the driver does not give it: for v4l2loopback before 0.15, which
    /// gives the one that was queued last, at which readers are looking. A reader that asked for fewer buffers than there are has
    /// made them fewer since: an index beyond them means another buffer then, and it is that one's turn.
    pub(super) fn reclaim_next(&mut self, last: Option<usize>) -> Result<Option<usize>, Errno> {
        let Some(next) = last.map_or(0, |last| last + 1).checked_rem(self.mappings.len()) else { return Ok(None) };
        let (offset, _) = self.node.query_buffer(self.direction, u32::try_from(next).map_err(|_| Errno::INVAL)?)?;
        let index = self.mappings.iter().position(|mapping| mapping.offset == offset).unwrap_or(next);
        self.reclaim(index);
        Ok(Some(index))
    }

    /// Makes a buffer ours without asking the driver, as [`Queue::reclaim_next`]: v4l2loopback copies no frames, it only tells readers
    /// which buffer is the newest, and writes to none. To the driver the buffer stays queued; being queued once more does it no harm. So
    /// "free" then means that no other part of this process has it, not that no reader looks at it.
    pub(super) fn reclaim(&mut self, index: usize) {
        if let Some(mapping) = self.mappings.get_mut(index) {
            mapping.queued = false;
        }
    }

    /// Starts the stream.
    pub(super) fn start(&mut self) -> Result<(), Errno> {
        self.node.stream_on(self.direction)?;
        self.streaming = true;
        Ok(())
    }

    /// Stops the stream; every buffer is ours again.
    pub(super) fn stop(&mut self) -> Result<(), Errno> {
        let outcome = self.node.stream_off(self.direction);
        if outcome.is_ok() {
            self.streaming = false;
            for mapping in &mut self.mappings {
                mapping.queued = false;
            }
        }
        outcome
    }
}

impl Drop for Queue {
    /// STREAMOFF, unmap, free; then the node closes. A device that is gone refuses these, which is as good: closing frees all.
    fn drop(&mut self) {
        if self.streaming {
            let _ = self.stop();
        }
        for mapping in self.mappings.drain(..) {
            // SAFETY: mapped by `new` with this address and length, and nothing borrows it: we hold `&mut self`, at the end.
            let _ = unsafe { munmap(mapping.start.as_ptr().cast(), mapping.length) };
        }
        // Not a loopback's: v4l2loopback 0.12 would forget what its readers have mapped. Closing frees them as well.
        if self.direction == Direction::Capture {
            let _ = self.node.request_buffers(self.direction, 0);
        }
    }
}
