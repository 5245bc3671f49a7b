//! The numbers of the adaptive mode, in one place, because they were found together: by a random search over the camera paths of
//! rendered and real clips of hands, walks, vehicles, pans and logged gyroscopes at 15 to 60 frames a second, as the pipeline measures
//! them: with its errors, which a forecast makes larger. Weighed were the output's acceleration and jitter against the input's, with each
//! path a little smaller and larger too, so that no single push decides, and what a step and a pan overshoot. What the search drove to
//! nothing was removed: a pull to a slow line through the camera's path or to the middle of its range, the loss of speed where the window
//! pushes, a window that is narrower ahead of a moving camera, and the weight of an excess now.
//!
//! `examples/tune.rs` judges these numbers on camera paths, and searches others.

/// Declares the numbers, each with its default and its name.
macro_rules! numbers {
    ($($(#[$doc:meta])+ $name:ident = $default:expr;)+) => {
        /// Numbers of the adaptive mode.
        #[derive(Clone, Copy, Debug)]
        pub struct Tuning {
            $($(#[$doc])+ pub $name: f64,)+
        }

        impl Default for Tuning {
            fn default() -> Self {
                Self { $($name: $default,)+ }
            }
        }

        impl Tuning {
            /// Every number with its name, for a search.
            pub fn numbers(&mut self) -> Vec<(&'static str, &mut f64)> {
                vec![$((stringify!($name), &mut self.$name),)+]
            }
        }
    };
}

numbers! {
    /// Ridge against which the forecast's weights are learned (squares of a channel's bound).
    ridge = 0.000_019;
    /// Seconds for which the forecast remembers.
    forget_s = 4.33;
    /// Seconds for which the forecast's errors are remembered.
    error_s = 0.21;
    /// Error that is expected at first of a forecast six ticks ahead (of a channel's bound).
    first_error = 0.131;
    /// Factor on the measured errors where the camera is predictable ..
    doubt = 0.277;
    /// .. and where it is not.
    doubt_unforeseen = 0.5;
    /// The least error that is expected (of a channel's bound).
    least_deviation = 0.023;
    /// The camera is predictable where a forecast of a moment ahead is off by at most this part of a channel's bound ..
    foreseen_to = 0.118;
    /// .. and not at all from this part on.
    unforeseen_from = 0.17;
    /// Seconds for which that is remembered.
    surprise_s = 0.85;
    /// Rate at which speed costs as much as acceleration, Hz: where the virtual camera holds its place ..
    hold_hz = 2.99;
    /// .. and where it follows.
    follow_hz = 0.984;
    /// It holds where all that the camera did in so many seconds ..
    hold_s = 3.75;
    /// .. takes at most this part of the window, ..
    hold_to = 0.914;
    /// .. and follows from this part on.
    follow_from = 1.4;
    /// Weight of jerk.
    jerk = 0.0086;
    /// Weight of an expected excess over the window.
    rho = 1.315;
    /// The same with look-ahead, where the camera's path is known.
    rho_known = 1.0;
    /// Seconds after which an expected excess counts e times less.
    option_s = 0.086;
    /// Share of the window that the plan counts on later: where the camera is predictable, ..
    later = 0.887;
    /// .. where it is not (there the expected errors keep the distance), ..
    later_unforeseen = 1.0;
    /// .. and with look-ahead, where the camera's path is known.
    known = 0.9;
    /// The window counts as full where at least this part of it is used.
    full_use = 0.8;
    /// Seconds for which it is remembered how often it was full.
    full_s = 1.5;
    /// The channels are planned together from this share of the time on, at first a little, ..
    full_from = 0.1;
    /// .. and wholly from this share on.
    full_to = 0.3;
    /// `later` of the plan of all channels together ..
    joint_later = 0.96;
    /// .. and its `follow_hz`.
    joint_follow_hz = 1.2;
    /// Strength of that plan's pull of roll towards the camera, Hz: the natural frequency that it would have without the other terms.
    roll_return_hz = 0.6;
}

impl Tuning {
    /// The numbers as the plan of all channels together takes them.
    pub(super) fn joint(&self) -> Self {
        Self { later: self.joint_later, follow_hz: self.joint_follow_hz, ..*self }
    }
}
