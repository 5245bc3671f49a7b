//! Pyramidal Lucas-Kanade with a forward-backward check.
//!
//! Each point is followed from the coarsest level down (Bouguet's pyramid, the inverse compositional form of Baker and Matthews
//! 2004 on each level), then followed back. Minimised on each level is the sum over a square patch of (template - picture)^2,
//! less what a change of brightness and contrast explains. The answer is the mean of both ways, in which the bias of bilinear
//! interpolation cancels to first order. Coordinates are pixels of the picture.

use crate::frame::{Frame, Track};
use crate::geometry::hypot;
use crate::image::PlaneRef;
use crate::kernel::{Level, lk};

/// Settings of the tracker.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Params {
    /// Side of the square patch that is compared (pixels; 8, 16 or 24).
    pub window: u32,
    /// Largest distance between a point and where it lands when followed forward and back (pixels, 0.05 to 5).
    pub max_round_trip_px: f64,
}

impl Default for Params {
    fn default() -> Self {
        Self { window: 16, max_round_trip_px: 0.5 }
    }
}

/// A point that is being followed, where it is in the newest frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Feature {
    /// Place (x, y), pixels.
    pub at: [f32; 2],
    /// Name, kept while it is followed.
    pub id: u32,
    /// Frame pairs through which it was followed.
    pub age: u32,
    /// How it agreed with the camera's motion so far: 1 wholly, 0 not at all. Kept by [`remember`].
    pub background: f32,
}

/// What a new frame says of a feature counts for so much of its memory.
const NEWS: f32 = 0.25;

/// Lets `features` remember what the shutter model made of their tracks (same order), in a frame of the given confidence.
pub fn remember(features: &mut [Feature], tracks: &[Track], confidence: f64) {
    let news = NEWS * confidence as f32;
    for (feature, track) in features.iter_mut().zip(tracks) {
        feature.background += news * (track.weight - feature.background);
    }
}

/// Steps at most on a level.
const MAX_STEPS: usize = 10;
/// Where the next step would be shorter than this, the search ends on the finest level, and on the others (pixels of that level).
const SETTLED: [f32; 2] = [0.004, 0.04];
/// The least part of a step that the next one is expected to be: the first steps of a search say little of it. With a quarter, the estimated
/// path of clips rendered with known motion is 0.7 % worse in the mean; with a half, no better.
const MIN_SHRINKING: f32 = 0.4;
/// Steps are made at most twice as long: those that shrink more slowly do not do so evenly.
const MAX_SHRINKING: f32 = 0.5;
/// A step or a way longer than this on one level is a point lost (pixels of that level).
const FARTHEST: f32 = 12.0;
/// Root mean square difference between both patches above which they are not the same thing (grey levels).
const MAX_DIFFERENCE: f32 = 40.0;

/// Follows points from one frame to the next.
#[derive(Debug)]
pub struct Tracker {
    params: Params,
    level: Level,
    found: Vec<Option<Found>>,
    shifts: Vec<f32>,
    neighbours: Neighbours,
}

/// A way along which a point was found.
#[derive(Clone, Copy)]
struct Way {
    shift: [f32; 2],
    /// Where in the patch the texture lies that was followed.
    centroid: [f32; 2],
    /// Standard deviation of the place that the difference left over suggests, pixels.
    sigma: f32,
}

/// Features for which there is room from the start.
const MAX_FEATURES: usize = 4096;

/// A point followed forward and back.
#[derive(Debug)]
struct Found {
    /// Mean shift of both ways.
    shift: [f32; 2],
    /// Where the shift holds, from the point.
    centroid: [f32; 2],
    /// Distance between the start and where the way back ends.
    round_trip: f32,
    /// Standard deviation of the shift.
    sigma: f32,
}

impl Tracker {
    /// A tracker with the given settings.
    pub fn new(params: Params, level: Level) -> Self {
        let (found, shifts) = (Vec::with_capacity(MAX_FEATURES), Vec::with_capacity(MAX_FEATURES));
        Self { params, level, found, shifts, neighbours: Neighbours::default() }
    }

    /// Takes the largest round trip from `params`; the window stays.
    pub fn set_params(&mut self, params: &Params) {
        self.params.max_round_trip_px = params.max_round_trip_px;
    }

