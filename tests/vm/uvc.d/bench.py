"""What a case has on its bench: emulated cameras, the daemon, a reader of its loopback; and what came of it."""
import glob
import json
import os
import socket
import subprocess
import sys
from dataclasses import dataclass, field

from rig import CAPTURE, Daemon, Reader, camera_appears, identity, identity_or_none, nodes, now, until
from webcam.remote import ask

HERE = os.path.dirname(os.path.realpath(__file__))
SOCKET = "/run/gimbald-test.sock"
LOG = "/tmp/gimbald-uvc.log"
LATE_FRAMES, LATE_SHARE = 12, 0.03
CARD, SERIAL, TWIN = "Test Webcam", "TEST0001", "TEST0002"


@dataclass
class Case:
    """A case: a function that runs it on a Bench. `core`: continuous integration runs it too."""

    name: str
    run: object
    core: bool = False


@dataclass
class Seen:
    """What a reader saw in so many seconds: live frames are bright, and each other than the one before."""

    seconds: float
    frames: int = 0
    live: int = 0
    dark: int = 0
    gap: float = 0.0
    replaced: int = 0  # written to the loopback, and replaced by newer ones before this reader took them

    @property
    def rate(self):
        return self.live / self.seconds

    def __str__(self):
        return f"{self.rate:5.1f} live fps ({self.frames} seen, {self.dark} dark, longest gap {self.gap:.2f} s)"


@dataclass
class Shared:
    """What all cases share."""

    program: str
    out: str
    size: tuple
    pictures: str = ""


