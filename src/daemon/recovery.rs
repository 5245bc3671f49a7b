//! Recovery from unusable frames: the stream is restarted, then the next-best pixel format is tried.
//!
//! Only decisions are made here; [`super::monitored_source`] carries them out.

use crate::control::RejectedFormat;
use crate::device::v4l2::Avoided;
use crate::image::PixelFormat;

const SECOND_NS: i64 = 1_000_000_000;

/// How long no frame may be usable before something is done (nanoseconds): at first, and at most, after it was doubled each time
/// that everything had been tried.
const PAUSE_NS: (i64, i64) = (3 * SECOND_NS, 300 * SECOND_NS);

/// Frames that must have come meanwhile: of a slow camera, a few more are waited for.
const MIN_FRAMES: u64 = 5;

/// Times as long where no frame comes at all; a stream that gives nothing is restarted by its capture.
const SILENT: i64 = 4;

/// A format that gave so many usable frames works, whatever happens later ...
const WORKS: u64 = 10;

/// ... and its stream is restarted so often before another format is tried; one that never worked, once.
const RESTARTS: u32 = 2;

/// Formats that are remembered as left, of all cameras.
const MAX_LEFT: usize = 32;

/// What is to be done.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Step {
    /// Nothing.
    #[default]
    GoOn,
    /// The stream is to be stopped and started.
    Restart,
    /// The camera is to be opened with its next-best format.
    NextFormat,
    /// All formats were tried: the camera is to be opened with its best one again.
    FirstFormat,
}

/// Follows a camera from when it is opened, through its formats.
#[derive(Clone, Copy, Debug)]
pub(super) struct Recovery {
    /// Without a usable frame for this long, something is done.
    pause_ns: i64,
    /// When a usable frame came last, or something was done; frames of the stream by then, usable and all.
    since_ns: i64,
    usable: u64,
    frames: u64,
    /// Times this stream was restarted since a usable frame came.
    restarts: u32,
    works: bool,
    /// Whether there is a format to try after this one, and whether others were left for it.
    next: bool,
    left: bool,
}

impl Recovery {
    /// For a camera that was not open before, or was closed for another reason.
    pub(super) fn new() -> Self {
        Self { pause_ns: PAUSE_NS.0, since_ns: 0, usable: 0, frames: 0, restarts: 0, works: false, next: false, left: false }
    }

    /// A stream begins at `now_ns`. `next` says whether the camera has another format to try, `left` whether others of its formats
    /// were left.
    pub(super) fn begin(&mut self, now_ns: i64, next: bool, left: bool) {
        *self = Self { pause_ns: self.pause_ns, since_ns: now_ns, next, left, ..Self::new() };
    }

    /// Whether the stream's format gives usable frames.
    pub(super) fn works(&self) -> bool {
        self.works
    }

    /// To be asked a few times a second: what to do at `now_ns`, when the stream has given `frames`, of which `unusable` ones.
    pub(super) fn look(&mut self, now_ns: i64, frames: u64, unusable: u64) -> Step {
        let usable = frames.saturating_sub(unusable);
        if usable > self.usable {
            (self.usable, self.restarts) = (usable, 0);
            self.mark(now_ns, frames);
            if usable >= WORKS {
                (self.works, self.pause_ns) = (true, PAUSE_NS.0);
            }
            return Step::GoOn;
        }
        let passed_ns = now_ns.saturating_sub(self.since_ns);
        if frames == 0 {
            let over = passed_ns >= SILENT * self.pause_ns && (self.next || self.left);
            return if over { self.other_format(now_ns, frames) } else { Step::GoOn };
        }
        if passed_ns < self.pause_ns || frames.saturating_sub(self.frames) < MIN_FRAMES {
            return Step::GoOn;
        }
        if self.restarts < if self.works { RESTARTS } else { 1 } {
            self.restarts += 1;
            self.mark(now_ns, frames);
            return Step::Restart;
        }
        self.other_format(now_ns, frames)
    }

    /// Everything was tried: the next round takes longer.
    pub(super) fn goes_round(&mut self) {
        self.pause_ns = self.pause_ns.saturating_mul(2).min(PAUSE_NS.1);
    }

    fn mark(&mut self, now_ns: i64, frames: u64) {
        (self.since_ns, self.frames) = (now_ns, frames);
    }

