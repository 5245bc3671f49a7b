//! The crop window: how much of the picture is given up to hide the border, and keeping every correction inside it.
//!
//! The output shows the picture magnified by `zoom` about its centre; the margin that this hides is what a correction may use.
//! For each frame, in this order: [`Window::rows_margin`] is how much of the rows' own motion may be undone, scaled back from [`KNEE`] of the
//! margin on, gently at first; [`Window::bounds`] is what that leaves to corrections, as planes; the smoother stays inside of these; and
//! [`Window::correction_part`] checks the map itself, since the picture's edge, as rows and perspective bend it, is no plane. With a
//! border that may show, the window reaches beyond the picture, as far as the largest zoom would give way.

mod bounds;

use nalgebra::Matrix3;

use crate::geometry::{Homography, OutputMap, PerChannel, Pose, View};
pub use bounds::Rows;
pub(crate) use bounds::{Bounds, CORNERS, Corner};

/// What is done about places that the camera did not see.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Border {
    /// They never show: corrections stay within what the zoom hides.
    #[default]
    Zoom,
    /// They show the picture mirrored at its edge.
    Mirror,
    /// They are black.
    Black,
}

/// Settings of the crop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Params {
    /// Magnification of the output (ratio, 1 to 2; 1.1 = a tenth larger); with `auto` that at the beginning.
    pub zoom: f64,
    /// Whether the magnification follows what the shake needs.
    pub auto: bool,
    /// Auto: most magnification. A border that may show: corrections may go as far as this magnification would hide (ratio, 1 to 2).
    pub max_zoom: f64,
    /// What is done about places that the camera did not see.
    pub border: Border,
}

impl Default for Params {
    fn default() -> Self {
        Self { zoom: 1.1, auto: false, max_zoom: 1.2, border: Border::Zoom }
    }
}

/// Share of the margin up to which a correction is left alone.
const KNEE: f64 = 0.7;
/// Points along each side of the outline that are watched.
const PER_SIDE: usize = 9;

/// Difference of poses over which slopes are taken.
const STEP: f64 = 1e-4;
/// Sizes of input and output, and the zoom between them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Window {
    input: [f64; 2],
    output: [f64; 2],
    /// The zoom as it is, and the one it is on its way to.
    zoom: f64,
    goal: f64,
    /// Most zoom that shake is given; 0 where the zoom is fixed.
    auto: f64,
    /// Margin (share of the picture's size) that shake needed of late.
    need: f64,
    /// Margin (share of the picture's size) beyond the picture, as it is.
    beyond: f64,
    /// The margin, all in all, that a border that may show gives; 0 where it may not.
    most: f64,
}

/// Most that the log of the zoom changes in a second, where it was told to.
const GLIDE: f64 = 0.1;
/// The same where shake asks for more, and where it needs less: too slow to be seen.
const GROW: f64 = 0.008;
const SHRINK: f64 = 0.003;
/// Least zoom that shake is given: room for the first knock.
const MIN_AUTO: f64 = 1.02;
/// Seconds for which a need is remembered.
const NEED_S: f64 = 30.0;
/// Share of the margin that a need should take; from [`FULL`] of it on, it may be that more was wanted, and [`MORE`] is given.
const COMFORT: f64 = 0.8;
const FULL: f64 = 0.9;
const MORE: f64 = 1.3;
/// Change of the log of the zoom that is not worth a move.
const IDLE: f64 = 0.01;

impl Window {
    /// A window for an input and an output picture of the given sizes (width, height).
    pub fn new(params: &Params, input: [usize; 2], output: [usize; 2]) -> Self {
        let mut window = Self { input: input.map(|n| n as f64), output: output.map(|n| n as f64), ..Self::default() };
        window.set_params(params);
        window.zoom = window.goal;
        window.beyond = window.beyond_goal();
        window
    }

