//! The socket of a daemon that runs: requests and replies, clients who behave badly, and its place in the file system.

mod answers;
mod crowd;
mod daemon;
mod place;
mod rig;
