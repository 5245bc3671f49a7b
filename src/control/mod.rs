//! Control of a running daemon: requests and replies over a socket, settings, counters.
//!
//! A [`DaemonState`] is shared by all threads of a daemon. The frame path writes its [`Metrics`] (atomic numbers alone) and looks at its
//! [`Live`](crate::pipeline::Live) settings. Requests are answered on the [`Server`]'s thread, which waits for no client and for no
//! file: the configuration is read on a thread of its own ([`DaemonState::reload_soon`]).
//!
//! # Protocol
//! A Unix stream socket. A request is one line of UTF-8 text, at most [`LONGEST_REQUEST`] bytes and a line end (`\n`, or `\r\n`). Its
//! reply is one line of JSON. Any number of requests may follow one another on a connection; replies come in their order.
//!
//! | request, in words | the same as JSON ([`Request`]) | reply ([`Reply`]), beside `"ok": true` |
//! |---|---|---|
//! | `status` | `"status"` | `status`: an object, a [`Status`] |
//! | `prometheus` | `"prometheus"` | `text`: the same in Prometheus' text format, version 0.0.4 |
//! | `history NUMBER` | `{"history": NUMBER}` | `history`: up to 200 [`FrameRecord`]s from this frame number on, and the number to ask for `next`; 0 begins with the oldest that is kept, about a minute ago |
//! | `on`, `off` | `"on"`, `"off"` | as `set` |
//! | `set KEY=VALUE` | `{"set": "KEY=VALUE"}` | `changed`: keys that have a new value; `restart`: keys that wait for a restart |
//! | `reload` | `"reload"` | the same, after reading the configuration file again |
//!
//! What cannot be done is answered `{"ok": false, "error": "...", "kind": "..."}`: `error` is for people, `kind` is a
//! [`RefusalKind`]: `request`, `setting`, `configuration`, `late`, or `busy`, after which the daemon hangs up. Later versions may add
//! fields and kinds, and clients should pass over those that they do not know. A client that is hung up on may connect again.
//!
//! ```sh
//! echo status | socat -t 5 - UNIX-CONNECT:/run/gimbald/control.sock
//! ```
//!
//! # Limits
//! [`Limits`] has them all. A connection may ask 20 requests a second (40 at once after a rest), a process 50, a user 100; what is asked
//! beyond that waits, and who has asked least goes first. There are 64 places, 16 of them for root and the daemon's own user alone; a
//! user has at most 32 and a process 16. Where they are taken, a newcomer displaces a connection of the process with most of them: one
//! that asks too much, or the one that has been idle longest. A connection that asks nothing for a minute is ended, and so is one whose
//! request takes more than ten seconds to arrive, or that takes its reply no faster. The log has ten lines a second about all this at
//! most, and counts the others.

mod answer;
mod client;
mod daemon_state;
mod exposition;
mod folder;
mod history;
mod log_limiter;
mod metrics;
mod quotas;
mod reload;
mod reply;
pub(crate) mod request;
mod server;
mod session;
mod socket;
mod status;
mod token_bucket;

pub(crate) use client::ClientError;
pub use client::Connection;
pub use daemon_state::{Applied, DaemonState, Reread};
pub(crate) use history::FrameRecord;
pub use history::HistoryPart;
pub(crate) use metrics::Losses;
pub use metrics::{Metrics, Phase};
pub use quotas::Limits;
pub use reply::{Refusal, RefusalKind, Reply};
pub(crate) use request::{Assignment, RequestError};
pub use request::{FrameNumber, LONGEST_REQUEST, Request};
pub use server::Server;
pub use socket::BoundSocket;
pub(crate) use socket::default_paths;
pub use status::{CameraInfo, OutputInfo, PipewireInfo, Spread, Status};
pub(crate) use status::{Drops, Found, Frames, RejectedFormat, Unusable};
pub use token_bucket::Rate;

/// Does what a client asks, and gives its reply.
#[cfg(feature = "fuzzing")]
pub fn fuzz_reply(request: &Request, state: &DaemonState) -> Reply {
    answer::answer(request, state, "the fuzzer")
}