    /// Takes new settings; the zoom glides to them.
    pub fn set_params(&mut self, params: &Params) {
        self.auto = if params.auto { params.max_zoom.max(1.0) } else { 0.0 };
        self.goal = if params.auto { params.zoom.min(self.auto) } else { params.zoom };
        self.need = COMFORT * margin(self.goal);
        self.most = if params.border == Border::Zoom { 0.0 } else { margin(params.max_zoom) };
    }

    /// The zoom as it is: the part of the picture that is shown is 1 / zoom wide.
    pub fn zoom(&self) -> f64 {
        self.zoom
    }

    /// How far corrections may go beyond the picture (share of its size).
    fn beyond_goal(&self) -> f64 {
        (self.most - margin(self.zoom)).max(0.0)
    }

    /// The rectangle in which the outline has to stay: least and most (x, y).
    fn limits(&self) -> [[f64; 2]; 2] {
        let most = self.input.map(|n| n - 1.0);
        [most.map(|most| -self.beyond * most), most.map(|most| (1.0 + self.beyond) * most)]
    }

    /// Takes in the share of the margin that a frame used ([`Window::crop_use`]): with auto, the zoom follows it.
    pub fn follow_use(&mut self, crop_use: f64, interval_s: f64) {
        if self.auto == 0.0 {
            return;
        }
        let wanted = if crop_use >= FULL { MORE * crop_use } else { crop_use };
        self.need = (self.need * (-interval_s / NEED_S).exp()).max(wanted * (margin(self.zoom) + self.beyond));
        let goal = (1.0 / (1.0 - 2.0 * (self.need / COMFORT).min(0.4))).clamp(MIN_AUTO.min(self.auto), self.auto);
        if (goal / self.goal).ln().abs() > IDLE {
            self.goal = goal;
        }
    }

