//! Pictures for programs outside the daemon: shared memory that a companion in a user's session lends, and the socket between both.
//!
//! The daemon is a system service that knows nothing of desktops; the companion (`gimbald pipewire`) has the user's rights and knows
//! nothing of cameras. The companion owns the memory (memfds of one picture each), because it is also the memory of the desktop's
//! readers, and lends it to the daemon, which draws the stabilized picture straight into it. Nothing is copied on the way.
//!
//! # The protocol
//!
//! The socket is of type SOCK_SEQPACKET: messages have ends. The daemon listens at [`socket_paths`]; every user may connect.
//!
//! | from | message | with |
//! |---|---|---|
//! | daemon | `Format`: size, interval, the camera's node (empty where there is no camera) | |
//! | companion | `Watch`: whether a program watches, whether it wants the output alone or the input too, and in which size | the camera's node, opened to read and write |
//! | companion | `Lend`: a new piece of memory, its number | the memfd |
//! | companion | `Free`: the piece of that number may be drawn into (again) | |
//! | companion | `Revoke`: the piece of that number is gone | |
//! | daemon | `Frame`: the piece of that number holds a picture, taken then | |
//! | daemon | `Refused`: why no pictures come | |
//!
//! Companions for PipeWire take the output. `gimbald view` takes both pictures and a description of each frame ([`Pair`]), 12 times a
//! second at most: it lends one piece of memory, and frees it when its next picture is due.
//!
//! # Who gets pictures
//!
//! Users who may open the camera. A companion proves that its user may with a descriptor of the camera's node that it opened to read
//! and write: the kernel has then checked its rights (group, or the list that logind keeps for the user at the desk). It is asked for with each `Watch`, so
//! rights that were lost count from the next one on, as they would for a program that has the camera open itself.
//!
//! # What a hostile companion can do
//!
//! Get nothing it could not get from the camera. Memory is taken only where its size is sealed, so it cannot shrink under the daemon; what
//! it holds is never read. Messages that are not understood end the connection. The socket is never waited for: a frame for which there is
//! no free memory, or no room in the socket, is dropped for that companion alone. Connections, pieces of memory and their size are limited.

mod client;
mod connection;
mod frame_info;
mod lease;
mod memory;
mod pair;
mod proof;
mod server;
mod wire;

pub use client::{Client, Heard};
pub(crate) use frame_info::FrameInfo;
pub use lease::Outlet;
pub use memory::Memory;
pub use pair::{Inspector, Pair};
pub(crate) use server::socket_paths;
pub use server::{Companions, Server};
pub use wire::{Format, Refusal};

/// The format of every shared picture. It is the one that every reader of PipeWire cameras takes.
pub const PIXEL: crate::image::PixelFormat = crate::image::PixelFormat::Yuyv;
