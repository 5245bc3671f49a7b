//! Rolling shutter: from tracks to the motion of the camera between frames and of the rows within them.

/// Which model of the camera's motion is used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Model {
    /// "CMOS digital image stabilization" (Cho, Kim, Hong 2007): zoom and translation, constant within a frame interval.
    #[default]
    Cho2007,
}

/// Which of the two parameter sets of cho2007 describes a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Parameters {
    /// Eq. (11), from the homography to the frame after: one frame late, the paper's choice.
    #[default]
    TimeT,
    /// Eq. (12), from the homography to the frame before: no latency.
    TimeT1,
}

/// Settings of the rolling-shutter model.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Params {
    /// Which model.
    pub model: Model,
    /// cho2007 alone: which parameter set.
    pub parameters: Parameters,
}
