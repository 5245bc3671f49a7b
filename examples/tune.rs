//! Judges and searches the numbers of the adaptive mode ([`gimbald::stage::smooth::Tuning`]): drives crop window and smoother alone over
//! camera paths, without pictures. A path of ten seconds takes some 30 ms.
//!
//! ```sh
//! cargo run --release --example tune -- LIST [search=ROUNDS] [seed=N] [lookahead_ms=200] [strength=2] [zoom=1.2] [NAME=VALUE ...]
//! ```
//!
//! LIST is a text file with a camera path on each line, `examples/tune.list` shows how: its group (`search` or `judge`), what it is
//! judged as (`full`: shake that fills the window; `fits`), a name, and where it comes from:
//!
//! - `gyro FILE`: a gyroscope's log, CSV with a head line, `t_s,x,y,z` (s, rad/s; pitch, yaw, roll), without its mean rate,
//! - `trace FILE`: what `gimbald replay --trace` wrote,
//! - `handheld`, `walk` or `pan`: made, with `seed=`.
//!
//! then any of `start=` and `seconds=` (s), `gain=`, `fps=`, `readout=` (frame intervals), `size=640x480`, `hfov=` (degrees). Files are
//! looked for beside LIST. Without `search`, every path is judged with the numbers as they are, or as NAME=VALUE says. With it, better
//! numbers are looked for on the group `search`, each path 15 % smaller and 20 % larger, and judged on the group `judge`.
//!
//! For each path: jitter (rms of what is above 0.5 Hz) and acceleration (rms of second differences) of the virtual camera over those of
//! the camera, yaw and pitch in pixels at the centre, roll in pixels at the corners, from frame 15 on; the share of frames that use more
//! than 85 % of the margin. The objective is the mean of ln(jitter) + 0.8 ln(acceleration) over the paths that fill the window, and a
//! quarter of that over those that fit.

use std::collections::HashMap;
use std::f64::consts::{SQRT_2, TAU};
use std::path::Path;

use anyhow::{Context as _, bail, ensure};
use gimbald::geometry::{Homography, OutputMap, Pinhole, Pose, RowPoses, View};
use gimbald::random::Congruential;
use gimbald::stage::crop::{self, Window};
use gimbald::stage::shutter::RowSpan;
use gimbald::stage::smooth::{self, Smoother, Tuning};

/// First frames that are not judged.
const SKIPPED: usize = 15;
/// Numbers that matter with look-ahead alone, or hardly at all: a search leaves them as they are.
const LEFT: [&str; 4] = ["jerk", "first_error", "rho_known", "known"];
/// Factors on the paths of a search.
const GAINS: [f64; 2] = [0.85, 1.2];

/// A camera's path.
struct Log {
    name: String,
    group: String,
    fills: bool,
    readout_s: f64,
    hfov_deg: f64,
    size: [usize; 2],
    /// Times of the frames' first rows, seconds.
    frames: Vec<f64>,
    /// Where the camera was, at times.
    path: Vec<(f64, Pose)>,
}

impl Log {
    fn at(&self, time: f64) -> Pose {
        let i = self.path.partition_point(|(at, _)| *at <= time).clamp(1, self.path.len() - 1);
        let ((from, a), (to, b)) = (self.path[i - 1], self.path[i]);
        let part = ((time - from) / (to - from).max(1e-9)).clamp(0.0, 1.0);
        a + (b - a) * part
    }

