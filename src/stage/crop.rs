//! The crop window: how much of the picture is given up to hide the border, and keeping every correction inside it.
//!
//! The output shows the picture magnified by `zoom` about its centre; the margin that this hides is what a correction may use.
//! A correction that would use more than [`KNEE`] of it is scaled back, gently at first, so that the output's outline never
//! leaves the picture.

use nalgebra::Matrix3;

use crate::geometry::{Homography, OutputMap};

/// Settings of the crop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Params {
    /// Magnification of the output (ratio, 1 to 2; 1.1 = a tenth larger).
    pub zoom: f64,
}

impl Default for Params {
    fn default() -> Self {
        Self { zoom: 1.1 }
    }
}

/// Share of the margin up to which a correction is left alone.
const KNEE: f64 = 0.7;
/// Points along each side of the outline that are watched.
const PER_SIDE: usize = 9;

/// Sizes of input and output, and the zoom between them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Window {
    input: [f64; 2],
    output: [f64; 2],
    zoom: f64,
}

impl Window {
    /// A window for an input and an output picture of the given sizes (width, height).
    pub fn new(params: &Params, input: [usize; 2], output: [usize; 2]) -> Self {
        Self { input: input.map(|n| n as f64), output: output.map(|n| n as f64), zoom: params.zoom }
    }

    /// Takes output pixels to the virtual camera's: the zoom about the centre, and where the sizes differ, the scale at which the
    /// whole input fits.
    pub fn view(&self) -> Homography {
        let [out_x, out_y] = self.output.map(|n| (n - 1.0) / 2.0);
        let [in_x, in_y] = self.input.map(|n| (n - 1.0) / 2.0);
        let fit = (self.input[0] / self.output[0]).max(self.input[1] / self.output[1]);
        let scale = if self.input == self.output { 1.0 } else { fit } / self.zoom;
        Homography(Matrix3::new(scale, 0.0, in_x - scale * out_x, 0.0, scale, in_y - scale * out_y, 0.0, 0.0, 1.0))
    }

    /// Points along the output's outline.
    fn outline(&self) -> impl Iterator<Item = [f64; 2]> {
        let [right, bottom] = self.output.map(|n| n - 1.0);
        (0..PER_SIDE).flat_map(move |i| {
            let part = i as f64 / (PER_SIDE - 1) as f64;
            [[part * right, 0.0], [part * right, bottom], [0.0, part * bottom], [right, part * bottom]]
        })
    }

    /// How far the outline reaches into the margin: 0 where `map` moves nothing, 1 where it touches the picture's edge, more
    /// outside. Infinite where there is no margin and the map moves something.
    pub fn reach(&self, map: &OutputMap, view: &Homography) -> f64 {
        let limit = self.input.map(|n| n - 1.0);
        let mut most = 0.0f64;
        for point in self.outline() {
            let (here, rest) = (map.apply(point), view.apply(point));
            for i in 0..2 {
                let margin = if here[i] < rest[i] { rest[i] } else { limit[i] - rest[i] };
                let moved = (here[i] - rest[i]).abs();
                if moved > 1e-9 {
                    // an output of another shape has bars beside the picture: there is nothing to hide there
                    let share = if margin < -1e-6 { 0.0 } else { moved / margin.max(1e-9) };
                    most = most.max(share);
                } else if !moved.is_finite() {
                    return f64::INFINITY;
                }
            }
        }
        most
    }

    /// The largest part (0 to 1) of a correction for which the outline stays inside, softened from [`KNEE`] of the margin on.
    /// `map` gives the map for a part of the correction, part 0 must stay inside.
    pub fn allowed(&self, view: &Homography, map: impl Fn(f64) -> OutputMap) -> f64 {
        let whole = self.reach(&map(1.0), view);
        let rest = self.reach(&map(0.0), view);
        if whole.max(rest) <= KNEE {
            return 1.0;
        }
        // the part at which the edge is touched; more than 1 where the whole correction stays inside
        let (mut low, mut high) = (0.0, 4.0);
        for _ in 0..24 {
            let middle = 0.5 * (low + high);
            if self.reach(&map(middle), view) <= 1.0 { low = middle } else { high = middle }
        }
        soften(1.0 / low.max(1e-6)) * low
    }
}

/// A share of the margin as it may be: itself up to the knee, then bending towards 1.
fn soften(wanted: f64) -> f64 {
    if wanted <= KNEE { wanted } else { KNEE + (1.0 - KNEE) * ((wanted - KNEE) / (1.0 - KNEE)).tanh() }
}
