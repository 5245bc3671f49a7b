//! What `gimbald view` gets of each frame besides the pictures: numbers at fixed offsets in shared memory.

use crate::frame::Frame;

/// Frames that are described with each pair of pictures: as many as a camera of 120 fps delivers between two pairs.
pub(super) const REMEMBERED: usize = 16;

/// Numbers per frame.
const NUMBERS: usize = 29;

/// Bytes of the descriptions: the number of frames so far, then the last frames in a ring.
pub(super) const BYTES: usize = 8 + 8 * NUMBERS * REMEMBERED;

/// What is known of a frame after it was processed.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FrameInfo {
    /// Number of the frame, counted from the first that a page wanted.
    pub number: u64,
    /// When it was taken (seconds, on the source's clock).
    pub time_s: f64,
    /// The camera path, in the four parameters of the motion model.
    pub path: [f64; 4],
    /// The virtual camera's path.
    pub smoothed: [f64; 4],
    /// Weight of the correction, 0 to 1.
    pub trust: f64,
    /// Confidence in this frame's motion, 0 to 1.
    pub confidence: f64,
    /// Share of the crop margin in use, 0 to 1.
    pub crop_use: f64,
    /// Inliers, and all tracks.
    pub points: [f64; 2],
    /// Outcome, as [`Outcome::code`](crate::frame::Outcome::code) has it.
    pub outcome: f64,
    /// Where the output's corners are in the input (pixels; clockwise from the top left).
    pub corners: [[f64; 2]; 4],
    /// Processing time (ms).
    pub spent_ms: f64,
    /// Readout time (s) and its standard deviation, horizontal field of view (degrees) and its standard deviation.
    pub camera: [f64; 4],
}

impl FrameInfo {
    /// The description of a frame whose output is `width` x `height`.
    pub fn of(frame: &Frame, number: u64, (width, height): (usize, usize)) -> Self {
        let context = &frame.context;
        let (right, bottom) = (width as f64 - 1.0, height as f64 - 1.0);
        let camera = context.calibration.map(|camera| [camera.readout_s, camera.hfov_deg]);
        Self {
            number,
            time_s: frame.stamp.time_ns as f64 * 1e-9,
            path: context.path.0,
            smoothed: context.smoothed.0,
            trust: context.trust,
            confidence: context.confidence,
            crop_use: context.crop_use,
            points: [f64::from(context.fit.inliers), f64::from(context.fit.tracks)],
            outcome: f64::from(context.outcome.code()),
            corners: [[0.0, 0.0], [right, 0.0], [right, bottom], [0.0, bottom]].map(|corner| context.map.apply(corner)),
            spent_ms: context.spent_ns.iter().sum::<u64>() as f64 * 1e-6,
            camera: camera.map_or([0.0; 4], |[readout, hfov]| [readout.value, readout.sigma, hfov.value, hfov.sigma]),
        }
    }

    fn numbers(&self) -> [f64; NUMBERS] {
        let mut numbers = [0.0; NUMBERS];
        let [a, b, c, d] = self.corners;
        let all = [self.number as f64, self.time_s]
            .into_iter()
            .chain(self.path)
            .chain(self.smoothed)
            .chain([self.trust, self.confidence, self.crop_use])
            .chain(self.points)
            .chain([self.outcome])
            .chain(a.into_iter().chain(b).chain(c).chain(d))
            .chain([self.spent_ms])
            .chain(self.camera);
        numbers.iter_mut().zip(all).for_each(|(number, value)| *number = value);
        numbers
    }

    fn from_numbers(n: &[f64; NUMBERS]) -> Self {
        let four = |at: usize| std::array::from_fn(|i| n[at + i]);
        Self {
            number: n[0] as u64,
            time_s: n[1],
            path: four(2),
            smoothed: four(6),
            trust: n[10],
            confidence: n[11],
            crop_use: n[12],
            points: [n[13], n[14]],
            outcome: n[15],
            corners: std::array::from_fn(|i| [n[16 + 2 * i], n[17 + 2 * i]]),
            spent_ms: n[24],
            camera: four(25),
        }
    }
}

/// The descriptions of the last frames.
#[derive(Clone, Debug, Default)]
pub(super) struct Ring {
    count: u64,
    frames: [FrameInfo; REMEMBERED],
}

impl Ring {
    /// The number of the frame to come.
    pub(super) fn count(&self) -> u64 {
        self.count
    }

    pub(super) fn push(&mut self, info: FrameInfo) {
        self.frames[self.count as usize % REMEMBERED] = info;
        self.count += 1;
    }

    /// Writes all of it into the first [`BYTES`] of `bytes`.
    pub(super) fn write(&self, bytes: &mut [u8]) {
        let Some((count, rest)) = bytes.split_first_chunk_mut() else { return };
        *count = self.count.to_le_bytes();
        let places = rest.chunks_exact_mut(8);
        for (place, number) in places.zip(self.frames.iter().flat_map(FrameInfo::numbers)) {
            place.copy_from_slice(&number.to_le_bytes());
        }
    }
}

/// The frames of a ring that was written, oldest first. Nothing in it is trusted to be more than numbers.
pub(super) fn read(bytes: &[u8]) -> Vec<FrameInfo> {
    let Some((count, rest)) = bytes.split_first_chunk() else { return Vec::new() };
    let count = u64::from_le_bytes(*count);
    let mut numbers = rest.chunks_exact(8).map(|bytes| f64::from_le_bytes(std::array::from_fn(|i| bytes[i])));
    let frames: Vec<FrameInfo> = (0..REMEMBERED)
        .map_while(|_| {
            let mut frame = [0.0; NUMBERS];
            frame.iter_mut().try_for_each(|number| numbers.next().map(|next| *number = next))?;
            Some(FrameInfo::from_numbers(&frame))
        })
        .collect();
    let there = usize::try_from(count).unwrap_or(usize::MAX).min(frames.len());
    let first = if there < REMEMBERED { 0 } else { count as usize % REMEMBERED };
    (0..there).map(|i| frames[(first + i) % REMEMBERED]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn info(number: u64) -> FrameInfo {
        let n = number as f64;
        FrameInfo {
            number,
            time_s: n / 30.0,
            path: [n, 1.0, 2.0, 3.0],
            smoothed: [4.0, 5.0, 6.0, n],
            corners: [[n, 0.5], [1.5, n], [2.5, 3.5], [4.5, 5.5]],
            camera: [0.02, 0.001, 70.0, n],
            spent_ms: 3.25,
            ..FrameInfo::default()
        }
    }

    #[test]
    fn the_last_frames_are_read_as_they_were_written() {
        let mut bytes = vec![0xff; BYTES];
        let mut ring = Ring::default();
        ring.write(&mut bytes);
        assert_eq!(read(&bytes), []);
        for number in 0..40 {
            ring.push(info(number));
            ring.write(&mut bytes);
            let first = (number + 1).saturating_sub(REMEMBERED as u64);
            assert_eq!(read(&bytes), (first..=number).map(info).collect::<Vec<_>>());
        }
    }

    #[test]
    fn what_another_process_wrote_over_is_read_without_harm() {
        assert_eq!(read(&[]), []);
        assert!(read(&[0xff; 100]).len() <= REMEMBERED);
        assert_eq!(read(&[0xff; BYTES]).len(), REMEMBERED);
    }
}
