//! A PipeWire camera node: created, watched for viewers, and fed with pictures.

use std::ffi::{CStr, CString, c_char, c_int, c_void};
use std::os::fd::{AsRawFd, OwnedFd};
use std::ptr::{NonNull, null, null_mut};
use std::sync::atomic::{AtomicPtr, AtomicU32, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use rustix::fs::{MemfdFlags, SealFlags, fcntl_add_seals, ftruncate, memfd_create};

use super::layout::{
    Busy, Chunk, DATA_MAPPABLE, DATA_MEM_FD, DATA_READABLE, DATA_WRITABLE, DIRECTION_OUTPUT, Dict, DictItem,
    FLAG_ALLOC_BUFFERS, FLAG_DRIVER, FLAG_RT_PROCESS, Header, ID_ANY, META_BUSY, META_HEADER, Opaque, PwBuffer, STATE_ERROR,
    STATE_PAUSED, STATE_STREAMING, STATE_UNCONNECTED, STREAM_EVENTS_VERSION, StreamEvents,
};
use super::library::Library;
use super::pod::{self, Pod};
use crate::rt::notifier::Notifier;

/// Buffers that a node has: below eight, one reader that keeps some starves all others.
const BUFFERS: std::ops::RangeInclusive<u32> = 8..=16;

/// A picture has no more bytes than this: PipeWire's numbers have 31 bits.
const LARGEST: usize = i32::MAX as usize;

/// What a node offers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NodeParams {
    /// Its name for programs (`node.name`); no other node should have it.
    pub name: String,
    /// Its name for people (`node.description`).
    pub description: String,
    /// Pixels; even.
    pub width: u32,
    /// Pixels; even.
    pub height: u32,
    /// Nominal time between pictures (seconds, numerator and denominator).
    pub interval: (u32, u32),
}

impl NodeParams {
    /// Bytes from one row to the next: YUY2 has two for each pixel.
    pub fn stride(&self) -> usize {
        2 * self.width as usize
    }

    /// Bytes of a picture.
    pub fn bytes(&self) -> usize {
        self.stride() * self.height as usize
    }
}

/// Why there is no node.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NodeError {
    /// No PipeWire daemon answers, or it ended the connection.
    #[error("PipeWire does not respond ({0}); it runs in the user's session: systemctl --user status pipewire")]
    Unreachable(String),
    /// The size has no place in PipeWire's numbers.
    #[error("PipeWire does not accept pictures of {0}x{1}")]
    Size(u32, u32),
    /// The library refused.
    #[error("PipeWire refused to {0}: {1}")]
    Refused(&'static str, String),
}

/// What a node is at.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum State {
    /// It is being made known.
    Connecting,
    /// Programs can see it; none watches.
    Paused,
    /// One program watches it, or several do.
    Streaming,
    /// PipeWire ended it, for this reason; it has to be made again.
    Lost(String),
}

/// A buffer of a node that may be drawn into.
#[derive(Clone, Debug)]
pub struct Slot {
    /// Its number; none has the number of one before it.
    pub id: u64,
    /// Its memory: a memfd of [`NodeParams::bytes`], its size sealed.
    pub fd: Arc<OwnedFd>,
}

/// A node. It goes when this is dropped.
#[derive(Debug)]
pub struct Node {
    library: &'static Library,
    thread: NonNull<Opaque>,
    stream: NonNull<Opaque>,
    shared: Arc<Shared>,
    sequence: u64,
}

// SAFETY: the library's objects may be used from any thread that holds the loop's lock, which every method here takes.
unsafe impl Send for Node {}

/// What the library's thread tells, and what it needs to answer.
#[derive(Debug)]
struct Shared {
    library: &'static Library,
    /// Null until the stream is made; the callbacks that need it come later.
    stream: AtomicPtr<Opaque>,
    bytes: usize,
    stride: usize,
    wake: Notifier,
    reported: Mutex<Reported>,
}

