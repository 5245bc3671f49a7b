//! Clock, rings and threads: what runs, never what it computes.

pub mod clock;
pub mod log_throttle;
pub mod notifier;
pub mod stop;
