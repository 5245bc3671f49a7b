//! When frames were taken: restores the camera's own rhythm from a source's time stamps.
//!
//! A camera exposes its frames evenly, at a rate that changes now and then (many halve it in low light). Where a driver, a bus or a busy
//! machine stamps frames as they arrive, they come late by what varies: jitter of milliseconds, stalls, then bursts of frames that
//! waited. With n the camera's count (gaps in it are real time), P its period and d a delay,
//!
//! ```text
//! stamp(n) = start + n P + d(n),   d(n) >= 0
//! ```
//!
//! [`Timing`] estimates P as the median of the slopes between the last frames that came in time (Theil and Sen), and d from the
//! lowest line of that slope; where there are too few such frames, by adding up how far each interval is from its share of P. An
//! interval that is on the rhythm is taken as it is, to the nanosecond: even times are never changed. One that is too short is the
//! rhythm's where the frame before was late by as much, or where no camera is so fast. One that is too long is the rhythm's where
//! frames of this source were as late before and made up for it; otherwise it is believed, so that a slower rate or a gap is followed
//! at once. There is no latency.
//!
//! This is the only place that judges and limits time between frames; every stage takes [`seconds_between`] and [`step_s`] as given.

use crate::frame::{Moment, Stamp};

/// Longest time between two frames that counts as motion (seconds): in a longer one anything may have happened.
const LONGEST_S: f64 = 1.0;
/// The virtual camera never moves for longer than this, or the nominal interval, from one frame to the next (seconds): in a gap nothing
/// was shown, and it must not catch up in one frame.
const LONGEST_STEP_S: f64 = 0.1;
/// Part of the period by which an interval on the rhythm may be off.
const EVEN: f64 = 0.02;
/// An interval below this part of the period, and of the nominal one, is no camera's.
const FASTEST: f64 = 0.4;
/// Impossibly short intervals in a row, with nothing to make up for, after which the camera is that fast: no driver queues as many frames.
const MAX_QUEUED: u32 = 40;
/// Delays up to this many times the largest one recently made up for count as delays.
const LATER: f64 = 1.5;
/// Part of the largest delay made up for that is forgotten with each frame.
const FORGET: f64 = 1.0 / 300.0;
/// Part of a delay that lasts with each frame that comes on the rhythm: one that is not made up for is none.
const LASTS: f64 = 0.7;
/// Part of the period by which an interval is off the rhythm clearly: several in a row are another rhythm.
const CLEARLY: f64 = 0.15;
/// Intervals in a row that make a new rhythm, and the part of their mean by which they may differ.
const AGREEING: usize = 3;
const ALIKE: f64 = 0.1;
/// Largest gap in the camera's count that is believed, frames.
const LARGEST_GAP: u64 = 300;
/// Frames whose stamps the period is estimated from, at most and at least.
const POINTS: usize = 32;
const MIN_POINTS: usize = 10;

/// Seconds from one [`Moment`]'s time to a later one's, as far as they count as motion.
pub fn seconds_between(before_ns: i64, now_ns: i64) -> f64 {
    (now_ns.saturating_sub(before_ns) as f64 * 1e-9).min(LONGEST_S)
}

/// The part of `interval_s` seconds between two frames in which the virtual camera moves; frames come every `nominal_s` seconds.
pub fn step_s(interval_s: f64, nominal_s: f64) -> f64 {
    interval_s.min(LONGEST_STEP_S.max(nominal_s))
}

/// Judges the stamps of a source's frames, one after the other.
#[derive(Clone, Debug)]
pub struct Timing {
    nominal_ns: f64,
    /// The period as it is estimated.
    period_ns: f64,
    last: Option<Stamp>,
    /// The last frame's judged time, and the camera's count.
    time_ns: i64,
    count: u64,
    /// How late the last frame's stamp was.
    late_ns: f64,
    /// Delay that the last frames in a row made up for, and the largest such, slowly forgotten.
    caught_up_ns: f64,
    proven_ns: f64,
    /// Periods that the last intervals in a row suggest, all clearly off the rhythm.
    odd_ns: [f64; AGREEING],
    odd: usize,
    /// Impossibly short intervals in a row that made up for nothing.
    queued: u32,
    line: Line,
}

/// The classification of an interval.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Verdict {
    /// On the rhythm.
    Even,
    /// Short, as the frame before was late.
    CaughtUp,
    /// Shorter than a camera's; the frame before must have been late, or this one has the time of another clock.
    Impossible,
    /// Off the rhythm by no more than this source's delays.
    Jitter,
    /// Long or short: believed.
    Believed,
}

impl Timing {
    /// For a source whose frames are said to come every `nominal_s` seconds (clamped to 0.0001 to 10).
    pub fn new(nominal_s: f64) -> Self {
        let nominal_ns = 1e9 * nominal_s.clamp(1e-4, 10.0);
        Self {
            nominal_ns,
            period_ns: nominal_ns,
            last: None,
            time_ns: 0,
            count: 0,
            late_ns: 0.0,
            caught_up_ns: 0.0,
            proven_ns: 0.0,
            odd_ns: [0.0; AGREEING],
            odd: 0,
            queued: 0,
            line: Line::default(),
        }
    }

