//! Statistics of a run: processing time of each stage, and counts of frames by outcome.

use std::time::Instant;

use serde_json::{Map, Value, json};

use super::Histogram;
use crate::frame::{Frame, HoldReason, Outcome, Stage};
use crate::image::PictureRef;
use crate::pipeline::{Observer, Reason, Totals};

/// Times of every stage and of the whole frame, in bounded memory.
#[derive(Debug)]
pub struct Stats {
    stages: [Histogram; Stage::ALL.len()],
    total: Histogram,
    seen: Totals,
    started: Instant,
}

impl Default for Stats {
    fn default() -> Self {
        Self { stages: Default::default(), total: Histogram::default(), seen: Totals::default(), started: Instant::now() }
    }
}

/// Count, median, 99th percentile and maximum, in milliseconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Times {
    /// Frames that went through the stage.
    pub count: u64,
    /// Median, ms.
    pub median_ms: f64,
    /// 99th percentile, ms.
    pub p99_ms: f64,
    /// Maximum, ms.
    pub max_ms: f64,
}

impl Stats {
    /// Counts the times of a frame's stages (nanoseconds).
    pub fn add_times(&mut self, spent_ns: &[u64; Stage::ALL.len()]) {
        for (histogram, &ns) in self.stages.iter_mut().zip(spent_ns) {
            // A stage that a frame skipped has spent nothing; counting it would flatter the median.
            if ns > 0 {
                histogram.add(ns);
            }
        }
        self.total.add(spent_ns.iter().sum());
    }

    /// Times of one stage.
    pub fn stage(&self, stage: Stage) -> Times {
        times(&self.stages[stage as usize])
    }

    /// Times of whole frames: the sums of their stages.
    pub fn total(&self) -> Times {
        times(&self.total)
    }

    /// What became of the frames sent so far; all that is known where the run itself ended in an error.
    pub fn seen(&self) -> &Totals {
        &self.seen
    }

    /// Everything as JSON, with `totals` of the run. Times in milliseconds; `wall_s` counts from the making of the statistics.
    pub fn json(&self, totals: &Totals) -> Value {
        let mut stages = Map::new();
        for stage in Stage::ALL {
            stages.insert(stage.name().into(), json_of(self.stage(stage)));
        }
        let reasons = Reason::ALL.into_iter().filter(|&reason| totals.unusable.count(reason) > 0);
        let unusable: Map<String, Value> =
            reasons.map(|reason| (reason.name().to_owned(), totals.unusable.count(reason).into())).collect();
        let wall_s = self.started.elapsed().as_secs_f64();
        json!({
            "frames": {
                "in": totals.frames_in,
                "out": totals.frames_out,
                "stabilized": totals.stabilized,
                "held": totals.held,
                "passed_through": totals.passed_through,
                "damaged": totals.damaged,
                "cut": totals.cut,
                "dropped": totals.dropped,
                "unusable": unusable,
            },
            "wall_s": wall_s,
            "frames_per_s": totals.frames_out as f64 / wall_s.max(1e-9),
            "stages": stages,
            "total": json_of(self.total()),
        })
    }
}

impl Observer for Stats {
    fn drawn(&mut self, _: &Frame, _: PictureRef<'_>) {}

    fn sent(&mut self, frame: &Frame) {
        self.add_times(&frame.context.spent_ns);
        self.seen.frames_in += 1;
        self.seen.frames_out += 1;
        self.seen.cut += u64::from(frame.cut);
        match frame.context.outcome {
            Outcome::Stabilized => self.seen.stabilized += 1,
            Outcome::Held(HoldReason::Damaged) => {
                self.seen.held += 1;
                self.seen.damaged += 1;
            }
            Outcome::PassedThrough(_) => self.seen.passed_through += 1,
            Outcome::Pending => {}
        }
    }
}

fn times(histogram: &Histogram) -> Times {
    let ms = |ns: u64| ns as f64 / 1e6;
    Times {
        count: histogram.count(),
        median_ms: ms(histogram.quantile(0.5)),
        p99_ms: ms(histogram.quantile(0.99)),
        max_ms: ms(histogram.max()),
    }
}

fn json_of(times: Times) -> Value {
    json!({ "count": times.count, "median_ms": times.median_ms, "p99_ms": times.p99_ms, "max_ms": times.max_ms })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_of_known_frames() {
        let mut stats = Stats::default();
        let mut frame = Frame::default();
        for ms in 1..=100 {
            frame.context.spent_ns[Stage::Warp as usize] = ms * 1_000_000;
            frame.context.spent_ns[Stage::Fit as usize] = if ms == 7 { 2_000_000 } else { 0 };
            stats.sent(&frame);
        }
        let json = stats.json(&Totals { frames_in: 100, frames_out: 99, ..Totals::default() });
        let warp = &json["stages"]["warp"];
        assert_eq!(warp["count"], 100);
        assert!((warp["median_ms"].as_f64().unwrap() - 50.0).abs() < 0.5, "{warp}");
        assert!((warp["p99_ms"].as_f64().unwrap() - 99.0).abs() < 1.0, "{warp}");
        assert_eq!(warp["max_ms"], 100.0);
        assert_eq!((&json["stages"]["fit"]["count"], &json["total"]["count"]), (&json!(1), &json!(100)));
        assert_eq!((&json["frames"]["in"], &json["frames"]["out"]), (&json!(100), &json!(99)));
    }
}
