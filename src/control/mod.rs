//! What people say to a daemon that runs, and what it tells them: settings, counts, a socket.
//!
//! A [`Desk`] is shared by all threads of a daemon. The frame path writes its [`Tally`] (atomic numbers alone) and looks at its
//! [`Live`](crate::pipeline::Live) settings; everything else happens on the [`Server`]'s thread.
//!
//! # Protocol
//! A Unix stream socket. A request is one line of at most [`LONGEST_REQUEST`] bytes; its answer is one line of JSON, an object
//! whose `ok` says whether it was done. Any number of requests may follow one another, each after the answer before.
//!
//! | request | answer, beside `"ok": true` |
//! |---|---|
//! | `status` | `status`: a [`Status`] |
//! | `prometheus` | `text`: the same for Prometheus |
//! | `on`, `off` | as `set` |
//! | `set KEY=VALUE` | `changed`: keys that have a new value; `restart`: keys that wait for a restart |
//! | `reload` | the same, after reading the configuration file anew |
//!
//! What cannot be done is answered `{"ok": false, "error": "..."}`. Who says nothing for a while, does not take his answers, or
//! asks without end of line, is hung up on.

mod client;
mod desk;
mod exposition;
mod request;
mod server;
mod socket;
mod status;
mod tally;

pub use client::{ClientError, Connection};
pub use desk::{Applied, Desk, Reread};
pub use request::LONGEST_REQUEST;
pub use server::{Rules, Server};
pub use socket::{Place, default_paths};
pub use status::{CameraNow, Drops, FormatLeft, Found, Frames, OutputNow, Spread, Status, Unusable};
pub use tally::{Lost, State, Tally};