    /// This format is given up, for now.
    fn other_format(&mut self, now_ns: i64, frames: u64) -> Step {
        self.mark(now_ns, frames);
        if self.next {
            return Step::NextFormat;
        }
        self.goes_round();
        if self.left { Step::FirstFormat } else { Step::Restart }
    }
}

/// The formats of cameras that gave no usable frame, for as long as the daemon runs.
#[derive(Debug, Default)]
pub(super) struct RejectedFormats(Vec<Left>);

#[derive(Debug)]
struct Left {
    format: Avoided,
    what: String,
    /// Not to be tried now.
    avoided: bool,
}

impl RejectedFormats {
    /// `pixel` of the camera of this name at this bus gave no usable frame, for the reason `what`.
    pub(super) fn leave(&mut self, (card, bus): &(String, String), pixel: PixelFormat, what: String) {
        self.forget(card, bus, pixel);
        if self.0.len() >= MAX_LEFT {
            self.0.remove(0);
        }
        let format = Avoided { card: card.clone(), bus: bus.clone(), pixel };
        self.0.push(Left { format, what, avoided: true });
    }

    /// All formats of this camera may be tried again.
    pub(super) fn try_again(&mut self, (card, bus): &(String, String)) {
        self.0.iter_mut().filter(|left| left.format.is_of(card, bus)).for_each(|left| left.avoided = false);
    }

    /// All formats of every camera may be tried again; whether any was avoided.
    pub(super) fn try_all_again(&mut self) -> bool {
        let any = self.0.iter().any(|left| left.avoided);
        self.0.iter_mut().for_each(|left| left.avoided = false);
        any
    }

    /// `pixel` of this camera works after all.
    pub(super) fn forget(&mut self, card: &str, bus: &str, pixel: PixelFormat) {
        self.0.retain(|left| !(left.format.is_of(card, bus) && left.format.pixel == pixel));
    }

    /// Whether formats of this camera are avoided now.
    pub(super) fn any(&self, (card, bus): &(String, String)) -> bool {
        self.0.iter().any(|left| left.avoided && left.format.is_of(card, bus))
    }

    /// What is not to be chosen now.
    pub(super) fn avoided(&self) -> Vec<Avoided> {
        self.0.iter().filter(|left| left.avoided).map(|left| left.format.clone()).collect()
    }

