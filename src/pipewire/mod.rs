//! A camera node in PipeWire: libpipewire, opened at run time, behind an interface without `unsafe`.
//!
//! gimbald is one program for machines with PipeWire and without: it does not link the library but opens it when a node is made
//! ([`Library::open`]), and says what is missing. What is used of the library has been the same since version 0.3.40; the layouts of
//! its structures, in `layout`, are checked when this is compiled.
//!
//! A [`Node`] is a *driver*: PipeWire does not ask it for pictures, it sends one whenever it has one, and every reader maps the same
//! memory. It has exactly one format (browsers ignore nodes with several, and the first reader's choice would bind the others).

mod layout;
mod library;
mod node;
mod pod;

pub use library::{Library, Missing};
pub use node::{Node, NodeParams, Slot, State};