#[derive(Debug)]
struct Reported {
    state: State,
    slots: Vec<Known>,
    next: u64,
}

/// A buffer that the library has made known and not yet taken away.
#[derive(Debug)]
struct Known {
    id: u64,
    buffer: NonNull<PwBuffer>,
    fd: Arc<OwnedFd>,
    /// It was taken from the library, and not sent since.
    taken: bool,
}

// SAFETY: the pointer is followed only while the loop's lock is held, between add_buffer and remove_buffer, which come with that lock.
unsafe impl Send for Known {}

impl Shared {
    /// Never held while the library is called.
    fn reported(&self) -> MutexGuard<'_, Reported> {
        self.reported.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

static EVENTS: StreamEvents = StreamEvents {
    version: STREAM_EVENTS_VERSION,
    destroy: None,
    state_changed: Some(state_changed),
    control_info: None,
    io_changed: None,
    param_changed: Some(param_changed),
    add_buffer: Some(add_buffer),
    remove_buffer: Some(remove_buffer),
    process: None,
    drained: None,
    command: None,
    trigger_done: None,
};

impl Node {
    /// Makes the node known to PipeWire. `wake` is notified whenever [`Node::state`] or the buffers change.
    ///
    /// # Errors
    /// [`NodeError`]; where PipeWire does not run it may soon, so try again.
    pub fn new(library: &'static Library, params: &NodeParams, wake: &Notifier) -> Result<Self, NodeError> {
        if params.width == 0 || params.height == 0 || params.bytes() > LARGEST {
            return Err(NodeError::Size(params.width, params.height));
        }
        let shared = Arc::new(Shared {
            library,
            stream: AtomicPtr::new(null_mut()),
            bytes: params.bytes(),
            stride: params.stride(),
            wake: wake.clone(),
            reported: Mutex::new(Reported { state: State::Connecting, slots: Vec::new(), next: 0 }),
        });
        // SAFETY: the name ends in a zero; no properties are needed.
        let thread = unsafe { (library.thread_loop_new)(c"pipewire".as_ptr(), null()) };
        let Some(thread) = NonNull::new(thread) else { return Err(refused("make a thread", last_error())) };
        let stream = Self::stream(library, thread, params, &shared);
        let Some(stream) = NonNull::new(stream) else {
            let error = refused("make a stream", last_error());
            // SAFETY: made above, not started, and nothing uses it.
            unsafe { (library.thread_loop_destroy)(thread.as_ptr()) };
            return Err(error);
        };
        shared.stream.store(stream.as_ptr(), Ordering::Release);
        let node = Self { library, thread, stream, shared, sequence: 0 };
        node.connect(params)?;
        Ok(node)
    }

    /// A stream with its properties and callbacks; null where the library refuses.
    fn stream(library: &Library, thread: NonNull<Opaque>, params: &NodeParams, shared: &Shared) -> *mut Opaque {
        let properties = properties(params);
        let items: Vec<DictItem> =
            properties.iter().map(|(key, value)| DictItem { key: key.as_ptr(), value: value.as_ptr() }).collect();
        let dict = Dict { flags: 0, count: items.len() as u32, items: items.as_ptr() };
        let name = text(&params.name);
        // SAFETY: the dictionary and its texts live until the call ends, and the library copies them. The stream takes the properties.
        // EVENTS is static. `shared` does not move and outlives the stream: Node lets it go after the stream was destroyed.
        unsafe {
            let properties = (library.properties_new_dict)(&raw const dict);
            let data = std::ptr::from_ref(shared).cast_mut().cast();
            let pw_loop = (library.thread_loop_get_loop)(thread.as_ptr());
            (library.stream_new_simple)(pw_loop, name.as_ptr(), properties, &raw const EVENTS, data)
        }
    }

