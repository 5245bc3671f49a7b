//! The numbers of the adaptive drive, in one place, because they were found together: by a random search over the camera paths of
//! rendered and real clips of hands, walks, vehicles, pans and logged gyroscopes at 15 to 60 frames a second, as the pipeline measures
//! them: with its errors, which a forecast makes larger. Weighed were the output's acceleration and jitter against the input's, with each
//! path a little smaller and larger too, so that no single push decides, and what a step and a pan overshoot. What the search drove to
//! nothing was taken out: a pull to a slow line through the camera's path or to the middle of its range, the loss of speed where the
//! window pushes, a window that is narrower ahead of a moving camera, and the weight of an excess now.

/// Numbers of the adaptive drive.
#[derive(Clone, Copy, Debug)]
pub struct Tuning {
    /// Ridge against which the forecast's weights are learned, half windows^2.
    pub ridge: f64,
    /// Seconds for which the forecast remembers.
    pub forget_s: f64,
    /// Seconds for which the forecast's errors are remembered.
    pub error_s: f64,
    /// Error that is expected of a forecast six ticks ahead, half windows.
    pub first_error: f64,
    /// Factor on the measured errors where the camera is foreseen well, and where it is not.
    pub doubt: f64,
    /// See `doubt`.
    pub doubt_unforeseen: f64,
    /// The least error that is believed, half windows.
    pub least_deviation: f64,
    /// The camera is foreseen well where a forecast of a moment ahead is off by so many half windows at most ..
    pub foreseen_to: f64,
    /// .. and not at all from so many on.
    pub unforeseen_from: f64,
    /// Seconds for which that is remembered.
    pub surprise_s: f64,
    /// Rate at which speed is worth as much as acceleration, Hz: where the virtual camera stands, and where it goes along.
    pub hold_hz: f64,
    /// See `hold_hz`.
    pub follow_hz: f64,
    /// It stands where all that the camera did in so many seconds takes at most this part of the window ..
    pub hold_s: f64,
    /// See `hold_s`.
    pub hold_to: f64,
    /// .. and goes along from that part on.
    pub follow_from: f64,
    /// Weight of jerk, and of an excess over the window that is expected.
    pub jerk: f64,
    /// See `jerk`.
    pub rho: f64,
    /// With look-ahead: weight of an excess where the camera's path is known.
    pub rho_known: f64,
    /// Seconds after which a foreseen excess counts e times less.
    pub option_s: f64,
    /// Share of the window that the plan counts on later: where the camera is foreseen well, where it is not (there the errors that are
    /// expected keep from the edge already), and with look-ahead where the camera's path is known.
    pub later: f64,
    /// See `later`.
    pub later_unforeseen: f64,
    /// See `later`.
    pub known: f64,
}

impl Default for Tuning {
    fn default() -> Self {
        Self {
            ridge: 0.000_019,
            forget_s: 4.33,
            error_s: 0.21,
            first_error: 0.131,
            doubt: 0.277,
            doubt_unforeseen: 0.5,
            least_deviation: 0.023,
            foreseen_to: 0.118,
            unforeseen_from: 0.17,
            surprise_s: 0.85,
            hold_hz: 2.99,
            follow_hz: 0.984,
            hold_s: 3.75,
            hold_to: 0.914,
            follow_from: 1.4,
            jerk: 0.0086,
            rho: 1.315,
            rho_known: 1.0,
            option_s: 0.086,
            later: 0.887,
            later_unforeseen: 1.0,
            known: 0.9,
        }
    }
}
