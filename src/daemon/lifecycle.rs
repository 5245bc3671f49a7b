//! The service's life cycle as a state machine: an event in, the next action out. Without devices, threads or clocks.
//!
//! ```text
//!            OutputOpened              ViewersArrived                CameraOpened
//!   Closed ───────────────▶ Idle ◀───────────────────▶ Opening ──────────────────▶ Streaming
//!     ▲                      ▲ ▲       ViewersLeft       │  ▲                        │  │
//!     │ RetryDue             │ └─────────────────────────┼──┼────── StreamEnded ─────┘  │
//!     │                      │ ViewersLeft     CameraFailed │ RetryDue                  │ CameraFailed
//!   WaitingForOutput         └──────────── WaitingForCamera ◀───────────────────────────┘
//! ```
//!
//! From every state, `OutputFailed` leads to `WaitingForOutput` and `StopRequested` to `Ended`.

use std::time::Duration;

use super::backoff::Backoff;
use crate::device::DeviceError;

/// A device that appeared is tried after this long: udev gives it its links and permissions first.
const SETTLED: Duration = Duration::from_millis(100);

/// What the service is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum State {
    /// Neither output nor camera is open.
    Closed,
    /// The output is open and shows a placeholder, the camera is closed: no viewers.
    Idle,
    /// The camera is being opened.
    Opening,
    /// Frames go from the camera to the output.
    Streaming,
    /// The camera is not available; the output shows a placeholder.
    WaitingForCamera,
    /// The output is not available.
    WaitingForOutput,
    /// It is over.
    Ended,
}

/// What happened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Event {
    /// The output is open.
    OutputOpened,
    /// The output could not be opened, or stopped working.
    OutputFailed(Cause),
    /// The camera is open.
    CameraOpened,
    /// The camera could not be opened, or stopped working.
    CameraFailed(Cause),
    /// The stream ended without a failure: no viewers, or another format is to be tried.
    StreamEnded,
    /// There are viewers (or the camera is to be open always).
    ViewersArrived,
    /// There are none any more.
    ViewersLeft,
    /// A companion connected, which needs no loopback.
    CompanionConnected,
    /// A video device appeared, disappeared or changed its permissions.
    DevicesChanged,
    /// The pause before the next attempt is over.
    RetryDue,
    /// The service is to end.
    StopRequested,
}

/// Why a device failed, as far as it matters for what to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Cause {
    /// Another program has it.
    Busy,
    /// It cannot do what is configured.
    Unsupported,
    /// It is absent, was unplugged, may not be opened, ...
    Unavailable,
}

impl From<&DeviceError> for Cause {
    fn from(error: &DeviceError) -> Self {
        match error {
            DeviceError::Busy { .. } => Self::Busy,
            DeviceError::Unsupported { .. } | DeviceError::Format { .. } => Self::Unsupported,
            DeviceError::Io { .. } | DeviceError::Gone { .. } => Self::Unavailable,
        }
    }
}

/// What to do next. Each action ends with an event.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Action {
    /// Open the output.
    OpenOutput,
    /// Show the placeholder until there are viewers.
    Idle,
    /// Open the camera.
    OpenCamera,
    /// Stream until something ends it.
    Stream,
    /// Wait this long, unless something happens before.
    Wait(Duration),
    /// End.
    Stop,
    /// End with the error of the last failure.
    Fail,
}

/// The state machine.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lifecycle {
    state: State,
    backoff: Backoff,
    /// Managed by systemd: whatever does not work is waited for. In a terminal, what never worked is an error.
    is_service: bool,
    /// A camera was opened before.
    had_camera: bool,
}

impl Lifecycle {
    /// The state before the first [`Action::OpenOutput`].
    pub(super) fn new(is_service: bool) -> Self {
        Self { state: State::Closed, backoff: Backoff::default(), is_service, had_camera: false }
    }

    /// The present state.
    pub(super) fn state(&self) -> State {
        self.state
    }

    /// Frames were delivered: the next failure is a new one.
    pub(super) fn delivered(&mut self) {
        self.backoff.reset();
    }

    /// Whether a camera that fails for this cause is given up: one that never worked as configured will not begin to.
    pub(super) fn gives_up_camera(&self, cause: Cause) -> bool {
        cause == Cause::Unsupported && !self.had_camera && !self.is_service
    }

    /// The same for the output when it is opened first.
    fn gives_up_output(&self, cause: Cause) -> bool {
        self.state == State::Closed && cause != Cause::Busy && !self.had_camera && !self.is_service
    }

