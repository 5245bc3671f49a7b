//! The structures of libpipewire and its plugin interface (SPA) that are shared with the library, as its headers lay them out.
//!
//! Only what is used has a name. The sizes and offsets are those of the 64-bit headers of 0.3.65 and 1.4; they belong to the library's
//! stable interface.

use std::ffi::{c_char, c_int, c_void};
use std::mem::{offset_of, size_of};

/// An object of the library that is only ever pointed to.
#[repr(C)]
pub(super) struct Opaque {
    _private: [u8; 0],
}

/// `struct spa_dict_item`.
#[repr(C)]
pub(super) struct DictItem {
    pub(super) key: *const c_char,
    pub(super) value: *const c_char,
}

/// `struct spa_dict`.
#[repr(C)]
pub(super) struct Dict {
    pub(super) flags: u32,
    pub(super) count: u32,
    pub(super) items: *const DictItem,
}

/// `struct spa_chunk`: the valid part of a block, set for each picture.
#[repr(C)]
pub(super) struct Chunk {
    pub(super) offset: u32,
    pub(super) size: u32,
    pub(super) stride: i32,
    pub(super) flags: i32,
}

/// `struct spa_data`: a block of memory.
#[repr(C)]
pub(super) struct Data {
    pub(super) kind: u32,
    pub(super) flags: u32,
    pub(super) fd: i64,
    pub(super) map_offset: u32,
    pub(super) max_size: u32,
    pub(super) data: *mut c_void,
    pub(super) chunk: *mut Chunk,
}

/// `struct spa_meta`: what is said beside a buffer's memory.
#[repr(C)]
pub(super) struct Meta {
    pub(super) kind: u32,
    pub(super) size: u32,
    pub(super) data: *mut c_void,
}

/// `struct spa_buffer`.
#[repr(C)]
pub(super) struct SpaBuffer {
    pub(super) meta_count: u32,
    pub(super) data_count: u32,
    pub(super) metas: *mut Meta,
    pub(super) datas: *mut Data,
}

/// The beginning of `struct pw_buffer`, which later versions make longer.
#[repr(C)]
pub(super) struct PwBuffer {
    pub(super) buffer: *mut SpaBuffer,
    pub(super) user_data: *mut c_void,
    pub(super) size: u64,
}

/// `struct spa_meta_header`: a picture's time and number.
#[repr(C)]
pub(super) struct Header {
    pub(super) flags: u32,
    pub(super) offset: u32,
    /// Nanoseconds on CLOCK_MONOTONIC.
    pub(super) pts: i64,
    pub(super) dts_offset: i64,
    pub(super) seq: u64,
}

/// `struct spa_meta_busy`: how many use a buffer; counted up and down by every process that has it mapped.
#[repr(C)]
pub(super) struct Busy {
    pub(super) flags: u32,
    pub(super) count: u32,
}

/// `struct pw_stream_events`, version 2.
#[repr(C)]
pub(super) struct StreamEvents {
    pub(super) version: u32,
    pub(super) destroy: Option<unsafe extern "C" fn(*mut c_void)>,
    pub(super) state_changed: Option<unsafe extern "C" fn(*mut c_void, c_int, c_int, *const c_char)>,
    pub(super) control_info: Option<unsafe extern "C" fn(*mut c_void, u32, *const c_void)>,
    pub(super) io_changed: Option<unsafe extern "C" fn(*mut c_void, u32, *mut c_void, u32)>,
    pub(super) param_changed: Option<unsafe extern "C" fn(*mut c_void, u32, *const c_void)>,
    pub(super) add_buffer: Option<unsafe extern "C" fn(*mut c_void, *mut PwBuffer)>,
    pub(super) remove_buffer: Option<unsafe extern "C" fn(*mut c_void, *mut PwBuffer)>,
    pub(super) process: Option<unsafe extern "C" fn(*mut c_void)>,
    pub(super) drained: Option<unsafe extern "C" fn(*mut c_void)>,
    pub(super) command: Option<unsafe extern "C" fn(*mut c_void, *const c_void)>,
    pub(super) trigger_done: Option<unsafe extern "C" fn(*mut c_void)>,
}

pub(super) const STREAM_EVENTS_VERSION: u32 = 2;

/// `enum spa_data_type`: memory behind a descriptor.
pub(super) const DATA_MEM_FD: u32 = 2;
/// Flags of [`Data`]: readable, writable; and mappable, which versions since 1.2 want to be told.
pub(super) const DATA_READABLE: u32 = 1;
pub(super) const DATA_WRITABLE: u32 = 2;
pub(super) const DATA_MAPPABLE: u32 = 8;

/// `enum spa_meta_type`.
pub(super) const META_HEADER: u32 = 1;
pub(super) const META_BUSY: u32 = 7;

/// `enum pw_stream_state`.
pub(super) const STATE_ERROR: c_int = -1;
pub(super) const STATE_UNCONNECTED: c_int = 0;
pub(super) const STATE_PAUSED: c_int = 2;
pub(super) const STATE_STREAMING: c_int = 3;

/// `enum pw_stream_flags`.
pub(super) const FLAG_DRIVER: c_int = 1 << 3;
pub(super) const FLAG_RT_PROCESS: c_int = 1 << 4;
pub(super) const FLAG_ALLOC_BUFFERS: c_int = 1 << 8;

/// `enum spa_direction`: a source's.
pub(super) const DIRECTION_OUTPUT: c_int = 1;

/// `PW_ID_ANY`.
pub(super) const ID_ANY: u32 = u32::MAX;

const _: () = {
    assert!(size_of::<DictItem>() == 16 && size_of::<Dict>() == 16 && offset_of!(Dict, items) == 8);
    assert!(size_of::<Chunk>() == 16);
    assert!(size_of::<Data>() == 40 && offset_of!(Data, fd) == 8 && offset_of!(Data, max_size) == 20);
    assert!(offset_of!(Data, data) == 24 && offset_of!(Data, chunk) == 32);
    assert!(size_of::<Meta>() == 16 && offset_of!(Meta, data) == 8);
    assert!(size_of::<SpaBuffer>() == 24 && offset_of!(SpaBuffer, metas) == 8 && offset_of!(SpaBuffer, datas) == 16);
    assert!(offset_of!(PwBuffer, user_data) == 8 && offset_of!(PwBuffer, size) == 16);
    assert!(size_of::<Header>() == 32 && offset_of!(Header, pts) == 8 && offset_of!(Header, seq) == 24);
    assert!(size_of::<Busy>() == 8 && offset_of!(Busy, count) == 4);
    assert!(size_of::<StreamEvents>() == 96 && offset_of!(StreamEvents, param_changed) == 40);
    assert!(offset_of!(StreamEvents, add_buffer) == 48 && offset_of!(StreamEvents, trigger_done) == 88);
};
