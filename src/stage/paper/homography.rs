//! Robust estimation of the homography between two frames: seeded MSAC, then refinement on the inliers.
//!
//! Minimised is the sum over tracks of rho(|H x - x'|^2), the distance in the newer frame in pixels: by MSAC (Torr and Zisserman
//! 2000; rho = min(e^2, threshold^2)) over minimal samples, then by Gauss-Newton with Geman-McClure weights. Coordinates are
//! normalised (centre of the tracks to 0, mean distance 1) while fitting.

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use crate::frame::{Fit, Track};
use crate::geometry::{Homography, hypot};
use crate::random::SplitMix;

/// Which entries of the homography are free.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Form {
    /// `h4 = h7 = 0`, the form that eq. (10) has: six unknowns.
    #[default]
    Constrained,
    /// All eight.
    General,
}

/// Settings of the fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Params {
    /// Which entries are free.
    pub form: Form,
    /// Distance at which a track stops being an inlier (pixels, 0.2 to 10).
    pub threshold_px: f64,
    /// Seed of the random choice of hypotheses; the same input gives the same bytes.
    pub seed: u64,
}

impl Default for Params {
    fn default() -> Self {
        Self { form: Form::Constrained, threshold_px: 1.5, seed: 1 }
    }
}

/// Tracks below which nothing is fitted.
const MIN_TRACKS: usize = 12;
/// Tracks for which there is room from the start.
const MAX_TRACKS: usize = 4096;
/// What the inliers' threshold grows by, pixels a pixel of motion.
const SLACK: f64 = 0.15;
/// Hypotheses at most.
const MAX_HYPOTHESES: usize = 160;
/// Probability with which at least one sample should hold no outlier.
const CERTAINTY: f64 = 0.999;
/// Weight from which a track agrees: that of one as far off as the model's scale.
const MIN_WEIGHT: f32 = 0.25;
/// Rounds of refinement.
const REFINEMENTS: usize = 6;

/// Fits homographies, one after the other.
#[derive(Debug)]
pub struct Fitter {
    params: Params,
    random: SplitMix,
    lengths: Vec<f64>,
}

/// A homography's first eight entries, h9 = 1.
type Entries = SVector<f64, 8>;

impl Fitter {
    /// A fitter whose random choices follow from the settings' seed.
    pub fn new(params: Params) -> Self {
        Self { params, random: SplitMix::new(params.seed), lengths: Vec::with_capacity(MAX_TRACKS) }
    }

    /// Takes form and threshold from `params`; the random choices go on as they would.
    pub fn set_params(&mut self, params: &Params) {
        (self.params.form, self.params.threshold_px) = (params.form, params.threshold_px);
    }

    /// Fits `tracks`. With too few of them, or all of them in one place or on a line, the fit is the identity with confidence 0.
    pub fn fit(&mut self, tracks: &[Track]) -> Fit {
        let nothing = Fit { tracks: tracks.len() as u32, ..Fit::default() };
        if tracks.len() < MIN_TRACKS {
            return nothing;
        }
        let Some(frame) = Normal::of(tracks) else { return nothing };
        // the model leaves out roll and perspective, and its misfit grows with the motion
        let threshold = (self.params.threshold_px + SLACK * self.median_motion(tracks)) / frame.scale;
        let Some(rough) = self.search(tracks, &frame, threshold) else { return nothing };
        let fine = refine(self.params.form, tracks, &frame, rough, threshold);
        let agree = |track: &&Track| frame.error(&fine, track).is_some_and(|e| e < threshold * threshold);
        let inliers = tracks.iter().filter(agree).count();
        let confidence = confidence(inliers, tracks.len(), frame.spread(tracks.iter().filter(agree)));
        let homography = frame.restore(&fine);
        if !homography.is_finite() || confidence == 0.0 {
            return nothing;
        }
        Fit { homography, inliers: inliers as u32, tracks: tracks.len() as u32, confidence }
    }