    /// When the next frame was taken: its [`Moment`] lies after that of the frame before, whatever the stamps say.
    pub fn judge(&mut self, stamp: &Stamp) -> Moment {
        let Some(last) = self.last.replace(*stamp) else {
            self.line.push(0, stamp.time_ns);
            return Moment::default();
        };
        let passed_ns = stamp.time_ns.saturating_sub(last.time_ns);
        let counted = stamp.sequence.checked_sub(last.sequence);
        let counted = counted.filter(|frames| (1..=LARGEST_GAP).contains(frames)).unwrap_or(1);
        let leap_ns = (1e9 * LONGEST_S).max(3.0 * self.nominal_ns);
        if passed_ns as f64 > leap_ns || (passed_ns as f64) < -self.period_ns {
            // the camera was away, or the clock is another
            let judged_ns =
                if passed_ns > 0 { 1e9 * LONGEST_S } else { (counted as f64 * self.period_ns).min(1e9 * LONGEST_S) };
            self.begin(counted, stamp.time_ns);
            return self.moment(judged_ns as i64, passed_ns, false);
        }
        let frames = self.frames(counted, passed_ns as f64);
        self.count += frames;
        let expected_ns = frames as f64 * self.period_ns;
        let off_ns = passed_ns as f64 - expected_ns;
        let is_too_short = (passed_ns as f64) < FASTEST * frames as f64 * self.period_ns.min(self.nominal_ns);
        let verdict = self.verdict(off_ns, is_too_short);
        let was_late_ns = self.late_ns;
        self.remember(verdict, off_ns, is_too_short);
        self.update_clock(verdict, (off_ns, is_too_short), stamp.time_ns);
        if is_too_short {
            self.follow_haste(verdict, passed_ns as f64 / frames as f64, stamp.time_ns);
        } else {
            self.follow_rate(verdict, (was_late_ns, off_ns), passed_ns as f64 / frames as f64, stamp.time_ns);
        }
        match verdict {
            Verdict::Even => self.moment(passed_ns, passed_ns, true),
            Verdict::CaughtUp => self.moment(expected_ns.round() as i64, passed_ns, true),
            Verdict::Jitter => self.moment(expected_ns.round() as i64, passed_ns, !is_too_short),
            Verdict::Impossible => self.moment(expected_ns.round() as i64, passed_ns, false),
            Verdict::Believed => self.moment(passed_ns, passed_ns, false),
        }
    }

    /// A frame that was taken `judged_ns` after the one before, where the stamps say `passed_ns`.
    fn moment(&mut self, judged_ns: i64, passed_ns: i64, is_certain: bool) -> Moment {
        self.time_ns = self.time_ns.saturating_add(judged_ns.max(1));
        Moment { time_ns: self.time_ns, off_s: passed_ns.saturating_sub(judged_ns) as f64 * 1e-9, is_certain }
    }

    /// Starts over from a frame stamped `time_ns`, `frames` after the last one.
    fn begin(&mut self, frames: u64, time_ns: i64) {
        self.count += frames;
        (self.late_ns, self.caught_up_ns, self.odd, self.queued) = (0.0, 0.0, 0, 0);
        self.line.clear();
        self.line.push(self.count, time_ns);
    }

    /// Delays of this source up to which none is an outlier (nanoseconds).
    fn usual_delay_ns(&self) -> f64 {
        LATER * self.proven_ns
    }

    /// Frames of the camera in `passed_ns`, of which it counted `counted`. Where so many cannot have passed, not even since the frame
    /// before was due, the count is not the camera's.
    fn frames(&self, counted: u64, passed_ns: f64) -> u64 {
        let since_due_ns = self.late_ns + passed_ns;
        let least_ns = (counted as f64 - EVEN) * self.period_ns - self.usual_delay_ns();
        if counted == 1 || since_due_ns >= least_ns { counted } else { (since_due_ns / self.period_ns).round().max(1.0) as u64 }
    }

    /// What an interval is that is `off_ns` longer than the rhythm's; `is_too_short` for a camera's.
    fn verdict(&self, off_ns: f64, is_too_short: bool) -> Verdict {
        let Self { period_ns, late_ns, .. } = *self;
        let even_ns = EVEN * period_ns;
        let usual_ns = self.usual_delay_ns();
        match () {
            () if off_ns.abs() <= even_ns => Verdict::Even,
            () if off_ns < 0.0 && late_ns + off_ns >= -even_ns => Verdict::CaughtUp,
            () if off_ns < 0.0 && -off_ns <= usual_ns && (self.odd == 0 || is_too_short) => Verdict::Jitter,
            () if is_too_short => Verdict::Impossible,
            // a frame that is late behind one that was late by more than jitter is a slower camera's
            () if off_ns > 0.0 && late_ns + off_ns <= usual_ns && late_ns.min(off_ns) <= 0.5 * period_ns => Verdict::Jitter,
            () => Verdict::Believed,
        }
    }