    /// `interval_s` seconds go by.
    pub fn glide(&mut self, interval_s: f64) {
        let rate = match (self.auto > 0.0, self.goal > self.zoom) {
            (false, _) => GLIDE,
            (true, true) => GROW,
            (true, false) => SHRINK,
        };
        let most = rate * interval_s;
        if self.zoom > 0.0 && self.zoom != self.goal {
            self.zoom = (self.goal / self.zoom).ln().clamp(-most, most).exp() * self.zoom;
            if (self.zoom / self.goal - 1.0).abs() < 1e-9 {
                self.zoom = self.goal;
            }
        }
        let most = GLIDE * interval_s;
        self.beyond += (self.beyond_goal() - self.beyond).clamp(-most, most);
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

    /// The share of the margin that a map uses: 0 where it moves nothing, 1 where the outline touches the picture's edge, more
    /// outside. Infinite where there is no margin and the map moves something.
    pub fn crop_use(&self, map: &OutputMap, view: &View) -> f64 {
        let [least, limit] = self.limits();
        let mut most = 0.0f64;
        for point in self.outline() {
            let (here, rest) = (map.apply(point), map.at_rest(point, view));
            for i in 0..2 {
                let margin = if here[i] < rest[i] { rest[i] - least[i] } else { limit[i] - rest[i] };
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

    /// The corrections for which the outline stays inside, as half-spaces around the correction `near`. `map` gives the map for a
    /// correction: a difference of poses, in whatever units the path has.
    pub fn bounds(&self, view: &View, near: Pose, map: impl Fn(Pose) -> OutputMap) -> Bounds {
        let [least, limit] = self.limits();
        let (middle, mut beside) = (map(near), [OutputMap::default(); 4]);
        for (c, moved) in beside.iter_mut().enumerate() {
            let mut to = near;
            to[c] += STEP;
            *moved = map(to);
        }
        let mut bounds = Bounds::default();
        for point in self.outline() {
            let (here, rest) = (middle.apply(point), middle.at_rest(point, view));
            let moved = beside.map(|map| map.apply(point));
            for i in 0..2 {
                let slope: PerChannel = std::array::from_fn(|c| (moved[c][i] - here[i]) / STEP);
                let along = near.dot(&slope);
                for (sign, slack, slack_still) in
                    [(1.0, limit[i] - here[i], limit[i] - rest[i]), (-1.0, here[i] - least[i], rest[i] - least[i])]
                {
                    // an output of another shape has bars beside the picture: there is nothing to hide there
                    if slack_still >= -1e-6 && slope.iter().all(|s| s.is_finite()) {
                        bounds.add(slope.map(|s| sign * s), slack + sign * along, slack_still);
                    }
                }
            }
        }
        bounds
    }

    /// The largest part (0 to 1) of a correction for which the outline stays inside; part 0 must.
    pub fn correction_part(&self, view: &View, map: impl Fn(f64) -> OutputMap) -> f64 {
        if self.crop_use(&map(1.0), view) <= 1.0 {
            return 1.0;
        }
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..24 {
            let middle = 0.5 * (low + high);
            if self.crop_use(&map(middle), view) <= 1.0 { low = middle } else { high = middle }
        }
        low
    }

    /// The largest part (0 to 1) of the rows' motion for which the outline stays inside, softened from [`KNEE`] of the margin on.
    /// `map` gives the map for a part of the motion, part 0 must stay inside.
    pub fn rows_margin(&self, view: &View, map: impl Fn(f64) -> OutputMap) -> f64 {
        let whole = self.crop_use(&map(1.0), view);
        let rest = self.crop_use(&map(0.0), view);
        if whole.max(rest) <= KNEE {
            return 1.0;
        }
        // the part at which the edge is touched; more than 1 where the whole correction stays inside
        let (mut low, mut high) = (0.0, 4.0);
        for _ in 0..24 {
            let middle = 0.5 * (low + high);
            if self.crop_use(&map(middle), view) <= 1.0 { low = middle } else { high = middle }
        }
        soften(1.0 / low.max(1e-6)) * low
    }
}

/// The margin that a zoom hides, as a share of the picture's size.
fn margin(zoom: f64) -> f64 {
    0.5 * (1.0 - 1.0 / zoom.max(1.0))
}

/// A share of the margin as it may be: itself up to the knee, then bending towards 1.
fn soften(wanted: f64) -> f64 {
    if wanted <= KNEE { wanted } else { KNEE + (1.0 - KNEE) * ((wanted - KNEE) / (1.0 - KNEE)).tanh() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Pinhole, RowPoses};

    #[test]
    fn the_bounds_are_what_the_crop_use_says() {
        let size = [640, 480];
        let window = Window::new(&Params::default(), size, size);
        let (view, camera) = (window.view(), Pinhole::new(size, 50.0));
        let mut rows = RowPoses { samples: [Pose::default(); RowPoses::SAMPLES], spacing: 479.0 / 24.0 };
        for (i, pose) in rows.samples.iter_mut().enumerate() {
            let t = i as f64 / 24.0 - 0.5;
            *pose = Pose([0.006 * t, 0.004 * t, 0.003 * t, 0.0]);
        }
        let map = |e: Pose| OutputMap::Rows {
            window: Homography::IDENTITY,
            view: Homography(camera.turned(-e).0 * view.0).scaled(),
            camera,
            kept: 0.0,
            rows,
        };
        for near in [[0.0; 4], [0.02, 0.01, 0.0, 0.0], [-0.02, 0.015, 0.01, 0.0], [0.01, -0.02, -0.02, 0.005]].map(Pose) {
            let bounds = window.bounds(&view.into(), near, map);
            for c in 0..4 {
                for edge in bounds.interval(c, &near, Rows::Moving) {
                    // a plane is exact near the correction it was made for, not right across the window
                    if (edge - near[c]).abs() > 1.1 * bounds.alone()[c] {
                        continue;
                    }
                    let mut at = near;
                    at[c] = edge;
                    let off = window.crop_use(&map(at), &view.into());
                    assert!(
                        (off - 1.0).abs() < if c == 3 { 0.06 } else { 0.03 },
                        "channel {c} of {near:?} at its edge {edge}: reach {off}"
                    );
                }
                let [low, high] = bounds.interval(c, &Pose::default(), Rows::Still);
                assert!((high - bounds.alone()[c]).abs().min((low + bounds.alone()[c]).abs()) < 0.2 * bounds.alone()[c]);
            }
        }
    }

    #[test]
    fn a_border_that_may_show_gives_room_and_glides() {
        let size = [640, 480];
        let shown = Params { zoom: 1.0, border: Border::Mirror, ..Params::default() };
        let mut window = Window::new(&shown, size, size);
        let camera = Pinhole::new(size, 50.0);
        let alone = |window: &Window| {
            let view = window.view();
            let map = |e: Pose| OutputMap::Projective(Homography(camera.turned(-e).0 * view.0));
            window.bounds(&view.into(), Pose::default(), map).alone()
        };
        // no magnification, and about the room of the largest one
        let [wide, hidden] =
            [window, Window::new(&Params { zoom: shown.max_zoom, ..Params::default() }, size, size)].map(|w| alone(&w));
        assert!((0..2).all(|c| (0.9..1.1).contains(&(wide[c] / hidden[c]))), "{wide:?} {hidden:?}");
        // with auto it grows to what hides the border that shows
        let mut auto = Window::new(&Params { auto: true, ..shown }, size, size);
        for _ in 0..60 * 30 {
            auto.follow_use(1.0, 1.0 / 30.0);
            auto.glide(1.0 / 30.0);
        }
        assert!((auto.zoom - shown.max_zoom).abs() < 1e-6 && auto.beyond < 1e-6, "{} {}", auto.zoom, auto.beyond);
        window.set_params(&Params { zoom: 1.1, ..Params::default() });
        for _ in 0..60 {
            let before = alone(&window);
            window.glide(1.0 / 30.0);
            assert!((0..2).all(|c| (alone(&window)[c] / before[c] - 1.0).abs() < 0.15));
        }
        assert_eq!(alone(&window), alone(&Window::new(&Params { zoom: 1.1, ..Params::default() }, size, size)));
    }

    #[test]
    fn the_zoom_glides_and_arrives() {
        let mut window = Window::new(&Params { zoom: 1.1, ..Params::default() }, [640, 480], [640, 480]);
        window.set_params(&Params { zoom: 1.3, ..Params::default() });
        let mut before = window.zoom;
        for _ in 0..60 {
            window.glide(1.0 / 30.0);
            assert!(window.zoom >= before && window.zoom / before < 1.0034, "{before} to {}", window.zoom);
            before = window.zoom;
        }
        assert_eq!(before, 1.3);
    }
    #[test]
    fn an_auto_zoom_follows_the_shake_within_its_limits_and_too_slowly_to_be_seen() {
        let params = Params { auto: true, max_zoom: 1.25, ..Params::default() };
        let mut window = Window::new(&params, [640, 480], [640, 480]);
        // shake that needs a margin of `need` of the picture, for two minutes
        let mut shake = |need: f64| {
            for _ in 0..120 * 30 {
                let before = window.zoom;
                window.follow_use((need / margin(window.zoom)).min(1.0), 1.0 / 30.0);
                window.glide(1.0 / 30.0);
                let rate = 30.0 * (window.zoom / before).ln();
                assert!((-SHRINK - 1e-9..=GROW + 1e-9).contains(&rate), "{rate}");
            }
            window.zoom
        };
        assert!((shake(0.0) - MIN_AUTO).abs() < 0.011);
        let some = shake(0.06);
        assert!((margin(some) * COMFORT / 0.06 - 1.0).abs() < 0.15, "{some}");
        assert_eq!(shake(0.3), 1.25);
        assert!(shake(0.02) < 1.12);
    }
}
