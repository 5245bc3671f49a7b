"""A desktop session without a desktop, and programs that watch its PipeWire camera."""
import json
import os
import re
import shutil
import subprocess
import sys
import threading
import zlib

from rig import DARK, now, until

LACKING = [name for name in ("pipewire", "wireplumber", "dbus-daemon", "gst-launch-1.0", "pw-dump") if not shutil.which(name)]


class Session:
    """A user's session: bus, PipeWire, WirePlumber; `user`: (uid, groups), else this one. `program`: gimbald."""

    def __init__(self, name, program, user=None):
        self.place, self.program, self.user = f"/run/session-{name}", program, user
        os.makedirs(self.place, 0o700, exist_ok=True)
        if user:
            os.chown(self.place, user[0], user[0])
        self.parts = [self.start("dbus-daemon", "--session", "--nofork", "--nopidfile", f"--address=unix:path={self.place}/bus")]
        until(10, lambda: os.path.exists(f"{self.place}/bus"))
        self.parts.append(self.start("pipewire"))
        until(10, lambda: os.path.exists(f"{self.place}/pipewire-0"))
        self.start_wireplumber()

    def start_wireplumber(self):
        self.wireplumber = self.start("wireplumber")
        self.parts.append(self.wireplumber)
        until(20, lambda: "WirePlumber" in json.dumps(self.dump()))

    def restart_wireplumber(self):
        self.parts.remove(self.wireplumber)
        self.wireplumber.kill()
        self.wireplumber.wait()
        until(20, lambda: "WirePlumber" not in json.dumps(self.dump()))
        self.start_wireplumber()

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
        process = self.start(self.program, "pipewire")
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

    def cameras(self):
        """Nodes that programs may choose as a camera."""
        infos = [thing.get("info") or {} for thing in self.dump() if thing.get("type", "").endswith("Node")]
        return [info for info in infos if info.get("props", {}).get("media.class") == "Video/Source"]

    def node(self, name="gimbald"):
        return next((info for info in reversed(self.cameras()) if info["props"].get("node.name") == name), None)

    def size(self, name="gimbald"):
        formats = (self.node(name) or {}).get("params", {}).get("EnumFormat") or [{}]
        return formats[0].get("size")

    def said(self):
        with open(f"{self.place}/{os.path.basename(self.program)}.log", errors="replace") as file:
            return file.read()

    def end(self):
        for part in reversed(self.parts):
            part.kill()
            part.wait()


class Watcher:
    """A program that watches the node, GStreamer's way."""

    def __init__(self, session, size, name="gimbald"):
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


class Clock:
    """A program that takes the node's pictures without looking at them, and says of each when it had it and what stamp it bears."""

    LINE = re.compile(rb"chain.*\((\d+) bytes.*pts: (\d+):(\d+):(\d+)\.(\d+),.*offset: (\d+)")

    def __init__(self, session, name="gimbald"):
        self.came, self.stamps, self.numbers = [], [], []
        words = ["gst-launch-1.0", "-v", "pipewiresrc", f"target-object={name}", "!", "video/x-raw", "!", "fakesink", "silent=false", "sync=false"]
        self.process = session.start(*words, stdout=subprocess.PIPE)
        threading.Thread(target=self.read, daemon=True).start()

    def read(self):
        for line in self.process.stdout:
            at = now()
            if found := self.LINE.search(line):
                _, hours, minutes, seconds, nanoseconds, number = (int(word) for word in found.groups())
                self.came.append(at)
                self.stamps.append(3600 * hours + 60 * minutes + seconds + nanoseconds * 1e-9)
                self.numbers.append(number)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.kill()
        self.process.wait()


def skip_if_lacking():
    if LACKING:
        sys.exit(f"SKIPPED: not installed: {' '.join(LACKING)}")
