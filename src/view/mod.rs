//! The page of `gimbald view`: what it shows of a daemon or a recording, and the web server that browsers get it from.
//!
//! The server belongs to this command and listens on the loopback interface only; the daemon opens no port.
//!
//! | request, below `/TOKEN/` | answer |
//! |---|---|
//! | `GET` (nothing) | the page: one file with its style and script |
//! | `GET about` | JSON: what is shown, the settings with range and meaning, the names of the path's axes |
//! | `GET state` | JSON: the daemon's status or the recording's position, and the values of the settings |
//! | `GET preview?seen=N&since=M` | the newest picture after number N: length of the JSON (`u32`), JSON (all frames after frame M), JPEG (output above input); 204 if there is none |
//! | `POST set` with `KEY=VALUE` | changes a setting |
//! | `POST play` with `play`, `pause`, `seek SECONDS`, `loop`, `once` | controls a recording |
//! | `POST write` with lines of `KEY=VALUE` | writes settings to the configuration file |
//!
//! # Access
//! A request needs the token: 128 random bits in the address, new for each start. It must name this server as its `Host` (so a foreign
//! name that resolves to the loopback address does not help another site), and requests of a page must come from this server's own page
//! (`Origin`, `Sec-Fetch-Site`). Answers are not cached, not shown in frames, and not readable for other origins.

mod access;
mod backend;
mod config_file;
mod daemon;
mod preview;
mod recording;
mod server;
mod shots;

pub use backend::Backend;
pub use daemon::DaemonBackend;
pub use recording::RecordingBackend;
pub use server::Server;
pub use shots::take_pictures;