@dataclass
class Bench:
    """One case's cameras, daemon and reader. What is started here is ended by `end`."""

    shared: Shared
    failed: list = field(default_factory=list)
    notes: list = field(default_factory=list)
    cameras: list = field(default_factory=list)
    daemon: Daemon = None
    reader: Reader = None
    last_picture: int = None
    last_sequence: int = None
    last_status: dict = field(default_factory=dict)

    # -- judging

    def check(self, what, holds):
        """`what` is what should be; it is told where it is not."""
        if not holds:
            self.failed.append(what)
        return holds

    def note(self, text):
        self.notes.append(text)

    # -- cameras

    @staticmethod
    def webcam(*words, name="cam"):
        """Tells a camera that runs `unplug`, `set KEY=VALUE`... (see webcam/__main__.py); what it answers."""
        try:
            return ask(name, " ".join(words))
        except SystemExit as error:
            raise RuntimeError(f"{' '.join(words)}: {error}") from None

    def start_camera(self, *words, name="cam"):
        """Plugs one in; its first node. udev has made its links by then."""
        command = [sys.executable, "-B", f"{HERE}/webcam", "start", *words, "--name", name]
        if self.shared.pictures:
            command += ["--pictures", self.shared.pictures]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            raise RuntimeError(f"the camera {' '.join(words)} does not start: {done.stderr.strip()}")
        self.cameras.append(name)
        subprocess.run(["udevadm", "settle", "-t", "10"], check=False)
        return done.stdout.strip()

    def stats(self, name="cam"):
        return json.loads(self.webcam("stats", name=name))

    # -- the daemon

    def start_daemon(self, *sets, device=CARD, program=None, **more):
        """Starts gimbald with the settings and waits until its loopback is a camera, or it ends. Says whether it offers a picture."""
        sets = list(sets)
        if not any(given.startswith("camera.width") for given in sets):
            sets += [f"camera.width={self.shared.size[0]}", f"camera.height={self.shared.size[1]}"]
        if not any(given.startswith("camera.format") for given in sets):
            sets += ["camera.format=mjpeg"]  # of small pictures it would choose the raw ones
        sets += ["output.linger_s=0.5", f"control.socket={SOCKET}"]
        if os.path.exists(LOG):
            os.unlink(LOG)
        self.daemon = Daemon(program or self.shared.program, self.shared.out, *sets, device=device, log=LOG, **more).start()
        camera_appears(self.shared.out, while_=self.daemon.alive)
        return self.daemon.alive()

    def status(self):
        """What the daemon says of itself; nothing where it does not answer."""
        self.last_status = {}
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as to:
            to.settimeout(5)
            try:
                to.connect(SOCKET)
                to.sendall(b"status\n")
                self.last_status = json.loads(to.makefile().readline())["status"]
            except (OSError, ValueError, KeyError) as error:
                self.note(f"no status: {error!r}")
        return self.last_status

    def camera_in_use(self):
        """The node that gimbald streams from, None where it has none."""
        return (self.status().get("camera") or {}).get("path")

    def said(self):
        return self.daemon.said() if self.daemon else ""

    def is_late(self, status):
        """Whether the machine did not give gimbald the time for the camera's frames: rates say nothing then."""
        drops = status.get("drops", {})
        late = drops.get("behind", 0) + drops.get("camera_stale", 0)
        # All buffers may be full once, when it starts, and when the camera is opened again.
        if late <= LATE_FRAMES + LATE_SHARE * status.get("frames", {}).get("captured", 0):
            return False
        self.note(f"RATES NOT JUDGED: the machine was too late for {late} frames")
        return True

    # -- the reader

    def open_reader(self):
        self.reader = Reader(self.shared.out)
        return self.reader

    def watch(self, seconds, until_live=False):
        """Reads for so long, or until two live frames came; what was seen."""
        began, since, seen = now(), now(), Seen(seconds)
        while (left := began + seconds - now()) > 0:
            frame = self.reader.frame(left)
            if not frame:
                break
            seen.frames += 1
            if self.last_sequence is not None and frame.sequence > self.last_sequence:
                seen.replaced += frame.sequence - self.last_sequence - 1
            self.last_sequence = frame.sequence
            if not frame.live:
                seen.dark += 1
            elif frame.sum != self.last_picture:
                seen.live += 1
                seen.gap, since = max(seen.gap, now() - since), now()
            self.last_picture = frame.sum
            if until_live and seen.live > 1:
                break
        seen.gap = max(seen.gap, now() - since)
        return seen

    def live_within(self, seconds):
        """Whether the picture is live within so many seconds; notes when."""
        began = now()
        live = self.watch(seconds, until_live=True).live > 1
        self.note(f"live after {now() - began:.1f} s" if live else f"NOT live within {seconds:.0f} s")
        return live

    # -- the end

    def end(self):
        """Ends everything; gives what the first camera sent."""
        if self.reader:
            self.reader.close()
        if self.daemon and self.daemon.alive():
            try:
                code = self.daemon.stop()
                self.check(f"exit status 0 at SIGTERM, not {code}", code == 0)
            except subprocess.TimeoutExpired:
                self.daemon.kill()
                self.check("it ends within 10 s of SIGTERM", False)
        sent = {}
        for name in self.cameras:
            try:
                sent[name] = self.stats(name)
                self.webcam("stop", name=name)
            except (RuntimeError, ValueError) as error:
                self.check(f"the camera {name} answers: {error}", False)
        until(5, lambda: not any(identity_or_none(path) == "uvcvideo" for path in nodes()))
        return sent


def socket_of(node):
    """The USB socket of the camera behind a node, as sysfs names it (1-1); None where there is none."""
    name = os.path.basename(os.path.realpath(node or "?"))
    path = os.path.realpath(f"/sys/class/video4linux/{name}/device")
    return os.path.basename(os.path.dirname(path)) if "/usb" in path else None


def camera_nodes(socket="1-1"):
    """The nodes of the camera in that socket."""
    return [path for path in nodes() if socket_of(path) == socket]


def capture_nodes(socket="1-1"):
    """Those of them that give pictures, not metadata."""
    return [path for path in camera_nodes(socket) if identity(path)[1] & CAPTURE]


def link(kind, node):
    """The link below /dev/v4l (`kind`: by-id, by-path) that udev made to a node."""
    found = sorted(path for path in glob.glob(f"/dev/v4l/{kind}/*") if os.path.realpath(path) == node)
    if not found:
        raise RuntimeError(f"udev made no link {kind} to {node}: {glob.glob('/dev/v4l/*/*')}")
    return found[0]
