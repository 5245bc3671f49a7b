//! Settings that change while frames go by: the drawn correction glides, no frame is late or missing, no memory is taken.

mod common;

use common::{Memory, Script, Seen, Shot, film, frame_of};
use gimbald::config::keys::KEYS;
use gimbald::config::{Key, Kind, Settings};
use gimbald::device::null::NullSink;
use gimbald::device::synthetic::{self, Motion};
use gimbald::device::{DeviceError, FrameSink, FrameSource, Lent, StreamFormat};
use gimbald::frame::{Frame, Outcome, PassReason};
use gimbald::image::PictureRef;
use gimbald::pipeline::{Counts, Live, Observer, Params, Reason, Stabilizer, run_live};
use gimbald::rt::stop::Stop;
use gimbald::stage::shutter::{self, Model, Parameters};
use gimbald::stage::{crop, smooth};
use std::sync::atomic::{AtomicUsize, Ordering};

const SIZE: [u32; 2] = [240, 180];
const FRAMES: usize = 210;
const FPS: f64 = 30.0;
/// A change asked for before the frame of that number.
type Change = (usize, Params);

fn shaken(motion: Motion) -> Vec<Shot> {
    let [width, height] = SIZE;
    film(&synthetic::Params { width, height, motion, frames: FRAMES as u64, gain: 0.5, ..synthetic::Params::default() })
}

/// Walks the film through, with changes on the way; every frame must come out in its time.
fn carried(shots: &[Shot], start: &Params, changes: &[Change], late: usize) -> Vec<Seen> {
    let format = shots[0].format;
    let mut sink = NullSink::new(&format);
    let (mut stabilizer, mut memory) = (Stabilizer::new(start, &format, &sink.format()), Memory::default());
    for (n, shot) in shots.iter().enumerate() {
        changes.iter().filter(|(at, _)| *at == n).for_each(|(_, params)| stabilizer.set_params(params));
        stabilizer.push(Box::new(frame_of(shot)));
        while stabilizer.emit(&mut sink, &mut memory).unwrap().is_some() {}
        while stabilizer.give_back().is_some() {}
        if n > 0 {
            assert_eq!(memory.seen.len(), n + 1 - late, "after frame {n}");
        }
    }
    memory.seen
}

/// How far the picture's corners or centre moved over the camera's picture from the frame before (pixels), at most.
fn step(seen: &[Seen], n: usize) -> f64 {
    let corners = seen[n - 1].corners().into_iter().zip(seen[n].corners());
    corners.map(|(before, now)| (now[0] - before[0]).hypot(now[1] - before[1])).fold(0.0, f64::max)
}

/// Half of the picture that a zoom hides, along the diagonal (pixels): the largest correction.
fn margin(zoom: f64) -> f64 {
    let [width, height] = SIZE.map(f64::from);
    0.5 * (1.0 - 1.0 / zoom) * width.hypot(height)
}

fn models() -> [(Params, usize); 3] {
    [(Model::Cho2007, Parameters::TimeT, 1), (Model::Cho2007, Parameters::TimeT1, 0), (Model::Continuous, Parameters::TimeT, 0)]
        .map(|(model, parameters, late)| (Params { shutter: shutter::Params { model, parameters }, ..Params::default() }, late))
}

