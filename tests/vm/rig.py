"""The virtual machine's devices as the tests use them: a reader that does what a call app does, the test camera, the daemon.

Python's standard library only, and nothing of gimbald's own code: what is shown here is shown by a stranger.
"""
import fcntl
import glob
import mmap
import os
import select
import signal
import socket
import struct
import subprocess
import sys
import time
import zlib

import confined

CAPTURE, MMAP = 1, 1
DARK = 50  # mean luma below which a picture is the placeholder; the test camera's is far above


def _request(direction, number, size):
    return (direction << 30) | (size << 16) | (ord("V") << 8) | number


QUERYCAP = _request(2, 0, 104)
G_FMT, S_FMT = _request(3, 4, 208), _request(3, 5, 208)
REQBUFS, QUERYBUF, QBUF, DQBUF = _request(3, 8, 20), _request(3, 9, 88), _request(3, 15, 88), _request(3, 17, 88)
STREAMON, STREAMOFF = _request(1, 18, 4), _request(1, 19, 4)
G_PARM, S_PARM = _request(3, 21, 204), _request(3, 22, 204)


def now():
    return time.clock_gettime(time.CLOCK_MONOTONIC)


class Frame:
    """A frame that was read: when it came, when it says that it was taken, what it looks like."""

    def __init__(self, came, taken, sequence, size, data):
        self.came, self.taken, self.sequence, self.size = came, taken, sequence, size
        # a sample of all rows and columns, luma only in YUYV, whose even bytes it takes
        sample = data[0:size:1022]
        self.sum = zlib.crc32(sample)
        self.luma = sum(sample) / max(1, len(sample))
        self.live = self.luma >= DARK


class Reader:
    """Reads a V4L2 device as a call app does."""

    def __init__(self, path, buffers=4, size=None, fps=None):
        self.path, self.maps = path, []
        self.fd = os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            fmt = bytearray(208)
            struct.pack_into("<I", fmt, 0, CAPTURE)
            fcntl.ioctl(self.fd, G_FMT, fmt, True)
            if size:
                struct.pack_into("<III", fmt, 8, size[0], size[1], struct.unpack("<I", b"YUYV")[0])
                struct.pack_into("<II", fmt, 24, 0, 0)
            fcntl.ioctl(self.fd, S_FMT, fmt, True)
            self.width, self.height = struct.unpack_from("<II", fmt, 8)
            self.code = bytes(fmt[16:20]).decode()
            if fps:
                parm = bytearray(204)
                struct.pack_into("<I", parm, 0, CAPTURE)
                struct.pack_into("<II", parm, 12, 1, fps)
                fcntl.ioctl(self.fd, S_PARM, parm, True)
            request = bytearray(20)
            struct.pack_into("<III", request, 0, buffers, CAPTURE, MMAP)
            fcntl.ioctl(self.fd, REQBUFS, request, True)
            for index in range(struct.unpack_from("<I", request)[0]):
                buf = self._buffer(index)
                fcntl.ioctl(self.fd, QUERYBUF, buf, True)
                offset, length = struct.unpack_from("<Q", buf, 64)[0], struct.unpack_from("<I", buf, 72)[0]
                self.maps.append(mmap.mmap(self.fd, length, mmap.MAP_SHARED, mmap.PROT_READ, offset=offset))
                fcntl.ioctl(self.fd, QBUF, self._buffer(index), True)
            self.started = now()
            fcntl.ioctl(self.fd, STREAMON, struct.pack("<i", CAPTURE))
        except OSError:
            self.close()
            raise

    @staticmethod
    def _buffer(index):
        buf = bytearray(88)
        struct.pack_into("<II", buf, 0, index, CAPTURE)
        struct.pack_into("<I", buf, 60, MMAP)
        return buf

    def frame(self, patience):
        """The next frame; None where patience (seconds) runs out. OSError where the device fails."""
        end = now() + patience
        while True:
            left = end - now()
            if left <= 0:
                return None
            poll = select.poll()
            poll.register(self.fd, select.POLLIN)
            events = poll.poll(left * 1000)
            buf = self._buffer(0)
            try:
                fcntl.ioctl(self.fd, DQBUF, buf, True)
            except BlockingIOError:
                if events and events[0][1] & (select.POLLERR | select.POLLHUP):
                    time.sleep(0.01)
                continue
            came = now()
            index, used = struct.unpack_from("<I", buf, 0)[0], struct.unpack_from("<I", buf, 8)[0]
            seconds, micros = struct.unpack_from("<qq", buf, 24)
            frame = Frame(came, seconds + micros / 1e6, struct.unpack_from("<I", buf, 56)[0], used, self.maps[index])
            fcntl.ioctl(self.fd, QBUF, self._buffer(index), True)
            return frame

    def frames(self, seconds):
        """What comes within so many seconds."""
        end, found = now() + seconds, []
        while (left := end - now()) > 0:
            frame = self.frame(left)
            if frame:
                found.append(frame)
        return found

    def live(self, patience, different=2):
        """Waits until so many different live pictures came; the time of the last, or None."""
        end, seen = now() + patience, set()
        while (left := end - now()) > 0:
            frame = self.frame(left)
            if frame and frame.live:
                seen.add(frame.sum)
                if len(seen) >= different:
                    return frame.came
        return None

    def close(self):
        for piece in self.maps:
            piece.close()
        if self.fd >= 0:
            os.close(self.fd)
        self.fd, self.maps = -1, []

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()


