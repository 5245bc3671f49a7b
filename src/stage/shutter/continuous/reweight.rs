//! Iteratively reweighted least squares: solves for the path, weighs each track by how far it is from what the path says, and solves again.
//!
//! The weights are those of Geman and McClure (S. Geman, D. McClure, "Statistical methods for tomographic image reconstruction", Bulletin
//! of the ISI 52, 1987): rho(e) = e^2 / (1 + e^2 / s^2), whose scale s follows what the inliers leave over.

use super::calibration::Calibrator;
use super::consensus::{self, Turn};
use super::filter::Filter;
use super::geman_mcclure;
use super::observations::{MAX_TRACKS, Observations};

/// Rounds at most and at least, and the part of the weights that a round changes below which it is the last: against always taking the most
/// rounds, no rendered clip became worse by more than 0.001 px.
const ROUNDS: usize = 4;
const MIN_ROUNDS: usize = 2;
const SETTLED: f64 = 0.02;
/// A track of less weight is left out: together a thousand such weigh as much as one inlier.
pub const MIN_WEIGHT: f64 = 1e-3;
/// Least and largest scale of the weights, pixels. Chosen by trial on rendered clips with a person in front of the background.
const SCALE_PX: [f64; 2] = [0.5, 2.0];
/// The scale in root mean squares of what the inliers leave over (weights fall to a quarter there), and how fast it follows them, frame by
/// frame.
const SCALE_SIGMAS: f64 = 3.0;
const SCALE_NEWS: f64 = 0.1;
/// A track's place is off by more than its own difference and texture say, as all are alike: by blur and by what is no rotation.
/// Standard deviation of that (pixels), at least and at most; how fast it follows what is found of it, frame by frame.
const COMMON_SIGMA_PX: [f64; 2] = [0.03, 0.5];
const COMMON_NEWS: f64 = 0.1;

/// The weights of a pair's tracks, and how far tracks are off.
#[derive(Debug)]
pub struct Reweighting {
    /// By the tracks' order, 0 to 1.
    pub weights: Vec<f64>,
    scale_px: f64,
    common: f64,
}

/// What the last round left over.
#[derive(Clone, Copy, Debug, Default)]
pub struct Residuals {
    /// Sum of the weights: the number of inliers.
    pub inliers: f64,
    /// Weighted sum of squares, pixels^2.
    squares: f64,
    /// Sums of the excess of the squares over the tracks' own variances, and of its weights.
    excess: f64,
    certainty: f64,
}

impl Reweighting {
    /// For a camera of which no track was seen yet.
    pub fn new() -> Self {
        let [least_px, _] = COMMON_SIGMA_PX;
        Self { weights: Vec::with_capacity(MAX_TRACKS), scale_px: SCALE_PX[0], common: least_px * least_px }
    }

    /// A stream begins.
    pub fn begin(&mut self) {
        self.weights.clear();
        (self.scale_px, self.common) = (SCALE_PX[0], COMMON_SIGMA_PX[0].powi(2));
    }

    /// Variance that all tracks have in common, pixels^2.
    pub fn common(&self) -> f64 {
        self.common
    }

    /// Scale of the weights, pixels.
    pub fn scale_px(&self) -> f64 {
        self.scale_px
    }

    /// Starts from the tracks' distances to the turn that [`consensus`] found.
    pub fn start(&mut self, observations: &Observations, turn: &Turn) {
        self.weights.clear();
        self.weights.extend(observations.sights.iter().map(|sight| geman_mcclure(sight.misfit(turn), consensus::LIMIT_SQUARE)));
    }

    /// Solves for the path and weighs, in turn. From the second round on the part `share` of what the tracks say of the calibration is
    /// counted. `None` where the equations have no solution.
    pub fn solve(
        &mut self,
        observations: &mut Observations,
        filter: &mut Filter,
        calibrator: &Calibrator,
        share: f64,
    ) -> Option<Residuals> {
        let mut residuals = Residuals::default();
        for round in 0..ROUNDS {
            filter.start_trial();
            if share > 0.0 && round > 0 {
                calibrator.add_terms(observations, &self.weights, share, filter);
            }
            let (weights, details) = (&self.weights, &observations.details);
            let information = |i: usize| if weights[i] > MIN_WEIGHT { details[i].information * weights[i] } else { 0.0 };
            observations.batch.add_to(filter, information);
            if !filter.solve() {
                return None;
            }
            filter.ease_prior();
            observations.batch.evaluate(filter);
            let changed;
            (residuals, changed) = self.weigh(observations);
            if round + 1 >= MIN_ROUNDS && changed < SETTLED * residuals.inliers {
                break;
            }
        }
        Some(residuals)
    }

    /// Weighs each track by its distance from what the path says. Gives what is left over, and by how much the weights changed.
    fn weigh(&mut self, observations: &Observations) -> (Residuals, f64) {
        let (mut residuals, mut changed) = (Residuals::default(), 0.0);
        for (i, prediction) in observations.batch.predictions() {
            let misfit = observations.misfit(i, &prediction.change);
            let weight = geman_mcclure(misfit, self.scale_px * self.scale_px);
            residuals.squares += weight * misfit;
            residuals.inliers += weight;
            // of x and y together; the most certain tracks say most
            let (certainty, own) = (weight * observations.details[i].information, observations.details[i].sigma_px);
            residuals.excess += certainty * (0.5 * misfit - own * own);
            residuals.certainty += certainty;
            changed += (weight - self.weights[i]).abs();
            self.weights[i] = weight;
        }
        (residuals, changed)
    }

    /// Scale and common variance follow what was left over, slowly.
    pub fn learn(&mut self, residuals: &Residuals) {
        let Residuals { inliers, squares, excess, certainty } = residuals;
        let [least, most] = COMMON_SIGMA_PX.map(|sigma| sigma * sigma);
        self.common += COMMON_NEWS * ((excess / certainty.max(1e-9)).clamp(least, most) - self.common);
        let noise = (squares / inliers.max(1.0)).sqrt();
        self.scale_px += SCALE_NEWS * ((SCALE_SIGMAS * noise).clamp(SCALE_PX[0], SCALE_PX[1]) - self.scale_px);
    }
}