    /// Reads a line of the list.
    fn read(line: &str, folder: &Path) -> anyhow::Result<Self> {
        let mut words = line.split_whitespace();
        let mut word = || words.next().context("expected GROUP full|fits NAME KIND");
        let (group, fills, name, kind) = (word()?.to_owned(), word()? == "full", word()?.to_owned(), word()?.to_owned());
        let rest: Vec<&str> = words.collect();
        let options: HashMap<&str, &str> = rest.iter().filter_map(|word| word.split_once('=')).collect();
        let number = |key: &str, default: f64| options.get(key).map_or(Ok(default), |text| text.parse::<f64>());
        let file = || rest.first().map(|name| folder.join(name)).context("expected a file");
        let (start, seconds, fps) = (number("start", 0.0)?, number("seconds", 6.0)?, number("fps", 30.0)?);
        let (width, height) =
            options.get("size").unwrap_or(&"640x480").split_once('x').context("expected size=WIDTHxHEIGHT")?;
        let mut path = match kind.as_str() {
            "gyro" => gyro(&file()?, start, seconds)?,
            "trace" => trace(&file()?)?,
            made => (0..((seconds + 0.2) * 480.0) as usize)
                .map(|k| k as f64 / 480.0)
                .map(|t| Ok((t, shake(made, number("seed", 1.0)? as u64, seconds, t)?)))
                .collect::<anyhow::Result<_>>()?,
        };
        let gain = number("gain", 1.0)?;
        path.iter_mut().for_each(|(_, pose)| *pose = *pose * gain);
        let frames = if kind == "trace" {
            path.iter().map(|(t, _)| *t).collect()
        } else {
            (0..(seconds * fps) as usize).map(|k| k as f64 / fps).collect()
        };
        Ok(Self {
            name,
            group,
            fills,
            readout_s: number("readout", 0.85)? / fps,
            hfov_deg: number("hfov", 48.9)?,
            size: [width.parse()?, height.parse()?],
            frames,
            path,
        })
    }
}

/// The lines of a CSV file, as numbers by the head line's names; what is no number is 0.
fn table(file: &Path) -> anyhow::Result<(Vec<String>, Vec<Vec<f64>>)> {
    let text = std::fs::read_to_string(file).with_context(|| format!("cannot read {}", file.display()))?;
    let mut lines = text.lines();
    let head = lines.next().context("an empty file")?.split(',').map(str::to_owned).collect();
    Ok((head, lines.map(|line| line.split(',').map(|word| word.parse().unwrap_or(0.0)).collect()).collect()))
}

fn gyro(file: &Path, start: f64, seconds: f64) -> anyhow::Result<Vec<(f64, Pose)>> {
    let rows = table(file)?.1;
    let rows: Vec<Vec<f64>> =
        rows.into_iter().filter(|row| row.len() > 3 && (start..start + seconds + 0.2).contains(&row[0])).collect();
    ensure!(rows.len() > 10, "{}: nothing recorded from {start} s on", file.display());
    let mean: [f64; 3] = std::array::from_fn(|i| rows.iter().map(|row| row[i + 1]).sum::<f64>() / rows.len() as f64);
    let (mut turn, mut before) = ([0.0; 3], rows[0][0]);
    Ok(rows
        .iter()
        .map(|row| {
            (0..3).for_each(|i| turn[i] += (row[i + 1] - mean[i]) * (row[0] - before));
            before = row[0];
            (row[0] - start, Pose([turn[1], turn[0], turn[2], 0.0]))
        })
        .collect())
}

fn trace(file: &Path) -> anyhow::Result<Vec<(f64, Pose)>> {
    let (head, rows) = table(file)?;
    let column = |name: &str| {
        head.iter().position(|column| column == name).with_context(|| format!("{}: no column {name}", file.display()))
    };
    let (time, pose) = (column("time_s")?, [column("P_yaw")?, column("P_pitch")?, column("P_roll")?, column("P_zoom")?]);
    Ok(rows.iter().map(|row| (row[time], Pose(pose.map(|i| row[i])))).collect())
}