def identity(path):
    """(driver, capabilities) of a node."""
    fd = os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        cap = bytearray(104)
        fcntl.ioctl(fd, QUERYCAP, cap, True)
        return cap[:16].split(b"\0")[0].decode(), struct.unpack_from("<I", cap, 88)[0]
    finally:
        os.close(fd)


def nodes():
    return sorted(glob.glob("/dev/video[0-9]*"), key=lambda path: int(path[10:]))


def loopback():
    """The node made with exclusive_caps: the one that apps take for a camera. The others say that they are both."""
    found = []
    for path in nodes():
        driver, caps = identity(path)
        if driver == "v4l2 loopback" and caps & 3 == 2:
            found.append(path)
    if not found:
        sys.exit("SKIPPED: no v4l2loopback with exclusive_caps here")
    return found[0]


class Camera:
    """The kernel's test camera, wherever it is now."""

    place = "/sys/bus/platform/drivers/vivid/"

    @staticmethod
    def path():
        for path in nodes():
            try:
                driver, caps = identity(path)
            except OSError:
                continue
            if driver == "vivid" and caps & 1:
                return path
        return None

    @classmethod
    def becomes_even(cls, size, fps, slower=1):
        """Waits until its frames come evenly; whether they do. In a machine that has just started, vivid gives six at once and then none
        for most of a second."""
        def is_even():
            with Reader(cls.path(), size=size, fps=fps) as reader:
                came = [frame.came for frame in reader.frames(1.5)]
            return len(came) > 1 and max(b - a for a, b in zip(came, came[1:])) < 4 * slower / fps
        return until(40, is_even)

    @classmethod
    def control(cls, controls):
        path = cls.path()
        done = path and subprocess.run(["v4l2-ctl", "-d", path, "-c", controls], capture_output=True)
        return bool(done) and done.returncode == 0

    @classmethod
    def move(cls):
        """A picture that is bright, and different in each frame."""
        cls.control("test_pattern=0,horizontal_movement=5,vertical_movement=4")

    @classmethod
    def unplug(cls):
        with open(cls.place + "unbind", "w") as file:
            file.write("vivid.0")

    @classmethod
    def plug(cls):
        with open(cls.place + "bind", "w") as file:
            file.write("vivid.0")
        cls.move()

    @staticmethod
    def is_open():
        """Whether any process holds a vivid node open."""
        cameras = [path for path in nodes() if identity_or_none(path) == "vivid"]
        for link in glob.glob("/proc/[0-9]*/fd/*"):
            try:
                if os.readlink(link) in cameras:
                    return True
            except OSError:
                pass
        return False