    /// Follows `features` from `before` into `now`. Those that are found move on, the others go; `now.context.tracks` gets one
    /// track each, in the same order. Pictures of different size have no tracks.
    ///
    /// A point begins where a neighbour found before it moved, on the picture itself. Where there is none, where it is not found so,
    /// not surely or moved otherwise, it is looked for from the coarsest level down; where that fails too, once more from where the found
    /// ones moved: a jerk leaves many of them outside the reach of the coarsest level.
    pub fn follow(&mut self, before: &Frame, now: &mut Frame, features: &mut Vec<Feature>) {
        let Frame { picture, pyramid, context, .. } = now;
        context.tracks.clear();
        let same = before.picture.width() == picture.width() && before.picture.height() == picture.height();
        if !same || before.pyramid.levels.len() != pyramid.levels.len() {
            features.clear();
            return;
        }
        let (old, new) = (Pyramids::of(before), Pyramids { luma: picture.luma(), levels: &pyramid.levels });
        match self.params.window {
            ..=8 => self.find::<8>(&old, &new, features),
            9..=16 => self.find::<16>(&old, &new, features),
            _ => self.find::<24>(&old, &new, features),
        }
        let size = new.size();
        let mut found = self.found.iter();
        features.retain_mut(|feature| {
            let Some(Found { shift, centroid, sigma, .. }) = found.next().and_then(Option::as_ref) else { return false };
            let [x, y] = feature.at;
            let to = [x + shift[0], y + shift[1]];
            feature.at = to;
            feature.age += 1;
            // at the picture's edge a patch may hold more repeated samples than others: their place is no place
            let place = |i: usize, at: f32| {
                let room = (at.min(to[i]), size[i] - 1.0 - at.max(to[i]));
                f64::from(at + centroid[i].clamp(-room.0.max(0.0), room.1.max(0.0)))
            };
            let from = [place(0, x), place(1, y)];
            context.tracks.push(Track {
                from,
                to: [from[0] + f64::from(shift[0]), from[1] + f64::from(shift[1])],
                id: feature.id,
                age: feature.age,
                sigma_px: *sigma,
                background: feature.background,
                weight: 1.0,
            });
            true
        });
    }

    /// Looks for each feature: `self.found` has what became of it, in the same order.
    fn find<const N: usize>(&mut self, old: &Pyramids<'_>, new: &Pyramids<'_>, features: &[Feature]) {
        let (level, size) = (self.level, new.size());
        let furthest = self.params.max_round_trip_px as f32;
        let coarsest = old.levels.len();
        let mut template = lk::Template::<N>::default();
        let mut look = |at: [f32; 2], guess: [f32; 2], from: usize, trusted: bool| {
            follow_one(level, &mut template, [old, new], at, guess, from, trusted).filter(|found| {
                let to = [at[0] + found.shift[0], at[1] + found.shift[1]];
                found.round_trip <= furthest && (0..2).all(|i| to[i] >= 1.0 && to[i] <= size[i] - 2.0)
            })
        };
        let sharp = SHARP * (size[0] / SHARP_WIDTH).max(1.0);
        self.neighbours.begin(size);
        self.found.clear();
        for (i, feature) in features.iter().enumerate() {
            if let Some(next) = features.get(i + 1) {
                let [x, y] = self.neighbours.shift(next.at).unwrap_or_default();
                lk::expect(old.luma, next.at, N);
                lk::expect(new.luma, [next.at[0] + x, next.at[1] + y], N);
            }
            let near = |found: &Found, guess: [f32; 2]| {
                found.sigma <= sharp && hypot(found.shift[0] - guess[0], found.shift[1] - guess[1]) <= NEAR
            };
            let trusted = feature.age >= TRUSTED.0 && feature.background > TRUSTED.1;
            let found = self
                .neighbours
                .shift(feature.at)
                .and_then(|guess| look(feature.at, guess, 0, trusted).filter(|found| near(found, guess)))
                .or_else(|| look(feature.at, [0.0; 2], coarsest, false));
            if let Some(found) = &found {
                self.neighbours.found(feature.at, found.shift);
            }
            self.found.push(found);
        }
        let lost = self.found.iter().filter(|found| found.is_none()).count();
        if let Some(guess) = median_shift(&self.found, &mut self.shifts)
            && hypot(guess[0], guess[1]) > MIN_GUESS
            && lost * 8 > features.len()
        {
            for (feature, found) in features.iter().zip(&mut self.found).filter(|(_, found)| found.is_none()) {
                *found = look(feature.at, guess, coarsest, false);
            }
        }
    }
}

