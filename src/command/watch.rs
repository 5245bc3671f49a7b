//! The observers of one run (trace, statistics, report, comparison), and the files that they write.

use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use super::destination::ReportFile;
use super::progress::Progress;
use super::{Exit, Failure};
use crate::device::{DeviceError, private};
use crate::frame::Frame;
use crate::image::PictureRef;
use crate::pipeline::{Observer, Totals};
use crate::report::{Compare, Report, Stats, Trace};
use crate::rt::stop::Stop;
use crate::stage::shutter::Model;

/// The observers of a run: times always, the rest as asked for.
pub(super) struct Watch {
    /// Side by side.
    pub(super) compare: Option<Compare>,
    /// Where the times go.
    pub(super) stats_file: Option<ReportFile>,
    /// The page.
    pub(super) report: Option<(Report, ReportFile)>,
    /// The times.
    pub(super) stats: Stats,
    trace: Option<(Trace<BufWriter<File>>, PathBuf)>,
    progress: Progress,
    stop: Stop,
}

impl Watch {
    /// Watches the progress of `what` through `frames` frames. Observers that fail set `stop`.
    pub(super) fn new(what: &'static str, frames: Option<u64>, stop: Stop) -> Self {
        Self {
            compare: None,
            stats_file: None,
            report: None,
            stats: Stats::default(),
            trace: None,
            progress: Progress::new(what, frames),
            stop,
        }
    }

    /// Also writes a trace.
    ///
    /// # Errors
    /// Where the file cannot be created.
    pub(super) fn trace_to(&mut self, path: &Path, model: Model) -> Result<(), Failure> {
        let file = private::create(path).map_err(|error| Failure::creating(path, &error))?;
        let trace =
            Trace::new(BufWriter::new(file), model, self.stop.clone()).map_err(|error| Failure::writing(path, &error))?;
        self.trace = Some((trace, path.into()));
        Ok(())
    }

    /// Writes what was seen. Even a run that failed has its trace, times and page, up to the failure.
    ///
    /// # Errors
    /// The run's failure, or the first that occurred in watching it.
    pub(super) fn end(self, ran: Result<Totals, DeviceError>) -> Result<Totals, Failure> {
        self.progress.finish();
        let totals = ran.as_ref().map_or_else(|_| self.stats.seen().clone(), Clone::clone);
        let traced = self.trace.map_or(Ok(()), |(trace, path)| trace.finish().map_err(|error| Failure::writing(&path, &error)));
        let compared = self.compare.map_or(Ok(()), |compare| compare.finish().map_err(Failure::from));
        let timed = match self.stats_file {
            None => Ok(()),
            Some(file) => match serde_json::to_string_pretty(&self.stats.json(&totals)) {
                Ok(text) => file.fill(&(text + "\n")),
                Err(error) => Err(Failure::new(Exit::Io, format!("cannot write the times as JSON: {error}"))),
            },
        };
        let reported = self.report.map_or(Ok(()), |(report, file)| file.fill(&report.html(&totals, &self.stats)));
        ran.map_err(Failure::from).and_then(|totals| traced.and(compared).and(timed).and(reported).map(|()| totals))
    }

    /// Shows something to each observer there is.
    fn each(&mut self, show: impl Fn(&mut dyn Observer)) {
        show(&mut self.stats);
        show(&mut self.progress);
        self.trace.iter_mut().for_each(|(trace, _)| show(trace));
        self.compare.iter_mut().for_each(|compare| show(compare));
        self.report.iter_mut().for_each(|(report, _)| show(report));
    }
}

impl Observer for Watch {
    fn drawn(&mut self, frame: &Frame, output: PictureRef<'_>) {
        self.each(|observer| observer.drawn(frame, output));
    }

    fn sent(&mut self, frame: &Frame) {
        self.each(|observer| observer.sent(frame));
    }
}