    /// The homography of `tracks` that a shutter model has weighed (their `weight`): by linear least squares, without a search. Those
    /// of at least a quarter of the full weight are inliers. To be told, not to be built on: the model that weighed knows more.
    pub fn agree(&self, tracks: &[Track]) -> Fit {
        let nothing = Fit { tracks: tracks.len() as u32, ..Fit::default() };
        let Some(frame) = Normal::of(tracks).filter(|_| tracks.len() >= MIN_TRACKS) else { return nothing };
        let agreeing = || tracks.iter().filter(|track| track.weight >= MIN_WEIGHT);
        let inliers = agreeing().count();
        let confidence = confidence(inliers, tracks.len(), frame.spread(agreeing()));
        let Some(entries) = linear(self.params.form, tracks, &frame) else { return nothing };
        let homography = frame.restore(&entries);
        if !homography.is_finite() || confidence == 0.0 {
            return nothing;
        }
        Fit { homography, inliers: inliers as u32, tracks: tracks.len() as u32, confidence }
    }

    /// Median length of the tracks, pixels.
    fn median_motion(&mut self, tracks: &[Track]) -> f64 {
        self.lengths.clear();
        self.lengths.extend(tracks.iter().map(|t| hypot(t.to[0] - t.from[0], t.to[1] - t.from[1])));
        let middle = self.lengths.len() / 2;
        *self.lengths.select_nth_unstable_by(middle, f64::total_cmp).1
    }

    /// The hypothesis with the least truncated error.
    fn search(&mut self, tracks: &[Track], frame: &Normal, threshold: f64) -> Option<Entries> {
        let size = match self.params.form {
            Form::Constrained => 3,
            Form::General => 4,
        };
        let limit = threshold * threshold;
        let mut best: Option<(f64, Entries)> = None;
        let mut wanted = MAX_HYPOTHESES;
        let mut tried = 0;
        while tried < wanted {
            tried += 1;
            let mut sample = [([0.0; 2], [0.0; 2]); 4];
            for point in &mut sample[..size] {
                *point = frame.pair(&tracks[self.random.below(tracks.len())]);
            }
            let hypothesis = match self.params.form {
                Form::Constrained => constrained([sample[0], sample[1], sample[2]]),
                Form::General => general(sample),
            };
            let Some(hypothesis) = hypothesis else { continue };
            let (mut cost, mut inliers) = (0.0, 0usize);
            for track in tracks {
                let error = frame.error(&hypothesis, track).unwrap_or(f64::INFINITY);
                inliers += usize::from(error < limit);
                cost += error.min(limit);
                if best.as_ref().is_some_and(|(least, _)| cost >= *least) {
                    break;
                }
            }
            if best.as_ref().is_none_or(|(least, _)| cost < *least) {
                best = Some((cost, hypothesis));
                let share = inliers as f64 / tracks.len() as f64;
                let clean = share.powi(size as i32).clamp(1e-9, 1.0 - 1e-9);
                wanted = (((1.0 - CERTAINTY).ln() / (1.0 - clean).ln()).ceil() as usize).clamp(12, MAX_HYPOTHESES);
            }
        }
        best.map(|(_, entries)| entries)
    }
}

/// How far to believe a fit: 0 with hardly more inliers than unknowns, one in five, or all on a line; 1 with 40, one in two and an
/// eighth as wide as long.
fn confidence(inliers: usize, tracks: usize, spread: f64) -> f64 {
    let ramp = |x: f64, from: f64, to: f64| ((x - from) / (to - from)).clamp(0.0, 1.0);
    ramp(inliers as f64, 8.0, 40.0) * ramp(inliers as f64 / tracks.max(1) as f64, 0.2, 0.5) * ramp(spread, 0.03, 0.12)
}

/// The normalising similarity: the tracks' centre goes to 0, their mean distance from it to 1.
struct Normal {
    centre: [f64; 2],
    scale: f64,
}

impl Normal {
    fn of(tracks: &[Track]) -> Option<Self> {
        let n = tracks.len() as f64;
        let mut centre = [0.0; 2];
        for track in tracks {
            centre[0] += track.from[0] / n;
            centre[1] += track.from[1] / n;
        }
        let scale = tracks.iter().map(|t| hypot(t.from[0] - centre[0], t.from[1] - centre[1])).sum::<f64>() / n;
        (scale.is_finite() && scale > 1.0).then_some(Self { centre, scale })
    }