def identity_or_none(path):
    try:
        return identity(path)[0]
    except OSError:
        return None


class Daemon:
    """`gimbald run` with some settings; what it says goes to a file."""

    def __init__(self, program, out, *sets, device="vivid", log="/tmp/gimbald.log", env=None):
        self.program, self.out, self.log, self.env = program, out, log, env
        self.sets = [f"camera.device={device}", f"output.device={out}", *sets]
        self.process = None

    def start(self):
        arguments = [self.program, "run"] + [word for given in self.sets for word in ("--set", given)]
        if unit := os.environ.get("GIMBALD_UNIT"):
            self.process = confined.Service(arguments, self.log, self.env or {}, unit)
            return self
        environment = {**os.environ, **(self.env or {})}
        with open(self.log, "ab") as log:
            self.process = subprocess.Popen(arguments, stdout=log, stderr=log, env=environment)
        return self

    @property
    def pid(self):
        return self.process.pid

    def alive(self):
        return self.process.poll() is None

    def stop(self, patience=10):
        self.process.send_signal(signal.SIGTERM)
        return self.process.wait(patience)

    def kill(self):
        self.process.kill()
        return self.process.wait()

    def cpu(self):
        """Seconds of processor time used."""
        with open(f"/proc/{self.pid}/stat") as file:
            fields = file.read().rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def cpu_exact(self):
        """The same from the scheduler, in its nanoseconds; all threads."""
        total = 0
        for path in glob.glob(f"/proc/{self.pid}/task/*/schedstat"):
            with open(path) as file:
                total += int(file.read().split()[0])
        return total / 1e9

    def memory(self):
        """Resident memory, MiB."""
        with open(f"/proc/{self.pid}/status") as file:
            for line in file:
                if line.startswith("VmRSS"):
                    return int(line.split()[1]) / 1024
        return 0.0

    def descriptors(self):
        return len(os.listdir(f"/proc/{self.pid}/fd"))

    def said(self):
        with open(self.log, errors="replace") as file:
            return file.read()


class Manager:
    """The service manager, as far as the daemon can tell: somebody who listens."""

    def __init__(self):
        self.path = "/run/gimbald-notify"  # not in /tmp: a service has one of its own
        if os.path.exists(self.path):
            os.unlink(self.path)
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind(self.path)
        os.chmod(self.path, 0o666)  # the daemon may have an account of its own
        self.socket.setblocking(False)
        self.heard = []

    def listen(self):
        while True:
            try:
                self.heard += self.socket.recv(4096).decode(errors="replace").split("\n")
            except BlockingIOError:
                return


def camera_appears(out, patience=15, while_=lambda: True):
    """Waits until the loopback is a camera, as long as a condition holds."""
    end = now() + patience
    while now() < end and while_():
        try:
            if identity(out)[1] & 1:
                return True
        except OSError:
            pass
        time.sleep(0.02)
    return False


def until(patience, condition):
    """Waits until a condition holds; says whether it does."""
    end = now() + patience
    while True:
        if condition():
            return True
        if now() >= end:
            return False
        time.sleep(0.05)


class Report:
    """Counts what was checked."""

    def __init__(self):
        self.failed = 0
        self.born = now()

    def say(self, *words):
        print(f"{now() - self.born:7.1f} ", *words, flush=True)

    def check(self, what, holds):
        self.failed += not holds
        self.say("ok   " if holds else "FAIL ", what)
        return holds

    def end(self):
        self.say("all is well" if not self.failed else f"{self.failed} checks failed")
        sys.exit(1 if self.failed else 0)


def percentile(values, part):
    """The value below which so much of `values` lies."""
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(part * len(ordered)))] if ordered else float("nan")