/// A point that ends no further than this from where a neighbour's motion takes it was found so (pixels), if its place is known as
/// well as this (standard deviation, pixels of a picture so many wide; as many degrees in a wider one, whose pixels are smaller behind lenses that
/// are as soft). In noise, and where something moves on its own, only the pyramid tells what is what.
const NEAR: f32 = 1.5;
const SHARP: f32 = 0.06;
const SHARP_WIDTH: f32 = 640.0;

/// A point followed through this many pairs of frames, and this surely background, is trusted: where its neighbours' motion leads to it, the
/// way back need not prove that it is the same point.
const TRUSTED: (u32, f32) = (4, 0.5);

/// How the points moved that were found last in each part of the picture.
#[derive(Debug, Default)]
struct Neighbours {
    shifts: [[Option<[f32; 2]>; Self::COLUMNS]; Self::ROWS],
    /// Parts a pixel.
    scale: [f32; 2],
}

impl Neighbours {
    const COLUMNS: usize = 16;
    const ROWS: usize = 12;

    /// Forgets all, for a picture of the given size.
    fn begin(&mut self, size: [f32; 2]) {
        *self = Self { scale: [Self::COLUMNS as f32 / size[0], Self::ROWS as f32 / size[1]], ..Self::default() };
    }

    fn part(&self, at: [f32; 2]) -> [usize; 2] {
        let index = |i: usize, count: usize| ((at[i] * self.scale[i]) as usize).min(count - 1);
        [index(0, Self::COLUMNS), index(1, Self::ROWS)]
    }

    fn found(&mut self, at: [f32; 2], shift: [f32; 2]) {
        let [column, row] = self.part(at);
        self.shifts[row][column] = Some(shift);
    }

    /// How the point's part of the picture moved, or one beside it.
    fn shift(&self, at: [f32; 2]) -> Option<[f32; 2]> {
        let [column, row] = self.part(at);
        self.shifts[row][column].or_else(|| {
            let columns = column.saturating_sub(1)..(column + 2).min(Self::COLUMNS);
            let rows = row.saturating_sub(1)..(row + 2).min(Self::ROWS);
            self.shifts[rows].iter().flat_map(|row| &row[columns.clone()]).flatten().next().copied()
        })
    }
}

/// A median motion shorter than this is no better guess than none (pixels).
const MIN_GUESS: f32 = 4.0;

/// Median shift of what was found, in each direction; `None` where too little was.
fn median_shift(found: &[Option<Found>], scratch: &mut Vec<f32>) -> Option<[f32; 2]> {
    let mut median = |axis: usize| {
        scratch.clear();
        scratch.extend(found.iter().flatten().map(|found| found.shift[axis]));
        let middle = scratch.len() / 2;
        (scratch.len() >= 8).then(|| *scratch.select_nth_unstable_by(middle, f32::total_cmp).1)
    };
    Some([median(0)?, median(1)?])
}

/// A picture's luma and its lower levels.
struct Pyramids<'a> {
    luma: PlaneRef<'a>,
    levels: &'a [crate::image::Plane],
}

impl<'a> Pyramids<'a> {
    fn of(frame: &'a Frame) -> Self {
        Self { luma: frame.picture.luma(), levels: &frame.pyramid.levels }
    }

    /// Width and height of the picture.
    fn size(&self) -> [f32; 2] {
        [self.luma.width() as f32, self.luma.height() as f32]
    }

    /// Level `i`; 0 is the picture.
    fn plane(&self, i: usize) -> PlaneRef<'a> {
        if i == 0 { self.luma } else { self.levels[i - 1].as_ref() }
    }
}