    fn connect(&self, params: &NodeParams) -> Result<(), NodeError> {
        // SAFETY: the loop was made and not started yet.
        let started = unsafe { (self.library.thread_loop_start)(self.thread.as_ptr()) };
        if started < 0 {
            return Err(refused("start its thread", std::io::Error::from_raw_os_error(-started)));
        }
        let rate = (params.interval.1.max(1), params.interval.0.max(1));
        let format = pod::format(params.width, params.height, rate);
        let pods = [format.as_ptr()];
        let flags = FLAG_DRIVER | FLAG_RT_PROCESS | FLAG_ALLOC_BUFFERS;
        let _lock = self.lock();
        // SAFETY: the lock is held; the parameter lives until the call ends, and the library copies it.
        let connected =
            unsafe { (self.library.stream_connect)(self.stream.as_ptr(), DIRECTION_OUTPUT, ID_ANY, flags, pods.as_ptr(), 1) };
        if connected < 0 {
            return Err(NodeError::Unreachable(std::io::Error::from_raw_os_error(-connected).to_string()));
        }
        Ok(())
    }

    /// What it is at.
    pub fn state(&self) -> State {
        self.shared.reported().state.clone()
    }

    /// Whether the library still has that buffer.
    pub fn has(&self, id: u64) -> bool {
        self.shared.reported().slots.iter().any(|known| known.id == id)
    }

    /// A buffer to draw into; `None` where readers use all of them.
    pub fn dequeue(&mut self) -> Option<Slot> {
        let _lock = self.lock();
        // SAFETY: the lock is held and the stream lives.
        let buffer = NonNull::new(unsafe { (self.library.stream_dequeue_buffer)(self.stream.as_ptr()) })?;
        let mut reported = self.shared.reported();
        let known = reported.slots.iter_mut().find(|known| known.buffer == buffer)?;
        known.taken = true;
        Some(Slot { id: known.id, fd: known.fd.clone() })
    }

    /// Sends the buffer of that number, which was taken and drawn into, with a picture of the time `time_ns` (CLOCK_MONOTONIC,
    /// nanoseconds). Nothing happens where the library took it away meanwhile; says whether it was sent.
    pub fn send(&mut self, id: u64, time_ns: i64) -> bool {
        self.sequence += 1;
        let _lock = self.lock();
        let found = {
            let mut reported = self.shared.reported();
            let known = reported.slots.iter_mut().find(|known| known.id == id && known.taken);
            known.map(|known| {
                known.taken = false;
                known.buffer
            })
        };
        let Some(buffer) = found else { return false };
        // SAFETY: the lock is held, so the buffer is still the library's: remove_buffer takes it off the list before it is freed.
        unsafe {
            describe(buffer, self.shared.bytes, self.shared.stride, time_ns, self.sequence);
            (self.library.stream_queue_buffer)(self.stream.as_ptr(), buffer.as_ptr());
            (self.library.stream_trigger_process)(self.stream.as_ptr());
        }
        true
    }

    /// Declares every buffer that was not taken free of readers: one that was killed, or keeps what it got, leaves its buffers
    /// counted as in use forever.
    pub fn forget_readers(&mut self) {
        let _lock = self.lock();
        for known in &self.shared.reported().slots {
            // SAFETY: the lock is held and the buffer is on the list; the count is shared with other processes and only used atomically.
            if let Some(count) = unsafe { busy(known.buffer) } {
                count.store(u32::from(known.taken), Ordering::Relaxed);
            }
        }
    }

    fn lock(&self) -> Locked<'_> {
        // SAFETY: the loop lives as long as the node; its lock may be taken again by the thread that has it.
        unsafe { (self.library.thread_loop_lock)(self.thread.as_ptr()) };
        Locked(self)
    }
}

impl Drop for Node {
    fn drop(&mut self) {
        {
            let _lock = self.lock();
            // SAFETY: the lock is held; the stream is not used after this.
            unsafe { (self.library.stream_destroy)(self.stream.as_ptr()) };
        }
        // SAFETY: stopped without the lock, as the library asks, then destroyed; its thread ends before `shared` goes.
        unsafe {
            (self.library.thread_loop_stop)(self.thread.as_ptr());
            (self.library.thread_loop_destroy)(self.thread.as_ptr());
        }
    }
}

