//! One line of CSV per frame: the results of each stage.

use std::io::{self, Write};

use super::names::{MotionNames, outcome_name};
use crate::frame::{Frame, PathParameters};
use crate::image::PictureRef;
use crate::pipeline::Observer;
use crate::rt::stop::Stop;
use crate::stage::shutter::Model;

/// Writes the trace. Columns: `index` (frames drawn before), `sequence` (the source's), `time_s` (after the first frame, s),
/// `interval_s`, `h1` to `h9` (homography from the frame before, pixels), the model's parameters of the motion since the
/// frame before, of the camera's path and of the virtual camera's (cho2007: `a c d`, `U_a U_c U_d`, `S_a S_c S_d`),
/// `inliers`, `tracks`, `confidence` (in the motion), `trust`, `rows_gain` (the part of the rows' own motion that is undone), `crop_use` (0 to 1), `share_yaw` to `share_zoom` (what each channel takes of the crop
/// margin where least of it is left), `crop_zoom`, `readout_ms`, `hfov_deg`, `lens_k1` (what is believed of the camera at this frame;
/// empty where the model does not estimate it), `outcome`.
#[derive(Debug)]
pub struct Trace<W: Write> {
    to: W,
    axes: usize,
    index: u64,
    start_ns: Option<i64>,
    failed: Option<io::Error>,
    stop: Stop,
}

impl<W: Write> Trace<W> {
    /// Writes the head line. Where writing fails later, `stop` is set: a trace with a hole would mislead.
    ///
    /// # Errors
    /// What `to` reports.
    pub fn new(mut to: W, model: Model, stop: Stop) -> io::Result<Self> {
        let names = MotionNames::of(model);
        write!(to, "index,sequence,time_s,interval_s")?;
        (1..=9).try_for_each(|i| write!(to, ",h{i}"))?;
        names.axes.iter().try_for_each(|axis| write!(to, ",{}", axis.name))?;
        for path in [names.path, names.smoothed] {
            names.axes.iter().try_for_each(|axis| write!(to, ",{path}_{}", axis.name))?;
        }
        writeln!(
            to,
            ",inliers,tracks,confidence,trust,rows_gain,crop_use,share_yaw,share_pitch,share_roll,share_zoom,crop_zoom,readout_ms,hfov_deg,lens_k1,outcome"
        )?;
        Ok(Self { to, axes: names.axes.len(), index: 0, start_ns: None, failed: None, stop })
    }

    /// Writes what is buffered.
    ///
    /// # Errors
    /// The first that occurred since the beginning.
    pub fn finish(mut self) -> io::Result<()> {
        match self.failed.take() {
            Some(error) => Err(error),
            None => self.to.flush(),
        }
    }

    fn line(&mut self, frame: &Frame) -> io::Result<()> {
        let context = &frame.context;
        let start_ns = *self.start_ns.get_or_insert(frame.stamp.time_ns);
        let time_s = frame.stamp.time_ns.saturating_sub(start_ns) as f64 / 1e9;
        let to = &mut self.to;
        write!(to, "{},{},{time_s},{}", self.index, frame.stamp.sequence, context.interval_s)?;
        let h = &context.fit.homography.0;
        (0..9).try_for_each(|i| write!(to, ",{}", h[(i / 3, i % 3)]))?;
        for PathParameters(parameters) in [context.motion, context.path, context.smoothed] {
            parameters[..self.axes].iter().try_for_each(|value| write!(to, ",{value}"))?;
        }
        let fit = &context.fit;
        write!(to, ",{},{},{},{}", fit.inliers, fit.tracks, context.confidence, context.trust)?;
        write!(to, ",{},{}", context.rows_gain, context.crop_use)?;
        context.crop_shares.iter().try_for_each(|share| write!(to, ",{share}"))?;
        write!(to, ",{}", context.crop_zoom)?;
        match &context.calibration {
            Some(camera) => {
                write!(to, ",{},{},{}", 1e3 * camera.readout_s.value, camera.hfov_deg.value, camera.lens_k1.value)?;
            }
            None => write!(to, ",,,")?,
        }
        writeln!(to, ",{}", outcome_name(context.outcome))
    }
}

impl<W: Write> Observer for Trace<W> {
    fn drawn(&mut self, frame: &Frame, _: PictureRef<'_>) {
        if self.failed.is_none()
            && let Err(error) = self.line(frame)
        {
            self.failed = Some(error);
            self.stop.set();
        }
        self.index += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Calibration, Estimate};
    use crate::image::Picture;

    #[test]
    fn every_line_has_as_many_fields_as_the_head() {
        let mut bytes = Vec::new();
        let mut trace = Trace::new(&mut bytes, Model::Cho2007, Stop::default()).unwrap();
        let mut frame = Frame::default();
        for time_ns in [5_000_000_000, 5_040_000_000] {
            frame.stamp.time_ns = time_ns;
            frame.context.motion = PathParameters([1.001, -2.5, 0.25, 0.0]);
            let [readout_s, hfov_deg, lens_k1] = [-0.025, 48.5, -0.06].map(Estimate::exact);
            frame.context.calibration = (time_ns > 5_000_000_000).then_some(Calibration { readout_s, hfov_deg, lens_k1 });
            trace.drawn(&frame, Picture::default().as_ref());
        }
        trace.finish().unwrap();
        let text = String::from_utf8(bytes).unwrap();
        let rows: Vec<Vec<&str>> = text.lines().map(|line| line.split(',').collect()).collect();
        assert_eq!(rows.len(), 3);
        assert!(rows.iter().all(|row| row.len() == 37), "{text}");
        let column = |name| rows[0].iter().position(|head| *head == name).unwrap();
        assert_eq!((rows[2][column("index")], rows[2][column("time_s")]), ("1", "0.04"));
        assert_eq!((rows[1][column("readout_ms")], rows[1][column("hfov_deg")]), ("", ""));
        assert_eq!((rows[2][column("readout_ms")], rows[2][column("hfov_deg")]), ("-25", "48.5"));
        assert_eq!((rows[1][column("lens_k1")], rows[2][column("lens_k1")]), ("", "-0.06"));
        assert_eq!((rows[2][column("c")], rows[2][column("h9")], rows[2][column("outcome")]), ("-2.5", "1", "pending"));
    }

    #[test]
    fn a_full_disk_stops_the_run_and_is_told() {
        /// Takes the head, then no more.
        struct Full(usize);
        impl Write for Full {
            fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
                self.0 = self.0.checked_sub(bytes.len()).ok_or_else(|| io::Error::from(io::ErrorKind::StorageFull))?;
                Ok(bytes.len())
            }
            fn flush(&mut self) -> io::Result<()> {
                Ok(())
            }
        }
        let stop = Stop::default();
        let mut trace = Trace::new(Full(240), Model::Cho2007, stop.clone()).unwrap();
        trace.drawn(&Frame::default(), Picture::default().as_ref());
        assert!(stop.is_set());
        assert_eq!(trace.finish().unwrap_err().kind(), io::ErrorKind::StorageFull);
    }
}
