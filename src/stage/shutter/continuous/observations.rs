//! The tracks of a pair of frames, as linear measurements of the camera's path and of the flow.

use super::batch::Batch;
use super::calibration::Calibrator;
use super::consensus::{self, Sight};
use super::filter::Filter;
use super::flow::Row;
use super::row_agreement::Compared;
use super::{Times, geman_mcclure};
use crate::frame::Track;
use crate::geometry::Pose;
use crate::kernel::Level;

/// Tracks used, at most: the batch has twelve bits for the number of a measurement.
pub const MAX_TRACKS: usize = 4096;
/// A track's own standard deviation counts as no more than this, pixels. Chosen by trial.
const MAX_SIGMA_PX: f64 = 2.0;
/// Prior weight of a track that never agreed with the camera's motion, against 1 of one that always did. Not 0: what moved by itself may
/// have come to rest. Chosen by trial.
const MIN_BACKGROUND: f64 = 0.05;
/// The prior weight counts up to this many times the mean in the least squares: a lone track must not outweigh the rest.
const MAX_PRIOR_WEIGHT: f64 = 2.0;

/// What is kept of a track beside what [`consensus`] needs.
#[derive(Clone, Copy, Debug)]
pub struct Detail {
    /// Half-way between both places, pixels.
    pub middle: [f64; 2],
    /// Motion, pixels.
    pub moved: [f64; 2],
    /// The rows on which it was seen, in the earlier frame and the later.
    pub rows: [f64; 2],
    /// Standard deviation of its place by its own texture and difference, pixels.
    pub sigma_px: f64,
    /// Information of its place, 1 / pixels^2, times the prior weight.
    pub information: f64,
}

/// The measurements of one pair of frames, by the tracks' order. Nothing is allocated after `new`.
#[derive(Debug)]
pub struct Observations {
    /// As the consensus sees them.
    pub sights: Vec<Sight>,
    /// The rest.
    pub details: Vec<Detail>,
    /// As the filter takes them.
    pub batch: Batch,
}

impl Observations {
    /// None, with room for [`MAX_TRACKS`].
    pub fn new(level: Level) -> Self {
        let (sights, details) = (Vec::with_capacity(MAX_TRACKS), Vec::with_capacity(MAX_TRACKS));
        Self { sights, details, batch: Batch::new(MAX_TRACKS, level) }
    }

    /// Takes the tracks of a pair of frames. All tracks have the variance `common` (pixels^2) beside their own.
    pub fn gather(&mut self, tracks: &[Track], times: &Times, calibrator: &Calibrator, filter: &Filter, common: f64) {
        self.sights.clear();
        self.details.clear();
        self.batch.clear();
        for track in tracks {
            let middle = [0.5 * (track.from[0] + track.to[0]), 0.5 * (track.from[1] + track.to[1])];
            let moved = [track.to[0] - track.from[0], track.to[1] - track.from[1]];
            let derivative = calibrator.camera.derivative(middle);
            let moments = [times.before_s + calibrator.delay(track.from[1]), times.now_s + calibrator.delay(track.to[1])];
            let row = middle[1] / calibrator.size[1] as f64 - 0.5;
            let flow_row = Row::new(row + 0.5, times.interval_s);
            self.batch.push(filter, moments.map(|moment| filter.locate(moment)), flow_row);
            let flow = filter.flow_at(&flow_row);
            let turned = [moved[0] - flow.dot(&derivative[0]), moved[1] - flow.dot(&derivative[1])];
            self.sights.push(Sight { turned, derivative, row, weight: 1.0 });
            let sigma_px = f64::from(track.sigma_px).min(MAX_SIGMA_PX);
            let information = 1.0 / (sigma_px * sigma_px + common);
            self.details.push(Detail { middle, moved, rows: [track.from[1], track.to[1]], sigma_px, information });
        }
        let Self { sights, details, batch } = self;
        batch.prepare(|i| (sights[i].derivative, details[i].moved));
        let background = |i: usize| MIN_BACKGROUND + (1.0 - MIN_BACKGROUND) * f64::from(tracks[i].background);
        consensus::distribute_weights(tracks, calibrator.size, background, sights);
    }

    /// Lets the prior weights count in the least squares as well.
    pub fn apply_prior_weights(&mut self) {
        for (detail, sight) in self.details.iter_mut().zip(&self.sights) {
            detail.information *= sight.weight.min(MAX_PRIOR_WEIGHT);
        }
    }

    /// How many tracks of which weight there are, by the flow's bins.
    pub fn presence(&self, weights: &[f64]) -> [f64; super::flow::BINS] {
        let mut present = [0.0; super::flow::BINS];
        for (sight, weight) in self.sights.iter().zip(weights) {
            let Row { bin, weights } = Row::new(sight.row + 0.5, 1.0);
            for (i, share) in weights.into_iter().enumerate() {
                present[bin + i] += share * weight * sight.weight.min(MAX_PRIOR_WEIGHT);
            }
        }
        present
    }

    /// The share of the tracks, each by its prior weight, that agree.
    pub fn agreeing_share(&self, weights: &[f64]) -> f64 {
        let (mut agreed, mut sum) = (0.0, 0.0);
        for (sight, weight) in self.sights.iter().zip(weights) {
            agreed += sight.weight * weight;
            sum += sight.weight;
        }
        agreed / sum.max(1e-9)
    }

    /// Squared distance between what a change of the pose says of track `i` and what was seen, pixels^2.
    #[inline]
    pub fn misfit(&self, i: usize, change: &Pose) -> f64 {
        consensus::misfit(&self.sights[i].derivative, self.details[i].moved, change)
    }

    /// What is compared for [`super::row_agreement`], where the pose changed by `whole` between the middle rows. A track counts where it
    /// agrees with the path or, within `scale_px`, with one without motion of the rows: the tracks that agree with the path alone would
    /// confirm whatever it says.
    pub fn compared<'a>(
        &'a self,
        weights: &'a [f64],
        filter: &'a Filter,
        calibrator: &'a Calibrator,
        whole: Pose,
        scale_px: f64,
    ) -> impl Iterator<Item = Compared> + 'a {
        let half_width = 0.5 * calibrator.size[0] as f64;
        self.batch.predictions().map(move |(i, prediction)| {
            let (detail, Sight { derivative, weight: prior_weight, .. }) = (&self.details[i], &self.sights[i]);
            let flow = filter.flow_at(self.batch.flow_row(i));
            let by_rows = derivative.map(|row| (prediction.change - flow - whole).dot(&row));
            let moved: [f64; 2] = std::array::from_fn(|i| detail.moved[i] - flow.dot(&derivative[i]));
            let rest: [f64; 2] = std::array::from_fn(|i| moved[i] - whole.dot(&derivative[i]));
            let weight = weights[i].max(geman_mcclure(rest[0] * rest[0] + rest[1] * rest[1], scale_px * scale_px));
            let place = std::array::from_fn(|i| (detail.middle[i] - calibrator.camera.centre[i]) / half_width);
            Compared { place, moved, by_rows, weight: weight * prior_weight.min(MAX_PRIOR_WEIGHT) }
        })
    }
}