/// The loop's lock.
struct Locked<'a>(&'a Node);

impl Drop for Locked<'_> {
    fn drop(&mut self) {
        // SAFETY: taken by Node::lock in this thread.
        unsafe { (self.0.library.thread_loop_unlock)(self.0.thread.as_ptr()) };
    }
}

/// Writes beside a buffer's memory how much of it is valid, and the picture's time and number.
///
/// # Safety
/// The buffer must be the library's and taken from it, and the loop's lock held.
unsafe fn describe(buffer: NonNull<PwBuffer>, bytes: usize, stride: usize, time_ns: i64, sequence: u64) {
    // SAFETY: the caller promises a live buffer; the library gives each a spa_buffer, and each block a chunk, when it makes it known.
    unsafe {
        let spa = (*buffer.as_ptr()).buffer;
        if (*spa).data_count > 0 {
            let chunk = (*(*spa).datas).chunk;
            *chunk = Chunk { offset: 0, size: bytes as u32, stride: stride as i32, flags: 0 };
        }
        if let Some(header) = meta(buffer, META_HEADER, size_of::<Header>()) {
            *header.cast::<Header>().as_ptr() = Header { flags: 0, offset: 0, pts: time_ns, dts_offset: 0, seq: sequence };
        }
    }
}

/// The count of a buffer's users, where there is one.
///
/// # Safety
/// As for [`describe`].
unsafe fn busy<'a>(buffer: NonNull<PwBuffer>) -> Option<&'a AtomicU32> {
    // SAFETY: as the caller promises; the metadata is a spa_meta_busy, aligned to eight, in memory shared with the readers.
    unsafe {
        let busy = meta(buffer, META_BUSY, size_of::<Busy>())?.cast::<Busy>();
        Some(AtomicU32::from_ptr(&raw mut (*busy.as_ptr()).count))
    }
}

/// A buffer's metadata of that kind, if it is as large.
///
/// # Safety
/// As for [`describe`].
unsafe fn meta(buffer: NonNull<PwBuffer>, kind: u32, size: usize) -> Option<NonNull<c_void>> {
    // SAFETY: as the caller promises; `metas` has `meta_count` elements.
    unsafe {
        let spa = (*buffer.as_ptr()).buffer;
        let metas = (0..(*spa).meta_count as usize).map(|index| (*spa).metas.add(index));
        let found = metas.into_iter().find(|&meta| (*meta).kind == kind && (*meta).size as usize >= size)?;
        NonNull::new((*found).data)
    }
}

/// # Safety
/// For the library alone, which gives back the `data` of the stream: a [`Shared`] that outlives it.
unsafe extern "C" fn state_changed(data: *mut c_void, _: c_int, state: c_int, error: *const c_char) {
    // SAFETY: as said above; the error is null or a text that ends in a zero.
    let (shared, error) = unsafe { (&*data.cast::<Shared>(), error.as_ref().map(|text| CStr::from_ptr(text))) };
    let why = || error.map_or_else(|| "it closed the connection".into(), |text| text.to_string_lossy().into_owned());
    let state = match state {
        STATE_ERROR => State::Lost(why()),
        STATE_UNCONNECTED => State::Lost(why()),
        STATE_PAUSED => State::Paused,
        STATE_STREAMING => State::Streaming,
        _ => State::Connecting,
    };
    let mut reported = shared.reported();
    // What is lost stays so: the first reason is the true one.
    if !matches!(reported.state, State::Lost(_)) {
        reported.state = state;
    }
    drop(reported);
    shared.wake.notify();
}

