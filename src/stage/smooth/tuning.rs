//! The numbers of the adaptive drive, in one place, because they were found together: by a random search over the camera paths of
//! rendered and real clips and of synthetic hands, walks, vehicles, pans and logged gyroscopes at 15 to 60 frames a second. Weighed
//! were the output's acceleration and jitter against the input's, with each path a little smaller and larger too, so that no single push
//! decides, and what a step and a pan overshoot. What the search drove to nothing was taken out: a pull to a slow line through the camera's
//! path, the loss of speed where the window pushes, and the weight of an excess now.

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
    /// Factor on the measured errors, and the least that is believed, half windows.
    pub doubt: f64,
    /// See `doubt`.
    pub least_deviation: f64,
    /// Rate at which speed is worth as much as acceleration, Hz.
    pub drag_hz: f64,
    /// Weight of jerk, and of an excess over the window that is expected.
    pub jerk: f64,
    /// See `jerk`.
    pub rho: f64,
    /// With look-ahead: weight of an excess where the camera's path is known.
    pub rho_known: f64,
    /// Seconds after which a foreseen excess counts e times less.
    pub option_s: f64,
    /// Speed at which the window ahead is half as wide, half windows to a tick.
    pub lead_speed: f64,
    /// Share of the window that the plan counts on later, and with look-ahead where the camera's path is known.
    pub later: f64,
    /// See `later`.
    pub known: f64,
}

impl Default for Tuning {
    fn default() -> Self {
        Self {
            ridge: 0.000_019,
            forget_s: 4.33,
            error_s: 0.13,
            first_error: 0.131,
            doubt: 0.379,
            least_deviation: 0.0535,
            drag_hz: 0.476,
            jerk: 0.0322,
            rho: 0.189,
            rho_known: 1.0,
            option_s: 0.11,
            lead_speed: 0.0099,
            later: 0.856,
            known: 0.95,
        }
    }
}