    fn pair(&self, track: &Track) -> ([f64; 2], [f64; 2]) {
        let normal = |p: [f64; 2]| [(p[0] - self.centre[0]) / self.scale, (p[1] - self.centre[1]) / self.scale];
        (normal(track.from), normal(track.to))
    }

    /// Squared distance in the newer frame; `None` where the point goes to infinity or beyond.
    #[inline]
    fn error(&self, h: &Entries, track: &Track) -> Option<f64> {
        let (from, to) = self.pair(track);
        let [x, y, _] = project(h, from)?;
        Some((x - to[0]) * (x - to[0]) + (y - to[1]) * (y - to[1]))
    }

    /// How wide the tracks lie against how long: the ratio of their deviations along both principal axes, 0 (on a line) to 1.
    fn spread<'a>(&self, tracks: impl Iterator<Item = &'a Track>) -> f64 {
        let (mut n, mut mean, mut square) = (0.0, [0.0; 2], [0.0; 3]);
        for track in tracks {
            let ([x, y], _) = self.pair(track);
            n += 1.0;
            mean = [mean[0] + x, mean[1] + y];
            square = [square[0] + x * x, square[1] + x * y, square[2] + y * y];
        }
        let [mx, my] = mean.map(|m| m / n);
        let [xx, xy, yy] = [square[0] / n - mx * mx, square[1] / n - mx * my, square[2] / n - my * my];
        let root = ((xx - yy) * (xx - yy) + 4.0 * xy * xy).sqrt();
        let (smaller, larger) = ((xx + yy - root).max(0.0), xx + yy + root);
        if larger > 0.0 { (smaller / larger).sqrt() } else { 0.0 }
    }

    /// The same homography between pixels.
    fn restore(&self, h: &Entries) -> Homography {
        let (s, [cx, cy]) = (self.scale, self.centre);
        let there = Matrix3::new(1.0 / s, 0.0, -cx / s, 0.0, 1.0 / s, -cy / s, 0.0, 0.0, 1.0);
        let back = Matrix3::new(s, 0.0, cx, 0.0, s, cy, 0.0, 0.0, 1.0);
        let inner = Matrix3::new(h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], 1.0);
        Homography(back * inner * there).scaled()
    }
}

/// The image of a point and its divisor.
#[inline]
fn project(h: &Entries, [x, y]: [f64; 2]) -> Option<[f64; 3]> {
    let w = h[6] * x + h[7] * y + 1.0;
    (w > 0.05).then(|| [(h[0] * x + h[1] * y + h[2]) / w, (h[3] * x + h[4] * y + h[5]) / w, w])
}

/// Six entries from three pairs: rows first (h5, h6, h8 from y alone), then columns.
fn constrained(pairs: [([f64; 2], [f64; 2]); 3]) -> Option<Entries> {
    let rows = Matrix3::from_fn(|i, j| {
        let ([_, y], [_, to]) = pairs[i];
        [y, 1.0, -y * to][j]
    });
    let right = Vector3::from_fn(|i, _| pairs[i].1[1]);
    let [h5, h6, h8] = solve(rows, right)?;
    let columns = Matrix3::from_fn(|i, j| [pairs[i].0[0], pairs[i].0[1], 1.0][j]);
    let right = Vector3::from_fn(|i, _| pairs[i].1[0] * (h8 * pairs[i].0[1] + 1.0));
    let [h1, h2, h3] = solve(columns, right)?;
    Some(Entries::from([h1, h2, h3, 0.0, h5, h6, 0.0, h8]))
}

fn solve(matrix: Matrix3<f64>, right: Vector3<f64>) -> Option<[f64; 3]> {
    let lu = matrix.lu();
    (lu.determinant().abs() > 1e-6).then(|| lu.solve(&right)).flatten().map(Into::into)
}

