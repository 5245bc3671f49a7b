//! Reports of a run: traces, statistics, side-by-side pictures, HTML pages. Observes the pipeline, and never influences it.

mod compare;
mod histogram;
mod html;
mod names;
mod pair;
mod patterns;
mod stats;
mod trace;

pub use compare::{Compare, compare_format};
pub use histogram::Histogram;
pub use html::{Both, DaemonReport, Paper, Report};
pub use names::MotionNames;
pub use pair::{EncodedPair, PairEncoder};
pub use patterns::{PatternFrame, PatternWatch, Shape};
pub use stats::Stats;
pub use trace::Trace;