    /// Keeps account of delays.
    fn remember(&mut self, verdict: Verdict, off_ns: f64, is_too_short: bool) {
        self.proven_ns *= 1.0 - FORGET;
        if verdict == Verdict::CaughtUp || is_too_short {
            self.caught_up_ns -= off_ns;
            self.proven_ns = self.proven_ns.max(self.caught_up_ns);
        } else if off_ns >= -EVEN * self.period_ns {
            self.caught_up_ns = 0.0;
        }
        let lasts = if verdict == Verdict::Even { LASTS } else { 1.0 };
        self.late_ns = lasts * (self.late_ns + off_ns).clamp(0.0, 1e9 * LONGEST_S);
    }

    /// Takes the frame as a point of the line that the period is the slope of, where it came in time.
    fn update_clock(&mut self, verdict: Verdict, (off_ns, is_too_short): (f64, bool), time_ns: i64) {
        if verdict == Verdict::Impossible || (verdict == Verdict::Believed && off_ns > 0.5 * self.period_ns) {
            self.line.clear();
        }
        let is_in_time = self.late_ns <= self.period_ns && (verdict == Verdict::CaughtUp || !is_too_short);
        if is_in_time {
            self.line.push(self.count, time_ns);
        }
        if let Some(slope_ns) = self.line.slope_ns().filter(|_| is_in_time) {
            self.period_ns = slope_ns;
            self.late_ns = self.line.above_ns(slope_ns, (self.count, time_ns)).clamp(0.0, 1e9 * LONGEST_S);
        }
    }

    /// Notices a camera that is so much faster than it is said to be that its intervals, of `suggested_ns`, are too short.
    fn follow_haste(&mut self, verdict: Verdict, suggested_ns: f64, time_ns: i64) {
        self.queued = if verdict == Verdict::CaughtUp { 0 } else { self.queued + 1 };
        if self.queued > MAX_QUEUED && suggested_ns > 0.0 {
            (self.nominal_ns, self.period_ns, self.proven_ns) = (suggested_ns, suggested_ns, 0.0);
            self.begin(0, time_ns);
        }
    }

    /// Notices another rate: a few intervals in a row that agree with each other and not with the period. One of them suggests
    /// `suggested_ns`.
    fn follow_rate(&mut self, verdict: Verdict, (was_late_ns, off_ns): (f64, f64), suggested_ns: f64, time_ns: i64) {
        self.queued = 0;
        let clearly_ns = CLEARLY * self.period_ns;
        let is_odd = match verdict {
            Verdict::Believed => true,
            Verdict::Jitter => off_ns < 0.0 || (off_ns > clearly_ns && was_late_ns > 0.5 * self.period_ns),
            _ => false,
        };
        if !is_odd {
            self.odd = 0;
            return;
        }
        self.odd_ns.rotate_left(1);
        self.odd_ns[AGREEING - 1] = suggested_ns;
        self.odd += 1;
        let mean_ns = self.odd_ns.iter().sum::<f64>() / AGREEING as f64;
        let spread_ns = (ALIKE * mean_ns).max(0.3 * self.usual_delay_ns());
        let agree = self.odd_ns.iter().all(|period_ns| (period_ns - mean_ns).abs() <= spread_ns);
        if self.odd >= AGREEING && agree && mean_ns > 0.0 {
            self.period_ns = mean_ns;
            self.proven_ns = self.proven_ns.min(0.5 * mean_ns);
            self.begin(0, time_ns);
        }
    }
}

/// The last frames' counts and stamps.
#[derive(Clone, Debug, Default)]
struct Line {
    points: [(u64, i64); POINTS],
    len: usize,
}

impl Line {
    fn clear(&mut self) {
        self.len = 0;
    }

    fn push(&mut self, count: u64, time_ns: i64) {
        if self.len == POINTS {
            self.points.rotate_left(1);
            self.len -= 1;
        }
        self.points[self.len] = (count, time_ns);
        self.len += 1;
    }

    /// How far a point is above the lowest line of the given slope (nanoseconds).
    fn above_ns(&self, slope_ns: f64, point: (u64, i64)) -> f64 {
        let apart = |&(count, time_ns): &(u64, i64)| (point.1 - time_ns) as f64 - slope_ns * (point.0 as f64 - count as f64);
        self.points[..self.len].iter().map(apart).fold(0.0, f64::max)
    }

    /// Median of the slopes between all points (nanoseconds a frame), where there are enough.
    fn slope_ns(&self) -> Option<f64> {
        let mut slopes = [0.0; POINTS * (POINTS - 1) / 2];
        let mut len = 0;
        for (i, later) in self.points[..self.len].iter().enumerate() {
            for sooner in &self.points[..i] {
                slopes[len] = (later.1 - sooner.1) as f64 / (later.0 - sooner.0).max(1) as f64;
                len += 1;
            }
        }
        if self.len < MIN_POINTS {
            return None;
        }
        let (_, median, _) = slopes[..len].select_nth_unstable_by(len / 2, f64::total_cmp);
        Some(*median).filter(|slope_ns| *slope_ns > 0.0)
    }
}

#[cfg(test)]
mod tests;
