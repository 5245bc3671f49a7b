//! Real drivers: the kernel's test camera (vivid) and v4l2loopback. Runs where both are there, as root (`tests/vm/run` makes a
//! virtual machine that has them); elsewhere each test says that it is skipped.

mod camera;
mod loopback;
mod rig;

use assert_no_alloc::AllocDisabler;

#[global_allocator]
static ALLOCATOR: AllocDisabler = AllocDisabler;
