//! A software gimbal for Linux webcams: removes camera shake and rolling-shutter distortion, live or from recordings.
//!
//! This page is the plan of the code: what belongs where, what everything means, and what never happens. `tests/house.rs` checks the
//! floors; `docs/how-it-works.md` describes the algorithm; `CONTRIBUTING.md` lists where to find what.
//!
//! # Floors
//! A module may use modules on lower floors only. Those on one floor do not use each other.
//!
//! ```text
//!  9  command                                       the commands of the program: arguments, texts, exit codes
//!  8  daemon | companion | view                     the service: devices, recovery, watchdog | its part in a user's session | the page
//!  7  report                                        traces and the HTML reports
//!  6  control                                       status, metrics, history, control socket
//!  5  log                                           the log
//!  4  config | share | systemd                      settings | pictures for other processes | the service manager
//!  3  pipeline                                      the journey of a frame: which stage is next, who owns the frame
//!  2  stage | device | pipewire                     algorithms | cameras, outputs, files | PipeWire's library
//!  1  kernel | frame                                loops over pixels, the only SIMD | a frame and what is known of it
//!  0  geometry | image | random | rt                points, rotations | pixels in memory | seeded numbers | clock, wake-ups
//! ```
//!
//! # The journey of a frame
//! [`device::FrameSource`] lends the camera's bytes. [`stage::unpack`] decodes them, [`stage::timing`] judges the time stamp,
//! [`stage::pyramid`], [`stage::detect`] and [`stage::track`] follow points from the previous frame, [`stage::shutter`] turns these tracks
//! into the camera's motion, row by row, [`stage::smooth`] plans the virtual camera's path within the crop margin ([`stage::crop`]), and
//! [`stage::warp`] draws into the canvas that [`device::FrameSink`] lends. [`pipeline::Stabilizer`] has these steps in order, and
//! [`frame::FrameContext`] collects their results in the same order.
//!
//! # Conventions
//! - **Pixels**: centres are at whole numbers, (0, 0) is the centre of the top-left pixel, x points right, y down. Points are `[x, y]`.
//! - **Camera**: a pinhole; rays are (x, y, 1) with z forward. A pose ([`geometry::Pose`]) is yaw about y, pitch about x, roll about z (radians, right-hand
//!   rule, from camera to scene), and log zoom. A camera that yaws by a positive angle looks further right, and its picture moves left.
//! - **Maps** go from the output to the input: for each output pixel, where it is seen in the camera's picture.
//! - **Units** are in the names: `_s`, `_ms`, `_ns`, `_px`, `_deg`, `_hz`. Settings use ms and degrees, the code seconds and radians.
//! - **Uncertainties** are standard deviations ([`geometry::Estimate`]); what is shown to users is two of them.
//! - **Time stamp** ([`frame::Stamp::time_ns`]): when the row that is read first was exposed: the top row, or the bottom row where the
//!   readout is negative. CLOCK_MONOTONIC for cameras; only differences matter.
//! - **Readout time**: the time in which all H rows of a frame are read. Row y (0 to H) is exposed `readout · y / H` after the top row;
//!   negative where the sensor is read from bottom to top. 0 is a global shutter.
//! - **Reference time** of a frame: the moment for which its pose is given. The middle row's exposure in [`stage::shutter::continuous`],
//!   the first row's in [`stage::paper`], which follows its paper in this.
//! - **Interval**: the time between the time stamps of two frames, after [`stage::timing`] has judged them; the only place that does.
//!
//! # Threads of the service
//! | thread | owns | waits for |
//! |---|---|---|
//! | main | supervisor, output; while streaming, all stages but decoding | decoded frames; viewers, devices, a stop request |
//! | `capture` | while streaming, the camera and the decoder | the camera |
//! | `signals` | nothing | SIGTERM, SIGINT, SIGHUP |
//! | `watchdog` | nothing; reads the heartbeat | a quarter of systemd's watchdog interval |
//! | `control` | the control socket and its connections | requests |
//! | `pictures` | the socket for PipeWire companions and pages | companions, pages |
//! | `cameras` | the list of connected cameras | changes in /dev |
//! | `viewers` | the viewer counts | v4l2loopback's events, companions |
//!
//! `opening`, `reload` and `closing` exist only while a camera is opened, the configuration is read, or shared memory is released. Frames
//! travel between `capture` and main in bounded channels; if main is late, the oldest frame is dropped, so latency never builds up.
//!
//! # What never happens
//! - On the frame path, after the first frames: no allocation, no lock that is held elsewhere for long, no log line, and no system call
//!   beyond what V4L2 needs (`tests/no_allocation.rs`).
//! - The algorithms ([`stage`]) open no files, start no threads and read no clock: the same input gives the same output, to the bit, at
//!   every SIMD level (`tests/golden.rs`).
//! - A damaged frame is never an error and never silent: it is counted with its reason, and a usable picture is shown instead.
//! - The correction never jumps: where the motion is unknown it fades.
//! - `unsafe` exists only in `device::v4l2`, `kernel`, `pipewire` and `share::memory`.
//! - The service opens no network connection. Only `gimbald view` listens, on the loopback interface.
//!
//! # Public interface
//! gimbald is a program. Its library exists so that the program's tests, benchmarks, examples and fuzz targets reach its parts; nothing in
//! it is a stable interface. What they do not use is private to the crate: all of `companion`, `daemon`, `log`, `pipewire`, `report` and
//! `view`, and parts of other modules; `cargo doc --document-private-items` shows them. Stable are the command line, the exit codes, the configuration file, the JSON of `gimbald status`, the names of the
//! Prometheus metrics, and the requests of the control socket ([`control`]).
//!
//! # Glossary
//! | word | meaning |
//! |---|---|
//! | camera path | pose of the real camera over time |
//! | virtual camera | the steady camera whose picture is shown; its path minus the camera path is the *correction* |
//! | crop margin | the part of the picture that `crop.zoom` hides, and that corrections may use; *crop use* is the share in use |
//! | confidence | how reliable one frame's motion is, 0 to 1 |
//! | gain | what multiplies a correction, 0 to 1; all are in [`stage::gains`] |
//! | trust | weight of the correction, 0 to 1: follows the confidence slowly |
//! | presence | the same for switching on and off |
//! | track | a point seen in two frames; an *inlier* agrees with the camera's motion |
//! | held | the previous picture shown again in place of an unusable frame |
//! | passed through | shown without correction |
//! | viewer | a program that streams from the virtual camera |
//! | companion | `gimbald pipewire`: offers the pictures in a user's session |
//! | page | `gimbald view`: shows input, output and settings in a browser |
//! | placeholder | the picture that viewers see while there is none from the camera |
//! | calibration | readout time, field of view and lens distortion of a camera |

pub mod command;
mod companion;
pub mod config;
pub mod control;
mod daemon;
pub mod device;
pub mod frame;
pub mod geometry;
pub mod image;
pub mod kernel;
mod log;
pub mod pipeline;
mod pipewire;
pub mod random;
mod report;
pub mod rt;
pub mod share;
pub mod stage;
pub mod systemd;
mod view;

/// What the fuzz targets (`fuzz/`) need of rooms that are private.
#[cfg(feature = "fuzzing")]
#[doc(hidden)]
pub mod fuzzing {
    pub use crate::control::fuzz_reply;
    pub use crate::daemon::fuzz_calibration_store;
}