/// Made shake at time `t`: sums of sines whose size falls with their frequency.
fn shake(kind: &str, seed: u64, seconds: f64, t: f64) -> anyhow::Result<Pose> {
    let (hz, degrees): ([f64; 2], [f64; 3]) = match kind {
        "handheld" => ([0.3, 7.0], [0.55, 0.55, 0.35]),
        "walk" => ([0.3, 6.0], [0.3, 0.3, 0.1]),
        "pan" => ([0.4, 7.0], [0.35, 0.35, 0.25]),
        _ => bail!("{kind}: expected gyro, trace, handheld, walk or pan"),
    };
    let mut random = random(seed);
    let mut pose = Pose::default();
    for (c, size) in degrees.into_iter().enumerate() {
        for i in 0..16 {
            let f = hz[0] * (hz[1] / hz[0]).powf((f64::from(i) + random()) / 16.0);
            pose[c] += size * SQRT_2 / 4.0 * (hz[0] / f).sqrt() * 1.6 * (TAU * (f * t + random())).sin();
        }
    }
    if kind == "walk" {
        pose[0] += 0.8 * (TAU * 0.95 * t + 0.4).sin();
        pose[1] += (TAU * 1.9 * t).sin() + 0.3 * (TAU * 3.8 * t + 1.0).sin();
        pose[2] += 0.5 * (TAU * 0.95 * t).sin();
    } else if kind == "pan" {
        let u = ((t - 0.35 * seconds) / 1.6).clamp(0.0, 1.0);
        pose[0] += 16.0 * u * u * (3.0 - 2.0 * u);
    }
    Ok(Pose(pose.0.map(f64::to_radians)))
}

/// Numbers from 0 to 1, the same for the same seed.
fn random(seed: u64) -> impl FnMut() -> f64 {
    let mut generator = Congruential::scattered(seed);
    move || generator.unit()
}

/// What all paths are driven with.
struct Setup {
    smooth: smooth::Params,
    crop: crop::Params,
}

/// Where camera and virtual camera were, and what share of the margin was used.
type Driven = (Vec<Pose>, Vec<Pose>, Vec<f64>);

/// Drives crop window and smoother over a path, as the pipeline does.
fn drive(log: &Log, setup: &Setup, tuning: &Tuning, gain: f64) -> Driven {
    let mut smoother = Smoother::tuned(&setup.smooth, tuning);
    let mut window = Window::new(&setup.crop, log.size, log.size);
    let camera = Pinhole::new(log.size, log.hfov_deg);
    let (count, half) = (log.frames.len(), 0.5 * log.readout_s);
    let at = |t: f64| log.at(t) * gain;
    let interval = |k: usize| if k > 0 { log.frames[k] - log.frames[k - 1] } else { 0.0 };
    let (mut driven, mut seen): (Driven, usize) = (Driven::default(), 0);
    for k in 0..count {
        while seen < count && (seen <= k || log.frames[seen] - log.frames[k] <= setup.smooth.lookahead_s() + 1e-3) {
            let (first, last) = (log.frames[seen], log.frames[seen] + log.readout_s);
            let last_before = at(last - interval(seen));
            let ends = RowSpan { first: at(first), last: at(last), last_before, half_s: half, interval_s: interval(seen) };
            smoother.observe(at(first + half), interval(seen), if seen > 0 { ends } else { RowSpan::default() });
            seen += 1;
        }
        let (pose, step_s) = (at(log.frames[k] + half), interval(k));
        window.glide(step_s);
        let view = View::from(window.view());
        let mut rows = RowPoses {
            samples: [Pose::default(); RowPoses::SAMPLES],
            spacing: (log.size[1] - 1) as f64 / (RowPoses::SAMPLES - 1) as f64,
        };
        for (i, row) in rows.samples.iter_mut().enumerate().filter(|_| k > 0) {
            let seen = at(log.frames[k] + log.readout_s * i as f64 / (RowPoses::SAMPLES - 1) as f64);
            *row = seen - pose;
        }
        let map = |correction: Pose, part: f64| {
            let turn = camera.turned(-correction);
            OutputMap::Rows {
                window: Homography::IDENTITY,
                view: Homography(turn.0 * view.window.0).scaled(),
                camera,
                kept: 0.0,
                rows: rows.part(part),
            }
        };
        let part = window.rows_margin(&view, |part| map(Pose::default(), part));
        let bounds = window.bounds(&view, smoother.correction(), |correction| map(correction, part));
        let place = smoother.step(pose, step_s, log.frames[seen - 1] - log.frames[k], &bounds);
        let wanted = place - pose;
        let share = window.correction_part(&view, |share| map(wanted * share, part));
        let correction = wanted * share;
        let crop_use = window.crop_use(&map(correction, part), &view);
        window.follow_use(crop_use, step_s);
        driven.0.push(pose);
        driven.1.push(pose + correction);
        driven.2.push(crop_use);
    }
    driven
}

