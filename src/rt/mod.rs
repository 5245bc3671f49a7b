//! Clock, rings and threads: what runs, never what it computes.

pub mod clock;
pub mod rarely;
pub mod stop;
pub mod wake;
