"""The PipeWire camera with a real camera driver and a real service: without v4l2loopback, beside it, and for whom it is.

In the virtual machine, without the loopback: GIMBALD_VM="tests/vm/machine --loopback off" tests/vm/guest pipewire
Arguments: the program.
"""
import json
import os
import shutil
import subprocess
import sys
import threading
import time
import zlib

from rig import DARK, Camera, Daemon, Reader, Report, camera_appears, loopback, now, until

WIDTH, HEIGHT = 640, 480
SIZE = [f"camera.width={WIDTH}", f"camera.height={HEIGHT}", "camera.fps=30"]
PROGRAM = sys.argv[1]
report = Report()
missing = [name for name in ("pipewire", "wireplumber", "dbus-daemon", "gst-launch-1.0", "pw-dump") if not shutil.which(name)]
if missing:
    sys.exit(f"SKIPPED: not installed: {' '.join(missing)}")


class Session:
    """A user's session without a desktop: bus, PipeWire, WirePlumber; `user`: (uid, groups), else this one."""

    def __init__(self, name, user=None):
        self.place, self.user = f"/run/session-{name}", user
        os.makedirs(self.place, 0o700, exist_ok=True)
        if user:
            os.chown(self.place, user[0], user[0])
        self.parts = [self.start("dbus-daemon", "--session", "--nofork", "--nopidfile", f"--address=unix:path={self.place}/bus")]
        until(10, lambda: os.path.exists(f"{self.place}/bus"))
        self.parts.append(self.start("pipewire"))
        until(10, lambda: os.path.exists(f"{self.place}/pipewire-0"))
        self.parts.append(self.start("wireplumber"))
        until(20, lambda: "WirePlumber" in json.dumps(self.dump()))

    def words(self, *words):
        if not self.user:
            return list(words)
        uid, groups = self.user
        return ["setpriv", f"--reuid={uid}", f"--regid={uid}", f"--groups={groups}" if groups else "--clear-groups", "--", *words]

    def environment(self):
        return {
            **os.environ, "XDG_RUNTIME_DIR": self.place, "HOME": self.place, "DBUS_SESSION_BUS_ADDRESS": f"unix:path={self.place}/bus",
            "XDG_CONFIG_HOME": f"{self.place}/config", "XDG_STATE_HOME": f"{self.place}/state", "DISABLE_RTKIT": "1",
            "GST_REGISTRY": f"{self.place}/registry", "GIO_USE_VFS": "local",
        }

    def start(self, *words, **more):
        with open(f"{self.place}/{os.path.basename(words[0])}.log", "ab") as log:
            more = {"stdout": log, **more}
            return subprocess.Popen(self.words(*words), env=self.environment(), stderr=log, stdin=subprocess.DEVNULL, **more)

    def companion(self):
        process = self.start(PROGRAM, "pipewire")
        self.parts.append(process)
        return process

    def dump(self):
        said = subprocess.run(self.words("pw-dump"), env=self.environment(), capture_output=True, text=True).stdout
        found, decoder, at = [], json.JSONDecoder(), 0
        while (at := said.find("[", at)) >= 0:
            try:
                objects, at = decoder.raw_decode(said, at)
            except ValueError:
                break
            found += objects
        return found

    def node(self, name="gimbald"):
        for thing in reversed(self.dump()):
            if (thing.get("info") or {}).get("props", {}).get("node.name") == name:
                return thing["info"]
        return None

    def size(self, name="gimbald"):
        formats = (self.node(name) or {}).get("params", {}).get("EnumFormat") or [{}]
        return formats[0].get("size")

    def said(self):
        with open(f"{self.place}/{os.path.basename(PROGRAM)}.log", errors="replace") as file:
            return file.read()

    def end(self):
        for part in reversed(self.parts):
            part.kill()
            part.wait()


class Watcher:
    """A program that watches the node, GStreamer's way."""

    def __init__(self, session, size=(WIDTH, HEIGHT), name="gimbald"):
        self.bytes, self.frames, self.started = 2 * size[0] * size[1], [], now()
        words = ["gst-launch-1.0", "-q", "pipewiresrc", f"target-object={name}", "!", "video/x-raw", "!", "fdsink", "fd=1", "sync=false"]
        self.process = session.start(*words, stdout=subprocess.PIPE)
        self.thread = threading.Thread(target=self.read, daemon=True)
        self.thread.start()

    def read(self):
        while len(data := self.process.stdout.read(self.bytes)) == self.bytes:
            sample = data[::1022]
            self.frames.append((now(), sum(sample) / len(sample) >= DARK, zlib.crc32(sample)))

    def live(self, patience=10, different=5):
        """Waits until so many different live pictures came after this call; the time of the first, or None."""
        at = len(self.frames)
        enough = lambda: len({crc for _, live, crc in self.frames[at:] if live}) >= different
        return next(came for came, live, _ in self.frames[at:] if live) if until(patience, enough) else None

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.kill()
        self.process.wait()