/// What is left below 0.5 Hz: a Butterworth filter of second order, forth and back, the path mirrored through its ends.
fn below(values: &[f64], fps: f64) -> Vec<f64> {
    let k = (0.5 * std::f64::consts::PI / fps).tan();
    let over = 1.0 / (1.0 + SQRT_2 * k + k * k);
    let (b, a) = (k * k * over, [2.0 * (k * k - 1.0) * over, (1.0 - SQRT_2 * k + k * k) * over]);
    let (count, pad) = (values.len(), 45.min(values.len() - 2));
    let mut padded: Vec<f64> = (1..=pad).rev().map(|i| 2.0 * values[0] - values[i]).collect();
    padded.extend_from_slice(values);
    padded.extend((1..=pad).map(|i| 2.0 * values[count - 1] - values[count - 1 - i]));
    for _ in 0..2 {
        let (mut first, mut second) = (padded[0] * (1.0 - b), padded[0] * (b - a[1]));
        for value in &mut padded {
            let out = b * *value + first;
            (first, second) = (2.0 * b * *value - a[0] * out + second, b * *value - a[1] * out);
            *value = out;
        }
        padded.reverse();
    }
    padded[pad..pad + count].to_vec()
}

/// Jitter and acceleration, pixels.
fn measured(path: &[Pose], scale: [f64; 3], fps: f64) -> [f64; 2] {
    let (mut jitter, mut acceleration) = (0.0, 0.0);
    for (c, scale) in scale.into_iter().enumerate() {
        let values: Vec<f64> = path[SKIPPED..].iter().map(|pose| pose[c] * scale).collect();
        jitter +=
            values.iter().zip(below(&values, fps)).map(|(value, low)| (value - low).powi(2)).sum::<f64>() / values.len() as f64;
        let second = |w: &[f64]| (w[0] - 2.0 * w[1] + w[2]).powi(2);
        acceleration += values.windows(3).map(second).sum::<f64>() / (values.len() - 2) as f64;
    }
    [jitter.sqrt(), acceleration.sqrt()]
}

/// Ratios of jitter and acceleration, and the share of frames that fill the window.
fn judged(log: &Log, setup: &Setup, tuning: &Tuning, gain: f64) -> [f64; 3] {
    let (camera, place, used) = drive(log, setup, tuning, gain);
    let [width, height] = log.size.map(|n| n as f64);
    let focal = 0.5 * width / (0.5 * log.hfov_deg.to_radians()).tan();
    let fps = (log.frames.len() - 1) as f64 / (log.frames[log.frames.len() - 1] - log.frames[0]);
    let [before, after] = [camera, place].map(|path| measured(&path, [focal, focal, 0.5 * width.hypot(height)], fps));
    let full = used.iter().filter(|used| **used > 0.85).count() as f64 / used.len() as f64;
    [after[0] / before[0].max(1e-3), after[1] / before[1].max(1e-3), full]
}

/// Geometric means of the ratios (those that fill the window, those that fit), and the objective.
fn objective(logs: &[&Log], setup: &Setup, tuning: &Tuning, gains: &[f64]) -> [f64; 5] {
    let (mut sums, mut counts) = ([0.0; 4], [0.0; 2]);
    for log in logs {
        for gain in gains {
            let [jitter, acceleration, _] = judged(log, setup, tuning, *gain);
            // below these it makes no difference that can be seen
            let (at, floor) = if log.fills { (0, [0.0; 2]) } else { (2, [0.03, 0.02]) };
            sums[at] += (jitter + floor[0]).ln();
            sums[at + 1] += (acceleration + floor[1]).ln();
            counts[at / 2] += 1.0;
        }
    }
    let mean: [f64; 4] = std::array::from_fn(|i| sums[i] / f64::max(counts[i / 2], 1.0));
    let [a, b, c, d] = mean.map(f64::exp);
    [a, b, c, d, mean[0] + 0.8 * mean[1] + 0.25 * (mean[2] + 0.8 * mean[3])]
}