    /// What to do after `event`; `wanted` says whether the camera should be open now.
    ///
    /// Events that mean nothing in a state leave it as it is: the action is that of the state.
    pub(super) fn handle(&mut self, event: Event, wanted: bool) -> Action {
        use State::{Closed, Ended, Idle, Opening, Streaming, WaitingForCamera, WaitingForOutput};
        match (self.state, event) {
            (_, Event::StopRequested) => self.enter(Ended, Action::Stop),
            (_, Event::OutputFailed(cause)) if self.gives_up_output(cause) => self.enter(Ended, Action::Fail),
            (_, Event::CameraFailed(cause)) if self.gives_up_camera(cause) => self.enter(Ended, Action::Fail),
            (_, Event::OutputFailed(_)) => {
                let pause = self.backoff.next(false);
                self.enter(WaitingForOutput, Action::Wait(pause))
            }
            (Opening | Streaming, Event::CameraFailed(cause)) => {
                let pause = self.backoff.next(cause == Cause::Busy);
                self.enter(WaitingForCamera, Action::Wait(pause))
            }
            (Closed, Event::OutputOpened) | (Streaming, Event::StreamEnded) | (WaitingForCamera, Event::RetryDue) => {
                self.open_camera_or_idle(wanted)
            }
            (Closed | WaitingForOutput, Event::CompanionConnected)
            | (WaitingForOutput, Event::RetryDue)
            | (Idle, Event::DevicesChanged) => self.enter(Closed, Action::OpenOutput),
            (Idle, Event::ViewersArrived) => self.enter(Opening, Action::OpenCamera),
            (Opening, Event::CameraOpened) => {
                self.had_camera = true;
                self.enter(Streaming, Action::Stream)
            }
            (WaitingForCamera, Event::ViewersLeft) => self.open_camera_or_idle(false),
            (WaitingForCamera | WaitingForOutput, Event::DevicesChanged) => {
                self.backoff.reset();
                Action::Wait(SETTLED)
            }
            (Closed, _) => Action::OpenOutput,
            (Idle, _) => Action::Idle,
            (Opening, _) => Action::OpenCamera,
            (Streaming, _) => Action::Stream,
            (WaitingForCamera | WaitingForOutput, _) => Action::Wait(self.backoff.next(false)),
            (Ended, _) => Action::Stop,
        }
    }

    fn open_camera_or_idle(&mut self, wanted: bool) -> Action {
        if wanted {
            return self.enter(State::Opening, Action::OpenCamera);
        }
        self.backoff.reset();
        self.enter(State::Idle, Action::Idle)
    }

    fn enter(&mut self, state: State, action: Action) -> Action {
        self.state = state;
        action
    }
}

#[cfg(test)]
mod tests {
    use super::Event::*;
    use super::*;

    const UNAVAILABLE: Cause = Cause::Unavailable;

    fn wait(ms: u64) -> Action {
        Action::Wait(Duration::from_millis(ms))
    }

    /// Feeds events in a row, all with viewers or without; checks state and action after each.
    fn follow(lifecycle: &mut Lifecycle, wanted: bool, steps: &[(Event, State, Action)]) {
        for (index, &(event, state, action)) in steps.iter().enumerate() {
            let got = lifecycle.handle(event, wanted);
            assert_eq!((got, lifecycle.state()), (action, state), "step {index}: {event:?}");
        }
    }

    /// A lifecycle in `state`.
    fn in_state(state: State, is_service: bool) -> Lifecycle {
        Lifecycle { state, ..Lifecycle::new(is_service) }
    }

    #[test]
    fn a_viewer_opens_the_camera_and_the_last_one_to_leave_closes_it() {
        let mut lifecycle = Lifecycle::new(true);
        follow(&mut lifecycle, false, &[(OutputOpened, State::Idle, Action::Idle)]);
        follow(
            &mut lifecycle,
            true,
            &[
                (ViewersArrived, State::Opening, Action::OpenCamera),
                (CameraOpened, State::Streaming, Action::Stream),
                (StreamEnded, State::Opening, Action::OpenCamera),
                (CameraOpened, State::Streaming, Action::Stream),
            ],
        );
        follow(&mut lifecycle, false, &[(StreamEnded, State::Idle, Action::Idle)]);
    }

    #[test]
    fn an_unplugged_camera_is_waited_for_ever_longer_and_found_at_once_when_devices_change() {
        let mut lifecycle = Lifecycle::new(true);
        follow(
            &mut lifecycle,
            true,
            &[
                (OutputOpened, State::Opening, Action::OpenCamera),
                (CameraOpened, State::Streaming, Action::Stream),
                (CameraFailed(UNAVAILABLE), State::WaitingForCamera, wait(100)),
                (RetryDue, State::Opening, Action::OpenCamera),
                (CameraFailed(UNAVAILABLE), State::WaitingForCamera, wait(200)),
                (RetryDue, State::Opening, Action::OpenCamera),
                (CameraFailed(UNAVAILABLE), State::WaitingForCamera, wait(400)),
                (DevicesChanged, State::WaitingForCamera, Action::Wait(SETTLED)),
                (RetryDue, State::Opening, Action::OpenCamera),
                (CameraFailed(UNAVAILABLE), State::WaitingForCamera, wait(100)),
            ],
        );
        lifecycle.delivered();
        follow(&mut lifecycle, false, &[(ViewersLeft, State::Idle, Action::Idle)]);
    }

