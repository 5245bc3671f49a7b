"""Cameras with a fault: from the start, or for a while. The picture has to be live again afterwards, and the daemon to live."""
from dataclasses import dataclass

from bench import Case


@dataclass
class Fault:
    """A fault and what has to hold.

    `during`, `after`: least live frames a second while it lasts and when it is over, as a part of the camera's rate. `missing`: frames
    counted as missing, at most, as a part of those that came. `opens`: the daemon has to offer a picture at all.
    """

    name: str
    options: tuple = ()
    start: tuple = ()
    fault: tuple = ()
    undo: tuple = ()
    sets: tuple = ()
    act: object = None  # does something to the camera, instead of `fault`
    seconds: float = 3.0
    during: float = 0.0
    after: float = 0.65
    recovers: float = 8.0
    missing: float = 1.0
    opens: bool = True

    def run(self, bench):
        bench.note(bench.start_camera(*self.start, *self.options))
        if not bench.start_daemon(*self.sets):
            bench.check("it offers a picture", not self.opens)
            return
        bench.open_reader()
        bench.live_within(15)
        nominal = (bench.status().get("camera") or {}).get("fps") or 30
        bench.note(f"before {bench.watch(2)}")
        if self.fault:
            bench.webcam("set", *self.fault)
        if self.act:
            self.act(bench)
        during = bench.watch(self.seconds)
        if self.undo:
            bench.webcam("set", *self.undo)
        if self.fault or self.act:
            bench.live_within(self.recovers)
        after = bench.watch(3)
        bench.note(f"during {during}")
        bench.note(f"after  {after}")
        status = bench.status()
        late = bench.is_late(status)
        for what, seen, least in ("during", during, self.during), ("after", after, self.after):
            if late and least:
                bench.check(f"{what}: live", seen.live > 1)
            else:
                bench.check(f"{what}: {least * nominal:.1f} live fps at least, not {seen.rate:.1f}", seen.rate >= least * nominal)
        came, missing = status.get("frames", {}).get("captured", 0), status.get("drops", {}).get("camera_missing", 0)
        bench.check(f"{missing} frames missing beside {came} that came", late or missing <= self.missing * max(1, came))
        bench.check("the daemon lives", bench.daemon.alive())


HD, FULL_HD = ("camera.width=1280", "camera.height=720"), ("camera.width=1920", "camera.height=1080")

FAULTS = [
    Fault("plain", during=0.7),
    Fault("bulk", options=("--bulk",), during=0.7),
    Fault("yuyv", options=("--bulk",), sets=("camera.format=yuyv",), during=0.65),
    Fault("continuous-intervals", options=("--continuous",), during=0.7),
    Fault("60-fps-offered", options=("--fps60",), during=0.7),
    # the picture
    Fault("no-huffman", start=("huffman=0",), during=0.7),
    Fault("no-huffman-midway", fault=("huffman=0",), undo=("huffman=1",), during=0.7),
    Fault("trailing-rubbish", start=("trailing=700",), during=0.7),
    Fault("trailing-zeros", start=("zeros=5000",), during=0.7),
    Fault("app4-payload", start=("app4=90000",), during=0.7),
    Fault("corrupt-1-in-5", fault=("corrupt=0.2",), undo=("corrupt=0",), during=0.5),
    Fault("corrupt-all", fault=("corrupt=1",), undo=("corrupt=0",)),
    Fault("cut-1-in-5", fault=("cut=0.2",), undo=("cut=0",), during=0.5),
    Fault("cut-all", fault=("cut=1",), undo=("cut=0",)),
    Fault("empty-1-in-5", fault=("empty=0.2",), undo=("empty=0",), during=0.5),
    Fault("first-frames-bad", start=("firstbad=10",), during=0.7),
    Fault("frames-beyond-the-maximum", fault=("big=2000000",), undo=("big=0",)),
    Fault("jpeg-size-changes-midway", fault=("othersize=640x480",), undo=("othersize=",), sets=HD),
    Fault("jpeg-1088-rows", start=("othersize=+8",), sets=FULL_HD, during=0.7),
    Fault("jpeg-of-another-size", start=("othersize=640x480",), sets=HD, after=0.0),
    # the payloads
    Fault("err-bit-1-in-5", fault=("error=0.2",), undo=("error=0",), during=0.5),
    Fault("err-bit-all", fault=("error=1",), undo=("error=0",), seconds=8),
    Fault("lost-payload-1-in-5", fault=("drop=0.2",), undo=("drop=0",), during=0.5),
    Fault("iso-error-1-in-5", fault=("iso_error=0.2",), undo=("iso_error=0",), during=0.5),
    Fault("bad-header-1-in-5", fault=("badheader=0.2",), undo=("badheader=0",), during=0.5),
    Fault("no-eof", start=("noeof=1",), during=0.65),
    Fault("no-fid", start=("nofid=1",), after=0.0),  # uvcvideo itself drops these: one frame after each start
    Fault("pts-none", start=("pts=none",), during=0.7),
    Fault("pts-zero", start=("pts=zero",), during=0.7),
    Fault("pts-wild", start=("pts=wild",), during=0.7),
    Fault("max-frame-size-small", start=("maxframe=20000",), after=0.0),  # uvcvideo gives no frame
    Fault("max-frame-size-zero", start=("maxframe=1",), after=0.0),
    # the times
    Fault("first-frame-late", start=("late=3",), during=0.7),
    Fault("exposure-halves-rate", fault=("dark=1",), undo=("dark=0",), during=0.4),
    Fault("slow-from-the-start", start=("dark=1",), during=0.4, after=0.4),
    Fault("pause-3-s", fault=("pause=3",), seconds=3.5),
    Fault("hangs-until-restarted", fault=("hang=1",), seconds=12),
    Fault("twice-as-fast-as-said", fault=("slow=0.5",), undo=("slow=1",), during=0.7),
    # the bus and the requests
    Fault("bus-glitch-one-transfer", fault=("urb_error=1",), during=0.5, missing=0.2),
    Fault("bus-glitch-all-transfers", fault=("urb_error=5",), seconds=9),
    Fault("stall-probe-3-times", start=("stall_probe=3",), during=0.65),
    Fault("stall-commit-3-times", start=("stall_commit=3",), during=0.65),
    Fault("stall-start-3-times", start=("stall_alt=3",), during=0.65),
    Fault("stall-controls", start=("stall_controls=1",), during=0.7),
    Fault("other-mode-than-asked", start=("probe_fixed=1:1",), during=0.7),
    Fault("too-much-bandwidth", options=("--bandwidth", "5000"), after=0.0, opens=False),
    Fault("privacy-shutter", fault=("privacy=1",), undo=("privacy=0",), during=0.7),
    # what is offered, and in which order
    Fault("h264-offered-first", options=("--formats", "H264,MJPG,YUYV"), during=0.7),
    Fault("grey-first-and-nv12", options=("--bulk", "--formats", "GREY,NV12,MJPG"), during=0.65),
    Fault("second-stream-h264", options=("--second", "H264"), during=0.7),
    Fault("second-stream-h264-first", options=("--second", "H264", "--second-first"), during=0.7),
    Fault("second-stream-grey-first", options=("--second", "GREY:640x480", "--second-first"), during=0.7),
]

CORE = ("plain", "bulk", "no-huffman", "corrupt-1-in-5", "jpeg-1088-rows", "second-stream-h264-first", "second-stream-grey-first")
CASES = [Case(fault.name, fault.run, core=fault.name in CORE) for fault in FAULTS]
