//! Video files of any kind, through the programs `ffmpeg` and `ffprobe` where they are installed.
//!
//! `ffprobe` says what a file holds ([`Origin`]), one `ffmpeg` decodes its pictures into a pipe ([`FfmpegSource`]), another encodes
//! what is made of them ([`FfmpegSink`]) and takes the sound from the file that the pictures came from.
//!
//! - Each picture keeps its time, on the file's own clock. Most containers round times: Matroska and WebM to milliseconds, MP4 here to
//!   1/60000 s; AVI has one rate.
//! - Pictures travel with 8 bits a sample, limited range, in the matrix that the file names, which the output names again. Interlaced
//!   frames are deinterlaced.
//! - A file that says to be shown turned by 90, 180 or 270 degrees, as a phone's, is stabilized as its sensor read it, in rows; the
//!   output is turned when it is encoded.
//! - Only files are opened (no network), and none that lists other files, as playlists do.
//! - What ffmpeg reports goes into gimbald's messages. It runs in a process group of its own: Ctrl-C ends gimbald's work first, and the
//!   file is finished.

mod origin;
mod program;
mod sink;
mod source;

pub use origin::Origin;
pub(crate) use origin::Turn;
pub(crate) use program::is_installed;
pub(crate) use sink::FfmpegSink;
pub(crate) use source::FfmpegSource;