#[test]
fn switching_off_and_on_fades_and_keeps_time() {
    for motion in [Motion::Walk] {
        let shots = shaken(motion);
        for (on, late) in models() {
            let off = Params { enabled: false, ..on };
            let always = carried(&shots, &on, &[], late);
            let seen = carried(&shots, &on, &[(60, off), (130, on), (160, off), (170, on)], late);
            let what = format!("{motion:?} {:?} {:?}", on.shutter.model, on.shutter.parameters);
            // in one frame no more of the correction comes or goes than the fade allows: 5 % of the largest there can be
            let allowed = 1.5 / FPS * margin(on.crop.zoom);
            let mut most = 0.0f64;
            for n in 1..seen.len() {
                let more = step(&seen, n) - step(&always, n);
                assert!(more <= allowed + 1e-6, "{what}: frame {n} jumps {more} px farther than without a switch");
                most = most.max(more);
            }
            println!("{what}: at a switch a frame moves by {most:.2} px more than without, {allowed:.2} allowed");
            assert!(most > 0.0, "{what}: nothing was switched");
            // a second after the switch nothing is corrected any more
            let off: Vec<usize> =
                (0..FRAMES - late).filter(|&n| seen[n].outcome == Outcome::PassedThrough(PassReason::SwitchedOff)).collect();
            let first = off.first().copied().unwrap_or(FRAMES);
            assert!((88..=91).contains(&(first + late)), "{what}: off from frame {first}");
            assert_eq!(off, (first..130 - late).collect::<Vec<_>>(), "{what}");
            assert!(off.iter().all(|&n| seen[n].crop_use < 1e-6), "{what}: still corrected");
            let end = seen.len() - 1;
            // the planner leaves room for the motion of the rows that is shown, and so differs by a little
            for (now, then) in seen[end].corners().into_iter().zip(always[end].corners()) {
                let off = (now[0] - then[0]).hypot(now[1] - then[1]);
                assert!(off < 0.5, "{what}: {off} px from where it were had it never been off");
            }
        }
    }
}

#[test]
fn strength_zoom_and_mode_glide() {
    let iir = |cutoff_hz| smooth::Params { mode: smooth::Mode::Iir, cutoff_hz, ..smooth::Params::default() };
    let weak = smooth::Params { strength: 0.2, ..smooth::Params::default() };
    for motion in [Motion::Handheld] {
        let shots = shaken(motion);
        let start = Params::default();
        let ways = [
            ("strength", Params { smooth: weak, ..start }),
            ("zoom", Params { crop: crop::Params { zoom: 1.3, ..start.crop }, ..start }),
            ("mode", Params { smooth: iir(0.6), ..start }),
            ("cutoff", Params { smooth: iir(3.0), ..start }),
        ];
        for (what, other) in ways {
            let seen = carried(&shots, &start, &[(70, other), (140, start)], 0);
            let around = |n: &usize| (70..100).contains(n) || (140..170).contains(n);
            let most = |with: &dyn Fn(&usize) -> bool| (1..FRAMES).filter(with).map(|n| step(&seen, n)).fold(0.0, f64::max);
            let (near, far) = (most(&around), most(&|n| !around(n)));
            println!("{motion:?}, {what}: within a second of a change a frame moves by {near:.2} px at most, else {far:.2}");
            // of a window of 14 pixels
            assert!(near <= far + 1.5, "{motion:?}, {what}: a change of settings moves a frame by {near} px, others {far}");
        }
    }
}

/// Every value of a live key to which the test changes it: other words, a fifth of the range further on.
fn others(key: &Key, settings: &Settings) -> Vec<Settings> {
    let with = |change: &dyn Fn(&mut Settings)| {
        let mut other = settings.clone();
        change(&mut other);
        other
    };
    let further = |(low, high): (f64, f64), value: f64| {
        let step = 0.2 * (high - low);
        if value + step <= high { value + step } else { value - step }
    };
    match &key.kind {
        Kind::NamedNumber { range, names, get, set } => {
            let now = get(settings);
            let named = names.iter().filter(|(_, number)| *number != now).map(|(_, number)| with(&|s| set(s, *number)));
            named.chain([with(&|s| set(s, further(*range, now)))]).collect()
        }
        Kind::Number { range, get, set } => vec![with(&|s| set(s, further(*range, get(settings))))],
        Kind::NumberOrAuto { range, get, set } => {
            let number = get(settings).unwrap_or(range.0);
            vec![with(&|s| set(s, Some(further(*range, number)))), with(&|s| set(s, None))]
        }
        Kind::Choice { words, get, set } => {
            let now = get(settings);
            words.iter().filter(|word| **word != now).map(|word| with(&|s| set(s, word))).collect()
        }
        Kind::Switch { get, set } => vec![with(&|s| set(s, !get(settings)))],
        Kind::SwitchOrAuto { .. } | Kind::Count { .. } | Kind::Text { .. } | Kind::Form { .. } => {
            panic!("{}: no live key of this kind is known here", key.name)
        }
    }
}