def alone():
    """Without v4l2loopback."""
    session = Session("root")
    session.companion()
    daemon = Daemon(PROGRAM, "auto", *SIZE, "output.linger_s=1", env={"XDG_RUNTIME_DIR": session.place}).start()
    report.check("without a loopback the node has the camera's size", until(15, lambda: session.size() == {"width": WIDTH, "height": HEIGHT}))
    time.sleep(1)
    report.check("and the camera is closed", not Camera.is_open())
    own = []
    for _ in range(3):
        with Reader(Camera.path(), size=(WIDTH, HEIGHT), fps=30) as reader:
            own.append(reader.frame(5).came - reader.started)
    report.say("      the camera's own first frame comes after", *(f"{seconds:.3f}" for seconds in own), "s")
    for _ in range(5):
        subprocess.run(session.words("wpctl", "status"), env=session.environment(), capture_output=True)
        session.dump()
    report.check("listing leaves it closed", not Camera.is_open())
    for visit in range(3):
        with Watcher(session) as first:
            came = first.live()
            report.check(f"visit {visit}: live pictures come", came)
            report.say(f"      {came - first.started:.3f} s after the program was started" if came else "      none")
            report.check("      the camera is open", Camera.is_open())
            with Watcher(session) as second:
                report.check("      for a second program as well", second.live())
            report.check("      the first goes on when the second has left", first.live() and Camera.is_open())
        left = now()
        report.check("      the camera is closed when nobody watches", until(5, lambda: not Camera.is_open()))
        report.say(f"      {now() - left:.2f} s after the program left")

    with Watcher(session) as watcher:
        report.check("somebody watches", watcher.live())
        daemon.kill()
        at = len(watcher.frames)
        report.check("the daemon is killed: the last picture goes on", until(5, lambda: len(watcher.frames) >= at + 8))
        report.check("      and it is one of the camera's", all(live for _, live, _ in watcher.frames[at + 2:]))
        daemon.start()
        begun = now()
        report.check("      and live ones when it is back", watcher.live(15))
        report.say(f"      {now() - begun:.2f} s after the start")
        Camera.unplug()
        report.check("unplugged: the dark picture comes", until(10, lambda: watcher.frames and not watcher.frames[-1][1]))
        Camera.plug()
        report.check("plugged in again: live pictures", watcher.live(20))
    until(5, lambda: not Camera.is_open())

    subprocess.run(["modprobe", "v4l2loopback", "video_nr=10", "exclusive_caps=1", "max_buffers=8", "card_label=gimbald"], check=True)
    out = loopback()
    report.check("v4l2loopback is loaded later: it becomes a camera too", camera_appears(out, 20))
    with Watcher(session) as watcher, Reader(out) as reader:
        report.check("both at once: PipeWire", watcher.live())
        report.check("      and the loopback", reader.live(5))
    report.check("      and the camera is closed then", until(6, lambda: not Camera.is_open()))
    with Reader(out) as reader:
        report.check("the loopback alone", reader.live(5))
        report.check("      opens no node", session.node()["state"] != "running")
    report.check("the daemon stops", daemon.stop() == 0)
    session.end()
    if report.failed:
        print(daemon.said(), session.said())


def for_whom():
    """The real service, and two users: one who may open cameras, one who may not."""
    shutil.copy(PROGRAM, "/usr/local/bin/gimbald")
    unit = os.path.join(os.path.dirname(os.path.abspath(__file__)), "../../systemd/gimbald.service")
    shutil.copy(unit, "/run/systemd/system/gimbald.service")
    os.makedirs("/run/systemd/system/gimbald.service.d", exist_ok=True)
    sets = " ".join(f"--set {word}" for word in [*SIZE, "camera.device=vivid", "output.linger_s=1"])
    with open("/run/systemd/system/gimbald.service.d/test.conf", "w") as file:
        file.write(f"[Service]\nExecStart=\nExecStart=/usr/local/bin/gimbald run {sets}\n")
    subprocess.run(["systemctl", "daemon-reload"], check=True)
    path = Camera.path()
    video = os.stat(path).st_gid
    report.check("the service starts", subprocess.run(["systemctl", "start", "gimbald"]).returncode == 0)
    sessions = {"may": Session("may", (1, str(video))), "may-not": Session("may-not", (2, ""))}
    for session in sessions.values():
        session.companion()
        report.check("a user's node is there", until(15, lambda s=session: s.size() == {"width": WIDTH, "height": HEIGHT}))
    report.check("nobody watches: the camera is closed", not Camera.is_open())
    with Watcher(sessions["may-not"]) as stranger:
        report.check("who may not open the camera sees dark pictures", until(10, lambda: len(stranger.frames) > 8))
        report.check("      no others", not any(live for _, live, _ in stranger.frames))
        report.check("      and does not open the camera", not Camera.is_open())
        report.check("      and is told why", f"may not open {path}" in sessions["may-not"].said())
        with Watcher(sessions["may"]) as friend:
            report.check("who may open it sees live ones", friend.live())
            time.sleep(1)
            report.check("      the other still does not", not any(live for _, live, _ in stranger.frames))
            subprocess.run(["systemctl", "restart", "gimbald"], check=True)
            report.check("      also after a restart of the service", friend.live(15))
    report.check("      and the camera is closed then", until(6, lambda: not Camera.is_open()))
    user = subprocess.run(["systemctl", "show", "-P", "MainPID", "gimbald"], capture_output=True, text=True).stdout.strip()
    report.check("the service is not root", os.stat(f"/proc/{user}").st_uid != 0)
    subprocess.run(["systemctl", "stop", "gimbald"])
    if report.failed:
        print(subprocess.run(["journalctl", "-u", "gimbald", "-o", "cat", "--no-pager"], capture_output=True, text=True).stdout)
        print(*(session.said() for session in sessions.values()))
    for session in sessions.values():
        session.end()


Camera.move()
alone()
for_whom()
report.end()
