"""Clients of the control socket that ask without end, while a picture goes through. In the virtual machine; arguments: the program, for
how long (10 seconds).

Sixteen connections write `set a=` as fast as it is taken. The picture goes on as before, other clients are answered, and the log stays
short.
"""
import os
import select
import socket
import subprocess
import sys
import time

from rig import Camera, Daemon, Reader, Report, camera_appears, loopback, now, percentile

# In the folder that the unit gives the daemon (see confined.py).
SOCKET = "/run/gimbald/flood.sock"


def flood(path):
    """Writes without end, and takes what is answered."""
    streams = []
    for _ in range(16):
        stream = socket.socket(socket.AF_UNIX)
        stream.connect(path)
        stream.setblocking(False)
        streams.append(stream)
    lines = b"set a=\n" * 800
    while True:
        readable, writable, _ = select.select(streams, streams, [])
        for stream in readable:
            if not stream.recv(1 << 18):
                return
        for stream in writable:
            try:
                stream.send(lines)
            except BlockingIOError:
                pass


if sys.argv[1] == "--flood":
    flood(sys.argv[2])
    sys.exit("hung up on")

SECONDS = float(sys.argv[2]) if len(sys.argv) > 2 else 10.0
report, out = Report(), loopback()
Camera.move()
if not os.environ.get("GIMBALD_UNIT"):
    os.makedirs(os.path.dirname(SOCKET), exist_ok=True)
daemon = Daemon(sys.argv[1], out, f"control.socket={SOCKET}", "camera.width=640", "camera.height=360").start()
report.check("the loopback becomes a camera", camera_appears(out))


def asked(command):
    """How long one command of the program takes, and whether it went well."""
    begun = now()
    done = subprocess.run([sys.argv[1], command, "--socket", SOCKET], capture_output=True, text=True)
    return now() - begun, done.returncode == 0, done.stdout


def watched(reader, seconds):
    """Frames that the reader gets in so long, those that are missing between them, and what commands did meanwhile."""
    end, frames, commands, at = now() + seconds, [], [], now()
    while now() < end:
        frame = reader.frame(2)
        if frame is None:
            break
        frames.append(frame)
        if now() > at:
            at = now() + 0.5
            commands += [asked("status"), asked("reload")]
    times = sorted(a.taken for a in frames)
    steps = [b - a for a, b in zip(times, times[1:])]
    usual = percentile(steps, 0.5)
    return len(frames), sum(round(step / usual) - 1 for step in steps), commands


with Reader(out) as reader:
    report.check("the picture is live", reader.live(10) is not None)
    count, missing, _ = watched(reader, SECONDS)
    report.say(f"       calm: {count} frames, {missing} missing")
    lines = daemon.said().count("\n")
    flooding = subprocess.Popen([sys.executable, "-B", __file__, "--flood", SOCKET])
    time.sleep(1)
    count, more, commands = watched(reader, SECONDS)
    report.check("the sixteen are still connected", flooding.poll() is None)
    flooding.kill()
    grown = daemon.said().count("\n") - lines
    report.check(f"under the flood: {count} frames, {more} missing (at most {missing} and 1 in 100)", more <= missing + count // 100)
    took = [command[0] for command in commands]
    report.check(f"{len(commands)} commands, all answered", commands and all(command[1] for command in commands))
    report.say(f"       in {percentile(took, 0.5):.3f} s (median), {max(took):.3f} s (longest)")
    report.check(f"{grown / (SECONDS + 1):.1f} lines a second in the log (10 at most)", grown <= 10 * (SECONDS + 1))
daemon.stop()
report.end()