    #[test]
    fn frames_between_two_failures_make_the_second_a_new_one() {
        let mut lifecycle = in_state(State::Streaming, true);
        for _ in 0..3 {
            follow(
                &mut lifecycle,
                true,
                &[
                    (CameraFailed(UNAVAILABLE), State::WaitingForCamera, wait(100)),
                    (RetryDue, State::Opening, Action::OpenCamera),
                    (CameraOpened, State::Streaming, Action::Stream),
                ],
            );
            lifecycle.delivered();
        }
    }

    #[test]
    fn a_busy_camera_is_tried_often() {
        let mut lifecycle = in_state(State::Opening, true);
        let pauses: Vec<Action> = (0..5)
            .map(|_| {
                let action = lifecycle.handle(CameraFailed(Cause::Busy), true);
                lifecycle.handle(RetryDue, true);
                action
            })
            .collect();
        assert_eq!(pauses, [wait(100), wait(200), wait(300), wait(300), wait(300)]);
    }

    #[test]
    fn an_output_that_disappears_is_opened_again_from_every_state() {
        for state in [State::Idle, State::Opening, State::Streaming, State::WaitingForCamera] {
            let mut lifecycle = in_state(state, false);
            follow(
                &mut lifecycle,
                true,
                &[
                    (OutputFailed(UNAVAILABLE), State::WaitingForOutput, wait(100)),
                    (RetryDue, State::Closed, Action::OpenOutput),
                    (OutputOpened, State::Opening, Action::OpenCamera),
                ],
            );
        }
        let mut lifecycle = in_state(State::Closed, true);
        follow(
            &mut lifecycle,
            true,
            &[
                (OutputFailed(UNAVAILABLE), State::WaitingForOutput, wait(100)),
                (CompanionConnected, State::Closed, Action::OpenOutput),
            ],
        );
        // Idle with PipeWire alone: the loopback may have appeared.
        follow(&mut in_state(State::Idle, true), false, &[(DevicesChanged, State::Closed, Action::OpenOutput)]);
    }

    #[test]
    fn in_a_terminal_what_never_worked_is_an_error_and_in_a_service_it_is_waited_for() {
        let first = |state: State, is_service: bool, event: Event| in_state(state, is_service).handle(event, true);
        for cause in [Cause::Unsupported, UNAVAILABLE] {
            assert_eq!(first(State::Closed, false, OutputFailed(cause)), Action::Fail);
            assert_eq!(first(State::Closed, true, OutputFailed(cause)), wait(100));
        }
        assert_eq!(first(State::Closed, false, OutputFailed(Cause::Busy)), wait(100), "a busy one is released some day");
        assert_eq!(first(State::Opening, false, CameraFailed(Cause::Unsupported)), Action::Fail);
        assert_eq!(first(State::Opening, true, CameraFailed(Cause::Unsupported)), wait(100));
        assert_eq!(first(State::Opening, false, CameraFailed(UNAVAILABLE)), wait(100), "an absent one is plugged in some day");
        let mut worked = in_state(State::Opening, false);
        worked.handle(CameraOpened, true);
        assert_eq!(worked.handle(CameraFailed(Cause::Unsupported), true), wait(100), "it worked before");
    }

    #[test]
    fn a_stop_ends_every_state_and_nothing_follows() {
        let states = [
            State::Closed,
            State::Idle,
            State::Opening,
            State::Streaming,
            State::WaitingForCamera,
            State::WaitingForOutput,
            State::Ended,
        ];
        for state in states {
            let mut lifecycle = in_state(state, true);
            assert_eq!(lifecycle.handle(StopRequested, true), Action::Stop);
            assert_eq!(lifecycle.handle(OutputOpened, true), Action::Stop);
            assert_eq!(lifecycle.state(), State::Ended);
        }
    }

    #[test]
    fn events_that_do_not_belong_to_a_state_leave_it() {
        for (state, event, action) in [
            (State::Closed, ViewersArrived, Action::OpenOutput),
            (State::Idle, RetryDue, Action::Idle),
            (State::Idle, ViewersLeft, Action::Idle),
            (State::Opening, DevicesChanged, Action::OpenCamera),
            (State::Streaming, CompanionConnected, Action::Stream),
            (State::WaitingForOutput, ViewersLeft, wait(100)),
        ] {
            follow(&mut in_state(state, true), true, &[(event, state, action)]);
        }
    }
}