/// Follows the point `at` forward and back between two pictures (the older first), from level `from` down. The way back begins at the
/// opposite of `guess`, not where the way forward ended, or it would not prove that they end at the same place; that of a point that is
/// `trusted` begins there, one step or two from its end, and takes the bias out of the mean.
fn follow_one<const N: usize>(
    level: Level,
    template: &mut lk::Template<N>,
    [old, new]: [&Pyramids<'_>; 2],
    at: [f32; 2],
    guess: [f32; 2],
    from: usize,
    trusted: bool,
) -> Option<Found> {
    let forth = descend(level, template, [old, new], at, guess, from)?;
    let there = [at[0] + forth.shift[0], at[1] + forth.shift[1]];
    let back = if trusted { forth.shift } else { guess };
    let back = descend(level, template, [new, old], there, back.map(|g| -g), from)?;
    let apart = [forth.shift[0] + back.shift[0], forth.shift[1] + back.shift[1]];
    let shift = [forth.shift[0] - 0.5 * apart[0], forth.shift[1] - 0.5 * apart[1]];
    let centroid = [0, 1].map(|i: usize| 0.5 * (forth.centroid[i] + back.centroid[i]));
    Some(Found { shift, centroid, round_trip: hypot(apart[0], apart[1]), sigma: forth.sigma })
}

/// Follows a point of the first picture in the other from level `from` to the finest; `None` where it is lost.
fn descend<const N: usize>(
    level: Level,
    template: &mut lk::Template<N>,
    [old, new]: [&Pyramids<'_>; 2],
    at: [f32; 2],
    guess: [f32; 2],
    from: usize,
) -> Option<Way> {
    let mut way = Way { shift: guess, centroid: [0.0; 2], sigma: f32::INFINITY };
    for i in (0..=from).rev() {
        let scale = 1.0 / (1u32 << i) as f32;
        let here = at.map(|c| (c + 0.5) * scale - 0.5);
        template.extract(level, old.plane(i), here);
        let start = way.shift.map(|s| s * scale);
        match align(level, template, new.plane(i), here, start, i == 0) {
            Some(found) => way = Way { shift: found.shift.map(|s| s / scale), ..found },
            // a coarse level may show nothing of what the finest one shows
            None if i > 0 => {}
            None => return None,
        }
    }
    Some(way)
}

/// The part of a step that the one after it was, along it: 0 to [`MAX_SHRINKING`]. Gauss-Newton's steps shrink by about the same part each
/// time, and so all that are still to come can be taken at once: a step is worth 1 / (1 - part) of itself (Aitken's extrapolation). Not on the
/// finest level: few steps are made there, and plain ones end nearer to the place.
fn shrinking(before: [f32; 2], now: [f32; 2]) -> f32 {
    let square = before[0] * before[0] + before[1] * before[1];
    ((before[0] * now[0] + before[1] * now[1]) / square).clamp(0.0, MAX_SHRINKING)
}

/// Gauss-Newton on one level, the finest or another, in its pixels, from the shift `start` on.
fn align<const N: usize>(
    level: Level,
    template: &mut lk::Template<N>,
    plane: PlaneRef<'_>,
    here: [f32; 2],
    start: [f32; 2],
    is_finest: bool,
) -> Option<Way> {
    let [xx, xy, yy] = template.gauss_newton;
    let determinant = xx * yy - xy * xy;
    let area = (N * N) as f32;
    // less than half a grey level of slope in the weaker direction is noise
    let smaller = 0.5 * (xx + yy - ((xx - yy) * (xx - yy) + 4.0 * xy * xy).sqrt());
    if !(smaller > 0.25 * area && determinant > 0.0) {
        return None;
    }
    let settled = SETTLED[usize::from(!is_finest)];
    let mut shift = start;
    let mut left = f32::INFINITY;
    let mut before: Option<[f32; 2]> = None;
    for _ in 0..MAX_STEPS {
        let step = template.compare(level, plane, [here[0] + shift[0], here[1] + shift[1]]);
        let [bx, by] = step.rhs;
        let delta = [(xy * by - yy * bx) / determinant, (xy * bx - xx * by) / determinant];
        // what is left of the squares after the step: it takes as much as it is long along the slope
        left = step.square - step.sum * step.sum / area + (bx * delta[0] + by * delta[1]);
        let part = before.map_or(0.0, |before| shrinking(before, delta));
        let scale = if is_finest { 1.0 } else { 1.0 / (1.0 - part) };
        shift = [shift[0] + scale * delta[0], shift[1] + scale * delta[1]];
        let way = hypot(shift[0] - start[0], shift[1] - start[1]);
        if !way.is_finite() || way > FARTHEST {
            return None;
        }
        let next = if before.is_some() { part.max(MIN_SHRINKING) } else { 1.0 };
        if next * hypot(delta[0], delta[1]) < settled {
            break;
        }
        before = Some(delta);
    }
    let difference = (left / area).max(0.0).sqrt();
    if difference > MAX_DIFFERENCE {
        return None;
    }
    // noise has slopes too, and they say nothing: a difference of two noisy pictures has twice their variance, a central
    // difference of one half of it
    let slope = (smaller - 0.25 * area * difference * difference).max(0.02 * smaller);
    Some(Way { shift, centroid: template.centroid, sigma: difference / slope.sqrt() })
}