/// The picture does not jump when a live key changes, whichever it is and whatever else is set.
#[test]
fn every_live_key_glides() {
    const CHANGES: [usize; 2] = [50, 90];
    let shots = &shaken(Motion::Handheld)[..130];
    let mut tried = 0;
    for base in ["smooth.mode=adaptive", "smooth.mode=iir", "crop.border=mirror", "camera.lens_k1=-0.12"] {
        let base = Settings::read(None, &[base.to_owned()]).unwrap();
        let far = carried(shots, &base.pipeline, &[], 0);
        let far = (1..far.len()).map(|n| step(&far, n)).fold(0.0, f64::max);
        for key in KEYS.iter().filter(|key| key.live && key.section() != "log") {
            for other in others(key, &base) {
                assert_ne!(other.pipeline, base.pipeline, "{}: does not reach the pipeline", key.name);
                let seen = carried(shots, &base.pipeline, &[(CHANGES[0], other.pipeline), (CHANGES[1], base.pipeline)], 0);
                let near = (CHANGES[0]..shots.len()).map(|n| step(&seen, n)).fold(0.0, f64::max);
                // of a window of 14 pixels, as in `strength_zoom_and_mode_glide`
                let change = format!("{} from {} to {}", key.name, key.value_text(&base), key.value_text(&other));
                assert!(near <= far + 1.5, "{change}: a frame moves by {near} px, without a change by {far} at most");
                tried += 1;
            }
        }
    }
    println!("{tried} changes");
    assert!(tried >= 3 * 10, "only {tried} changes were tried");
}

/// Gives a frame when the one before was sent, so that none is given up.
struct OneByOne<'a> {
    script: Script,
    sent: &'a AtomicUsize,
}

impl FrameSource for OneByOne<'_> {
    fn format(&self) -> StreamFormat {
        self.script.format
    }

    fn lend(&mut self) -> Result<Lent<'_>, DeviceError> {
        if self.sent.load(Ordering::Acquire) < self.script.next {
            std::thread::yield_now();
            return Ok(Lent::Idle);
        }
        self.script.lend()
    }
}

/// Changes the settings when so many frames were drawn.
struct Changing<'a> {
    live: &'a Live,
    changes: &'a [Change],
    outcomes: Vec<Outcome>,
    sent: &'a AtomicUsize,
}

impl Observer for Changing<'_> {
    fn drawn(&mut self, frame: &Frame, _: PictureRef<'_>) {
        self.changes.iter().filter(|(at, _)| *at == self.outcomes.len()).for_each(|(_, params)| self.live.set(params));
        self.outcomes.push(frame.context.outcome);
    }

    fn sent(&mut self, _: &Frame) {
        self.sent.fetch_add(1, Ordering::Release);
    }
}

#[test]
fn a_pipeline_that_runs_takes_changes_and_says_what_it_carries() {
    let mut shots = shaken(Motion::Handheld);
    shots[3] = shots[3].clone().damaged();
    let on = Params::default();
    let changes = [(9, Params { enabled: false, ..on }), (99, on)];
    let (live, sent) = (Live::new(&on), AtomicUsize::new(0));
    let mut changing = Changing { live: &live, changes: &changes, outcomes: Vec::new(), sent: &sent };
    let mut source = OneByOne { script: Script::new(shots), sent: &sent };
    let mut sink = NullSink::new(&source.format());
    let totals = run_live(&mut source, &mut sink, &on, &live, &Stop::default(), &mut changing).unwrap();
    let Counts { frames_in, unusable, dropped, cut: _ } = live.counts();
    assert_eq!((frames_in, unusable[Reason::Marked as usize], unusable.iter().sum::<u64>(), dropped), (FRAMES as u64, 1, 1, 0));
    assert_eq!((totals.frames_in, totals.frames_out), (FRAMES as u64, FRAMES as u64));
    let off: Vec<usize> =
        (0..FRAMES).filter(|&n| changing.outcomes[n] == Outcome::PassedThrough(PassReason::SwitchedOff)).collect();
    // switched with the tenth frame and faded for a second; on again with the hundredth
    let first = off.first().copied().unwrap_or(FRAMES);
    assert!((38..=41).contains(&first), "off from frame {first}");
    assert_eq!(off, (first..100).collect::<Vec<_>>());
}
