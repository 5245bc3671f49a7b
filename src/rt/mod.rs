//! The clock, a stop flag, wake-ups for waiting threads, and a limit for repeated log messages.

pub mod clock;
pub(crate) mod log_throttle;
pub mod notifier;
pub mod stop;