fn shown(o: [f64; 5]) -> String {
    format!("fill {:.3} / {:.3}, fit {:.3} / {:.3}, objective {:.4}", o[0], o[1], o[2], o[3], o[4])
}

/// Changes a few numbers at a time, and keeps what is better.
fn search(logs: &[&Log], setup: &Setup, mut tuning: Tuning, rounds: usize, seed: u64) -> Tuning {
    let mut random = random(seed);
    let mut best = objective(logs, setup, &tuning, &GAINS);
    let mut spread = 0.35;
    for round in 0..rounds {
        let mut other = tuning;
        for _ in 0..=(random() * 3.0) as usize {
            let mut numbers = other.numbers();
            numbers.retain(|(name, _)| !LEFT.contains(name));
            let i = (random() * numbers.len() as f64) as usize;
            *numbers[i].1 *= (2.0 * spread * (random() + random() - 1.0)).exp();
        }
        let now = objective(logs, setup, &other, &GAINS);
        if now[4] < best[4] {
            (best, tuning, spread) = (now, other, f64::min(1.15 * spread, 0.8));
            println!("round {round}: {}", shown(best));
        } else {
            spread = f64::max(0.985 * spread, 0.08);
        }
    }
    tuning
}

fn main() -> anyhow::Result<()> {
    let mut words = std::env::args().skip(1);
    let list = words.next().context("name a list of camera paths: tune LIST [search=ROUNDS] [NAME=VALUE ...]")?;
    let (mut setup, mut tuning) =
        (Setup { smooth: smooth::Params::default(), crop: crop::Params::default() }, Tuning::default());
    let (mut rounds, mut seed) = (0, 1);
    for word in words {
        let (name, value) = word.split_once('=').with_context(|| format!("{word}: expected NAME=VALUE"))?;
        let value: f64 = value.parse().with_context(|| format!("{word}: expected a number"))?;
        match name {
            "search" => rounds = value as usize,
            "seed" => seed = value as u64,
            "lookahead_ms" => setup.smooth.lookahead_ms = value,
            "strength" => setup.smooth.strength = value,
            "zoom" => setup.crop.zoom = value,
            _ => {
                *tuning
                    .numbers()
                    .into_iter()
                    .find(|(known, _)| *known == name)
                    .with_context(|| format!("no number {name}"))?
                    .1 = value
            }
        }
    }
    let text = std::fs::read_to_string(&list).with_context(|| format!("cannot read {list}"))?;
    let folder = Path::new(&list).parent().unwrap_or(Path::new("."));
    let lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty() && !line.starts_with('#'));
    let logs = lines.map(|(n, line)| Log::read(line, folder).with_context(|| format!("{list}:{}", n + 1)));
    let logs: Vec<Log> = logs.collect::<anyhow::Result<_>>()?;
    let group = |name: &str| logs.iter().filter(|log| log.group == name).collect::<Vec<&Log>>();
    if rounds > 0 {
        tuning = search(&group("search"), &setup, tuning, rounds, seed);
        tuning.numbers().into_iter().for_each(|(name, value)| println!("{name} = {value:.4};"));
    }
    for log in &logs {
        let [jitter, acceleration, full] = judged(log, &setup, &tuning, 1.0);
        println!("{:20} {:6}  jitter {jitter:.3}  acceleration {acceleration:.3}  full {full:.2}", log.name, log.group);
    }
    for name in ["search", "judge"] {
        println!("{name}: {}", shown(objective(&group(name), &setup, &tuning, &[1.0])));
    }
    Ok(())
}