    /// The same for the status.
    pub(super) fn for_status(&self) -> Vec<RejectedFormat> {
        let rejected = |left: &Left| RejectedFormat {
            camera: left.format.card.clone(),
            format: left.format.pixel.to_string(),
            what: left.what.clone(),
        };
        self.0.iter().map(rejected).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Looks four times a second at a camera of 30 frames a second; gives the steps with their times (seconds). `usable` says
    /// whether the frame at a time (seconds after the stream began) can be used, `None` that none comes.
    fn follow(recovery: &mut Recovery, from_s: f64, seconds: f64, usable: impl Fn(f64) -> Option<bool>) -> Vec<(f64, Step)> {
        let (mut frames, mut unusable, mut steps) = (0, 0, Vec::new());
        for n in 0..(seconds * 120.0) as u32 {
            let time = f64::from(n) / 120.0;
            if n % 4 == 3
                && let Some(usable) = usable(time)
            {
                frames += 1;
                unusable += u64::from(!usable);
            }
            if n % 30 == 29 {
                let at = from_s + (time * 4.0).ceil() / 4.0;
                let step = recovery.look((at * 1e9) as i64, frames, unusable);
                if step != Step::GoOn {
                    steps.push((at, step));
                    if step != Step::Restart {
                        break;
                    }
                }
            }
        }
        steps
    }

    fn begun(next: bool, left: bool) -> Recovery {
        let mut recovery = Recovery::new();
        recovery.begin(0, next, left);
        recovery
    }

    #[test]
    fn the_stream_is_restarted_and_then_the_next_format_tried() {
        let steps = follow(&mut begun(true, false), 0.0, 60.0, |_| Some(false));
        assert_eq!(steps, [(3.0, Step::Restart), (6.0, Step::NextFormat)]);
    }

    #[test]
    fn without_another_format_it_is_restarted_ever_more_rarely() {
        let steps = follow(&mut begun(false, false), 0.0, 2000.0, |_| Some(false));
        let times: Vec<f64> = steps.iter().map(|(at, _)| *at).collect();
        assert_eq!(times[..9], [3.0, 6.0, 12.0, 24.0, 48.0, 96.0, 192.0, 384.0, 684.0]);
        assert!(times.windows(2).all(|pair| pair[1] - pair[0] <= 300.0), "{times:?}");
        assert!(steps.iter().all(|(_, step)| *step == Step::Restart));
    }

    #[test]
    fn when_all_formats_were_tried_it_goes_round_ever_more_rarely() {
        let mut recovery = Recovery::new();
        let (mut at, mut rounds) = (0.0, Vec::new());
        for _ in 0..12 {
            let begun = at;
            for (next, left) in [(true, false), (true, true), (false, true)] {
                recovery.begin((at * 1e9) as i64, next, left);
                let (end, step) = *follow(&mut recovery, at, 1000.0, |_| Some(false)).last().unwrap();
                assert_eq!(step, if next { Step::NextFormat } else { Step::FirstFormat });
                at = end;
            }
            rounds.push(at - begun);
        }
        assert_eq!(rounds[..3], [18.0, 36.0, 72.0]);
        assert_eq!(rounds[11], 1800.0);
    }

    #[test]
    fn a_single_usable_frame_now_and_then_is_enough() {
        let steps = follow(&mut begun(true, true), 0.0, 300.0, |time| Some(time % 2.0 < 1.0 / 30.0));
        assert_eq!(steps, []);
    }

    #[test]
    fn damage_that_passes_costs_no_format() {
        let mut recovery = begun(true, false);
        let steps = follow(&mut recovery, 0.0, 100.0, |time| Some(!(20.0..28.0).contains(&time)));
        assert_eq!(steps, [(23.0, Step::Restart), (26.0, Step::Restart)]);
        assert!(recovery.works());
        let steps = follow(&mut begun(true, false), 0.0, 100.0, |time| Some(time < 20.0));
        assert_eq!(steps.last(), Some(&(29.0, Step::NextFormat)), "{steps:?}");
    }

    #[test]
    fn a_format_that_gives_nothing_at_all_is_left_and_one_that_fell_silent_is_not() {
        assert_eq!(follow(&mut begun(true, false), 0.0, 60.0, |_| None), [(12.0, Step::NextFormat)]);
        assert_eq!(follow(&mut begun(false, true), 0.0, 60.0, |_| None), [(12.0, Step::FirstFormat)]);
        assert_eq!(follow(&mut begun(false, false), 0.0, 600.0, |_| None), [], "its capture restarts it");
        assert_eq!(follow(&mut begun(true, true), 0.0, 600.0, |time| (time < 1.0).then_some(true)), []);
        assert_eq!(follow(&mut begun(true, true), 0.0, 600.0, |time| (time < 0.05).then_some(false)), [], "one bad frame");
    }

    #[test]
    fn formats_are_left_for_one_camera_and_tried_again() {
        let (one, two) = (("Cam".to_owned(), "usb-1".to_owned()), ("Cam".to_owned(), "usb-2".to_owned()));
        let mut left = RejectedFormats::default();
        left.leave(&one, PixelFormat::Mjpeg, "damaged".into());
        left.leave(&one, PixelFormat::Mjpeg, "damaged again".into());
        left.leave(&one, PixelFormat::Nv12, "empty".into());
        assert_eq!((left.any(&one), left.any(&two), left.avoided().len()), (true, false, 2));
        left.try_again(&two);
        assert!(left.any(&one));
        left.try_again(&one);
        assert_eq!((left.any(&one), left.avoided().len(), left.for_status().len()), (false, 0, 2), "tried, and not forgotten");
        left.leave(&one, PixelFormat::Nv12, "empty".into());
        assert!(left.try_all_again() && !left.try_all_again() && !left.any(&one));
        left.forget(&one.0, &one.1, PixelFormat::Mjpeg);
        assert_eq!(left.for_status()[0].what, "empty");
        for n in 0..100 {
            left.leave(&(n.to_string(), String::new()), PixelFormat::Yuyv, String::new());
        }
        assert_eq!(left.for_status().len(), MAX_LEFT);
    }
}