/// Answers an agreed format with what the buffers should be.
///
/// # Safety
/// As for [`state_changed`].
unsafe extern "C" fn param_changed(data: *mut c_void, id: u32, param: *const c_void) {
    if id != pod::PARAM_FORMAT || param.is_null() {
        return;
    }
    // SAFETY: as said above.
    let shared = unsafe { &*data.cast::<Shared>() };
    let pods: [Pod; 2] =
        [pod::buffers(BUFFERS, shared.bytes as u32, shared.stride as u32), pod::meta(META_HEADER, size_of::<Header>())];
    let pointers = [pods[0].as_ptr(), pods[1].as_ptr()];
    let stream = shared.stream.load(Ordering::Acquire);
    if !stream.is_null() {
        // SAFETY: called by the library's thread, which holds the lock; the parameters live until the call ends.
        unsafe { (shared.library.stream_update_params)(stream, pointers.as_ptr(), 2) };
    }
}

/// Gives a new buffer its memory.
///
/// # Safety
/// As for [`state_changed`]; the buffer stays until [`remove_buffer`].
unsafe extern "C" fn add_buffer(data: *mut c_void, buffer: *mut PwBuffer) {
    // SAFETY: as said above.
    let shared = unsafe { &*data.cast::<Shared>() };
    let Some(buffer) = NonNull::new(buffer) else { return };
    let Ok(fd) = memory(shared.bytes) else { return };
    // SAFETY: a new buffer has its spa_buffer, and with ALLOC_BUFFERS its blocks are ours to fill.
    unsafe {
        let spa = (*buffer.as_ptr()).buffer;
        if (*spa).data_count == 0 {
            return;
        }
        let block = &mut *(*spa).datas;
        block.kind = DATA_MEM_FD;
        block.flags = DATA_READABLE | DATA_WRITABLE | DATA_MAPPABLE;
        block.fd = i64::from(fd.as_raw_fd());
        block.map_offset = 0;
        block.max_size = shared.bytes as u32;
        block.data = null_mut();
    }
    let mut reported = shared.reported();
    reported.next += 1;
    let id = reported.next;
    reported.slots.push(Known { id, buffer, fd: Arc::new(fd), taken: false });
    drop(reported);
    shared.wake.notify();
}

/// # Safety
/// As for [`state_changed`].
unsafe extern "C" fn remove_buffer(data: *mut c_void, buffer: *mut PwBuffer) {
    // SAFETY: as said above.
    let shared = unsafe { &*data.cast::<Shared>() };
    shared.reported().slots.retain(|known| known.buffer.as_ptr() != buffer);
    shared.wake.notify();
}

/// Memory for a picture that can be shared: the process that gets it cannot change its size.
fn memory(bytes: usize) -> Result<OwnedFd, rustix::io::Errno> {
    let fd = memfd_create(c"gimbald-picture", MemfdFlags::CLOEXEC | MemfdFlags::ALLOW_SEALING)?;
    ftruncate(&fd, bytes as u64)?;
    fcntl_add_seals(&fd, SealFlags::SHRINK | SealFlags::GROW | SealFlags::SEAL)?;
    Ok(fd)
}

/// What programs look for in a camera. A property for each line that `pw-dump` shows.
fn properties(params: &NodeParams) -> Vec<(CString, CString)> {
    [
        ("media.class", "Video/Source"),
        ("media.role", "Camera"),
        ("media.type", "Video"),
        ("media.category", "Capture"),
        ("node.name", &params.name),
        ("node.description", &params.description),
    ]
    .into_iter()
    .map(|(key, value)| (text(key), text(value)))
    .collect()
}

/// A text for the library; what follows a zero is cut off.
fn text(text: &str) -> CString {
    CString::new(text.split('\0').next().unwrap_or("")).unwrap_or_default()
}

fn refused(doing: &'static str, error: std::io::Error) -> NodeError {
    NodeError::Refused(doing, error.to_string())
}

fn last_error() -> std::io::Error {
    std::io::Error::last_os_error()
}