/// Eight entries from four pairs (direct linear transformation, h9 = 1).
fn general(pairs: [([f64; 2], [f64; 2]); 4]) -> Option<Entries> {
    let mut matrix = SMatrix::<f64, 8, 8>::zeros();
    let mut right = Entries::zeros();
    for (i, ([x, y], [u, v])) in pairs.into_iter().enumerate() {
        let rows = [[x, y, 1.0, 0.0, 0.0, 0.0, -u * x, -u * y], [0.0, 0.0, 0.0, x, y, 1.0, -v * x, -v * y]];
        for (j, row) in rows.into_iter().enumerate() {
            matrix.set_row(2 * i + j, &row.into());
        }
        right[2 * i] = u;
        right[2 * i + 1] = v;
    }
    let lu = matrix.lu();
    if lu.determinant().abs() < 1e-9 {
        return None;
    }
    lu.solve(&right)
}

/// Least squares of weighted tracks, on the algebraic error: between two frames the divisors are 1 to within a few hundredths.
fn linear(form: Form, tracks: &[Track], frame: &Normal) -> Option<Entries> {
    let mut normal = [[0.0; 8]; 8];
    let mut right = [0.0; 8];
    for track in tracks {
        let ([x, y], [u, v]) = frame.pair(track);
        let weight = f64::from(track.weight);
        let rows = [[x, y, 1.0, 0.0, 0.0, 0.0, -u * x, -u * y], [0.0, 0.0, 0.0, x, y, 1.0, -v * x, -v * y]];
        for i in 0..8 {
            let [a, b] = [weight * rows[0][i], weight * rows[1][i]];
            for j in 0..=i {
                normal[i][j] += a * rows[0][j] + b * rows[1][j];
            }
            right[i] += a * u + b * v;
        }
    }
    // its Cholesky factor is made of the lower triangle alone
    let mut normal = SMatrix::<f64, 8, 8>::from_fn(|i, j| if j <= i { normal[i][j] } else { 0.0 });
    let mut right = Entries::from(right);
    if form == Form::Constrained {
        fix(&mut normal, &mut right);
    }
    normal.cholesky().map(|factor| factor.solve(&right))
}

/// Holds h4 and h7 to 0.
fn fix(normal: &mut SMatrix<f64, 8, 8>, right: &mut Entries) {
    for fixed in [3, 6] {
        normal.row_mut(fixed).fill(0.0);
        normal.column_mut(fixed).fill(0.0);
        normal[(fixed, fixed)] = 1.0;
        right[fixed] = 0.0;
    }
}

/// Gauss-Newton on the geometric error with Geman-McClure weights, whose scale shrinks from the threshold to a third of it.
fn refine(form: Form, tracks: &[Track], frame: &Normal, mut h: Entries, threshold: f64) -> Entries {
    for round in 0..REFINEMENTS {
        let scale = threshold * (1.0 - 0.67 * round as f64 / (REFINEMENTS - 1) as f64);
        let mut normal = SMatrix::<f64, 8, 8>::zeros();
        let mut right = Entries::zeros();
        for track in tracks {
            let (from, to) = frame.pair(track);
            let Some([px, py, w]) = project(&h, from) else { continue };
            let (ex, ey) = (to[0] - px, to[1] - py);
            let [x, y] = from.map(|c| c / w);
            let weight = 1.0 / (1.0 + (ex * ex + ey * ey) / (scale * scale)).powi(2);
            let rows = [
                Entries::from([x, y, 1.0 / w, 0.0, 0.0, 0.0, -px * x, -px * y]),
                Entries::from([0.0, 0.0, 0.0, x, y, 1.0 / w, -py * x, -py * y]),
            ];
            for (row, error) in rows.iter().zip([ex, ey]) {
                normal.ger(weight, row, row, 1.0);
                right.axpy(weight * error, row, 1.0);
            }
        }
        if form == Form::Constrained {
            fix(&mut normal, &mut right);
        }
        let Some(factor) = normal.cholesky() else { return h };
        h += factor.solve(&right);
    }
    h
}
